#pragma once

#include <Eigen/Core>
#include <optional>

namespace soopnav {

/// The curve of constant density of a two-dimensional Gaussian error.
struct ErrorEllipse {
  double semi_major_m = 0.0;  ///< half the long axis [m]
  double semi_minor_m = 0.0;  ///< half the short axis [m]
  /// Direction of the long axis, from the first axis towards the second, in (-pi/2, pi/2] [rad]. With east and north as
  /// axes its azimuth is pi/2 minus this.
  double angle_rad = 0.0;
};

/// The ellipse of a 2 x 2 covariance [m²] that holds the error with `probability` in (0, 1); without one the 1-sigma
/// ellipse, which holds it with 0.393. Axes are sqrt(eigenvalue * q), q the chi-square quantile of two degrees of
/// freedom. Nothing for a covariance that is not finite, not symmetric to 1e-9 of its trace or has a negative
/// eigenvalue, and for a probability outside (0, 1). No allocation.
[[nodiscard]] std::optional<ErrorEllipse> error_ellipse(const Eigen::Matrix2d& covariance_m2) noexcept;
[[nodiscard]] std::optional<ErrorEllipse> error_ellipse(const Eigen::Matrix2d& covariance_m2,
                                                        double probability) noexcept;

/// Probability that a centred Gaussian error of 2 x 2 `covariance_m2` [m²] ends within `radius_m` of the origin.
/// Exact (doc/position_fix.md eq. 15), absolute error below 1e-12. NaN where `error_ellipse` gives nothing, and for a
/// negative radius. No allocation.
[[nodiscard]] double probability_within(const Eigen::Matrix2d& covariance_m2, double radius_m) noexcept;

/// Radius of the circle about the origin that holds a centred Gaussian error with `probability` in (0, 1): circular
/// error probable for 0.5 [m]. The exact circle, not one of the usual fits; relative error below 1e-9. Nothing where
/// `error_ellipse` gives nothing. No allocation.
[[nodiscard]] std::optional<double> circular_error_m(const Eigen::Matrix2d& covariance_m2,
                                                     double probability = 0.5) noexcept;

}  // namespace soopnav
