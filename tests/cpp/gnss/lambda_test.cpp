// Integer least squares against exhaustive search and against the laws that its transformation must keep.

#include "soopnav/gnss/lambda.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "soopnav/core/random.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::gnss {
namespace {

using Matrix = Eigen::MatrixXd;
using Vector = Eigen::VectorXd;

// A covariance as double differences have it: a few long axes (the baseline), the others short.
Matrix code_and_phase_covariance(int n, RandomStream& random, double long_cycles, double short_cycles) {
  Matrix B(n, 3);
  for (double& b : B.reshaped()) b = random.normal();
  return long_cycles * long_cycles * B * B.transpose() + short_cycles * short_cycles * Matrix::Identity(n, n);
}

Matrix random_covariance(int n, RandomStream& random, double spread) {
  Matrix A(n, n);
  for (double& a : A.reshaped()) a = random.normal();
  Matrix scale = Matrix::Zero(n, n);
  for (int i = 0; i < n; ++i) scale(i, i) = std::exp(spread * random.normal());
  return A * scale * A.transpose() + 1e-6 * Matrix::Identity(n, n);
}

double squared_norm(const Vector& a, const Matrix& Q, const Vector& z) { return (a - z).dot(Q.llt().solve(a - z)); }

// All vectors of a box about `a` in order of their norm: what nobody can search better.
std::vector<std::pair<double, Vector>> exhaustive(const Vector& a, const Matrix& Q, int half_width) {
  const int n = static_cast<int>(a.size());
  const Matrix inverse = Q.inverse();
  std::vector<std::pair<double, Vector>> all;
  std::vector<int> index(static_cast<std::size_t>(n), -half_width);
  while (true) {
    Vector z(n);
    for (int i = 0; i < n; ++i) z[i] = std::round(a[i]) + index[static_cast<std::size_t>(i)];
    all.emplace_back((a - z).dot(inverse * (a - z)), z);
    int i = 0;
    while (i < n && ++index[static_cast<std::size_t>(i)] > half_width)
      index[static_cast<std::size_t>(i++)] = -half_width;
    if (i == n) break;
  }
  std::ranges::sort(all, [](const auto& l, const auto& r) { return l.first < r.first; });
  return all;
}

Vector candidate(const IntegerLeastSquares& ils, int k) {
  const auto z = ils.candidate(k);
  return Eigen::Map<const Vector>(z.data(), static_cast<Eigen::Index>(z.size()));
}

TEST(Lambda, FindsWhatExhaustiveSearchFinds) {
  RandomStream random(11);
  IntegerLeastSquares ils(6);
  for (int trial = 0; trial < 60; ++trial) {
    const int n = 1 + trial % 4;
    const Matrix Q = random_covariance(n, random, 0.8) * 0.05;
    Vector a(n);
    for (double& x : a) x = random.uniform(-40.0, 40.0);
    ASSERT_EQ(ils.solve(a, Q), IntegerStatus::kSolved);
    ASSERT_EQ(ils.count(), 6);
    const auto all = exhaustive(a, Q, 9);
    for (int k = 0; k < 6; ++k) {
      EXPECT_NEAR(ils.squared_norm(k), all[static_cast<std::size_t>(k)].first, 1e-9 * (1.0 + ils.squared_norm(k)));
      EXPECT_EQ(candidate(ils, k), all[static_cast<std::size_t>(k)].second) << "trial " << trial << ", candidate " << k;
    }
  }
}

TEST(Lambda, NormsAscendAndBelongToTheirIntegers) {
  RandomStream random(12);
  IntegerLeastSquares ils(20);
  for (int trial = 0; trial < 40; ++trial) {
    const int n = 3 + trial % 10;
    const Matrix Q = code_and_phase_covariance(n, random, 4.0, 0.03);
    Vector a(n);
    for (double& x : a) x = random.uniform(-1e6, 1e6);
    ASSERT_EQ(ils.solve(a, Q), IntegerStatus::kSolved);
    for (int k = 0; k < ils.count(); ++k) {
      const Vector z = candidate(ils, k);
      EXPECT_EQ(z, z.array().round().matrix());
      const double norm = squared_norm(a, Q, z);
      EXPECT_NEAR(ils.squared_norm(k), norm, 1e-6 * (1.0 + norm));
      if (k > 0) {
        EXPECT_GE(ils.squared_norm(k), ils.squared_norm(k - 1));
        EXPECT_NE(z, candidate(ils, k - 1));
      }
    }
    EXPECT_DOUBLE_EQ(ils.ratio(), ils.squared_norm(1) / ils.squared_norm(0));
  }
}

TEST(Lambda, TransformationIsUnimodularAndDecorrelates) {
  RandomStream random(13);
  IntegerLeastSquares ils;
  for (const int n : {2, 5, 12, 20}) {
    const Matrix Q = code_and_phase_covariance(n, random, 5.0, 0.05);
    ASSERT_EQ(ils.decorrelate(Q), IntegerStatus::kSolved);
    const Matrix Z = ils.Z();
    EXPECT_EQ(Z, Z.array().round().matrix());
    EXPECT_NEAR(std::abs(Z.partialPivLu().determinant()), 1.0, 1e-6) << n;
    // The volume is kept, and the long axes are gone.
    const Matrix D = Z.transpose() * Q * Z;
    EXPECT_NEAR(ils.conditional_variances().array().log().sum(),
                2.0 * Q.llt().matrixLLT().diagonal().array().log().sum(), 1e-6 * n);
    EXPECT_LT(D.diagonal().maxCoeff(), Q.diagonal().maxCoeff());
    EXPECT_LT(D.diagonal().prod(), Q.diagonal().prod());
    EXPECT_GT(ils.success_rate(), 0.0);
    EXPECT_LE(ils.success_rate(), 1.0);
  }
}

TEST(Lambda, AnyUnimodularChangeOfVariablesGivesTheSameNorms) {
  RandomStream random(14);
  IntegerLeastSquares ils(4);
  for (int trial = 0; trial < 20; ++trial) {
    const int n = 6;
    const Matrix Q = code_and_phase_covariance(n, random, 2.0, 0.05);
    Vector a(n);
    for (double& x : a) x = random.uniform(-5.0, 5.0);
    Matrix U = Matrix::Identity(n, n);
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < i; ++j) U(i, j) = std::round(2.0 * random.normal());
    }
    ASSERT_EQ(ils.solve(a, Q), IntegerStatus::kSolved);
    std::array<double, 4> norms{};
    for (int k = 0; k < 4; ++k) norms[static_cast<std::size_t>(k)] = ils.squared_norm(k);
    const Vector best = candidate(ils, 0);
    ASSERT_EQ(ils.solve(U * a, U * Q * U.transpose()), IntegerStatus::kSolved);
    for (int k = 0; k < 4; ++k) {
      EXPECT_NEAR(ils.squared_norm(k), norms[static_cast<std::size_t>(k)], 1e-6 * (1.0 + ils.squared_norm(k)));
    }
    EXPECT_EQ(candidate(ils, 0), U * best);
  }
}

