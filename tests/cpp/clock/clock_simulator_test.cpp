#include "soopnav/clock/clock_simulator.hpp"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/clock/deviation.hpp"
#include "soopnav/clock/oscillator.hpp"
#include "soopnav/core/constants.hpp"
#include "support/allocation_count.hpp"
#include "support/nan.hpp"

namespace soopnav::clock {
namespace {

constexpr ClockNoise kNoise{0.036, 0.141};
using ::soopnav::test::kNan;

TEST(ClockSimulator, SameSeedSameClock) {
  const std::vector<double> t{0.0, 0.1, 0.1, 5.0};
  std::vector<ClockState> a(4), b(4), other(4);
  simulate(kNoise, {3.0, 0.5}, t, RandomStream(4), a);
  simulate(kNoise, {3.0, 0.5}, t, RandomStream(4), b);
  simulate(kNoise, {3.0, 0.5}, t, RandomStream(5), other);
  EXPECT_EQ(a, b);
  EXPECT_NE(a[3], other[3]);
  EXPECT_EQ(a[0], (ClockState{3.0, 0.5}));
  EXPECT_EQ(a[1], a[2]);  // no time has passed
  // Without noise it runs straight.
  simulate({}, {3.0, 0.5}, t, RandomStream(4), a);
  EXPECT_DOUBLE_EQ(a[3].bias_m, 5.5);
}

TEST(ClockSimulatorConsistency, IrregularStepsHaveTheCovarianceOfTheirSum) {
  // 4000 clocks: a variance varies by 2.2 %, 9 % is four deviations of each of three numbers.
  const std::array<double, 4> t{0.0, 0.3, 0.35, 2.0};
  Eigen::Matrix2d sum = Eigen::Matrix2d::Zero();
  constexpr int kClocks = 4000;
  const RandomStream random(9);
  for (int i = 0; i < kClocks; ++i) {
    std::array<ClockState, 4> x;
    simulate(kNoise, {}, t, random.substream(static_cast<std::uint64_t>(i)), x);
    const Eigen::Vector2d v(x[3].bias_m, x[3].drift_mps);
    sum += v * v.transpose() / kClocks;
  }
  const double sf = kNoise.white_frequency_m2ps, sg = kNoise.frequency_walk_m2ps3;
  EXPECT_NEAR(sum(0, 0) / (sf * 2.0 + sg * 8.0 / 3.0), 1.0, 0.1);
  EXPECT_NEAR(sum(1, 1) / (sg * 2.0), 1.0, 0.1);
  EXPECT_NEAR(sum(0, 1) / (sg * 2.0), 1.0, 0.1);
  EXPECT_NEAR(sum(0, 0) / prediction_variance_m2(kNoise, 2.0), 1.0, 0.1);
}

TEST(ClockSimulatorConsistency, AllanDeviationIsThatOfTheModel) {
  const Oscillator clock = Oscillator::ocxo();
  std::vector<double> t(20000);
  for (std::size_t i = 0; i < t.size(); ++i) t[i] = 0.1 * static_cast<double>(i);
  std::vector<ClockState> x(t.size());
  simulate(clock.noise(), {}, t, RandomStream(2), x);
  std::vector<double> phase;
  for (const ClockState& s : x) phase.push_back(s.bias_m / kSpeedOfLightMps);
  const std::vector<std::size_t> factors{1, 4, 16, 64};
  for (const Deviation& d : phase_deviations(phase, 0.1, DeviationKind::kOverlappingAllan, factors,
                                             {.confidence = 0.99999, .noise = PowerLaw::kRandomWalkFrequency})) {
    // The walk's interval, the wider one, at either noise.
    const double model = allan_deviation(clock.noise(), d.tau_s);
    EXPECT_LT(d.lower, model) << d.tau_s;
    EXPECT_GT(d.upper, model) << d.tau_s;
    EXPECT_LT(d.upper / d.lower, 2.0);
  }
}

TEST(ClockSimulator, RefusesWhatIsNoClock) {
  EXPECT_THROW(ClockSimulator({-1.0, 0.0}, RandomStream{}), std::invalid_argument);
  EXPECT_THROW(ClockSimulator({0.0, kNan}, RandomStream{}), std::invalid_argument);
  EXPECT_THROW(ClockSimulator(kNoise, RandomStream{}, {kNan, 0.0}), std::invalid_argument);
  ClockSimulator clock(kNoise, RandomStream{1}, {1.0, 2.0});
  const ClockState before = clock.state();
  for (const double dt : {-1.0, kNan, std::numeric_limits<double>::infinity()}) EXPECT_FALSE(clock.advance(dt));
  EXPECT_EQ(clock.state(), before);
  std::vector<ClockState> out(3);
  try {
    simulate(kNoise, {}, std::vector<double>{0.0, 2.0, 1.0}, RandomStream{}, out);
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find("time_s[2] = 1"), std::string::npos);
  }
  EXPECT_THROW(simulate(kNoise, {}, std::vector<double>{0.0}, RandomStream{}, out), std::invalid_argument);
}

TEST(Oscillator, CoefficientsAndDensitiesAreOneThing) {
  const Oscillator crosby = Oscillator::crosby();
  EXPECT_NEAR(crosby.noise().white_frequency_m2ps, 0.036, 1e-15);
  EXPECT_NEAR(crosby.noise().frequency_walk_m2ps3, 0.141, 1e-15);
  const Oscillator steadiest = Oscillator::basestation();
  for (const Oscillator& clock :
       {Oscillator::tcxo(), Oscillator::ocxo(), Oscillator::csac(), Oscillator::gps(), crosby}) {
    EXPECT_GT(clock.h0, steadiest.h0);
    const double t = clock.crossover_s();
    EXPECT_NEAR(clock.noise().white_frequency_m2ps * t / (clock.noise().frequency_walk_m2ps3 * t * t * t), 1.0, 1e-12);
  }
  // What their sources state.
  EXPECT_NEAR(allan_deviation(Oscillator::csac().noise(), 1.0), 3e-10, 1e-12);
  EXPECT_NEAR(std::sqrt(allan_deviation(Oscillator::csac().noise(), 86400.0) *
                            allan_deviation(Oscillator::csac().noise(), 86400.0) -
                        9e-20 / 86400.0) /
                  1e-11,
              1.0, 1e-6);
  EXPECT_NEAR(allan_deviation(Oscillator::gps().noise(), 1.0), 3e-12, 1e-14);
  EXPECT_NEAR(Oscillator::gps().h_minus_1 * 2.0 * std::log(2.0), 25e-28, 1e-35);
  EXPECT_TRUE(std::isinf(Oscillator{}.crossover_s()));
}

TEST(PredictionVariance, GrowsFromTheCovariance) {
  Eigen::Matrix2d P;
  P << 4.0, -0.5, -0.5, 1.0;
  EXPECT_DOUBLE_EQ(prediction_variance_m2(kNoise, 0.0, P), 4.0);
  EXPECT_DOUBLE_EQ(prediction_variance_m2(kNoise, 3.0, P), 4.0 - 3.0 + 9.0 + 0.036 * 3.0 + 0.141 * 9.0);
  EXPECT_THROW(static_cast<void>(prediction_variance_m2(kNoise, -1.0)), std::invalid_argument);
  P(0, 0) = -1.0;
  EXPECT_THROW(static_cast<void>(prediction_variance_m2(kNoise, 1.0, P)), std::invalid_argument);
}

TEST(ClockNoAlloc, StepsAndRuns) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  const std::array<double, 3> t{0.0, 1.0, 2.0};
  std::array<ClockState, 3> x;
  ClockSimulator clock(kNoise, RandomStream(1));
  EXPECT_EQ(test::allocations_of([&] {
              simulate(kNoise, {}, t, RandomStream(2), x);
              EXPECT_TRUE(clock.advance(0.1));
              EXPECT_FALSE(clock.advance(kNan));
            }),
            0);
}

}  // namespace
}  // namespace soopnav::clock
