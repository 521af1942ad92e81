#pragma once

#include <Eigen/Core>
#include <cmath>

#include "soopnav/core/constants.hpp"
#include "soopnav/geometry/wgs84.hpp"

namespace soopnav::navigation {

/// Transmitters farther from the Earth's centre than this (200 km up) rise and set; others are heard where they are
/// heard.
inline constexpr double kHorizonRadiusM = wgs84::kSemiMajorAxisM + 2e5;

[[nodiscard]] inline bool has_horizon(const Eigen::Vector3d& source_p_e) noexcept {
  return source_p_e.squaredNorm() > kHorizonRadiusM * kHorizonRadiusM;
}

/// The ellipsoid's normal at a geodetic place, outwards.
[[nodiscard]] inline Eigen::Vector3d ellipsoid_up(const geometry::Geodetic& place) noexcept {
  const double c = std::cos(place.latitude_rad);
  return {c * std::cos(place.longitude_rad), c * std::sin(place.longitude_rad), std::sin(place.latitude_rad)};
}

/// Sine of the elevation of a source above the plane normal to the ellipsoid below p (1e-5 rad, near the ground).
[[nodiscard]] inline double sine_of_elevation(const Eigen::Vector3d& p_e, const Eigen::Vector3d& source_p_e) noexcept {
  const Eigen::Vector3d up(p_e.x(), p_e.y(), p_e.z() / (1.0 - wgs84::kEccentricitySquared));
  const Eigen::Vector3d line = source_p_e - p_e;
  return up.dot(line) / (up.norm() * line.norm());
}

}  // namespace soopnav::navigation
