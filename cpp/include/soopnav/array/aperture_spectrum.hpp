#pragma once

#include <Eigen/Core>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace soopnav::array {

enum class ApertureMethod : std::uint8_t {
  kBeamforming,  ///< |a^H y|^2 / (n |y|^2), summed over looks: of one look its maximum is the link's coherence
  kMusic,        ///< a^H P a / n, P on the signal subspace of the looks: 1 is all that it can reach
};

/// One node's signal along a path whose clock is known or quiet, seen `looks` times: subcarriers far apart, loops.
struct ApertureLooks {
  std::span<const std::complex<double>> phasors;  ///< n x looks, a row per snapshot
  std::span<const double> path_m;                 ///< n x 2
  double wavelength_m = 0.0;
  /// Snapshots of the sub-apertures that a straight path of even steps is cut into: looks of its own, which tell
  /// coherent paths apart as `spatial_smoothing` does. 0: none.
  std::size_t subaperture = 0;
};

/// Spectrum over `bearing_rad`, 0 .. 1 (doc/synthetic_aperture.md eq. 11). On a straight path both sides look alike.
///
/// MUSIC needs as many looks as sources (paths of one transmitter are coherent: looks must differ in frequency or
/// place). Allocates; n x looks x directions.
/// @throws std::invalid_argument for sizes that do not fit, a wavelength that is not positive, numbers that are not
///         finite or all zero, n_sources outside 1 .. min(n, looks) for MUSIC, more than 32 looks, or a sub-aperture
///         of a path that is not straight and even, or leaves more than 32 looks or fewer than two snapshots each.
[[nodiscard]] std::vector<double> aperture_spectrum(const ApertureLooks& looks, std::span<const double> bearing_rad,
                                                    ApertureMethod method, std::size_t n_sources = 1);

/// Bearings of the highest separate maxima of that spectrum, highest first, found on a grid of a tenth of the beam and
/// refined to 1e-9 rad. At most n_sources; both sides of a straight path count, so ask for twice as many there.
[[nodiscard]] std::vector<double> aperture_directions(const ApertureLooks& looks, ApertureMethod method,
                                                      std::size_t n_sources = 1);

/// What bearings say about a position.
struct BearingCheck {
  std::vector<double> residual_rad;  ///< bearing less the one expected from the position, the free heading taken out
  std::vector<double> statistic;     ///< chi-square of 1 degree of freedom: against position and all other bearings
  std::vector<std::uint8_t> consistent;  ///< below the gate once the worst were left out one by one
  double heading_rad = 0.0;              ///< as given, or as the consistent bearings have it
  double total = 0.0;                    ///< chi-square of the consistent ones together
  int degrees_of_freedom = 0;
};

/// Whether bearings point where nodes are. A single reflection is as coherent as a direct path, and only this tells it.
///
/// Model: bearing_i = atan2(node_i - p) - heading + noise; the statistic is the deletion residual under S = R + H P H^T
/// + sigma_heading^2 1 1^T (doc/synthetic_aperture.md eq. 12). NaN bearings are left out (statistic NaN).
/// @param covariance_rad2 of the bearings, L x L. @param position_covariance_m2 2 x 2.
/// @param heading_sigma_rad 0: exact; infinity: unknown, three bearings at least.
/// @param gate of the statistic; 10.8 refuses one good bearing in a thousand.
/// @throws std::invalid_argument for sizes that do not fit, a node at the position, a covariance that is not positive
///         definite, a gate or sigma that is not positive, numbers that are not finite.
[[nodiscard]] BearingCheck check_bearings(std::span<const double> bearing_rad, const Eigen::MatrixXd& covariance_rad2,
                                          std::span<const double> node_position_m, const Eigen::Vector2d& position_m,
                                          const Eigen::Matrix2d& position_covariance_m2, double heading_rad,
                                          double heading_sigma_rad, double gate = 10.8);

}  // namespace soopnav::array
