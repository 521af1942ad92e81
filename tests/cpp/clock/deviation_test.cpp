#include "soopnav/clock/deviation.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "support/nan.hpp"

namespace soopnav::clock {
namespace {

using ::soopnav::test::kNan;
constexpr std::array kKinds{DeviationKind::kAllan,         DeviationKind::kOverlappingAllan,
                            DeviationKind::kModifiedAllan, DeviationKind::kTime,
                            DeviationKind::kHadamard,      DeviationKind::kOverlappingHadamard};

// The test suite of NIST SP 1065, section 12.4: 1000 frequencies of a linear congruential generator.
std::vector<double> nbs14() {
  std::vector<double> y;
  std::int64_t n = 1234567890;
  for (int i = 0; i < 1000; ++i, n = 16807 * n % 2147483647) y.push_back(static_cast<double>(n) / 2147483647.0);
  return y;
}

std::vector<double> phase_of(const std::vector<double>& y) {
  std::vector<double> x{0.0};
  for (const double f : y) x.push_back(x.back() + f);
  return x;
}

std::vector<double> values(const std::vector<Deviation>& d) {
  std::vector<double> out;
  for (const auto& one : d) out.push_back(one.deviation);
  return out;
}

std::vector<double> noise(std::size_t n, std::uint64_t seed) {
  std::vector<double> out(n);
  RandomStream(seed).fill_normal(std::span<double>(out));
  return out;
}

TEST(DeviationCrosscheck, TableOfSp1065) {
  // Table 31, seven digits printed; in the order of kKinds.
  const std::vector<std::array<double, 3>> published{
      {0.2922319, 0.09965736, 0.03897804}, {0.2922319, 0.09159953, 0.03241343}, {0.2922319, 0.06172376, 0.02170921},
      {0.1687202, 0.3563623, 1.253382},    {0.2943883, 0.1052754, 0.0391086},   {0.2943883, 0.09581083, 0.03237638}};
  const std::vector<std::size_t> factors{1, 10, 100};
  const auto y = nbs14();
  for (std::size_t kind = 0; kind < kKinds.size(); ++kind) {
    const auto of_y = frequency_deviations(y, 1.0, kKinds[kind], factors);
    const auto of_x = phase_deviations(phase_of(y), 1.0, kKinds[kind], factors);
    ASSERT_EQ(of_y.size(), 3U);
    for (std::size_t i = 0; i < 3; ++i) {
      EXPECT_NEAR(of_y[i].deviation / published[kind][i], 1.0, 1e-6) << kind << " " << i;
      EXPECT_NEAR(of_x[i].deviation / of_y[i].deviation, 1.0, 1e-11) << kind << " " << i;
      EXPECT_EQ(of_x[i].count, of_y[i].count);
    }
  }
}

TEST(DeviationCrosscheck, NinePointsOfSp1065) {
  const std::vector<double> y{892, 809, 823, 798, 671, 644, 883, 903, 677};
  const std::vector<std::array<double, 2>> published{{91.22945, 115.8082}, {91.22945, 85.95287}, {91.22945, 74.78849},
                                                     {52.67135, 86.35831}, {70.80607, 116.7980}, {70.80607, 85.61487}};
  const std::vector<std::size_t> factors{1, 2};
  for (std::size_t kind = 0; kind < kKinds.size(); ++kind) {
    const auto d = values(frequency_deviations(y, 1.0, kKinds[kind], factors));
    for (std::size_t i = 0; i < 2; ++i) EXPECT_NEAR(d[i] / published[kind][i], 1.0, 5e-7) << kind << " " << i;
  }
}

TEST(Deviation, CountsItsTerms) {
  const auto factors = averaging_factors(1001, DeviationKind::kOverlappingAllan, TauSpacing::kOctave);
  EXPECT_EQ(factors, (std::vector<std::size_t>{1, 2, 4, 8, 16, 32, 64, 128, 256}));
  const auto d = frequency_deviations(nbs14(), 2.0, DeviationKind::kOverlappingAllan, factors);
  const std::array<std::size_t, 9> counts{999, 997, 993, 985, 969, 937, 873, 745, 489};
  for (std::size_t i = 0; i < 9; ++i) EXPECT_EQ(d[i].count, counts[i]);
  EXPECT_EQ(d[2].tau_s, 8.0);
  EXPECT_EQ(averaging_factors(1001, DeviationKind::kAllan, TauSpacing::kDecade),
            (std::vector<std::size_t>{1, 2, 4, 10, 20, 40, 100, 200, 400}));
  for (const DeviationKind kind : kKinds) {
    for (std::size_t n = 0; n < 12; ++n) {
      const auto all = averaging_factors(n, kind, TauSpacing::kAll);
      const std::vector<double> x = noise(n, 3);
      EXPECT_EQ(phase_deviations(x, 1.0, kind, all).size(), all.size()) << n;
      const std::vector<std::size_t> next{all.size() + 1};
      EXPECT_TRUE(phase_deviations(x, 1.0, kind, next).empty()) << n;
    }
  }
}

TEST(DeviationLaw, OffsetsOfPhaseAndFrequencyAreNotSeen) {
  const auto x = noise(500, 1);
  const std::vector<std::size_t> factors{1, 3, 17};
  for (const DeviationKind kind : kKinds) {
    auto moved = x;
    for (std::size_t i = 0; i < moved.size(); ++i) moved[i] += 5.0 + 0.25 * static_cast<double>(i);
    const auto before = values(phase_deviations(x, 1.0, kind, factors));
    const auto after = values(phase_deviations(moved, 1.0, kind, factors));
    for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(after[i] / before[i], 1.0, 1e-11);
  }
  // A drift of frequency is not seen by the Hadamard deviation, and is by Allan's.
  auto drifting = x;
  for (std::size_t i = 0; i < drifting.size(); ++i) drifting[i] += static_cast<double>(i * i);
  const std::vector<std::size_t> one{8};
  EXPECT_NEAR(phase_deviations(drifting, 1.0, DeviationKind::kOverlappingHadamard, one)[0].deviation /
                  phase_deviations(x, 1.0, DeviationKind::kOverlappingHadamard, one)[0].deviation,
              1.0, 1e-9);
  EXPECT_GT(phase_deviations(drifting, 1.0, DeviationKind::kOverlappingAllan, one)[0].deviation, 10.0);
}

TEST(DeviationLaw, SlidingSumsEqualTheDefinition) {
  const auto x = noise(200, 2);
  const std::size_t m = 7;
  double sum = 0.0;
  for (std::size_t j = 0; j + 3 * m <= x.size(); ++j) {
    double window = 0.0;
    for (std::size_t i = j; i < j + m; ++i) window += x[i + 2 * m] - 2.0 * x[i + m] + x[i];
    sum += window * window;
  }
  const auto expected = std::sqrt(sum / (2.0 * 49.0 * 49.0 * static_cast<double>(x.size() - 3 * m + 1)));
  const std::vector<std::size_t> factors{m};
  const auto d = phase_deviations(x, 1.0, DeviationKind::kModifiedAllan, factors);
  EXPECT_EQ(d[0].count, x.size() - 3 * m + 1);
  EXPECT_NEAR(d[0].deviation / expected, 1.0, 1e-12);
}

TEST(DeviationGaps, DifferencesThatTouchOneAreLeftOut) {
  const auto whole = noise(300, 4);
  auto x = whole;
  x[50] = x[51] = x[200] = kNan;
  const std::vector<std::size_t> factors{1, 5};
  for (const DeviationKind kind : kKinds) {
    const auto d = phase_deviations(x, 1.0, kind, factors);
    const auto full = phase_deviations(whole, 1.0, kind, factors);
    for (std::size_t i = 0; i < 2; ++i) {
      EXPECT_TRUE(std::isfinite(d[i].deviation));
      EXPECT_LT(d[i].count, full[i].count);
      EXPECT_NEAR(d[i].deviation / full[i].deviation, 1.0, 0.2);
    }
  }
  EXPECT_EQ(phase_deviations(x, 1.0, DeviationKind::kOverlappingAllan, factors)[0].count, 298U - 4U - 3U);
  // A gap in the middle of frequencies: two records, pooled.
  std::vector<double> y(whole.begin(), whole.begin() + 100), a = y, b(whole.begin() + 100, whole.begin() + 180);
  y.push_back(kNan);
  y.insert(y.end(), b.begin(), b.end());
  const std::vector<std::size_t> four{4};
  for (const DeviationKind kind : kKinds) {
    const auto both = frequency_deviations(y, 1.0, kind, four)[0];
    const auto of_a = frequency_deviations(a, 1.0, kind, four)[0];
    const auto of_b = frequency_deviations(b, 1.0, kind, four)[0];
    ASSERT_EQ(both.count, of_a.count + of_b.count);
    const double pooled = (std::pow(of_a.deviation, 2) * static_cast<double>(of_a.count) +
                           std::pow(of_b.deviation, 2) * static_cast<double>(of_b.count)) /
                          static_cast<double>(both.count);
    EXPECT_NEAR(both.deviation / std::sqrt(pooled), 1.0, 1e-11);
  }
  EXPECT_TRUE(phase_deviations(std::vector<double>(9, kNan), 1.0, DeviationKind::kAllan, four).empty());
  EXPECT_TRUE(frequency_deviations(std::vector<double>(9, kNan), 1.0, DeviationKind::kAllan, four).empty());
}

TEST(Deviation, RefusesWhatIsNoRecord) {
  const std::vector<double> x(20, 1.0);
  const std::vector<std::size_t> one{1}, none{0};
  const auto message = [](const auto& call) -> std::string {
    try {
      static_cast<void>(call());
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  constexpr auto kKind = DeviationKind::kAllan;
  EXPECT_NE(message([&] { return phase_deviations(x, 0.0, kKind, one); }).find("dt_s = 0"), std::string::npos);
  EXPECT_NE(message([&] { return phase_deviations(x, kNan, kKind, one); }).find("dt_s"), std::string::npos);
  EXPECT_NE(message([&] { return phase_deviations(x, 1.0, kKind, none); }).find("factors[0] = 0"), std::string::npos);
  EXPECT_NE(message([&] { return phase_deviations(x, 1.0, kKind, one, {.confidence = 1.0}); }).find("confidence"),
            std::string::npos);
  auto bad = x;
  bad[7] = std::numeric_limits<double>::infinity();
  EXPECT_NE(message([&] { return phase_deviations(bad, 1.0, kKind, one); }).find("phase_s[7]"), std::string::npos);
  EXPECT_NE(message([&] { return frequency_deviations(bad, 1.0, kKind, one); }).find("frequency[7]"),
            std::string::npos);
  EXPECT_NE(message([&] { return equivalent_dof(kKind, PowerLaw::kWhitePhase, 0, 1); }), "");
  EXPECT_NE(message([&] { return equivalent_dof(kKind, PowerLaw::kWhitePhase, 1, 0); }), "");
}

TEST(EquivalentDof, OfOneTermIsOne) {
  for (const DeviationKind kind : kKinds) {
    for (int alpha = -2; alpha <= 2; ++alpha) {
      EXPECT_NEAR(equivalent_dof(kind, static_cast<PowerLaw>(alpha), 1, 1), 1.0, 1e-12);
      EXPECT_NEAR(equivalent_dof(kind, static_cast<PowerLaw>(alpha), 1000, 1), 1.0, 1e-12);
    }
  }
  // White frequency noise, no overlap: neighbours are correlated by -1/2, so 2 / Var is M / (1 + (1 - 1/M) / 2).
  EXPECT_NEAR(equivalent_dof(DeviationKind::kAllan, PowerLaw::kWhiteFrequency, 5, 20), 20.0 / (1.0 + 0.95 / 2.0), 1e-9);
  // SP 1065 table 5 for white phase noise: (N + 1)(N - 2m) / (2 (N - m)) there approximately, N = 1000, m = 10.
  EXPECT_NEAR(equivalent_dof(DeviationKind::kOverlappingAllan, PowerLaw::kWhitePhase, 10, 980) /
                  (1001.0 * 980.0 / (2.0 * 990.0)),
              1.0, 0.05);
  // And for white frequency noise: (3 (N - 1) / 2m - 2 (N - 2) / N) 4 m² / (4 m² + 5).
  EXPECT_NEAR(equivalent_dof(DeviationKind::kOverlappingAllan, PowerLaw::kWhiteFrequency, 10, 980) /
                  ((3.0 * 999.0 / 20.0 - 2.0 * 998.0 / 1000.0) * 400.0 / 405.0),
              1.0, 0.03);
}

// Phase of a power law, N samples: sums of white noise.
std::vector<double> power_law(int alpha, std::size_t n, RandomStream& random) {
  std::vector<double> x(n);
  random.fill_normal(std::span<double>(x));
  for (int sums = alpha; sums < 2; sums += 2) std::partial_sum(x.begin(), x.end(), x.begin());
  return x;
}

TEST(DeviationConsistency, VarianceIsThatOfItsDegreesOfFreedom) {
  // 400 records each: the relative variance of the squared deviation is 2 / dof. The variance of a mean square of 400
  // near-normal values varies by 7 %, more for few degrees of freedom; bounds of 40 % leave 1e-5.
  constexpr std::size_t kRecords = 400;
  RandomStream random(11);
  for (const DeviationKind kind : kKinds) {
    for (const int alpha : {2, 0, -2}) {
      const std::vector<std::size_t> factor{6};
      double sum = 0.0, square = 0.0, dof = 0.0;
      for (std::size_t i = 0; i < kRecords; ++i) {
        const auto x = power_law(alpha, 400, random);
        const auto d = phase_deviations(x, 1.0, kind, factor, {.noise = static_cast<PowerLaw>(alpha)});
        const double v = d[0].deviation * d[0].deviation;
        sum += v;
        square += v * v;
        dof = d[0].dof;
      }
      const double mean = sum / kRecords;
      const double relative = (square / kRecords - mean * mean) / (mean * mean);
      EXPECT_GT(relative * dof / 2.0, 0.6) << static_cast<int>(kind) << " " << alpha;
      EXPECT_LT(relative * dof / 2.0, 1.5) << static_cast<int>(kind) << " " << alpha;
    }
  }
}

TEST(DeviationConsistency, IntervalsHoldTheTruthAsOftenAsTheySay) {
  // White frequency noise of unit variance: the Allan variance is 1 / tau. 600 intervals at 68.3 %: 410 +- 57, five
  // deviations.
  RandomStream random(12);
  for (const std::size_t m : {1U, 16U, 100U}) {
    const std::vector<std::size_t> factor{m};
    int inside = 0;
    for (int i = 0; i < 600; ++i) {
      const auto x = power_law(0, 500, random);
      const auto d =
          phase_deviations(x, 1.0, DeviationKind::kOverlappingAllan, factor, {.noise = PowerLaw::kWhiteFrequency})[0];
      const double truth = 1.0 / std::sqrt(static_cast<double>(m));
      inside += d.lower < truth && truth < d.upper;
    }
    EXPECT_GT(inside, 353) << m;
    EXPECT_LT(inside, 467) << m;
  }
}

TEST(IdentifyNoise, TellsThePowerLaws) {
  RandomStream random(13);
  for (const DeviationKind kind : {DeviationKind::kOverlappingAllan, DeviationKind::kOverlappingHadamard}) {
    for (const int alpha : {2, 0, -2}) {
      const auto x = power_law(alpha, 20000, random);
      EXPECT_EQ(identify_noise(x, 1, kind), static_cast<PowerLaw>(alpha)) << alpha;
      if (alpha < 2) {
        EXPECT_EQ(identify_noise(x, 10, kind), static_cast<PowerLaw>(alpha)) << alpha;
      }
      EXPECT_FALSE(identify_noise(x, 1000, kind).has_value());
    }
  }
}

}  // namespace
}  // namespace soopnav::clock
