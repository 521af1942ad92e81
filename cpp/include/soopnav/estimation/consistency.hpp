#pragma once

#include <Eigen/Core>
#include <cmath>
#include <optional>

#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/detail/small_matrix.hpp"

namespace soopnav {

/// Normalised estimation error squared, eᵀ P⁻¹ e (Bar-Shalom, Li and Kirubarajan 2001, eq. 5.4.2-1): chi-square of as
/// many degrees of freedom as `error` has components when the covariance is right and the error Gaussian.
/// Nothing when a number is not finite or `covariance` is not positive definite. Allocates for dynamic sizes only.
template <class Error, class Covariance>
[[nodiscard]] std::optional<double> nees(const Eigen::MatrixBase<Error>& error,
                                         const Eigen::MatrixBase<Covariance>& covariance) {
  if (error.size() != covariance.rows() || covariance.rows() != covariance.cols()) return std::nullopt;
  if (!error.allFinite() || !covariance.allFinite()) return std::nullopt;
  const detail::CholeskyFactor<typename Covariance::PlainObject> root(covariance);
  if (!root.definite) return std::nullopt;
  typename Error::PlainObject whitened = error;
  root.whiten(whitened);
  return detail::squared_norm(whitened);
}

/// Between these the mean of `runs` independent NEES (or NIS) values lies with the probability asked for.
struct MeanBounds {
  double lower = 0.0;
  double upper = 0.0;
};

/// Two-sided bounds for the mean of `runs` >= 1 independent chi-square values of `dof` > 0 degrees of freedom, which a
/// consistent estimator leaves with `failure_probability` in (0, 1), half on each side (eq. 5.4.2-4 of the same book).
/// NaN for arguments outside those ranges. No allocation.
[[nodiscard]] MeanBounds mean_nees_bounds(double dof, int runs, double failure_probability) noexcept;

}  // namespace soopnav
