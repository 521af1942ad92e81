#pragma once

#include <Eigen/Core>
#include <cmath>

/// Algebra of a filter's small matrices as loops over coefficients. Every expression of Eigen is a family of types that
/// each user of a filter compiles; these cost nothing, allocate nothing and unroll where sizes are fixed. Outputs have
/// their size before, and do not overlap the inputs. Arrays are column-major and dense.
namespace soopnav::detail {

/// Whether the numbers of a matrix are finite: times zero they are zero, but for infinities and NaN. One sum for each
/// column, so that none waits for another.
template <class Matrix>
[[nodiscard]] bool all_finite(const Matrix& A) noexcept {
  bool finite = true;
  for (Eigen::Index j = 0; j < A.cols(); ++j) {
    double zero = 0.0;
    for (Eigen::Index i = 0; i < A.rows(); ++i) zero += A.coeff(i, j) * 0.0;
    finite &= zero == 0.0;
  }
  return finite;
}

/// Sum of the squares of a vector that owns its numbers.
template <class Vector>
[[nodiscard]] double squared_norm(const Vector& x) noexcept {
  double sum = 0.0;
  for (Eigen::Index i = 0; i < x.size(); ++i) sum += x.coeff(i) * x.coeff(i);
  return sum;
}

/// xᵀ A x.
template <class Square, class Vector>
[[nodiscard]] double quadratic_form(const Square& A, const Vector& x) noexcept {
  double sum = 0.0;
  for (Eigen::Index j = 0; j < x.size(); ++j) {
    double Ax = 0.0;
    for (Eigen::Index i = 0; i < x.size(); ++i) Ax += A.coeff(i, j) * x.coeff(i);
    sum += Ax * x.coeff(j);
  }
  return sum;
}

/// Copies rows x columns numbers from (row, column) of `from` to (to_row, to_column) of `to`.
template <class From, class To>
void copy_block(const From& from, Eigen::Index row, Eigen::Index column, Eigen::Index rows, Eigen::Index columns,
                To& to, Eigen::Index to_row, Eigen::Index to_column) noexcept {
  for (Eigen::Index j = 0; j < columns; ++j) {
    for (Eigen::Index i = 0; i < rows; ++i) to.coeffRef(to_row + i, to_column + j) = from.coeff(row + i, column + j);
  }
}

/// out += sign A B, over the rows and columns of `out` and the rows of `B`.
template <int Sign, class A, class B, class Out>
void accumulate_product(const A& a, const B& b, Out& out) noexcept {
  for (Eigen::Index j = 0; j < out.cols(); ++j) {
    for (Eigen::Index k = 0; k < b.rows(); ++k) {
      const double factor = Sign * b.coeff(k, j);
      for (Eigen::Index i = 0; i < out.rows(); ++i) out.coeffRef(i, j) += a.coeff(i, k) * factor;
    }
  }
}
/// out = A B, likewise.
template <class A, class B, class Out>
void product(const A& a, const B& b, Out& out) noexcept {
  for (Eigen::Index i = 0; i < out.size(); ++i) out.data()[i] = 0.0;
  accumulate_product<1>(a, b, out);
}
/// out += sign A Bᵀ, over the rows and columns of `out` and the columns of `B`.
template <int Sign, class A, class B, class Out>
void accumulate_product_transposed(const A& a, const B& b, Out& out) noexcept {
  for (Eigen::Index j = 0; j < out.cols(); ++j) {
    for (Eigen::Index k = 0; k < b.cols(); ++k) {
      const double factor = Sign * b.coeff(j, k);
      for (Eigen::Index i = 0; i < out.rows(); ++i) out.coeffRef(i, j) += a.coeff(i, k) * factor;
    }
  }
}
/// out = A Bᵀ, likewise.
template <class A, class B, class Out>
void product_transposed(const A& a, const B& b, Out& out) noexcept {
  for (Eigen::Index i = 0; i < out.size(); ++i) out.data()[i] = 0.0;
  accumulate_product_transposed<1>(a, b, out);
}
/// out += sign Aᵀ B, over the rows and columns of `out` and the rows of `B`.
template <int Sign, class A, class B, class Out>
void accumulate_transposed_product(const A& a, const B& b, Out& out) noexcept {
  for (Eigen::Index j = 0; j < out.cols(); ++j) {
    for (Eigen::Index i = 0; i < out.rows(); ++i) {
      double sum = 0.0;
      for (Eigen::Index k = 0; k < b.rows(); ++k) sum += a.coeff(k, i) * b.coeff(k, j);
      out.coeffRef(i, j) += Sign * sum;
    }
  }
}

/// Turns the symmetric `a`, whose lower triangle is read, into the lower triangular L of a = L Lᵀ. The upper triangle
/// stays. False when `a` is not positive definite.
[[nodiscard]] inline bool cholesky_in_place(double* a, Eigen::Index n) noexcept {
  for (Eigen::Index j = 0; j < n; ++j) {
    double* column = a + j * n;
    for (Eigen::Index k = 0; k < j; ++k) {
      const double factor = a[j + k * n];
      for (Eigen::Index i = j; i < n; ++i) column[i] -= a[i + k * n] * factor;
    }
    if (!(column[j] > 0.0)) return false;
    const double pivot = std::sqrt(column[j]);
    column[j] = pivot;
    for (Eigen::Index i = j + 1; i < n; ++i) column[i] /= pivot;
  }
  return true;
}

/// x := L⁻¹ x for the n x columns array `x`.
inline void solve_lower(const double* L, Eigen::Index n, double* x, Eigen::Index columns = 1) noexcept {
  for (double* end = x + n * columns; x != end; x += n) {
    for (Eigen::Index k = 0; k < n; ++k) {
      x[k] /= L[k + k * n];
      for (Eigen::Index i = k + 1; i < n; ++i) x[i] -= L[i + k * n] * x[k];
    }
  }
}
/// x := L⁻ᵀ x for the n x columns array `x`.
inline void solve_lower_transposed(const double* L, Eigen::Index n, double* x, Eigen::Index columns = 1) noexcept {
  for (double* end = x + n * columns; x != end; x += n) {
    for (Eigen::Index k = n - 1; k >= 0; --k) {
      for (Eigen::Index i = k + 1; i < n; ++i) x[k] -= L[i + k * n] * x[i];
      x[k] /= L[k + k * n];
    }
  }
}
/// x := x L⁻ᵀ for the rows x n array `x`.
inline void solve_right_lower_transposed(const double* L, Eigen::Index n, double* x, Eigen::Index rows) noexcept {
  for (Eigen::Index j = 0; j < n; ++j) {
    for (Eigen::Index k = 0; k < j; ++k) {
      for (Eigen::Index i = 0; i < rows; ++i) x[i + j * rows] -= x[i + k * rows] * L[j + k * n];
    }
    for (Eigen::Index i = 0; i < rows; ++i) x[i + j * rows] /= L[j + j * n];
  }
}
/// x := x L⁻¹ for the rows x n array `x`.
inline void solve_right_lower(const double* L, Eigen::Index n, double* x, Eigen::Index rows) noexcept {
  for (Eigen::Index j = n - 1; j >= 0; --j) {
    for (Eigen::Index k = j + 1; k < n; ++k) {
      for (Eigen::Index i = 0; i < rows; ++i) x[i + j * rows] -= x[i + k * rows] * L[k + j * n];
    }
    for (Eigen::Index i = 0; i < rows; ++i) x[i + j * rows] /= L[j + j * n];
  }
}

/// b := A⁻¹ b for the n x n array `a`, which is spent, and the n x columns array `b`, by elimination with row pivoting.
/// False, `b` spent, when a pivot vanishes beside the largest to rounding.
[[nodiscard]] bool solve_square(double* a, int n, double* b, int columns) noexcept;

/// Lower Cholesky factor, for an observation's noise or the like.
template <class Square>
struct CholeskyFactor {
  Square L;
  bool definite;

  explicit CholeskyFactor(const Square& S) noexcept : L(S), definite(cholesky_in_place(L.data(), L.rows())) {}
  /// x := L⁻¹ x.
  template <class Vector>
  void whiten(Vector& x) const noexcept {
    solve_lower(L.data(), L.rows(), x.data());
  }
};

}  // namespace soopnav::detail
