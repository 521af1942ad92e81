// Every Gaussian filter and the smoother behind it: the same answer where the models are linear, consistent where they
// are not.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "estimation/tracking_scene.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/consistency.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/information_filter.hpp"
#include "soopnav/estimation/iterated_kalman_filter.hpp"
#include "soopnav/estimation/rts_smoother.hpp"
#include "soopnav/estimation/square_root_kalman_filter.hpp"
#include "soopnav/estimation/unscented_kalman_filter.hpp"

namespace soopnav {
namespace {

using test::Fix;
using test::Motion;
using test::PlanarRange;
using test::Vehicle;

const Motion kMotion{{0.4, 0.2}};
const Eigen::Matrix4d kP0 = Eigen::Vector4d(25, 25, 4, 4).asDiagonal();

// Filters and smooths `steps` steps; `observe(filter, k)` updates at step k.
template <class Filter, class Observe>
RtsSmoother<Vehicle> smoothed(Filter filter, int steps, const Observe& observe) {
  RtsSmoother<Vehicle> smoother(steps);
  for (int k = 0; k < steps; ++k) {
    StepRecord<Vehicle> record;
    EXPECT_EQ(filter.predict(kMotion, 0.7, &record.cross), UpdateStatus::kAccepted);
    record.predicted = filter.state();
    record.P_pred = filter.covariance();
    observe(filter, k);
    record.filtered = filter.state();
    record.P = filter.covariance();
    EXPECT_EQ(smoother.record(record), SmoothStatus::kDone);
  }
  EXPECT_EQ(smoother.smooth(), SmoothStatus::kDone);
  return smoother;
}

template <class Filter>
class GaussianFilters : public testing::Test {};
using Filters =
    testing::Types<ExtendedKalmanFilter<Vehicle>, IteratedKalmanFilter<Vehicle>, UnscentedKalmanFilter<Vehicle>,
                   SquareRootKalmanFilter<Vehicle>, InformationFilter<Vehicle>>;
TYPED_TEST_SUITE(GaussianFilters, Filters);

TYPED_TEST(GaussianFilters, AgreeOnALinearModel) {
  constexpr int kSteps = 60;
  const Vehicle x0 = test::vehicle(100, -50, 3, 4);
  const auto observe = [](auto& filter, int k) {
    if (k % 4 == 3) return;
    const Eigen::Vector2d z(100 + 2 * k + std::sin(k), -50 + 3 * k + std::cos(3 * k));
    Eigen::Matrix2d R;
    R << 2.0, 0.7, 0.7, 1.0;
    EXPECT_TRUE(filter.update(Fix{}, z, R).accepted());
  };
  const auto got = smoothed(TypeParam(x0, kP0), kSteps, observe);
  const auto want = smoothed(ExtendedKalmanFilter<Vehicle>(x0, kP0), kSteps, observe);
  for (std::size_t k = 0; k < kSteps; ++k) {
    const auto& a = got.records()[k];
    const auto& b = want.records()[k];
    EXPECT_LT((a.filtered.x - b.filtered.x).norm(), 1e-9);
    EXPECT_LT((a.P - b.P).norm(), 1e-9);
    EXPECT_LT((a.cross - b.cross).norm(), 1e-9);
    EXPECT_LT((got.smoothed()[k].state.x - want.smoothed()[k].state.x).norm(), 1e-9);
    EXPECT_LT((got.smoothed()[k].P - want.smoothed()[k].P).norm(), 1e-9);
  }
  EXPECT_LT(want.smoothed()[30].P.trace(), 0.8 * want.records()[30].P.trace());  // the smoother did something
}

// Those that linearise once agree on any model.
template <class Filter>
class SingleLinearisation : public testing::Test {};
using OnceLinearised = testing::Types<SquareRootKalmanFilter<Vehicle>, InformationFilter<Vehicle>>;
TYPED_TEST_SUITE(SingleLinearisation, OnceLinearised);

TYPED_TEST(SingleLinearisation, AgreesOnRangesAndGroups) {
  const Vehicle x0 = test::vehicle(10, -5, 1, 2);
  ExtendedKalmanFilter<Vehicle> want(x0, kP0);
  TypeParam got(x0, kP0);
  const std::array<PlanarRange, 2> pair{PlanarRange{Eigen::Vector2d(60, 10)}, PlanarRange{Eigen::Vector2d(-20, 70)}};
  Eigen::Matrix2d R;
  R << 2.0, 0.9, 0.9, 1.0;
  for (int k = 0; k < 200; ++k) {
    ASSERT_EQ(want.predict(kMotion, 0.3), UpdateStatus::kAccepted);
    ASSERT_EQ(got.predict(kMotion, 0.3), UpdateStatus::kAccepted);
    const double angle = 0.02 * k;
    const Eigen::Vector2d p(30.0 * std::cos(angle), 30.0 * std::sin(angle));
    const Eigen::Vector2d z((p - Eigen::Vector2d(60, 10)).norm() + std::sin(5.0 * k),
                            (p - Eigen::Vector2d(-20, 70)).norm() + std::cos(7.0 * k));
    const Gate gate{.nis = 15.0};
    const auto a = want.update(Correlated<PlanarRange>{pair, z, R}, gate);
    const auto b = got.update(Correlated<PlanarRange>{pair, z, R}, gate);
    ASSERT_EQ(a.status, b.status);
    EXPECT_NEAR(a.nis, b.nis, 1e-9 * (1.0 + a.nis));
    EXPECT_LT((a.innovation - b.innovation).norm(), 1e-9);
    EXPECT_LT((a.covariance - b.covariance).norm(), 1e-9);
    EXPECT_LT((got.state().x - want.state().x).norm(), 1e-9);
    EXPECT_LT((got.covariance() - want.covariance()).norm(), 1e-9);
  }
  const std::vector<PlanarRange> many(17, pair[0]);
  EXPECT_EQ(
      got.update(Correlated<PlanarRange>{many, Eigen::VectorXd::Ones(17), Eigen::MatrixXd::Identity(17, 17)}).status,
      UpdateStatus::kTooManyRows);
  EXPECT_EQ(got.update(Correlated<PlanarRange>{pair, Eigen::VectorXd::Ones(3), R}).status,
            UpdateStatus::kNotPositiveDefinite);
}

TYPED_TEST(GaussianFilters, SmoothedStatesAreConsistentOnRanges) {
  // Ranges of 1 m to three beacons some 300 m away: the prior's 5 m bend a circle by 4 cm, little beside the noise, so
  // the linearisation is good. NEES of the smoothed state at one epoch, four degrees of freedom per run.
  constexpr int kRuns = 250;
  constexpr int kSteps = 30;
  const std::array<PlanarRange, 3> beacons{PlanarRange{Eigen::Vector2d(300, 0)},
                                           PlanarRange{Eigen::Vector2d(-200, 250)},
                                           PlanarRange{Eigen::Vector2d(0, -300)}};
  double filtered = 0.0, at_start = 0.0, midway = 0.0, nis = 0.0;
  for (int run = 0; run < kRuns; ++run) {
    RandomStream random(307, static_cast<std::uint64_t>(run));
    const Vehicle start = test::vehicle(5, -8, 1, 1);
    std::array<Vehicle, kSteps> truth;
    Vehicle now = start;
    for (Vehicle& x : truth) x = now = test::moved(now, kMotion, 0.7, random);
    const Vehicle x0 = start.retract(kP0.cwiseSqrt() * test::normals<4>(random));
    const auto observe = [&](TypeParam& filter, int k) {
      const PlanarRange& beacon = beacons[static_cast<std::size_t>(k % 3)];
      ValuePrediction<double, 1> h;
      EXPECT_TRUE(beacon.predict(truth[static_cast<std::size_t>(k)], h));
      nis += filter.update(beacon, h.z[0] + random.normal(), 1.0).nis;
    };
    const auto got = smoothed(TypeParam(x0, kP0), kSteps, observe);
    const auto of = [&](std::size_t k, const Vehicle& x, const Eigen::Matrix4d& P) {
      return nees(x.local(truth[k]), P).value_or(1e9);
    };
    filtered += of(kSteps - 1, got.records().back().filtered, got.records().back().P);
    at_start += of(0, got.smoothed()[0].state, got.smoothed()[0].P);
    midway += of(kSteps / 2, got.smoothed()[kSteps / 2].state, got.smoothed()[kSteps / 2].P);
  }
  const MeanBounds four = mean_nees_bounds(4.0, kRuns, 1e-6);
  const MeanBounds one = mean_nees_bounds(1.0, kRuns * kSteps, 1e-6);
  EXPECT_GT(filtered / kRuns, four.lower);
  EXPECT_LT(filtered / kRuns, four.upper);
  EXPECT_GT(at_start / kRuns, four.lower);
  EXPECT_LT(at_start / kRuns, four.upper);
  EXPECT_GT(midway / kRuns, four.lower);
  EXPECT_LT(midway / kRuns, four.upper);
  EXPECT_GT(nis / (kRuns * kSteps), one.lower);
  EXPECT_LT(nis / (kRuns * kSteps), one.upper);
}

}  // namespace
}  // namespace soopnav
