#pragma once

#include <array>
#include <cmath>
#include <type_traits>

#include "soopnav/core/arithmetic.hpp"
#include "soopnav/core/packet.hpp"
#include "soopnav/core/role.hpp"

namespace soopnav {

/// Random walk of an attitude: small random turns about the body's axes.
///
/// Model:   q <- q * exp(n),  n_i = sqrt(q_i dt) w_i a rotation vector in the body frame
///          (doc/process_models.md eq. 15); exact as long as the walk of one step is small
/// Roles:   attitude (a unit quaternion w, x, y, z). In a `JointProcess` it turns what the part before it wrote.
/// No allocation.
struct AttitudeRandomWalk {
  static constexpr int kNoise = 3;
  std::array<double, 3> psd{};  ///< q_i >= 0 about each body axis [rad²/s]

  /// `x`: a state of doubles or a `Packet` of particles.
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& /*x*/, double dt_s, const W& w, Y& y) const {
    using std::cos;
    using std::sin;
    using std::sqrt;
    const double sigma[3] = {sqrt(psd[0] * dt_s), sqrt(psd[1] * dt_s), sqrt(psd[2] * dt_s)};
    const auto n0 = eval(sigma[0] * w[0]);
    const auto n1 = eval(sigma[1] * w[1]);
    const auto n2 = eval(sigma[2] * w[2]);
    const auto angle = eval(sqrt(n0 * n0 + n1 * n1 + n2 * n2));
    using T = std::remove_cvref_t<decltype(angle)>;
    const auto half = eval(0.5 * angle);
    const T k = select(angle == T(0.0), T(0.5), eval(sin(half) / angle));
    const T b[4] = {cos(half), k * n0, k * n1, k * n2};
    auto&& next = y.next(kAttitude);
    const T a[4] = {T(next[0]), T(next[1]), T(next[2]), T(next[3])};
    next[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    next[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    next[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
    next[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
    if constexpr (Y::kJacobian) {
      for (int i = 0; i < 3; ++i) y.noise(kAttitude)(i, i) = sigma[i];
    }
    return true;
  }
};

}  // namespace soopnav
