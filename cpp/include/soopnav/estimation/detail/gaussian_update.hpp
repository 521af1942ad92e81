#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <type_traits>

#include "soopnav/core/status.hpp"
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
  if (!R.allFinite()) return UpdateStatus::kNonFinite;
  if constexpr (Matrix::RowsAtCompileTime == 1) {
    return R(0, 0) > 0.0 ? UpdateStatus::kAccepted : UpdateStatus::kNotPositiveDefinite;
  } else {
    for (Eigen::Index i = 0; i < R.rows(); ++i) {
      for (Eigen::Index j = 0; j < i; ++j) {
        if (!(std::abs(R(i, j) - R(j, i)) <= 1e-9 * std::sqrt(std::abs(R(i, i) * R(j, j))))) {
          return UpdateStatus::kNotPositiveDefinite;
        }
      }
    }
    const Eigen::LLT<typename Matrix::PlainObject> llt(R);
    return llt.info() == Eigen::Success ? UpdateStatus::kAccepted : UpdateStatus::kNotPositiveDefinite;
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

/// Solves S Kᵀ = (P Hᵀ)ᵀ, fills NIS, gates. `report.innovation` and `report.covariance` are set. True when K is.
template <class Report, class PHt, class Gain>
[[nodiscard]] bool innovate(Report& report, const PHt& PH, const Gate& gate, Gain& K) noexcept {
  using Square = typename Report::Square;
  if (!report.innovation.allFinite() || !report.covariance.allFinite()) {
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
    const Eigen::LLT<Square> llt(report.covariance);
    if (llt.info() != Eigen::Success) {
      report.status = UpdateStatus::kNotPositiveDefinite;
      return false;
    }
    typename Report::Vector whitened = report.innovation;
    llt.matrixL().solveInPlace(whitened);
    report.nis = whitened.squaredNorm();
    if (!passes(gate, report)) {
      report.status = UpdateStatus::kGated;
      return false;
    }
    // K Sᵀ = P Hᵀ, two triangular solves from the right.
    K = PH;
    llt.matrixU().template solveInPlace<Eigen::OnTheRight>(K);
    llt.matrixL().template solveInPlace<Eigen::OnTheRight>(K);
  }
  return true;
}

/// Copies the lower triangle over the upper one.
template <class Matrix>
void mirror_lower(Matrix& P) noexcept {
  for (Eigen::Index j = 1; j < P.cols(); ++j) {
    for (Eigen::Index i = 0; i < j; ++i) P(i, j) = P(j, i);
  }
}

/// Subtracts K Bᵀ + B Kᵀ, the symmetric form of a low-rank downdate. Of one column it keeps `P` symmetric to the bit.
template <class Square, class Gain, class Columns>
void subtract_symmetric(Square& P, const Gain& K, const Columns& B) noexcept {
  if constexpr (Gain::ColsAtCompileTime == 1) {
    for (Eigen::Index j = 0; j < P.cols(); ++j) P.col(j) -= K * B[j] + B * K[j];
  } else {
    P.noalias() -= K * B.transpose();
    P.noalias() -= B * K.transpose();
  }
}

/// Joseph's covariance update (I - K H) P (I - K H)ᵀ + K R Kᵀ (doc/kalman_filter.md).
///
/// With P' = P - K (P Hᵀ)ᵀ it is P' - C Kᵀ, where C = P' Hᵀ - K R is zero but for what rounding of the gain and of P'
/// left, and both terms are subtracted as one symmetric one: B = (P Hᵀ + C) / 2.
template <class Square, class HMatrix, class RMatrix, class PHt, class Gain>
void joseph_update(Square& P, const HMatrix& H, const RMatrix& R, const PHt& PH, const Gain& K) noexcept {
  PHt B = PH;
  B.noalias() -= K * (H * PH);
  B.noalias() -= K * R;
  B = 0.5 * (B + PH);
  subtract_symmetric(P, K, B);
  if constexpr (Gain::ColsAtCompileTime != 1) mirror_lower(P);
}

/// Lower triangular L with L Lᵀ = P, for positive semi-definite P: a pivot that vanishes to rounding gets a column of
/// zeros. False when a pivot is negative beyond rounding.
template <class Square>
[[nodiscard]] bool semidefinite_root(const Square& P, Square& L) noexcept {
  L.setZero();
  for (Eigen::Index j = 0; j < P.cols(); ++j) {
    const double pivot = P(j, j) - L.row(j).head(j).squaredNorm();
    const double rounding = 1e-13 * std::abs(P(j, j));
    if (!(pivot >= -rounding)) return false;
    if (pivot <= rounding) continue;
    L(j, j) = std::sqrt(pivot);
    for (Eigen::Index i = j + 1; i < P.rows(); ++i) {
      L(i, j) = (P(i, j) - L.row(i).head(j).dot(L.row(j).head(j))) / L(j, j);
    }
  }
  return true;
}

/// Whether `P` can be a covariance after an update: finite, no negative variance.
template <class Square>
[[nodiscard]] bool is_sound(const Square& P) noexcept {
  return P.allFinite() && (P.diagonal().array() >= 0.0).all();
}

}  // namespace soopnav::detail
