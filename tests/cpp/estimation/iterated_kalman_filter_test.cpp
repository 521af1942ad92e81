#include "soopnav/estimation/iterated_kalman_filter.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <limits>

#include "estimation/tracking_scene.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"

namespace soopnav {
namespace {

using Place = ComposedState<PlanarFrame, Role<2, PositionTag>>;
using Turned = ComposedState<EnuFrame, Role<3, AttitudeTag>>;
using test::PlanarRange;

Place place(double x, double y) {
  Place state;
  state.x << x, y;
  return state;
}

// One number, seen through its arc tangent: Newton's method runs away from where it is flat.
struct ArcTangent {
  static constexpr int kDim = 1;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    using std::atan;
    const auto b = x(kClockBias)[0];
    y.value(0) = atan(b);
    if constexpr (Y::kJacobian) y.jacobian(kClockBias)(0) = 1.0 / (1.0 + b * b);
    return true;
  }
};

// The known direction d as the body sees it.
struct DirectionSeen {
  using Frame = EnuFrame;
  static constexpr int kDim = 3;
  Eigen::Vector3d d;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto q = x(kAttitude);
    const Eigen::Vector3d v(q[1], q[2], q[3]);
    const Eigen::Vector3d t = 2.0 * v.cross(d);
    const Eigen::Vector3d b = d - q[0] * t + v.cross(t);
    for (int i = 0; i < 3; ++i) y.value(i) = b[i];
    if constexpr (Y::kJacobian) y.jacobian(kAttitude) << 0, -b[2], b[1], b[2], 0, -b[0], -b[1], b[0], 0;
    return true;
  }
};

TEST(IteratedKalmanFilter, OneIterationIsTheExtendedFilterToTheBit) {
  const test::Motion motion{{0.1, 0.2}};
  Eigen::Matrix4d P0 = Eigen::Vector4d(9, 4, 1, 1).asDiagonal();
  IteratedKalmanFilter<test::Vehicle> iterated(test::vehicle(10, 20, 1, 0), P0, {.max_iterations = 1});
  ExtendedKalmanFilter<test::Vehicle> extended(test::vehicle(10, 20, 1, 0), P0);
  for (int k = 0; k < 20; ++k) {
    ASSERT_EQ(iterated.predict(motion, 0.5), UpdateStatus::kAccepted);
    ASSERT_EQ(extended.predict(motion, 0.5), UpdateStatus::kAccepted);
    const PlanarRange model{Eigen::Vector2d(k % 2 == 0 ? 40 : -30, 5)};
    const auto a = iterated.update(model, 30.0 + k, 2.0);
    const auto b = extended.update(model, 30.0 + k, 2.0);
    EXPECT_EQ(a.status, b.status);
    EXPECT_EQ(a.nis, b.nis);
    EXPECT_EQ(iterated.iterations(), 1);
    EXPECT_EQ(iterated.state().x, extended.state().x);
    EXPECT_EQ(iterated.covariance(), extended.covariance());
  }
}

TEST(IteratedKalmanFilter, EndsWhereTheCostIsStationary) {
  // A range of 10 cm from a place known to 5 m, 20 m away: the circle bends within the prior.
  const Eigen::Matrix2d P0 = (Eigen::Matrix2d() << 25, 6, 6, 16).finished();
  const PlanarRange model{Eigen::Vector2d(12, 16)};
  IteratedKalmanFilter<Place> filter(place(0, 0), P0, {.max_iterations = 50, .tolerance = 1e-9});
  const auto report = filter.update(model, 14.0, 0.01);
  ASSERT_TRUE(report.accepted());
  EXPECT_TRUE(filter.converged());
  EXPECT_GT(filter.iterations(), 2);
  EXPECT_DOUBLE_EQ(report.innovation[0], -6.0);
  Prediction<1, Place> y;
  ASSERT_TRUE(model.predict(filter.state(), y));
  const Eigen::Vector2d prior = P0.lu().solve(filter.state().x);
  const Eigen::Vector2d gradient = prior - y.H.transpose() * (14.0 - y.z[0]) / 0.01;
  EXPECT_LT(gradient.norm(), 1e-6 * prior.norm());
  // Its covariance is that of the linear model there.
  const Eigen::Matrix2d information = P0.lu().solve(Eigen::Matrix2d::Identity()).eval() + y.H.transpose() * y.H / 0.01;
  EXPECT_LT((filter.covariance() * information - Eigen::Matrix2d::Identity()).norm(), 1e-5);
  // The extended filter stops short of it.
  ExtendedKalmanFilter<Place> extended(place(0, 0), P0);
  ASSERT_TRUE(extended.update(model, 14.0, 0.01).accepted());
  EXPECT_GT((extended.state().x - filter.state().x).norm(), 0.01);
}

