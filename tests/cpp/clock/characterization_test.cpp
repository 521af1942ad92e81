#include "soopnav/clock/characterization.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/clock/clock_group.hpp"
#include "soopnav/clock/clock_simulator.hpp"
#include "soopnav/clock/noise_bank.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "support/allocation_count.hpp"
#include "support/nan.hpp"

namespace soopnav::clock {
namespace {

using ::soopnav::test::kNan;

constexpr double kSigmaS = 5e-13;

// A basestation as stage 2 sees it: its clock and white noise of phases.
std::vector<double> phases(const Oscillator& clock, std::size_t n, std::uint64_t seed, double sigma_s = kSigmaS) {
  ClockSimulator simulator(clock.noise(), RandomStream(seed), {10.0, 0.3});
  RandomStream noise(seed, 1);
  std::vector<double> x;
  for (std::size_t i = 0; i < n; ++i) {
    x.push_back(simulator.state().bias_m / kSpeedOfLightMps + noise.normal(0.0, sigma_s));
    if (!simulator.advance(0.1)) return {};
  }
  return x;
}

PhaseModel one_clock(double sigma_s = kSigmaS) {
  PhaseModel model;
  model.covariance_s2[0] = sigma_s * sigma_s;
  return model;
}

// Two sources through one receiver: y = b_receiver - b_source.
PhaseModel two_sources() {
  PhaseModel model;
  model.channels = 2;
  model.clocks = 3;
  model.mixing = {1.0, -1.0, 0.0, 1.0, 0.0, -1.0};
  model.covariance_s2 = {kSigmaS * kSigmaS, 0.0, 0.0, kSigmaS * kSigmaS};
  return model;
}

std::vector<double> two_source_phases(std::size_t n, std::uint64_t seed) {
  const auto receiver = phases(Oscillator::ocxo(), n, seed, 0.0);
  const auto first = phases(Oscillator::basestation(), n, seed + 1);
  const auto second = phases(Oscillator::ocxo(), n, seed + 2);
  std::vector<double> y;
  for (std::size_t k = 0; k < n; ++k) {
    y.push_back(receiver[k] - first[k]);
    y.push_back(receiver[k] - second[k]);
  }
  return y;
}

template <class Body>
void refuses(const Body& body, const std::string& words) {
  try {
    body();
    FAIL() << "not refused: " << words;
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find(words), std::string::npos) << error.what();
  }
}

TEST(Characterization, BothStartsFindTheNoise) {
  // Three standard deviations of ln h (the bound's are 0.21 and 0.26) and ten of what two maxima may differ by.
  const Oscillator truth = Oscillator::basestation();
  const PhaseLikelihood likelihood(phases(truth, 2400, 3), one_clock());
  const std::array<std::size_t, 1> which{0};
  std::array<CharacterizationResult, 2> found;
  for (std::size_t i = 0; i < 2; ++i) {
    const double factor = i == 0 ? 100.0 : 0.01;
    const std::array<Oscillator, 1> start{Oscillator{factor * truth.h0, factor * truth.h_minus_2}};
    found[i] = characterize(likelihood, start, which, false);
    EXPECT_TRUE(found[i].best.converged);
    EXPECT_NEAR(std::log(found[i].best.clocks[0].h0 / truth.h0), 0.0, 0.7);
    EXPECT_NEAR(std::log(found[i].best.clocks[0].h_minus_2 / truth.h_minus_2), 0.0, 0.9);
    EXPECT_TRUE(found[i].identifiable[0]);
    EXPECT_TRUE(found[i].identifiable[1]);
    EXPECT_FALSE(found[i].jumped);
  }
  EXPECT_NEAR(found[0].best.log_likelihood, found[1].best.log_likelihood, 1e-4);
}

TEST(Characterization, ScoreIsTheLikelihoodsDerivative) {
  auto y = two_source_phases(300, 11);
  y[2 * 100] = kNan;  // an epoch that is skipped
  const PhaseLikelihood likelihood(y, two_sources());
  EXPECT_EQ(likelihood.skipped(), 1U);
  const std::array<Oscillator, 3> clocks{Oscillator::ocxo(), Oscillator::basestation(), Oscillator{3e-24, 2e-25}};
  const std::array<std::size_t, 3> all{0, 1, 2};
  const PhaseScore at = likelihood.evaluate(clocks, all);
  EXPECT_DOUBLE_EQ(at.log_likelihood, likelihood(clocks));
  for (std::size_t i = 0; i < 6; ++i) {
    std::array<double, 2> sides{};
    for (std::size_t s = 0; s < 2; ++s) {
      auto moved = clocks;
      double& h = i % 2 == 0 ? moved[i / 2].h0 : moved[i / 2].h_minus_2;
      h *= std::exp(s == 0 ? -1e-4 : 1e-4);
      sides[s] = likelihood(moved);
    }
    EXPECT_NEAR((sides[1] - sides[0]) / 2e-4, at.score[i], 1e-4 * (1.0 + std::abs(at.score[i]))) << i;
    EXPECT_GT(at.information[i * 6 + i], 0.0);
    for (std::size_t j = 0; j < i; ++j) EXPECT_EQ(at.information[i * 6 + j], at.information[j * 6 + i]);
  }
}

TEST(Characterization, ConstantsAndDriftsDoNotMatter) {
  auto y = two_source_phases(200, 21);
  const PhaseModel model = two_sources();
  const std::array<Oscillator, 3> clocks{Oscillator::ocxo(), Oscillator::basestation(), Oscillator::ocxo()};
  const double before = PhaseLikelihood(y, model)(clocks);
  for (std::size_t k = 0; k < 200; ++k) {
    y[2 * k] += 1e-6 + 1e-9 * static_cast<double>(k);
    y[2 * k + 1] -= 3e-7;
  }
  // Phases of 1e-6 s carry 2e-22 s of rounding beside noise of 5e-13.
  EXPECT_NEAR(PhaseLikelihood(y, model)(clocks), before, 1e-5);
}

TEST(Characterization, ABankHasThatLikelihood) {
  auto y = two_source_phases(400, 31);
  y[2 * 57 + 1] = kNan;
  const PhaseModel model = two_sources();
  const std::vector<Oscillator> candidates{Oscillator::ocxo(), Oscillator::basestation(), Oscillator::ocxo(),
                                           Oscillator::ocxo(), Oscillator::ocxo(),        Oscillator::basestation()};
  NoiseBank bank(model, candidates);
  EXPECT_DOUBLE_EQ(bank.weights()[0], 0.5);
  std::size_t used = 0;
  const long before = test::allocation_count;
  for (std::size_t k = 0; k < 400; ++k) used += bank.push(std::span<const double>(y).subspan(2 * k, 2)) ? 1U : 0U;
  if (test::kAllocationsCounted) {
    EXPECT_EQ(test::allocation_count, before);
  }
  EXPECT_EQ(used, 399U);
  EXPECT_EQ(bank.innovations(), 397U);
  const PhaseLikelihood likelihood(y, model);
  for (std::size_t i = 0; i < 2; ++i) {
    const double expected = likelihood(std::span<const Oscillator>(candidates).subspan(3 * i, 3));
    EXPECT_NEAR(bank.log_likelihoods()[i], expected, 1e-6) << i;
  }
  EXPECT_NEAR(bank.weights()[0] + bank.weights()[1], 1.0, 1e-12);
  EXPECT_FALSE(bank.push(std::array<double, 1>{0.0}));
  EXPECT_FALSE(bank.push(std::array<double, 2>{0.0, std::numeric_limits<double>::infinity()}));
}

TEST(Characterization, AHugePhaseLeavesABankAsItWas) {
  const auto y = phases(Oscillator::basestation(), 200, 32);
  const std::vector<Oscillator> candidates{Oscillator::basestation(), Oscillator::ocxo()};
  NoiseBank clean(one_clock(), candidates), dirty(one_clock(), candidates);
  EXPECT_FALSE(dirty.push(std::array<double, 1>{1e200}));  // nor does the record start there
  for (std::size_t k = 0; k < y.size(); ++k) {
    const bool bad = k == 50 || k == 120;
    const std::array<double, 1> z{bad ? (k == 50 ? 1e200 : -1e60) : y[k]};
    EXPECT_EQ(dirty.push(z), !bad);
    static_cast<void>(clean.push(std::array<double, 1>{bad ? kNan : y[k]}));
  }
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_TRUE(std::isfinite(dirty.log_likelihoods()[i]));
    EXPECT_DOUBLE_EQ(dirty.weights()[i], clean.weights()[i]);
  }
}

