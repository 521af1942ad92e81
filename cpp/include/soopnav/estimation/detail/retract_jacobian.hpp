#pragma once

#include <Eigen/Core>
#include <cmath>

#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav::detail {

/// Whether tangents at all states are the same space: vectors and headings, no rotations.
template <class State>
inline constexpr bool kFlatTangent = true;
template <class Frame, class... Roles>
inline constexpr bool kFlatTangent<ComposedState<Frame, Roles...>> = ((kStoredSize<Roles> == Roles::kDim) && ...);

/// Right Jacobian of the rotations: exp(d + e) = exp(d) exp(J e) to first order,
/// J = I - (1 - cos t) / t² [d] + (t - sin t) / t³ [d]², t = |d| (doc/kalman_filter.md eq. 24).
[[nodiscard]] inline Eigen::Matrix3d rotation_right_jacobian(const Eigen::Vector3d& d) noexcept {
  const double t2 = d.squaredNorm();
  const double t = std::sqrt(t2);
  // Series where the quotients lose digits; the terms left out are below 1e-14 there.
  const bool small = t2 < 1e-4;
  const double a = small ? 0.5 - t2 / 24.0 + t2 * t2 / 720.0 : (1.0 - std::cos(t)) / t2;
  const double b = small ? 1.0 / 6.0 - t2 / 120.0 + t2 * t2 / 5040.0 : (t - std::sin(t)) / (t2 * t);
  Eigen::Matrix3d W;
  W << 0, -d[2], d[1], d[2], 0, -d[0], -d[1], d[0], 0;
  return Eigen::Matrix3d::Identity() - a * W + b * W * W;
}

/// J with x.retract(d + e) = x.retract(d).retract(J e) to first order: the identity but for rotations.
template <class Frame, class... Roles>
[[nodiscard]] auto retract_jacobian(const ComposedState<Frame, Roles...>& /*x*/,
                                    const typename ComposedState<Frame, Roles...>::Tangent& d) noexcept {
  using State = ComposedState<Frame, Roles...>;
  using Square = Eigen::Matrix<double, State::kDim, State::kDim>;
  Square J = Square::Identity();
  const auto fill = [&]<class R>(R role) {
    if constexpr (kStoredSize<R> != R::kDim) {
      J.template block<3, 3>(State::at(role), State::at(role)) =
          rotation_right_jacobian(d.template segment<3>(State::at(role)));
    }
  };
  (fill(Roles{}), ...);
  return J;
}

}  // namespace soopnav::detail
