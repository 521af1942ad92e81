#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/status.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/detail/small_matrix.hpp"

namespace soopnav {

/// When a Kalman filter refuses an observation that is possible but implausible. Nothing is refused by default.
struct Gate {
  /// Refused when the normalised innovation squared lies above this (chi-square test).
  double nis = std::numeric_limits<double>::infinity();
  /// Residual monitor: refused when any component of the innovation exceeds this, in the units of z ...
  double residual = std::numeric_limits<double>::infinity();
  /// ... unless it lies within so many of its own standard deviations: a fixed threshold alone locks a filter out that
  /// has coasted until its uncertainty is larger than the threshold.
  double residual_sigmas = 0.0;

  /// The chi-square gate that refuses good observations of `rows` components with `probability` in (0, 1).
  [[nodiscard]] static Gate probability(double probability, int rows) noexcept {
    Gate gate;
    gate.nis = chi_square_upper_quantile(probability, rows);
    return gate;
  }
};

/// What became of an update. `M` rows, or Eigen::Dynamic with at most `MaxM`: no heap either way.
///
/// Innovation, covariance and NIS are those of the attempt whatever the status (NaN where it was refused before they
/// were known): a gated observation is reported with what gated it.
template <int M, int MaxM = M>
struct UpdateReport {
  using Vector = Eigen::Matrix<double, M, 1, 0, MaxM, 1>;
  using Square = Eigen::Matrix<double, M, M, 0, MaxM, MaxM>;

  UpdateStatus status = UpdateStatus::kUndefined;
  Vector innovation;                                      ///< z - h(x), angles the short way round
  Square covariance;                                      ///< S = H P Hᵀ + R, of the innovation
  double nis = std::numeric_limits<double>::quiet_NaN();  ///< innovationᵀ S⁻¹ innovation

  explicit UpdateReport(int rows = M == Eigen::Dynamic ? 0 : M) {
    innovation.setConstant(rows, std::numeric_limits<double>::quiet_NaN());
    covariance.setConstant(rows, rows, std::numeric_limits<double>::quiet_NaN());
  }
  [[nodiscard]] bool accepted() const noexcept { return status == UpdateStatus::kAccepted; }
  /// Logarithm of the Gaussian density of the innovation, -(nis + log det(2 pi S)) / 2; NaN where `nis` is.
  [[nodiscard]] double log_likelihood() const noexcept {
    if (!(nis >= 0.0)) return std::numeric_limits<double>::quiet_NaN();
    const detail::CholeskyFactor<Square> root(covariance);
    if (!root.definite) return std::numeric_limits<double>::quiet_NaN();
    double log_determinant = static_cast<double>(innovation.size()) * std::log(kTwoPi);
    for (Eigen::Index i = 0; i < innovation.size(); ++i) log_determinant += 2.0 * std::log(root.L.coeff(i, i));
    return -0.5 * (nis + log_determinant);
  }
};

}  // namespace soopnav
