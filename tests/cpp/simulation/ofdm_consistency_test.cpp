// Boundaries of simulated epochs: their offsets, their spread, the bound of the delay, and whether sigma is honest.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "soopnav/simulation/ofdm_link.hpp"
#include "soopnav/waveform/ofdm/two_ray.hpp"

namespace soopnav::simulation {
namespace {

const ofdm::Numerology kNumerology{};
const double kSampleM = kNumerology.sample_m();

struct Spread {
  double mean = 0.0, rms = 0.0, worst = 0.0, nis = 0.0;
};

Spread spread(const BoundarySeries& series, const std::vector<double>& delays_m) {
  Spread out;
  const auto count = static_cast<double>(delays_m.size());
  for (std::size_t e = 0; e < delays_m.size(); ++e) {
    const double error = std::remainder(series.range_m[e] - delays_m[e], kNumerology.ambiguity_m());
    out.mean += error / count;
    out.rms += error * error / count;
    out.worst = std::max(out.worst, std::abs(error));
    out.nis += error * error / (series.sigma_m[e] * series.sigma_m[e]) / count;
  }
  out.rms = std::sqrt(out.rms);
  return out;
}

// Evenly over the fractions of a sample, anywhere within the ambiguity.
std::vector<double> delays(std::size_t count) {
  std::vector<double> out(count);
  for (std::size_t e = 0; e < count; ++e) {
    out[e] = std::fmod((static_cast<double>(e) + 0.5) * 1.6180339887 * kSampleM * 7.0, kNumerology.ambiguity_m());
  }
  return out;
}

BoundarySeries measure(const std::vector<double>& at, int oversampling, Movement movement, ofdm::BoundaryMethod method,
                       std::optional<double> snr_db, std::uint64_t seed) {
  OfdmLinkOptions options;
  options.oversampling = oversampling;
  options.movement = movement;
  OfdmLink link(kNumerology, 250, options);
  OfdmLink::Measure how;
  how.method = method;
  how.snr_db = snr_db;
  return link.measure(at, {}, RandomStream(seed), how);
}

TEST(OfdmBoundaryConsistency, NearestSamplesAreUniformAtTheCriticalRate) {
  const auto at = delays(600);
  const auto s = spread(measure(at, 1, Movement::kFractionalDelay, ofdm::BoundaryMethod::kNearestSample, {}, 1), at);
  // Even fractions leave the mean and the spread almost no chance: sample / sqrt(12) = 4.327 m.
  EXPECT_NEAR(s.mean, 0.0, 0.4);
  EXPECT_NEAR(s.rms, kSampleM / std::sqrt(12.0), 0.2);
  EXPECT_LT(s.worst, 0.75 * kSampleM);
  EXPECT_NEAR(s.nis, 1.0, 0.15);
}

TEST(OfdmBoundaryConsistency, TheOffsetOfFineSamplesIsMinusSevenAndFloorTakesAHalf) {
  const auto at = delays(60);
  const auto exact =
      spread(measure(at, 15, Movement::kFractionalDelay, ofdm::BoundaryMethod::kNearestSample, {}, 2), at);
  EXPECT_NEAR(exact.mean, 0.0, 0.25);  // sigma 0.05 m
  EXPECT_GT(exact.rms, 0.28);          // a fine sample / sqrt(12)
  EXPECT_LT(exact.rms, 0.60);          // 0.40 m, sigma 0.04
  const auto paper =
      spread(measure(at, 15, Movement::kInterpolateAndShift, ofdm::BoundaryMethod::kNearestSample, {}, 2), at);
  EXPECT_NEAR(paper.mean, -0.5, 0.25);
  EXPECT_LT(paper.worst, 3.0);
  const ofdm::BoundaryEstimator fine(kNumerology, 250, 15), critical(kNumerology, 250);
  EXPECT_EQ(fine.offset_samples(), -7.0);
  EXPECT_EQ(critical.offset_samples(), 0.0);
}

TEST(OfdmBoundaryConsistency, InterpolatedBoundariesBeatFineSamples) {
  const auto at = delays(1000);
  const auto clean = spread(measure(at, 1, Movement::kFractionalDelay, ofdm::BoundaryMethod::kInterpolated, {}, 3), at);
  EXPECT_LT(clean.rms, 0.40);  // 0.23 m; the tail (3 m at most once in hundreds) carries a third of it
  EXPECT_LT(clean.nis, 0.9);   // sigma errs on the safe side
  EXPECT_NEAR(clean.mean, 0.0, 0.05);
  const auto noisy =
      spread(measure(at, 1, Movement::kFractionalDelay, ofdm::BoundaryMethod::kInterpolated, 0.0, 4), at);
  EXPECT_LT(noisy.rms, 3.0);  // 2.25 m, sigma 0.1
  EXPECT_GT(noisy.nis, 0.5);
  EXPECT_LT(noisy.nis, 2.2);
  EXPECT_GT(noisy.rms, ofdm::delay_crlb_m(0.0, 250));
}

TEST(OfdmBoundaryConsistency, BetweenSamplesTheVarianceComesNearTheBound) {
  // Half-way between samples, where the profile is steepest, 5 dB: efficient within the dependence of the pairs.
  std::vector<double> at(400, 33.5 * kSampleM);
  for (const double snr_db : {0.0, 5.0}) {
    const auto s =
        spread(measure(at, 1, Movement::kFractionalDelay, ofdm::BoundaryMethod::kInterpolated, snr_db, 5), at);
    const double bound = ofdm::delay_crlb_m(snr_db, 250, kNumerology, 0.5);
    EXPECT_GT(s.rms, 0.85 * bound);  // 400 runs: 4 sigma are 14 %
    EXPECT_LT(s.rms, 1.9 * bound);
  }
}

TEST(OfdmBoundaryConsistency, SigmaCoversTheThreshold) {
  const auto at = delays(300);
  for (const auto method : {ofdm::BoundaryMethod::kNearestSample, ofdm::BoundaryMethod::kMaximumLikelihood,
                            ofdm::BoundaryMethod::kInterpolated}) {
    const auto s = spread(measure(at, 1, Movement::kFractionalDelay, method, -15.0, 6), at);
    EXPECT_GT(s.worst, 300.0);  // wrong tops there are
    EXPECT_LT(s.nis, 5.0);      // and sigma knows
  }
}

TEST(OfdmTwoRayConsistency, LineOfSightBesideAStrongerReflection) {
  OfdmLinkOptions options;
  options.movement = Movement::kFractionalDelay;
  OfdmLink link(kNumerology, 250, options);
  const std::size_t runs = 300;
  const auto at = delays(runs);
  RandomStream random(11);
  std::vector<Reflection> reflections(runs);
  for (auto& r : reflections) {
    const double strength = random.uniform(1.0, 1.5);
    r = {random.uniform(199.0, 914.0), std::polar(strength, random.uniform(0.0, 2.0 * std::numbers::pi))};
  }
  OfdmLink::Measure how;
  how.folded = true;
  const auto series = link.measure(at, reflections, random.substream(1), how);
  EXPECT_GT(spread(series, at).rms, 100.0);  // the top is the reflection
  ofdm::TwoRayTiming timing(kNumerology, 250);
  std::vector<double> errors;
  double square = 0.0, nis = 0.0, extra = 0.0, strength = 0.0;
  for (std::size_t e = 0; e < runs; ++e) {
    const auto b = timing.estimate(std::span(series.folded).subspan(80 * e, 80), at[e] + random.normal(), 1.0);
    ASSERT_EQ(b.status, ofdm::BoundaryStatus::kOk);
    EXPECT_TRUE(b.two_rays);
    const double error = b.range_m - at[e];
    errors.push_back(std::abs(error));
    square += error * error / runs;
    nis += error * error / (b.sigma_m * b.sigma_m) / runs;
    extra += std::abs(std::remainder(b.extra_m - reflections[e].extra_m, kNumerology.ambiguity_m())) / runs;
    strength += std::abs(b.strength - std::abs(reflections[e].gain)) / runs;
  }
  std::nth_element(errors.begin(), errors.begin() + runs / 2, errors.end());
  EXPECT_LT(errors[runs / 2], 2.6);   // 2.0 m
  EXPECT_LT(std::sqrt(square), 3.6);  // 2.6 m
  EXPECT_GT(nis, 0.15);
  EXPECT_LT(nis, 2.0);
  EXPECT_LT(extra, 5.0);
  EXPECT_LT(strength, 0.08);
}

TEST(OfdmTwoRayConsistency, OneRayStaysOne) {
  OfdmLinkOptions options;
  options.movement = Movement::kFractionalDelay;
  OfdmLink link(kNumerology, 250, options);
  const auto at = delays(200);
  OfdmLink::Measure how;
  how.folded = true;
  const auto series = link.measure(at, {}, RandomStream(12), how);
  ofdm::TwoRayTiming timing(kNumerology, 250);
  double square = 0.0, nis = 0.0;
  int two = 0;
  for (std::size_t e = 0; e < at.size(); ++e) {
    const auto b = timing.estimate(std::span(series.folded).subspan(80 * e, 80), at[e], 1.0);
    ASSERT_EQ(b.status, ofdm::BoundaryStatus::kOk);
    two += b.two_rays ? 1 : 0;
    square += (b.range_m - at[e]) * (b.range_m - at[e]) / 200.0;
    nis += (b.range_m - at[e]) * (b.range_m - at[e]) / (b.sigma_m * b.sigma_m) / 200.0;
  }
  EXPECT_LT(std::sqrt(square), 1.6);
  EXPECT_LT(two, 80);
  EXPECT_LT(nis, 2.5);
}

}  // namespace
}  // namespace soopnav::simulation
