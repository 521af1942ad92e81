#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <vector>

#include "inertial/manoeuvre.hpp"
#include "process/process_battery.hpp"
#include "soopnav/geometry/gravity.hpp"
#include "soopnav/geometry/rotation.hpp"
#include "soopnav/inertial/coning_sculling.hpp"
#include "soopnav/inertial/strapdown_integrator.hpp"
#include "soopnav/inertial/strapdown_mechanization.hpp"

namespace soopnav::inertial {
namespace {

using State = StrapdownState<NedFrame>;
static_assert(ProcessModelFor<StrapdownMechanization<NedFrame>, State>);
static_assert(!ProcessModelFor<StrapdownMechanization<EnuFrame>, State>);
static_assert(State::kDim == 15);

double angle_between(const Eigen::Quaterniond& a, const Eigen::Quaterniond& b) {
  return 2.0 * std::asin(std::min(1.0, (a.conjugate() * b).vec().norm()));
}

// A cone of half angle `theta` at `frequency`: q = [cos(theta/2), sin(theta/2) cos wt, sin(theta/2) sin wt, 0].
Eigen::Quaterniond cone(double theta, double wt) {
  return {std::cos(theta / 2), std::sin(theta / 2) * std::cos(wt), std::sin(theta / 2) * std::sin(wt), 0.0};
}
// Its exact increments: w_b = (-w sin(theta) sin wt, w sin(theta) cos wt, -2 w sin²(theta/2)).
std::vector<ImuIncrement> coning(double theta, double frequency_hz, double rate_hz, int n) {
  const double w = kTwoPi * frequency_hz;
  std::vector<ImuIncrement> out;
  for (int k = 0; k < n; ++k) {
    const double a = w * k / rate_hz, b = w * (k + 1) / rate_hz;
    const double s = std::sin(theta / 2);
    out.push_back({{std::sin(theta) * (std::cos(b) - std::cos(a)), std::sin(theta) * (std::sin(b) - std::sin(a)),
                    -2.0 * s * s * (b - a)},
                   Eigen::Vector3d::Zero(),
                   1.0 / rate_hz});
  }
  return out;
}
double worst_coning_error(int previous, bool recursive) {
  const double theta = radians(1.0);
  std::vector<ImuIncrement> u = coning(theta, 10.0, 100.0, 200);
  if (recursive) {
    ConingSculling corrector(previous);
    for (ImuIncrement& one : u) one = corrector.correct(one);
  } else {
    ConingSculling::correct_all(u, previous);
  }
  Eigen::Quaterniond q = cone(theta, 0.0);
  double worst = 0.0;
  for (std::size_t k = 0; k < u.size(); ++k) {
    q = q * geometry::quaternion_from_rotation_vector(u[k].delta_theta_b);
    worst = std::max(worst, angle_between(q, cone(theta, kTwoPi * 0.1 * static_cast<double>(k + 1))));
  }
  return worst;
}

TEST(ConingSculling, FollowsAConeToAMicroradian) {
  EXPECT_GT(worst_coning_error(0, false), 1e-3);  // what there is to correct
  EXPECT_LT(worst_coning_error(1, false), 1.2e-4);
  EXPECT_LT(worst_coning_error(2, false), 1e-5);
  EXPECT_LT(worst_coning_error(3, false), 1e-6);
  EXPECT_LT(worst_coning_error(4, false), 1e-7);
  // The recursion knows nothing before its first sample: that one's 6.7e-6 rad stay, and no more.
  EXPECT_LT(worst_coning_error(4, true), 7e-6);
}

TEST(ConingSculling, TwoSamplesOfOneStep) {
  const double theta = radians(1.0);
  const auto fine = coning(theta, 10.0, 400.0, 800);
  const auto error = [&](bool correct) {
    Eigen::Quaterniond q = cone(theta, 0.0);
    for (std::size_t k = 0; k + 1 < fine.size(); k += 2) {
      const Eigen::Vector3d phi = correct ? ConingSculling::two_sample(fine[k], fine[k + 1]).delta_theta_b
                                          : Eigen::Vector3d(fine[k].delta_theta_b + fine[k + 1].delta_theta_b);
      q = q * geometry::quaternion_from_rotation_vector(phi);
    }
    return angle_between(q, cone(theta, 0.0));
  };
  EXPECT_GT(error(false), 3e-4);
  EXPECT_LT(error(true), 2e-6);
}

TEST(ConingSculling, ConstantRatesAreLeftAlone) {
  ConingSculling corrector;
  const ImuIncrement u{{1e-3, -2e-3, 3e-3}, {0.1, 0.2, -0.3}, 0.01};
  for (int k = 0; k < 8; ++k) {
    const ImuIncrement c = corrector.correct(u);
    EXPECT_LT((c.delta_theta_b - u.delta_theta_b).norm(), 1e-18);
    EXPECT_LT((c.delta_velocity_b - u.delta_velocity_b).norm(), 1e-16);
  }
  EXPECT_THROW(ConingSculling(5), std::invalid_argument);
  EXPECT_THROW(ConingSculling(-1), std::invalid_argument);
  ImuIncrement bad = u;
  bad.delta_theta_b[1] = std::nan("");
  EXPECT_TRUE(std::isnan(corrector.correct(bad).delta_theta_b[1]));
  EXPECT_TRUE(corrector.correct(u).all_finite());
}

TEST(ConingSculling, RotatedIncrementIsTheIntegralOfTheTurn) {
  const Eigen::Vector3d d(0.3, -0.1, 0.7);
  for (const double size : {0.0, 1e-9, 1e-3, 0.1, 0.19, 0.21, 1.0, 3.0}) {
    const Eigen::Vector3d phi = size * Eigen::Vector3d(1.0, 2.0, -2.0) / 3.0;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    constexpr int kSteps = 2000;
    for (int k = 0; k < kSteps; ++k) {
      sum += geometry::quaternion_from_rotation_vector((k + 0.5) / kSteps * phi) * d / kSteps;
    }
    EXPECT_LT((rotated_increment(phi, d) - sum).norm(), 1e-6 * size * size + 1e-13) << size;
    EXPECT_LT((IncrementRotation(phi).matrix(phi) * d - rotated_increment(phi, d)).norm(), 1e-15);
  }
}

struct Errors {
  double position_m, velocity_mps, attitude_rad;
};
// The moving frame's mechanisation along the manoeuvre, against truth.
Errors integrate_moving(double rate_hz, double end_s, bool sculling, NavigationState* end = nullptr) {
  const auto path = test::manoeuvre();
  auto u = path.imu_increments(rate_hz, 0.0, end_s);
  if (sculling) ConingSculling::correct_all(u);
  StrapdownIntegrator integrator(path.navigation_state(0.0));
  for (const ImuIncrement& one : u) EXPECT_EQ(integrator.step(one), IntegrationStatus::kIntegrated);
  const NavigationState truth = path.navigation_state(end_s);
  const NavigationState& got = integrator.state();
  if (end != nullptr) *end = got;
  const Eigen::Vector3d off = geometry::geodetic_to_ecef(got.place) - geometry::geodetic_to_ecef(truth.place);
  return {off.norm(), (got.v_n_mps - truth.v_n_mps).norm(), angle_between(got.q_n_b, truth.q_n_b)};
}

TEST(StrapdownIntegrator, ExactIncrementsComeBack) {
  const Errors e = integrate_moving(100.0, 60.0, true);
  EXPECT_LT(e.position_m, 1e-3);
  EXPECT_LT(e.velocity_mps, 1e-4);
  EXPECT_LT(e.attitude_rad, 1e-6);
  RecordProperty("position_um", std::to_string(1e6 * e.position_m));
  RecordProperty("attitude_nrad", std::to_string(1e9 * e.attitude_rad));
  // Without the corrections the bar is missed: this path needs them.
  const Errors without = integrate_moving(100.0, 60.0, false);
  EXPECT_GT(without.position_m, 5.0 * e.position_m);
}

template <class Frame>
void expect_agreement(geometry::LocalAxes axes) {
  const auto path = test::manoeuvre(axes);
  const StrapdownMechanization<Frame> process(test::kHome);
  auto u = path.imu_increments(500.0, 0.0, 60.0);
  ConingSculling::correct_all(u);
  StrapdownState<Frame> x;
  const auto m = path.at(0.0);
  x(kAttitude) << m.q_n_b.w(), m.q_n_b.vec();
  x(kVelocity) = m.v_n_mps;
  x(kPosition) = m.p_n_m;
  StrapdownIntegrator moving(path.navigation_state(0.0));
  for (const ImuIncrement& one : u) {
    x = test::next_state(process, x, one.dt_s, ZeroNoise{}, one);
    ASSERT_EQ(moving.step(one), IntegrationStatus::kIntegrated);
  }
  const auto& frame = process.frame();
  const NavigationState& state = moving.state();
  const Eigen::Vector3d p = frame.position_from_geodetic(state.place);
  EXPECT_LT((p - x(kPosition)).norm(), 2e-6);
  const Eigen::Matrix3d turn =
      frame.rotation_from_ecef() *
      geometry::rotation_ecef_to_ned(state.place.latitude_rad, state.place.longitude_rad).transpose();
  EXPECT_LT((turn * state.v_n_mps - x(kVelocity)).norm(), 1e-7);
  const Eigen::Quaterniond q(x.x[0], x.x[1], x.x[2], x.x[3]);
  EXPECT_LT(angle_between(geometry::quaternion_from_rotation(turn * state.q_n_b.toRotationMatrix()), q), 1e-10);
  EXPECT_LT((x(kPosition) - path.at(60.0).p_n_m).norm(), 1e-3);
}

TEST(StrapdownMechanization, AgreesWithTheMovingFrame) {
  expect_agreement<NedFrame>(geometry::LocalAxes::kNed);
  expect_agreement<EnuFrame>(geometry::LocalAxes::kEnu);
}

TEST(StrapdownMechanization, JacobianEqualsCentralDifferences) {
  RandomStream random(29);
  const ImuNoise noise{.gyro_density = 2e-3,
                       .accelerometer_density = 5e-2,
                       .gyro_bias_walk = 1e-4,
                       .accelerometer_bias_walk = 1e-3,
                       .gyro_bias_time_s = 100.0,
                       .accelerometer_bias_time_s = 30.0};
  for (const auto& process : {StrapdownMechanization<NedFrame>(test::kHome, noise)}) {
    for (const double dt : {0.01, 0.2}) {
      for (int k = 0; k < 10; ++k) {
        const test::Place<State> place(test::kLocal, random);
        const ImuIncrement u{dt * Eigen::Vector3d(random.normal(), random.normal(), random.normal()),
                             dt * Eigen::Vector3d(3.0 * random.normal(), 3.0 * random.normal(), -9.8), dt};
        Eigen::VectorXd scale = place.scale;
        scale.segment<3>(State::at(kGyroBias)).setConstant(0.3);
        EXPECT_LT(test::worst_transition_error(process, place.x, scale, dt, u), 2e-7) << dt << ", state " << k;
      }
    }
  }
}

TEST(StrapdownMechanization, GapJacobianEqualsCentralDifferences) {
  RandomStream random(31);
  const StrapdownGap gap{{0.01, 1.0}, {.gyro_bias_walk = 1e-4, .gyro_bias_time_s = 100.0}};
  for (int k = 0; k < 5; ++k) {
    const test::Place<State> place(test::kLocal, random);
    EXPECT_LT(test::worst_transition_error(gap, place.x, place.scale, 0.7), 1e-7) << k;
  }
}

TEST(StrapdownMechanization, TransitionFollowsGravity) {
  // A metre north turns gravity by 1/R: d g_N / d p_N = -g/R, and a metre down adds about 2 g / R (and w²).
  const StrapdownMechanization<NedFrame> process(test::kHome);
  const State x;
  const auto linear = test::linearise(process, x, 1.0, {Eigen::Vector3d::Zero(), {0.0, 0.0, -9.8}, 1.0});
  const int v = State::at(kVelocity), p = State::at(kPosition);
  const double rate = 9.8 / 6.378e6;
  EXPECT_NEAR(linear.F(v, p) / -rate, 1.0, 0.01);
  EXPECT_NEAR(linear.F(v + 1, p + 1) / -rate, 1.0, 0.01);
  EXPECT_NEAR(linear.F(v + 2, p + 2) / (2.0 * rate), 1.0, 0.01);
}

TEST(StrapdownMechanization, RefusesWhatDoesNotFit) {
  const StrapdownMechanization<NedFrame> process(test::kHome);
  ValueTransition<State> y{State{}};
  EXPECT_FALSE(process.propagate(State{}, ImuIncrement{{}, {}, 0.02}, 0.01, ZeroNoise{}, y));
  EXPECT_THROW(StrapdownMechanization<NedFrame>(test::kHome, {.gyro_density = -1.0}), std::invalid_argument);
  EXPECT_THROW(StrapdownMechanization<NedFrame>(test::kHome, {.gyro_bias_time_s = 0.0}), std::invalid_argument);
  EXPECT_THROW(StrapdownMechanization<NedFrame>({4.0, 0.0, 0.0}), std::invalid_argument);
}

TEST(StrapdownIntegrator, RestsOnTheTurningEarth) {
  // Increments of a body at rest: Earth rate and the support against gravity. Ten minutes in steps of 0.1 s.
  NavigationState start;
  start.place = test::kHome;
  StrapdownIntegrator integrator(start);
  const ImuIncrement u{0.1 * geometry::earth_rate_ned(start.place.latitude_rad),
                       -0.1 * geometry::normal_gravity_ned(start.place.latitude_rad, start.place.height_m), 0.1};
  for (int k = 0; k < 6000; ++k) ASSERT_EQ(integrator.step(u), IntegrationStatus::kIntegrated);
  EXPECT_LT(integrator.state().v_n_mps.norm(), 1e-6);
  EXPECT_LT(std::abs(integrator.state().place.height_m - start.place.height_m), 1e-4);
  EXPECT_LT(angle_between(integrator.state().q_n_b, start.q_n_b), 1e-9);
}

TEST(StrapdownIntegrator, RefusesWhatItCannotFollow) {
  NavigationState start;
  start.place = test::kHome;
  StrapdownIntegrator integrator(start);
  EXPECT_EQ(integrator.step({{std::nan(""), 0, 0}, {0, 0, 0}, 0.01}), IntegrationStatus::kNonFinite);
  EXPECT_EQ(integrator.step({{0, 0, 0}, {0, 0, 0}, 0.0}), IntegrationStatus::kTimeNotAdvancing);
  EXPECT_EQ(integrator.step({{0, 0, 0}, {0, 0, 0}, -1.0}), IntegrationStatus::kTimeNotAdvancing);
  EXPECT_EQ(integrator.state().v_n_mps.norm(), 0.0);
  start.place.latitude_rad = kPi / 2.0;
  EXPECT_EQ(StrapdownIntegrator(start).step({{0, 0, 0}, {0, 0, 0}, 0.01}), IntegrationStatus::kNearPole);
  start.place.latitude_rad = 2.0;
  EXPECT_THROW(StrapdownIntegrator{start}, std::invalid_argument);
  start.place = test::kHome;
  start.q_n_b = Eigen::Quaterniond(1.0, 1.0, 0.0, 0.0);
  EXPECT_THROW(StrapdownIntegrator{start}, std::invalid_argument);
  EXPECT_EQ(to_string(IntegrationStatus::kNearPole), "near a pole");
}

}  // namespace
}  // namespace soopnav::inertial
