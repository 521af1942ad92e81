#include "soopnav/inertial/imu_errors.hpp"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/random.hpp"
#include "support/allocation_count.hpp"
#include "support/nan.hpp"

namespace soopnav::inertial {
namespace {

using Vector1 = Eigen::Matrix<double, 1, 1>;
using ::soopnav::test::kNan;

// Readings of a sensor at rest.
std::vector<double> at_rest(const SensorErrorModel& model, double dt_s, int n, std::uint64_t seed) {
  SensorErrors<1> sensor(model, RandomStream(seed));
  std::vector<double> out;
  for (int i = 0; i < n; ++i) {
    Vector1 reading(0.0);
    EXPECT_EQ(sensor.apply(reading, dt_s), ReadingStatus::kValid);
    out.push_back(reading[0]);
  }
  return out;
}

// Mean of half the squared difference of neighbouring means over m readings, and how many: the Allan variance without
// overlap.
struct Allan {
  double variance = 0.0;
  int count = 0;
};
Allan allan(const std::vector<double>& y, std::size_t m) {
  Allan out;
  double before = kNan;
  for (std::size_t i = 0; i + m <= y.size(); i += m) {
    double mean = 0.0;
    for (std::size_t j = i; j < i + m; ++j) mean += y[j] / static_cast<double>(m);
    if (i > 0) {
      out.variance += 0.5 * (mean - before) * (mean - before);
      ++out.count;
    }
    before = mean;
  }
  out.variance /= out.count;
  return out;
}

TEST(ImuErrorsConsistency, WhiteNoiseFallsWithTheAveragingTime) {
  // Neighbouring terms are correlated by -1/2: relative variance 3 / count. Five deviations.
  const double dt = 0.02, density = 0.3;
  const auto y = at_rest({.white_density = density}, dt, 40000, 1);
  for (const std::size_t m : {1U, 10U, 100U}) {
    const Allan a = allan(y, m);
    const double model = density * density / (static_cast<double>(m) * dt);
    EXPECT_NEAR(a.variance / model, 1.0, 5.0 * std::sqrt(3.0 / a.count)) << m;
  }
  // A sigma of each sample does not know the step, and both add their squares.
  const auto z = at_rest({.sample_sigma = 0.1, .white_density = density}, dt, 20000, 2);
  EXPECT_NEAR(allan(z, 1).variance / (0.01 + density * density / dt), 1.0, 5.0 * std::sqrt(3.0 / 20000.0));
}

TEST(ImuErrorsConsistency, BiasWalkRisesWithTheAveragingTime) {
  // K² tau / 3, less what the steps leave of it: (2 m² + 1) / (6 m²) K² tau for readings after each step.
  const double dt = 0.1, walk = 0.05;
  const auto y = at_rest({.bias_walk_density = walk}, dt, 60000, 3);
  for (const std::size_t m : {1U, 4U, 32U}) {
    const Allan a = allan(y, m);
    const auto mm = static_cast<double>(m * m);
    const double model = walk * walk * static_cast<double>(m) * dt * (2.0 * mm + 1.0) / (6.0 * mm);
    EXPECT_NEAR(a.variance / model, 1.0, 5.0 * std::sqrt(3.0 / a.count)) << m;
  }
}

TEST(ImuErrorsConsistency, MarkovBiasForgetsItself) {
  const double sigma = 0.2, time = 2.0, dt = 0.5;
  const auto y = at_rest({.markov_sigma = sigma, .markov_time_s = time}, dt, 40000, 4);
  double square = 0.0, product = 0.0;
  for (std::size_t i = 1; i < y.size(); ++i) {
    square += y[i] * y[i];
    product += y[i] * y[i - 1];
  }
  const double keep = std::exp(-dt / time);
  // As many independent squares as (1 - keep²) / (1 + keep²) of them: relative sigma 2.8 %.
  const double n = 40000.0 * (1.0 - keep * keep) / (1.0 + keep * keep);
  EXPECT_NEAR(square / (40000.0 * sigma * sigma), 1.0, 5.0 * std::sqrt(2.0 / n));
  EXPECT_NEAR(product / square, keep, 5.0 * std::sqrt((1.0 - keep * keep) / 40000.0));
  // In its steady state from the start: 2000 first readings, variance to 3.2 % each.
  double first = 0.0;
  for (std::uint64_t seed = 0; seed < 2000; ++seed) {
    const double x = at_rest({.markov_sigma = sigma, .markov_time_s = time}, dt, 1, seed)[0];
    first += x * x / 2000.0;
  }
  EXPECT_NEAR(first / (sigma * sigma), 1.0, 0.16);
}

TEST(ImuErrorsConsistency, DrawnOnceErrorsHaveTheirSigmas) {
  const SensorErrorModel model{.turn_on_sigma = 2.0, .scale_sigma = 1e-2, .misalignment_sigma = 1e-3};
  double bias = 0.0, scale = 0.0, angle = 0.0;
  for (std::uint64_t seed = 0; seed < 1000; ++seed) {
    const SensorErrors<3> sensor(model, RandomStream(seed));
    bias += sensor.bias().squaredNorm() / 3000.0;
    const Eigen::Matrix3d M = sensor.gain() - Eigen::Matrix3d::Identity();
    scale += M.diagonal().squaredNorm() / 3000.0;
    angle += (M.squaredNorm() - M.diagonal().squaredNorm()) / 6000.0;
  }
  EXPECT_NEAR(bias / 4.0, 1.0, 5.0 * std::sqrt(2.0 / 3000.0));
  EXPECT_NEAR(scale / 1e-4, 1.0, 5.0 * std::sqrt(2.0 / 3000.0));
  EXPECT_NEAR(angle / 1e-6, 1.0, 5.0 * std::sqrt(2.0 / 6000.0));
}

TEST(ImuErrors, GainBiasLimitAndStep) {
  SensorErrors<2> sensor({.saturation = 10.0, .quantum = 0.5}, RandomStream{});
  Eigen::Matrix2d gain;
  gain << 1.1, 0.2, 0.0, 1.0;
  sensor.set_gain(gain);
  sensor.set_bias({0.3, -0.2});
  Eigen::Vector2d u(2.0, 1.0);
  EXPECT_EQ(sensor.apply(u, 0.1), ReadingStatus::kValid);
  EXPECT_EQ(u, Eigen::Vector2d(2.5, 1.0));  // 2.7 and 0.8 to halves
  u = {20.0, -30.0};
  EXPECT_EQ(sensor.apply(u, 0.1), ReadingStatus::kSaturated);
  EXPECT_EQ(u, Eigen::Vector2d(10.0, -10.0));
  EXPECT_THROW(sensor.set_bias({kNan, 0.0}), std::invalid_argument);
  EXPECT_THROW(sensor.set_gain(gain * kNan), std::invalid_argument);
}

TEST(ImuErrors, WhatIsNoReadingChangesNothing) {
  const ImuErrorModel model = [] {
    ImuErrorModel m = ImuErrorModel::consumer();
    m.gyro.bias_walk_density = 0.1;
    return m;
  }();
  PlanarImuErrors unit(model, RandomStream(1)), other(model, RandomStream(1));
  PlanarImuSample sample{kNan, {1.0, 2.0}};
  EXPECT_EQ(unit.apply(sample, 0.02), ReadingStatus::kRejected);
  EXPECT_EQ(sample.specific_force_b_mps2, Eigen::Vector2d(1.0, 2.0));
  for (const double dt : {0.0, -1.0, kNan, std::numeric_limits<double>::infinity()}) {
    PlanarImuSample good{0.1, {1.0, 2.0}};
    EXPECT_EQ(unit.apply(good, dt), ReadingStatus::kRejected);
    EXPECT_EQ(good.yaw_rate_radps, 0.1);
  }
  PlanarImuSample a{0.1, {1.0, 2.0}}, b = a;
  EXPECT_EQ(unit.apply(a, 0.02), ReadingStatus::kValid);
  EXPECT_EQ(other.apply(b, 0.02), ReadingStatus::kValid);
  EXPECT_EQ(a.yaw_rate_radps, b.yaw_rate_radps);
  EXPECT_EQ(a.specific_force_b_mps2, b.specific_force_b_mps2);
}

TEST(ImuErrors, OneKindDoesNotShiftAnother) {
  const auto white = at_rest({.sample_sigma = 1.0}, 0.1, 50, 8);
  const auto both = at_rest({.sample_sigma = 1.0, .turn_on_sigma = 3.0}, 0.1, 50, 8);
  for (std::size_t i = 1; i < white.size(); ++i) {
    EXPECT_NEAR(both[i] - white[i], both[0] - white[0], 1e-14);
  }
  EXPECT_NE(both[0], white[0]);
}

TEST(ImuErrors, Presets) {
  EXPECT_EQ(ImuErrorModel::crosby().gyro.sample_sigma, 0.1);
  // 0.15 °/√h is an angle of 0.15° after an hour.
  EXPECT_NEAR(ImuErrorModel::industrial().gyro.white_density * std::sqrt(3600.0), radians(0.15), 1e-15);
  EXPECT_NEAR(ImuErrorModel::tactical().accelerometer.turn_on_sigma, 0.3e-3 * 9.80665, 1e-12);
  EXPECT_NEAR(ImuErrorModel::consumer().gyro.turn_on_sigma * 3600.0, radians(50.0), 1e-12);
}

TEST(ImuErrors, RefusesWhatIsNoModel) {
  const auto message = [](const SensorErrorModel& model) -> std::string {
    try {
      const SensorErrors<1> sensor(model, RandomStream{}, "gyro");
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_EQ(message({}), "");
  EXPECT_NE(message({.sample_sigma = -1.0}).find("gyro.sample_sigma = -1"), std::string::npos);
  EXPECT_NE(message({.white_density = kNan}), "");
  EXPECT_NE(message({.markov_sigma = 1.0}).find("markov_time_s"), std::string::npos);
  EXPECT_NE(message({.saturation = 0.0}).find("saturation"), std::string::npos);
}

TEST(ImuErrorsNoAlloc, Readings) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  PlanarImuErrors planar(ImuErrorModel::crosby(), RandomStream(1));
  SpatialImuErrors spatial(ImuErrorModel::consumer(), RandomStream(1));
  PlanarImuSample sample{0.1, {1.0, 2.0}};
  Eigen::Vector3d w(0.1, 0.2, 0.3), f(0.0, 0.0, 9.8);
  EXPECT_EQ(test::allocations_of([&] {
              EXPECT_EQ(planar.apply(sample, 0.02), ReadingStatus::kValid);
              EXPECT_EQ(spatial.apply(w, f, 0.01), ReadingStatus::kValid);
            }),
            0);
}

}  // namespace
}  // namespace soopnav::inertial
