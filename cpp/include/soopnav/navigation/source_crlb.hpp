#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "soopnav/navigation/source_locator.hpp"

namespace soopnav::navigation {

/// What a bound assumes beside the bearings.
struct SourceBoundOptions {
  int dimensions = 2;
  SourceMotion motion = SourceMotion::kStatic;
  double acceleration_psd = 0.0;        ///< white acceleration of a moving source [m²/s³]
  double heading_bias_sigma_rad = 0.0;  ///< > 0: an unknown constant of all azimuths, of this 1-sigma
  double start_sigma_m = 0.0;           ///< > 0: prior 1-sigma of each coordinate of the position
  double start_speed_sigma_mps = 0.0;   ///< > 0: prior 1-sigma of each component of the velocity
};

/// Least covariance with which any unbiased estimator can know a source after each bearing: the posterior Cramér-Rao
/// bound along the true geometry (doc/source_location.md section 8; `PosteriorCrlb`), equal to the classical bound for
/// a source at rest and without a prior.
///
/// `bearings`: places, times and standard deviations; the angles themselves are not read. `source_m`: true position at
/// the first bearing, `velocity_mps` its velocity. Returns one matrix for each bearing, of position (2 or 3), then
/// velocity when moving; infinity on the diagonal of what is not determined yet, and NaN beside it. A bearing with a
/// number that is not finite, a bad sigma or from the source's own place adds nothing. Throws std::invalid_argument for
/// options, a source that is not finite, or times that fall. Allocates.
[[nodiscard]] std::vector<Eigen::MatrixXd> source_crlb(std::span<const SourceBearing> bearings,
                                                       const Eigen::Vector3d& source_m,
                                                       const Eigen::Vector3d& velocity_mps,
                                                       const SourceBoundOptions& options);

}  // namespace soopnav::navigation
