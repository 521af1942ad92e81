// What holds between steps, covariances and conventions of the process models.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

#include "process/process_battery.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/joint_process.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/layout_kalman_filter.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/measurement/planar_increment.hpp"
#include "soopnav/process/attitude_random_walk.hpp"
#include "soopnav/process/coordinated_turn.hpp"
#include "soopnav/process/nearly_constant_velocity.hpp"
#include "soopnav/process/planar_odometry.hpp"
#include "soopnav/process/random_walk.hpp"

namespace soopnav {
namespace {

using Planar = PositionVelocity<PlanarFrame, 2>;
using Turning = ComposedState<PlanarFrame, Role<2, PositionTag>, Role<2, VelocityTag>, Role<1, TurnRateTag>>;
using Pose = ComposedState<PlanarFrame, Role<2, PositionTag>, Role<1, HeadingTag>>;
using Tilted = ComposedState<EnuFrame, Role<3, AttitudeTag>>;

// Models belong to states that hold what they move.
static_assert(ProcessModelFor<NearlyConstantVelocity<2>, Planar>);
static_assert(ProcessModelFor<CoordinatedTurn<>, Turning>);
static_assert(ProcessModelFor<PlanarOdometry, Pose>);

double relative(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) { return (a - b).norm() / b.norm(); }

// One step of a second equals ten of a tenth, in F and in Q.
template <class Process, class State>
void composes(const Process& process, const State& x, double tolerance) {
  Eigen::MatrixXd Q;
  const auto many = test::compose(process, x, 1.0, 10, Q);
  const auto one = test::linearise(process, x, 1.0);
  EXPECT_LT(relative(many.F, one.F), tolerance);
  EXPECT_LT(relative(Q, one.Q()), tolerance);
  State end = x;
  for (int k = 0; k < 10; ++k) end = test::next_state(process, end, 0.1);
  EXPECT_LT(test::next_state(process, x, 1.0).local(end).norm(), 1e-9);
}

TEST(NearlyConstantVelocity, HasTheTextbookCovariance) {
  const double q0 = 0.3, q1 = 2.0, dt = 0.7;
  const auto step = test::linearise(NearlyConstantVelocity<2>{{q0, q1}}, Planar{}, dt);
  Eigen::Matrix4d Q = Eigen::Matrix4d::Zero();
  for (const auto& [i, q] : {std::pair{0, q0}, std::pair{1, q1}}) {
    Q(i, i) = q * dt * dt * dt / 3.0;
    Q(i, i + 2) = Q(i + 2, i) = q * dt * dt / 2.0;
    Q(i + 2, i + 2) = q * dt;
  }
  EXPECT_LT(relative(step.Q(), Q), 1e-14);
  composes(NearlyConstantVelocity<2>{{q0, q1}}, Planar{}, 1e-13);
}

TEST(PiecewiseConstantAcceleration, HasTheTextbookCovarianceOfItsStep) {
  const double sigma = 1.5, dt = 0.5;
  const PiecewiseConstantAcceleration<2> process{{sigma, 0.0}};
  const auto step = test::linearise(process, Planar{}, dt);
  Eigen::Matrix4d Q = Eigen::Matrix4d::Zero();
  Q(0, 0) = 0.25 * dt * dt * dt * dt;
  Q(0, 2) = Q(2, 0) = 0.5 * dt * dt * dt;
  Q(2, 2) = dt * dt;
  EXPECT_LT(relative(step.Q(), sigma * sigma * Q), 1e-14);
  // Its noise is the step's: the velocity of ten tenths is ten times less noisy than that of a whole one.
  Eigen::MatrixXd tenths;
  test::compose(process, Planar{}, 1.0, 10, tenths);
  EXPECT_NEAR(tenths(2, 2) * 10.0, test::linearise(process, Planar{}, 1.0).Q()(2, 2), 1e-12);
}

TEST(Walks, Compose) {
  RandomStream random(1);
  composes(RandomWalk{kHeading, {0.01}}, test::Place<Pose>(test::kLocal, random).x, 1e-13);
  composes(AttitudeRandomWalk{{1e-3, 2e-3, 3e-3}}, test::Place<Tilted>(test::kLocal, random).x, 1e-13);
}

TEST(AttitudeRandomWalk, TurnsAboutTheBodysAxes) {
  // The body's first axis points up: a positive turn about it goes from east to north.
  Tilted x;
  const Eigen::Quaterniond up(Eigen::AngleAxisd(-kPi / 2.0, Eigen::Vector3d::UnitY()));
  x.x << up.w(), up.x(), up.y(), up.z();
  const double dt = 4.0;
  const Tilted turned = test::next_state(AttitudeRandomWalk{{0.01, 0.0, 0.0}}, x, dt, test::OneNormal{0, 1.0});
  const Eigen::Quaterniond q(turned.x[0], turned.x[1], turned.x[2], turned.x[3]);
  const Eigen::AngleAxisd step(q * up.conjugate());  // in the frame
  EXPECT_NEAR(step.angle(), 0.2, 1e-12);
  EXPECT_NEAR((step.axis() - Eigen::Vector3d::UnitZ()).norm(), 0.0, 1e-12);
  // No noise, no turn; and a huge one is still a rotation.
  EXPECT_EQ(test::next_state(AttitudeRandomWalk{}, x, dt).x, x.x);
  EXPECT_NEAR(test::next_state(AttitudeRandomWalk{{1.0, 1.0, 1.0}}, x, dt, test::OneNormal{1, 40.0}).x.norm(), 1.0,
              1e-12);
}

Turning turning(double vx, double vy, double rate) {
  Turning x;
  x.x << 10.0, 20.0, vx, vy, rate;
  return x;
}

TEST(CoordinatedTurn, GoesRoundACircle) {
  // A quarter of a circle of radius v / omega, from the first axis towards the second.
  const auto quarter = test::next_state(CoordinatedTurn<>{}, turning(10.0, 0.0, 0.1), kPi / 0.2);
  EXPECT_NEAR(quarter.x[0], 10.0 + 100.0, 1e-9);
  EXPECT_NEAR(quarter.x[1], 20.0 + 100.0, 1e-9);
  EXPECT_NEAR(quarter.x[2], 0.0, 1e-12);
  EXPECT_NEAR(quarter.x[3], 10.0, 1e-12);
  const auto round = test::next_state(CoordinatedTurn<>{}, turning(3.0, -4.0, -0.5), kTwoPi / 0.5);
  EXPECT_NEAR((round.x - turning(3.0, -4.0, -0.5).x).norm(), 0.0, 1e-12);
}

TEST(CoordinatedTurn, IsStraightWithoutTurnRate) {
  for (const double rate : {0.0, 1e-300, -1e-200, 1e-18}) {
    const auto step = test::linearise(CoordinatedTurn<>{0.4, 0.0}, turning(3.0, -4.0, rate), 2.0);
    const auto straight = test::linearise(NearlyConstantVelocity<2>{{0.4, 0.4}}, Planar{}, 2.0);
    EXPECT_LT(relative(step.F.topLeftCorner<4, 4>(), straight.F), 1e-15);
    EXPECT_LT(relative(step.Q().topLeftCorner<4, 4>(), straight.Q()), 1e-14);
    EXPECT_NEAR(
        (test::next_state(CoordinatedTurn<>{}, turning(3.0, -4.0, rate), 2.0).x.head<2>() - Eigen::Vector2d(16.0, 12.0))
            .norm(),
        0.0, 1e-12);
  }
}

// Noise that enters velocity and turn rate at every moment, carried to the end by the model's own transition.
Eigen::MatrixXd integrated_noise(const CoordinatedTurn<>& process, const Turning& x, double dt) {
  constexpr int kIntervals = 2000;  // Simpson's rule
  const CoordinatedTurn<> still{};
  Eigen::MatrixXd density = Eigen::MatrixXd::Zero(5, 5);
  density(2, 2) = density(3, 3) = process.acceleration_psd;
  density(4, 4) = process.turn_rate_psd;
  Eigen::MatrixXd Q = Eigen::MatrixXd::Zero(5, 5);
  for (int k = 0; k <= kIntervals; ++k) {
    const double since = dt * k / kIntervals;
    const auto then = since < dt ? test::next_state(still, x, dt - since) : x;
    Eigen::MatrixXd F = Eigen::MatrixXd::Identity(5, 5);
    if (k > 0) F = test::linearise(still, then, since).F;
    const double weight = (k == 0 || k == kIntervals) ? 1.0 : (k % 2 == 1 ? 4.0 : 2.0);
    Q += weight * dt / (3.0 * kIntervals) * F * density * F.transpose();
  }
  return Q;
}

TEST(CoordinatedTurn, NoiseOfAccelerationIsExact) {
  for (const double rate : {0.0, 1e-4, 0.1, 0.24, 0.26, -1.0, 4.0}) {
    const CoordinatedTurn<> process{0.7, 0.0};
    const auto x = turning(12.0, -5.0, rate);
    EXPECT_LT(relative(test::linearise(process, x, 2.0).Q(), integrated_noise(process, x, 2.0)), 1e-9) << rate;
    composes(process, x, 1e-12);
  }
}

TEST(CoordinatedTurn, NoiseOfTurnRateIsExactButForThePosition) {
  const CoordinatedTurn<> process{0.0, 0.002};
  const auto x = turning(12.0, -5.0, 0.3);
  const Eigen::MatrixXd Q = test::linearise(process, x, 1.0).Q();
  const Eigen::MatrixXd exact = integrated_noise(process, x, 1.0);
  EXPECT_LT(relative(Q.bottomRightCorner<3, 3>(), exact.bottomRightCorner<3, 3>()), 1e-9);
  // One step overstates the position's variance by 20/12 (doc eq. 13); short steps compose to the truth.
  const Eigen::Matrix2d of_position = Q.topLeftCorner<2, 2>();
  const Eigen::Matrix2d exact_position = exact.topLeftCorner<2, 2>();
  EXPECT_NEAR(of_position.trace() / exact_position.trace(), 20.0 / 12.0, 0.02);
  Eigen::MatrixXd tenths;
  test::compose(process, x, 1.0, 20, tenths);
  EXPECT_LT(relative(tenths, exact), 0.01);
}

TEST(PlanarOdometry, IsWhatPlanarIncrementMeasures) {
  RandomStream random(12);
  for (int k = 0; k < 20; ++k) {
    const Pose x = test::Place<Pose>(test::kLocal, random).x;
    const PlanarDisplacement u{{random.normal(), random.normal()}, random.uniform(-3.0, 3.0)};
    const Pose y = test::next_state(PlanarOdometry{}, x, 0.1, ZeroNoise{}, u);
    ValuePrediction<double, 3> z;
    const PlanarIncrement<PlanarFrame> increment{Eigen::Vector2d(x.x.head<2>()), x.x[2]};
    ASSERT_TRUE(increment.predict(y, z));
    EXPECT_NEAR(z.value(0), u.translation_b_m[0], 1e-10);
    EXPECT_NEAR(z.value(1), u.translation_b_m[1], 1e-10);
    EXPECT_NEAR(z.value(2), u.turn_rad, 1e-12);
  }
}

TEST(Processes, GivePacketsWhatTheyGiveStates) {
  EXPECT_EQ((test::worst_packet_ulps<Planar>(NearlyConstantVelocity<2>{{0.3, 2.0}}, 0.5)), 0.0);
  EXPECT_EQ((test::worst_packet_ulps<Planar>(PiecewiseConstantAcceleration<2>{{0.3, 2.0}}, 0.5)), 0.0);
  EXPECT_EQ((test::worst_packet_ulps<Pose>(RandomWalk{kPlanarPosition, {0.3, 2.0}}, 0.5)), 0.0);
  EXPECT_LE((test::worst_packet_ulps<Turning>(CoordinatedTurn<>{0.3, 0.01}, 0.5)), 4.0);
  EXPECT_LE((test::worst_packet_ulps<Tilted>(AttitudeRandomWalk{{0.01, 0.02, 0.03}}, 0.5)), 4.0);
  Eigen::Matrix3d L;
  L << 0.1, 0.0, 0.0, 0.02, 0.2, 0.0, 0.003, 0.004, 0.01;
  EXPECT_LE((test::worst_packet_ulps<Pose>(PlanarOdometry{L}, 0.5, {{3.0, 1.0}, 0.4})), 4.0);
  EXPECT_LE((test::worst_packet_ulps<Turning>(
                JointProcess{CoordinatedTurn<>{0.3, 0.01}, RandomWalk{kPlanarPosition, {0.3, 2.0}}}, 0.5)),
            4.0);
}

TEST(Processes, MoveBlocksAsTheyMoveRoles) {
  using Base = LayoutState<PlanarFrame, Role<1, ClockBiasTag>>;
  ExtendedKalmanFilter<Base> layout({}, Eigen::Matrix<double, 1, 1>(1.0), 10, 4);
  const Eigen::Vector2d p(5.0, -3.0), v(1.0, 2.0);
  const Block<2> place = layout.join<2>(p, 4.0 * Eigen::Matrix2d::Identity(), "place");
  const Block<2> speed = layout.join<2>(v, 9.0 * Eigen::Matrix2d::Identity(), "speed");
  Planar x;
  x.x << p, v;
  ExtendedKalmanFilter<Planar> fixed(x, Eigen::Vector4d(4.0, 4.0, 9.0, 9.0).asDiagonal());
  for (int k = 0; k < 3; ++k) {
    ASSERT_EQ(layout.predict(NearlyConstantVelocity<2, Block<2>, Block<2>>{{0.3, 0.4}, place, speed}, 0.5),
              UpdateStatus::kAccepted);
    ASSERT_EQ(fixed.predict(NearlyConstantVelocity<2>{{0.3, 0.4}}, 0.5), UpdateStatus::kAccepted);
  }
  EXPECT_NEAR((layout.state().x().tail<4>() - fixed.state().x).norm(), 0.0, 1e-12);
  EXPECT_NEAR((layout.covariance().bottomRightCorner<4, 4>() - fixed.covariance()).norm(), 0.0, 1e-12);
  EXPECT_EQ(layout.covariance()(0, 0), 1.0);
}

TEST(Processes, RefuseNothingButNegativeDensitiesInTheFilter) {
  ExtendedKalmanFilter<Turning> filter(turning(1.0, 2.0, 0.1), Eigen::Matrix<double, 5, 5>::Identity());
  const Turning before = filter.state();
  EXPECT_EQ(filter.predict(CoordinatedTurn<>{-1.0, 0.1}, 1.0), UpdateStatus::kNonFinite);
  EXPECT_EQ(filter.predict(CoordinatedTurn<>{1.0, -0.1}, 1.0), UpdateStatus::kNonFinite);
  EXPECT_EQ(filter.predict(NearlyConstantVelocity<2>{{-1.0, 1.0}}, 1.0), UpdateStatus::kNonFinite);
  EXPECT_EQ(filter.state().x, before.x);
  EXPECT_EQ(filter.covariance(), (Eigen::Matrix<double, 5, 5>::Identity()));
}

}  // namespace
}  // namespace soopnav
