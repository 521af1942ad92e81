// Process noise ten times too small, too large, and right.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>

#include "estimation/tracking_scene.hpp"
#include "soopnav/estimation/adaptive_noise.hpp"
#include "soopnav/estimation/consistency.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"

namespace soopnav {
namespace {

using test::Fix;
using test::Motion;
using test::Vehicle;

struct Outcome {
  double mean_log = 0.0;       // of the multiplier over its right value, over the runs
  double worst_log = 0.0;      // the run furthest off
  double nis_learnt = 0.0;     // mean NIS with the learnt noise, of two degrees of freedom
  double nis_as_stated = 0.0;  // and with the stated one
};

// 100 runs that learn over 5000 fixes, ten times the memory, and are judged over another 400.
Outcome learn(double factor, std::uint64_t seed) {
  constexpr int kRuns = 100;
  constexpr int kLearning = 5000;
  constexpr int kJudged = 400;
  const Motion right{{1.0, 1.0}};
  const Motion stated{{1.0 / factor, 1.0 / factor}};
  const Eigen::Matrix2d R = 4.0 * Eigen::Matrix2d::Identity();
  Outcome out;
  for (int run = 0; run < kRuns; ++run) {
    RandomStream random(seed, static_cast<std::uint64_t>(run));
    Vehicle truth = test::vehicle(0, 0, 1, 1);
    const Eigen::Matrix4d P0 = Eigen::Matrix4d::Identity();
    ExtendedKalmanFilter<Vehicle> filter(truth.retract(test::normals<4>(random)), P0);
    ExtendedKalmanFilter<Vehicle> fixed = filter;
    AdaptiveProcessNoise noise;
    for (int k = 0; k < kLearning + kJudged; ++k) {
      truth = test::moved(truth, right, 1.0, random);
      const Eigen::Vector2d z = truth.x.head<2>() + 2.0 * test::normals<2>(random);
      EXPECT_EQ(filter.predict(noise.scaled(stated), 1.0), UpdateStatus::kAccepted);
      const auto report = filter.update(Fix{}, z, R);
      if (k < kLearning) {
        EXPECT_TRUE(noise.observe(report, R));
      } else {
        out.nis_learnt += report.nis;
      }
      EXPECT_EQ(fixed.predict(stated, 1.0), UpdateStatus::kAccepted);
      const auto as_stated = fixed.update(Fix{}, z, R);
      if (k >= kLearning) out.nis_as_stated += as_stated.nis;
    }
    const double off = std::log(noise.multiplier() / factor);
    out.mean_log += off;
    out.worst_log = std::max(out.worst_log, std::abs(off));
  }
  out.mean_log /= kRuns;
  out.nis_learnt /= kRuns * kJudged;
  out.nis_as_stated /= kRuns * kJudged;
  testing::Test::RecordProperty("outcome", std::to_string(out.mean_log) + " " + std::to_string(out.worst_log) + " " +
                                               std::to_string(out.nis_learnt) + " " +
                                               std::to_string(out.nis_as_stated));
  return out;
}

TEST(AdaptiveProcessNoise, RecoversNoiseTenTimesTooSmall) {
  const Outcome out = learn(10.0, 211);
  EXPECT_LT(std::abs(out.mean_log), 0.06);
  EXPECT_LT(out.worst_log, 0.6);
  EXPECT_NEAR(out.nis_learnt, 2.0, 0.06);
  EXPECT_GT(out.nis_as_stated, 3.0);
}

TEST(AdaptiveProcessNoise, RecoversNoiseTenTimesTooLarge) {
  const Outcome out = learn(0.1, 223);
  EXPECT_LT(std::abs(out.mean_log), 0.06);
  EXPECT_LT(out.worst_log, 0.6);
  EXPECT_NEAR(out.nis_learnt, 2.0, 0.06);
  EXPECT_LT(out.nis_as_stated, 1.5);
}

TEST(AdaptiveProcessNoise, LeavesRightNoiseAlone) {
  const Outcome out = learn(1.0, 227);
  EXPECT_LT(std::abs(out.mean_log), 0.06);
  EXPECT_LT(out.worst_log, 0.6);
  EXPECT_NEAR(out.nis_learnt, 2.0, 0.06);
}

}  // namespace
}  // namespace soopnav
