#include "soopnav/clock/two_state.hpp"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "process/process_battery.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/joint_process.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/layout_kalman_filter.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav::clock {
namespace {

using Clock = ComposedState<EcefFrame, Role<1, ClockBiasTag>, Role<1, ClockDriftTag>>;
static_assert(ProcessModelFor<TwoState<>, Clock>);
static_assert(std::same_as<decltype(TwoState{ClockNoise{}}), TwoState<>>);
static_assert(std::same_as<decltype(TwoState{ClockNoise{}, Block<1>{}, Block<1>{}}), TwoState<Block<1>, Block<1>>>);

constexpr ClockNoise kNoise{0.036, 0.141};

TEST(TwoState, HasTheTextbookCovariance) {
  const double dt = 0.7;
  const auto step = test::linearise(TwoState{kNoise}, Clock{}, dt);
  const double sf = kNoise.white_frequency_m2ps, sg = kNoise.frequency_walk_m2ps3;
  Eigen::Matrix2d F, Q;
  F << 1.0, dt, 0.0, 1.0;
  Q << sf * dt + sg * dt * dt * dt / 3.0, sg * dt * dt / 2.0, sg * dt * dt / 2.0, sg * dt;
  EXPECT_EQ(step.F, F);
  EXPECT_LT((step.Q() - Q).norm(), 1e-15);
}

TEST(TwoState, TenTenthsAreOneStep) {
  // Also where one of the densities is nothing.
  for (const ClockNoise& noise : {kNoise, ClockNoise{0.036, 0.0}, ClockNoise{0.0, 0.141}}) {
    Eigen::MatrixXd Q;
    const auto many = test::compose(TwoState{noise}, Clock{}, 1.0, 10, Q);
    const auto one = test::linearise(TwoState{noise}, Clock{}, 1.0);
    EXPECT_LT((many.F - one.F).norm(), 1e-14);
    EXPECT_LT((Q - one.Q()).norm(), 1e-14);
  }
}

TEST(TwoState, JacobianEqualsCentralDifferences) {
  RandomStream random(3);
  using Receiver = PositionVelocityClock<EnuFrame, 3>;
  for (const double dt : {0.02, 1.0, 30.0}) {
    const test::Place<Receiver> place(test::kLocal, random);
    EXPECT_LT(test::worst_transition_error(TwoState{kNoise}, place.x, place.scale, dt), 1e-7) << dt;
  }
}

TEST(TwoState, PacketsHaveTheBitsOfStates) {
  EXPECT_EQ((test::worst_packet_ulps<PositionVelocityClock<EnuFrame, 2>>(TwoState{kNoise}, 0.5)), 0.0);
}

TEST(TwoState, MovesTheClockOfASource) {
  using State = LayoutState<EcefFrame, Role<1, ClockBiasTag>, Role<1, ClockDriftTag>>;
  ExtendedKalmanFilter<State> filter({}, Eigen::Matrix2d::Identity(), 10, 4);
  const Block<1> bias = filter.join(100.0, 4.0, "bias");
  const Block<1> drift = filter.join(2.0, 1.0, "drift");
  const JointProcess both{TwoState{kNoise}, TwoState{kNoise, bias, drift}};
  ASSERT_EQ(filter.predict(both, 3.0), UpdateStatus::kAccepted);
  EXPECT_EQ(filter.state()(bias)[0], 106.0);
  EXPECT_EQ(filter.state()(drift)[0], 2.0);
  const auto P = filter.covariance();
  EXPECT_NEAR(P(2, 2), 4.0 + 9.0 + 0.036 * 3.0 + 0.141 * 9.0, 1e-12);
  EXPECT_NEAR(P(2, 3), 3.0 + 0.141 * 4.5, 1e-12);
  EXPECT_NEAR(P(0, 0), 1.0 + 9.0 + 0.036 * 3.0 + 0.141 * 9.0, 1e-12);
  EXPECT_EQ(P(0, 2), 0.0);  // independent noises
}

TEST(ClockNoise, FromOscillatorCoefficients) {
  // A temperature-compensated crystal oscillator: h0 2e-19 s, h-2 2e-20 Hz (Brown and Hwang, table 9.3).
  const ClockNoise noise = ClockNoise::from_allan(2e-19, 2e-20);
  EXPECT_NEAR(noise.white_frequency_m2ps, 8.98755e-3, 1e-8);
  EXPECT_NEAR(noise.frequency_walk_m2ps3, 3.54818e-2, 1e-6);
  const ClockNoise two = noise + ClockNoise{1.0, 2.0};
  EXPECT_EQ(two.white_frequency_m2ps, noise.white_frequency_m2ps + 1.0);
  EXPECT_EQ(two.frequency_walk_m2ps3, noise.frequency_walk_m2ps3 + 2.0);
}

TEST(ClockNoise, RefusesWhatIsNoDensity) {
  const auto message = [](double h0, double h_minus_2) -> std::string {
    try {
      static_cast<void>(ClockNoise::from_allan(h0, h_minus_2));
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_NE(message(-1.0, 0.0).find("h0"), std::string::npos);
  EXPECT_NE(message(0.0, -2.0).find("h_minus_2 = -2"), std::string::npos);
  EXPECT_NE(message(std::nan(""), 0.0), "");
  EXPECT_NE(message(0.0, std::numeric_limits<double>::infinity()), "");
  EXPECT_EQ(message(0.0, 0.0), "");
  for (const double tau : {0.0, -1.0, std::nan(""), std::numeric_limits<double>::infinity()}) {
    EXPECT_THROW(static_cast<void>(allan_deviation(kNoise, tau)), std::invalid_argument) << tau;
  }
}

TEST(AllanDeviation, IsThatOfTheOscillator) {
  const double h0 = 2e-19, h2 = 2e-20;
  for (const double tau : {0.1, 1.0, 10.0, 1000.0}) {
    const double expected = std::sqrt(h0 / (2.0 * tau) + 2.0 * kPi * kPi / 3.0 * h2 * tau);
    EXPECT_NEAR(allan_deviation(ClockNoise::from_allan(h0, h2), tau) / expected, 1.0, 1e-12) << tau;
  }
}

TEST(AllanDeviation, IsThatOfTheProcess) {
  // Two steps from a clock at rest: the variance of b2 - 2 b1 + b0 over 2 tau².
  for (const double tau : {0.1, 1.0, 30.0}) {
    Eigen::MatrixXd two;
    test::compose(TwoState{kNoise}, Clock{}, 2.0 * tau, 2, two);
    const auto one = test::linearise(TwoState{kNoise}, Clock{}, tau);
    // Cov(b2, b1) = (F Q)(bias, bias).
    const double variance = two(0, 0) - 4.0 * (one.F * one.Q())(0, 0) + 4.0 * one.Q()(0, 0);
    const double expected = allan_deviation(kNoise, tau) * kSpeedOfLightMps;
    EXPECT_NEAR(std::sqrt(variance / (2.0 * tau * tau)) / expected, 1.0, 1e-9) << tau;
  }
}

TEST(AllanDeviation, IsThatOfASimulatedClock) {
  // White frequency noise alone: neighbouring second differences are correlated by -1/2, so the mean square of n has a
  // relative variance of 3 / n, and its root a quarter of that. 4.2 standard deviations.
  const ClockNoise noise{0.5, 0.0};
  RandomStream random(7);
  Clock x;
  std::array<double, 3> b{};
  double sum = 0.0;
  const int n = 4000;
  for (int k = 0; k < n + 2; ++k) {
    const std::array<double, 2> w{random.normal(), random.normal()};
    x = test::next_state(TwoState{noise}, x, 1.0, w);
    b = {b[1], b[2], x.x[0]};
    if (k >= 2) sum += (b[2] - 2.0 * b[1] + b[0]) * (b[2] - 2.0 * b[1] + b[0]);
  }
  const double measured = std::sqrt(sum / (2.0 * n)) / kSpeedOfLightMps;
  EXPECT_NEAR(measured / allan_deviation(noise, 1.0), 1.0, 0.5 * 4.2 * std::sqrt(3.0 / n));
}

}  // namespace
}  // namespace soopnav::clock
