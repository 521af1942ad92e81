#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

/// Conventions, everywhere in soopnav: a rotation T_n_b maps the coordinates a vector has in frame b to those it has in
/// frame n, v_n = T_n_b v_b. Quaternions are unit, Hamilton, scalar first where they are four numbers (w, x, y, z), and
/// stand for the same map. Angles are radians, right-handed.
namespace soopnav::geometry {

/// Attitude of a body by yaw, pitch and roll: from the reference, turn by yaw about z, then by pitch about the new y,
/// then by roll about the new x. With a north-east-down reference and a forward-right-down body, yaw is the heading
/// clockwise from north, pitch is nose up and roll is right wing down.
struct Euler {
  double yaw_rad = 0.0;    ///< [-pi, pi) as returned
  double pitch_rad = 0.0;  ///< [-pi/2, pi/2] as returned
  double roll_rad = 0.0;   ///< [-pi, pi) as returned
};

/// T_n_b = Rz(yaw) Ry(pitch) Rx(roll).
[[nodiscard]] Eigen::Matrix3d rotation_from_euler(const Euler& euler) noexcept;

/// The yaw, pitch and roll of T_n_b. At pitch = +-pi/2, where only yaw -+ roll is defined, roll is 0.
[[nodiscard]] Euler euler_from_rotation(const Eigen::Matrix3d& T_n_b) noexcept;

/// The quaternion of the same rotation, w >= 0. `T_n_b` must be a rotation; it is not checked.
[[nodiscard]] Eigen::Quaterniond quaternion_from_rotation(const Eigen::Matrix3d& T_n_b) noexcept;

/// The matrix of a unit quaternion.
[[nodiscard]] Eigen::Matrix3d rotation_from_quaternion(const Eigen::Quaterniond& q_n_b) noexcept;

/// The rotation by |phi| about the axis `phi` (the exponential of [phi x], Rodrigues); exact to rounding down to 0.
[[nodiscard]] Eigen::Quaterniond quaternion_from_rotation_vector(const Eigen::Vector3d& phi_rad) noexcept;

/// The rotation vector of a unit quaternion, the short way (at most pi long); inverse of the function above.
[[nodiscard]] Eigen::Vector3d rotation_vector_from_quaternion(const Eigen::Quaterniond& q) noexcept;

/// The matrix [v x] with [v x] w = v x w.
[[nodiscard]] Eigen::Matrix3d skew(const Eigen::Vector3d& v) noexcept;

}  // namespace soopnav::geometry
