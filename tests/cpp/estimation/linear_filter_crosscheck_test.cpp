// A long run of a system of fourteen states against the same filter in long double, and what plain subtraction does to
// it.

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>

#include "estimation/linear_systems.hpp"
#include "soopnav/estimation/linear_filter.hpp"

namespace soopnav {
namespace {

using test::matrix_at;
using test::vector_at;

constexpr int kSteps = 2400;

double smallest_eigenvalue(const Eigen::MatrixXd& P) {
  const Eigen::MatrixXd symmetric = 0.5 * (P + P.transpose());
  return Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(symmetric, Eigen::EigenvaluesOnly).eigenvalues()[0];
}

// The step at which P - K S Kᵀ, written down as it stands, has a negative eigenvalue. The measured values do not
// matter.
TEST(FourteenStates, PlainSubtractionGoesIndefinite) {
  const auto s = test::fourteen_states();
  using Book = test::BookFilter<double>;
  Book book(s);
  Eigen::MatrixXd P = book.P;
  int failed = 0;
  for (int k = 1; k <= kSteps && failed == 0; ++k) {
    P = Book::sum(book.Q, 1, Book::times(book.F, P), Book::transposed(book.F));
    const Eigen::MatrixXd PHt = Book::times(P, Book::transposed(book.H));
    const Eigen::MatrixXd S = Book::sum(book.R, 1, book.H, PHt);
    double log_determinant = 0.0;
    const Eigen::MatrixXd K = Book::times(PHt, Book::inverse(S, log_determinant));
    P = Book::sum(P, -1, Book::times(K, S), Book::transposed(K));
    if (smallest_eigenvalue(P) <= 0.0) failed = k;
  }
  EXPECT_GT(failed, 450);
  EXPECT_LT(failed, 670);
}

TEST(FourteenStates, RankFormStaysWithTheTruth) {
  const auto s = test::fourteen_states();
  const auto data = test::simulate(s, kSteps, 14);
  const LinearRun r = linear_filter(s.view(), {.z = data.values()}, s.x0, s.P0);
  test::BookFilter<long double> book(s);
  double smallest = 1.0;
  double P_error = 0.0;
  double x_error = 0.0;
  for (int k = 0; k < kSteps; ++k) {
    book.step(data.z.row(k).transpose());
    P_error = std::max(P_error,
                       (matrix_at(r.P, k, 14, 14) - book.P.cast<double>()).norm() / static_cast<double>(book.P.norm()));
    x_error = std::max(
        x_error, (vector_at(r.x, k, 14) - book.x.cast<double>()).norm() / (1.0 + static_cast<double>(book.x.norm())));
    if (k % 40 == 39) smallest = std::min(smallest, smallest_eigenvalue(matrix_at(r.P, k, 14, 14)));
  }
  EXPECT_LT(P_error, 1e-12);
  EXPECT_LT(x_error, 1e-10);
  EXPECT_GT(smallest, 1.2e-3);  // of the long-double filter as well: 1.27e-3
}

}  // namespace
}  // namespace soopnav
