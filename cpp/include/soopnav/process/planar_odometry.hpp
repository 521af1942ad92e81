#pragma once

#include <Eigen/Core>
#include <cmath>

#include "soopnav/core/arithmetic.hpp"
#include "soopnav/core/role.hpp"

namespace soopnav {

/// Displacement and turn during a step, in the body's axes at its beginning (first axis forward, second to the left).
struct PlanarDisplacement {
  Eigen::Vector2d translation_b_m = Eigen::Vector2d::Zero();
  double turn_rad = 0.0;  ///< from the first axis towards the second

  [[nodiscard]] bool all_finite() const noexcept { return translation_b_m.allFinite() && std::isfinite(turn_rad); }
};

/// Dead reckoning: a pose moved by odometry or by a camera over the ground. What `PlanarIncrement` measures, as the
/// process itself: no previous pose is kept.
///
/// Model:   p += C(psi) (u + n_u),  psi += d_psi + n_psi          (doc/process_models.md eq. 17; nielsen section 4.2)
/// Noise:   [n_u, n_psi] = L w [m, m, rad] for each step, of covariance L Lᵀ whatever its duration.
/// Roles:   planar position, heading. No allocation.
struct PlanarOdometry {
  using Input = PlanarDisplacement;
  static constexpr int kNoise = 3;
  Eigen::Matrix3d noise_root = Eigen::Matrix3d::Zero();  ///< L, any square root of the increments' covariance

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, const PlanarDisplacement& u, double /*dt_s*/, const W& w, Y& y) const {
    using std::cos;
    using std::sin;
    const auto& L = noise_root;
    const auto heading = eval(x(kHeading)[0]);
    const auto c = eval(cos(heading));
    const auto s = eval(sin(heading));
    const auto forward = eval(u.translation_b_m[0] + (L(0, 0) * w[0] + L(0, 1) * w[1] + L(0, 2) * w[2]));
    const auto left = eval(u.translation_b_m[1] + (L(1, 0) * w[0] + L(1, 1) * w[1] + L(1, 2) * w[2]));
    const auto d0 = eval(c * forward - s * left);
    const auto d1 = eval(s * forward + c * left);
    auto&& next_p = y.next(kPlanarPosition);
    next_p[0] += d0;
    next_p[1] += d1;
    y.next(kHeading)[0] += u.turn_rad + (L(2, 0) * w[0] + L(2, 1) * w[1] + L(2, 2) * w[2]);
    if constexpr (Y::kJacobian) {
      y.transition(kPlanarPosition, kHeading) << -d1, d0;
      for (int k = 0; k < 3; ++k) {
        y.noise(kPlanarPosition)(0, k) = c * L(0, k) - s * L(1, k);
        y.noise(kPlanarPosition)(1, k) = s * L(0, k) + c * L(1, k);
        y.noise(kHeading)(0, k) = L(2, k);
      }
    }
    return true;
  }
};

}  // namespace soopnav
