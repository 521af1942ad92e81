#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <optional>
#include <vector>

#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/inertial/imu_increment.hpp"
#include "soopnav/inertial/strapdown_integrator.hpp"

namespace soopnav::simulation {

/// A sine of an angle: amplitude * sin(2 pi frequency t + phase).
struct Oscillation {
  double amplitude_rad = 0.0;
  double frequency_hz = 0.0;
  double phase_rad = 0.0;
};

/// Motion of a body at one time, in the trajectory's frame n.
struct SpatialMotion {
  Eigen::Vector3d p_n_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d v_n_mps = Eigen::Vector3d::Zero();
  Eigen::Vector3d a_n_mps2 = Eigen::Vector3d::Zero();         ///< second derivative of p_n
  Eigen::Quaterniond q_n_b = Eigen::Quaterniond::Identity();  ///< body (forward, right, down) to n
  Eigen::Vector3d w_nb_b_radps = Eigen::Vector3d::Zero();     ///< rate of the body relative to n, along its axes
};

/// How a path through waypoints is driven.
struct PathOptions {
  double speed_mps = 15.0;
  double max_acceleration_mps2 = 3.0;
  /// At rest so long before it sets off with half the greatest acceleration; without it, at speed from the beginning.
  std::optional<double> rest_s{};
};

/// A smooth path in three dimensions, known exactly at any time: position, velocity, acceleration, attitude and rate.
///
/// Model:   a uniform B-spline of degree 5 (four continuous derivatives) of position and yaw; roll and pitch oscillate.
///          The body's first axis follows the path's horizontal direction, but for the smoothing of both.
///                                                                                         (doc/strapdown.md eq. 42-44)
/// Frames:  n is north-east-down or east-north-up at the origin, fixed to the Earth; yaw is clockwise from north, the
///          body forward-right-down, in both.
/// Immutable; nothing allocates behind the constructor.
class SpatialTrajectory {
 public:
  struct Attitude {
    Oscillation roll{};
    Oscillation pitch{};
  };

  /// Control points c_i, `knot_s` apart, along the axes of `frame` [m]: with n of them the path lasts (n - 5) * knot_s.
  /// Throws std::invalid_argument for fewer than six, for what is not finite, and for a spacing that is not positive.
  SpatialTrajectory(const geometry::LocalFrame& frame, std::vector<Eigen::Vector3d> control_points, double knot_s,
                    const Attitude& attitude);

  /// Along straight lines between waypoints at a constant speed, corners rounded so that no acceleration is above the
  /// bound: it passes inside the corners. Throws std::invalid_argument for fewer than two waypoints, two equal ones in
  /// a row, options that are not positive, and where corners follow each other too closely for the bound.
  [[nodiscard]] static SpatialTrajectory through(const geometry::LocalFrame& frame,
                                                 const std::vector<Eigen::Vector3d>& waypoints,
                                                 const PathOptions& options, const Attitude& attitude);

  [[nodiscard]] const geometry::LocalFrame& frame() const noexcept { return frame_; }
  [[nodiscard]] double duration_s() const noexcept { return duration_s_; }
  [[nodiscard]] double knot_s() const noexcept { return knot_s_; }
  /// Greatest acceleration at 16 times between any two knots [m/s²].
  [[nodiscard]] double greatest_acceleration_mps2() const noexcept;

  /// The motion at 0 <= `t_s` <= `duration_s`; beyond, that of the nearest end's polynomial. Does not allocate.
  [[nodiscard]] SpatialMotion at(double t_s) const noexcept;

  /// The same as latitude, longitude, height, velocity and attitude in the moving north-east-down frame.
  [[nodiscard]] inertial::NavigationState navigation_state(double t_s) const;

  /// What a perfect inertial measurement unit integrates from `start_s` to `end_s`: rate and specific force, with
  /// normal gravity, Earth rate and Coriolis, by Gauss-Legendre quadrature to rounding (1e-15 rad, 1e-14 m/s for each
  /// step; doc/strapdown.md eq. 45). One increment for each 1 / `rate_hz`; what is left at the end is dropped. Throws
  /// std::invalid_argument for a rate that is not positive and times outside the path.
  [[nodiscard]] std::vector<inertial::ImuIncrement> imu_increments(double rate_hz, double start_s, double end_s) const;

 private:
  using Control = Eigen::Vector4d;  // north-east-down position, yaw
  geometry::LocalFrame frame_;
  geometry::LocalFrame ned_;
  std::vector<Control> control_;
  double knot_s_;
  double duration_s_;
  Attitude attitude_;
  Eigen::Vector3d omega_ie_ned_;

  struct Curve {
    Control value, first, second;
  };
  [[nodiscard]] Curve curve(double t_s) const noexcept;
  [[nodiscard]] SpatialMotion motion_ned(double t_s) const noexcept;
};

}  // namespace soopnav::simulation
