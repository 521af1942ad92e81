#include "soopnav/estimation/resampling.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

#include "soopnav/estimation/chi_square.hpp"

namespace soopnav {
namespace {

constexpr Resampling kUnbiased[] = {Resampling::kMultinomial, Resampling::kResidual, Resampling::kStratified,
                                    Resampling::kSystematic};

std::vector<std::uint32_t> draw(Resampling scheme, const std::vector<double>& weights, std::size_t count,
                                RandomStream& random) {
  std::vector<std::uint32_t> ancestors(count, 999999);
  EXPECT_TRUE(resample(scheme, weights, random, ancestors)) << to_string(scheme);
  return ancestors;
}

std::vector<double> offspring(const std::vector<std::uint32_t>& ancestors, std::size_t n) {
  std::vector<double> counts(n, 0.0);
  for (const std::uint32_t a : ancestors) counts.at(a) += 1.0;
  return counts;
}

TEST(Resampling, OneParticleIsItsOwnAncestor) {
  for (const Resampling scheme : kUnbiased) {
    RandomStream random(1);
    EXPECT_EQ(draw(scheme, {0.3}, 1, random), std::vector<std::uint32_t>{0});
    EXPECT_EQ(draw(scheme, {0.3}, 5, random), std::vector<std::uint32_t>(5, 0));
  }
}

TEST(Resampling, AllTheMassInOneParticle) {
  for (const Resampling scheme : kUnbiased) {
    for (const std::size_t n : {2U, 7U, 511U, 512U, 513U, 2000U}) {
      for (const std::size_t at : {std::size_t{0}, n / 2, n - 1}) {
        std::vector<double> weights(n, 0.0);
        weights[at] = 1e-300;
        RandomStream random(n);
        EXPECT_EQ(draw(scheme, weights, n, random), std::vector<std::uint32_t>(n, static_cast<std::uint32_t>(at)))
            << to_string(scheme) << " " << n << " " << at;
      }
    }
  }
}

TEST(Resampling, NoOffspringWithoutWeightAndAscendingOrder) {
  RandomStream random(3);
  for (const Resampling scheme : kUnbiased) {
    for (int run = 0; run < 60; ++run) {
      const auto n = static_cast<std::size_t>(random.uniform(1.0, 1600.0));
      std::vector<double> weights(n);
      for (double& w : weights) w = random.uniform() < 0.7 ? 0.0 : std::exp(20.0 * random.normal());
      weights[static_cast<std::size_t>(random.uniform() * static_cast<double>(n))] = 1.0;
      const auto count = static_cast<std::size_t>(random.uniform(1.0, 3000.0));
      const auto ancestors = draw(scheme, weights, count, random);
      EXPECT_TRUE(std::is_sorted(ancestors.begin(), ancestors.end()));
      for (const std::uint32_t a : ancestors) ASSERT_GT(weights.at(a), 0.0) << to_string(scheme);
    }
  }
}

TEST(Resampling, EqualWeightsKeepEveryParticle) {
  for (const std::size_t n : {1U, 3U, 10U, 512U, 777U, 5000U}) {
    std::vector<std::uint32_t> all(n);
    std::iota(all.begin(), all.end(), 0U);
    for (const Resampling scheme : {Resampling::kResidual, Resampling::kStratified, Resampling::kSystematic}) {
      RandomStream random(7);
      // Weights whose sums are exact, so that no boundary rounds.
      EXPECT_EQ(draw(scheme, std::vector<double>(n, 0.25), n, random), all) << to_string(scheme) << " " << n;
    }
  }
}

TEST(Resampling, RefusesWhatIsNoWeight) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  for (const std::vector<double>& weights :
       std::vector<std::vector<double>>{{}, {0.0, 0.0}, {1.0, -0.1}, {1.0, nan}, {nan, 1.0}, {inf, 1.0}, {-1.0}}) {
    for (const Resampling scheme : kUnbiased) {
      RandomStream random(1);
      std::vector<std::uint32_t> ancestors(3, 77);
      EXPECT_FALSE(resample(scheme, weights, random, ancestors));
      EXPECT_EQ(ancestors, std::vector<std::uint32_t>(3, 77));
      EXPECT_EQ(random.position(), 0U);
    }
  }
  RandomStream random(1);
  EXPECT_TRUE(resample(Resampling::kSystematic, std::vector<double>{1.0}, random, std::span<std::uint32_t>()));
  EXPECT_EQ(random.position(), 0U);
}

TEST(Resampling, NamesAreGiven) {
  EXPECT_EQ(to_string(Resampling::kResidual), "residual");
  EXPECT_EQ(to_string(static_cast<Resampling>(99)), "unknown");
}

// Offspring over many draws: the mean is N w within 4.5 sigma of its Monte-Carlo error for each of 12 particles and 4
// schemes (probability 3e-4 / 0.9 for 48 comparisons of 7e-6 each), sums are N, and the variances are ordered as theory
// has it.
struct Moments {
  std::vector<double> mean;
  std::vector<double> variance;
};
Moments moments(Resampling scheme, const std::vector<double>& weights, std::size_t count, int runs) {
  RandomStream random(static_cast<std::uint64_t>(scheme) + 40);
  Moments m{std::vector<double>(weights.size(), 0.0), std::vector<double>(weights.size(), 0.0)};
  for (int r = 0; r < runs; ++r) {
    const auto counts = offspring(draw(scheme, weights, count, random), weights.size());
    for (std::size_t i = 0; i < counts.size(); ++i) {
      m.mean[i] += counts[i] / runs;
      m.variance[i] += counts[i] * counts[i] / runs;
    }
  }
  for (std::size_t i = 0; i < weights.size(); ++i) m.variance[i] -= m.mean[i] * m.mean[i];
  return m;
}

const std::vector<double> kWeights = {0.01, 0.2, 0.03, 0.0, 0.11, 0.17, 0.002, 0.098, 0.13, 0.05, 0.12, 0.08};

TEST(Resampling, IsUnbiased) {
  constexpr int kRuns = 20000;
  constexpr std::size_t kCount = 20;
  const double total = std::accumulate(kWeights.begin(), kWeights.end(), 0.0);
  for (const Resampling scheme : kUnbiased) {
    const Moments m = moments(scheme, kWeights, kCount, kRuns);
    for (std::size_t i = 0; i < kWeights.size(); ++i) {
      const double expected = static_cast<double>(kCount) * kWeights[i] / total;
      const double sigma = std::sqrt(m.variance[i] / kRuns);
      EXPECT_NEAR(m.mean[i], expected, 5.0 * sigma + 1e-12) << to_string(scheme) << " " << i;
    }
  }
}

TEST(Resampling, MultinomialOffspringAreMultinomial) {
  // Chi-square over all offspring of many draws; the share of right generators beyond the bound is 1e-5.
  constexpr int kRuns = 3000;
  constexpr std::size_t kCount = 20;
  const double total = std::accumulate(kWeights.begin(), kWeights.end(), 0.0);
  const Moments m = moments(Resampling::kMultinomial, kWeights, kCount, kRuns);
  double chi_square = 0.0;
  double variance_error = 0.0;
  for (std::size_t i = 0; i < kWeights.size(); ++i) {
    const double p = kWeights[i] / total;
    if (p == 0.0) continue;
    const double expected = kRuns * kCount * p;
    chi_square += std::pow(m.mean[i] * kRuns - expected, 2) / expected;
    const double variance = static_cast<double>(kCount) * p * (1.0 - p);
    variance_error = std::max(variance_error, std::abs(m.variance[i] / variance - 1.0));
  }
  EXPECT_LT(chi_square, chi_square_upper_quantile(1e-5, 10.0));
  EXPECT_LT(variance_error, 0.25);  // rarest particle: 120 offspring in all, 5 sigma of its variance are 0.25 or less
}

TEST(Resampling, VariancesAreOrdered) {
  constexpr int kRuns = 4000;
  const Moments multinomial = moments(Resampling::kMultinomial, kWeights, 20, kRuns);
  const Moments residual = moments(Resampling::kResidual, kWeights, 20, kRuns);
  const Moments stratified = moments(Resampling::kStratified, kWeights, 20, kRuns);
  const auto sum = [](const Moments& m) { return std::accumulate(m.variance.begin(), m.variance.end(), 0.0); };
  EXPECT_LT(sum(residual), 0.6 * sum(multinomial));
  EXPECT_LT(sum(stratified), 0.6 * sum(multinomial));
  // Systematic: floor(N w) or one more, never anything else.
  RandomStream random(5);
  for (int r = 0; r < 500; ++r) {
    const auto counts = offspring(draw(Resampling::kSystematic, kWeights, 20, random), kWeights.size());
    for (std::size_t i = 0; i < counts.size(); ++i) {
      ASSERT_LE(std::abs(counts[i] - 20.0 * kWeights[i]), 1.0 + 1e-9) << i;
    }
  }
}

TEST(Resampling, NearestMixesNeighbours) {
  // What the listings do: particle i gets N (w_i + w_i+1) / 2, so a particle without weight lives on.
  std::vector<double> weights(1000);
  for (std::size_t i = 0; i < weights.size(); ++i) weights[i] = i % 2 == 0 ? 2.0 : 0.0;
  RandomStream random(2);
  double without = 0.0;
  for (const std::uint32_t a : draw(Resampling::kNearest, weights, 1000, random)) without += weights[a] == 0.0 ? 1 : 0;
  EXPECT_EQ(without, 0.0);  // equal sums: the first of them, which has the weight
  // Half of the particles, at random, share a twentieth of the weight.
  for (double& w : weights) w = random.uniform() < 0.5 ? 1.9 : 0.1;
  const auto light = [&weights](const std::vector<std::uint32_t>& ancestors) {
    return std::count_if(ancestors.begin(), ancestors.end(), [&](std::uint32_t a) { return weights[a] < 1.0; });
  };
  EXPECT_LT(light(draw(Resampling::kMultinomial, weights, 1000, random)), 100);  // 50 expected, sigma 7
  EXPECT_GT(light(draw(Resampling::kNearest, weights, 1000, random)), 150);      // 275 expected, sigma 20
}

}  // namespace
}  // namespace soopnav
