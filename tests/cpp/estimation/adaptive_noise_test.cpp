#include "soopnav/estimation/adaptive_noise.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "estimation/tracking_scene.hpp"
#include "soopnav/core/joint_process.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/process/random_walk.hpp"

namespace soopnav {
namespace {

using test::Fix;
using test::Motion;
using test::Vehicle;

TEST(ScaledNoise, ScalesGainAndDrawsAlike) {
  const AdaptiveProcessNoise noise({.initial = 9.0});
  const Motion motion{{0.3, 0.7}};
  const auto scaled = noise.scaled(motion);
  Transition<Vehicle, Motion::kNoise> plain(test::vehicle(1, 2, 3, 4)), wide(test::vehicle(1, 2, 3, 4));
  const Eigen::Vector4d w(0.5, -1.0, 2.0, 0.3), tripled = 3.0 * w;
  ASSERT_TRUE(motion.propagate(plain.state, 0.5, tripled, plain));
  ASSERT_TRUE(scaled.propagate(wide.state, 0.5, w, wide));
  EXPECT_LT((wide.state.x - plain.state.x).norm(), 1e-14);
  EXPECT_LT((wide.G - 3.0 * plain.G).norm(), 1e-14);
  EXPECT_EQ(wide.F, plain.F);
  // Beside another part, only its own columns.
  using Whole = ComposedState<PlanarFrame, Role<2, PositionTag>, Role<2, VelocityTag>, Role<1, ClockBiasTag>>;
  const RandomWalk walk{kClockBias, {4.0}};
  const JointProcess behind{walk, scaled};
  const JointProcess before{scaled, walk};
  Transition<Whole, 5> a({}), b({});
  ASSERT_TRUE(behind.propagate(Whole{}, 0.5, ZeroNoise{}, a));
  ASSERT_TRUE(before.propagate(Whole{}, 0.5, ZeroNoise{}, b));
  for (const auto& y : {a, b}) {
    EXPECT_NEAR(y.G.row(4).norm(), std::sqrt(2.0), 1e-14);
    EXPECT_LT((y.G.topRows<4>() * y.G.topRows<4>().transpose() - 9.0 * plain.G * plain.G.transpose()).norm(), 1e-13);
  }
}

TEST(AdaptiveProcessNoise, MovesByTheScoreOfAnInnovation) {
  // Eqs. 30 to 33 of one row: U = (S - R) / S, score U (nis - 1) / 2, information U² / 2.
  AdaptiveProcessNoise noise({.memory = 1e15, .prior_information = 2.0});
  UpdateReport<1> report;
  report.status = UpdateStatus::kAccepted;
  report.innovation[0] = 3.0;
  report.covariance(0, 0) = 4.0;
  EXPECT_TRUE(noise.observe(report, 1.0));
  const double information = 2.0 + 0.5 * 0.75 * 0.75;
  EXPECT_NEAR(std::log(noise.multiplier()), 0.5 * 0.75 * (2.25 - 1.0) / information, 1e-12);
  EXPECT_NEAR(noise.information(), information, 1e-6);
  AdaptiveProcessNoise again(noise.options());
  again.restore(noise.log_multiplier(), noise.information());
  EXPECT_EQ(again.multiplier(), noise.multiplier());
  EXPECT_EQ(again.information(), noise.information());
  // Where R covers the innovation there is nothing to learn.
  const double before = noise.multiplier();
  EXPECT_TRUE(noise.observe(report, 4.0));
  EXPECT_EQ(noise.multiplier(), before);
}

TEST(AdaptiveProcessNoise, RefusesWhatIsNoInnovation) {
  AdaptiveProcessNoise noise;
  UpdateReport<1> report;
  EXPECT_FALSE(noise.observe(report, 1.0));  // undefined
  report.status = UpdateStatus::kAccepted;
  EXPECT_FALSE(noise.observe(report, 1.0));  // not a number
  report.innovation[0] = 1.0;
  report.covariance(0, 0) = 0.0;
  EXPECT_FALSE(noise.observe(report, 1.0));
  report.covariance(0, 0) = 2.0;
  EXPECT_FALSE(noise.observe(report, std::numeric_limits<double>::quiet_NaN()));
  EXPECT_EQ(noise.multiplier(), 1.0);
  EXPECT_TRUE(noise.observe(report, 1.0));
  EXPECT_NE(noise.multiplier(), 1.0);
  // A gated innovation is one too; what it may do is bounded, and so is the multiplier.
  report.status = UpdateStatus::kGated;
  report.innovation[0] = 1e9;
  AdaptiveProcessNoise bounded({.upper = 3.0});
  EXPECT_TRUE(bounded.observe(report, 1.0));
  EXPECT_LT(bounded.multiplier(), 2.1);
  for (int k = 0; k < 5; ++k) EXPECT_TRUE(bounded.observe(report, 1.0));
  EXPECT_NEAR(bounded.multiplier(), 3.0, 1e-12);
}

TEST(AdaptiveProcessNoise, OptionsThatBreakTheirRule) {
  const auto make = [](const AdaptiveNoiseOptions& options) { AdaptiveProcessNoise noise(options); };
  EXPECT_NO_THROW(make({}));
  EXPECT_THROW(make({.lower = 0.0}), std::invalid_argument);
  EXPECT_THROW(make({.lower = 2.0, .upper = 1.0}), std::invalid_argument);
  EXPECT_THROW(make({.initial = 1e9}), std::invalid_argument);
  EXPECT_THROW(make({.memory = 0.5}), std::invalid_argument);
  EXPECT_THROW(make({.prior_information = 0.0}), std::invalid_argument);
  EXPECT_THROW(make({.memory = std::numeric_limits<double>::quiet_NaN()}), std::invalid_argument);
}

}  // namespace
}  // namespace soopnav
