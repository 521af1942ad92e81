#pragma once

#include <Eigen/Core>

#include "soopnav/core/role.hpp"
#include "soopnav/measurement/arithmetic.hpp"
#include "soopnav/measurement/line_of_sight.hpp"

namespace soopnav {

/// Distance to a point: two-way ranging, or one-way with synchronised clocks.
///
/// Model:   z = |p - q|                                  (doc/measurement_models.md eq. 3; crosby eq. 3.8) [m]
/// Frames:  p receiver, q source, both in `FrameTag` [m]; a state in another frame does not compile.
/// Roles:   the receiver's position (as many components as the source has; a planar state supplies its stated height)
///          and the source's when it is a `Block` or a role rather than `Known`.
/// Emitter: `Receiver = Known<N>` and `Source` a role or block: a known receiver ranges to an unknown source.
/// Refused: `predict` with a Jacobian answers false within `kMinRangeM` of the source. No allocation.
template <class FrameTag = EcefFrame, StatePart Source = Known<3>,
          PartOf<Source::kDim> Receiver = Role<Source::kDim, PositionTag>>
struct Range {
  static_assert(Source::kDim == 2 || Source::kDim == 3, "a source has two or three coordinates");
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  Source source_p{};      ///< q [m]
  Receiver receiver_p{};  ///< p [m]

  /// `x`: a state, or a packet of particles. `y`: with or without Jacobian.
  template <class X, class Y>
  requires Provides<X, Range, Source, Receiver>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto line = line_of_sight<Source::kDim>(x(receiver_p), x(source_p));
    y.value(0) = line.range;
    if constexpr (Y::kJacobian) {
      if (!(line.range > kMinRangeM)) return false;
      line.add_gradient(y.jacobian(receiver_p), y.jacobian(source_p));
    }
    return true;
  }
};

template <class Derived>
Range(const Eigen::MatrixBase<Derived>&)
    -> Range<detail::FrameOfSpace<Derived::RowsAtCompileTime>, Known<Derived::RowsAtCompileTime>>;

}  // namespace soopnav
