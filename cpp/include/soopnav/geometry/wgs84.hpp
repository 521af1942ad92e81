#pragma once

#include <Eigen/Core>
#include <optional>

/// Rotations, WGS 84 and local frames.
namespace soopnav::geometry {

/// A place by geodetic latitude, longitude and height over the WGS 84 ellipsoid.
struct Geodetic {
  double latitude_rad = 0.0;   ///< -pi/2 ... pi/2, north positive
  double longitude_rad = 0.0;  ///< east positive
  double height_m = 0.0;       ///< along the ellipsoid's normal, outwards positive
};

/// Nearest distance to the Earth's centre that `ecef_to_geodetic` takes [m]. Far nearer (43 km) normals begin to cross
/// and the height of a point is no longer unique.
inline constexpr double kMinCentreDistanceM = 1e6;

/// ECEF position p_e [m] of a geodetic place: x to (0, 0), y to (0, 90 deg E), z to the north pole.
///
/// p_e = ((N + h) cos(lat) cos(lon), (N + h) cos(lat) sin(lon), (N (1 - e^2) + h) sin(lat)),
/// N = a / sqrt(1 - e^2 sin^2(lat))  (NGA.STND.0036_1.0.0_WGS84, equations 4-14). Any angle is taken as it is; what is
/// not finite gives what is not finite. Does not allocate.
[[nodiscard]] Eigen::Vector3d geodetic_to_ecef(const Geodetic& place) noexcept;
[[nodiscard]] Eigen::Vector3d geodetic_to_ecef(double latitude_rad, double longitude_rad, double height_m) noexcept;

/// The geodetic place of an ECEF position [m]; latitude in [-pi/2, pi/2], longitude in [-pi, pi], 0 on the axis.
///
/// Bowring's iteration on the reduced latitude (Survey Review 23, 1976, equation for tan(lat)), to convergence, without
/// trigonometric calls in the loop and without a division that could fail at the poles. `geodetic_to_ecef` of it gives
/// `p_e` back within 7e-16 of its distance to the centre: 5 nm near the ground, 60 nm at a height of 1e8 m (measured
/// on 2e6 points each). None when `p_e` is not finite, nearer to the centre than `kMinCentreDistanceM` or beyond
/// 1e15 m. Does not allocate.
[[nodiscard]] std::optional<Geodetic> ecef_to_geodetic(const Eigen::Vector3d& p_e) noexcept;

/// Radius of curvature in the meridian, M = a (1 - e^2) / (1 - e^2 sin^2(lat))^(3/2) [m].
[[nodiscard]] double meridian_radius_m(double latitude_rad) noexcept;

/// Radius of curvature in the prime vertical, N = a / sqrt(1 - e^2 sin^2(lat)) [m].
[[nodiscard]] double prime_vertical_radius_m(double latitude_rad) noexcept;

}  // namespace soopnav::geometry
