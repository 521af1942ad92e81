#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <type_traits>

#include "soopnav/core/status.hpp"
#include "soopnav/estimation/detail/small_matrix.hpp"
#include "soopnav/estimation/update_report.hpp"

namespace soopnav::detail {

/// A matrix of sizes known or bounded when compiling; Eigen wants a row to be stored as a row.
template <int Rows, int Columns, int MaxRows = Rows, int MaxColumns = Columns>
using BoundedMatrix =
    Eigen::Matrix<double, Rows, Columns, MaxRows == 1 && MaxColumns != 1 ? Eigen::RowMajor : Eigen::ColMajor, MaxRows,
                  MaxColumns>;

/// Whether `R` can be the covariance of an observation: finite, symmetric to rounding, positive definite.
template <class Matrix>
[[nodiscard]] UpdateStatus check_noise(const Matrix& R) noexcept {
  if constexpr (Matrix::RowsAtCompileTime == 1) {
    const double r = R.coeff(0, 0);
    if (!std::isfinite(r)) return UpdateStatus::kNonFinite;
    return r > 0.0 ? UpdateStatus::kAccepted : UpdateStatus::kNotPositiveDefinite;
  } else {
    typename Matrix::PlainObject L = R;
    if (!all_finite(L)) return UpdateStatus::kNonFinite;
    for (Eigen::Index i = 0; i < L.rows(); ++i) {
      for (Eigen::Index j = 0; j < i; ++j) {
        const double scale = std::sqrt(std::abs(L.coeff(i, i) * L.coeff(j, j)));
        if (!(std::abs(L.coeff(i, j) - L.coeff(j, i)) <= 1e-9 * scale)) return UpdateStatus::kNotPositiveDefinite;
      }
    }
    return cholesky_in_place(L.data(), L.rows()) ? UpdateStatus::kAccepted : UpdateStatus::kNotPositiveDefinite;
  }
}

/// Whether `gate` lets the innovation of `report` pass; its nis and covariance are set.
template <class Report>
[[nodiscard]] bool passes(const Gate& gate, const Report& report) noexcept {
  if (report.nis > gate.nis) return false;
  if (std::isinf(gate.residual)) return true;
  for (Eigen::Index i = 0; i < report.innovation.size(); ++i) {
    const double limit = std::max(gate.residual, gate.residual_sigmas * std::sqrt(report.covariance(i, i)));
    if (std::abs(report.innovation[i]) > limit) return false;
  }
  return true;
}

/// PH = P Hᵀ and S = H P Hᵀ + R.
template <class HMatrix, class Square, class RMatrix, class PHt, class Covariance>
void project(const HMatrix& H, const Square& P, const RMatrix& R, PHt& PH, Covariance& S) noexcept {
  if constexpr (PHt::ColsAtCompileTime == 1) {
    PH.noalias() = P * H.transpose();
    S.noalias() = H * PH;
    S += R;
  } else {
    product_transposed(P, H, PH);
    S = R;
    accumulate_product<1>(H, PH, S);
  }
}

/// step = K innovation.
template <class Gain, class Vector, class Tangent>
void correct(const Gain& K, const Vector& innovation, Tangent& step) noexcept {
  if constexpr (Gain::ColsAtCompileTime == 1) {
    step = K * innovation[0];
  } else {
    product(K, innovation, step);
  }
}

/// Solves S Kᵀ = (P Hᵀ)ᵀ, fills NIS, gates. `report.innovation` and `report.covariance` are set. True when K is.
template <class Report, class PHt, class Gain>
[[nodiscard]] bool innovate(Report& report, const PHt& PH, const Gate& gate, Gain& K) noexcept {
  using Square = typename Report::Square;
  if (!all_finite(report.innovation) || !all_finite(report.covariance)) {
    report.status = UpdateStatus::kNonFinite;
    return false;
  }
  if constexpr (Square::RowsAtCompileTime == 1) {
    const double s = report.covariance(0, 0);
    if (!(s > 0.0)) {
      report.status = UpdateStatus::kNotPositiveDefinite;
      return false;
    }
    report.nis = report.innovation[0] * report.innovation[0] / s;
    if (!passes(gate, report)) {
      report.status = UpdateStatus::kGated;
      return false;
    }
    K = PH * (1.0 / s);
  } else {
    const CholeskyFactor<Square> root(report.covariance);
    if (!root.definite) {
      report.status = UpdateStatus::kNotPositiveDefinite;
      return false;
    }
    typename Report::Vector whitened = report.innovation;
    root.whiten(whitened);
    report.nis = squared_norm(whitened);
    if (!passes(gate, report)) {
      report.status = UpdateStatus::kGated;
      return false;
    }
    // K Sᵀ = P Hᵀ, two triangular solves from the right.
    K = PH;
    solve_right_lower_transposed(root.L.data(), K.cols(), K.data(), K.rows());
    solve_right_lower(root.L.data(), K.cols(), K.data(), K.rows());
  }
  return true;
}

/// Copies the lower triangle over the upper one.
template <class Matrix>
void mirror_lower(Matrix& P) noexcept {
  for (Eigen::Index j = 1; j < P.cols(); ++j) {
    for (Eigen::Index i = 0; i < j; ++i) P.coeffRef(i, j) = P.coeff(j, i);
  }
}

/// Subtracts K Bᵀ + B Kᵀ, the symmetric form of a low-rank downdate. Of one column it keeps `P` symmetric to the bit.
template <class Square, class Gain, class Columns>
void subtract_symmetric(Square& P, const Gain& K, const Columns& B) noexcept {
  if constexpr (Gain::ColsAtCompileTime == 1) {
    for (Eigen::Index j = 0; j < P.cols(); ++j) P.col(j) -= K * B[j] + B * K[j];
  } else {
    accumulate_product_transposed<-1>(K, B, P);
    accumulate_product_transposed<-1>(B, K, P);
  }
}

/// Joseph's covariance update (I - K H) P (I - K H)ᵀ + K R Kᵀ (doc/kalman_filter.md).
///
/// With P' = P - K (P Hᵀ)ᵀ it is P' - C Kᵀ, where C = P' Hᵀ - K R is zero but for what rounding of the gain and of P'
/// left, and both terms are subtracted as one symmetric one: B = (P Hᵀ + C) / 2.
template <class Square, class HMatrix, class RMatrix, class PHt, class Gain>
void joseph_update(Square& P, const HMatrix& H, const RMatrix& R, const PHt& PH, const Gain& K) noexcept {
  PHt B = PH;
  if constexpr (Gain::ColsAtCompileTime == 1) {
    B.noalias() -= K * (H * PH);
    B.noalias() -= K * R;
    B = 0.5 * (B + PH);
  } else {
    RMatrix HPH = R;
    product(H, PH, HPH);
    accumulate_product<-1>(K, HPH, B);
    accumulate_product<-1>(K, R, B);
    for (Eigen::Index i = 0; i < B.size(); ++i) B.data()[i] = 0.5 * (B.data()[i] + PH.data()[i]);
  }
  subtract_symmetric(P, K, B);
  if constexpr (Gain::ColsAtCompileTime != 1) mirror_lower(P);
}

/// Lower triangular L with L Lᵀ = P, for positive semi-definite P: a pivot that vanishes to rounding gets a column of
/// zeros. False when a pivot is negative beyond rounding.
template <class Square>
[[nodiscard]] bool semidefinite_root(const Square& P, Square& L) noexcept {
  for (Eigen::Index j = 0; j < P.cols(); ++j) {
    for (Eigen::Index i = 0; i < P.rows(); ++i) L.coeffRef(i, j) = 0.0;
    double pivot = P.coeff(j, j);
    for (Eigen::Index k = 0; k < j; ++k) pivot -= L.coeff(j, k) * L.coeff(j, k);
    const double rounding = 1e-13 * std::abs(P.coeff(j, j));
    if (!(pivot >= -rounding)) return false;
    if (pivot <= rounding) continue;
    const double root = std::sqrt(pivot);
    L.coeffRef(j, j) = root;
    for (Eigen::Index i = j + 1; i < P.rows(); ++i) {
      double rest = P.coeff(i, j);
      for (Eigen::Index k = 0; k < j; ++k) rest -= L.coeff(i, k) * L.coeff(j, k);
      L.coeffRef(i, j) = rest / root;
    }
  }
  return true;
}

/// Whether `P` can be a covariance after an update: finite, no negative variance.
template <class Square>
[[nodiscard]] bool is_sound(const Square& P) noexcept {
  bool sound = all_finite(P);
  for (Eigen::Index i = 0; i < P.rows(); ++i) sound &= P.coeff(i, i) >= 0.0;
  return sound;
}

}  // namespace soopnav::detail
