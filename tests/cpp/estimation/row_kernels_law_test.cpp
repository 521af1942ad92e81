// The set of instructions chosen at run time changes no bit, and the kernels compute what they say.

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <vector>

#include "estimation/row_kernels.hpp"
#include "estimation/row_kernels_exercise.hpp"

namespace soopnav::test {

std::vector<double> exercise_baseline(int n, std::uint64_t seed);
std::vector<double> exercise_avx2(int n, std::uint64_t seed);

namespace {

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

TEST(RowKernels, SameBitsForEveryVectorWidth) {
  for (int n = 1; n <= 41; ++n) {
    const auto chosen = exercise(n, 77);
    EXPECT_EQ(chosen, exercise_baseline(n, 77)) << n;
    EXPECT_EQ(chosen, exercise_avx2(n, 77)) << n;
    EXPECT_EQ(chosen[chosen.size() - 3], 1.0) << n;  // positive definite
  }
}

TEST(RowKernels, SolvesWhatEigenSolves) {
  for (const int n : {1, 3, 4, 5, 8, 14, 17, 40}) {
    const int stride = detail::padded(n);
    const Matrix M = Matrix::Random(n, n);
    const Matrix P = M * M.transpose() + Matrix::Identity(n, n);
    const Matrix B = Matrix::Random(n, n);
    detail::RowArena arena(5 * static_cast<std::size_t>(n) * static_cast<std::size_t>(stride) +
                           2 * static_cast<std::size_t>(stride));
    double* const p = arena.take(n, stride);
    double* const b = arena.take(n, stride);
    double* const DU = arena.take(n, stride);
    double* const U = arena.take(n, stride);
    double* const d = arena.take(1, stride);
    double* const inverse_d = arena.take(1, stride);
    detail::load_rows(P.data(), n, n, stride, p);
    detail::load_rows(B.data(), n, n, stride, b);
    ASSERT_TRUE(detail::factorize(p, n, stride, 0.0, DU, U, d, inverse_d, b, stride));
    detail::solve_upper(U, inverse_d, n, stride, b, stride);
    Matrix X(n, n);
    detail::store_rows(b, n, n, stride, X.data());
    EXPECT_LT((P * X - B).norm(), 1e-12 * P.norm() * X.norm()) << n;
  }
}

TEST(RowKernels, FactorizeRefusesAPivotOfRounding) {
  detail::RowArena arena(6 * 8);
  double* const P = arena.take(2, 4);
  double* const DU = arena.take(2, 4);
  double* const U = arena.take(2, 4);
  double* const B = arena.take(2, 4);
  double d[4];
  double inverse_d[4];
  const auto factor = [&](double variance, double covariance, double tolerance) {
    P[0] = P[5] = variance;
    P[1] = P[4] = covariance;
    return detail::factorize(P, 2, 4, tolerance, DU, U, d, inverse_d, B, 4);
  };
  EXPECT_TRUE(factor(4.0, 1.0, 1e-14));
  EXPECT_TRUE(factor(1.0, 1.0 - 1e-12, 1e-14));
  EXPECT_FALSE(factor(1.0, 1.0, 0.0));
  EXPECT_FALSE(factor(1.0, 1.0 - 1e-15, 1e-14));
  EXPECT_FALSE(factor(-1.0, 0.0, 1e-14));
  EXPECT_FALSE(factor(0.0, 0.0, 0.0));
  EXPECT_FALSE(factor(std::numeric_limits<double>::quiet_NaN(), 0.0, 0.0));
}

TEST(RowKernels, FindsWhatIsNotFiniteAnywhere) {
  for (const double bad : {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(),
                           -std::numeric_limits<double>::infinity()}) {
    for (int at = 0; at < 36; ++at) {
      std::vector<double> values(36, 1e300);
      EXPECT_TRUE(detail::all_finite(values.data(), 9, 4));
      values[static_cast<std::size_t>(at)] = bad;
      EXPECT_FALSE(detail::all_finite(values.data(), 9, 4)) << at;
    }
  }
}

TEST(RowKernels, SymmetryHasATolerance) {
  std::vector<double> A{4.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0};
  EXPECT_TRUE(detail::is_symmetric(A.data(), 2, 4, 0.0));
  A[1] += 1e-9;
  EXPECT_TRUE(detail::is_symmetric(A.data(), 2, 4, 1e-9));  // 5e-10 of sqrt(4 * 1)
  EXPECT_FALSE(detail::is_symmetric(A.data(), 2, 4, 1e-10));
  A[1] = 0.0;
  A[4] = -0.0;
  EXPECT_TRUE(detail::is_symmetric(A.data(), 2, 4, 0.0));
  A[4] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(detail::is_symmetric(A.data(), 2, 4, 1.0));
}

}  // namespace
}  // namespace soopnav::test
