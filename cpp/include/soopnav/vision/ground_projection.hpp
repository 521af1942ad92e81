#pragma once

#include <Eigen/Core>

#include "soopnav/vision/ground_plane.hpp"

namespace soopnav::vision {

/// Tilt of the camera as nielsen has it (4.2.1): R_ed = R_y(a_y) R_x(a_x) from its untilted frame d to its camera frame
/// e, both left-handed with y up the image [rad]. In our camera frame
///   n = (sin a_y cos a_x, sin a_x, cos a_y cos a_x)           (doc/ego_motion.md eq. 7).
/// nielsen's normal points out of the ground there, (A, B, C) = (-sin a_y cos a_x, sin a_x, -cos a_y cos a_x), while
/// its text chooses C positive, so that the signs of A and B, and thus of both angles, turn. Ours is n into the ground.
struct TiltAngles {
  double a_x_rad = 0.0;
  double a_y_rad = 0.0;
};

[[nodiscard]] Eigen::Vector3d normal_of_tilt(const TiltAngles& tilt) noexcept;
/// Inverse of `normal_of_tilt` for n_z > 0: a_x = asin n_y, a_y = atan2(n_x, n_z).
[[nodiscard]] TiltAngles tilt_of_normal(const Eigen::Vector3d& normal_c) noexcept;
/// [A B C D] of nielsen with C positive, in its frame e: [n_x, -n_y, n_z, -d].
[[nodiscard]] Eigen::Vector4d nielsen_coefficients(const GroundPlane& plane) noexcept;

/// Where the body stands: its foot below the camera, in the ground frame, and its heading.
struct GroundPose {
  double x_m = 0.0;
  double y_m = 0.0;
  double heading_rad = 0.0;  ///< a_z: from ground x to the body's first axis, counterclockwise seen from above
};

/// The increment from `previous` to `present` in axes of the previous body, {dx, dy, da_z}; da_z in [-pi, pi).
[[nodiscard]] Eigen::Vector3d increment_between(const GroundPose& previous, const GroundPose& present) noexcept;
/// The pose that `increment` leads to: inverse of `increment_between`.
[[nodiscard]] GroundPose moved(const GroundPose& previous, const Eigen::Vector3d& increment) noexcept;
/// nielsen's increments are in axes of the PRESENT body, f_i = C f_(i-1) - delta (4.2.2): turned by -da_z, and back.
[[nodiscard]] Eigen::Vector3d to_present_axes(const Eigen::Vector3d& increment) noexcept;
[[nodiscard]] Eigen::Vector3d to_previous_axes(const Eigen::Vector3d& present_increment) noexcept;

/// nielsen's chain of frames (4.1, 4.2.1), each as a map to the next and back [m]. a: ground. b: ground axes, origin at
/// the foot. c: turned by the heading; right-handed, z up. d: at the camera, left-handed, z down. e: tilted by a_x, a_y
/// (f is the text's second name for it). camera: ours, y of e negated.
///
/// nielsen's frame c is not quite our body: when both angles differ from zero its first axis is not the camera's x axis
/// projected on the ground. `heading_offset_rad` is the turn from our body to its c; it belongs to the heading only.
struct NielsenFrames {
  GroundPose pose;  ///< of OUR body
  TiltAngles tilt;
  double height_m = 1.0;

  [[nodiscard]] double heading_offset_rad() const noexcept;
  [[nodiscard]] Eigen::Vector3d b_from_a(const Eigen::Vector3d& p_a) const noexcept;
  [[nodiscard]] Eigen::Vector3d c_from_b(const Eigen::Vector3d& p_b) const noexcept;
  [[nodiscard]] Eigen::Vector3d d_from_c(const Eigen::Vector3d& p_c) const noexcept;
  [[nodiscard]] Eigen::Vector3d e_from_d(const Eigen::Vector3d& p_d) const noexcept;
  [[nodiscard]] static Eigen::Vector3d camera_from_e(const Eigen::Vector3d& p_e) noexcept;
  [[nodiscard]] Eigen::Vector3d a_from_b(const Eigen::Vector3d& p_b) const noexcept;
  [[nodiscard]] Eigen::Vector3d b_from_c(const Eigen::Vector3d& p_c) const noexcept;
  [[nodiscard]] Eigen::Vector3d c_from_d(const Eigen::Vector3d& p_d) const noexcept;
  [[nodiscard]] Eigen::Vector3d d_from_e(const Eigen::Vector3d& p_e) const noexcept;
  [[nodiscard]] static Eigen::Vector3d e_from_camera(const Eigen::Vector3d& p_camera) noexcept;
  /// From the ground to our camera frame and back: the whole chain.
  [[nodiscard]] Eigen::Vector3d camera_from_ground(const Eigen::Vector3d& p_a) const noexcept;
  [[nodiscard]] Eigen::Vector3d ground_from_camera(const Eigen::Vector3d& p_camera) const noexcept;
};

/// Rays of a camera met with the tilted ground (doc/ego_motion.md eq. 8-11; nielsen 4.1, steps 4 to 6).
///
/// point = B d r / (n . r), B the first two rows of `body_axes`: the ground point in axes of the body, from its foot.
/// No allocation.
class GroundProjection {
 public:
  /// From a plane that is ok.
  explicit GroundProjection(const GroundPlane& plane) noexcept
      : axes_(body_axes(plane.normal_c)), normal_(plane.normal_c), distance_m_(plane.distance_m) {}

  /// `ray_c`: direction with z > 0, any length. False, and nothing written, where it does not meet the ground in front
  /// of the camera, or so flat (n . r < 0.05 |r|, 87 degrees) that the point means nothing.
  /// `to_ray`: derivative by the first two numbers of a ray with z = 1 [m].
  /// `to_plane`: by [eta_1, eta_2, d], as `GroundPlane::covariance` [m/rad, m/rad, 1].
  [[nodiscard]] bool project(const Eigen::Vector3d& ray_c, Eigen::Vector2d& point_b, Eigen::Matrix2d* to_ray = nullptr,
                             Eigen::Matrix<double, 2, 3>* to_plane = nullptr) const noexcept;

  /// The camera-frame point of a body point on the ground [m].
  [[nodiscard]] Eigen::Vector3d to_camera(const Eigen::Vector2d& point_b) const noexcept {
    return axes_.topRows<2>().transpose() * point_b + distance_m_ * normal_;
  }

  [[nodiscard]] const Eigen::Matrix3d& axes() const noexcept { return axes_; }

 private:
  Eigen::Matrix3d axes_;
  Eigen::Vector3d normal_;
  double distance_m_;
};

}  // namespace soopnav::vision
