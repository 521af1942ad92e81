// Closely spaced paths, snapshots of several cells, loops and streams. Seeds are fixed; bounds on means of squares are
// what an efficient estimator leaves once in 10^4.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <complex>
#include <limits>
#include <stdexcept>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/waveform/lte/measurement_stream.hpp"
#include "soopnav/waveform/lte/snapshot_ranger.hpp"
#include "support/allocation_count.hpp"
#include "waveform/lte_scene.hpp"

namespace soopnav::lte {
namespace {

using soopnav::test::allocations_of;
using soopnav::test::kAllocationsCounted;
using test::truth;

constexpr double kLightMps = 299792458.0;

/// A channel of 100 blocks and two ports.
struct Channel {
  std::vector<int> frequencies;
  std::vector<Cf32> values;
  double variance = 0.0;
  [[nodiscard]] ChannelView view() const {
    ChannelView v;
    v.ports = 2;
    v.port[0] = values.data();
    v.port[1] = values.data() + frequencies.size();
    v.frequencies = frequencies;
    v.noise_variance = variance;
    return v;
  }
};

Channel channel_of(const std::vector<double>& delays_s, const std::vector<std::array<std::complex<double>, 2>>& gains,
                   double variance, RandomStream& random, int n_rb = 100) {
  Channel c;
  for (int j = 0; j < 4 * n_rb; ++j) c.frequencies.push_back(subcarrier_index(3 * j + 1, n_rb));
  const std::size_t n = c.frequencies.size();
  c.values.resize(2 * n);
  for (std::size_t p = 0; p < 2; ++p) {
    for (std::size_t j = 0; j < n; ++j) {
      std::complex<double> sum = 0.0;
      for (std::size_t l = 0; l < delays_s.size(); ++l) {
        sum += gains[l][p] * std::polar(1.0, -kTwoPi * kSubcarrierSpacingHz * c.frequencies[j] * delays_s[l]);
      }
      c.values[p * n + j] = Cf32(sum);
    }
  }
  c.variance = variance;
  if (variance > 0.0) random.add_complex_normal(c.values, variance);
  return c;
}

std::array<std::complex<double>, 2> phases(RandomStream& random, double amplitude = 1.0) {
  return {std::polar(amplitude, random.uniform(0.0, kTwoPi)), std::polar(amplitude, random.uniform(0.0, kTwoPi))};
}

TEST(PathResolver, ExactWithoutNoiseOnAnyBandwidth) {
  RandomStream random(1);
  PathResolver resolver;
  for (const int n_rb : kBandwidthsRb) {
    const double cell_s = 1.0 / (12.0 * n_rb * kSubcarrierSpacingHz);
    const std::vector<double> delays{3e-7, 3e-7 + 0.6 * cell_s};
    const auto c = channel_of(delays, {phases(random), phases(random, 0.8)}, 0.0, random, n_rb);
    ResolvedPaths out;
    ASSERT_EQ(resolver.resolve(c.view(), out), ResolveStatus::kOk) << n_rb;
    ASSERT_GE(out.paths.size(), 2U) << n_rb;
    EXPECT_NEAR(out.toa_s, delays[0], 2e-4 * cell_s) << n_rb;
    EXPECT_NEAR(out.paths[1].delay_s, delays[1], 2e-4 * cell_s) << n_rb;
  }
}

TEST(PathResolver, TwoPathsReachTheirBoundAndOneStaysOne) {
  constexpr int kRuns = 150;
  RandomStream random(2);
  PathResolver resolver;
  double nees = 0.0, ratio = 0.0, first_peak = 0.0, polished = 0.0;
  int ones = 0;
  for (int run = 0; run < kRuns; ++run) {
    const double start = random.uniform(-3e-7, 3e-7), gap = random.uniform(0.3, 1.0) / 18e6;
    const double amplitude = std::pow(10.0, random.uniform(-6.0, 6.0) / 20.0);
    auto c = channel_of({start, start + gap}, {phases(random), phases(random, amplitude)}, 0.05, random);
    ResolvedPaths out;
    ASSERT_EQ(resolver.resolve(c.view(), out), ResolveStatus::kOk);
    EXPECT_EQ(out.paths.size(), 2U) << run;
    nees += std::pow((out.toa_s - start) / out.toa_sigma_s, 2) / kRuns;
    polished += std::pow(out.toa_s - start, 2);
    first_peak += std::pow(out.first_peak_s - start, 2);
    EXPECT_NEAR(out.fit, 1.0, 0.2);  // 1600 degrees of freedom: five deviations
    c = channel_of({start}, {phases(random)}, 0.05, random);
    ASSERT_EQ(resolver.resolve(c.view(), out), ResolveStatus::kOk);
    ones += out.paths.size() == 1 ? 1 : 0;
    ratio += std::pow((out.toa_s - start) / out.toa_sigma_s, 2) / kRuns;
    EXPECT_LT(std::abs(out.first_peak_s - start), 6.0 * out.toa_sigma_s + 1e-10);
  }
  EXPECT_GT(nees, 0.6);  // chi-square of 150: 0.59 ... 1.49 at 1e-4
  EXPECT_LT(nees, 1.5);
  EXPECT_GT(ratio, 0.59);
  EXPECT_LT(ratio, 1.49);
  EXPECT_GE(ones, kRuns - 2);
  EXPECT_LT(polished, first_peak / 9.0);
}

TEST(PathResolver, RefusesWhatIsNoChannel) {
  EXPECT_THROW(PathResolver({.max_paths = 0}), std::invalid_argument);
  EXPECT_THROW(PathResolver({.max_paths = 7}), std::invalid_argument);
  EXPECT_THROW(PathResolver({.window_s = 1.0}), std::invalid_argument);
  EXPECT_THROW(PathResolver({.min_separation = 0.0}), std::invalid_argument);
  EXPECT_THROW(PathResolver({.earliest_db = 1.0}), std::invalid_argument);
  EXPECT_THROW(PathResolver({.peak_threshold = 0.0}), std::invalid_argument);
  RandomStream random(3);
  PathResolver resolver;
  ResolvedPaths out;
  auto c = channel_of({0.0}, {phases(random)}, 0.01, random);
  c.values[5] = {std::numeric_limits<float>::quiet_NaN(), 0.0F};
  EXPECT_EQ(resolver.resolve(c.view(), out), ResolveStatus::kNonFinite);
  std::fill(c.values.begin(), c.values.end(), Cf32{});
  EXPECT_EQ(resolver.resolve(c.view(), out), ResolveStatus::kNonFinite);
  random.fill_complex_normal(c.values, 0.01);
  EXPECT_EQ(resolver.resolve(c.view(), out), ResolveStatus::kLost);
  c.frequencies[7] += 1;
  EXPECT_EQ(resolver.resolve(c.view(), out), ResolveStatus::kTooShort);
  EXPECT_TRUE(out.paths.empty());
}

TEST(PathResolver, MusicPeaksWhereThePathsAre) {
  RandomStream random(4);
  const std::vector<double> delays{1e-7, 1.5e-7};
  const auto c = channel_of(delays, {phases(random), phases(random)}, 0.005, random);
  PathResolver resolver;
  ResolvedPaths out;
  ASSERT_EQ(resolver.resolve(c.view(), out), ResolveStatus::kOk);
  const std::array at{1e-7, 1.25e-7, 1.5e-7, 3e-7};
  std::array<double, 4> value{};
  resolver.music(at, 2, value);
  EXPECT_GT(value[0], 10.0 * value[1]);
  EXPECT_GT(value[2], 10.0 * value[1]);
  EXPECT_LT(value[3], value[1]);
}

struct Scene {
  std::vector<CellParameters> cells;
  std::vector<Detection> known;
  std::vector<double> guess, cfo;
};

Scene six_cells(RandomStream& random) {
  Scene s;
  for (int l = 0; l < 6; ++l) {
    CellParameters cell = test::random_cell(random, 50, 2);
    cell.cell_id = 37 * l + 11;
    cell.delay_s = 100e-6 + random.uniform(-1e-6, 0.0);
    cell.power_db = -2.0 * l;
    cell.data_load = 0.0;
    cell.cfo_hz = random.uniform(-100.0, 100.0);
    s.cells.push_back(cell);
    s.known.push_back(truth(cell));
    s.guess.push_back(cell.delay_s + random.uniform(-2e-7, 2e-7) - 3 * kFrameS);
    s.cfo.push_back(cell.cfo_hz);
  }
  return s;
}

TEST(SnapshotRanger, CancellationMakesSixCellsSharper) {
  RandomStream random(5);
  const Scene s = six_cells(random);
  const double rate = 15.36e6;
  const auto iq = synthesize(s.cells, rate, static_cast<std::size_t>(1.2e-3 * rate), noise_variance_for_snr(20.0), 3);
  double with = 0.0, without = 0.0;
  for (const bool cancel : {true, false}) {
    SnapshotRanger ranger(rate, s.known, {.cancel = cancel});
    const auto out = ranger.range(iq, s.guess, s.cfo);
    ASSERT_EQ(out.size(), 6U);
    for (std::size_t l = 0; l < 6; ++l) {
      ASSERT_EQ(out[l].status, ResolveStatus::kOk) << l;
      const double error = out[l].toa_s - (s.cells[l].delay_s - 3 * kFrameS);
      EXPECT_LT(std::abs(error), 5.0 * out[l].sigma_s + 1e-10) << l << ' ' << cancel;
      (cancel ? with : without) += out[l].sigma_s * out[l].sigma_s;
      EXPECT_EQ(out[l].cell_id, s.cells[l].cell_id);
      EXPECT_GT(out[l].undetected_s, 0.0);
    }
  }
  EXPECT_LT(with, 0.2 * without);
}

TEST(SnapshotRanger, RefusesAndReports) {
  RandomStream random(6);
  Scene s = six_cells(random);
  EXPECT_THROW(SnapshotRanger(15.36e6, {}), std::invalid_argument);
  EXPECT_THROW(SnapshotRanger(15e6, s.known), std::invalid_argument);
  EXPECT_THROW(SnapshotRanger(15.36e6, s.known, {.subframes = 11}), std::invalid_argument);
  EXPECT_THROW(SnapshotRanger(15.36e6, s.known, {.passes = 0}), std::invalid_argument);
  EXPECT_THROW(SnapshotRanger(15.36e6, s.known, {.search_window_s = 1.0}), std::invalid_argument);
  SnapshotRanger ranger(15.36e6, s.known);
  std::vector<Cf32> iq(18432);
  for (const auto& r : ranger.range(std::span(iq).first(100), s.guess)) EXPECT_EQ(r.status, ResolveStatus::kTooShort);
  for (const auto& r : ranger.range(iq, std::array{0.0})) EXPECT_EQ(r.status, ResolveStatus::kTooShort);
  random.fill_complex_normal(iq, 1.0);
  int lost = 0;
  for (const auto& r : ranger.range(iq, s.guess)) lost += r.status == ResolveStatus::kLost ? 1 : 0;
  EXPECT_EQ(lost, 6);  // each passes once in 10^6
  for (std::size_t i = 9000; i < 13000; ++i) iq[i] = {std::numeric_limits<float>::infinity(), 0.0F};
  for (const auto& r : ranger.range(iq, s.guess)) EXPECT_EQ(r.status, ResolveStatus::kNonFinite);
  s.guess[2] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(ranger.range(iq, s.guess)[2].status, ResolveStatus::kTooShort);
}

struct Followed {
  int updates = 0, tracking = 0, slips = 0, arcs = 0;
  double phase_std = 0.0, phase_sigma = 0.0, toa_rms_m = 0.0, toa_sigma_m = 0.0, cn0_dbhz = 0.0;
  LoopStatus last = LoopStatus::kPullIn;
};

constexpr double kCarrierHz = 2e9, kLoopRate = 1.92e6;

CellParameters loop_cell(Duplex duplex = Duplex::kFdd) {
  CellParameters cell;
  cell.cell_id = 123;
  cell.n_ports = 2;
  cell.duplex = duplex;
  cell.delay_s = 1.3e-3;
  cell.cfo_hz = 212.3;
  cell.clock_error_ppm = 212.3 / kCarrierHz * 1e6;
  cell.port_gain = {1.0, std::polar(1.0, 2.0), 1.0, 1.0};
  return cell;
}

Followed follow(const CellParameters& cell, double snr_db, double duration_s, std::uint64_t seed) {
  Detection known = truth(cell);
  known.frame_start_s += 1e-7;
  known.cfo_hz -= 30.0;
  CrsLoop loop({.sample_rate_hz = kLoopRate, .carrier_hz = kCarrierHz}, known);
  Synthesizer signal({&cell, 1}, kLoopRate, noise_variance_for_snr(snr_db), seed);
  std::vector<Cf32> block(7777);
  Followed out;
  double sum = 0.0, square = 0.0, toa = 0.0;
  int settled = 0;
  for (double t = 0.0; t < duration_s; t += 7777 / kLoopRate) {
    signal.generate(block);
    for (const LoopUpdate& u : loop.push(block)) {
      ++out.updates;
      out.tracking += u.status == LoopStatus::kTracking ? 1 : 0;
      out.slips += u.slip ? 1 : 0;
      out.last = u.status;
      out.arcs = u.arc;
      if (u.time_s < 0.5) continue;
      ++settled;
      const double phase = u.carrier_phase_cycles + cell.cfo_hz * u.time_s;
      sum += phase;
      square += phase * phase;
      toa +=
          std::pow((u.toa_s - cell.delay_s + (u.time_s - cell.delay_s) * cell.clock_error_ppm * 1e-6) * kLightMps, 2);
      out.phase_sigma += u.phase_sigma_cycles;
      out.toa_sigma_m += u.toa_sigma_s * kLightMps;
      out.cn0_dbhz += u.cn0_dbhz;
    }
  }
  out.phase_std = std::sqrt(std::max(0.0, square / settled - std::pow(sum / settled, 2)));
  out.toa_rms_m = std::sqrt(toa / settled);
  out.phase_sigma /= settled;
  out.toa_sigma_m /= settled;
  out.cn0_dbhz /= settled;
  return out;
}

TEST(CrsLoop, JitterIsThatOfThermalNoise) {
  for (const double snr_db : {-9.0, 0.0, 15.0}) {
    const Followed f = follow(loop_cell(), snr_db, 2.5, 7);
    // 12 elements of 4 symbols on 2 ports in a millisecond; Bn / (C/N0) [rad^2].
    const double cn0 = std::pow(10.0, snr_db / 10.0) * 96e3;
    const double theory = std::sqrt(15.0 / cn0) / kTwoPi;
    EXPECT_EQ(f.slips, 0);
    EXPECT_GT(f.tracking, f.updates - 40);
    EXPECT_NEAR(f.cn0_dbhz, 10.0 * std::log10(cn0), 0.5);
    // 60 independent values in two seconds: within 1 dB and their own 3.9 deviations (0.35).
    EXPECT_NEAR(f.phase_std / theory, 1.05, 0.4) << snr_db;
    EXPECT_NEAR(f.phase_sigma / theory, 1.0, 0.12) << snr_db;
    EXPECT_LT(f.toa_rms_m, 4.0 * f.toa_sigma_m) << snr_db;  // a handful of independent values
    EXPECT_GT(f.toa_rms_m, 0.1 * f.toa_sigma_m) << snr_db;
  }
}

TEST(CrsLoop, FindsTheDownlinkSubframesOfTdd) {
  const CellParameters cell = loop_cell(Duplex::kTdd);
  CrsLoop loop({.sample_rate_hz = kLoopRate, .carrier_hz = kCarrierHz}, truth(cell));
  const auto iq = synthesize({&cell, 1}, kLoopRate, 384000, noise_variance_for_snr(10.0), 3);
  int slips = 0;
  for (const LoopUpdate& u : loop.push(iq)) slips += u.slip ? 1 : 0;
  EXPECT_EQ(loop.subframes(), 0x231U);  // configuration 1: 0, 4, 5, 9
  EXPECT_EQ(slips, 0);
  EXPECT_EQ(loop.last().status, LoopStatus::kTracking);
}

TEST(CrsLoop, LosesCoastsAndFindsAgain) {
  const CellParameters cell = loop_cell();
  CrsLoop loop({.sample_rate_hz = kLoopRate, .carrier_hz = kCarrierHz}, truth(cell));
  auto iq = synthesize({&cell, 1}, kLoopRate, 960000, noise_variance_for_snr(15.0), 4);
  // 10 ms of NaN are coasted over in one arc; 150 ms of silence lose the cell.
  for (std::size_t i = 384000; i < 403200; ++i) iq[i] = {std::numeric_limits<float>::quiet_NaN(), 0.0F};
  for (std::size_t i = 576000; i < 864000; ++i) iq[i] = Cf32{};
  int coasted = 0, lost = 0, arc_before = -1;
  bool finite = true;
  for (const LoopUpdate& u : loop.push(iq)) {
    if (u.time_s > 0.2 && u.time_s < 0.21) coasted += u.status == LoopStatus::kCoasting ? 1 : 0;
    if (u.time_s > 0.29 && u.time_s < 0.3) arc_before = u.arc;
    lost += u.status == LoopStatus::kLost ? 1 : 0;
    finite = finite && std::isfinite(u.toa_s) && std::isfinite(u.carrier_phase_cycles) && std::isfinite(u.cn0_dbhz);
  }
  EXPECT_GE(coasted, 8);
  EXPECT_EQ(arc_before, 0);
  EXPECT_GT(lost, 50);
  EXPECT_TRUE(finite);
  EXPECT_EQ(loop.last().status, LoopStatus::kTracking);
  EXPECT_EQ(loop.last().arc, 1);
  EXPECT_LT(std::abs(loop.last().toa_s - (cell.delay_s - (0.5 - cell.delay_s) * cell.clock_error_ppm * 1e-6)), 1e-8);
}

TEST(CrsLoop, FollowsAFrequencyStepAndCarriesPhaseOverLostSamples) {
  CellParameters cell = loop_cell();
  cell.clock_error_ppm = 0.0;
  cell.cfo_hz = 100.0;
  auto first = synthesize({&cell, 1}, kLoopRate, 1152000, noise_variance_for_snr(20.0), 5);
  // 15 Hz more from 0.15 s on, phase continuous.
  for (std::size_t n = 288000; n < first.size(); ++n) {
    first[n] *= Cf32(std::polar(1.0, kTwoPi * 15.0 * static_cast<double>(n - 288000) / kLoopRate));
  }
  CrsLoop loop({.sample_rate_hz = kLoopRate}, truth(cell));
  static_cast<void>(loop.push(std::span(first).first(960000)));
  EXPECT_NEAR(loop.last().cfo_hz, 115.0, 2.0);
  EXPECT_EQ(loop.last().arc, 0);
  loop.skip(9600);  // 5 ms
  static_cast<void>(loop.push(std::span(first).subspan(969600)));
  EXPECT_EQ(loop.last().arc, 0);
  EXPECT_EQ(loop.last().status, LoopStatus::kTracking);
  EXPECT_NEAR(loop.last().cfo_hz, 115.0, 2.0);
  EXPECT_THROW(CrsLoop({.sample_rate_hz = 2e6}, truth(cell)), std::invalid_argument);
  EXPECT_THROW(CrsLoop({.pll_bandwidth_hz = 0.0}, truth(cell)), std::invalid_argument);
  EXPECT_THROW(CrsLoop({.pll_order = 1}, truth(cell)), std::invalid_argument);
  EXPECT_THROW(CrsLoop({.dll_bandwidth_hz = 99.0}, truth(cell)), std::invalid_argument);
  EXPECT_THROW(CrsLoop({.lost_after_s = 0.0}, truth(cell)), std::invalid_argument);
  EXPECT_THROW(CrsLoop({.carrier_hz = 1.0}, truth(cell)), std::invalid_argument);
}

TEST(MeasurementStream, CellsAppearAndVanishAtAFixedRate) {
  CellParameters there = loop_cell(), other = loop_cell();
  other.cell_id = 301;
  other.delay_s = 4.1e-3;
  other.power_db = -3.0;
  there.data_load = other.data_load = 0.3;
  const double noise = noise_variance_for_snr(15.0);
  auto iq = synthesize({&there, 1}, kLoopRate, 1536000, noise, 6);
  const auto second = synthesize({&other, 1}, kLoopRate, 1536000, 0.0, 6);
  for (std::size_t n = 384000; n < 960000; ++n) iq[n] += second[n];  // 0.2 ... 0.5 s
  MeasurementStream stream({.sample_rate_hz = kLoopRate,
                            .carrier_hz = kCarrierHz,
                            .rate_hz = 20.0,
                            .search_interval_s = 0.1,
                            .max_cfo_hz = 1e3,
                            .drop_after_s = 0.1});
  int epochs = 0, with_other = 0;
  double last_toa = 0.0;
  for (std::size_t at = 0; at < iq.size(); at += 50000) {
    for (const StreamEpoch& e : stream.push(std::span(iq).subspan(at, std::min<std::size_t>(50000, iq.size() - at)))) {
      ++epochs;
      EXPECT_NEAR(e.time_s, epochs / 20.0, 1e-12);
      for (const CellMeasurement& c : e.cells) {
        EXPECT_TRUE(std::isfinite(c.toa_s) && std::isfinite(c.sigma_s) && std::isfinite(c.carrier_phase_cycles));
        if (c.cell_id == 123) last_toa = c.toa_s;
        with_other += c.cell_id == 301 && c.status == LoopStatus::kTracking ? 1 : 0;
      }
      const Observation toa = e.toa();
      EXPECT_LE(toa.size(), static_cast<int>(e.cells.size()));
      EXPECT_EQ(e.carrier_phase().size(), toa.size());
    }
  }
  EXPECT_EQ(epochs, 16);
  EXPECT_GE(with_other, 2);
  EXPECT_LE(with_other, 7);
  EXPECT_EQ(stream.cells(), 1);  // the other has gone
  EXPECT_NEAR(last_toa, there.delay_s - 0.8 * there.clock_error_ppm * 1e-6, 2e-8);
  stream.skip(192000);
  EXPECT_EQ(stream.push(std::span(iq).first(10)).size(), 2U);
  EXPECT_THROW(MeasurementStream({.rate_hz = 0.0}), std::invalid_argument);
  EXPECT_THROW(MeasurementStream({.sample_rate_hz = 2e6}), std::invalid_argument);
  EXPECT_THROW(MeasurementStream({.max_cells = 17}), std::invalid_argument);
}

TEST(PathsNoAlloc, ResolverRangerAndLoop) {
  if (!kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  RandomStream random(8);
  const auto c = channel_of({0.0, 3e-8}, {phases(random), phases(random)}, 0.01, random);
  PathResolver resolver;
  ResolvedPaths out;
  static_cast<void>(resolver.resolve(c.view(), out));
  EXPECT_EQ(allocations_of([&] { static_cast<void>(resolver.resolve(c.view(), out)); }), 0);

  const Scene s = six_cells(random);
  const auto iq = synthesize(s.cells, 15.36e6, 18432, noise_variance_for_snr(20.0), 3);
  SnapshotRanger ranger(15.36e6, s.known);
  static_cast<void>(ranger.range(iq, s.guess, s.cfo));
  EXPECT_EQ(allocations_of([&] { static_cast<void>(ranger.range(iq, s.guess, s.cfo)); }), 0);

  const CellParameters cell = loop_cell();
  const auto signal = synthesize({&cell, 1}, kLoopRate, 76800, noise_variance_for_snr(20.0), 3);
  CrsLoop loop({.sample_rate_hz = kLoopRate}, truth(cell));
  static_cast<void>(loop.push(std::span(signal).first(38400)));
  EXPECT_EQ(allocations_of([&] {
              for (std::size_t at = 38400; at < signal.size(); at += 3840) {
                static_cast<void>(loop.push(std::span(signal).subspan(at, 3840)));
              }
            }),
            0);
}

}  // namespace
}  // namespace soopnav::lte
