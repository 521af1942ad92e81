#include "soopnav/estimation/detail/symmetric_eigen.hpp"

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <Eigen/SVD>

namespace soopnav::detail {

namespace {

template <int MaxN>
void decompose(const double* matrix, int n, double* values, double* vectors) noexcept {
  using Square = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, MaxN, MaxN>;
  const Eigen::SelfAdjointEigenSolver<Square> solver(Square(Eigen::Map<const Square>(matrix, n, n)));
  Eigen::Map<Eigen::VectorXd>(values, n) = solver.eigenvalues();
  Eigen::Map<Square>(vectors, n, n) = solver.eigenvectors();
}

template <int MaxN>
bool decompose(const double* matrix, int n, double* values, double* left, double* right) noexcept {
  using Square = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, MaxN, MaxN>;
  const unsigned wanted = static_cast<unsigned>(left != nullptr ? Eigen::ComputeFullU : 0) |
                          static_cast<unsigned>(right != nullptr ? Eigen::ComputeFullV : 0);
  const Eigen::JacobiSVD<Square> svd(Square(Eigen::Map<const Square>(matrix, n, n)), wanted);
  if (svd.info() != Eigen::Success || !svd.singularValues().allFinite()) return false;
  Eigen::Map<Eigen::VectorXd>(values, n) = svd.singularValues();
  if (left != nullptr) Eigen::Map<Square>(left, n, n) = svd.matrixU();
  if (right != nullptr) Eigen::Map<Square>(right, n, n) = svd.matrixV();
  return true;
}

constexpr int kBounded = 32;

}  // namespace

void symmetric_eigen(const double* matrix, int n, double* values, double* vectors) noexcept {
  if (n <= kBounded) {
    decompose<kBounded>(matrix, n, values, vectors);
  } else {
    decompose<Eigen::Dynamic>(matrix, n, values, vectors);
  }
}

bool square_svd(const double* matrix, int n, double* values, double* left, double* right) noexcept {
  return n <= kBounded ? decompose<kBounded>(matrix, n, values, left, right)
                       : decompose<Eigen::Dynamic>(matrix, n, values, left, right);
}

}  // namespace soopnav::detail
