#include "soopnav/estimation/chi_square.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace soopnav {
namespace {

struct TableRow {
  double dof;
  double lower_05, upper_05, upper_01, upper_001;
};

// NIST/SEMATECH e-Handbook of Statistical Methods, section 1.3.6.7.4, three decimals.
constexpr TableRow kTable[] = {
    {1, 0.004, 3.841, 6.635, 10.828},         {2, 0.103, 5.991, 9.210, 13.816},    {3, 0.352, 7.815, 11.345, 16.266},
    {5, 1.145, 11.070, 15.086, 20.515},       {10, 3.940, 18.307, 23.209, 29.588}, {30, 18.493, 43.773, 50.892, 59.703},
    {100, 77.929, 124.342, 135.807, 149.449},
};

TEST(ChiSquare, QuantilesEqualThePublishedTable) {
  for (const TableRow& row : kTable) {
    EXPECT_NEAR(chi_square_quantile(0.05, row.dof), row.lower_05, 0.0006) << row.dof;
    EXPECT_NEAR(chi_square_quantile(0.95, row.dof), row.upper_05, 0.0006) << row.dof;
    EXPECT_NEAR(chi_square_upper_quantile(0.01, row.dof), row.upper_01, 0.0006) << row.dof;
    EXPECT_NEAR(chi_square_upper_quantile(0.001, row.dof), row.upper_001, 0.0006) << row.dof;
  }
}

TEST(ChiSquare, TwoDegreesOfFreedomAreExponential) {
  for (const double q : {1e-300, 1e-100, 1e-12, 1e-3, 0.3, 0.5, 0.9, 0.999}) {
    EXPECT_NEAR(chi_square_upper_quantile(q, 2.0), -2.0 * std::log(q), 2e-13 * (1.0 - 2.0 * std::log(q))) << q;
    EXPECT_NEAR(chi_square_quantile(q, 2.0) / (-2.0 * std::log1p(-q)), 1.0, 1e-12) << q;
  }
  for (const double x : {1e-9, 0.1, 1.0, 7.0, 300.0}) {
    EXPECT_NEAR(chi_square_cdf(x, 2.0) / -std::expm1(-0.5 * x), 1.0, 1e-13) << x;
    EXPECT_NEAR(regularized_gamma_q(1.0, 0.5 * x) / std::exp(-0.5 * x), 1.0, 1e-12) << x;
  }
}

TEST(ChiSquare, OneDegreeOfFreedomIsASquaredNormal) {
  for (const double k : {0.01, 0.6744897501960817, 1.0, 1.959963984540054, 3.0, 6.0}) {
    EXPECT_NEAR(chi_square_cdf(k * k, 1.0), std::erf(k / std::sqrt(2.0)), 1e-14) << k;
    EXPECT_NEAR(normal_two_sided_gate(std::erfc(k / std::sqrt(2.0))), k, 1e-9 * k) << k;
  }
}

TEST(ChiSquare, QuantileInvertsTheDistribution) {
  for (const double dof : {0.5, 1.0, 3.0, 7.5, 40.0, 39.9, 600.0, 20000.0}) {
    for (const double p : {1e-8, 1e-3, 0.2, 0.5, 0.8, 0.999}) {
      const double x = chi_square_quantile(p, dof);
      EXPECT_NEAR(chi_square_cdf(x, dof) / p, 1.0, 1e-10) << dof << " " << p;
      const double y = chi_square_upper_quantile(p, dof);
      EXPECT_NEAR(regularized_gamma_q(0.5 * dof, 0.5 * y) / p, 1.0, 1e-10) << dof << " " << p;
    }
  }
}

TEST(ChiSquare, SeriesAndFractionMeet) {
  for (const double a : {0.3, 1.0, 5.0, 50.0, 5000.0}) {
    const double at = a + 1.0;
    const double step = 1e-7 * at;
    EXPECT_NEAR(regularized_gamma_p(a, at - step) + regularized_gamma_q(a, at - step), 1.0, 1e-14);
    // The density is smooth across the border of the two expansions.
    const double left = regularized_gamma_p(a, at) - regularized_gamma_p(a, at - step);
    const double right = regularized_gamma_p(a, at + step) - regularized_gamma_p(a, at);
    EXPECT_NEAR(left / right, 1.0, 1e-4) << a;
  }
}

TEST(ChiSquare, EndsAndRefusals) {
  constexpr double kInf = std::numeric_limits<double>::infinity();
  EXPECT_EQ(chi_square_quantile(0.0, 3.0), 0.0);
  EXPECT_EQ(chi_square_quantile(1.0, 3.0), kInf);
  EXPECT_EQ(chi_square_upper_quantile(0.0, 3.0), kInf);
  EXPECT_EQ(chi_square_cdf(0.0, 3.0), 0.0);
  EXPECT_EQ(chi_square_cdf(kInf, 3.0), 1.0);
  EXPECT_GE(chi_square_quantile(1e-300, 0.5), 0.0);
  for (const double bad : {std::nan(""), -0.1, 1.1}) {
    EXPECT_TRUE(std::isnan(chi_square_quantile(bad, 3.0))) << bad;
    EXPECT_TRUE(std::isnan(chi_square_upper_quantile(bad, 3.0))) << bad;
  }
  for (const double bad : {std::nan(""), 0.0, -1.0, kInf})
    EXPECT_TRUE(std::isnan(chi_square_quantile(0.5, bad))) << bad;
  EXPECT_TRUE(std::isnan(chi_square_cdf(-1.0, 2.0)));
  EXPECT_TRUE(std::isnan(normal_two_sided_gate(0.0)));
}

}  // namespace
}  // namespace soopnav
