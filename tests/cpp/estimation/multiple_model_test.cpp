#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numbers>

#include "estimation/tracking_scene.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/consistency.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/interacting_multiple_model.hpp"
#include "soopnav/process/random_walk.hpp"
#include "support/nan.hpp"

namespace soopnav {
namespace {

using ::soopnav::test::kNan;
using test::Fix;
using test::Motion;
using test::PlanarRange;
using test::Vehicle;
using Clock = ComposedState<PlanarFrame, Role<1, ClockBiasTag>>;
struct Seen {
  static constexpr int kDim = 1;
  [[nodiscard]] bool predict(const Clock& x, Prediction<1, Clock>& y) const {
    y.value(0) = x(kClockBias)[0];
    y.jacobian(kClockBias)(0) = 1.0;
    return true;
  }
};
const Eigen::Matrix2d kSticky = (Eigen::Matrix2d() << 0.95, 0.05, 0.1, 0.9).finished();

TEST(InteractingMultipleModel, OfEqualModesIsOneFilter) {
  const Motion motion{{0.2, 0.3}};
  const Eigen::Matrix4d P0 = Eigen::Vector4d(9, 4, 1, 1).asDiagonal();
  InteractingMultipleModel many(test::vehicle(10, 20, 1, 0), P0, kSticky, Eigen::Vector2d(0.3, 0.7), motion, motion);
  ExtendedKalmanFilter<Vehicle> one(test::vehicle(10, 20, 1, 0), P0);
  for (int k = 0; k < 50; ++k) {
    ASSERT_EQ(many.predict(0.5), UpdateStatus::kAccepted);
    ASSERT_EQ(one.predict(motion, 0.5), UpdateStatus::kAccepted);
    const PlanarRange model{Eigen::Vector2d(k % 2 == 0 ? 40 : -30, 5)};
    const double z = (k % 2 == 0 ? 34.0 : 44.0) + 0.5 * k;
    const auto a = many.update(model, z, 4.0, Gate{.nis = 30.0});
    const auto b = one.update(model, z, 4.0, Gate{.nis = 30.0});
    ASSERT_EQ(a.status, b.status);
    EXPECT_NEAR(a.nis, b.nis, 1e-10 * (1.0 + b.nis));
    ASSERT_TRUE(a.accepted());
    EXPECT_NEAR(many.log_likelihood(), b.log_likelihood(), 1e-9);
    EXPECT_LT((many.state().x - one.state().x).norm(), 1e-9);
    EXPECT_LT((many.covariance() - one.covariance()).norm(), 1e-10);
  }
  // Nothing told the modes apart: the chain's stationary distribution.
  EXPECT_NEAR(many.probabilities()[0], 2.0 / 3.0, 1e-3);
}

TEST(InteractingMultipleModel, OneStepEqualsTheFormulas) {
  // A clock that stands still or jumps, seen directly: everything is a scalar.
  using Walk = RandomWalk<Role<1, ClockBiasTag>>;
  Clock x0;
  x0.x << 5.0;
  InteractingMultipleModel imm(x0, Eigen::Matrix<double, 1, 1>(2.0), kSticky, Eigen::Vector2d(0.4, 0.6),
                               Walk{kClockBias, {0.5}}, Walk{kClockBias, {30.0}});
  ASSERT_EQ(imm.predict(1.0), UpdateStatus::kAccepted);
  const double mu0 = 0.4 * 0.95 + 0.6 * 0.1;
  EXPECT_NEAR(imm.probabilities()[0], mu0, 1e-15);
  EXPECT_NEAR(imm.covariance()(0, 0), mu0 * 2.5 + (1.0 - mu0) * 32.0, 1e-12);
  const auto report = imm.update(Seen{}, 9.0, 1.0);
  ASSERT_TRUE(report.accepted());
  const double S[2] = {3.5, 33.0};
  EXPECT_NEAR(report.innovation[0], 4.0, 1e-14);
  EXPECT_NEAR(report.covariance(0, 0), mu0 * S[0] + (1.0 - mu0) * S[1], 1e-12);
  const auto density = [&](int j) { return std::exp(-0.5 * 16.0 / S[j]) / std::sqrt(2.0 * std::numbers::pi * S[j]); };
  const double total = mu0 * density(0) + (1.0 - mu0) * density(1);
  const double posterior = mu0 * density(0) / total;
  EXPECT_NEAR(imm.log_likelihood(), std::log(total), 1e-12);
  EXPECT_NEAR(imm.probabilities()[0], posterior, 1e-12);
  const double x[2] = {5.0 + 4.0 * 2.5 / 3.5, 5.0 + 4.0 * 32.0 / 33.0};
  const double P[2] = {2.5 / 3.5, 32.0 / 33.0};
  const double mean = posterior * x[0] + (1.0 - posterior) * x[1];
  EXPECT_NEAR(imm.state().x[0], mean, 1e-12);
  EXPECT_NEAR(imm.covariance()(0, 0),
              posterior * P[0] + (1.0 - posterior) * P[1] + posterior * (1.0 - posterior) * std::pow(x[0] - x[1], 2),
              1e-12);
  // The next prediction mixes: mode 0 comes from 0 with 0.95 mu_0, from 1 with 0.1 mu_1.
  ASSERT_EQ(imm.predict(1.0), UpdateStatus::kAccepted);
  const double from0 = 0.95 * posterior / (0.95 * posterior + 0.1 * (1.0 - posterior));
  EXPECT_NEAR(imm.modes()[0].state().x[0], from0 * x[0] + (1.0 - from0) * x[1], 1e-12);
  EXPECT_NEAR(imm.modes()[0].covariance()(0, 0),
              from0 * P[0] + (1.0 - from0) * P[1] + from0 * (1.0 - from0) * std::pow(x[0] - x[1], 2) + 0.5, 1e-12);
}

TEST(InteractingMultipleModel, AGroupWithOneCovarianceIsAModelOfItsRows) {
  const auto make = [] {
    return InteractingMultipleModel(test::vehicle(10, 20, 1, 0), Eigen::Matrix4d::Identity(), kSticky,
                                    Eigen::Vector2d(0.3, 0.7), Motion{{0.1, 0.1}}, Motion{{5.0, 5.0}});
  };
  auto by_rows = make(), by_model = make();
  // Ranges far off along the axes are the coordinates, but for a constant.
  const std::array<PlanarRange, 2> ranges{PlanarRange{Eigen::Vector2d(-1e6, 0)}, PlanarRange{Eigen::Vector2d(0, -1e6)}};
  const Eigen::Matrix2d R = (Eigen::Matrix2d() << 1.0, 0.4, 0.4, 2.0).finished();
  for (int k = 0; k < 10; ++k) {
    ASSERT_EQ(by_rows.predict(0.5), UpdateStatus::kAccepted);
    ASSERT_EQ(by_model.predict(0.5), UpdateStatus::kAccepted);
    const Eigen::Vector2d at(10.0 + k + (k % 2), 20.0 - 0.5 * k);
    const Eigen::VectorXd z = at.array() + 1e6;
    const auto a = by_rows.update(Correlated<PlanarRange>{ranges, z, R});
    const auto b = by_model.update(Fix{}, at, R);
    ASSERT_TRUE(a.accepted());
    EXPECT_NEAR(a.nis, b.nis, 1e-3);
    EXPECT_NEAR(by_rows.log_likelihood(), by_model.log_likelihood(), 1e-3);
    EXPECT_LT((by_rows.state().x - by_model.state().x).norm(), 1e-3);
    EXPECT_LT((by_rows.covariance() - by_model.covariance()).norm(), 1e-3);
    EXPECT_LT((by_rows.probabilities() - by_model.probabilities()).norm(), 1e-3);
  }
  const auto before = by_rows.state().x;
  const Eigen::VectorXd far = Eigen::Vector2d(1e6 + 500, 1e6);
  EXPECT_EQ(by_rows.update(Correlated<PlanarRange>{ranges, far, R}, Gate{.nis = 20.0}).status, UpdateStatus::kGated);
  EXPECT_EQ(by_rows.update<1>(Correlated<PlanarRange>{ranges, far, R}).status, UpdateStatus::kTooManyRows);
  EXPECT_EQ(by_rows.state().x, before);
}

TEST(InteractingMultipleModel, MixesHeadingsAndAttitudesInTheTangent) {
  using Posed = ComposedState<PlanarFrame, Role<1, HeadingTag>, Role<3, AttitudeTag>>;
  using Walk = RandomWalk<Role<1, HeadingTag>>;
  Posed x0;
  const Eigen::Matrix4d P0 = 0.01 * Eigen::Matrix4d::Identity();
  InteractingMultipleModel imm(x0, P0, kSticky, Eigen::Vector2d(0.5, 0.5), Walk{kHeading, {0.0}},
                               Walk{kHeading, {0.0}});
  // Two modes astride the seam, turned 0.4 rad apart about one axis: the mean is half way.
  auto modes = imm.modes();
  Eigen::Vector4d d;
  d << std::numbers::pi - 0.1, 1.0, 0.0, 0.0;
  modes[0].restore(x0.retract(d), P0);
  d << -std::numbers::pi + 0.2, 1.4, 0.0, 0.0;
  modes[1].restore(x0.retract(d), P0);
  imm.restore(modes, Eigen::Vector2d(0.5, 0.5));
  const Eigen::Vector4d mean = x0.local(imm.state());
  EXPECT_NEAR(mean[0], -std::numbers::pi + 0.05, 1e-12);
  EXPECT_NEAR(mean[1], 1.2, 1e-12);
  EXPECT_NEAR(imm.state()(kAttitude).norm(), 1.0, 1e-14);
  EXPECT_NEAR(imm.covariance()(0, 0), 0.01 + 0.15 * 0.15, 1e-12);
  EXPECT_NEAR(imm.covariance()(1, 1), 0.01 + 0.2 * 0.2, 1e-12);
  EXPECT_NEAR(imm.covariance()(0, 1), 0.15 * 0.2, 1e-12);
}

TEST(InteractingMultipleModel, RefusedInputChangesNothing) {
  InteractingMultipleModel imm(test::vehicle(10, 20, 1, 0), Eigen::Matrix4d::Identity(), kSticky,
                               Eigen::Vector2d(0.3, 0.7), Motion{{0.1, 0.1}}, Motion{{5.0, 5.0}});
  ASSERT_EQ(imm.predict(1.0), UpdateStatus::kAccepted);
  const auto before = imm;
  const auto unchanged = [&](UpdateStatus got, UpdateStatus want) {
    EXPECT_EQ(got, want);
    EXPECT_EQ(imm.state().x, before.state().x);
    EXPECT_EQ(imm.covariance(), before.covariance());
    EXPECT_EQ(imm.probabilities(), before.probabilities());
    for (std::size_t j = 0; j < 2; ++j) EXPECT_EQ(imm.modes()[j].covariance(), before.modes()[j].covariance());
  };
  const Eigen::Matrix2d R = Eigen::Matrix2d::Identity();
  unchanged(imm.update(Fix{}, Eigen::Vector2d(kNan, 0), R).status, UpdateStatus::kNonFinite);
  unchanged(imm.update(Fix{}, Eigen::Vector2d(0, 0), -R).status, UpdateStatus::kNotPositiveDefinite);
  unchanged(imm.update(Fix{}, Eigen::Vector2d(0, 0), kNan * R).status, UpdateStatus::kNonFinite);
  unchanged(imm.update(PlanarRange{Eigen::Vector2d(11, 20)}, 5.0, 1.0).status, UpdateStatus::kUndefined);
  const auto report = imm.update(Fix{}, Eigen::Vector2d(500, 20), R, Gate::probability(1e-3, 2));
  unchanged(report.status, UpdateStatus::kGated);
  EXPECT_GT(report.nis, 1e3);
  unchanged(imm.predict(0.0), UpdateStatus::kTimeNotAdvancing);
  unchanged(imm.predict(kNan), UpdateStatus::kTimeNotAdvancing);
  // Without the gate, too far for any mode's density to be a number: decided by logarithms all the same.
  EXPECT_TRUE(imm.update(Fix{}, Eigen::Vector2d(5000, 20), R).accepted());
  EXPECT_NEAR(imm.probabilities().sum(), 1.0, 1e-12);
  EXPECT_GT(imm.probabilities()[1], 0.999);
}

TEST(InteractingMultipleModel, SetUpThatIsNoChainThrows) {
  const auto make = [](const Eigen::Matrix2d& transition, const Eigen::Vector2d& probabilities) {
    InteractingMultipleModel imm(Vehicle{}, Eigen::Matrix4d::Identity(), transition, probabilities, Motion{}, Motion{});
  };
  const Eigen::Vector2d half(0.5, 0.5);
  EXPECT_NO_THROW(make(kSticky, half));
  EXPECT_NO_THROW(make(Eigen::Matrix2d::Identity(), Eigen::Vector2d(1.0, 0.0)));
  EXPECT_THROW(make(kSticky.transpose(), half), std::invalid_argument);
  EXPECT_THROW(make((Eigen::Matrix2d() << 1.5, -0.5, 0, 1).finished(), half), std::invalid_argument);
  EXPECT_THROW(make(kNan * kSticky, half), std::invalid_argument);
  EXPECT_THROW(make(kSticky, Eigen::Vector2d(0.5, 0.6)), std::invalid_argument);
  EXPECT_THROW(make(kSticky, Eigen::Vector2d(-0.5, 1.5)), std::invalid_argument);
}

}  // namespace
}  // namespace soopnav
