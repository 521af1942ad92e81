// The receiver's inner parts, each against what it stands for.
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <vector>

#include "waveform/lte/canceller.hpp"
#include "waveform/lte/cell_test.hpp"
#include "waveform/lte/crs_tracker.hpp"
#include "waveform/lte/delay_subspace.hpp"
#include "waveform/lte/demodulator.hpp"
#include "waveform/lte/frame_layout.hpp"
#include "waveform/lte/kernels.hpp"
#include "waveform/lte/link_tracker.hpp"
#include "waveform/lte/path_model.hpp"
#include "waveform/lte/pss_correlator.hpp"
#include "waveform/lte_scene.hpp"

namespace soopnav::lte {
namespace {

using test::noise;
using test::random_cell;
using Cf64 = std::complex<double>;

// Kernels against the same sums in double precision, for every remainder of the vectors' widths.

TEST(Kernels, AgreeWithPlainSums) {
  for (const std::size_t n : {0U, 1U, 2U, 3U, 7U, 15U, 16U, 17U, 31U, 32U, 33U, 63U, 64U, 100U, 1023U, 2500U}) {
    SCOPED_TRACE(n);
    const auto a = noise(n, 1.0, 1), b = noise(n, 1.0, 2);
    std::vector<Cf32> product(n), scaled(n);
    kernels::multiply(a.data(), b.data(), product.data(), n);
    const Cf32 factor(0.3F, -1.7F);
    kernels::multiply_scaled(a.data(), b.data(), factor, scaled.data(), n);
    std::vector<float> power(n, 2.0F), sum(n, 0.5F), x(n), y(n);
    kernels::accumulate_power(a.data(), power.data(), n);
    kernels::add(power.data(), sum.data(), n);
    Cf64 correlation{};
    double energy = 0.0, dot = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      const Cf64 p(a[i]), q(b[i]);
      EXPECT_LT(std::abs(Cf64(product[i]) - p * q), 1e-5);
      EXPECT_LT(std::abs(Cf64(scaled[i]) - p * q * Cf64(factor)), 1e-5);
      EXPECT_LT(std::abs(Cf64(kernels::multiply(a[i], b[i])) - p * q), 1e-5);
      EXPECT_LT(std::abs(Cf64(kernels::multiply_conj(a[i], b[i])) - p * std::conj(q)), 1e-5);
      EXPECT_NEAR(static_cast<double>(power[i]), 2.0 + std::norm(p), 1e-5);
      EXPECT_FLOAT_EQ(sum[i], 0.5F + power[i]);
      correlation += p * std::conj(q);
      energy += std::norm(p);
      x[i] = a[i].real();
      y[i] = b[i].imag();
      dot += static_cast<double>(x[i]) * static_cast<double>(y[i]);
    }
    const double tolerance = 1e-6 * static_cast<double>(n + 1);
    EXPECT_LT(std::abs(Cf64(kernels::dot_conj(a.data(), b.data(), n)) - correlation), tolerance);
    EXPECT_NEAR(static_cast<double>(kernels::dot(x.data(), y.data(), n)), dot, tolerance);
    EXPECT_NEAR(kernels::energy(a.data(), n), energy, tolerance);
  }
}

TEST(Kernels, MaximumIsFoundAtEveryPlace) {
  for (const std::size_t n : {1U, 2U, 15U, 16U, 17U, 40U, 64U}) {
    for (std::size_t at = 0; at < n; ++at) {
      std::vector<float> x(n, -3.0F);
      x[at] = -1.0F;
      EXPECT_EQ(kernels::maximum(x.data(), n), -1.0F) << n << ' ' << at;
    }
  }
}

TEST(Kernels, PhasorsStayExact) {
  for (const double start : {0.0, 0.31, -7.9, 1e6 + 0.25}) {
    for (const double step : {0.0, 1e-7, 0.013, -0.4999, 3.25, 1.0 / 3.0}) {
      for (const std::size_t n : {1U, 5U, 16U, 257U, 20000U}) {
        std::vector<Cf32> out(n);
        kernels::phasors(start, step, out.data(), n);
        double worst = 0.0;
        for (std::size_t i = 0; i < n; ++i) {
          const double cycles = start + step * static_cast<double>(i);
          worst = std::max(worst, std::abs(Cf64(out[i]) - std::polar(1.0, kTwoPi * (cycles - std::floor(cycles)))));
        }
        EXPECT_LT(worst, 5e-6) << start << ' ' << step << ' ' << n;
      }
    }
  }
  kernels::phasors(0.1, 0.2, nullptr, 0);
}

// Places of the synchronisation signals, counted in the units of TS 36.211 (2048 per symbol; prefixes 160, 144, 512).

TEST(FrameLayout, SynchronisationSignals) {
  const auto useful_start = [](int slot, int symbol, CyclicPrefix cp) {
    int at = slot * 15360;
    for (int l = 0; l <= symbol; ++l) {
      at += cp == CyclicPrefix::kExtended ? 512 : l == 0 ? 160 : 144;
      if (l < symbol) at += 2048;
    }
    return at / 16;
  };
  for (const CyclicPrefix cp : {CyclicPrefix::kNormal, CyclicPrefix::kExtended}) {
    const int last = cp == CyclicPrefix::kNormal ? 6 : 5;
    EXPECT_EQ(pss_in_half_frame(Duplex::kFdd, cp), useful_start(0, last, cp));
    EXPECT_EQ(pss_in_half_frame(Duplex::kTdd, cp), useful_start(2, 2, cp));
    EXPECT_EQ(sss_before_pss(Duplex::kFdd, cp), useful_start(0, last, cp) - useful_start(0, last - 1, cp));
    EXPECT_EQ(sss_before_pss(Duplex::kTdd, cp), useful_start(2, 2, cp) - useful_start(1, last, cp));
  }
}

// The demodulator gives back the grid that was sent, at any fraction of a sample and any carrier offset.

TEST(Demodulator, ReturnsTheGridThatWasSent) {
  RandomStream random(3);
  for (const auto& [n_rb, size] : {std::pair{6, 128}, std::pair{15, 256}, std::pair{25, 512}, std::pair{75, 1024}}) {
    for (const CyclicPrefix cp : {CyclicPrefix::kNormal, CyclicPrefix::kExtended}) {
      CellParameters cell = random_cell(random, n_rb, 1);
      cell.cp = cp;
      cell.delay_s = random.uniform(20e-6, 30e-6);
      cell.cfo_hz = random.uniform(-20e3, 20e3);
      const double rate_hz = size * kSubcarrierSpacingHz;
      const auto iq = synthesize({&cell, 1}, rate_hz, static_cast<std::size_t>(2.1e-3 * rate_hz), 0.0, 4);
      const Cf64 gain = cell.port_gain[0] * std::polar(1.0, cell.carrier_phase_rad);
      Demodulator demodulator(size);
      EXPECT_EQ(demodulator.fft_size(), size);
      demodulator.set_frequency(cell.cfo_hz / rate_hz);
      std::vector<Cf32> got(static_cast<std::size_t>(12 * n_rb)), pilots(static_cast<std::size_t>(2 * n_rb));
      const auto reference = noise(pilots.size(), 1.0, 5);
      for (int subframe = 0; subframe < 2; ++subframe) {
        const ResourceGrid grid = resource_grid(cell, cell.start_sfn, subframe, 4);
        for (int l = 0; l < grid.n_symbols; ++l) {
          const int per_slot = symbols_per_slot(cp), symbol = l % per_slot;
          const double start = cell.delay_s * rate_hz + (2 * subframe + l / per_slot) * 7.5 * size +
                               symbol_start_samples(cp, symbol, size) + cyclic_prefix_samples(cp, symbol, size);
          ASSERT_TRUE(demodulator.transform(iq, start, 3 * size / 128));
          demodulator.subcarriers(6 * n_rb, got.data());
          double worst = 0.0;
          for (int k = 0; k < 12 * n_rb; ++k) {
            worst = std::max(worst, std::abs(Cf64(got[static_cast<std::size_t>(k)]) - gain * Cf64(grid.at(0, l, k))));
          }
          EXPECT_LT(worst, 2e-4) << n_rb << ' ' << l;
          for (int first = 0; first < 6; ++first) {
            demodulator.pilots(first - 6 * n_rb, 2 * n_rb, reference.data(), pilots.data());
            for (std::size_t m = 0; m < pilots.size(); ++m) {
              const Cf64 expected = Cf64(got[6 * m + static_cast<std::size_t>(first)]) * Cf64(reference[m]);
              EXPECT_LT(std::abs(Cf64(pilots[m]) - expected), 1e-4);
            }
          }
        }
      }
    }
  }
}

TEST(Demodulator, StaysInsideTheCapture) {
  const auto iq = noise(300, 1.0, 6);
  Demodulator demodulator(128);
  EXPECT_TRUE(demodulator.transform(iq, 3.0, 3));
  EXPECT_FALSE(demodulator.transform(iq, 2.99, 3));
  EXPECT_TRUE(demodulator.transform(iq, 175.9, 3));
  EXPECT_FALSE(demodulator.transform(iq, 176.0, 3));
  EXPECT_FALSE(demodulator.transform(iq, -1e18, 3));
  EXPECT_FALSE(demodulator.transform(iq, 1e18, 3));
  EXPECT_FALSE(demodulator.transform(iq, std::nan(""), 3));
  EXPECT_FALSE(demodulator.transform({}, 10.0, 3));
}

// PSS correlator: root, place, carrier offset and drift of the strongest candidate.

TEST(PssCorrelator, FindsRootPlaceOffsetAndDrift) {
  RandomStream random(7);
  for (const bool wide : {false, true}) {
    PssCorrelator correlator({.max_cfo_hz = wide ? 60e3 : 10e3,
                              .spacing_hz = wide ? 7.5e3 : 4.875e3,
                              .inverse_size = wide ? 6144 : 10240,
                              .max_drift_ppm = 90.0,
                              .max_half_frames = 16,
                              .in_band = !wide});
    const double ratio = wide ? 10240.0 / 6144.0 : 1.0;
    EXPECT_EQ(correlator.lags(), wide ? 5760 : 9600);
    std::vector<PssCandidate> candidates;
    for (const double ppm : {-80.0, 0.0, 80.0}) {
      for (int root = 0; root < 3; ++root) {
        CellParameters cell = random_cell(random);
        cell.cell_id = 3 * (cell.cell_id / 3) + root;
        cell.cfo_hz = random.uniform(-1.0, 1.0) * (wide ? 55e3 : 9e3);
        cell.clock_error_ppm = ppm;
        cell.duplex = root == 1 ? Duplex::kTdd : Duplex::kFdd;
        const auto iq = synthesize({&cell, 1}, kBaseRateHz, 153600, noise_variance_for_snr(5.0), 8);
        correlator.clear();
        for (std::size_t at = 0; at < iq.size(); at += kHalfFrameSamples) correlator.add(iq, at);
        EXPECT_EQ(correlator.half_frames(), 16);
        correlator.peaks(5, candidates);
        ASSERT_EQ(candidates.size(), 5U);
        // To a lag, half a step of the slip over groups, and half of the bank's spacing. A Zadoff-Chu sequence has
        // ghosts at offsets of its own, so the right place may be the second or third.
        const double at = cell.delay_s * kBaseRateHz + pss_in_half_frame(cell.duplex, cell.cp);
        const auto right = [&](const PssCandidate& c) {
          return c.n_id_2 == root && std::abs(std::remainder(c.tau - at, 9600.0)) < 1.0 + 2.0 * ratio &&
                 std::abs(c.cfo_hz - cell.cfo_hz) < (wide ? 3.9e3 : 2.6e3) &&
                 std::abs(c.drift + 1e-6 * ppm) < 1.1 * ratio * 2.0 / 115200.0;
        };
        EXPECT_EQ(candidates[0].n_id_2, root);
        EXPECT_EQ(std::count_if(candidates.begin(), candidates.begin() + 3, right), 1) << root << ' ' << ppm;
        for (std::size_t i = 0; i < 5; ++i) {
          EXPECT_GE(candidates[i].tau, 0.0);
          EXPECT_LT(candidates[i].tau, 9600.0);
          if (i > 0) {
            EXPECT_LE(candidates[i].score, candidates[i - 1].score);
          }
        }
      }
    }
  }
}

TEST(PssCorrelator, ScoreIsInUnitsOfItsMean) {
  // Noise: each lag's sum of 16 powers over its mean is Gamma(16)/16, roughly, and the largest of 9600 x 9 near 3.
  PssCorrelator correlator({.max_cfo_hz = 3e3,
                            .spacing_hz = 3e3,
                            .inverse_size = 10240,
                            .max_drift_ppm = 0.0,
                            .max_half_frames = 16,
                            .in_band = false});
  const auto iq = noise(153600 + 128, 7.0, 9);
  for (std::size_t at = 0; at + 128 < iq.size(); at += kHalfFrameSamples) correlator.add(iq, at);
  std::vector<PssCandidate> candidates;
  correlator.peaks(3, candidates);
  ASSERT_EQ(candidates.size(), 3U);
  EXPECT_GT(candidates[0].score, 2.2);
  EXPECT_LT(candidates[0].score, 4.0);
}

TEST(PssCorrelator, NothingInNothing) {
  PssCorrelator correlator({.max_cfo_hz = 0.0,
                            .spacing_hz = 3e3,
                            .inverse_size = 10240,
                            .max_drift_ppm = 0.0,
                            .max_half_frames = 2,
                            .in_band = true});
  std::vector<PssCandidate> candidates(3);
  correlator.peaks(5, candidates);
  EXPECT_TRUE(candidates.empty());
  const std::vector<Cf32> silence(19200);
  correlator.add(silence, 0);
  correlator.peaks(5, candidates);
  EXPECT_TRUE(candidates.empty());
  correlator.add(silence, 19200);  // beyond the end
  EXPECT_EQ(correlator.half_frames(), 1);
  correlator.add(silence, 9600);
  correlator.add(silence, 0);  // beyond max_half_frames
  EXPECT_EQ(correlator.half_frames(), 2);
}

// Cell test: candidate to confirmed cell.

TEST(CellTest, ConfirmsTheCellAndOnlyAtItsPlace) {
  RandomStream random(10);
  CellTest cell_test;
  for (int trial = 0; trial < 8; ++trial) {
    CellParameters cell = random_cell(random);
    cell.cp = trial % 2 == 0 ? CyclicPrefix::kNormal : CyclicPrefix::kExtended;
    cell.duplex = trial % 4 < 2 ? Duplex::kFdd : Duplex::kTdd;
    cell.cfo_hz = random.uniform(-2e3, 2e3);
    const auto iq = synthesize({&cell, 1}, kBaseRateHz, 76800, noise_variance_for_snr(3.0), 11);
    double at = cell.delay_s * kBaseRateHz + pss_in_half_frame(cell.duplex, cell.cp);
    at = std::fmod(at, 9600.0);
    std::vector<ConfirmedCell> out;
    const PssCandidate good{cell.cell_id % 3, std::round(at), 1500.0, 0.0, 1.0};
    cell_test.examine(
        iq, good, false, [](int) { return false; }, out);
    ASSERT_EQ(out.size(), 1U);
    EXPECT_EQ(out[0].cell_id, cell.cell_id);
    EXPECT_EQ(out[0].cp, cell.cp);
    EXPECT_EQ(out[0].duplex, cell.duplex);
    EXPECT_GT(out[0].evidence, CellTest::kEvidence);
    EXPECT_NEAR(out[0].cfo_hz, cell.cfo_hz, 30.0);
    EXPECT_LT(std::abs(std::remainder(out[0].frame_start - cell.delay_s * kBaseRateHz, 19200.0)), 1.5);
    out.clear();
    cell_test.examine(
        iq, good, false, [&](int id) { return id == cell.cell_id; }, out);  // known before
    EXPECT_TRUE(out.empty());
    const PssCandidate wrong_root{(cell.cell_id + 1) % 3, std::round(at), 1500.0, 0.0, 1.0};
    cell_test.examine(
        iq, wrong_root, false, [](int) { return false; }, out);
    const PssCandidate elsewhere{cell.cell_id % 3, std::fmod(at + 3000.0, 9600.0), 1500.0, 0.0, 1.0};
    cell_test.examine(
        iq, elsewhere, false, [](int) { return false; }, out);
    EXPECT_TRUE(out.empty());
  }
}

// Reference signals.

TEST(CrsTracker, ChannelOfEveryPort) {
  RandomStream random(12);
  for (const int n_ports : {1, 2, 4}) {
    for (const CyclicPrefix cp : {CyclicPrefix::kNormal, CyclicPrefix::kExtended}) {
      CellParameters cell = random_cell(random, 25, n_ports);
      cell.cp = cp;
      cell.delay_s = 1e-3;
      cell.cfo_hz = 300.0;
      constexpr int kSize = 512;
      const double rate_hz = kSize * kSubcarrierSpacingHz, late = 1.7;  // the state is 1.7 samples early
      const auto iq = synthesize({&cell, 1}, rate_hz, static_cast<std::size_t>(22e-3 * rate_hz));
      CrsTracker tracker(kSize);
      tracker.configure({cell.cell_id, cp, Duplex::kFdd, 25, n_ports});
      ASSERT_EQ(tracker.elements(), 100);
      tracker.read(iq, {cell.delay_s * rate_hz - late, 0.0, cell.cfo_hz / rate_hz}, 20);
      ASSERT_EQ(tracker.frames().size(), 2U);
      for (std::size_t f = 0; f < 2; ++f) {
        EXPECT_EQ(tracker.frames()[f].index, static_cast<int>(f));
        EXPECT_EQ(tracker.frames()[f].symbols, 40);
        EXPECT_LT(tracker.frames()[f].noise_variance, 1e-6);
        for (int port = 0; port < n_ports; ++port) {
          const int per_parity = port < 2 ? 20 : 10;
          EXPECT_EQ(tracker.symbols(f, port, 0), per_parity);
          EXPECT_EQ(tracker.symbols(f, port, 1), per_parity);
          const Cf64 gain = cell.port_gain[static_cast<std::size_t>(port)] * std::polar(1.0, cell.carrier_phase_rad);
          for (int j = 0; j < 100; ++j) {
            const int frequency = tracker.element_frequencies()[static_cast<std::size_t>(j)];
            const Cf64 expected = gain * std::polar(1.0, -kTwoPi * frequency * late / kSize);
            EXPECT_LT(std::abs(Cf64(tracker.channel(f, port)[j]) - expected), 3e-4) << port << ' ' << j;
          }
        }
      }
    }
  }
}

TEST(CrsTracker, ElementsStepByThreeButForTheCarrier) {
  for (const int cell_id : {0, 1, 2, 3, 4, 5, 503}) {
    CrsTracker tracker(128);
    tracker.configure({cell_id, CyclicPrefix::kNormal, Duplex::kFdd, 6, 2});
    const auto& f = tracker.element_frequencies();
    ASSERT_EQ(f.size(), 24U);
    EXPECT_EQ(f[0], -36 + cell_id % 3);
    for (std::size_t j = 1; j < f.size(); ++j) EXPECT_EQ(f[j] - f[j - 1], f[j] > 0 && f[j - 1] < 0 ? 4 : 3);
  }
}

TEST(CrsTracker, NoiseVariance) {
  RandomStream random(13);
  for (const Duplex duplex : {Duplex::kFdd, Duplex::kTdd}) {
    CellParameters cell = random_cell(random, 15, 2);
    cell.duplex = duplex;
    cell.delay_s = 1e-3;
    const double rate_hz = 3.84e6, variance = noise_variance_for_snr(-3.0);
    const auto iq = synthesize({&cell, 1}, rate_hz, static_cast<std::size_t>(42e-3 * rate_hz), variance, 14);
    CrsTracker tracker(256);
    tracker.configure({cell.cell_id, cell.cp, duplex, 15, 2});
    const int symbols = duplex == Duplex::kFdd ? 40 : 10;
    tracker.read(iq, {cell.delay_s * rate_hz, 0.0, 0.0}, symbols);
    ASSERT_EQ(tracker.frames().size(), 4U);
    double freedom = 0.0;
    for (const auto& frame : tracker.frames()) freedom += frame.noise_weight;
    EXPECT_EQ(freedom, 4.0 * 2.0 * 30.0 * (symbols - 2));  // a mean taken for each of two halves of the comb
    EXPECT_NEAR(tracker.noise_variance() / variance, 1.0, 5.0 / std::sqrt(freedom));
  }
}

TEST(CrsTracker, TddSubframesAreHeardOrNot) {
  RandomStream random(15);
  for (int configuration = 0; configuration < 7; ++configuration) {
    CellParameters cell = random_cell(random, 25, 2);
    cell.duplex = Duplex::kTdd;
    cell.tdd_configuration = configuration;
    cell.delay_s = 0.2e-3;
    const double rate_hz = 7.68e6;
    const auto iq = synthesize({&cell, 1}, rate_hz, 172800, noise_variance_for_snr(3.0), 16);
    CrsTracker tracker(512);
    tracker.configure({cell.cell_id, cell.cp, cell.duplex, 25, 2});
    const LinkState state{cell.delay_s * rate_hz, 0.0, 0.0};
    tracker.read(iq, state, 10);
    ASSERT_EQ(tracker.frames().size(), 2U);
    EXPECT_EQ(tracker.frames()[0].symbols, 10);  // subframes 0 and 5, and the first symbols of 1 and 6
    tracker.find_downlink_subframes(iq, state);
    for (int subframe = 0; subframe < 10; ++subframe) {
      const bool heard = downlink_symbols(cell, subframe) > 0;
      EXPECT_EQ((tracker.subframes() >> subframe) & 1U, heard ? 1U : 0U) << configuration << ' ' << subframe;
      EXPECT_EQ(tracker.transmitted(2 * subframe, 0), heard);
      const bool special = subframe == 1 || subframe == 6;
      EXPECT_EQ(tracker.transmitted(2 * subframe + 1, 0), heard && !special);
      EXPECT_EQ(tracker.transmitted(2 * subframe, 4), heard && !special);
    }
  }
}

TEST(CrsTracker, SlotsOutsideTheCaptureAreRefused) {
  CrsTracker tracker(128);
  tracker.configure({7, CyclicPrefix::kNormal, Duplex::kFdd, 6, 2});
  const auto iq = noise(1920, 1.0, 17);
  const LinkState state{0.0, 0.0, 0.0};
  EXPECT_TRUE(tracker.read_slots(iq, state, 0, 0, 2));
  EXPECT_TRUE(tracker.read_slots(iq, state, 0, 1, 1));
  EXPECT_FALSE(tracker.read_slots(iq, state, 0, 2, 1));
  EXPECT_FALSE(tracker.read_slots(iq, state, -1, 0, 2));
  EXPECT_FALSE(tracker.read_slots({}, state, 0, 0, 2));
}

// Delay of a channel.

std::vector<int> comb(int n_rb, int offset) {
  std::vector<int> f(static_cast<std::size_t>(4 * n_rb));
  for (std::size_t j = 0; j < f.size(); ++j) {
    const int centred = 3 * static_cast<int>(j) + offset - 6 * n_rb;
    f[j] = centred < 0 ? centred : centred + 1;
  }
  return f;
}

std::vector<Cf32> channel(const std::vector<int>& f, int size, const std::vector<std::pair<double, Cf64>>& paths) {
  std::vector<Cf32> y(f.size());
  for (std::size_t j = 0; j < f.size(); ++j) {
    Cf64 sum{};
    for (const auto& [delay, gain] : paths) sum += gain * std::polar(1.0, -kTwoPi * f[j] * delay / size);
    y[j] = Cf32(sum);
  }
  return y;
}

TEST(RefineDelay, ConvergesToTheDelayWithAnyPhases) {
  RandomStream random(18);
  for (const int n_rb : {6, 25, 100}) {
    const int size = n_rb == 6 ? 128 : n_rb == 25 ? 512 : 2048;
    const auto f = comb(n_rb, n_rb % 3);
    const double cell = static_cast<double>(size) / (12 * n_rb);  // 1 / bandwidth, samples
    for (int trial = 0; trial < 20; ++trial) {
      const double delay = random.uniform(-30.0, 30.0) * size / 2048.0;
      const auto a = channel(f, size, {{delay, std::polar(1.0, random.uniform(0.0, 6.28))}});
      const auto b = channel(f, size, {{delay, std::polar(0.4, random.uniform(0.0, 6.28))}});
      const std::array<const Cf32*, 2> y{a.data(), b.data()};
      const double start = delay + random.uniform(-0.45, 0.45) * cell;
      const DelayFit fit = refine_delay(y.data(), nullptr, 2, f.data(), static_cast<int>(f.size()), size, start);
      EXPECT_TRUE(fit.converged);
      EXPECT_NEAR(fit.tau, delay, 2e-6 * size / 128.0);
      const double count = static_cast<double>(f.size());
      EXPECT_NEAR(fit.power, count * count * (1.0 + 0.16), 1e-4 * count * count);
      double mean = 0.0, square = 0.0;
      for (const int k : f) {
        mean += k / count;
        square += static_cast<double>(k) * k / count;
      }
      EXPECT_NEAR(fit.curvature, std::pow(kTwoPi / size, 2) * (square - mean * mean), 1e-4 * fit.curvature);
    }
  }
}

TEST(RefineDelay, AgainstATemplateItIsTheShift) {
  const auto f = comb(25, 1);
  const std::vector<std::pair<double, Cf64>> paths{{2.0, {0.5, 0.2}}, {4.1, {-0.3, 1.0}}, {9.9, {0.0, 0.7}}};
  auto later = paths;
  for (auto& path : later) path.first += 0.321;
  for (auto& path : later) path.second *= std::polar(1.0, 2.2);
  const auto reference = channel(f, 512, paths), y = channel(f, 512, later);
  const std::array<const Cf32*, 1> a{y.data()}, b{reference.data()};
  const DelayFit fit = refine_delay(a.data(), b.data(), 1, f.data(), 100, 512, 0.0);
  EXPECT_TRUE(fit.converged);
  EXPECT_NEAR(fit.tau, 0.321, 1e-5);
}

TEST(RefineDelay, SilenceDoesNotConverge) {
  const auto f = comb(6, 0);
  const std::vector<Cf32> silence(24);
  const std::array<const Cf32*, 1> y{silence.data()};
  EXPECT_FALSE(refine_delay(y.data(), nullptr, 1, f.data(), 24, 128, 0.0).converged);
}

TEST(CoarseDelay, AnyDelayWithinTheComb) {
  CoarseDelay coarse;
  for (const int n_rb : {6, 100, 25}) {
    const int size = n_rb == 6 ? 128 : n_rb == 25 ? 512 : 2048;
    const auto f = comb(n_rb, 2);
    for (double share = -0.48; share < 0.49; share += 0.031) {
      const double delay = share * size / 3.0;
      const auto x = channel(f, size, {{delay, {0.0, 2.0}}});
      const std::array<const Cf32*, 1> y{x.data()};
      // Refining asks for half of a resolution cell; the profile's step and the skipped carrier take a third.
      EXPECT_NEAR(coarse.estimate(y.data(), 1, static_cast<int>(f.size()), size), delay, 0.4 * size / (12.0 * n_rb));
    }
  }
}

TEST(LinkTracker, DelayDriftAndFrequency) {
  RandomStream random(19);
  for (const double ppm : {-15.0, 0.0, 15.0}) {
    CellParameters cell = random_cell(random, 6, 2);
    cell.delay_s = 2e-3;
    cell.cfo_hz = 700.0;
    cell.clock_error_ppm = ppm;
    const auto iq = synthesize({&cell, 1}, kBaseRateHz, 163200, noise_variance_for_snr(20.0), 20);
    CrsTracker tracker(128);
    tracker.configure({cell.cell_id, cell.cp, cell.duplex, 6, 2});
    LinkState state{cell.delay_s * kBaseRateHz + 1.1, 0.0, (cell.cfo_hz + 12.0) / kBaseRateHz};
    LinkTracker link;
    ASSERT_TRUE(link.track(tracker, iq, state, 3, 20e-6));
    EXPECT_EQ(link.frames().size(), 8U);
    // Deviations at 20 dB over eight frames: 0.0011 samples, 0.02 ppm, 0.01 Hz.
    EXPECT_NEAR(state.frame_start, cell.delay_s * kBaseRateHz, 0.012);
    EXPECT_NEAR(state.drift, 1.0 / (1.0 + 1e-6 * ppm) - 1.0, 0.15e-6);
    EXPECT_NEAR(state.frequency * kBaseRateHz, cell.cfo_hz, 0.1);
    EXPECT_LT(link.drift_sigma(), 0.06e-6);
    EXPECT_NEAR(10.0 * std::log10(link.snr()), 20.0, 0.5);
  }
  LinkTracker link;
  CrsTracker tracker(128);
  tracker.configure({3, CyclicPrefix::kNormal, Duplex::kFdd, 6, 1});
  LinkState state{0.0, 0.0, 0.0};
  EXPECT_FALSE(link.track(tracker, {}, state, 2, 1e-6));
}

// Channels that delays within a window can make.

TEST(DelaySubspace, KeepsTheWindowAndRejectsTheRest) {
  const Eigen::VectorXd f = sync_frequencies();
  ASSERT_EQ(f.size(), 62);
  DelaySubspace subspace(f, -1.2e-6, 4.7e-6, 1e-3);
  EXPECT_GT(subspace.rank(), 5);  // 5.9 us of 930 kHz: five and a half independent values
  EXPECT_LT(subspace.rank(), 12);
  const auto response = [&](double delay_s) {
    std::vector<Cf32> in(62), out(62);
    double energy = 0.0, error = 0.0, kept = 0.0;
    for (Eigen::Index k = 0; k < 62; ++k) {
      in[static_cast<std::size_t>(k)] = Cf32(std::polar(1.0, -kTwoPi * 15e3 * f(k) * delay_s));
    }
    subspace.project(in.data(), out.data());
    for (std::size_t k = 0; k < 62; ++k) {
      energy += static_cast<double>(std::norm(in[k]));
      error += static_cast<double>(std::norm(in[k] - out[k]));
      kept += static_cast<double>(std::norm(out[k]));
    }
    auto again = out;
    subspace.project(out.data(), again.data());  // a projection
    for (std::size_t k = 0; k < 62; ++k) EXPECT_LT(std::abs(again[k] - out[k]), 1e-5F);
    EXPECT_NEAR(error + kept, energy, 1e-3);
    return error / energy;
  };
  for (double us = -1.1; us < 4.6; us += 0.3) EXPECT_LT(response(us * 1e-6), 0.02) << us;
  for (const double us : {-12.0, -6.0, 10.0, 20.0}) EXPECT_GT(response(us * 1e-6), 0.9) << us;
}

TEST(DelaySubspace, InterpolatesBetweenTheElements) {
  const auto elements = comb(6, 1);
  Eigen::VectorXd from(24), to(72);
  for (Eigen::Index j = 0; j < 24; ++j) from(j) = elements[static_cast<std::size_t>(j)];
  for (Eigen::Index k = 0; k < 72; ++k) to(k) = k < 36 ? static_cast<double>(k - 36) : static_cast<double>(k - 35);
  DelaySubspace subspace(from, -1.0e-6, 4.0e-6, 1e-2);
  subspace.set_targets(to);
  std::vector<Cf32> in(24), out(72);
  for (const double delay_s : {-0.5e-6, 0.0, 1.3e-6, 3.5e-6}) {
    for (Eigen::Index j = 0; j < 24; ++j) {
      in[static_cast<std::size_t>(j)] = Cf32(std::polar(1.0, 0.4 - kTwoPi * 15e3 * from(j) * delay_s));
    }
    subspace.interpolate(in.data(), out.data());
    double error = 0.0;
    for (Eigen::Index k = 0; k < 72; ++k) {
      const Cf64 expected = std::polar(1.0, 0.4 - kTwoPi * 15e3 * to(k) * delay_s);
      error += std::norm(Cf64(out[static_cast<std::size_t>(k)]) - expected) / 72.0;
    }
    EXPECT_LT(error, 0.01) << delay_s;  // what the eigenvalues left out, 1e-2, allow
  }
}

// Discrete paths.

TEST(PathModel, RecoversPathsWithoutNoise) {
  CoarseDelay coarse;
  PathModel model;
  const auto f = comb(100, 0);
  const std::vector<std::pair<double, Cf64>> paths{{-3.3, {0.35, 0.1}}, {0.4, {0.0, 1.0}}, {7.9, {-0.4, 0.3}}};
  auto other = paths;
  for (auto& path : other) path.second *= std::polar(1.3, path.first);
  const auto a = channel(f, 2048, paths), b = channel(f, 2048, other);
  const std::array<const Cf32*, 2> y{a.data(), b.data()};
  ASSERT_TRUE(model.fit(y.data(), 2, f.data(), 400, 2048, 1e-6, {.window_samples = 140.0}, coarse));
  ASSERT_EQ(model.paths(), 3);
  EXPECT_EQ(model.first(), 0);
  for (int l = 0; l < 3; ++l) {
    const auto& [delay, gain] = paths[static_cast<std::size_t>(l)];
    EXPECT_NEAR(model.delay(l), delay, 1e-4);
    EXPECT_NEAR(model.power(l), std::norm(gain) * (1.0 + 1.69) / 2.0, 1e-3);
  }
  for (std::size_t j = 0; j < f.size(); ++j) {
    EXPECT_LT(std::abs(model.channel(0)[j] - a[j]), 1e-4F);
    EXPECT_LT(std::abs(model.channel(1)[j] - b[j]), 1e-4F);
  }
}

TEST(PathModel, FirstPathsDeviationIsTheBound) {
  // Two paths 1.5 resolution cells apart: the bound from the Fisher matrix of delays and complex amplitudes, built by
  // central differences of the channel.
  CoarseDelay coarse;
  PathModel model;
  const auto f = comb(25, 2);
  constexpr int kSize = 512;
  const double variance = 1e-3, apart = 1.5 * kSize / 300.0;
  const std::vector<std::pair<double, Cf64>> paths{{0.0, {0.8, 0.1}}, {apart, {0.2, 0.9}}};
  Eigen::MatrixXcd jacobian(100, 6);
  for (int column = 0; column < 6; ++column) {
    std::array<std::vector<Cf64>, 2> side;
    for (int s = 0; s < 2; ++s) {
      auto moved = paths;
      const double step = s == 0 ? 1e-5 : -1e-5;
      auto& path = moved[static_cast<std::size_t>(column / 3)];
      if (column % 3 == 0) path.first += step;
      if (column % 3 == 1) path.second += step;
      if (column % 3 == 2) path.second += Cf64(0.0, step);
      for (const int k : f) {
        Cf64 sum{};
        for (const auto& [delay, gain] : moved) sum += gain * std::polar(1.0, -kTwoPi * k * delay / kSize);
        side[static_cast<std::size_t>(s)].push_back(sum);
      }
    }
    for (Eigen::Index j = 0; j < 100; ++j) {
      const auto u = static_cast<std::size_t>(j);
      jacobian(j, column) = (side[0][u] - side[1][u]) / 2e-5;
    }
  }
  const Eigen::MatrixXd fisher = 2.0 / variance * (jacobian.adjoint() * jacobian).real();
  const double bound = std::sqrt(fisher.inverse()(0, 0));

  RandomStream random(21);
  const auto clean = channel(f, kSize, paths);
  double square = 0.0, reported = 0.0;
  constexpr int kRuns = 400;
  std::vector<Cf32> y;
  for (int run = 0; run < kRuns; ++run) {
    test::with_noise(clean, variance, random, y);
    const std::array<const Cf32*, 1> one{y.data()};
    ASSERT_TRUE(model.fit(one.data(), 1, f.data(), 100, kSize, variance, {.window_samples = 36.0}, coarse));
    ASSERT_EQ(model.paths(), 2);
    square += model.delay(0) * model.delay(0) / kRuns;
    reported += model.first_sigma() / kRuns;
  }
  // 400 runs: a chi-square mean beyond 1.30 or below 0.74 has probability 1e-4.
  EXPECT_LT(square / (bound * bound), 1.30);
  EXPECT_GT(square / (bound * bound), 0.74);
  EXPECT_NEAR(reported / bound, 1.0, 0.1);
}

TEST(PathModel, FirstPathRule) {
  // A path 22 dB below the strongest is modelled but not called the first; one 15 dB below is.
  CoarseDelay coarse;
  PathModel model;
  const auto f = comb(100, 0);
  for (const double level_db : {-22.0, -15.0}) {
    const double early = std::pow(10.0, level_db / 20.0);
    const auto y = channel(f, 2048, {{-6.0, {0.0, early}}, {1.0, {1.0, 0.0}}});
    const std::array<const Cf32*, 1> one{y.data()};
    ASSERT_TRUE(model.fit(one.data(), 1, f.data(), 400, 2048, 1e-7, {.window_samples = 140.0}, coarse));
    EXPECT_EQ(model.paths(), 2);
    EXPECT_NEAR(model.delay(model.first()), level_db < -20.0 ? 1.0 : -6.0, 1e-2);
  }
}

TEST(PathModel, NoiseHasNoPath) {
  CoarseDelay coarse;
  PathModel model;
  const auto f = comb(25, 0);
  RandomStream random(22);
  int found = 0;
  std::vector<Cf32> a(100), b(100);
  for (int run = 0; run < 2000; ++run) {
    random.fill_complex_normal(a, 0.3);
    random.fill_complex_normal(b, 0.3);
    const std::array<const Cf32*, 2> y{a.data(), b.data()};
    found += model.fit(y.data(), 2, f.data(), 100, 512, 0.3, {.window_samples = 36.0}, coarse) ? 1 : 0;
  }
  EXPECT_EQ(found, 0);  // 2e-3 expected
}

// Cancelling.

TEST(Canceller, TakesTheKnownElementsAndLeavesTheOthers) {
  RandomStream random(23);
  for (const Duplex duplex : {Duplex::kFdd, Duplex::kTdd}) {
    for (const CyclicPrefix cp : {CyclicPrefix::kNormal, CyclicPrefix::kExtended}) {
      CellParameters cell = random_cell(random, 6, 2);
      cell.duplex = duplex;
      cell.cp = cp;
      cell.cfo_hz = 400.0;
      cell.delay_s = 0.3e-3;
      cell.taps = {{0.0, 1.0}, {1.3e-6, {0.0, 0.5}}};
      cell.sync_ports = SyncPorts::kAll;
      const auto before = synthesize({&cell, 1}, kBaseRateHz, 19200 + 1000, 0.0, 24);
      auto after = before;
      CrsTracker tracker(128);
      tracker.configure({cell.cell_id, cp, duplex, 6, 2});
      const LinkState state{cell.delay_s * kBaseRateHz, 0.0, cell.cfo_hz / kBaseRateHz};
      tracker.read(before, state, 1);
      Canceller canceller;
      canceller.subtract(state, tracker, after);

      Demodulator demodulator(128);
      demodulator.set_frequency(state.frequency);
      std::vector<Cf32> x(72), y(72);
      double known_before = 0.0, known_after = 0.0, other_before = 0.0, other_change = 0.0;
      for (int subframe = 0; subframe < 10; ++subframe) {
        const ResourceGrid grid = resource_grid(cell, cell.start_sfn, subframe, 24);
        CellParameters empty = cell;  // of data, so that what is left is known: reference, synchronisation, broadcast
        empty.data_load = 0.0;
        const ResourceGrid bare = resource_grid(empty, cell.start_sfn, subframe, 24);
        const int per_slot = symbols_per_slot(cp);
        for (int l = 0; l < grid.n_symbols; ++l) {
          const int slot = 2 * subframe + l / per_slot, symbol = l % per_slot;
          if (subframe == 0 && slot == 1 && symbol < 4) continue;  // broadcast
          const double start = tracker.useful_start(state, 0, slot, symbol);
          ASSERT_TRUE(demodulator.transform(before, start, 3));
          demodulator.subcarriers(36, x.data());
          ASSERT_TRUE(demodulator.transform(after, start, 3));
          demodulator.subcarriers(36, y.data());
          const bool heard = l < downlink_symbols(cell, subframe);
          const bool certain = duplex == Duplex::kFdd || tracker.transmitted(slot, symbol);
          for (int k = 0; k < 72; ++k) {
            const auto u = static_cast<std::size_t>(k);
            const bool known = std::abs(bare.at(0, l, k)) + std::abs(bare.at(1, l, k)) > 0.0F;
            if (known && heard && certain) {
              known_before += static_cast<double>(std::norm(x[u]));
              known_after += static_cast<double>(std::norm(y[u]));
            } else {
              other_before += static_cast<double>(std::norm(x[u]));
              other_change += static_cast<double>(std::norm(x[u] - y[u]));
            }
          }
        }
      }
      EXPECT_LT(known_after, 3e-3 * known_before);
      EXPECT_LT(other_change, 3e-3 * other_before);
    }
  }
}

}  // namespace
}  // namespace soopnav::lte
