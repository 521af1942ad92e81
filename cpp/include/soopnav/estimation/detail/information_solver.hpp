#pragma once

#include <Eigen/Core>
#include <cmath>

#include "soopnav/estimation/detail/small_matrix.hpp"
#include "soopnav/estimation/detail/symmetric_eigen.hpp"

namespace soopnav::detail {

/// An eigenvalue of an information matrix of unit diagonal below this, for each component, is rounding.
inline constexpr double kInformationRankTolerance = 1e-14;
/// A row lies in what is determined when its part outside is below this share of it.
inline constexpr double kDeterminedTolerance = 1e-7;

/// Solves with an information matrix Y = D C D that may be singular; C has a unit diagonal, or zeros where nothing is
/// known. Cholesky where C is definite to rounding, otherwise the eigenvectors of C, solutions of least norm.
template <int Dim>
class InformationSolver {
 public:
  using Square = Eigen::Matrix<double, Dim, Dim>;
  using Vector = Eigen::Matrix<double, Dim, 1>;

  explicit InformationSolver(const Square& Y) noexcept {
    for (int i = 0; i < Dim; ++i) scale_[i] = Y(i, i) > 0.0 ? 1.0 / std::sqrt(Y(i, i)) : 1.0;
    Square C;
    for (int j = 0; j < Dim; ++j) {
      for (int i = 0; i < Dim; ++i) C.coeffRef(i, j) = scale_[i] * Y.coeff(i, j) * scale_[j];
    }
    root_ = C;
    definite_ = cholesky_in_place(root_.data(), Dim);
    for (int i = 0; i < Dim && definite_; ++i) {
      const double pivot = root_.coeff(i, i);
      definite_ = pivot * pivot > kInformationRankTolerance * Dim;
    }
    rank_ = Dim;
    if (definite_) return;
    Vector values;
    symmetric_eigen(C.data(), Dim, values.data(), vectors_.data());
    rank_ = 0;
    for (int i = 0; i < Dim; ++i) {
      const double value = values[i];
      const bool counts = value > kInformationRankTolerance * Dim;
      inverse_[i] = counts ? 1.0 / value : 0.0;
      rank_ += counts ? 1 : 0;
    }
  }

  [[nodiscard]] bool definite() const noexcept { return definite_; }
  [[nodiscard]] int rank() const noexcept { return rank_; }

  /// A solution X of Y X = B for B in the range of Y.
  template <class Right>
  [[nodiscard]] Right solve(const Right& B) const noexcept {
    Right X = B;
    rescale(X);
    if (definite_) {
      solve_lower(root_.data(), Dim, X.data(), X.cols());
      solve_lower_transposed(root_.data(), Dim, X.data(), X.cols());
    } else {
      Right turned = X;
      for (Eigen::Index i = 0; i < X.size(); ++i) turned.data()[i] = 0.0;
      accumulate_transposed_product<1>(vectors_, X, turned);
      for (Eigen::Index j = 0; j < X.cols(); ++j) {
        for (int i = 0; i < Dim; ++i) turned.coeffRef(i, j) *= inverse_[i];
      }
      product(vectors_, turned, X);
    }
    rescale(X);
    return X;
  }

  /// Whether hᵀ x is determined: h has no part outside the range of Y.
  template <class Row>
  [[nodiscard]] bool determines(const Row& h) const noexcept {
    if (definite_) return true;
    Vector g = h;
    rescale(g);
    const double whole = squared_norm(g);
    double outside = 0.0;
    for (int i = 0; i < Dim; ++i) {
      double part = 0.0;
      for (int k = 0; k < Dim; ++k) part += vectors_.coeff(k, i) * g[k];
      if (!(inverse_[i] > 0.0)) outside += part * part;
    }
    return outside <= kDeterminedTolerance * kDeterminedTolerance * whole;
  }

 private:
  template <class Right>
  void rescale(Right& X) const noexcept {
    for (Eigen::Index j = 0; j < X.cols(); ++j) {
      for (int i = 0; i < Dim; ++i) X.coeffRef(i, j) *= scale_[i];
    }
  }

  Vector scale_;
  Square root_;
  Square vectors_;
  Vector inverse_;
  bool definite_ = false;
  int rank_ = 0;
};

}  // namespace soopnav::detail
