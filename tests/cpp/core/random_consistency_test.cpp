// The distributions. Seeds are fixed; each bound says how often a right generator with a random seed would break it.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "soopnav/core/random.hpp"

namespace soopnav {
namespace {

constexpr std::size_t kDraws = 1'000'000;

double normal_cdf(double x) { return 0.5 * std::erfc(-x / std::sqrt(2.0)); }

// Moments 1 to 4 within five of their standard deviations (6e-7 each), Kolmogorov's distance below the 1e-6 quantile
// (sqrt(n) D = 2.69), draws beyond four sigma within five standard deviations of their number.
template <class Real>
void expect_standard_normal(std::vector<Real>& draws) {
  const auto n = static_cast<double>(draws.size());
  double moment[5] = {};
  double beyond = 0.0;
  for (const Real draw : draws) {
    const auto x = static_cast<double>(draw);
    double power = x;
    for (int k = 1; k <= 4; ++k, power *= x) moment[k] += power / n;
    beyond += std::abs(x) > 4.0 ? 1.0 : 0.0;
  }
  EXPECT_LT(std::abs(moment[1]), 5.0 * std::sqrt(1.0 / n));
  EXPECT_LT(std::abs(moment[2] - 1.0), 5.0 * std::sqrt(2.0 / n));
  EXPECT_LT(std::abs(moment[3]), 5.0 * std::sqrt(15.0 / n));
  EXPECT_LT(std::abs(moment[4] - 3.0), 5.0 * std::sqrt(96.0 / n));
  const double expected_beyond = 2.0 * n * normal_cdf(-4.0);
  EXPECT_LT(std::abs(beyond - expected_beyond), 5.0 * std::sqrt(expected_beyond));

  double correlation = 0.0;  // of neighbours, and of those a pair apart
  double pair_correlation = 0.0;
  for (std::size_t i = 2; i < draws.size(); ++i) {
    correlation += static_cast<double>(draws[i]) * static_cast<double>(draws[i - 1]);
    pair_correlation += static_cast<double>(draws[i]) * static_cast<double>(draws[i - 2]);
  }
  EXPECT_LT(std::abs(correlation), 5.0 * std::sqrt(n));
  EXPECT_LT(std::abs(pair_correlation), 5.0 * std::sqrt(n));

  std::sort(draws.begin(), draws.end());
  double distance = 0.0;
  for (std::size_t i = 0; i < draws.size(); ++i) {
    const double cdf = normal_cdf(static_cast<double>(draws[i]));
    distance = std::max({distance, cdf - static_cast<double>(i) / n, static_cast<double>(i + 1) / n - cdf});
  }
  EXPECT_LT(distance, 2.69 / std::sqrt(n));
}

TEST(RandomConsistency, DoubleNormals) {
  std::vector<double> draws(kDraws);
  RandomStream(2026).fill_normal(std::span(draws));
  expect_standard_normal(draws);
}

TEST(RandomConsistency, FloatNormals) {
  std::vector<float> draws(kDraws);
  RandomStream(2026).fill_normal(std::span(draws));
  expect_standard_normal(draws);
}

// First draws of many substreams: what a Monte-Carlo campaign sees.
TEST(RandomConsistency, NormalsAcrossSubstreams) {
  constexpr std::size_t kStreams = 100'000;
  const RandomStream campaign(7);
  std::vector<double> draws(kStreams);
  for (std::size_t i = 0; i < kStreams; ++i) draws[i] = campaign.substream(i).normal();
  expect_standard_normal(draws);
}

// Chi-square of 1000 cells: mean 999, standard deviation 44.7; within six (2e-9 for a normal, 1e-7 for its skew).
TEST(RandomConsistency, UniformsFillTheirCells) {
  constexpr std::size_t kCells = 1000;
  std::vector<double> draws(kDraws);
  RandomStream(5).fill_uniform(draws);
  std::vector<double> count(kCells);
  for (const double u : draws) count[static_cast<std::size_t>(u * static_cast<double>(kCells))] += 1.0;
  const double expected = static_cast<double>(kDraws) / static_cast<double>(kCells);
  double chi_square = 0.0;
  for (const double c : count) chi_square += (c - expected) * (c - expected) / expected;
  EXPECT_NEAR(chi_square, 999.0, 6.0 * std::sqrt(2.0 * 999.0));
}

// Every bit of the words is one in half the draws, within five standard deviations.
TEST(RandomConsistency, BitsAreFair) {
  constexpr int kWords = 100'000;
  RandomStream random(6);
  RandomStream random_32(6);
  std::vector<double> ones(96);
  for (int i = 0; i < kWords; ++i) {
    const std::uint64_t word = random.next_u64();
    const std::uint32_t word_32 = random_32.next_u32();
    for (unsigned bit = 0; bit < 64; ++bit) ones[bit] += static_cast<double>((word >> bit) & 1U);
    for (unsigned bit = 0; bit < 32; ++bit) ones[64 + bit] += static_cast<double>((word_32 >> bit) & 1U);
  }
  for (const double count : ones) EXPECT_NEAR(count, kWords / 2.0, 5.0 * std::sqrt(kWords / 4.0));
}

// Power and circularity of complex noise, five standard deviations each.
TEST(RandomConsistency, ComplexNormalsAreCircular) {
  constexpr double kVariance = 0.02;
  std::vector<Cf32> draws(kDraws);
  RandomStream(8).fill_complex_normal(draws, kVariance);
  const auto n = static_cast<double>(kDraws);
  double power = 0.0;
  std::complex<double> pseudo = 0.0;
  std::complex<double> mean = 0.0;
  for (const Cf32 draw : draws) {
    const std::complex<double> x(draw);
    power += std::norm(x) / n;
    pseudo += x * x / n;
    mean += x / n;
  }
  EXPECT_NEAR(power, kVariance, 5.0 * kVariance / std::sqrt(n));
  EXPECT_LT(std::abs(pseudo), 5.0 * kVariance * std::sqrt(2.0 / n));
  EXPECT_LT(std::abs(mean), 5.0 * std::sqrt(kVariance / n));
}

}  // namespace
}  // namespace soopnav
