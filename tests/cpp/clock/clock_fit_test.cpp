#include "soopnav/clock/clock_fit.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/clock/clock_simulator.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "support/nan.hpp"

namespace soopnav::clock {
namespace {

using ::soopnav::test::kNan;

std::vector<double> record(const Oscillator& clock, double dt_s, std::size_t n, std::uint64_t seed) {
  ClockSimulator simulator(clock.noise(), RandomStream(seed), {10.0, 0.3});
  std::vector<double> x;
  for (std::size_t i = 0; i < n; ++i) {
    x.push_back(simulator.state().bias_m / kSpeedOfLightMps);
    if (!simulator.advance(dt_s)) return {};
  }
  return x;
}

TEST(ClockFit, GivesBackTheCoefficients) {
  // The relative standard deviations at the crossover are 0.7 % and 1 % for 1e5 phases, so 10 % is ten of them.
  for (const Oscillator& clock : {Oscillator::tcxo(), Oscillator::gps(), Oscillator::crosby()}) {
    const auto x = record(clock, clock.crossover_s(), 100000, 5);
    const ClockFit fit = fit_clock(x, clock.crossover_s());
    EXPECT_NEAR(fit.clock.h0 / clock.h0, 1.0, 0.1);
    EXPECT_NEAR(fit.clock.h_minus_2 / clock.h_minus_2, 1.0, 0.1);
    EXPECT_EQ(fit.phase_noise_s, 0.0);
    EXPECT_LT(fit.sigma_h0 / clock.h0, 0.02);
    EXPECT_LT(fit.sigma_h_minus_2 / clock.h_minus_2, 0.03);
  }
}

TEST(ClockFitConsistency, ErrorsAreAsLargeAsItsSigmas) {
  // 60 fits of two coefficients: the mean squares have 60 degrees of freedom each, 0.4 ... 1.9 is left with 1e-5.
  const Oscillator clock = Oscillator::ocxo();
  for (const double dt : {0.05, 0.5, 4.0}) {
    double h0 = 0.0, h2 = 0.0;
    for (std::uint64_t seed = 0; seed < 60; ++seed) {
      const ClockFit fit = fit_clock(record(clock, dt, 2000, seed), dt);
      // Logarithms are nearer to normal.
      h0 += std::pow(std::log(fit.clock.h0 / clock.h0) * fit.clock.h0 / fit.sigma_h0, 2) / 60.0;
      h2 += std::pow(std::log(fit.clock.h_minus_2 / clock.h_minus_2) * fit.clock.h_minus_2 / fit.sigma_h_minus_2, 2) /
            60.0;
    }
    EXPECT_GT(h0, 0.4) << dt;
    EXPECT_LT(h0, 1.9) << dt;
    EXPECT_GT(h2, 0.4) << dt;
    EXPECT_LT(h2, 1.9) << dt;
  }
}

TEST(ClockFitCrosscheck, LikelihoodIsThatOfTheSecondDifferences) {
  // Without phase noise the second differences are a moving average, with the covariance of doc/clocks.md eq. 13; their
  // density differs from the filter's by the unit of the phases alone.
  const double dt = 2.0;
  const auto x = record(Oscillator::tcxo(), dt, 40, 9);
  const ClockFit fit = fit_clock(x, dt);
  const double sf = 0.5 * fit.clock.h0, sg = 2.0 * kPi * kPi * fit.clock.h_minus_2;
  const auto n = static_cast<Eigen::Index>(x.size()) - 2;
  Eigen::VectorXd z(n);
  Eigen::MatrixXd R = Eigen::MatrixXd::Zero(n, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const auto k = static_cast<std::size_t>(i);
    z[i] = x[k + 2] - 2.0 * x[k + 1] + x[k];
    R(i, i) = 2.0 * sf * dt + 2.0 / 3.0 * sg * dt * dt * dt;
    if (i > 0) R(i, i - 1) = R(i - 1, i) = -sf * dt + sg * dt * dt * dt / 6.0;
  }
  const Eigen::LLT<Eigen::MatrixXd> llt(R);
  const double log_det = 2.0 * llt.matrixL().toDenseMatrix().diagonal().array().log().sum();
  const double expected = -0.5 * (z.dot(llt.solve(z)) + log_det + static_cast<double>(n) * std::log(kTwoPi));
  EXPECT_NEAR(fit.log_likelihood, expected, 1e-6 * std::abs(expected));
}

TEST(ClockFit, GapsArePredictedAcross) {
  const Oscillator clock = Oscillator::tcxo();
  auto x = record(clock, 0.5, 30000, 6);
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (i < 3 || i % 7 == 2 || (i > 5000 && i < 6000)) x[i] = kNan;
  }
  const ClockFit fit = fit_clock(x, 0.5);
  EXPECT_NEAR(fit.clock.h0 / clock.h0, 1.0, 5.0 * fit.sigma_h0 / clock.h0);
  EXPECT_NEAR(fit.clock.h_minus_2 / clock.h_minus_2, 1.0, 5.0 * fit.sigma_h_minus_2 / clock.h_minus_2);
  EXPECT_LT(fit.sigma_h0 / clock.h0, 0.05);
}

TEST(ClockFit, PhaseNoiseIsToldFromTheClock) {
  const Oscillator clock = Oscillator::tcxo();
  const double dt = 0.5, sigma = 1e-10;
  auto x = record(clock, dt, 30000, 7);
  RandomStream random(8);
  for (double& value : x) value += random.normal(0.0, sigma);
  const ClockFit fit = fit_clock(x, dt, {.phase_noise = true});
  EXPECT_NEAR(fit.clock.h0 / clock.h0, 1.0, 5.0 * fit.sigma_h0 / clock.h0);
  EXPECT_NEAR(fit.clock.h_minus_2 / clock.h_minus_2, 1.0, 5.0 * fit.sigma_h_minus_2 / clock.h_minus_2);
  EXPECT_LT(fit.sigma_h0 / clock.h0, 0.1);
  EXPECT_NEAR(fit.phase_noise_s / sigma, 1.0, 0.1);
  EXPECT_GT(fit_clock(x, dt).clock.h0, 1.5 * clock.h0);  // and without it in the model it is taken for white frequency
}

TEST(ClockFit, SaysWhatTheRecordDoesNotShow) {
  const Oscillator clock{1e-20, 1e-30};  // the walk would need 16 million seconds
  const ClockFit fit = fit_clock(record(clock, 1.0, 5000, 3), 1.0);
  EXPECT_NEAR(fit.clock.h0 / clock.h0, 1.0, 0.1);
  EXPECT_LT(fit.clock.h_minus_2, 3.0 * fit.sigma_h_minus_2);
  EXPECT_GT(fit.sigma_h_minus_2, clock.h_minus_2);
  const ClockFit walk = fit_clock(record({0.0, 1e-22}, 1.0, 5000, 3), 1.0);
  EXPECT_NEAR(walk.clock.h_minus_2 / 1e-22, 1.0, 0.1);
  EXPECT_LT(walk.clock.h0, 4.0 * walk.sigma_h0);
  EXPECT_GT(walk.sigma_h0, 0.0);
  // Nor beside phase noise, to which white frequency noise could otherwise hide.
  auto x = record({0.0, 1e-22}, 1.0, 5000, 3);
  RandomStream random(4);
  for (double& value : x) value += random.normal(0.0, 1e-10);
  const ClockFit noisy = fit_clock(x, 1.0, {.phase_noise = true});
  EXPECT_NEAR(noisy.clock.h_minus_2 / 1e-22, 1.0, 0.25);
  EXPECT_NEAR(noisy.phase_noise_s / 1e-10, 1.0, 0.1);
  EXPECT_LT(noisy.clock.h0, 4.0 * noisy.sigma_h0);
}

TEST(ClockFit, RefusesWhatIsNoRecord) {
  const auto message = [](const std::vector<double>& x, double dt) -> std::string {
    try {
      static_cast<void>(fit_clock(x, dt));
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  const auto x = record(Oscillator::tcxo(), 1.0, 20, 1);
  EXPECT_EQ(message(x, 1.0), "");
  EXPECT_NE(message(x, -1.0).find("dt_s = -1"), std::string::npos);
  EXPECT_NE(message({1.0, 2.0, kNan, 4.0}, 1.0).find("got 3"), std::string::npos);
  EXPECT_NE(message(std::vector<double>(20, 1.0), 1.0).find("straight line"), std::string::npos);
  auto bad = x;
  bad[4] = -std::numeric_limits<double>::infinity();
  EXPECT_NE(message(bad, 1.0).find("phase_s[4]"), std::string::npos);
}

}  // namespace
}  // namespace soopnav::clock