TEST(Characterization, WeightsStayWhereNoLikelihoodIsFinite) {
  // Noise this large has squares that overflow: neither candidate has a likelihood.
  const std::vector<Oscillator> candidates{{1e290, 1e280}, {2e290, 2e280}};
  NoiseBank bank(one_clock(), candidates, std::array<double, 2>{3.0, 1.0});
  for (const double z : phases(Oscillator::ocxo(), 20, 33)) static_cast<void>(bank.push(std::array<double, 1>{z}));
  EXPECT_EQ(bank.log_likelihoods()[0], -std::numeric_limits<double>::infinity());
  EXPECT_NEAR(bank.weights()[0], 0.75, 1e-12);
  EXPECT_NEAR(bank.weights()[1], 0.25, 1e-12);
}

TEST(Characterization, AJumpIsSeen) {
  auto y = phases(Oscillator::basestation(), 2400, 41);
  for (std::size_t k = 1200; k < y.size(); ++k) y[k] += 3e-10;  // half a cycle at L1
  const PhaseLikelihood likelihood(y, one_clock());
  const std::array<Oscillator, 1> start{};
  const auto found = characterize(likelihood, start, std::array<std::size_t, 1>{0});
  EXPECT_TRUE(found.jumped);
  EXPECT_EQ(found.largest_at, 1200U);
}

