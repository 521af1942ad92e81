#pragma once

#include <Eigen/Core>
#include <cmath>

#include "soopnav/core/role.hpp"
#include "soopnav/measurement/arithmetic.hpp"

namespace soopnav {

/// Pseudorange from a source: the time of arrival of its signal on the receiver's clock, times the speed of light.
///
/// Model:   z = |p - q| + b - b_q                        (doc/position_fix.md eq. 1) [m]
/// Frames:  p receiver, q source, both in `FrameTag` [m]; a state in another frame does not compile.
/// Signs:   b = c * (receiver clock - system time) lengthens it, b_q = c * (source clock - system time) shortens it: a
///          source that transmits t seconds late has b_q = -c * t.
/// Roles:   position (three components; a planar state supplies its stated height), clock bias, and the source clock
///          when `SourceClock` is a `Block<1>`.
/// Refused: `predict` with a Jacobian answers false within `kMinRangeM` of the source. No allocation.
template <class FrameTag = EcefFrame, PartOf<1> SourceClock = Known<1>>
struct Pseudorange {
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  Eigen::Vector3d source_p = Eigen::Vector3d::Zero();  ///< q, the source's antenna [m]
  SourceClock source_clock{};                          ///< b_q [m]

  /// `x`: a state, or a packet of particles. `y`: with or without Jacobian.
  template <class X, class Y>
  requires FrameCompatible<Pseudorange, X>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    using std::sqrt;
    const auto p = x(kPosition);
    const auto dx = eval(p[0] - source_p[0]);
    const auto dy = eval(p[1] - source_p[1]);
    const auto dz = eval(p[2] - source_p[2]);
    const auto range = eval(sqrt(dx * dx + dy * dy + dz * dz));
    y.value(0) = range + x(kClockBias)[0] - x(source_clock)[0];
    if constexpr (Y::kJacobian) {
      if (!(range > kMinRangeM)) return false;
      y.jacobian(kPosition) << dx / range, dy / range, dz / range;
      y.jacobian(kClockBias)(0) = 1.0;
      y.jacobian(source_clock)(0) = -1.0;
    }
    return true;
  }
};

Pseudorange(const Eigen::Vector3d&)->Pseudorange<>;
template <PartOf<1> SourceClock>
Pseudorange(const Eigen::Vector3d&, SourceClock) -> Pseudorange<EcefFrame, SourceClock>;

}  // namespace soopnav