TEST(Lambda, WholeCyclesOnlyMoveTheAnswer) {
  RandomStream random(15);
  const Matrix Q = code_and_phase_covariance(7, random, 3.0, 0.05);
  Vector a(7), shift(7);
  for (double& x : a) x = random.uniform(-0.5, 0.5);
  for (double& x : shift) x = std::round(1e8 * random.normal());
  IntegerLeastSquares near, far;
  ASSERT_EQ(near.solve(a, Q), IntegerStatus::kSolved);
  ASSERT_EQ(far.solve(a + shift, Q), IntegerStatus::kSolved);
  EXPECT_EQ(candidate(far, 0), candidate(near, 0) + shift);
}

TEST(Lambda, FortyIntegersOfOneEpoch) {
  RandomStream random(16);
  IntegerLeastSquares ils;
  const int n = 40;
  const Matrix Q = code_and_phase_covariance(n, random, 3.0, 0.02);
  const Matrix root = Q.llt().matrixL();
  for (int trial = 0; trial < 20; ++trial) {
    Vector truth(n), noise(n);
    for (double& x : truth) x = std::round(1e5 * random.normal());
    for (double& x : noise) x = random.normal();
    ASSERT_EQ(ils.solve(truth + root * noise, Q), IntegerStatus::kSolved);
    EXPECT_EQ(candidate(ils, 0), truth);
    EXPECT_LT(ils.nodes(), 5'000'000);
  }
}

// The best candidate is right at least as often as bootstrapping, whose success rate is exact.
TEST(Lambda, SuccessRateIsALowerBoundThatIsNearlyReached) {
  RandomStream random(17);
  IntegerLeastSquares ils(1);
  Matrix Q = code_and_phase_covariance(5, random, 1.0, 0.05);
  for (int i = 0; i < 200 && (ils.decorrelate(Q) != IntegerStatus::kSolved || ils.success_rate() > 0.8); ++i) Q *= 1.05;
  for (int i = 0; i < 200 && (ils.decorrelate(Q) != IntegerStatus::kSolved || ils.success_rate() < 0.7); ++i) Q *= 0.97;
  const Matrix root = Q.llt().matrixL();
  constexpr int kTrials = 4000;
  int right = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    Vector noise(5);
    for (double& x : noise) x = random.normal();
    ASSERT_EQ(ils.solve(root * noise, Q), IntegerStatus::kSolved);
    if (candidate(ils, 0).isZero()) ++right;
  }
  const double bound = ils.success_rate();
  const double share = right / static_cast<double>(kTrials);
  ASSERT_GT(bound, 0.65);
  ASSERT_LT(bound, 0.85);
  const double slack = 4.0 * std::sqrt(bound * (1.0 - bound) / kTrials);
  EXPECT_GT(share, bound - slack);
  EXPECT_LT(share, bound + 0.1 + slack);
}

