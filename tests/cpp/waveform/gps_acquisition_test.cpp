#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <complex>
#include <cstddef>
#include <limits>
#include <span>
#include <stdexcept>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/dsp/detection.hpp"
#include "soopnav/waveform/gps/acquisition.hpp"
#include "soopnav/waveform/gps/aided_correlator.hpp"
#include "soopnav/waveform/gps/synthesis.hpp"
#include "support/allocation_count.hpp"
#include "support/nan.hpp"

namespace soopnav::gps {
namespace {

using ::soopnav::test::kNan;
constexpr double kRateHz = 2.048e6;

std::vector<Cf32> samples_of(const SatelliteSignal& signal, std::size_t count, double intermediate_hz,
                             std::uint64_t seed) {
  std::vector<Cf32> out(count);
  SignalGenerator({signal}, kRateHz, intermediate_hz).render(0, out, RandomStream(seed));
  return out;
}

TEST(GpsAcquirer, FindsDelayDopplerAndPower) {
  for (const double doppler_hz : {-4321.0, 0.0, 3300.0}) {
    Acquirer acquirer({.intermediate_hz = 123e3, .coherent_ms = 5, .noncoherent = 10});
    const double delay_s = 777.25 / kRateHz;
    const auto iq = samples_of({.prn = 12, .delay_s = delay_s, .doppler_hz = doppler_hz, .cn0_dbhz = 42.0},
                               acquirer.samples(), 123e3, 3);
    const Acquisition found = acquirer.search(iq, 12);
    ASSERT_EQ(found.status, AcquisitionStatus::kFound);
    EXPECT_NEAR(found.delay_s * kRateHz, 777.25, 0.3);
    EXPECT_NEAR(found.doppler_hz, doppler_hz, 12.0);
    EXPECT_NEAR(found.cn0_dbhz, 41.0, 1.5);
    EXPECT_EQ(acquirer.search(iq, 13).status, AcquisitionStatus::kNotFound);
  }
}

// The statistic does not depend on the samples' scale, and what overflows is not called found.
TEST(GpsAcquirer, AnyAmplitudeGivesOneStatistic) {
  Acquirer acquirer({.coherent_ms = 2, .min_doppler_hz = 0.0, .max_doppler_hz = 500.0});
  std::vector<Cf32> noise(acquirer.samples());
  RandomStream(9).fill_complex_normal(noise);
  const double statistic = acquirer.search(noise, 5).statistic;
  std::vector<Cf32> scaled(noise.size());
  for (const float scale : {1e-12F, 1e13F, 1e14F}) {
    for (std::size_t n = 0; n < noise.size(); ++n) scaled[n] = scale * noise[n];
    const Acquisition found = acquirer.search(scaled, 5);
    EXPECT_EQ(found.status, AcquisitionStatus::kNotFound) << scale;
    EXPECT_NEAR(found.statistic, statistic, 1e-3 * statistic) << scale;
  }
  for (const float scale : {1e16F, 1e22F, 1e37F}) {
    for (std::size_t n = 0; n < noise.size(); ++n) scaled[n] = scale * noise[n];
    EXPECT_EQ(acquirer.search(scaled, 5).status, AcquisitionStatus::kNotFinite) << scale;
  }
  Acquirer silent({.min_doppler_hz = 0.0, .max_doppler_hz = 500.0, .noise_variance = 1e-60});
  const Acquisition found = silent.search(noise, 5);
  EXPECT_EQ(found.status, AcquisitionStatus::kNotFinite);
  EXPECT_TRUE(std::isfinite(found.statistic + found.cn0_dbhz));
}

// Half a second at 5 kHz moves the code by 1.6 chips: only sums that are moved back add up.
TEST(GpsAcquirer, FollowsTheCodeThroughALongSearch) {
  Acquirer acquirer({.coherent_ms = 10, .noncoherent = 50, .min_doppler_hz = 4950.0, .max_doppler_hz = 5050.0});
  const auto iq =
      samples_of({.prn = 3, .delay_s = 1e-4, .doppler_hz = 5000.0, .cn0_dbhz = 30.0}, acquirer.samples(), 0.0, 4);
  const Acquisition found = acquirer.search(iq, 3);
  EXPECT_EQ(found.status, AcquisitionStatus::kFound);
  EXPECT_NEAR(found.delay_s, 1e-4, 0.3 / kRateHz);
  // 50 sums of SNR 10; the code lies between samples half of the time.
  EXPECT_GT(found.statistic, 50.0 + 0.72 * 500.0);
}

TEST(GpsAcquirer, NoiseHasTheGammaLaw) {
  Acquirer acquirer(
      {.coherent_ms = 2, .noncoherent = 3, .min_doppler_hz = 0.0, .max_doppler_hz = 0.0, .noise_variance = 2.0});
  EXPECT_EQ(acquirer.dopplers(), 1U);
  std::vector<Cf32> iq(acquirer.samples());
  double sum = 0.0, squares = 0.0, passed = 0.0, cells = 0.0;
  const double level = dsp::detection_threshold(3, 0.05);
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    RandomStream(seed, 9).fill_complex_normal(iq, 2.0);
    static_cast<void>(acquirer.search(iq, 1));
    for (std::size_t n = 0; n < acquirer.delays(); n += 4) {  // two chips apart: hardly correlated
      const auto t = static_cast<double>(acquirer.surface()[n]);
      sum += t;
      squares += t * t;
      passed += t > level ? 1.0 : 0.0;
      cells += 1.0;
    }
  }
  const double mean = sum / cells;
  EXPECT_NEAR(mean, 3.0, 5.0 * std::sqrt(3.0 / cells));
  EXPECT_NEAR(squares / cells - mean * mean, 3.0, 5.0 * std::sqrt(36.0 / cells));
  EXPECT_NEAR(passed / cells, 0.05, 5.0 * std::sqrt(0.05 * 0.95 / cells));
}

TEST(GpsAcquirer, RefusesAndReports) {
  for (const AcquisitionOptions& bad :
       std::initializer_list<AcquisitionOptions>{{.sample_rate_hz = 1e6},
                                                 {.sample_rate_hz = 2.0485e6},
                                                 {.sample_rate_hz = kNan},
                                                 {.intermediate_hz = 2e6},
                                                 {.coherent_ms = 0},
                                                 {.coherent_ms = 21},
                                                 {.noncoherent = 0},
                                                 {.min_doppler_hz = 10.0, .max_doppler_hz = 0.0},
                                                 {.doppler_step_hz = -1.0},
                                                 {.doppler_step_hz = 1e-3},
                                                 {.false_alarm_probability = 0.0},
                                                 {.noise_variance = kNan}}) {
    EXPECT_THROW(Acquirer{bad}, std::invalid_argument);
  }
  Acquirer acquirer({.min_doppler_hz = 0.0, .max_doppler_hz = 1000.0});
  std::vector<Cf32> iq(acquirer.samples() - 1, Cf32(1.0F, 0.0F));
  EXPECT_EQ(acquirer.search(iq, 1).status, AcquisitionStatus::kTooFewSamples);
  iq.resize(acquirer.samples());
  iq[17] = {std::numeric_limits<float>::quiet_NaN(), 0.0F};
  EXPECT_EQ(acquirer.search(iq, 1).status, AcquisitionStatus::kNotFinite);
  std::fill(iq.begin(), iq.end(), Cf32{});
  EXPECT_EQ(acquirer.search(iq, 1).status, AcquisitionStatus::kNotFinite);
  EXPECT_THROW(static_cast<void>(acquirer.search(iq, 38)), std::invalid_argument);
  EXPECT_DOUBLE_EQ(cell_loss(0.0, 0.0, 1e-3), 1.0);
  EXPECT_DOUBLE_EQ(cell_loss(-0.5, 0.0, 1e-3), 0.25);
  EXPECT_NEAR(cell_loss(0.0, 500.0, 1e-3), 4.0 / (kPi * kPi), 1e-15);
  EXPECT_DOUBLE_EQ(cell_loss(1.5, 0.0, 1e-3), 0.0);
}

// A signal with data, a Doppler that changes, and an intermediate frequency: sums of the right cell are all signal.
TEST(AidedCorrelator, SumsAreCoherentWhereThePredictionIsRight) {
  const std::vector<std::int8_t> bits{1, -1, -1, 1, 1, -1, 1};
  const double doppler_hz = 2345.0, delay_s = 3.1e-3, intermediate_hz = 40e3;
  AidedCorrelator correlator(5, {.intermediate_hz = intermediate_hz, .block_s = 0.02, .max_blocks = 10, .bits = bits});
  std::vector<Cf32> iq(10 * correlator.block_samples());
  SignalGenerator({{.prn = 5, .delay_s = delay_s, .doppler_hz = doppler_hz, .phase_cycles = 0.2, .bits = bits}},
                  kRateHz, intermediate_hz)
      .render(0, iq);
  const double pace = 1.0 + doppler_hz / kCarrierHz;
  for (std::size_t b = 0; b < 10; ++b) {
    const double t = correlator.block_s() * static_cast<double>(b);
    ASSERT_TRUE(correlator.push(
        std::span(iq).subspan(b * correlator.block_samples(), correlator.block_samples()),
        {.transmit_time_s = pace * t - delay_s, .carrier_phase_cycles = -doppler_hz * t, .doppler_hz = doppler_hz}));
  }
  const double amplitude = std::sqrt(std::pow(10.0, 4.5) / kRateHz);
  const double whole = amplitude * static_cast<double>(correlator.block_samples());
  for (std::size_t b = 0; b < 10; ++b) {
    const std::complex<double> sum = correlator.sums()[b * 5 + 2];
    EXPECT_NEAR(std::abs(sum), whole, 2e-3 * whole);
    EXPECT_NEAR(std::arg(sum), 0.2 * kTwoPi, 1e-2);
    EXPECT_NEAR(std::abs(correlator.sums()[b * 5 + 1]), 0.5 * whole, 0.01 * whole);
    EXPECT_NEAR(std::abs(correlator.sums()[b * 5 + 4]), 0.0, 0.03 * whole);
  }
  EXPECT_EQ(correlator.delay_chips(4), 1.0);
  EXPECT_FALSE(correlator.push(std::span(iq).first(correlator.block_samples()), {}));  // full
  correlator.clear();
  iq[5] = {std::numeric_limits<float>::infinity(), 0.0F};
  EXPECT_FALSE(correlator.push(std::span(iq).first(correlator.block_samples()), {}));
  EXPECT_FALSE(correlator.push(std::span(iq).first(17), {}));
  EXPECT_FALSE(correlator.push(std::span(iq).first(correlator.block_samples()), {.doppler_hz = kNan}));
  EXPECT_EQ(correlator.blocks(), 0U);
  EXPECT_THROW(AidedCorrelator(5, {.sample_rate_hz = 1e6}), std::invalid_argument);
  EXPECT_THROW(AidedCorrelator(5, {.block_s = 2.0}), std::invalid_argument);
  EXPECT_THROW(AidedCorrelator(5, {.half_chips = -1}), std::invalid_argument);
  EXPECT_THROW(AidedCorrelator(5, {.bits = {0}}), std::invalid_argument);
  EXPECT_THROW(AidedCorrelator(0, {}), std::invalid_argument);
}

TEST(SearchFrequencies, IsTheSumItSays) {
  constexpr std::size_t kBlocks = 1203, kCodes = 2;
  std::vector<std::complex<double>> y(kBlocks * kCodes);
  RandomStream random(4);
  for (auto& value : y) value = {random.normal(), random.normal()};
  const FrequencyGrid grid{-0.7, 0.35, 5};
  std::vector<double> out(kCodes * grid.count);
  ASSERT_TRUE(search_frequencies(y, kCodes, 0.1, 2.0, grid, 400, out));
  for (std::size_t c = 0; c < kCodes; ++c) {
    for (std::size_t f = 0; f < grid.count; ++f) {
      const double hz = -0.7 + 0.35 * static_cast<double>(f);
      double expected = 0.0;
      for (std::size_t m = 0; m < 3; ++m) {
        std::complex<double> sum{};
        for (std::size_t b = 400 * m; b < 400 * (m + 1); ++b) {
          sum += y[b * kCodes + c] * std::polar(1.0, -kTwoPi * hz * 0.1 * (static_cast<double>(b) + 0.5));
        }
        expected += std::norm(sum) / (2.0 * 400.0);
      }
      EXPECT_NEAR(out[c * grid.count + f], expected, 1e-9 * expected);
    }
  }
  const auto before = out;
  EXPECT_FALSE(search_frequencies(y, kCodes, 0.1, 2.0, grid, 2000, out));
  EXPECT_FALSE(search_frequencies(y, kCodes, 0.1, 0.0, grid, 400, out));
  EXPECT_FALSE(search_frequencies(y, 4, 0.1, 1.0, grid, 400, out));
  y[7] = {kNan, 0.0};
  EXPECT_FALSE(search_frequencies(y, kCodes, 0.1, 2.0, grid, 400, out));
  EXPECT_EQ(out, before);
}

TEST(Detection, KnownValuesAndRanges) {
  EXPECT_DOUBLE_EQ(dsp::marcum_q(1, 0.0, 3.0), std::exp(-4.5));
  EXPECT_DOUBLE_EQ(dsp::marcum_q(4, 7.0, 0.0), 1.0);
  EXPECT_DOUBLE_EQ(dsp::marcum_q(4, 7.0, std::numeric_limits<double>::infinity()), 0.0);
  EXPECT_NEAR(dsp::marcum_q(1, 1.0, 1.0), 0.73287980379682020, 1e-13);  // (1 + exp(-1) I0(1)) / 2
  EXPECT_TRUE(std::isnan(dsp::marcum_q(0, 1.0, 1.0)));
  EXPECT_TRUE(std::isnan(dsp::marcum_q(1, -1.0, 1.0)));
  EXPECT_TRUE(std::isnan(dsp::marcum_q(1, 1.0, kNan)));
  for (const int m : {1, 2, 17, 400}) {
    for (const double p : {1.0, 0.5, 1e-3, 1e-30, 1e-200}) {
      const double t = dsp::detection_threshold(m, p);
      EXPECT_NEAR(dsp::false_alarm_probability(m, t) / p, 1.0, 1e-9) << m << ' ' << p;
    }
  }
  EXPECT_TRUE(std::isnan(dsp::detection_threshold(1, 0.0)));
  EXPECT_NEAR(dsp::cell_false_alarm(0.01, 105.0), 9.5712e-5, 1e-9);
  EXPECT_TRUE(std::isnan(dsp::cell_false_alarm(1.0, 5.0)));
}

TEST(GpsNoAllocation, SearchesAndPushes) {
  if (!::soopnav::test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  Acquirer acquirer({.coherent_ms = 2, .noncoherent = 2, .min_doppler_hz = 1000.0, .max_doppler_hz = 2000.0});
  AidedCorrelator correlator(9, {.block_s = 0.02, .max_blocks = 3});
  std::vector<Cf32> iq(correlator.block_samples());
  RandomStream(1).fill_complex_normal(iq);
  std::array<double, 15> out{};
  bool done = true;
  EXPECT_EQ(::soopnav::test::allocations_of([&] {
              static_cast<void>(acquirer.search(iq, 9));
              for (int i = 0; i < 3; ++i) done = done && correlator.push(iq, {});
              done = done && search_frequencies(correlator.sums(), 5, 0.02, 1.0, {0.0, 0.1, 3}, 3, out);
            }),
            0);
  EXPECT_TRUE(done);
}

}  // namespace
}  // namespace soopnav::gps
