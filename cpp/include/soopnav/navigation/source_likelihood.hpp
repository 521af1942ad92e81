#pragma once

#include <cstddef>
#include <span>

/// The likelihood of many places at once, given bearings (carter 5.14, 5.15; doc/source_location.md eq. 6 to 8).
namespace soopnav::navigation {

/// A bearing as the kernels read it. In two dimensions elevation and heights are not read.
struct PackedBearing {
  double x = 0.0, y = 0.0, z = 0.0;             ///< platform [m]
  double cos_azimuth = 1.0, sin_azimuth = 0.0;  ///< of the measured azimuth
  double elevation = 0.0;                       ///< measured [rad]
  double variance_azimuth = 1.0;                ///< without the platform's own [rad²]
  double variance_elevation = 1.0;
  double xx = 0.0, xy = 0.0, yy = 0.0, xz = 0.0, yz = 0.0, zz = 0.0;  ///< covariance of the platform [m²]

  [[nodiscard]] bool exact_platform() const noexcept {
    return xx == 0.0 && xy == 0.0 && yy == 0.0 && xz == 0.0 && yz == 0.0 && zz == 0.0;
  }
};

/// Coordinates of n places, one array each; `z` empty in the plane.
struct Places {
  std::span<const double> x, y, z;
};

/// Adds to `log_likelihood` (n) the sum over `bearings` of ln p(bearing | source at place), p = (1 - e) N + e / (2 pi),
/// in space (1 - e) N N + e / (2 pi²), e = `outlier_probability` in [0, 1), N the normal density of the wrapped angle.
/// At the platform's own place a direction means nothing: the angle there is that of the vector (0, 0), 0 or pi.
/// n a multiple of 8, arrays of any alignment; variances > 0. Angles are right to 4e-12 rad; in
/// the plane, where deviations are above 1e-4 rad and the platform is exact, to 3e-7 rad (and 2e-7 of the extent of 256
/// successive places over their distance from the platform). About 1 ns for a bearing and a place with AVX-512. Same
/// bits with every instruction set. No allocation.
void add_log_likelihood(std::span<const PackedBearing> bearings, const Places& places, double outlier_probability,
                        std::span<double> log_likelihood) noexcept;

/// Sums over weights.
struct WeightSum {
  double sum = 0.0;
  double squares = 0.0;
};

/// weights[i] *= scale * p(bearing | place i) / p_max, p_max the largest value that p can take in the plane with an
/// exact platform; returns the sums of the new weights. Sizes and refusals as `add_log_likelihood`.
WeightSum weigh_places(const PackedBearing& bearing, const Places& places, double outlier_probability, double scale,
                       std::span<double> weights) noexcept;

/// Likelihood on a grid.
struct SurfaceGrid {
  double x_min_m, x_max_m, y_min_m, y_max_m;  ///< centres of the outer cells
  std::size_t columns, rows;                  ///< along x and y, each at least 2
};

/// Log-likelihood of each cell's centre, row by row from y_min; `surface` has rows * columns numbers. Allocates two
/// rows. Throws std::invalid_argument for a grid or sizes that do not fit, or an outlier probability outside [0, 1).
void likelihood_surface(std::span<const PackedBearing> bearings, const SurfaceGrid& grid, double outlier_probability,
                        std::span<double> surface);

}  // namespace soopnav::navigation
