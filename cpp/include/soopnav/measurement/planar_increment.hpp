#pragma once

#include <cmath>
#include <concepts>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/role.hpp"
#include "soopnav/measurement/arithmetic.hpp"

namespace soopnav {

/// Displacement and turn since a previous pose, as a camera over the ground or a wheel sees it.
///
/// Model:   [dx, dy] = C(psi_0)ᵀ (p - p_0),  d_psi = psi - psi_0  (doc/measurement_models.md eq. 16; nielsen 4.2.2)
///          [m, m, rad]
/// Frames:  p, psi present pose, p_0, psi_0 previous one, in `FrameTag`; the increment is in the axes of the previous
///          body: dx along the first one. C(psi) turns the body's axes into the frame's.
/// Signs:   headings count from the first axis of the frame towards its second (`kHeading`). The Δx, Δy that nielsen
/// fits
///          to feature points are in the axes of the *present* body: turn them by d_psi first.
/// Roles:   the previous position and heading: `Known`, a `Block` of a cloned pose (an angle block for its heading), or
///          roles; the present pose.
/// Residual: of the third row wrapped to [-pi, pi).
/// Refused: nothing. No allocation.
template <class FrameTag, PartOf<2> PreviousPosition = Known<2>, PartOf<1> PreviousHeading = Known<1>,
          PartOf<1> Heading = Role<1, HeadingTag>, PartOf<2> Position = Role<2, PositionTag>>
struct PlanarIncrement {
  static_assert(!std::same_as<FrameTag, EcefFrame>, "a heading is stated in a local frame");
  using Frame = FrameTag;
  static constexpr int kDim = 3;
  PreviousPosition previous_p{};       ///< p_0 [m]
  PreviousHeading previous_heading{};  ///< psi_0 [rad]
  Heading heading{};                   ///< psi [rad]
  Position position{};                 ///< p [m]

  template <class X, class Y>
  requires Provides<X, PlanarIncrement, PreviousPosition, PreviousHeading, Heading, Position>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    using std::cos;
    using std::sin;
    const auto p = x(position);
    const auto from = x(previous_p);
    const auto turned = eval(x(previous_heading)[0]);
    const auto c = eval(cos(turned));
    const auto s = eval(sin(turned));
    const auto east = eval(p[0] - from[0]);
    const auto north = eval(p[1] - from[1]);
    const auto forward = eval(c * east + s * north);
    const auto left = eval(c * north - s * east);
    y.value(0) = forward;
    y.value(1) = left;
    y.value(2) = wrap_to_pi(eval(x(heading)[0] - turned));
    if constexpr (Y::kJacobian) {
      auto&& to_p = y.jacobian(position);
      auto&& to_from = y.jacobian(previous_p);
      auto&& to_turned = y.jacobian(previous_heading);
      const double turn[2][2] = {{c, s}, {-s, c}};
      for (int row = 0; row < 2; ++row) {
        for (int i = 0; i < 2; ++i) {
          to_p(row, i) += turn[row][i];
          to_from(row, i) -= turn[row][i];
        }
      }
      to_turned(0, 0) += left;
      to_turned(1, 0) -= forward;
      to_turned(2, 0) -= 1.0;
      y.jacobian(heading)(2, 0) += 1.0;
    }
    return true;
  }

  /// The difference; of the turn, the short way round.
  template <class T>
  [[nodiscard]] static T residual(int row, const T& z, const T& predicted) {
    const T difference = z - predicted;
    return row == 2 ? wrap_to_pi(difference) : difference;
  }
};

}  // namespace soopnav
