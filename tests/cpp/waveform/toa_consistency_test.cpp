// Times of arrival against the Cramer-Rao bound, which lte_scene.hpp computes apart, and their reported deviations
// against the errors. Fixed seeds; a bound on a mean of squares is the chi-square quantile named beside it.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numeric>
#include <string>
#include <vector>

#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/waveform/lte/time_of_arrival.hpp"
#include "waveform/lte_scene.hpp"

namespace soopnav::lte {
namespace {

using test::delay_crlb_s;
using test::random_cell;
using test::truth;
using test::with_noise;
using test::wrapped_s;

constexpr double kFalseFailure = 5e-5;  // on either side

struct Errors {
  int runs = 0;
  double over_crlb = 0.0;    // mean of (error / bound)^2
  double sigma_ratio = 0.0;  // mean of reported deviation / bound
  double nees = 0.0;         // mean of (error / reported deviation)^2
  double worst_s = 0.0;
};

// `runs` of one subframe that begins within `spread_s` of where it is expected, over a few delays and identities.
Errors subframe_errors(CellParameters cell, double rate_hz, double snr_db, int runs, double spread_s,
                       std::uint64_t seed) {
  constexpr double kExpectedS = 20e-6;
  constexpr int kScenes = 20;
  RandomStream random(seed);
  Errors errors;
  std::vector<Cf32> iq;
  const std::array subframes{0};
  for (int scene = 0; scene < kScenes; ++scene) {
    const CellParameters drawn = random_cell(random, cell.n_rb, cell.n_ports);
    cell.cell_id = drawn.cell_id;
    cell.carrier_phase_rad = drawn.carrier_phase_rad;
    cell.port_gain = drawn.port_gain;
    cell.delay_s = kExpectedS + random.uniform(-spread_s, spread_s);
    cell.cfo_hz = random.uniform(-50.0, 50.0);
    const auto clean = synthesize({&cell, 1}, rate_hz, static_cast<std::size_t>(1.1e-3 * rate_hz));
    const double bound_s = delay_crlb_s(cell, snr_db, subframes);
    SubframeToaEstimator estimator(rate_hz, truth(cell));
    for (int run = 0; run < runs / kScenes; ++run) {
      with_noise(clean, noise_variance_for_snr(snr_db), random, iq);
      const auto toa = estimator.estimate(iq, 0, kExpectedS, 0.0);
      EXPECT_TRUE(toa);
      if (!toa) continue;
      const double error_s = toa->toa_s - cell.delay_s;
      ++errors.runs;
      errors.over_crlb += std::pow(error_s / bound_s, 2);
      errors.sigma_ratio += toa->sigma_s / bound_s;
      errors.nees += std::pow(error_s / toa->sigma_s, 2);
      errors.worst_s = std::max(errors.worst_s, std::abs(error_s));
    }
  }
  errors.over_crlb /= errors.runs;
  errors.sigma_ratio /= errors.runs;
  errors.nees /= errors.runs;
  return errors;
}

double upper(int runs) { return chi_square_upper_quantile(kFalseFailure, runs) / runs; }
double lower(int runs) { return chi_square_quantile(kFalseFailure, runs) / runs; }

class SubframeToaBound : public ::testing::TestWithParam<double> {};

TEST_P(SubframeToaBound, IsMetAtOneHundredResourceBlocks) {
  // 1.12 of the bound is the bar: with 1000 runs an efficient estimator is beyond it once in 10^6.
  const double snr_db = GetParam();
  CellParameters cell;
  cell.n_rb = 100;
  cell.n_ports = 2;
  const Errors errors = subframe_errors(cell, 30.72e6, snr_db, 1000, 1e-6, static_cast<std::uint64_t>(snr_db + 100.0));
  ASSERT_EQ(errors.runs, 1000);
  RecordProperty("rmse_over_crlb", std::to_string(std::sqrt(errors.over_crlb)));
  RecordProperty("sigma_over_crlb", std::to_string(errors.sigma_ratio));
  RecordProperty("nees", std::to_string(errors.nees));
  EXPECT_LE(std::sqrt(errors.over_crlb), 1.12);
  EXPECT_GE(errors.over_crlb, lower(1000));  // and not below it, as a wrong bound would have it
  EXPECT_NEAR(errors.sigma_ratio, 1.0, 0.05);
  EXPECT_GE(errors.nees, lower(1000));
  EXPECT_LE(errors.nees, 1.02 * upper(1000));  // the deviation is itself estimated, from 1600 differences
}

INSTANTIATE_TEST_SUITE_P(All, SubframeToaBound, ::testing::Values(-5.0, 0.0, 10.0, 20.0, 30.0));

TEST(SubframeToaConsistency, OtherKindsOfCell) {
  struct Kind {
    double rate_hz;
    int n_rb, n_ports;
    CyclicPrefix cp;
    Duplex duplex;
  };
  constexpr CyclicPrefix kNormal = CyclicPrefix::kNormal, kExtended = CyclicPrefix::kExtended;
  std::uint64_t seed = 1;
  for (const Kind& kind : {Kind{7.68e6, 25, 1, kNormal, Duplex::kFdd}, Kind{7.68e6, 25, 4, kExtended, Duplex::kFdd},
                           Kind{3.84e6, 15, 2, kExtended, Duplex::kTdd}, Kind{1.92e6, 6, 2, kNormal, Duplex::kTdd},
                           Kind{15.36e6, 75, 4, kNormal, Duplex::kFdd}, Kind{19.2e6, 100, 1, kNormal, Duplex::kTdd}}) {
    SCOPED_TRACE(kind.rate_hz);
    CellParameters cell;
    cell.n_rb = kind.n_rb;
    cell.n_ports = kind.n_ports;
    cell.cp = kind.cp;
    cell.duplex = kind.duplex;
    const Errors errors = subframe_errors(cell, kind.rate_hz, 10.0, 400, 1e-6, ++seed);
    ASSERT_EQ(errors.runs, 400);
    EXPECT_LE(errors.over_crlb, upper(400));
    EXPECT_GE(errors.over_crlb, lower(400));
    EXPECT_NEAR(errors.sigma_ratio, 1.0, 0.08);
  }
}

TEST(SubframeToaConsistency, UnambiguousOverSixKilometres) {
  // Elements every 45 kHz: 22.2 us or 6.66 km; one shift of the comb alone would repeat within 11.1 us. Beyond the
  // cyclic prefix a symbol's neighbours disturb it, so the error is larger than the bound, but of the same peak.
  CellParameters cell;
  cell.n_rb = 100;
  cell.n_ports = 2;
  const Errors errors = subframe_errors(cell, 30.72e6, 10.0, 400, 10e-6, 31);
  ASSERT_EQ(errors.runs, 400);
  EXPECT_LT(errors.worst_s * kSpeedOfLightMps, 3.0);  // the next lobe of the peak is 24 m away
}

// Whole captures.

class ToaFrames : public ::testing::TestWithParam<int> {};

TEST_P(ToaFrames, ErrWithinTheirDeviations) {
  constexpr double kRateHz = 7.68e6;
  RandomStream random(41, static_cast<std::uint64_t>(GetParam()));
  ToaEstimator estimator(kRateHz);
  TimeOfArrival toa;
  std::vector<Cf32> iq;
  double nees = 0.0, mean = 0.0, mean_sigma_s = 0.0, over_crlb = 0.0;
  int frames = 0;
  std::array<int, 10> subframes{};
  std::iota(subframes.begin(), subframes.end(), 0);
  for (int scene = 0; scene < 6; ++scene) {
    CellParameters cell = random_cell(random, 25, GetParam());
    cell.delay_s = random.uniform(0.1e-3, 4e-3);
    cell.cfo_hz = random.uniform(-2e3, 2e3);
    const auto clean = synthesize({&cell, 1}, kRateHz, static_cast<std::size_t>(34.5e-3 * kRateHz));
    const double bound_s = delay_crlb_s(cell, 10.0, subframes, false);
    for (int run = 0; run < 20; ++run) {
      with_noise(clean, noise_variance_for_snr(10.0), random, iq);
      ASSERT_EQ(estimator.estimate(iq, truth(cell), toa), ToaStatus::kOk);
      ASSERT_EQ(toa.toa_s.size(), 3U);
      EXPECT_EQ(toa.paths.size(), 1U);
      for (std::size_t i = 0; i < 3; ++i) {
        const double error_s = wrapped_s(toa.toa_s[i] - cell.delay_s);
        nees += std::pow(error_s / toa.sigma_s[i], 2);
        over_crlb += std::pow(error_s / bound_s, 2);
        mean += error_s / toa.sigma_s[i];
        mean_sigma_s += toa.sigma_s[i] / bound_s;
        ++frames;
      }
    }
  }
  ASSERT_EQ(frames, 360);
  EXPECT_GE(nees / frames, lower(frames));
  EXPECT_LE(nees / frames, upper(frames));
  EXPECT_LE(over_crlb / frames, 1.02 * upper(frames));
  EXPECT_NEAR(mean_sigma_s / frames, 1.0, 0.03);
  EXPECT_LT(std::abs(mean) / std::sqrt(frames), 4.1);  // no bias: standard normal, 4e-5
}

INSTANTIATE_TEST_SUITE_P(Ports, ToaFrames, ::testing::Values(1, 2, 4));

TEST(ToaConsistency, FramesErrIndependently) {
  // What is done to the link's state must not reach the frames' times: their errors' mean is as small as independent
  // ones make it, whether the clock is known well or hardly, in a band where that decides how frames are followed.
  constexpr double kRateHz = 30.72e6;
  constexpr int kRuns = 24;
  RandomStream random(44);
  ToaEstimator estimator(kRateHz);
  TimeOfArrival toa;
  std::vector<Cf32> iq;
  for (const double known_ppm : {0.01, 0.3, 0.0}) {
    double of_mean = 0.0, of_frames = 0.0;
    int frames = 0;
    std::vector<Cf32> clean;
    CellParameters cell;
    for (int run = 0; run < kRuns; ++run) {
      if (run % 8 == 0) {
        cell = random_cell(random, 100);
        cell.delay_s = random.uniform(0.1e-3, 1e-3);
        clean = synthesize({&cell, 1}, kRateHz, static_cast<std::size_t>(61.5e-3 * kRateHz));
      }
      with_noise(clean, noise_variance_for_snr(-8.0), random, iq);
      Detection d = truth(cell);
      d.clock_error_sigma_ppm = known_ppm;
      ASSERT_EQ(estimator.estimate(iq, d, toa), ToaStatus::kOk);
      double sum = 0.0;
      for (std::size_t i = 0; i < toa.toa_s.size(); ++i) {
        const double e = wrapped_s(toa.toa_s[i] - cell.delay_s) / toa.sigma_s[i];
        sum += e;
        of_frames += e * e;
        ++frames;
      }
      of_mean += sum * sum / static_cast<double>(toa.toa_s.size()) / kRuns;
    }
    EXPECT_LE(of_mean, upper(kRuns)) << known_ppm;
    EXPECT_GE(of_mean, lower(kRuns)) << known_ppm;
    EXPECT_LE(of_frames / frames, upper(frames)) << known_ppm;
  }
}

TEST(ToaConsistency, FirstPathsDeviationCoversWhatTheFramesShare) {
  // Three paths a few resolution cells apart: the first one's place is common to the frames.
  constexpr double kRateHz = 7.68e6;
  RandomStream random(42);
  ToaEstimator estimator(kRateHz);
  TimeOfArrival toa;
  std::vector<Cf32> iq;
  double nees = 0.0;
  constexpr int kRuns = 200;
  CellParameters cell = random_cell(random, 25);
  cell.delay_s = 1.3e-3;
  cell.taps = {{0.0, 0.7}, {0.45e-6, std::polar(1.0, 2.0)}, {1.3e-6, std::polar(0.6, -1.0)}};
  const auto clean = synthesize({&cell, 1}, kRateHz, static_cast<std::size_t>(12e-3 * kRateHz));
  for (int run = 0; run < kRuns; ++run) {
    with_noise(clean, noise_variance_for_snr(15.0), random, iq);
    ASSERT_EQ(estimator.estimate(iq, truth(cell), toa), ToaStatus::kOk);
    ASSERT_EQ(toa.paths.size(), 3U);
    nees += std::pow(wrapped_s(toa.toa_s[0] - cell.delay_s) / toa.sigma_s[0], 2) / kRuns;
  }
  EXPECT_LE(nees, upper(kRuns));
  EXPECT_GE(nees, 0.3);  // the sum of a frame's own error and the shared one overlap: cautious, not idle
}

TEST(ToaConsistency, NoPathIsInventedBeforeTheOnlyOne) {
  constexpr double kRateHz = 7.68e6;
  RandomStream random(43);
  ToaEstimator estimator(kRateHz);
  TimeOfArrival toa;
  std::vector<Cf32> iq, clean;
  CellParameters cell;
  int invented = 0;
  double worst = 0.0;
  for (int run = 0; run < 500; ++run) {
    if (run % 50 == 0) {
      cell = random_cell(random, 25);
      cell.delay_s = random.uniform(0.1e-3, 1e-3);
      clean = synthesize({&cell, 1}, kRateHz, static_cast<std::size_t>(11.5e-3 * kRateHz));
    }
    with_noise(clean, noise_variance_for_snr(20.0), random, iq);
    ASSERT_EQ(estimator.estimate(iq, truth(cell), toa), ToaStatus::kOk);
    invented += toa.paths.size() == 1 ? 0 : 1;
    worst = std::max(worst, std::abs(wrapped_s(toa.toa_s[0] - cell.delay_s)) / toa.sigma_s[0]);
  }
  EXPECT_EQ(invented, 0);
  EXPECT_LT(worst, 6.0);
}

}  // namespace
}  // namespace soopnav::lte
