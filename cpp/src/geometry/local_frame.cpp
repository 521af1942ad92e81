#include "soopnav/geometry/local_frame.hpp"

#include <cmath>
#include <sstream>
#include <stdexcept>

#include "soopnav/core/angle.hpp"

namespace soopnav::geometry {
namespace {

Geodetic checked(const Geodetic& origin) {
  const auto require = [](bool holds, const char* name, double value, const char* rule) {
    if (holds) return;
    std::ostringstream message;
    message << "origin." << name << ": " << value << "; " << rule;
    throw std::invalid_argument(message.str());
  };
  require(std::abs(origin.latitude_rad) <= kPi / 2.0, "latitude_rad", origin.latitude_rad,
          "it must lie between -pi/2 and pi/2");
  require(std::isfinite(origin.longitude_rad), "longitude_rad", origin.longitude_rad, "it must be finite");
  require(origin.height_m >= -wgs84::kSemiMinorAxisM && origin.height_m <= 1e9, "height_m", origin.height_m,
          "it must lie between -6 356 km and 1e9 m");
  return origin;
}

Eigen::Matrix3d rotated(const Eigen::Matrix3d& rotation, const Eigen::Matrix3d& covariance) {
  const Eigen::Matrix3d product = rotation * covariance * rotation.transpose();
  return 0.5 * (product + product.transpose());
}

}  // namespace

Eigen::Matrix3d rotation_ecef_to_enu(double latitude_rad, double longitude_rad) noexcept {
  const double sin_lat = std::sin(latitude_rad);
  const double cos_lat = std::cos(latitude_rad);
  const double sin_lon = std::sin(longitude_rad);
  const double cos_lon = std::cos(longitude_rad);
  Eigen::Matrix3d T_enu_e;
  T_enu_e << -sin_lon, cos_lon, 0.0,                    //
      -sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat,  //
      cos_lat * cos_lon, cos_lat * sin_lon, sin_lat;
  return T_enu_e;
}

Eigen::Matrix3d rotation_ecef_to_ned(double latitude_rad, double longitude_rad) noexcept {
  const Eigen::Matrix3d T_enu_e = rotation_ecef_to_enu(latitude_rad, longitude_rad);
  Eigen::Matrix3d T_ned_e;
  T_ned_e << T_enu_e.row(1), T_enu_e.row(0), -T_enu_e.row(2);
  return T_ned_e;
}

Eigen::Vector3d swap_enu_ned(const Eigen::Vector3d& v) noexcept { return {v.y(), v.x(), -v.z()}; }

std::optional<Direction> direction_enu(const Eigen::Vector3d& from_enu_m, const Eigen::Vector3d& to_enu_m) noexcept {
  const Eigen::Vector3d line = to_enu_m - from_enu_m;
  const double horizontal = std::hypot(line.x(), line.y());
  const double range = std::hypot(horizontal, line.z());
  if (!(range > 0.0) || !std::isfinite(range)) return std::nullopt;
  return Direction{wrap_to_two_pi(std::atan2(line.x(), line.y())), std::atan2(line.z(), horizontal), range};
}

LocalFrame::LocalFrame(const Geodetic& origin, LocalAxes axes)
    : origin_(checked(origin)),
      axes_(axes),
      origin_p_e_(geodetic_to_ecef(origin)),
      rotation_(axes == LocalAxes::kEnu ? rotation_ecef_to_enu(origin.latitude_rad, origin.longitude_rad)
                                        : rotation_ecef_to_ned(origin.latitude_rad, origin.longitude_rad)) {}

Eigen::Vector3d LocalFrame::position_from_ecef(const Eigen::Vector3d& p_e) const noexcept {
  return rotation_ * (p_e - origin_p_e_);
}

Eigen::Vector3d LocalFrame::position_to_ecef(const Eigen::Vector3d& p_l) const noexcept {
  return origin_p_e_ + rotation_.transpose() * p_l;
}

Eigen::Vector3d LocalFrame::velocity_from_ecef(const Eigen::Vector3d& v_e) const noexcept { return rotation_ * v_e; }

Eigen::Vector3d LocalFrame::velocity_to_ecef(const Eigen::Vector3d& v_l) const noexcept {
  return rotation_.transpose() * v_l;
}

Eigen::Matrix3d LocalFrame::covariance_from_ecef(const Eigen::Matrix3d& P_e) const noexcept {
  return rotated(rotation_, P_e);
}

Eigen::Matrix3d LocalFrame::covariance_to_ecef(const Eigen::Matrix3d& P_l) const noexcept {
  return rotated(rotation_.transpose(), P_l);
}

Eigen::Vector3d LocalFrame::position_from_geodetic(const Geodetic& place) const noexcept {
  return position_from_ecef(geodetic_to_ecef(place));
}

std::optional<Geodetic> LocalFrame::position_to_geodetic(const Eigen::Vector3d& p_l) const noexcept {
  return ecef_to_geodetic(position_to_ecef(p_l));
}

std::optional<Direction> LocalFrame::direction_to(const Eigen::Vector3d& p_e) const noexcept {
  const Eigen::Vector3d p_l = position_from_ecef(p_e);
  return direction_enu(Eigen::Vector3d::Zero(), axes_ == LocalAxes::kEnu ? p_l : swap_enu_ned(p_l));
}

}  // namespace soopnav::geometry
