#pragma once

#include <Eigen/Core>
#include <cmath>

#include "soopnav/core/arithmetic.hpp"
#include "soopnav/core/role.hpp"

namespace soopnav::inertial {

/// One sample of a planar inertial measurement unit, in the body frame (first axis forward, second to the left).
struct PlanarImuSample {
  double yaw_rate_radps = 0.0;                                      ///< from the first axis towards the second
  Eigen::Vector2d specific_force_b_mps2 = Eigen::Vector2d::Zero();  ///< along the body's axes

  [[nodiscard]] bool all_finite() const noexcept {
    return std::isfinite(yaw_rate_radps) && specific_force_b_mps2.allFinite();
  }
};

/// Standard deviations of the white errors of one sample.
struct PlanarImuNoise {
  double gyro_sigma_radps = 0.0;
  double accelerometer_sigma_mps2 = 0.0;
};

/// How a sample is carried through its step.
enum class PlanarIntegration {
  kZeroOrderHold,  ///< force and heading held: p += v dt + a dt²/2, the exact integral of the frozen system
                   ///< (crosby 3.3)
  kEuler,          ///< p += v dt
};

/// Planar inertial navigation: heading, velocity and position driven by a yaw rate and two accelerometers.
///
/// Model:   psi += (w + n_w) dt,  v += C(psi) (f + n_f) dt,  p += v dt + C(psi) (f + n_f) dt²/2  (crosby 2.7-2.13, 3.3)
/// Frames:  C(psi) turns the body's axes into the plane's; psi counts from the first axis towards the second, so it is
///          minus the Theta of crosby (2.8), (2.9).
/// Noise:   white errors of the samples through the same gains, B_k Q B_kᵀ (crosby section 3.5 means this).
/// Roles:   heading, planar velocity, planar position. The transition carries d v / d psi, which the constant Phi of
///          crosby leaves out (and is overconfident for it).
/// No allocation.
struct PlanarMechanization {
  using Input = PlanarImuSample;
  static constexpr int kNoise = 3;
  PlanarImuNoise noise{};
  PlanarIntegration integration = PlanarIntegration::kZeroOrderHold;

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, const PlanarImuSample& u, double dt_s, const W& w, Y& y) const {
    using std::cos;
    using std::sin;
    const auto heading = eval(x(kHeading)[0]);
    const auto c = eval(cos(heading));
    const auto s = eval(sin(heading));
    const auto f0 = eval(u.specific_force_b_mps2[0] + noise.accelerometer_sigma_mps2 * w[1]);
    const auto f1 = eval(u.specific_force_b_mps2[1] + noise.accelerometer_sigma_mps2 * w[2]);
    const auto a0 = eval(c * f0 - s * f1);
    const auto a1 = eval(s * f0 + c * f1);
    const double half = integration == PlanarIntegration::kEuler ? 0.0 : 0.5 * dt_s * dt_s;
    const auto v = x(kPlanarVelocity);
    const auto p = x(kPlanarPosition);
    auto&& next_heading = y.next(kHeading);
    auto&& next_v = y.next(kPlanarVelocity);
    auto&& next_p = y.next(kPlanarPosition);
    next_heading[0] = heading + dt_s * (u.yaw_rate_radps + noise.gyro_sigma_radps * w[0]);
    next_p[0] = p[0] + dt_s * v[0] + half * a0;
    next_p[1] = p[1] + dt_s * v[1] + half * a1;
    next_v[0] = v[0] + dt_s * a0;
    next_v[1] = v[1] + dt_s * a1;
    if constexpr (Y::kJacobian) {
      y.transition(kPlanarVelocity, kHeading) << -dt_s * a1, dt_s * a0;
      y.transition(kPlanarPosition, kHeading) << -half * a1, half * a0;
      y.transition(kPlanarPosition, kPlanarVelocity) << dt_s, 0.0, 0.0, dt_s;
      const double gain = noise.accelerometer_sigma_mps2;
      y.noise(kHeading)(0, 0) = dt_s * noise.gyro_sigma_radps;
      y.noise(kPlanarVelocity).template rightCols<2>() << dt_s * gain * c, -dt_s * gain * s, dt_s * gain * s,
          dt_s * gain * c;
      y.noise(kPlanarPosition).template rightCols<2>() << half * gain * c, -half * gain * s, half * gain * s,
          half * gain * c;
    }
    return true;
  }
};

}  // namespace soopnav::inertial
