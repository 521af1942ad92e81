#pragma once

#include <Eigen/Core>
#include <cmath>

#include "soopnav/core/role.hpp"
#include "soopnav/measurement/arithmetic.hpp"

namespace soopnav {

/// Distance to a point: two-way ranging, or one-way with synchronised clocks.
///
/// Model:   z = |p - q|                                  (doc/position_fix.md eq. 1 without clocks) [m]
/// Frames:  p receiver, q source, both in `FrameTag` [m]; a state in another frame does not compile.
/// Roles:   position (three components; a planar state supplies its stated height).
/// Refused: `predict` with a Jacobian answers false within `kMinRangeM` of the source. No allocation.
template <class FrameTag = EcefFrame>
struct Range {
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  Eigen::Vector3d source_p = Eigen::Vector3d::Zero();  ///< q [m]

  /// `x`: a state, or a packet of particles. `y`: with or without Jacobian.
  template <class X, class Y>
  requires FrameCompatible<Range, X>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    using std::sqrt;
    const auto p = x(kPosition);
    const auto dx = eval(p[0] - source_p[0]);
    const auto dy = eval(p[1] - source_p[1]);
    const auto dz = eval(p[2] - source_p[2]);
    const auto range = eval(sqrt(dx * dx + dy * dy + dz * dz));
    y.value(0) = range;
    if constexpr (Y::kJacobian) {
      if (!(range > kMinRangeM)) return false;
      y.jacobian(kPosition) << dx / range, dy / range, dz / range;
    }
    return true;
  }
};

Range(const Eigen::Vector3d&)->Range<>;

}  // namespace soopnav
