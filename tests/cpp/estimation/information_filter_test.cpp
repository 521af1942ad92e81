#include "soopnav/estimation/information_filter.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "estimation/tracking_scene.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"

namespace soopnav {
namespace {

using test::Fix;
using test::Motion;
using test::Vehicle;
using Filter = InformationFilter<Vehicle>;
constexpr double kInf = std::numeric_limits<double>::infinity();

TEST(InformationFilter, StartsFromNothing) {
  // Two fixes a time apart determine position and velocity; wherever the state started, they alone do.
  const Eigen::Matrix2d R = Eigen::Vector2d(4.0, 1.0).asDiagonal();
  const Motion motion{{0.3, 0.6}};
  const double dt = 2.0;
  Filter filter = Filter::from_information(test::vehicle(1e4, -700, 30, -5), Eigen::Matrix4d::Zero());
  EXPECT_EQ(filter.rank(), 0);
  EXPECT_EQ(filter.covariance()(2, 2), kInf);
  EXPECT_EQ(filter.covariance()(0, 1), 0.0);
  ASSERT_EQ(filter.predict(motion, dt), UpdateStatus::kAccepted);
  EXPECT_EQ(filter.information().norm(), 0.0);

  const auto first = filter.update(Fix{}, Eigen::Vector2d(10, 20), R, Gate::probability(1e-3, 2));
  ASSERT_TRUE(first.accepted());
  EXPECT_EQ(first.covariance(0, 0), kInf);
  EXPECT_NEAR(first.nis, 0.0, 1e-12);  // nothing to compare with
  EXPECT_EQ(filter.rank(), 2);
  EXPECT_NEAR(filter.state().x[0], 10.0, 1e-9);
  EXPECT_NEAR(filter.covariance()(0, 0), 4.0, 1e-12);
  EXPECT_EQ(filter.covariance()(2, 2), kInf);

  Eigen::Matrix4d cross;
  ASSERT_EQ(filter.predict(motion, dt, &cross), UpdateStatus::kAccepted);
  EXPECT_TRUE(std::isnan(cross(0, 0)));
  EXPECT_EQ(filter.rank(), 2);
  EXPECT_EQ(filter.covariance()(0, 0), kInf);  // position was, p - v dt still is
  ASSERT_TRUE(filter.update(Fix{}, Eigen::Vector2d(16, 14), R, Gate::probability(1e-3, 2)).accepted());
  EXPECT_EQ(filter.rank(), 4);
  // Velocity now: the difference quotient plus what the noise of the step ties to the position; q dt³/3, q dt²/2, q dt.
  EXPECT_NEAR(filter.state().x[0], 16.0, 1e-9);
  EXPECT_NEAR(filter.state().x[2], 3.0, 1e-9);
  EXPECT_NEAR(filter.state().x[3], -3.0, 1e-9);
  const Eigen::Matrix4d P = filter.covariance();
  for (int i = 0; i < 2; ++i) {
    const double q = i == 0 ? 0.3 : 0.6;
    EXPECT_NEAR(P(i, i), R(i, i), 1e-9);
    EXPECT_NEAR(P(2 + i, 2 + i), 2.0 * R(i, i) / (dt * dt) + q * dt / 3.0, 1e-9);
    EXPECT_NEAR(P(i, 2 + i), R(i, i) / dt, 1e-9);
  }
  // From here on it is any other filter.
  ExtendedKalmanFilter<Vehicle> extended(filter.state(), P);
  for (int k = 0; k < 10; ++k) {
    ASSERT_EQ(filter.predict(motion, dt), UpdateStatus::kAccepted);
    ASSERT_EQ(extended.predict(motion, dt), UpdateStatus::kAccepted);
    const Eigen::Vector2d z(20.0 + 5.0 * k, 8.0 - 6.0 * k);
    const auto a = filter.update(Fix{}, z, R);
    const auto b = extended.update(Fix{}, z, R);
    EXPECT_NEAR(a.nis, b.nis, 1e-9 * b.nis);
  }
  EXPECT_LT((filter.state().x - extended.state().x).norm(), 1e-9);
  EXPECT_LT((filter.covariance() - extended.covariance()).norm(), 1e-9);
}

TEST(InformationFilter, TestsWhatIsDeterminedOfAnObservation) {
  // East is known, north is not: only the east component can disagree.
  Eigen::Matrix4d Y0 = Eigen::Matrix4d::Zero();
  Y0(0, 0) = 0.25;
  Filter filter = Filter::from_information(test::vehicle(0, 0, 0, 0), Y0);
  const auto far = filter.update(Fix{}, Eigen::Vector2d(50, 1e5), Eigen::Matrix2d::Identity(), Gate{.nis = 20.0});
  EXPECT_EQ(far.status, UpdateStatus::kGated);
  EXPECT_NEAR(far.nis, 500.0, 1e-6);
  EXPECT_NEAR(far.covariance(0, 0), 5.0, 1e-12);
  EXPECT_EQ(far.covariance(1, 1), kInf);
  EXPECT_EQ(filter.information(), Y0);
  EXPECT_EQ(filter.state().x, test::vehicle(0, 0, 0, 0).x);
  EXPECT_TRUE(filter.update(Fix{}, Eigen::Vector2d(5, 1e5), Eigen::Matrix2d::Identity(), Gate{.nis = 20.0}).accepted());
  EXPECT_NEAR(filter.state().x[0], 4.0, 1e-9);
  EXPECT_NEAR(filter.state().x[1], 1e5, 1e-6);
}

// Forgets its position and draws it anew: a transition that cannot be turned back.
struct Forget {
  static constexpr int kNoise = 2;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& /*x*/, double /*dt_s*/, const W& w, Y& y) const {
    auto&& next = y.next(kPlanarPosition);
    next[0] = w[0];
    next[1] = w[1];
    if constexpr (Y::kJacobian) {
      y.transition(kPlanarPosition, kPlanarPosition).setZero();
      y.noise(kPlanarPosition).setIdentity();
    }
    return true;
  }
};

TEST(InformationFilter, RefusesASingularTransition) {
  Filter filter(test::vehicle(1, 2, 3, 4), Eigen::Matrix4d::Identity());
  EXPECT_EQ(filter.predict(Forget{}, 1.0), UpdateStatus::kUndefined);
  EXPECT_EQ(filter.state().x, test::vehicle(1, 2, 3, 4).x);
  EXPECT_EQ(filter.information(), Eigen::Matrix4d::Identity());
}

TEST(InformationFilter, SetUpAndRestore) {
  Eigen::Matrix4d Y = Eigen::Matrix4d::Identity();
  Y(0, 0) = -1.0;
  EXPECT_THROW(static_cast<void>(Filter::from_information({}, Y)), std::invalid_argument);
  Y(0, 0) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(static_cast<void>(Filter::from_information({}, Y)), std::invalid_argument);
  Filter filter(test::vehicle(1, 2, 3, 4), Eigen::Matrix4d::Identity());
  EXPECT_FALSE(filter.restore({}, Eigen::Matrix4d::Zero()));
  EXPECT_EQ(filter.state().x, test::vehicle(1, 2, 3, 4).x);
  EXPECT_TRUE(filter.restore({}, 2.0 * Eigen::Matrix4d::Identity()));
  EXPECT_NEAR(filter.information()(1, 1), 0.5, 1e-15);
}

}  // namespace
}  // namespace soopnav