TEST(Characterization, WhatIsNotThereIsNotIdentifiable) {
  // Phases' own noise alone: h ends near the least that the search looks at.
  const PhaseLikelihood likelihood(phases({1e-40, 1e-42}, 600, 51), one_clock());
  const std::array<Oscillator, 1> start{};
  const auto found = characterize(likelihood, start, std::array<std::size_t, 1>{0});
  EXPECT_FALSE(found.identifiable[0]);
  EXPECT_FALSE(found.identifiable[1]);
  EXPECT_GT(found.direction_sigma.front(), found.direction_sigma.back() * 0.999);
}

TEST(ClockGroup, FollowsTheClocksAndSaysHowWell) {
  // Full rank: satellites tell the receiver's clock, the source's follows. Errors over stated sigmas, two seeds.
  PhaseModel model;
  model.channels = 2;
  model.clocks = 2;
  model.mixing = {1.0, 0.0, 1.0, -1.0};
  model.covariance_s2 = {kSigmaS * kSigmaS, 0.0, 0.0, kSigmaS * kSigmaS};
  const std::array<Oscillator, 2> clocks{Oscillator::ocxo(), Oscillator::basestation()};
  const std::size_t n = 1000;
  const auto receiver = phases(clocks[0], n, 61, 0.0);
  const auto source = phases(clocks[1], n, 62, 0.0);
  RandomStream noise(63);
  std::vector<double> y;
  for (std::size_t k = 0; k < n; ++k) {
    y.push_back(receiver[k] + noise.normal(0.0, kSigmaS));
    y.push_back(receiver[k] - source[k] + noise.normal(0.0, kSigmaS));
  }
  y[2 * 500] = kNan;
  const ClockGroupRun run = ClockGroup(model, clocks).run(y);
  double squares = 0.0;
  double filtered = 0.0;
  for (std::size_t k = 10; k < n; ++k) {
    squares += std::pow((run.bias_s[2 * k] - receiver[k]) / run.sigma_s[2 * k], 2) / static_cast<double>(n - 10);
    filtered +=
        std::pow((run.filtered_s[2 * k] - receiver[k]) / run.filtered_sigma_s[2 * k], 2) / static_cast<double>(n - 10);
    ASSERT_LE(run.sigma_s[2 * k], 1.0001 * run.filtered_sigma_s[2 * k]) << k;
  }
  EXPECT_NEAR(squares, 1.0, 0.3);
  EXPECT_NEAR(filtered, 1.0, 0.3);
  // The smoother's error has the Allan variance of white noise of its sigma at one step, less what neighbours share.
  const std::array<std::size_t, 1> factors{1};
  const auto variance = ClockGroup(model, clocks).error_allan_variance(0, factors, n);
  EXPECT_GT(variance[0], 0.0);
  EXPECT_LT(variance[0], 3.0 * std::pow(run.sigma_s[2 * 700] / 0.1, 2));
}

