#include "soopnav/simulation/planar_trajectory.hpp"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "support/allocation_count.hpp"
#include "support/nan.hpp"

namespace soopnav::simulation {
namespace {

using ::soopnav::test::kNan;
const std::vector<Eigen::Vector2d> kTown{{0, 0}, {100, 0}, {130, 60}, {60, 120}, {60, 200}, {-40, 150}};

struct Pose {
  double heading;
  Eigen::Vector2d v, p;
};

// The planar mechanisation with exact zero-order hold, written out (crosby 2.7 to 2.13).
std::vector<Pose> navigate(const PlanarMotion& start, const std::vector<PlanarImuReading>& imu, double dt) {
  Pose x{start.heading_rad, start.velocity_mps, start.position_m};
  std::vector<Pose> out;
  for (const auto& r : imu) {
    const double c = std::cos(x.heading), s = std::sin(x.heading);
    const Eigen::Vector2d& f = r.sample.specific_force_b_mps2;
    const Eigen::Vector2d a(c * f[0] - s * f[1], s * f[0] + c * f[1]);
    x.p += dt * x.v + 0.5 * dt * dt * a;
    x.v += dt * a;
    x.heading += dt * r.sample.yaw_rate_radps;
    out.push_back(x);
  }
  return out;
}

double worst_position_m(const PlanarTrajectory& truth, PlanarSampling sampling, double rate_hz = 50.0) {
  const auto imu = planar_imu(truth, rate_hz, {}, RandomStream{}, sampling);
  const auto track = navigate(truth.points().front(), imu, 1.0 / rate_hz);
  double worst = 0.0;
  for (std::size_t k = 0; k < imu.size(); ++k) {
    worst = std::max(worst, (track[k].p - truth.at(std::min(imu[k].t_s, truth.duration_s()))->position_m).norm());
  }
  return worst;
}

// Largest differences of a trajectory from its own derivatives, by central differences of `at`.
struct Residual {
  double velocity = 0.0, force = 0.0, rate = 0.0;
};
Residual residual(const PlanarTrajectory& t, double h) {
  Residual out;
  for (double s = 0.5; s < t.duration_s() - 0.5; s += 0.377) {
    const auto a = *t.at(s - h), m = *t.at(s), b = *t.at(s + h);
    const Eigen::Vector2d v = (b.position_m - a.position_m) / (2.0 * h);
    const Eigen::Vector2d acc = (b.velocity_mps - a.velocity_mps) / (2.0 * h);
    const double c = std::cos(m.heading_rad), sn = std::sin(m.heading_rad);
    const Eigen::Vector2d f(c * acc[0] + sn * acc[1], -sn * acc[0] + c * acc[1]);
    out.velocity = std::max(out.velocity, (v - m.velocity_mps).norm());
    out.force = std::max(out.force, (f - m.specific_force_b_mps2).norm());
    out.rate = std::max(out.rate, std::abs((b.heading_rad - a.heading_rad) / (2.0 * h) - m.yaw_rate_radps));
  }
  return out;
}

TEST(PlanarTrajectory, ContinuousTurnIsAsWritten) {
  const auto t = PlanarTrajectory::continuous_turn();
  ASSERT_EQ(t.points().size(), 120001U);
  EXPECT_EQ(t.duration_s(), 120.0);
  const PlanarMotion& start = t.points().front();
  EXPECT_EQ(start.velocity_mps, Eigen::Vector2d::Zero());
  EXPECT_EQ(start.specific_force_b_mps2, Eigen::Vector2d::Zero());
  double way = 0.0;
  for (const auto& m : t.points()) {
    way += m.velocity_mps.norm() * 1e-3;
    const Eigen::Vector2d forward(std::cos(m.heading_rad), std::sin(m.heading_rad));
    EXPECT_NEAR(m.velocity_mps.dot(forward), m.velocity_mps.norm(), 1e-12);
  }
  EXPECT_NEAR(way, 8.0 * 115.0, 0.01);  // half of the ramp is missing
  const auto late = *t.at(50.0);
  EXPECT_NEAR(late.velocity_mps.norm(), 8.0, 1e-12);
  EXPECT_NEAR(late.yaw_rate_radps, 0.035 + 0.1, 1e-12);
  EXPECT_NEAR(late.specific_force_b_mps2[1], 8.0 * 0.135, 1e-12);
  EXPECT_NEAR(late.heading_rad, 0.035 * 50.0 + 0.1 * 40.0 / kTwoPi, 1e-12);
}

TEST(PlanarTrajectory, IsItsOwnDerivative) {
  const auto turn = residual(PlanarTrajectory::continuous_turn(), 1e-2);
  // (h² / 6) of the next derivatives: 8 m/s at 0.135 rad/s.
  EXPECT_LT(turn.velocity, 1e-4);
  EXPECT_LT(turn.force, 1e-4);
  EXPECT_LT(turn.rate, 1e-6);
  const auto drive = residual(PlanarTrajectory::through(kTown), 1e-3);
  EXPECT_LT(drive.velocity, 1e-3);
  EXPECT_LT(drive.force, 0.01);
  EXPECT_LT(drive.rate, 1e-3);
}

TEST(PlanarTrajectory, TenTimesFewerPointsAreTheSameMotion) {
  // Between points the polynomials are the motion, to the seventh power of the step.
  const auto fine = PlanarTrajectory::continuous_turn();
  const auto coarse = PlanarTrajectory::continuous_turn({}, 100.0);
  for (double t = 0.0; t < 120.0; t += 0.7534) {
    EXPECT_LT((fine.at(t)->position_m - coarse.at(t)->position_m).norm(), 1e-9) << t;
    EXPECT_LT((fine.at(t)->velocity_mps - coarse.at(t)->velocity_mps).norm(), 1e-9) << t;
    EXPECT_NEAR(fine.at(t)->heading_rad, coarse.at(t)->heading_rad, 1e-11) << t;
  }
}

TEST(PlanarTrajectory, AtItsPointsIsThosePoints) {
  const auto t = PlanarTrajectory::continuous_turn({.duration_s = 11.0}, 1000.0);
  for (std::size_t k = 0; k < t.points().size(); k += 7) {
    EXPECT_EQ(t.at(t.points()[k].t_s)->position_m, t.points()[k].position_m) << k;
  }
  EXPECT_EQ(t.at(11.0)->position_m, t.points().back().position_m);
  for (const double outside : {-1e-9, 11.0001, kNan}) EXPECT_FALSE(t.at(outside).has_value());
}

TEST(PlanarTrajectory, MeansBringTheInsBack) {
  const auto turn = PlanarTrajectory::continuous_turn();
  EXPECT_LT(worst_position_m(turn, PlanarSampling::kMean), 0.005);
  EXPECT_LT(worst_position_m(PlanarTrajectory::through(kTown), PlanarSampling::kMean), 0.005);
  // Points are worse: a sample of the middle, in the axes there, is taken to be in those of the beginning.
  EXPECT_GT(worst_position_m(turn, PlanarSampling::kLeft), worst_position_m(turn, PlanarSampling::kMean));
  EXPECT_LT(worst_position_m(turn, PlanarSampling::kCentre), 2.0);
  EXPECT_LT(worst_position_m(turn, PlanarSampling::kLeft), 2.0);
}

TEST(PlanarTrajectory, ThroughKeepsItsLimitsAndMeetsItsPoints) {
  for (const DriveLimits& limits :
       {DriveLimits{}, DriveLimits{.speed_mps = 15.0, .acceleration_mps2 = 0.6, .lateral_acceleration_mps2 = 1.0},
        DriveLimits{.speed_mps = 30.0, .acceleration_mps2 = 3.0, .lateral_acceleration_mps2 = 4.0, .smoothing_s = 0}}) {
    const auto t = PlanarTrajectory::through(kTown, limits);
    std::vector<double> nearest(kTown.size(), 1e9);
    double speed = 0.0, along = 0.0, across = 0.0, jump = 0.0;
    for (std::size_t k = 0; k < t.points().size(); ++k) {
      const PlanarMotion& m = t.points()[k];
      for (std::size_t i = 0; i < kTown.size(); ++i) {
        nearest[i] = std::min(nearest[i], (m.position_m - kTown[i]).norm());
      }
      speed = std::max(speed, m.velocity_mps.norm());
      along = std::max(along, std::abs(m.specific_force_b_mps2[0]));
      across = std::max(across, std::abs(m.specific_force_b_mps2[1]));
      if (k > 0) jump = std::max(jump, std::abs(m.heading_rad - t.points()[k - 1].heading_rad));
    }
    for (const double distance : nearest) EXPECT_LT(distance, 0.51 * limits.speed_mps * 1e-3 + 1e-3);
    EXPECT_LE(speed, limits.speed_mps * 1.001);
    EXPECT_GT(speed, 4.0);
    EXPECT_LE(along, limits.acceleration_mps2 * 1.01);
    EXPECT_LE(across, limits.lateral_acceleration_mps2 * 1.01);
    EXPECT_GT(across, limits.lateral_acceleration_mps2 * 0.5);
    EXPECT_LT(jump, 0.1);
    EXPECT_EQ(t.points().front().velocity_mps.norm(), 0.0);
    EXPECT_LT(t.points().back().velocity_mps.norm(), 1e-12);
    EXPECT_LT((t.points().back().position_m - kTown.back()).norm(), 1e-3);
  }
}

TEST(PlanarTrajectory, ThroughTwoPointsIsStraight) {
  const auto t = PlanarTrajectory::through(std::vector<Eigen::Vector2d>{{1, 2}, {1, 52}}, {.speed_mps = 5.0});
  for (const auto& m : t.points()) {
    EXPECT_EQ(m.position_m[0], 1.0);
    EXPECT_NEAR(m.heading_rad, 0.5 * kPi, 1e-12);
    EXPECT_EQ(m.yaw_rate_radps, 0.0);
  }
  // 50 m at 5 m/s, 5 s lost to speeding up and slowing down, a second to smoothing.
  EXPECT_NEAR(t.duration_s(), 16.0, 0.01);
}

TEST(PlanarTrajectory, ProfilesAreIntegratedByTrapezoids) {
  std::vector<double> rate;
  std::vector<Eigen::Vector2d> force;
  for (int k = 0; k < 500; ++k) {
    rate.push_back(0.1 * std::sin(0.01 * k));
    force.emplace_back(k < 200 ? 0.5 : 0.0, 0.02 * std::cos(0.03 * k));
  }
  const PlanarStart start{0.3, {1.0, -1.0}, {10.0, 20.0}};
  const auto t = PlanarTrajectory::from_profiles(rate, force, 100.0, start);
  ASSERT_EQ(t.points().size(), 500U);
  EXPECT_EQ(t.rate_hz(), 100.0);
  double heading = 0.3;
  for (std::size_t k = 1; k < 500; ++k) heading += 0.005 * (rate[k] + rate[k - 1]);
  EXPECT_NEAR(t.points().back().heading_rad, heading, 1e-13);
  Eigen::Vector2d p = start.position_m;
  for (std::size_t k = 1; k < 500; ++k) {
    p += 0.005 * (t.points()[k].velocity_mps + t.points()[k - 1].velocity_mps);
  }
  EXPECT_LT((t.points().back().position_m - p).norm(), 1e-12);
  // A motion's own profiles give it back but for the rule's error, which falls with the square of the step.
  const auto truth = PlanarTrajectory::continuous_turn();
  std::array<double, 2> off{};
  for (std::size_t i = 0; i < 2; ++i) {
    const std::size_t every = i == 0 ? 20 : 10;
    rate.clear();
    force.clear();
    for (std::size_t k = 0; k < truth.points().size(); k += every) {
      rate.push_back(truth.points()[k].yaw_rate_radps);
      force.push_back(truth.points()[k].specific_force_b_mps2);
    }
    const auto back = PlanarTrajectory::from_profiles(rate, force, 1000.0 / static_cast<double>(every));
    off[i] = (back.points().back().position_m - truth.points().back().position_m).norm();
  }
  EXPECT_LT(off[0], 0.01);
  EXPECT_NEAR(off[0] / off[1], 4.0, 0.1);
}

TEST(PlanarImu, NoiseIsThatOfTheErrors) {
  const auto truth = PlanarTrajectory::continuous_turn();
  const auto clean = planar_imu(truth, 50.0, {}, RandomStream(1));
  const auto noisy = planar_imu(truth, 50.0, inertial::ImuErrorModel::crosby(), RandomStream(1));
  ASSERT_EQ(noisy.size(), 6000U);
  EXPECT_EQ(noisy.front().t_s, 0.02);
  EXPECT_EQ(noisy.back().t_s, 120.0);
  Eigen::Array3d square = Eigen::Array3d::Zero();
  for (std::size_t k = 0; k < 6000; ++k) {
    const auto& a = noisy[k].sample;
    const auto& b = clean[k].sample;
    const Eigen::Vector2d df = a.specific_force_b_mps2 - b.specific_force_b_mps2;
    square += Eigen::Array3d(a.yaw_rate_radps - b.yaw_rate_radps, df[0], df[1]).square() / 6000.0;
  }
  // Variances to 1.8 %, five of them.
  for (const double s : square) EXPECT_NEAR(s / 0.01, 1.0, 5.0 * std::sqrt(2.0 / 6000.0));
}

TEST(PlanarTrajectory, RefusesWhatIsNoMotion) {
  const auto message = [](const auto& call) -> std::string {
    try {
      static_cast<void>(call());
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  using T = PlanarTrajectory;
  using Points = std::vector<Eigen::Vector2d>;
  EXPECT_NE(message([] { return T::continuous_turn({.duration_s = 0.0}); }).find("duration_s"), std::string::npos);
  EXPECT_NE(message([] { return T::continuous_turn({.duration_s = 5.0}); }).find("ramp_s = 10"), std::string::npos);
  EXPECT_NE(message([] { return T::continuous_turn({}, -1.0); }).find("rate_hz = -1"), std::string::npos);
  EXPECT_NE(message([] { return T::continuous_turn({.speed_mps = kNan}); }).find("speed_mps"), std::string::npos);
  EXPECT_NE(message([] { return T::through(Points{{0, 0}}); }).find("got 1"), std::string::npos);
  EXPECT_NE(message([] {
              return T::through(Points{{0, 0}, {1, 0}, {1, 0}});
            }).find("waypoints_m[2]"),
            std::string::npos);
  EXPECT_NE(message([] { return T::through(Points{{0, 0}, {kNan, 0}}); }).find("waypoints_m[1]"), std::string::npos);
  EXPECT_NE(message([] { return T::through(kTown, {.acceleration_mps2 = 0.0}); }).find("acceleration_mps2"),
            std::string::npos);
  EXPECT_NE(message([] { return T::through(kTown, {.smoothing_s = -1.0}); }).find("smoothing_s"), std::string::npos);
  const std::vector<double> rate(5, 0.1);
  EXPECT_NE(message([&] {
              return T::from_profiles(rate, Points(4, {0, 0}), 50.0);
            }).find("5 samples"),
            std::string::npos);
  EXPECT_NE(message([&] {
              return T::from_profiles(rate, Points(5, {0, kNan}), 50.0);
            }).find("force_b_mps2[0]"),
            std::string::npos);
  const auto t = T::continuous_turn({.duration_s = 11.0});
  EXPECT_NE(message([&] { return planar_imu(t, 0.05, {}, RandomStream{}); }).find("no whole interval"),
            std::string::npos);
  EXPECT_NE(message([&] { return planar_imu(t, kNan, {}, RandomStream{}); }).find("rate_hz"), std::string::npos);
}

TEST(PlanarTrajectoryNoAlloc, At) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  const auto t = PlanarTrajectory::continuous_turn({.duration_s = 11.0});
  double sum = 0.0;
  EXPECT_EQ(test::allocations_of([&] { sum = t.at(5.55555)->position_m.norm() + (t.at(-1.0) ? 1.0 : 0.0); }), 0);
  EXPECT_GT(sum, 1.0);
}

}  // namespace
}  // namespace soopnav::simulation
