#pragma once

#include <Eigen/Core>

#include "soopnav/estimation/consistency.hpp"

namespace soopnav {

/// Statistics of a batch of errors against the covariances that a filter stated. `errors`: (T, n), a row per run or
/// epoch. `covariances`: (T * n, n), one below the other. All allocate unless said otherwise, and throw
/// std::invalid_argument naming the argument when shapes do not fit.

/// NEES of every row (see `nees`): NaN where it has none.
[[nodiscard]] Eigen::VectorXd nees_series(const Eigen::Ref<const Eigen::MatrixXd>& errors,
                                          const Eigen::Ref<const Eigen::MatrixXd>& covariances);

/// Root mean square of each component, (n). NaN in a component gives NaN. No rows are refused.
[[nodiscard]] Eigen::VectorXd rmse(const Eigen::Ref<const Eigen::MatrixXd>& errors);

/// Share of the errors inside the region that the stated covariance gives `probability` in (0, 1): NEES below the
/// chi-square quantile of n degrees of freedom. A row without NEES counts as outside.
[[nodiscard]] double coverage(const Eigen::Ref<const Eigen::MatrixXd>& errors,
                              const Eigen::Ref<const Eigen::MatrixXd>& covariances, double probability);

/// Between these the share of `runs` >= 1 independent trials that succeed with `probability` in (0, 1) each lies,
/// inclusive, but for at most `failure_probability` in (0, 1), half on each side: the binomial distribution itself, not
/// its normal approximation. NaN for arguments outside those ranges. No allocation.
[[nodiscard]] MeanBounds coverage_bounds(double probability, int runs, double failure_probability) noexcept;

/// Radius of the circle about the origin that holds `probability` in (0, 1] of the `errors` (T, 2): their sample
/// quantile, the smallest of them that enough others do not exceed. `circular_error_m` is its counterpart from a
/// covariance.
[[nodiscard]] double sample_circular_error_m(const Eigen::Ref<const Eigen::MatrixXd>& errors_m,
                                             double probability = 0.5);

}  // namespace soopnav
