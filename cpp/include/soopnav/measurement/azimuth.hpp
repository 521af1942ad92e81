#pragma once

#include <cmath>
#include <concepts>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/role.hpp"
#include "soopnav/measurement/arithmetic.hpp"

namespace soopnav {

/// Direction to a source in the horizontal plane, measured from north or from the receiver's heading.
///
/// Model:   z = atan2(s, c) - psi, where (c, s) are the components of q - p along the axis angles count from and along
///          the axis they turn to: north and east in `EnuFrame` and `NedFrame` (an azimuth, clockwise from above), the
///          first and second axis in `PlanarFrame`        (doc/measurement_models.md eq. 12; carter eq. 5.4, 5.7) [rad]
/// Frames:  p receiver, q source, both in `FrameTag` [m]; psi counts as z does. Not defined in `EcefFrame`. The role
///          `kHeading` counts from the first axis, so in `EnuFrame` it is no psi, and refused when compiling.
/// Roles:   the receiver's position (as many components as the source has), psi and the source's position when they are
///          a `Block` or a role: `Azimuth<PlanarFrame, Role<1, HeadingTag>>` is a bearing relative to the heading.
/// Emitter: `AzimuthToEmitter` has the source as the state and the receiver known.
/// Residual: wrapped to [-pi, pi).
/// Refused: `predict` answers false within `kMinRangeM` horizontally (of packets only with a Jacobian). No allocation.
template <class FrameTag, PartOf<1> Heading = Known<1>, StatePart Source = Known<2>,
          PartOf<Source::kDim> Receiver = Role<Source::kDim, PositionTag>>
struct Azimuth {
  static_assert(Source::kDim == 2 || Source::kDim == 3, "a source has two or three coordinates");
  static_assert(!std::same_as<FrameTag, EcefFrame>, "an azimuth is stated in a local frame");
  static_assert(!std::same_as<FrameTag, EnuFrame> || !std::same_as<Heading, Role<1, HeadingTag>>,
                "in EnuFrame azimuths count from north and the heading of a state from east");
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  static constexpr int kCosine = std::same_as<FrameTag, EnuFrame> ? 1 : 0;  ///< the axis angles count from
  Source source_p{};                                                        ///< q [m]
  Heading heading{};                                                        ///< psi [rad]
  Receiver receiver_p{};                                                    ///< p [m]

  template <class X, class Y>
  requires Provides<X, Azimuth, Heading, Source, Receiver>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    using std::atan2;
    const auto p = x(receiver_p);
    const auto q = x(source_p);
    const auto c = eval(q[kCosine] - p[kCosine]);
    const auto s = eval(q[1 - kCosine] - p[1 - kCosine]);
    y.value(0) = wrap_to_pi(eval(atan2(s, c) - x(heading)[0]));
    const auto square = eval(c * c + s * s);
    if (detail::too_near(square)) return false;
    if constexpr (Y::kJacobian) {
      if (std::isnan(square)) return false;
      auto&& to_p = y.jacobian(receiver_p);
      auto&& to_q = y.jacobian(source_p);
      to_p(0, kCosine) += s / square;
      to_p(0, 1 - kCosine) -= c / square;
      to_q(0, kCosine) -= s / square;
      to_q(0, 1 - kCosine) += c / square;
      y.jacobian(heading)(0) -= 1.0;
    }
    return true;
  }

  /// The difference the short way round.
  template <class T>
  [[nodiscard]] static T residual(int /*row*/, const T& z, const T& predicted) {
    return wrap_to_pi(eval(z - predicted));
  }
};

/// Azimuth from a known place to the emitter whose position is the state:
/// `AzimuthToEmitter<PlanarFrame, 2>{.heading = psi, .receiver_p = {x, y}}` (carter section 5).
template <class FrameTag, int Dim>
using AzimuthToEmitter = Azimuth<FrameTag, Known<1>, Role<Dim, PositionTag>, Known<Dim>>;

}  // namespace soopnav
