#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "soopnav/array/direction_finder.hpp"
#include "soopnav/core/random.hpp"

namespace soopnav::simulation {

/// How a map from eigenvalues to bearing errors is drawn.
struct EigenvalueMapOptions {
  std::size_t snapshots = 2500;      ///< of a sample covariance
  std::size_t trials = 400;          ///< at each SNR
  double elevation_low_rad = 0.02;   ///< directions are drawn evenly between these elevations ...
  double elevation_high_rad = 0.35;  ///< ... and in all azimuths
};

/// At each SNR: the ratio of the mean largest eigenvalue to the mean of the others, and the rms errors of MUSIC.
struct EigenvalueMap {
  std::vector<double> snr_db;
  std::vector<double> ratio;
  std::vector<double> azimuth_rms_rad;  ///< about 1.81 (pi / sqrt 3) when nothing is left of the signal
  std::vector<double> elevation_rms_rad;
  std::vector<double> angle_rms_rad;  ///< between the true and the found direction
};

/// Monte Carlo of one source: sample covariances from their exact law, directions by MUSIC (carter 5.3, fig. 5.13:
/// "the variance from the eigenvalue ratio"). Trial k of SNR i draws from substream i of `random`, its substream k, so
/// an SNR does not depend on the others. A trial without a direction is left out. About 15 us a trial on a grid of two
/// degrees. Allocates.
/// @throws std::invalid_argument for no SNR, one that is not finite, no snapshots, fewer than 10 trials, or elevations
/// that do not ascend within +-90 degrees.
[[nodiscard]] EigenvalueMap eigenvalue_map(std::shared_ptr<const array::SteeringTable> table,
                                           std::span<const double> snr_db, const EigenvalueMapOptions& options,
                                           const RandomStream& random);

}  // namespace soopnav::simulation
