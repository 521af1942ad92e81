#include "soopnav/estimation/detail/symmetric_eigen.hpp"

#include <Eigen/Core>
#include <Eigen/Eigenvalues>

namespace soopnav::detail {

namespace {

template <int MaxN>
void decompose(const double* matrix, int n, double* values, double* vectors) noexcept {
  using Square = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, MaxN, MaxN>;
  const Eigen::SelfAdjointEigenSolver<Square> solver(Square(Eigen::Map<const Square>(matrix, n, n)));
  Eigen::Map<Eigen::VectorXd>(values, n) = solver.eigenvalues();
  Eigen::Map<Square>(vectors, n, n) = solver.eigenvectors();
}

}  // namespace

void symmetric_eigen(const double* matrix, int n, double* values, double* vectors) noexcept {
  constexpr int kBounded = 32;
  if (n <= kBounded) {
    decompose<kBounded>(matrix, n, values, vectors);
  } else {
    decompose<Eigen::Dynamic>(matrix, n, values, vectors);
  }
}

}  // namespace soopnav::detail
