#include "soopnav/estimation/extended_kalman_filter.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <type_traits>
#include <vector>

#include "soopnav/core/joint_process.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/information_filter.hpp"
#include "soopnav/estimation/iterated_kalman_filter.hpp"
#include "soopnav/estimation/square_root_kalman_filter.hpp"
#include "soopnav/estimation/unscented_kalman_filter.hpp"
#include "soopnav/inertial/planar_mechanization.hpp"
#include "soopnav/measurement/azimuth.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "soopnav/process/random_walk.hpp"
#include "support/nan.hpp"

namespace soopnav {
namespace {

using Pvt = PositionVelocityClock<EnuFrame, 3>;
using Clocked = PositionClock<EnuFrame>;
using Planar = PlanarInertialState;
using Posed = ComposedState<EnuFrame, Role<3, PositionTag>, Role<3, AttitudeTag>>;
using Bearing = Azimuth<PlanarFrame, Role<1, HeadingTag>>;
using ::soopnav::test::kNan;

// The body's rotation seen through one known direction: three numbers, C(q)ᵀ d. Written in components, so that sigma
// points and particles take it too.
struct DirectionInBody {
  using Frame = EnuFrame;
  static constexpr int kDim = 3;
  Eigen::Vector3d d = Eigen::Vector3d::UnitX();
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto q = x(kAttitude);
    Eigen::Matrix3d C;
    C << 1 - 2 * (q[2] * q[2] + q[3] * q[3]), 2 * (q[1] * q[2] - q[0] * q[3]), 2 * (q[1] * q[3] + q[0] * q[2]),
        2 * (q[1] * q[2] + q[0] * q[3]), 1 - 2 * (q[1] * q[1] + q[3] * q[3]), 2 * (q[2] * q[3] - q[0] * q[1]),
        2 * (q[1] * q[3] - q[0] * q[2]), 2 * (q[2] * q[3] + q[0] * q[1]), 1 - 2 * (q[1] * q[1] + q[2] * q[2]);
    const Eigen::Vector3d b = C.transpose() * d;
    for (int i = 0; i < 3; ++i) y.value(i) = b[i];
    if constexpr (Y::kJacobian) y.jacobian(kAttitude) << 0, -b[2], b[1], b[2], 0, -b[0], -b[1], b[0], 0;
    return true;
  }
};

Clocked clocked(double e, double n, double u, double b) {
  Clocked x;
  x.x << e, n, u, b;
  return x;
}

template <class Filter>
class KalmanFilters : public testing::Test {};
template <class State>
struct Extended {
  using Filter = ExtendedKalmanFilter<State>;
};
template <class State>
struct Unscented {
  using Filter = UnscentedKalmanFilter<State>;
};
template <class State>
struct Iterated {
  using Filter = IteratedKalmanFilter<State>;
};
template <class State>
struct SquareRoot {
  using Filter = SquareRootKalmanFilter<State>;
};
template <class State>
struct Information {
  using Filter = InformationFilter<State>;
};
template <template <class> class Kind>
struct Of {
  template <class State>
  using Filter = typename Kind<State>::Filter;
};
using Kinds = testing::Types<Of<Extended>, Of<Unscented>, Of<Iterated>, Of<SquareRoot>, Of<Information>>;
TYPED_TEST_SUITE(KalmanFilters, Kinds);

TYPED_TEST(KalmanFilters, OnePseudorangeEqualsTheTextbookFormulas) {
  // A far source and a small covariance: the model is linear there, so both filters owe the linear answer.
  const Eigen::Matrix4d P0 = Eigen::Vector4d(4, 9, 1, 25).asDiagonal();
  typename TypeParam::template Filter<Clocked> filter(clocked(10, 20, 30, 5), P0);
  const Pseudorange<EnuFrame> model{Eigen::Vector3d(6e6, 8e6, 30), Known<1>{7.0}};
  const double range = Eigen::Vector3d(6e6 - 10, 8e6 - 20, 0).norm();
  const auto report = filter.update(model, range - 2.0 + 3.0, 2.0);
  ASSERT_TRUE(report.accepted());
  const Eigen::RowVector4d H(-(6e6 - 10) / range, -(8e6 - 20) / range, 0.0, 1.0);
  const double S = (H * P0 * H.transpose())(0) + 2.0;
  EXPECT_NEAR(report.innovation[0], 3.0, 1e-5);
  EXPECT_NEAR(report.covariance(0, 0), S, 1e-5);
  EXPECT_NEAR(report.nis, 9.0 / S, 1e-5);
  EXPECT_NEAR(report.log_likelihood(), -0.5 * (9.0 / S + std::log(2.0 * std::numbers::pi * S)), 1e-5);
  const Eigen::Vector4d gain = P0 * H.transpose() / S;
  EXPECT_NEAR((filter.state().x - (Eigen::Vector4d(10, 20, 30, 5) + gain * 3.0)).norm(), 0.0, 1e-5);
  EXPECT_NEAR((filter.covariance() - (P0 - gain * S * gain.transpose())).norm(), 0.0, 1e-4);
}

TYPED_TEST(KalmanFilters, BearingTheShortWayRound) {
  // Heading just below pi, the source behind: residuals and the heading itself cross the seam.
  Planar x0;
  x0.x << 3.1, 0, 0, 0, 0;
  typename TypeParam::template Filter<Planar> filter(x0, Eigen::Matrix<double, 5, 5>::Identity() * 0.01);
  const Bearing model{Eigen::Vector2d(-100, 0), kHeading};  // seen at pi - 3.1 = 0.0416
  const auto report = filter.update(model, std::numbers::pi - 3.1 - 0.2, 1e-6);
  ASSERT_TRUE(report.accepted());
  EXPECT_NEAR(report.innovation[0], -0.2, 1e-3);
  // The heading moved on by 0.2 and over the seam (a little of the bearing's change is the position's).
  EXPECT_NEAR(filter.state().x[0], 3.3 - 2.0 * std::numbers::pi, 3e-3);
}

TYPED_TEST(KalmanFilters, AttitudeConvergesToTheRotation) {
  const Eigen::Quaterniond truth = Eigen::Quaterniond(Eigen::AngleAxisd(2.8, Eigen::Vector3d(1, -2, 0.5).normalized()));
  Posed x0;
  const Eigen::Quaterniond start =
      truth * Eigen::Quaterniond(Eigen::AngleAxisd(0.3, Eigen::Vector3d(0.2, 1, 1).normalized()));
  x0.x << 0, 0, 0, start.w(), start.x(), start.y(), start.z();
  typename TypeParam::template Filter<Posed> filter(x0, Eigen::Matrix<double, 6, 6>::Identity() * 0.1);
  for (int k = 0; k < 30; ++k) {
    const Eigen::Vector3d d = k % 2 == 0 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d(0, 0.6, 0.8);
    ASSERT_TRUE(
        filter.update(DirectionInBody{d}, truth.conjugate() * d, Eigen::Matrix3d::Identity() * 1e-4).accepted());
  }
  const auto q = filter.state()(kAttitude);
  EXPECT_NEAR(q.norm(), 1.0, 1e-14);
  EXPECT_GT(std::abs(q.dot(Eigen::Vector4d(truth.w(), truth.x(), truth.y(), truth.z()))), 1.0 - 1e-5);
}

TYPED_TEST(KalmanFilters, RefusedInputChangesNothing) {
  const Eigen::Matrix4d P0 = Eigen::Vector4d(4, 9, 1, 25).asDiagonal();
  typename TypeParam::template Filter<Clocked> filter(clocked(10, 20, 30, 5), P0);
  const Pseudorange<EnuFrame> model{Eigen::Vector3d(600, 800, 30)};
  const Eigen::Matrix4d P = filter.covariance();
  const auto unchanged = [&](UpdateStatus got, UpdateStatus want) {
    EXPECT_EQ(got, want);
    EXPECT_EQ(filter.state().x, clocked(10, 20, 30, 5).x);
    EXPECT_EQ(filter.covariance(), P);
  };
  unchanged(filter.update(model, kNan, 1.0).status, UpdateStatus::kNonFinite);
  unchanged(filter.update(model, std::numeric_limits<double>::infinity(), 1.0).status, UpdateStatus::kNonFinite);
  unchanged(filter.update(model, 1000.0, kNan).status, UpdateStatus::kNonFinite);
  unchanged(filter.update(model, 1000.0, 0.0).status, UpdateStatus::kNotPositiveDefinite);
  unchanged(filter.update(model, 1000.0, -1.0).status, UpdateStatus::kNotPositiveDefinite);
  const RandomWalk walk{kPosition, {1.0, 1.0, 1.0}};
  for (const double dt : {0.0, -1.0, kNan, std::numeric_limits<double>::infinity()}) {
    unchanged(filter.predict(walk, dt), UpdateStatus::kTimeNotAdvancing);
  }
  unchanged(filter.predict(RandomWalk{kPosition, {-1.0, 1.0, 1.0}}, 1.0), UpdateStatus::kNonFinite);
  // 1000 m off at a few metres of uncertainty.
  const auto report = filter.update(model, 2000.0, 1.0, Gate::probability(1e-3, 1));
  unchanged(report.status, UpdateStatus::kGated);
  EXPECT_GT(report.nis, 1e3);
  EXPECT_TRUE(std::isfinite(report.innovation[0]));
  unchanged(filter.update(model, 2000.0, 1.0, Gate{.residual = 45.0}).status, UpdateStatus::kGated);
  // The residual monitor yields to an innovation that its own sigma explains.
  EXPECT_TRUE(filter.update(model, 1010.0, 1e6, Gate{.residual = 5.0, .residual_sigmas = 3.0}).accepted());
}

TEST(ExtendedKalmanFilter, ReceiverOnTopOfTheSourceIsUndefined) {
  ExtendedKalmanFilter<Clocked> filter(clocked(1, 2, 3, 0), Eigen::Matrix4d::Identity());
  EXPECT_EQ(filter.update(Pseudorange<EnuFrame>{Eigen::Vector3d(1, 2, 3)}, 5.0, 1.0).status, UpdateStatus::kUndefined);
}

TYPED_TEST(KalmanFilters, SetUpThatIsNoStateThrows) {
  using Filter = typename TypeParam::template Filter<Clocked>;
  const auto make = [](const Clocked& x, const Eigen::Matrix4d& P) { Filter filter(x, P); };
  if constexpr (std::is_same_v<Filter, InformationFilter<Clocked>>) {
    EXPECT_THROW(make(clocked(0, 0, 0, 0), Eigen::Matrix4d::Zero()), std::invalid_argument);
  } else {
    EXPECT_NO_THROW(make(clocked(0, 0, 0, 0), Eigen::Matrix4d::Zero()));  // known exactly
  }
  EXPECT_THROW(make(clocked(0, kNan, 0, 0), Eigen::Matrix4d::Identity()), std::invalid_argument);
  Eigen::Matrix4d P = Eigen::Matrix4d::Identity();
  P(1, 2) = 0.5;
  EXPECT_THROW(make(clocked(0, 0, 0, 0), P), std::invalid_argument);  // not symmetric
  P(2, 1) = 0.5;
  EXPECT_NO_THROW(make(clocked(0, 0, 0, 0), P));
  P(1, 2) = P(2, 1) = 1.5;
  EXPECT_THROW(make(clocked(0, 0, 0, 0), P), std::invalid_argument);  // indefinite
  P(0, 0) = kNan;
  EXPECT_THROW(make(clocked(0, 0, 0, 0), P), std::invalid_argument);
}

TYPED_TEST(KalmanFilters, FloorHoldsAndCounts) {
  typename TypeParam::template Filter<Clocked> filter(
      clocked(10, 20, 30, 5), Eigen::Vector4d(1e-4, 1e-4, 1e-4, 1.0).asDiagonal().toDenseMatrix());
  filter.set_covariance_floor(Eigen::Vector4d(0, 0, 0, 0.3));
  EXPECT_THROW(filter.set_covariance_floor(Eigen::Vector4d(0, 0, 0, -0.3)), std::invalid_argument);
  const Pseudorange<EnuFrame> model{Eigen::Vector3d(600, 800, 30)};
  for (int k = 0; k < 5; ++k) ASSERT_TRUE(filter.update(model, 995.0, 0.1).accepted());
  EXPECT_GE(filter.covariance()(3, 3), 0.3 * (1.0 - 1e-9));
  EXPECT_GT(filter.covariance_floor().counts[3], 0u);
  EXPECT_EQ(filter.covariance_floor().counts[0], 0u);
}

TEST(ExtendedKalmanFilter, CorrelatedEqualsADecorrelatedSequence) {
  // Two pseudoranges with a common error: whitened by hand they are two independent measurements of linear mixtures,
  // and around one point the mixture of two Jacobians is the Jacobian of the mixture.
  const std::array<Pseudorange<EnuFrame>, 2> models{Pseudorange<EnuFrame>{Eigen::Vector3d(6e5, 8e5, 30)},
                                                    Pseudorange<EnuFrame>{Eigen::Vector3d(-3e5, 9e5, 70)}};
  const Clocked x0 = clocked(10, 20, 30, 5);
  const Eigen::Matrix4d P0 = Eigen::Vector4d(4, 9, 1, 25).asDiagonal();
  Eigen::Vector2d h;
  Eigen::Matrix<double, 2, 4> H;
  for (int i = 0; i < 2; ++i) {
    Prediction<1, Clocked> y;
    ASSERT_TRUE(models[static_cast<std::size_t>(i)].predict(x0, y));
    h[i] = y.z[0];
    H.row(i) = y.estimated();
  }
  const Eigen::Vector2d z = h + Eigen::Vector2d(2.0, -3.0);
  Eigen::Matrix2d R;
  R << 3.0, 1.5, 1.5, 2.0;
  ExtendedKalmanFilter<Clocked> filter(x0, P0);
  const auto report = filter.update(Correlated<Pseudorange<EnuFrame>>{models, z, R});
  ASSERT_TRUE(report.accepted());
  const Eigen::Matrix2d S = H * P0 * H.transpose() + R;
  const Eigen::Matrix<double, 4, 2> K = S.lu().solve(H * P0).transpose();
  EXPECT_NEAR((filter.state().x - (x0.x + K * (z - h))).norm(), 0.0, 1e-10);
  EXPECT_NEAR((filter.covariance() - (P0 - K * S * K.transpose())).norm(), 0.0, 1e-12);
  EXPECT_NEAR(report.nis, (z - h).dot(S.lu().solve(z - h)), 1e-12);
  // Wrong shapes, an R that is no covariance: refused.
  EXPECT_EQ(filter.update(Correlated<Pseudorange<EnuFrame>>{models, z, Eigen::MatrixXd::Identity(3, 3)}).status,
            UpdateStatus::kNotPositiveDefinite);
  R(0, 1) = 9.0;
  EXPECT_EQ(filter.update(Correlated<Pseudorange<EnuFrame>>{models, z, R}).status, UpdateStatus::kNotPositiveDefinite);
  const std::vector<Pseudorange<EnuFrame>> many(17, models[0]);
  EXPECT_EQ(
      filter
          .update(Correlated<Pseudorange<EnuFrame>>{many, Eigen::VectorXd::Zero(17), Eigen::MatrixXd::Identity(17, 17)})
          .status,
      UpdateStatus::kTooManyRows);
}

TYPED_TEST(KalmanFilters, PredictionOfThePlanarMechanization) {
  // Standing at heading 0.5, pushed forward by 2 m/s² for 0.1 s, with a wide heading: d v / d psi shows in P.
  Planar x0;
  x0.x << 0.5, 0, 0, 0, 0;
  Eigen::Matrix<double, 5, 5> P0 = 1e-12 * Eigen::Matrix<double, 5, 5>::Identity();
  P0(0, 0) = 1e-6;
  typename TypeParam::template Filter<Planar> filter(x0, P0);
  const JointProcess process{inertial::PlanarMechanization{{0.01, 0.2}}, RandomWalk{kPlanarPosition, {0.4, 0.4}}};
  Eigen::Matrix<double, 5, 5> cross;
  ASSERT_EQ(filter.predict(process, {0.3, {2.0, 0.0}}, 0.1, &cross), UpdateStatus::kAccepted);
  EXPECT_NEAR(filter.state()(kHeading)[0], 0.53, 1e-12);
  EXPECT_NEAR(filter.state()(kPlanarVelocity)[0], 0.2 * std::cos(0.5), 1e-6);
  EXPECT_NEAR(filter.state()(kPlanarPosition)[1], 0.01 * std::sin(0.5), 1e-7);
  const Eigen::Matrix<double, 5, 5> P = filter.covariance();
  EXPECT_NEAR(P(0, 0), 1e-6 + 1e-6, 1e-12);
  // Across the push: 0.2 m/s times the heading's error; in every direction: the accelerometers.
  const Eigen::Vector2d across(-std::sin(0.5), std::cos(0.5));
  const double lateral = across.dot(P.block<2, 2>(1, 1) * across);
  EXPECT_NEAR(lateral, 0.04 * 1e-6 + 4e-4, 1e-9);
  EXPECT_NEAR(P(3, 3), 0.04 + 4e-4 * 0.0025 + std::pow(0.01 * std::sin(0.5), 2) * 1e-6, 1e-8);
  EXPECT_NEAR(cross(0, 0), 1e-6, 1e-12);
  EXPECT_NEAR(cross(0, 1), -0.2 * std::sin(0.5) * 1e-6, 1e-11);
}

}  // namespace
}  // namespace soopnav
