#pragma once

#include <Eigen/Core>
#include <cmath>

namespace soopnav::detail {

/// Turns the r x c array `A`, c >= r, into [L 0] by Householder reflections from the right, L lower triangular with a
/// diagonal >= 0: A Aᵀ = L Lᵀ, without a square having been formed (doc/kalman_filter.md eq. 18). No heap.
template <class Matrix>
void make_lower_triangular(Matrix& A) noexcept {
  using Row = Eigen::Matrix<double, 1, Matrix::ColsAtCompileTime, Eigen::RowMajor, 1, Matrix::MaxColsAtCompileTime>;
  using Column = Eigen::Matrix<double, Matrix::RowsAtCompileTime, 1, 0, Matrix::MaxRowsAtCompileTime, 1>;
  const Eigen::Index rows = A.rows();
  const Eigen::Index columns = A.cols();
  Row v(columns);
  Column w(rows);
  for (Eigen::Index k = 0; k < rows; ++k) {
    const Eigen::Index below = rows - k - 1;
    const double rest = A.row(k).tail(columns - k - 1).squaredNorm();
    const double pivot = A(k, k);
    if (rest > 0.0) {
      const double norm = std::sqrt(pivot * pivot + rest);
      const double image = pivot > 0.0 ? -norm : norm;
      v.tail(columns - k) = A.row(k).tail(columns - k);
      v[k] -= image;
      const double beta = 1.0 / (norm * (norm + std::abs(pivot)));
      w.tail(below).setZero();
      for (Eigen::Index j = k; j < columns; ++j) w.tail(below) += A.col(j).tail(below) * v[j];
      for (Eigen::Index j = k; j < columns; ++j) A.col(j).tail(below) -= w.tail(below) * (beta * v[j]);
      A.row(k).tail(columns - k).setZero();
      A(k, k) = image;
    }
    if (A(k, k) < 0.0) A.col(k).tail(rows - k) *= -1.0;
  }
}

}  // namespace soopnav::detail
