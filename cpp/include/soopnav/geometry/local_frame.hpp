#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "soopnav/geometry/wgs84.hpp"

namespace soopnav::geometry {

/// Axes of a local frame: the tangent plane of the ellipsoid at its origin.
enum class LocalAxes : std::uint8_t {
  kEnu,  ///< x east, y north, z up
  kNed,  ///< x north, y east, z down
};

/// T_enu_e: maps ECEF coordinates of a vector to east-north-up at the given latitude and longitude.
[[nodiscard]] Eigen::Matrix3d rotation_ecef_to_enu(double latitude_rad, double longitude_rad) noexcept;

/// T_ned_e: maps ECEF coordinates of a vector to north-east-down at the given latitude and longitude.
[[nodiscard]] Eigen::Matrix3d rotation_ecef_to_ned(double latitude_rad, double longitude_rad) noexcept;

/// The swap between east-north-up and north-east-down; its own inverse.
[[nodiscard]] Eigen::Vector3d swap_enu_ned(const Eigen::Vector3d& v) noexcept;

/// Where a target is seen from an observer.
struct Direction {
  double azimuth_rad = 0.0;    ///< from north towards east, [0, 2 pi); 0 straight up or down
  double elevation_rad = 0.0;  ///< above the tangent plane, [-pi/2, pi/2]
  double range_m = 0.0;        ///< straight-line distance
};

/// The direction of `to_enu_m - from_enu_m`, both east-north-up about one origin. None when they coincide or are not
/// finite.
[[nodiscard]] std::optional<Direction> direction_enu(const Eigen::Vector3d& from_enu_m,
                                                     const Eigen::Vector3d& to_enu_m) noexcept;

/// A Cartesian frame fixed to the Earth in one place, axes east-north-up or north-east-down.
///
/// Positions are shifted and rotated, velocities and covariances rotated only. Immutable; nothing allocates.
class LocalFrame {
 public:
  /// @throws std::invalid_argument when a coordinate is not finite, |latitude| > pi/2 or height is below -6 356 km or
  /// above 1e9 m.
  explicit LocalFrame(const Geodetic& origin, LocalAxes axes = LocalAxes::kEnu);

  [[nodiscard]] const Geodetic& origin() const noexcept { return origin_; }
  [[nodiscard]] const Eigen::Vector3d& origin_ecef() const noexcept { return origin_p_e_; }  ///< [m]
  [[nodiscard]] LocalAxes axes() const noexcept { return axes_; }
  /// T_l_e: maps ECEF coordinates of a vector to those of this frame.
  [[nodiscard]] const Eigen::Matrix3d& rotation_from_ecef() const noexcept { return rotation_; }

  /// Position: p_l = T_l_e (p_e - origin).
  [[nodiscard]] Eigen::Vector3d position_from_ecef(const Eigen::Vector3d& p_e) const noexcept;
  [[nodiscard]] Eigen::Vector3d position_to_ecef(const Eigen::Vector3d& p_l) const noexcept;

  /// Velocity relative to the Earth, or any free vector: v_l = T_l_e v_e.
  [[nodiscard]] Eigen::Vector3d velocity_from_ecef(const Eigen::Vector3d& v_e) const noexcept;
  [[nodiscard]] Eigen::Vector3d velocity_to_ecef(const Eigen::Vector3d& v_l) const noexcept;

  /// Covariance of a position or velocity: P_l = T_l_e P_e T_l_e', symmetric to the last bit.
  [[nodiscard]] Eigen::Matrix3d covariance_from_ecef(const Eigen::Matrix3d& P_e) const noexcept;
  [[nodiscard]] Eigen::Matrix3d covariance_to_ecef(const Eigen::Matrix3d& P_l) const noexcept;

  [[nodiscard]] Eigen::Vector3d position_from_geodetic(const Geodetic& place) const noexcept;
  /// None where `ecef_to_geodetic` has none.
  [[nodiscard]] std::optional<Geodetic> position_to_geodetic(const Eigen::Vector3d& p_l) const noexcept;

  /// Azimuth, elevation and range of an ECEF position seen from the origin. None when it is the origin or not finite.
  [[nodiscard]] std::optional<Direction> direction_to(const Eigen::Vector3d& p_e) const noexcept;

 private:
  Geodetic origin_;
  LocalAxes axes_;
  Eigen::Vector3d origin_p_e_;
  Eigen::Matrix3d rotation_;
};

}  // namespace soopnav::geometry
