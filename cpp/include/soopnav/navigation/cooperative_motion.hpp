#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/role.hpp"

namespace soopnav::navigation {

/// East, north and up at an ECEF position, one column each: T_e_enu. Up is the normal of the ellipsoid through the
/// point's foot, to within height / 6e8 rad; on the Earth's axis east is the second axis of e. No allocation.
[[nodiscard]] inline Eigen::Matrix3d east_north_up(const Eigen::Vector3d& p_e) noexcept {
  constexpr double kSquash =
      (wgs84::kSemiMajorAxisM / wgs84::kSemiMinorAxisM) * (wgs84::kSemiMajorAxisM / wgs84::kSemiMinorAxisM);
  Eigen::Matrix3d axes;
  const double across = std::hypot(p_e[0], p_e[1]);
  if (across > 0.0) {
    axes.col(0) << -p_e[1] / across, p_e[0] / across, 0.0;
  } else {
    axes.col(0) << 0.0, 1.0, 0.0;
  }
  axes.col(2) = Eigen::Vector3d(p_e[0], p_e[1], kSquash * p_e[2]).normalized();
  axes.col(1) = axes.col(2).cross(axes.col(0));
  return axes;
}

/// Motion with nearly constant velocity in ECEF, whose white acceleration is stated along the ground and upwards.
///
/// Model:   p += v dt + n_p,  v += n_v,  Cov(n_p, n_v) = T diag(q_h, q_h, q_v) T' [[dt³/3, dt²/2], [dt²/2, dt]], T
/// east,
///          north and up at p                             (doc/cooperative_motion.md eq. 1-2; mei eq. 3), exact for any
///          step over which T hardly turns
/// Left out: the turn of a straight path in the Earth's axes: v²/r, 4e-5 m/s² at 15 m/s.
/// Noise:   two normals for each axis of T: 2i moves velocity and position together, 2i + 1 the rest of the position.
/// Roles:   position and velocity; other roles or blocks when they are named. No allocation.
template <PartOf<3> Position = Role<3, PositionTag>, PartOf<3> Velocity = Role<3, VelocityTag>>
struct GroundConstantVelocity {
  using Frame = EcefFrame;
  static constexpr int kNoise = 6;
  double horizontal_psd = 0.0;  ///< q_h >= 0 of each of the two horizontal axes [m²/s³]
  double vertical_psd = 0.0;    ///< q_v >= 0 [m²/s³]
  Position position{};
  Velocity velocity{};

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    const Eigen::Vector3d p = x(position);
    const Eigen::Vector3d v = x(velocity);
    const Eigen::Matrix3d T = east_north_up(p);
    auto&& next_p = y.next(position);
    auto&& next_v = y.next(velocity);
    next_p += dt_s * v;
    for (int i = 0; i < 3; ++i) {
      const double to_v = std::sqrt((i == 2 ? vertical_psd : horizontal_psd) * dt_s);
      const double to_p = 0.5 * dt_s * to_v;
      const double rest = to_v * dt_s / std::sqrt(12.0);
      next_p += (to_p * w[2 * i] + rest * w[2 * i + 1]) * T.col(i);
      next_v += (to_v * w[2 * i]) * T.col(i);
      if constexpr (Y::kJacobian) {
        y.noise(velocity).col(2 * i) = to_v * T.col(i);
        y.noise(position).col(2 * i) = to_p * T.col(i);
        y.noise(position).col(2 * i + 1) = rest * T.col(i);
      }
    }
    if constexpr (Y::kJacobian) y.transition(position, velocity) = dt_s * Eigen::Matrix3d::Identity();
    return true;
  }
};

}  // namespace soopnav::navigation