TEST(Lambda, OneIntegerIsRounding) {
  IntegerLeastSquares ils(3);
  ASSERT_EQ(ils.solve(Vector::Constant(1, 7.3), Matrix::Constant(1, 1, 0.25)), IntegerStatus::kSolved);
  EXPECT_EQ(candidate(ils, 0)[0], 7.0);
  EXPECT_EQ(candidate(ils, 1)[0], 8.0);
  EXPECT_EQ(candidate(ils, 2)[0], 6.0);
  EXPECT_NEAR(ils.squared_norm(0), 0.36, 1e-12);
  EXPECT_NEAR(ils.success_rate(), std::erf(1.0 / std::sqrt(2.0)), 1e-12);
  ASSERT_EQ(ils.solve(Vector::Constant(1, 7.0), Matrix::Constant(1, 1, 0.25)), IntegerStatus::kSolved);
  EXPECT_TRUE(std::isinf(ils.ratio()));
}

TEST(Lambda, BadInputGivesAStatus) {
  IntegerLeastSquares ils;
  const Matrix I3 = Matrix::Identity(3, 3);
  const Vector a = Vector::Constant(3, 0.2);
  const auto with = [&](int i, int j, double value) {
    Matrix Q = I3;
    Q(i, j) = value;
    return ils.solve(a, Q);
  };
  EXPECT_EQ(with(1, 1, 0.0), IntegerStatus::kNotPositiveDefinite);
  EXPECT_EQ(ils.count(), 0);
  EXPECT_TRUE(std::isnan(ils.success_rate()));
  EXPECT_TRUE(std::isnan(ils.ratio()));
  EXPECT_EQ(with(1, 1, -1.0), IntegerStatus::kNotPositiveDefinite);
  EXPECT_EQ(with(1, 0, 1.0), IntegerStatus::kNotPositiveDefinite);  // singular: two equal integers
  EXPECT_EQ(with(2, 0, std::nan("")), IntegerStatus::kNonFinite);
  EXPECT_EQ(with(2, 2, std::numeric_limits<double>::infinity()), IntegerStatus::kNonFinite);
  EXPECT_EQ(ils.solve(Vector::Constant(3, std::nan("")), I3), IntegerStatus::kNonFinite);
  EXPECT_EQ(ils.solve(Vector::Constant(2, 0.0), I3), IntegerStatus::kWrongSize);
  // Above 2^52 a double has no room for the neighbour of an integer; at 2^52 the two best still differ.
  const double largest = std::ldexp(1.0, 52);
  EXPECT_EQ(ils.solve(Vector::Constant(3, largest), I3), IntegerStatus::kSolved);
  EXPECT_NE(candidate(ils, 0), candidate(ils, 1));
  for (const double beyond : {std::nextafter(largest, 2.0 * largest), -1e17, 1e300}) {
    Vector far = a;
    far[1] = beyond;
    EXPECT_EQ(ils.solve(far, I3), IntegerStatus::kTooLarge) << beyond;
    EXPECT_EQ(ils.count(), 0);
  }
  // So does a covariance whose decorrelation takes 1e20 of one integer from another.
  const Matrix lopsided{{1e60, 1e20}, {1e20, 1.0}};
  EXPECT_EQ(ils.solve(Vector::Constant(2, 0.2), lopsided), IntegerStatus::kTooLarge);
  EXPECT_EQ(to_string(IntegerStatus::kTooLarge), "too large");
  EXPECT_EQ(ils.solve(Vector(0), Matrix(0, 0)), IntegerStatus::kWrongSize);
  EXPECT_EQ(ils.decorrelate(Matrix::Identity(3, 2)), IntegerStatus::kWrongSize);
  EXPECT_EQ(ils.solve(Vector::Zero(kMaxAmbiguities + 1), Matrix::Identity(kMaxAmbiguities + 1, kMaxAmbiguities + 1)),
            IntegerStatus::kWrongSize);
  EXPECT_EQ(to_string(IntegerStatus::kNotPositiveDefinite), "not positive definite");
  EXPECT_THROW(IntegerLeastSquares(0), std::invalid_argument);
  EXPECT_THROW(IntegerLeastSquares(10'001), std::invalid_argument);
  EXPECT_THROW(IntegerLeastSquares(2, 0), std::invalid_argument);
  // Nothing is known of 40 integers: the search ends and says that it gave up.
  IntegerLeastSquares hopeless(2, 10'000);
  RandomStream random(18);
  EXPECT_EQ(hopeless.solve(Vector::Constant(40, 0.4), 1e4 * random_covariance(40, random, 0.1)),
            IntegerStatus::kSearchLimit);
}

TEST(NoAllocation, Lambda) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "this allocator cannot be counted";
  RandomStream random(19);
  IntegerLeastSquares ils(10);
  const Matrix Q = code_and_phase_covariance(20, random, 3.0, 0.05);
  const Vector a = Vector::Constant(20, 3.3);
  IntegerStatus status{};
  EXPECT_EQ(test::allocations_of([&] { status = ils.solve(a, Q); }), 0);
  EXPECT_EQ(status, IntegerStatus::kSolved);
}

}  // namespace
}  // namespace soopnav::gnss
