#include "soopnav/geometry/rotation.hpp"

#include <cmath>

#include "soopnav/core/angle.hpp"

namespace soopnav::geometry {

Eigen::Matrix3d rotation_from_euler(const Euler& euler) noexcept {
  const double cy = std::cos(euler.yaw_rad);
  const double sy = std::sin(euler.yaw_rad);
  const double cp = std::cos(euler.pitch_rad);
  const double sp = std::sin(euler.pitch_rad);
  const double cr = std::cos(euler.roll_rad);
  const double sr = std::sin(euler.roll_rad);
  Eigen::Matrix3d T_n_b;
  T_n_b << cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,  //
      sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,       //
      -sp, cp * sr, cp * cr;
  return T_n_b;
}

Euler euler_from_rotation(const Eigen::Matrix3d& T_n_b) noexcept {
  const double cos_pitch = std::hypot(T_n_b(0, 0), T_n_b(1, 0));
  const double pitch = std::atan2(-T_n_b(2, 0), cos_pitch);
  constexpr double kGimbalLock = 1e-12;  // below, the first column holds rounding rather than yaw
  if (cos_pitch < kGimbalLock) return {wrap_to_pi(std::atan2(-T_n_b(0, 1), T_n_b(1, 1))), pitch, 0.0};
  return {wrap_to_pi(std::atan2(T_n_b(1, 0), T_n_b(0, 0))), pitch, wrap_to_pi(std::atan2(T_n_b(2, 1), T_n_b(2, 2)))};
}

Eigen::Quaterniond quaternion_from_rotation(const Eigen::Matrix3d& T_n_b) noexcept {
  Eigen::Quaterniond q(T_n_b);
  q.normalize();
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  return q;
}

Eigen::Matrix3d rotation_from_quaternion(const Eigen::Quaterniond& q_n_b) noexcept { return q_n_b.toRotationMatrix(); }

Eigen::Quaterniond quaternion_from_rotation_vector(const Eigen::Vector3d& phi_rad) noexcept {
  const double half = 0.5 * phi_rad.norm();
  // sin(half) / (2 half); its series where the quotient would be 0 / 0.
  const double factor = half < 1e-4 ? 0.5 - half * half / 12.0 : 0.5 * std::sin(half) / half;
  return {std::cos(half), factor * phi_rad.x(), factor * phi_rad.y(), factor * phi_rad.z()};
}

Eigen::Vector3d rotation_vector_from_quaternion(const Eigen::Quaterniond& q) noexcept {
  const double sign = q.w() < 0.0 ? -1.0 : 1.0;
  const double sin_half = q.vec().norm();
  const double cos_half = std::abs(q.w());
  const double factor = sin_half < 1e-4 ? 2.0 / cos_half * (1.0 - sin_half * sin_half / (3.0 * cos_half * cos_half))
                                        : 2.0 * std::atan2(sin_half, cos_half) / sin_half;
  return sign * factor * q.vec();
}

Eigen::Matrix3d skew(const Eigen::Vector3d& v) noexcept {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(),  //
      v.z(), 0.0, -v.x(),   //
      -v.y(), v.x(), 0.0;
  return m;
}

}  // namespace soopnav::geometry
