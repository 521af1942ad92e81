#pragma once

#include <Eigen/Core>
#include <cmath>

namespace soopnav::detail {

/// Turns the rows x columns array `a`, columns >= rows, into [L 0] by Householder reflections from the right, L lower
/// triangular with a diagonal >= 0: A Aᵀ = L Lᵀ, without a square having been formed (doc/kalman_filter.md eq. 18).
/// `v` and `w` are room for `columns` and `rows` numbers. Loops over a column-major array, so that it costs nothing to
/// compile for one more size.
inline void make_lower_triangular(double* a, Eigen::Index rows, Eigen::Index columns, double* v, double* w) noexcept {
  for (Eigen::Index k = 0; k < rows; ++k) {
    double* const column = a + k * rows;
    double rest = 0.0;
    for (Eigen::Index j = k + 1; j < columns; ++j) rest += a[k + j * rows] * a[k + j * rows];
    const double pivot = column[k];
    if (rest > 0.0) {
      const double norm = std::sqrt(pivot * pivot + rest);
      const double image = pivot > 0.0 ? -norm : norm;
      for (Eigen::Index j = k; j < columns; ++j) v[j] = a[k + j * rows];
      v[k] -= image;
      const double beta = 1.0 / (norm * (norm + std::abs(pivot)));
      for (Eigen::Index i = k + 1; i < rows; ++i) w[i] = 0.0;
      for (Eigen::Index j = k; j < columns; ++j) {
        for (Eigen::Index i = k + 1; i < rows; ++i) w[i] += a[i + j * rows] * v[j];
      }
      for (Eigen::Index j = k; j < columns; ++j) {
        const double factor = beta * v[j];
        for (Eigen::Index i = k + 1; i < rows; ++i) a[i + j * rows] -= w[i] * factor;
        a[k + j * rows] = 0.0;
      }
      column[k] = image;
    }
    if (column[k] < 0.0) {
      for (Eigen::Index i = k; i < rows; ++i) column[i] = -column[i];
    }
  }
}

/// The same of a matrix. No heap where its sizes are fixed or bounded.
template <class Matrix>
void make_lower_triangular(Matrix& A) noexcept {
  static_assert(!Matrix::IsRowMajor);
  Eigen::Matrix<double, Matrix::ColsAtCompileTime, 1, 0, Matrix::MaxColsAtCompileTime, 1> v(A.cols());
  Eigen::Matrix<double, Matrix::RowsAtCompileTime, 1, 0, Matrix::MaxRowsAtCompileTime, 1> w(A.rows());
  make_lower_triangular(A.data(), A.rows(), A.cols(), v.data(), w.data());
}

}  // namespace soopnav::detail