TEST(ClockGroup, TheIterationLosesOneNoise) {
  const Oscillator truth = Oscillator::basestation();
  const auto y = phases(truth, 2400, 71);
  for (const auto analysis : {NoiseAnalysis::kIncrements, NoiseAnalysis::kAllanFit}) {
    const std::array<Oscillator, 1> start{Oscillator{100.0 * truth.h0, 100.0 * truth.h_minus_2}};
    const auto turns = iterate_noise(y, one_clock(), start, std::array<std::size_t, 1>{0}, analysis, 20);
    ASSERT_EQ(turns.size(), 21U);
    EXPECT_EQ(turns.front(), start[0]);
    EXPECT_LT(std::min(turns.back().h0 / truth.h0, turns.back().h_minus_2 / truth.h_minus_2), 0.1);
  }
}

TEST(Characterization, Refusals) {
  const auto y = phases(Oscillator::ocxo(), 20, 81);
  const std::array<Oscillator, 1> clock{Oscillator::ocxo()};
  refuses([&] { PhaseLikelihood(y, one_clock(0.0)); }, "phase noise");
  refuses([&] { PhaseLikelihood(std::vector<double>(y.begin(), y.begin() + 7), one_clock()); }, "at least 8");
  auto broken = y;
  broken[3] = std::numeric_limits<double>::infinity();
  refuses([&] { PhaseLikelihood(broken, one_clock()); }, "phase_s[3]");
  broken[3] = 1e160;
  refuses([&] { PhaseLikelihood(broken, one_clock()); }, "phase_s[3] = 1e+160");
  refuses([&] { static_cast<void>(ClockGroup(one_clock(), clock).run(broken)); }, "phase_s[3] = 1e+160");
  PhaseModel model = one_clock();
  for (const double dt_s : {0.0, 1e-200, 1e200, kNan}) {
    model.dt_s = dt_s;
    refuses([&] { check_model(model); }, "dt_s = ");
  }
  for (const double sigma : {1e-200, 1e-60, 1e60, 1e200})
    refuses([&] { check_model(one_clock(sigma)); }, "phase noise");
  model = one_clock();
  model.mixing[0] = 0.0;
  refuses([&] { check_model(model); }, "sees no clock");
  model = one_clock();
  model.channels = 4;
  refuses([&] { check_model(model); }, "channels");
  model = two_sources();
  model.covariance_s2[1] = 1e-25;
  refuses([&] { check_model(model); }, "symmetric");
  const PhaseLikelihood likelihood(y, one_clock());
  refuses([&] { static_cast<void>(likelihood(std::vector<Oscillator>(2))); }, "clocks: 1 expected");
  refuses([&] { static_cast<void>(likelihood(std::array<Oscillator, 1>{Oscillator{-1.0, 0.0}})); }, "h0");
  refuses([&] { static_cast<void>(characterize(likelihood, clock, {})); }, "at least one clock");
  refuses([&] { static_cast<void>(characterize(likelihood, clock, std::array<std::size_t, 2>{0, 0})); }, "twice");
  refuses([&] { static_cast<void>(characterize(likelihood, clock, std::array<std::size_t, 1>{1})); }, "clock 1 of 1");
  refuses([&] { NoiseBank(one_clock(), {}); }, "candidates");
  refuses([&] { NoiseBank(one_clock(), clock, std::array<double, 1>{0.0}); }, "prior");
  refuses([&] { NoiseBank(one_clock(), clock, std::array<double, 2>{1.0, 1.0}); }, "prior: 1 weights");
  model = two_sources();
  model.mixing = {1.0, 0.0, 0.0, 1.0, 0.0, 0.0};
  const std::array<Oscillator, 3> three{};
  refuses([&] { ClockGroup(model, three); }, "dependent");
  const ClockGroup group(one_clock(), clock);
  refuses([&] { static_cast<void>(group.run(std::vector<double>(5, kNan))); }, "2 whole");
  refuses([&] { static_cast<void>(group.error_allan_variance(0, std::array<std::size_t, 1>{20}, 10)); }, "factors: 20");
  refuses([&] { static_cast<void>(group.error_allan_variance(0, std::array<std::size_t, 1>{5}, 10)); }, "factors: 5");
  EXPECT_GT(group.error_allan_variance(0, std::array<std::size_t, 1>{5}, 11)[0], 0.0);
  const std::array<std::size_t, 1> which{0};
  refuses(
      [&] {
        static_cast<void>(
            iterate_noise(std::span<const double>(y).first(7), one_clock(), clock, which, NoiseAnalysis::kAllanFit, 1));
      },
      "8 whole epochs expected, got 7");
}

}  // namespace
}  // namespace soopnav::clock
