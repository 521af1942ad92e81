#pragma once

#include <Eigen/Core>
#include <cmath>

namespace soopnav::inertial {

/// What a strapdown inertial measurement unit gives for one step: rate and specific force, each integrated over it in
/// the body's axes (forward, right, down unless said otherwise).
struct ImuIncrement {
  Eigen::Vector3d delta_theta_b = Eigen::Vector3d::Zero();     ///< integral of w_ib_b over the step [rad]
  Eigen::Vector3d delta_velocity_b = Eigen::Vector3d::Zero();  ///< integral of f_ib_b over the step [m/s]
  double dt_s = 0.0;                                           ///< length of the step

  [[nodiscard]] bool all_finite() const noexcept {
    return delta_theta_b.allFinite() && delta_velocity_b.allFinite() && std::isfinite(dt_s);
  }
  /// The first part of the step as an increment of its own, rate and force taken as constant in it.
  [[nodiscard]] ImuIncrement part(double fraction) const noexcept {
    return {fraction * delta_theta_b, fraction * delta_velocity_b, fraction * dt_s};
  }
};

}  // namespace soopnav::inertial
