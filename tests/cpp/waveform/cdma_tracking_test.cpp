// CDMA pilots: codes, signals, search. Tracking: loops against theory, observables, losses, bad samples.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/dsp/detection.hpp"
#include "soopnav/waveform/cdma/acquisition.hpp"
#include "soopnav/waveform/cdma/pilot_code.hpp"
#include "soopnav/waveform/cdma/synthesis.hpp"
#include "soopnav/waveform/gps/synthesis.hpp"
#include "soopnav/waveform/tracking/loop.hpp"
#include "soopnav/waveform/tracking/tracker.hpp"
#include "support/allocation_count.hpp"

namespace soopnav {
namespace {

constexpr double kCarrierHz = 1.93125e9;

cdma::PilotSignal pilot(int pn_offset, double delay_s, double doppler_hz, double cn0_dbhz) {
  cdma::PilotSignal s;
  s.pn_offset = pn_offset;
  s.delay_s = delay_s;
  s.doppler_hz = doppler_hz;
  s.cn0_dbhz = cn0_dbhz;
  return s;
}

// The codes once more, the other way: a Galois register clocked by the polynomial, cut where fourteen zeros end.
std::vector<int> galois_code(std::uint32_t polynomial) {
  std::vector<int> maximal;
  std::uint32_t state = 1;
  for (int n = 0; n < 32767; ++n) {
    maximal.push_back(static_cast<int>(state & 1U));
    state = (state & 1U) != 0U ? (state >> 1U) ^ (polynomial >> 1U) : state >> 1U;
  }
  std::size_t run = 0, begin = 0;
  for (std::size_t n = 0; n < 2 * maximal.size(); ++n) {
    run = maximal[n % maximal.size()] == 0 ? run + 1 : 0;
    if (run == 14) begin = n + 1;
  }
  std::vector<int> code;
  for (std::size_t n = 0; n < maximal.size(); ++n) code.push_back(maximal[(begin + n) % maximal.size()]);
  code.push_back(0);
  return code;
}

TEST(PilotCode, IsThePolynomialsSequenceWithAZeroMore) {
  // A right-shifting Galois register of p(x) gives the recurrence of the reciprocal polynomial: bits k are x^(15 - k).
  const auto mirrored = [](std::initializer_list<unsigned> powers) {
    std::uint32_t p = 0;
    for (const unsigned k : powers) p |= 1U << (15 - k);
    return p;
  };
  const std::vector<int> i = galois_code(mirrored({15, 13, 9, 8, 7, 5, 0}));
  const std::vector<int> q = galois_code(mirrored({15, 12, 11, 10, 6, 5, 4, 3, 0}));
  const cdma::ShortCodes& codes = cdma::short_codes();
  int ones_i = 0, ones_q = 0;
  for (std::size_t n = 0; n < cdma::kCodeLength; ++n) {
    ASSERT_EQ(codes.i[n], 1 - 2 * i[n]) << n;
    ASSERT_EQ(codes.q[n], 1 - 2 * q[n]) << n;
    ones_i += i[n];
    ones_q += q[n];
  }
  EXPECT_EQ(ones_i, 16384);
  EXPECT_EQ(ones_q, 16384);
  for (std::size_t n = cdma::kCodeLength - 15; n < cdma::kCodeLength; ++n) {
    EXPECT_EQ(codes.i[n], 1);
    EXPECT_EQ(codes.q[n], 1);
  }
  EXPECT_EQ(codes.i[0], -1);
  EXPECT_EQ(codes.q[0], -1);
}

TEST(PilotCode, OffsetsAndWalshCodes) {
  const std::vector<Cf32> zero = cdma::pilot_code(0);
  for (const int k : {1, 37, 511}) {
    const std::vector<Cf32> code = cdma::pilot_code(k);
    for (std::size_t n = 0; n < cdma::kCodeLength; ++n) {
      ASSERT_EQ(code[(n + 64 * static_cast<std::size_t>(k)) % cdma::kCodeLength], zero[n]);
    }
  }
  EXPECT_NEAR(std::norm(zero[5]), 1.0, 1e-6);
  // Off its peak the complex code correlates to under 2 % (no exact law: the zero put in breaks it).
  for (const std::size_t shift : {1UL, 64UL, 777UL, 16384UL}) {
    std::complex<double> sum{};
    for (std::size_t n = 0; n < zero.size(); ++n) {
      sum += std::complex<double>(zero[n]) * std::conj(std::complex<double>(zero[(n + shift) % zero.size()]));
    }
    EXPECT_LT(std::abs(sum), 0.02 * 32768.0) << shift;
  }
  for (std::size_t a = 0; a < 64; a += 7) {
    for (std::size_t b = 0; b < 64; ++b) {
      int sum = 0;
      for (std::size_t n = 0; n < 64; ++n) sum += cdma::walsh_chip(a, n) * cdma::walsh_chip(b, n);
      ASSERT_EQ(sum, a == b ? 64 : 0);
    }
  }
  for (const int k : {-1, 512}) EXPECT_THROW(static_cast<void>(cdma::pilot_code(k)), std::invalid_argument);
}

// C.S0002: within 1.5 dB to 590 kHz, 40 dB down from 740 kHz on.
TEST(PilotSignal, FilterKeepsTheStandardsMask) {
  const auto response = [](double hz) {
    double sum = 0.0;
    for (std::size_t k = 0; k < 48; ++k) {
      sum += cdma::baseband_filter()[k] * std::cos(kTwoPi * hz / 4.9152e6 * (static_cast<double>(k) - 23.5));
    }
    return 20.0 * std::log10(std::abs(sum));
  };
  double least = 1e9, most = -1e9, beyond = -1e9;
  for (double hz = 0.0; hz <= 590e3; hz += 5e3) {
    least = std::min(least, response(hz));
    most = std::max(most, response(hz));
  }
  for (double hz = 740e3; hz <= 2457.6e3; hz += 5e3) beyond = std::max(beyond, response(hz));
  EXPECT_LT(most - least, 3.0);
  EXPECT_LT(beyond, most - 38.5);
}

TEST(PilotSignal, JoinsWithoutASeamAndHasItsPower) {
  for (const auto shape : {cdma::ChipShape::kRectangular, cdma::ChipShape::kStandard}) {
    cdma::PilotSignal s = pilot(12, 1.234e-3, 321.0, 60.0);
    s.channels = {{5, -3.0}, {32, -6.0}};
    cdma::SynthesisOptions options;
    options.shape = shape;
    const cdma::PilotGenerator generator({s}, options);
    std::vector<Cf32> whole(30'000), parts(30'000);
    generator.render(1000, whole);
    for (std::size_t at = 0; at < parts.size(); at += 7777) {
      generator.render(1000 + at, std::span(parts).subspan(at, std::min<std::size_t>(7777, parts.size() - at)));
    }
    double power = 0.0, difference = 0.0;
    for (std::size_t n = 0; n < whole.size(); ++n) {
      power += static_cast<double>(std::norm(whole[n])) / static_cast<double>(whole.size());
      difference = std::max(difference, static_cast<double>(std::abs(whole[n] - parts[n])));
    }
    const double expected = 1e6 / 2.4576e6 * (1.0 + std::pow(10.0, -0.3) + std::pow(10.0, -0.6));
    EXPECT_NEAR(power / expected, 1.0, 0.05);
    EXPECT_LT(difference, 1e-3 * std::sqrt(expected));
  }
}

TEST(PilotSearch, FindsTwoPilotsAndNothingInNoise) {
  cdma::AcquisitionOptions options;
  options.max_doppler_hz = 300.0;
  options.noncoherent = 2;
  cdma::PilotSearcher searcher(options);
  std::vector<Cf32> received(searcher.samples());
  const cdma::PilotGenerator generator({pilot(40, 11.3e-6, 137.0, 45.0), pilot(300, 21.9e-6, -210.0, 42.0)});
  generator.render(0, received, RandomStream(3));
  std::span<const cdma::Acquisition> found;
  const long allocations = test::allocations_of([&] { found = searcher.search(received); });
  if (test::kAllocationsCounted) {
    EXPECT_EQ(allocations, 0);
  }
  ASSERT_EQ(found.size(), 2U);
  const std::array<double, 2> excess{11.3e-6, 21.9e-6}, doppler{137.0, -210.0}, cn0{45.0, 42.0};
  for (std::size_t k = 0; k < 2; ++k) {
    EXPECT_EQ(found[k].pn_offset, k == 0 ? 40 : 300);
    EXPECT_NEAR(found[k].excess_s, excess[k], 5.0 * found[k].sigma_delay_s);
    EXPECT_NEAR(found[k].delay_s, found[k].pn_offset * cdma::kOffsetS + found[k].excess_s, 1e-12);
    EXPECT_NEAR(found[k].doppler_hz, doppler[k], 5.0 * found[k].sigma_doppler_hz);
    EXPECT_NEAR(found[k].cn0_dbhz, cn0[k], 5.0 * found[k].sigma_cn0_db);
  }
  std::fill(received.begin(), received.end(), Cf32{});
  RandomStream(4).fill_complex_normal(received);
  EXPECT_TRUE(searcher.search(received).empty());  // but once in 1000 seeds
  received[77] = {std::numeric_limits<float>::quiet_NaN(), 0.0F};
  EXPECT_TRUE(searcher.search(received).empty());
  EXPECT_TRUE(searcher.search(IqSpan(received).first(100)).empty());
}

TEST(PilotSearch, ManySumsFindAPilotInLittleMemory) {
  cdma::AcquisitionOptions o;
  o.sample_rate_hz = cdma::kChipRateHz;
  o.coherent_s = 64.5 / cdma::kChipRateHz;
  o.max_doppler_hz = 0.0;
  o.noncoherent = 60;
  cdma::PilotSearcher searcher(o);
  cdma::SynthesisOptions synthesis;
  synthesis.sample_rate_hz = o.sample_rate_hz;
  std::vector<Cf32> received(searcher.samples());
  cdma::PilotGenerator({pilot(100, 20e-6, 0.0, 53.0)}, synthesis).render(0, received, RandomStream(3));
  const auto found = searcher.search(received);
  ASSERT_EQ(found.size(), 1U);
  EXPECT_EQ(found[0].pn_offset, 100);
  EXPECT_GT(found[0].statistic, searcher.threshold());
}

TEST(PilotSearch, NoiseRaisesAlarmsAsOftenAsAsked) {
  cdma::AcquisitionOptions o;
  o.sample_rate_hz = cdma::kChipRateHz;
  o.coherent_s = 1e-3;
  o.max_doppler_hz = 0.0;
  o.noncoherent = 2;
  o.false_alarm_probability = 0.1;
  cdma::PilotSearcher searcher(o);
  std::vector<Cf32> noise(searcher.samples());
  RandomStream random(17);
  constexpr int kSearches = 100;
  int alarms = 0;
  for (int i = 0; i < kSearches; ++i) {
    random.fill_complex_normal(noise);
    alarms += searcher.search(noise).empty() ? 0 : 1;
  }
  // 10 expected, 3 their deviation; a block's own power in the scale takes a tenth of them away.
  EXPECT_GE(alarms, 1);
  EXPECT_LE(alarms, 21);
}

TEST(PilotSearch, ThresholdsAreExact) {
  // Of a Gamma variable by Wilson and Hilferty: its cube root is all but normal for many sums.
  for (const std::size_t k : {1UL, 4UL, 50UL, 1000UL, 10'000UL}) {
    cdma::AcquisitionOptions o;
    o.sample_rate_hz = cdma::kChipRateHz;
    o.coherent_s = 64.5 / cdma::kChipRateHz;
    o.max_doppler_hz = 0.0;
    o.noncoherent = k;
    const cdma::PilotSearcher searcher(o);
    const double p = searcher.cell_false_alarm();
    EXPECT_NEAR(p, -std::expm1(std::log1p(-1e-3) / 32768.0), 1e-20);
    EXPECT_NEAR(dsp::false_alarm_probability(static_cast<int>(k), searcher.threshold()) / p, 1.0, 1e-9);
    if (k == 1) {
      EXPECT_NEAR(searcher.threshold(), -std::log(p), 1e-12);
    }
    constexpr double kNormal = 5.4191;  // passed with 3.05e-8
    const double n = static_cast<double>(k), cube = 1.0 - 1.0 / (9.0 * n) + kNormal / (3.0 * std::sqrt(n));
    if (k >= 1000) {
      EXPECT_NEAR(searcher.threshold() / (n * cube * cube * cube), 1.0, 1e-3);
    }
  }
  std::array<int, 4> out{};
  EXPECT_EQ(cdma::offset_candidates(10.0 * cdma::kOffsetS + 3e-6, 0.0, 0.0, 50e-6, out), 1U);
  EXPECT_EQ(out[0], 10);
  EXPECT_EQ(cdma::offset_candidates(3e-6, 0.0, 60e-6, 50e-6, out), 4U);
}

TEST(Loop, BandwidthIsWhatWasAsked) {
  for (const int order : {1, 2, 3}) {
    for (const double product : {0.01, 0.1, 0.35}) {
      const tracking::Loop loop = tracking::design_loop(order, product / 0.02, 0.02);
      // Simulated: the loop follows nothing but noise of variance 1.
      RandomStream noise(static_cast<std::uint64_t>(order));
      double phase = 0.0, rate = 0.0, ramp = 0.0, sum = 0.0;
      constexpr int kSteps = 400'000;
      for (int k = 0; k < kSteps; ++k) {
        const double y = noise.normal() - (phase + 0.5 * rate + ramp / 6.0);
        phase += rate + 0.5 * ramp + loop.gain[0] * y;
        rate += ramp + loop.gain[1] * y;
        ramp += loop.gain[2] * y;
        sum += phase * phase / kSteps;
      }
      // Samples are correlated over 1 / (2 B): 5 sigma of what is left.
      EXPECT_NEAR(sum / (2.0 * product), 1.0, 5.0 * std::sqrt(2.0 / (kSteps * product))) << order << ' ' << product;
      EXPECT_NEAR(tracking::noise_variance(loop, 1.0).phase, 2.0 * product, 1e-9);
    }
  }
  // A slow second-order loop under a walk of phase: q / (4 zeta w), w = B / 0.53.
  const tracking::Loop slow = tracking::design_loop(2, 1.0, 1e-4);
  EXPECT_NEAR(tracking::oscillator_variance(slow, {1.0, 0.0}).phase, 0.5303 / (4.0 * std::sqrt(0.5)), 1e-3);
  EXPECT_TRUE(std::isinf(tracking::oscillator_variance(tracking::design_loop(1, 1.0, 0.01), {0.0, 1.0}).phase));
  for (const auto& [order, product] : {std::pair{0, 0.1}, {4, 0.1}, {1, 0.5}, {2, 1.0}, {3, 2.0}, {2, -1.0}}) {
    EXPECT_THROW(static_cast<void>(tracking::design_loop(order, product, 1.0)), std::invalid_argument);
  }
}

constexpr double kRate = 1.5e6;

std::vector<Cf32> pilot_samples(double seconds, double cn0_dbhz, double doppler_hz = 80.0, std::uint64_t seed = 5) {
  cdma::SynthesisOptions options;
  options.sample_rate_hz = kRate;
  std::vector<Cf32> out(static_cast<std::size_t>(seconds * kRate));
  cdma::PilotGenerator({pilot(3, 2.1e-3, doppler_hz, cn0_dbhz)}, options).render(0, out, RandomStream(seed));
  return out;
}

tracking::TrackerOptions pilot_options(double doppler_hz = 80.0) {
  tracking::TrackerOptions o;
  o.sample_rate_hz = kRate;
  o.delay_s = 2.1e-3;
  o.doppler_hz = doppler_hz;
  o.pull_in_s = 0.3;
  return o;
}

std::vector<tracking::Epoch> tracked(const tracking::Signal& signal, const tracking::TrackerOptions& o,
                                     IqSpan samples) {
  tracking::Tracker tracker(signal, o);
  std::vector<tracking::Epoch> out;
  tracker.push(samples, [&](const tracking::Epoch& e) { out.push_back(e); });
  return out;
}

TEST(Tracker, PilotObservablesFollowTheTruth) {
  const std::vector<Cf32> samples = pilot_samples(2.0, 45.0);
  tracking::TrackerOptions o = pilot_options(92.0);  // 12 Hz and a tenth of a chip off
  o.delay_s += 0.1 / cdma::kChipRateHz;
  for (const int order : {2, 3}) {
    o.pll_order = order;
    const auto epochs = tracked(tracking::Signal::cdma_pilot(kCarrierHz, 3), o, samples);
    ASSERT_EQ(epochs.size(), 20U);
    const auto& reference = epochs[10];
    for (std::size_t k = 10; k < 20; ++k) {
      const auto& e = epochs[k];
      ASSERT_TRUE(e.phase_locked && e.code_locked) << k;
      EXPECT_EQ(e.state, tracking::TrackerState::kTracking);
      EXPECT_EQ(e.arc, 0U);
      EXPECT_NEAR(e.t_s, 0.1 * static_cast<double>(k) + 0.05, 1e-6);
      const double truth = -80.0 * (e.t_s - reference.t_s);  // an approaching source: phase falls
      EXPECT_NEAR(e.carrier_phase_cycles - reference.carrier_phase_cycles, truth, 8.0 * e.carrier_phase_sigma_cycles);
      EXPECT_NEAR(e.delay_s, 2.1e-3 - 80.0 / kCarrierHz * e.t_s, 6.0 * e.delay_sigma_s + 5e-9);
      EXPECT_NEAR(e.doppler_hz, 80.0, 6.0 * e.doppler_sigma_hz);
      EXPECT_NEAR(e.cn0_hz, std::pow(10.0, 4.5), 6.0 * e.cn0_sigma_hz);
      EXPECT_GT(e.phase_lock, 0.9);
    }
  }
}

TEST(Tracker, GpsFindsItsBits) {
  gps::SatelliteSignal s;
  s.prn = 9;
  s.delay_s = 7.3e-3;
  s.doppler_hz = -1500.0;
  s.cn0_dbhz = 45.0;
  s.bits = {1, -1, -1, 1, -1, 1, 1, 1, -1, 1, -1};
  std::vector<Cf32> samples(static_cast<std::size_t>(2.52 * kRate));
  gps::SignalGenerator({s}, kRate, 1e5).render(0, samples, RandomStream(8));
  tracking::TrackerOptions o;
  o.sample_rate_hz = kRate;
  o.intermediate_hz = 1e5;
  o.delay_s = 0.3e-3;  // only modulo a code period
  o.doppler_hz = -1480.0;
  const auto epochs = tracked(tracking::Signal::gps_l1(9), o, samples);
  ASSERT_EQ(epochs.size(), 25U);
  for (std::size_t k = 17; k < 25; ++k) {
    const auto& e = epochs[k];
    ASSERT_TRUE(e.phase_locked && e.code_locked) << k;
    EXPECT_NEAR(e.carrier_phase_cycles - epochs[17].carrier_phase_cycles, 1500.0 * (e.t_s - epochs[17].t_s),
                8.0 * e.carrier_phase_sigma_cycles);
    EXPECT_NEAR(e.delay_s, 0.3e-3 + 1500.0 / gps::kCarrierHz * e.t_s, 6.0 * e.delay_sigma_s + 5e-9);
    EXPECT_NEAR(e.cn0_hz, std::pow(10.0, 4.5), 6.0 * e.cn0_sigma_hz);  // fails where bits' edges lie inside
  }
}

TEST(Tracker, BlocksOfAnySizesGiveTheSameBits) {
  const std::vector<Cf32> samples = pilot_samples(0.8, 40.0);
  const tracking::Signal signal = tracking::Signal::cdma_pilot(kCarrierHz, 3);
  const auto whole = tracked(signal, pilot_options(), samples);
  for (const std::size_t block : {1UL, 511UL, 4096UL, 100'003UL}) {
    tracking::Tracker tracker(signal, pilot_options());
    std::vector<tracking::Epoch> parts;
    for (std::size_t at = 0; at < samples.size(); at += block) {
      tracker.push(IqSpan(samples).subspan(at, std::min(block, samples.size() - at)),
                   [&](const tracking::Epoch& e) { parts.push_back(e); });
    }
    ASSERT_EQ(parts.size(), whole.size());
    for (std::size_t k = 0; k < whole.size(); ++k) {
      ASSERT_EQ(parts[k].carrier_phase_cycles, whole[k].carrier_phase_cycles) << block;
      ASSERT_EQ(parts[k].delay_s, whole[k].delay_s);
      ASSERT_EQ(parts[k].cn0_hz, whole[k].cn0_hz);
    }
  }
}

TEST(Tracker, LossJumpAndBadSamplesAreReported) {
  std::vector<Cf32> samples = pilot_samples(6.0, 45.0);
  // Two seconds without the signal, then it is back; later a clock jumps by 0.4 cycles; a burst of rubbish.
  RandomStream noise(21);
  const auto at = [](double t) { return static_cast<std::size_t>(t * kRate); };
  noise.fill_complex_normal(std::span(samples).subspan(at(1.5), at(3.0) - at(1.5)));
  const Cf32 turn(std::polar(1.0, kTwoPi * 0.4));
  for (std::size_t n = at(4.55); n < samples.size(); ++n) samples[n] *= turn;
  for (std::size_t n = at(5.41); n < at(5.41) + 300; ++n) {
    samples[n] = {std::numeric_limits<float>::quiet_NaN(), n % 2 == 0 ? 3e38F : std::numeric_limits<float>::infinity()};
  }
  const auto epochs = tracked(tracking::Signal::cdma_pilot(kCarrierHz, 3), pilot_options(), samples);
  ASSERT_EQ(epochs.size(), 60U);
  for (const auto& e : epochs) {
    EXPECT_TRUE(
        std::isfinite(e.carrier_phase_cycles + e.delay_s + e.doppler_hz + e.cn0_hz + e.carrier_phase_sigma_cycles));
  }
  EXPECT_TRUE(epochs[13].phase_locked);
  EXPECT_EQ(epochs[13].arc, 0U);
  for (std::size_t k = 26; k < 30; ++k) EXPECT_FALSE(epochs[k].phase_locked || epochs[k].code_locked) << k;
  EXPECT_NE(epochs[28].state, tracking::TrackerState::kTracking);
  EXPECT_TRUE(epochs[43].phase_locked && epochs[43].code_locked);
  EXPECT_GT(epochs[43].arc, 0U);
  EXPECT_FALSE(epochs[45].phase_locked);          // the jump
  EXPECT_EQ(epochs[53].arc, epochs[43].arc + 1);  // a new ambiguity
  EXPECT_TRUE(epochs[53].phase_locked);
  EXPECT_EQ(epochs[54].bad_samples, 300U);
  EXPECT_TRUE(epochs[56].phase_locked);
  EXPECT_NEAR(epochs[56].carrier_phase_cycles - epochs[53].carrier_phase_cycles, -80.0 * 0.3, 0.02);
}

TEST(Tracker, NothingButNoiseNeverLocks) {
  std::vector<Cf32> samples(static_cast<std::size_t>(5.0 * kRate));
  RandomStream(31).fill_complex_normal(samples);
  int locked = 0;
  for (const auto& e : tracked(tracking::Signal::cdma_pilot(kCarrierHz, 3), pilot_options(), samples)) {
    locked += e.phase_locked ? 1 : 0;
    EXPECT_LT(std::abs(e.doppler_hz - 80.0), 500.0);
  }
  EXPECT_EQ(locked, 0);
  std::fill(samples.begin(), samples.end(), Cf32{});
  for (const auto& e : tracked(
           tracking::Signal::gps_l1(3),
           [] {
             tracking::TrackerOptions o;
             o.sample_rate_hz = kRate;
             return o;
           }(),
           samples)) {
    EXPECT_FALSE(e.phase_locked || e.code_locked);
    EXPECT_TRUE(std::isfinite(e.carrier_phase_cycles + e.delay_s + e.cn0_hz));
  }
}

TEST(Tracker, NoHeapWhileItRuns) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  const std::vector<Cf32> samples = pilot_samples(0.5, 45.0);
  tracking::Tracker tracker(tracking::Signal::cdma_pilot(kCarrierHz, 3), pilot_options());
  std::size_t count = 0;
  EXPECT_EQ(test::allocations_of([&] { tracker.push(samples, [&](const tracking::Epoch&) { ++count; }); }), 0);
  EXPECT_EQ(count, 5U);
}

// No loop pulls the code beyond its table, whatever it follows.
TEST(Tracker, RatesKeepWithinTheCodesTable) {
  tracking::Signal signal = tracking::Signal::gps_l1(3);
  signal.carrier_hz = 1e7;
  tracking::TrackerOptions o;
  o.sample_rate_hz = gps::kChipRateHz;
  o.doppler_hz = 8.99e4;
  o.epoch_s = 0.04;
  o.pull_in_bandwidth_hz = 200.0;
  std::vector<Cf32> samples(static_cast<std::size_t>(0.5 * o.sample_rate_hz));
  for (std::size_t n = 0; n < samples.size(); ++n) {  // the code at a Doppler ever further away
    const double t = static_cast<double>(n) / o.sample_rate_hz;
    const double cycles = 8.99e4 * t + 1e3 * t * t;
    const auto chip = static_cast<std::size_t>(t * gps::kChipRateHz * 1.009) % signal.chips.size();
    samples[n] = signal.chips[chip] * Cf32(std::polar(1.0, kTwoPi * (cycles - std::floor(cycles))));
  }
  const auto epochs = tracked(signal, o, samples);
  ASSERT_GT(epochs.size(), 5U);
  double highest = 0.0;
  for (const auto& e : epochs) highest = std::max(highest, e.doppler_hz);
  EXPECT_LE(highest, 9e4 * (1.0 + 1e-9));
  EXPECT_GT(highest, 8.995e4);
}

TEST(Tracker, RefusesWhatItCannotDo) {
  const tracking::Signal signal = tracking::Signal::gps_l1(1);
  tracking::TrackerOptions good;
  good.sample_rate_hz = kRate;
  EXPECT_NO_THROW(tracking::Tracker(signal, good));
  using Change = std::function<void(tracking::Signal&, tracking::TrackerOptions&)>;
  const std::vector<std::pair<std::string, Change>> cases{
      {"sample_rate_hz", [](auto&, auto& o) { o.sample_rate_hz = 1e6; }},
      {"intermediate_hz", [](auto&, auto& o) { o.intermediate_hz = 1e6; }},
      {"delay_s", [](auto&, auto& o) { o.delay_s = std::nan(""); }},
      {"integration_s", [](auto&, auto& o) { o.integration_s = 15e-3; }},
      {"pll_order", [](auto&, auto& o) { o.pll_order = 4; }},
      {"pll_bandwidth_hz", [](auto&, auto& o) { o.pll_bandwidth_hz = 100.0; }},
      {"dll_bandwidth_hz", [](auto&, auto& o) { o.dll_bandwidth_hz = 0.0; }},
      {"pull_in_bandwidth_hz", [](auto&, auto& o) { o.pull_in_bandwidth_hz = 1e4; }},
      {"doppler_hz", [](auto& s, auto& o) { s.carrier_hz = 1e7, o.doppler_hz = 1e6; }},
      {"signal.carrier_hz", [](auto& s, auto&) { s.carrier_hz = 1e5; }},
      {"early_late_chips", [](auto&, auto& o) { o.early_late_chips = 0.0; }},
      {"epoch_s", [](auto&, auto& o) { o.epoch_s = 0.03; }},
      {"pull_in_s", [](auto&, auto& o) { o.pull_in_s = 0.0; }},
      {"fll_bandwidth_hz", [](auto&, auto& o) { o.fll_bandwidth_hz = 1e3; }},
      {"signal.chips", [](auto& s, auto&) { s.chips.clear(); }},
      {"signal.symbol_s", [](auto& s, auto&) { s.symbol_s = 1.5e-3; }},
  };
  for (const auto& [name, change] : cases) {
    tracking::Signal s = signal;
    tracking::TrackerOptions o = good;
    change(s, o);
    try {
      const tracking::Tracker tracker(s, o);
      ADD_FAILURE() << name;
    } catch (const std::invalid_argument& error) {
      EXPECT_EQ(std::string(error.what()).find(name + " = "), 0U) << error.what();
    }
  }
}

}  // namespace
}  // namespace soopnav
