#pragma once

#include <Eigen/Core>

/// Gravity of the level ellipsoid and rates of the local level frame (doc/strapdown.md eq. 1-8).
namespace soopnav::geometry {

/// Normal gravity at the equator and at the poles [m/s²], and Somigliana's constant (NGA.STND.0036_1.0.0_WGS84, table
/// 3.6; derived from the defining constants).
inline constexpr double kNormalGravityEquatorMps2 = 9.7803253359;
inline constexpr double kNormalGravityPoleMps2 = 9.8321849378;
inline constexpr double kSomiglianaConstant = 1.931852652458e-3;

/// Dynamical form factor J2 of the level ellipsoid: 1.082629821e-3 (the same standard, derived).
inline constexpr double kEllipsoidJ2 = 1.082629821e-3;

/// Normal gravity on the ellipsoid [m/s²] (Somigliana; doc/strapdown.md eq. 1). Any angle; does not allocate.
[[nodiscard]] double normal_gravity_surface_mps2(double latitude_rad) noexcept;

/// Magnitude of normal gravity at a height [m/s²]: Somigliana's value with the usual expansion to second order in
/// height over a (doc/strapdown.md eq. 2). Within 5e-7 m/s² of the exact one up to 5 km, 2e-6 m/s² at 20 km.
[[nodiscard]] double normal_gravity_mps2(double latitude_rad, double height_m) noexcept;

/// Normal gravity, gravitation plus centrifugal, of the level ellipsoid at p_e [m/s²], ECEF, exact in closed form
/// (Heiskanen and Moritz, Physical Geodesy, sections 2-7, 2-8; doc/strapdown.md eq. 3-5).
///
/// Valid on and above the ellipsoid; below, the field of the same potential down to 500 km from the centre, and not
/// finite nearer. 1e-14 of its magnitude; about 60 ns; does not allocate.
[[nodiscard]] Eigen::Vector3d normal_gravity_ecef(const Eigen::Vector3d& p_e) noexcept;

/// The same at a geodetic place, along north, east and down [m/s²]: down positive; the plumb line bends with height, so
/// north is not zero above the ellipsoid (-8e-9 m/s² for each metre at 45 degrees).
[[nodiscard]] Eigen::Vector3d normal_gravity_ned(double latitude_rad, double height_m) noexcept;

/// Gravitation of a point mass with J2 at p_e [m/s²], ECEF, without the centrifugal part (doc/strapdown.md eq. 6).
/// `j2` = 0 leaves the point mass. Not finite at the centre.
[[nodiscard]] Eigen::Vector3d j2_gravitation_ecef(const Eigen::Vector3d& p_e, double j2 = kEllipsoidJ2) noexcept;

/// Centrifugal acceleration of a body at rest in ECEF [m/s²].
[[nodiscard]] Eigen::Vector3d centrifugal_ecef(const Eigen::Vector3d& p_e) noexcept;

/// Gradient d g / d p of gravity at r, a position from the Earth's centre in the axes of `omega_ie` (the Earth's rate
/// in the same axes [rad/s]) [1/s²]: point mass plus centrifugal (doc/strapdown.md eq. 7), within 1 % of the
/// ellipsoid's.
[[nodiscard]] Eigen::Matrix3d gravity_gradient(const Eigen::Vector3d& r, const Eigen::Vector3d& omega_ie) noexcept;

/// The Earth's rate in north-east-down, w_ie_n [rad/s]: (w cos(lat), 0, -w sin(lat)).
[[nodiscard]] Eigen::Vector3d earth_rate_ned(double latitude_rad) noexcept;

/// Rate of the moving north-east-down frame relative to the Earth, w_en_n [rad/s] (doc/strapdown.md eq. 8):
/// (v_E / (N + h), -v_N / (M + h), -v_E tan(lat) / (N + h)). Not finite at the poles.
[[nodiscard]] Eigen::Vector3d transport_rate_ned(double latitude_rad, double height_m,
                                                 const Eigen::Vector3d& v_n_mps) noexcept;

}  // namespace soopnav::geometry