TEST(IteratedKalmanFilter, PriorOfARotationIsWeighedInTheTangentThere) {
  // The most probable rotation between a prior 0.9 rad away and a direction seen as precisely as the prior is known:
  // neither wins, so the prior's weight in another tangent shows.
  const Eigen::Vector3d d = Eigen::Vector3d(0.3, -0.5, 0.8).normalized();
  const DirectionSeen model{d};
  Turned truth;
  truth = truth.retract(Eigen::Vector3d(0.5, 0.6, -0.4));
  ValuePrediction<double, 3> z;
  ASSERT_TRUE(model.predict(truth, z));
  const Eigen::Vector3d seen(z.z[0], z.z[1], z.z[2]);
  const Eigen::Matrix3d P0 = Eigen::Vector3d(0.3, 0.1, 0.2).asDiagonal();
  const Eigen::Matrix3d R = 0.05 * Eigen::Matrix3d::Identity();
  IteratedKalmanFilter<Turned> filter({}, P0, {.max_iterations = 100, .tolerance = 1e-10});
  ASSERT_TRUE(filter.update(model, seen, R).accepted());
  ASSERT_TRUE(filter.converged());
  const auto cost = [&](const Turned& x) {
    ValuePrediction<double, 3> h;
    static_cast<void>(model.predict(x, h));
    const Eigen::Vector3d e = Turned{}.local(x);
    const Eigen::Vector3d r = seen - Eigen::Vector3d(h.z[0], h.z[1], h.z[2]);
    return e.dot(P0.lu().solve(e)) + r.squaredNorm() / 0.05;
  };
  const double best = cost(filter.state());
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d step = 1e-4 * Eigen::Vector3d::Unit(i);
    const double slope = (cost(filter.state().retract(step)) - cost(filter.state().retract(-step))) / 2e-4;
    EXPECT_NEAR(slope, 0.0, 1e-5);
    EXPECT_GT(cost(filter.state().retract(step)), best);
  }
  EXPECT_GT(Turned{}.local(filter.state()).norm(), 0.3);
}

TEST(IteratedKalmanFilter, HalvesStepsThatWouldRunAway) {
  using Scalar = ComposedState<PlanarFrame, Role<1, ClockBiasTag>>;
  Scalar x0;
  x0.x << 3.0;
  const Eigen::Matrix<double, 1, 1> P0(100.0);
  IteratedKalmanFilter<Scalar> filter(x0, P0, {.max_iterations = 50});
  ASSERT_TRUE(filter.update(ArcTangent{}, 0.0, 1e-8).accepted());
  EXPECT_TRUE(filter.converged());
  EXPECT_NEAR(filter.state().x[0], 0.0, 1e-3);
  ExtendedKalmanFilter<Scalar> extended(x0, P0);
  ASSERT_TRUE(extended.update(ArcTangent{}, 0.0, 1e-8).accepted());
  EXPECT_LT(extended.state().x[0], -5.0);  // the full step overshoots, further with each repetition
}

TEST(IteratedKalmanFilter, GatesOnTheFirstInnovation) {
  const Eigen::Matrix2d P0 = 25.0 * Eigen::Matrix2d::Identity();
  IteratedKalmanFilter<Place> filter(place(0, 0), P0);
  const auto report = filter.update(PlanarRange{Eigen::Vector2d(12, 16)}, 80.0, 1.0, Gate{.nis = 20.0});
  EXPECT_EQ(report.status, UpdateStatus::kGated);
  EXPECT_NEAR(report.nis, 3600.0 / 26.0, 1e-9);
  EXPECT_EQ(filter.state().x, place(0, 0).x);
  EXPECT_EQ(filter.covariance(), P0);
  EXPECT_EQ(filter.iterations(), 0);
}

TEST(IteratedKalmanFilter, OptionsThatBreakTheirRule) {
  const auto make = [](const IterationOptions& options) {
    IteratedKalmanFilter<Place> filter({}, Eigen::Matrix2d::Identity(), options);
  };
  EXPECT_NO_THROW(make({.max_iterations = 1}));
  EXPECT_THROW(make({.max_iterations = 0}), std::invalid_argument);
  EXPECT_THROW(make({.tolerance = 0.0}), std::invalid_argument);
  EXPECT_THROW(make({.tolerance = std::numeric_limits<double>::quiet_NaN()}), std::invalid_argument);
}

}  // namespace
}  // namespace soopnav
