#include "soopnav/vision/ground_projection.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "soopnav/core/angle.hpp"

namespace soopnav::vision {

namespace {

constexpr double kFlattest = 0.05;  // n . r / |r|

Eigen::Matrix3d tilt_e_d(const TiltAngles& tilt) {
  return (Eigen::AngleAxisd(tilt.a_y_rad, Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(tilt.a_x_rad, Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

Eigen::Vector3d turned(const Eigen::Vector3d& v, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return {c * v.x() - s * v.y(), s * v.x() + c * v.y(), v.z()};
}

}  // namespace

Eigen::Vector3d normal_of_tilt(const TiltAngles& tilt) noexcept {
  return {std::sin(tilt.a_y_rad) * std::cos(tilt.a_x_rad), std::sin(tilt.a_x_rad),
          std::cos(tilt.a_y_rad) * std::cos(tilt.a_x_rad)};
}

TiltAngles tilt_of_normal(const Eigen::Vector3d& normal_c) noexcept {
  const double across = std::hypot(normal_c.x(), normal_c.z());
  return {std::atan2(normal_c.y(), across), std::atan2(normal_c.x(), normal_c.z())};
}

Eigen::Vector4d nielsen_coefficients(const GroundPlane& plane) noexcept {
  return {plane.normal_c.x(), -plane.normal_c.y(), plane.normal_c.z(), -plane.distance_m};
}

Eigen::Vector3d increment_between(const GroundPose& previous, const GroundPose& present) noexcept {
  const Eigen::Vector3d step =
      turned({present.x_m - previous.x_m, present.y_m - previous.y_m, 0.0}, -previous.heading_rad);
  return {step.x(), step.y(), wrap_to_pi(present.heading_rad - previous.heading_rad)};
}

GroundPose moved(const GroundPose& previous, const Eigen::Vector3d& increment) noexcept {
  const Eigen::Vector3d step = turned({increment.x(), increment.y(), 0.0}, previous.heading_rad);
  return {previous.x_m + step.x(), previous.y_m + step.y(), wrap_to_pi(previous.heading_rad + increment.z())};
}

Eigen::Vector3d to_present_axes(const Eigen::Vector3d& increment) noexcept { return turned(increment, -increment.z()); }

Eigen::Vector3d to_previous_axes(const Eigen::Vector3d& present_increment) noexcept {
  return turned(present_increment, present_increment.z());
}

double NielsenFrames::heading_offset_rad() const noexcept {
  // Its first axis is R_ed e_1, whose y in the camera is 0: seen in our body.
  const Eigen::Vector3d first = camera_from_e(tilt_e_d(tilt).col(0));
  const Eigen::Vector3d in_body = body_axes(normal_of_tilt(tilt)) * first;
  return std::atan2(in_body.y(), in_body.x());
}

Eigen::Vector3d NielsenFrames::b_from_a(const Eigen::Vector3d& p_a) const noexcept {
  return {p_a.x() - pose.x_m, p_a.y() - pose.y_m, p_a.z()};
}
Eigen::Vector3d NielsenFrames::a_from_b(const Eigen::Vector3d& p_b) const noexcept {
  return {p_b.x() + pose.x_m, p_b.y() + pose.y_m, p_b.z()};
}
Eigen::Vector3d NielsenFrames::c_from_b(const Eigen::Vector3d& p_b) const noexcept {
  return turned(p_b, -(pose.heading_rad + heading_offset_rad()));
}
Eigen::Vector3d NielsenFrames::b_from_c(const Eigen::Vector3d& p_c) const noexcept {
  return turned(p_c, pose.heading_rad + heading_offset_rad());
}
Eigen::Vector3d NielsenFrames::d_from_c(const Eigen::Vector3d& p_c) const noexcept {
  return {p_c.x(), p_c.y(), height_m - p_c.z()};
}
Eigen::Vector3d NielsenFrames::c_from_d(const Eigen::Vector3d& p_d) const noexcept {
  return {p_d.x(), p_d.y(), height_m - p_d.z()};
}
Eigen::Vector3d NielsenFrames::e_from_d(const Eigen::Vector3d& p_d) const noexcept { return tilt_e_d(tilt) * p_d; }
Eigen::Vector3d NielsenFrames::d_from_e(const Eigen::Vector3d& p_e) const noexcept {
  return tilt_e_d(tilt).transpose() * p_e;
}
Eigen::Vector3d NielsenFrames::camera_from_e(const Eigen::Vector3d& p_e) noexcept {
  return {p_e.x(), -p_e.y(), p_e.z()};
}
Eigen::Vector3d NielsenFrames::e_from_camera(const Eigen::Vector3d& p_camera) noexcept {
  return camera_from_e(p_camera);
}
Eigen::Vector3d NielsenFrames::camera_from_ground(const Eigen::Vector3d& p_a) const noexcept {
  return camera_from_e(e_from_d(d_from_c(c_from_b(b_from_a(p_a)))));
}
Eigen::Vector3d NielsenFrames::ground_from_camera(const Eigen::Vector3d& p_camera) const noexcept {
  return a_from_b(b_from_c(c_from_d(d_from_e(e_from_camera(p_camera)))));
}

bool GroundProjection::project(const Eigen::Vector3d& ray_c, Eigen::Vector2d& point_b, Eigen::Matrix2d* to_ray,
                               Eigen::Matrix<double, 2, 3>* to_plane) const noexcept {
  const double down = normal_.dot(ray_c);
  // The negated form also refuses NaN and rays that point backwards.
  if (!(ray_c.z() > 0.0) || !(down >= kFlattest * ray_c.norm()) || !ray_c.allFinite()) return false;
  const double scale = distance_m_ / down;
  const Eigen::Vector2d f = scale * (axes_.topRows<2>() * ray_c);  // eq. 8
  point_b = f;
  if (to_ray != nullptr) {  // eq. 9
    *to_ray = scale * axes_.topLeftCorner<2, 2>() - f * normal_.head<2>().transpose() / down;
  }
  if (to_plane != nullptr) {  // eq. 10: moved foot, stretched plane, turned axes
    const double turn = -normal_.x() / std::sqrt(std::max(1.0 - normal_.x() * normal_.x(), 1e-12));
    to_plane->leftCols<2>() = -f * f.transpose() / distance_m_ - distance_m_ * Eigen::Matrix2d::Identity();
    to_plane->col(1) += turn * Eigen::Vector2d(f.y(), -f.x());
    to_plane->col(2) = f / distance_m_;
  }
  return true;
}

}  // namespace soopnav::vision
