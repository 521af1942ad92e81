#include "soopnav/estimation/statistics.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "support/nan.hpp"

namespace soopnav {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using ::soopnav::test::kNan;

TEST(NeesSeries, IsNeesOfEachRowAndNanWhereThereIsNone) {
  MatrixXd errors(3, 2);
  errors << 1, 2, 3, -4, 1, 1;
  MatrixXd P(6, 2);
  P << 1, 0, 0, 4, 2, 1, 1, 2, 1, 2, 2, 1;  // the last one is indefinite
  const VectorXd values = nees_series(errors, P);
  EXPECT_NEAR(values[0], 2.0, 1e-14);
  EXPECT_NEAR(values[1], nees(Eigen::Vector2d(3, -4), (Eigen::Matrix2d() << 2, 1, 1, 2).finished()).value_or(0), 1e-12);
  EXPECT_TRUE(std::isnan(values[2]));
  EXPECT_THROW(static_cast<void>(nees_series(errors, P.topRows(5))), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(nees_series(MatrixXd(0, 2), MatrixXd(0, 2))), std::invalid_argument);
}

TEST(Rmse, OfEachComponent) {
  MatrixXd errors(2, 2);
  errors << 3, 1, 4, -1;
  EXPECT_NEAR(rmse(errors)[0], std::sqrt(12.5), 1e-14);
  EXPECT_NEAR(rmse(errors)[1], 1.0, 1e-14);
  errors(0, 1) = kNan;
  EXPECT_TRUE(std::isnan(rmse(errors)[1]));
  EXPECT_NEAR(rmse(errors)[0], std::sqrt(12.5), 1e-14);
  EXPECT_THROW(static_cast<void>(rmse(MatrixXd(0, 2))), std::invalid_argument);
}

TEST(Coverage, CountsWhatLiesInside) {
  // One component, variance 4: 68.27 % means |error| <= 2.
  const MatrixXd errors = (VectorXd(5) << 1.9, -1.9, 2.1, 0.0, kNan).finished();
  const MatrixXd P = VectorXd::Constant(5, 4.0);
  EXPECT_EQ(coverage(errors, P, 0.6827), 0.6);
  EXPECT_THROW(static_cast<void>(coverage(errors, P, 1.0)), std::invalid_argument);
}

TEST(CoverageBounds, AreTheBinomialQuantiles) {
  // scipy.stats.binom: the smallest k with P(K <= k) > side and the largest with P(K >= k) > side.
  const auto a = coverage_bounds(0.5, 10, 0.05);
  EXPECT_NEAR(a.lower, 0.2, 1e-12);
  EXPECT_NEAR(a.upper, 0.8, 1e-12);
  const auto b = coverage_bounds(0.95, 200, 1e-4);
  EXPECT_NEAR(b.lower, 176.0 / 200.0, 1e-12);
  EXPECT_NEAR(b.upper, 199.0 / 200.0, 1e-12);
  // For many runs the normal approximation.
  const auto c = coverage_bounds(0.3, 1000000, 0.0027);
  EXPECT_NEAR(c.lower, 0.3 - 3.0 * std::sqrt(0.21e-6), 3e-6);
  EXPECT_NEAR(c.upper, 0.3 + 3.0 * std::sqrt(0.21e-6), 3e-6);
  for (const auto& bad : {coverage_bounds(0.0, 5, 0.1), coverage_bounds(0.5, 0, 0.1), coverage_bounds(0.5, 5, 1.0),
                          coverage_bounds(kNan, 5, 0.1)}) {
    EXPECT_TRUE(std::isnan(bad.lower) && std::isnan(bad.upper));
  }
}

TEST(CoverageBounds, SwapWhenSuccessAndFailureSwap) {
  for (const double p : {0.02, 0.3, 0.77}) {
    const auto a = coverage_bounds(p, 83, 1e-3);
    const auto b = coverage_bounds(1.0 - p, 83, 1e-3);
    EXPECT_NEAR(a.lower, 1.0 - b.upper, 1e-12);
    EXPECT_NEAR(a.upper, 1.0 - b.lower, 1e-12);
  }
}

TEST(SampleCircularError, IsTheSampleQuantile) {
  MatrixXd errors(4, 2);
  errors << 3, 4, 0, 1, 0, -2, 10, 0;
  EXPECT_EQ(sample_circular_error_m(errors), 2.0);
  EXPECT_EQ(sample_circular_error_m(errors, 0.75), 5.0);
  EXPECT_EQ(sample_circular_error_m(errors, 0.76), 10.0);
  EXPECT_EQ(sample_circular_error_m(errors, 1.0), 10.0);
  EXPECT_EQ(sample_circular_error_m(errors, 1e-9), 1.0);
  EXPECT_THROW(static_cast<void>(sample_circular_error_m(MatrixXd::Ones(3, 3))), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(sample_circular_error_m(errors, 0.0)), std::invalid_argument);
  errors(0, 0) = kNan;
  EXPECT_TRUE(std::isnan(sample_circular_error_m(errors)));
}

}  // namespace
}  // namespace soopnav
