// What a body at rest tells: alignment, zero-velocity detection and updates; and what samples are worth.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <stdexcept>

#include "inertial/manoeuvre.hpp"
#include "measurement/jacobian_battery.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/consistency.hpp"
#include "soopnav/geometry/gravity.hpp"
#include "soopnav/geometry/rotation.hpp"
#include "soopnav/inertial/imu_guard.hpp"
#include "soopnav/inertial/static_alignment.hpp"
#include "soopnav/inertial/zero_velocity.hpp"
#include "support/nan.hpp"

namespace soopnav::inertial {
namespace {

using ::soopnav::test::kNan;

Eigen::Vector3d normals(RandomStream& random, double sigma) {
  return sigma * Eigen::Vector3d(random.normal(), random.normal(), random.normal());
}

struct Rest {
  Eigen::Matrix3d T_n_b = geometry::rotation_from_euler({2.1, 0.3, -0.2});
  Eigen::Vector3d force = -T_n_b.transpose() * geometry::normal_gravity_ned(test::kHome.latitude_rad, 0.0);
  Eigen::Vector3d rate = T_n_b.transpose() * geometry::earth_rate_ned(test::kHome.latitude_rad);
};

TEST(StaticAlignment, PerfectSensorsGiveTheAttitude) {
  const Rest rest;
  const Alignment found = static_alignment(rest.force, rest.rate, 60.0, {test::kHome.latitude_rad, 0.0, 0.0}, {});
  ASSERT_EQ(found.status, AlignmentStatus::kAligned);
  EXPECT_TRUE(found.gyrocompass);
  EXPECT_LT((found.q_n_b.toRotationMatrix() - rest.T_n_b).norm(), 1e-10);
  const Alignment given = static_alignment(rest.force, rest.rate, 60.0, {test::kHome.latitude_rad, 0.0, 0.0},
                                           {.gyro_bias_sigma_radps = 1e-3}, GivenHeading{2.1, 0.01});
  ASSERT_EQ(given.status, AlignmentStatus::kAligned);
  EXPECT_FALSE(given.gyrocompass);
  EXPECT_LT((given.q_n_b.toRotationMatrix() - rest.T_n_b).norm(), 1e-10);
}

// Errors of 400 alignments against the covariance they state, biases and their correlation with the attitude included.
// Quality 1: gyros that find north; 2: a given heading.
void expect_honest(const AlignmentErrors& errors, double heading_sigma, bool gyrocompass) {
  const Rest rest;
  const double duration = 120.0;
  RandomStream random(gyrocompass ? 11 : 12);
  constexpr int kRuns = 400;
  double attitude = 0.0, joint = 0.0;
  for (int run = 0; run < kRuns; ++run) {
    const Eigen::Vector3d b_a = normals(random, errors.accelerometer_bias_sigma_mps2);
    const Eigen::Vector3d b_g = normals(random, errors.gyro_bias_sigma_radps);
    const Eigen::Vector3d force =
        rest.force + b_a + normals(random, errors.accelerometer_density / std::sqrt(duration));
    const Eigen::Vector3d rate = rest.rate + b_g + normals(random, errors.gyro_density / std::sqrt(duration));
    std::optional<GivenHeading> heading;
    if (!gyrocompass) heading = GivenHeading{2.1 + heading_sigma * random.normal(), heading_sigma};
    const Alignment found =
        static_alignment(force, rate, duration, {test::kHome.latitude_rad, 0.0, 0.0}, errors, heading);
    ASSERT_EQ(found.status, AlignmentStatus::kAligned);
    ASSERT_EQ(found.gyrocompass, gyrocompass);
    const Eigen::Vector3d d = geometry::rotation_vector_from_quaternion(found.q_n_b.conjugate() *
                                                                        geometry::quaternion_from_rotation(rest.T_n_b));
    attitude += nees(d, found.covariance).value_or(1e9) / kRuns;
    Eigen::Matrix<double, 9, 1> e;
    e << d, b_g, b_a;
    Eigen::Matrix<double, 9, 9> P = Eigen::Matrix<double, 9, 9>::Zero();
    P.block<3, 3>(0, 0) = found.covariance;
    P.block<3, 3>(0, 3) = found.cross_gyro_bias;
    P.block<3, 3>(3, 0) = found.cross_gyro_bias.transpose();
    P.block<3, 3>(0, 6) = found.cross_accelerometer_bias;
    P.block<3, 3>(6, 0) = found.cross_accelerometer_bias.transpose();
    P.block<3, 3>(3, 3) = std::pow(errors.gyro_bias_sigma_radps, 2) * Eigen::Matrix3d::Identity();
    P.block<3, 3>(6, 6) = std::pow(errors.accelerometer_bias_sigma_mps2, 2) * Eigen::Matrix3d::Identity();
    joint += nees(e, P).value_or(1e9) / kRuns;
  }
  const auto three = mean_nees_bounds(3, kRuns, 1e-5);
  EXPECT_GT(attitude, three.lower);
  EXPECT_LT(attitude, three.upper);
  const auto nine = mean_nees_bounds(9, kRuns, 1e-5);
  EXPECT_GT(joint, nine.lower);
  EXPECT_LT(joint, nine.upper);
}

TEST(StaticAlignment, CovarianceIsThatOfItsErrors) {
  // 0.01 deg/h and 50 ug: north to 0.06 degrees.
  expect_honest({.gyro_bias_sigma_radps = 4.8e-8,
                 .accelerometer_bias_sigma_mps2 = 5e-4,
                 .gyro_density = 2e-7,
                 .accelerometer_density = 2e-3},
                0.0, true);
  expect_honest({.gyro_bias_sigma_radps = 2.4e-5,
                 .accelerometer_bias_sigma_mps2 = 5e-3,
                 .gyro_density = 4e-5,
                 .accelerometer_density = 2e-2},
                0.01, false);
}

TEST(StaticAlignment, SaysWhyNot) {
  const Rest rest;
  const geometry::Geodetic home = test::kHome;
  const AlignmentErrors poor{.gyro_bias_sigma_radps = 2.4e-5};
  EXPECT_EQ(static_alignment(rest.force, rest.rate, 10.0, home, poor).status, AlignmentStatus::kNoHeading);
  EXPECT_EQ(static_alignment(1.2 * rest.force, rest.rate, 10.0, home, {}).status, AlignmentStatus::kNotAtRest);
  const Eigen::Vector3d turning(0.3, 0.1, 0.0);
  EXPECT_EQ(static_alignment(rest.force, turning, 10.0, home, {}).status, AlignmentStatus::kNotAtRest);
  EXPECT_EQ(static_alignment({kNan, 0, 0}, rest.rate, 10.0, home, {}).status, AlignmentStatus::kNonFinite);
  EXPECT_EQ(static_alignment({0, 0, -9.83}, {0, 0, 0}, 10.0, {kPi / 2.0, 0.0, 0.0}, {}).status,
            AlignmentStatus::kNearPole);
  EXPECT_EQ(static_alignment({9.81, 0, 0}, rest.rate, 10.0, home, poor, GivenHeading{0.0, 0.1}).status,
            AlignmentStatus::kNoHeading);  // nose up
  EXPECT_THROW(static_cast<void>(static_alignment(rest.force, rest.rate, 0.0, home, {})), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(static_alignment(rest.force, rest.rate, 1.0, home, {.gyro_density = -1.0})),
               std::invalid_argument);
  EXPECT_EQ(to_string(AlignmentStatus::kNoHeading), "no heading");
}

TEST(ZeroVelocityDetector, TellsRestFromMotion) {
  RandomStream random(5);
  const ZeroVelocityOptions options{
      .window = 40, .accelerometer_sigma_mps2 = 0.02, .gyro_sigma_radps = 0.002, .threshold = 9.0};
  ZeroVelocityDetector detector(options);
  const Rest rest;
  const auto sample = [&](double swing) {
    return ImuIncrement{0.01 * (rest.rate + normals(random, 0.002)),
                        0.01 * (rest.force + normals(random, 0.02) + Eigen::Vector3d(swing, 0, 0)), 0.01};
  };
  for (int k = 0; k < 39; ++k) EXPECT_FALSE(detector.push(sample(0.0)));
  for (int k = 0; k < 200; ++k) EXPECT_TRUE(detector.push(sample(0.0))) << k;
  EXPECT_NEAR(detector.statistic(), 6.0, 3.0);
  EXPECT_LT((detector.mean_rate() - rest.rate).norm(), 0.002);
  int moving = 0;
  for (int k = 0; k < 80; ++k) moving += detector.push(sample(0.5 * std::sin(0.3 * k))) ? 0 : 1;
  EXPECT_GT(moving, 60);
  EXPECT_FALSE(detector.push({{kNan, 0, 0}, {0, 0, 0}, 0.01}));
  EXPECT_FALSE(detector.full());
  EXPECT_THROW(ZeroVelocityDetector({.window = 1}), std::invalid_argument);
  EXPECT_THROW(ZeroVelocityDetector({.threshold = -1.0}), std::invalid_argument);
}

TEST(ZeroVelocity, JacobianEqualsCentralDifferences) {
  RandomStream random(3);
  for (int k = 0; k < 10; ++k) {
    const test::Place<StrapdownState<NedFrame>> place(test::kLocal, random);
    EXPECT_LT(test::worst_jacobian_error(ZeroVelocity{}, place.x, place.scale), 1e-9);
    EXPECT_LT(test::worst_jacobian_error(ZeroAngularRate{normals(random, 1.0)}, place.x, place.scale), 1e-7);
  }
}

TEST(ImuGuard, NamesEverySample) {
  ImuGuard guard({.period_s = 0.01, .gyro_range_radps = 5.0, .accelerometer_range_mps2 = 80.0});
  const Eigen::Vector3d w(0.1, 0.2, 0.3), f(0.0, 0.0, -9.8);
  EXPECT_EQ(guard.judge(1.00, w, f).status, ImuStatus::kFirst);
  const auto ok = guard.judge(1.01, w, f);
  EXPECT_EQ(ok.status, ImuStatus::kOk);
  EXPECT_TRUE(ok.usable());
  EXPECT_NEAR(ok.step_s, 0.01, 1e-12);
  EXPECT_EQ(guard.judge(1.01, w, f).status, ImuStatus::kDuplicate);
  EXPECT_EQ(guard.judge(0.90, w, f).status, ImuStatus::kReversed);
  const auto gap = guard.judge(1.11, w, f);
  EXPECT_EQ(gap.status, ImuStatus::kGap);
  EXPECT_NEAR(gap.missing_s, 0.09, 1e-12);
  EXPECT_NEAR(gap.step_s, 0.01, 1e-12);
  EXPECT_EQ(guard.judge(1.12, Eigen::Vector3d(5.0, 0, 0), f).status, ImuStatus::kSaturated);
  EXPECT_EQ(guard.judge(1.13, w, Eigen::Vector3d(0, -80.0, 0)).status, ImuStatus::kSaturated);
  const auto bad = guard.judge(1.14, Eigen::Vector3d(kNan, 0, 0), f);
  EXPECT_EQ(bad.status, ImuStatus::kNonFinite);
  EXPECT_NEAR(bad.step_s, 0.01, 1e-12);
  EXPECT_FALSE(bad.usable());
  EXPECT_EQ(guard.judge(kNan, w, f).status, ImuStatus::kNonFinite);
  EXPECT_EQ(guard.judge(1.15, w, f).status, ImuStatus::kOk);
  EXPECT_EQ(guard.last_s(), 1.15);
  // A planar unit: one gyro, two accelerometers.
  ImuGuard planar({.period_s = 0.02, .gyro_range_radps = 2.0});
  planar.start(0.0);
  EXPECT_EQ(planar.judge(0.02, Eigen::Matrix<double, 1, 1>(1.0), Eigen::Vector2d(0.0, 1.0)).status, ImuStatus::kOk);
  EXPECT_EQ(planar.judge(0.04, Eigen::Matrix<double, 1, 1>(-2.0), Eigen::Vector2d(0.0, 1.0)).status,
            ImuStatus::kSaturated);
  EXPECT_THROW(ImuGuard({.period_s = 0.0}), std::invalid_argument);
  // A time that nothing missing explains is wrong, and those after it are not.
  EXPECT_EQ(planar.judge(1.7e9, Eigen::Matrix<double, 1, 1>(0.0), Eigen::Vector2d(0.0, 1.0)).status,
            ImuStatus::kFarAhead);
  EXPECT_EQ(planar.judge(0.06, Eigen::Matrix<double, 1, 1>(0.0), Eigen::Vector2d(0.0, 1.0)).status, ImuStatus::kOk);
  // The range itself, as an increment over a rounded time.
  EXPECT_EQ(planar.judge(0.08, Eigen::Matrix<double, 1, 1>(2.0 * (1.0 - 1e-12)), Eigen::Vector2d(0.0, 1.0)).status,
            ImuStatus::kSaturated);
  EXPECT_THROW(ImuGuard({.gap_periods = 1.0}), std::invalid_argument);
  EXPECT_THROW(ImuGuard({.max_gap_s = 0.0}), std::invalid_argument);
  EXPECT_EQ(to_string(ImuStatus::kReversed), "reversed");
  EXPECT_EQ(to_string(static_cast<ImuStatus>(99)), "unknown");
}

}  // namespace
}  // namespace soopnav::inertial
