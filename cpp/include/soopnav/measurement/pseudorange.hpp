#pragma once

#include <Eigen/Core>

#include "soopnav/core/role.hpp"
#include "soopnav/measurement/arithmetic.hpp"
#include "soopnav/measurement/line_of_sight.hpp"

namespace soopnav {

/// Pseudorange from a source: the time of arrival of its signal on the receiver's clock, times the speed of light.
///
/// Model:   z = |p - q| + b - b_q                        (doc/measurement_models.md eq. 4; pesyna eq. 5) [m]
/// Frames:  p receiver, q source, both in `FrameTag` [m]; a state in another frame does not compile.
/// Signs:   b = c * (receiver clock - system time) lengthens it, b_q = c * (source clock - system time) shortens it: a
///          source that transmits t seconds late has b_q = -c * t.
/// Roles:   the receiver's position (as many components as the source has; a planar state supplies its stated height)
///          and clock bias, and the source's clock and position when they are a `Block` or a role rather than `Known`.
/// Emitter: with `Receiver = Known<N>`, `ReceiverClock = Known<1>` it locates the source.
/// Refused: `predict` with a Jacobian answers false within `kMinRangeM` of the source. No allocation.
template <class FrameTag = EcefFrame, PartOf<1> SourceClock = Known<1>, StatePart Source = Known<3>,
          PartOf<1> ReceiverClock = Role<1, ClockBiasTag>,
          PartOf<Source::kDim> Receiver = Role<Source::kDim, PositionTag>>
struct Pseudorange {
  static_assert(Source::kDim == 2 || Source::kDim == 3, "a source has two or three coordinates");
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  Source source_p{};               ///< q, the source's antenna [m]
  SourceClock source_clock{};      ///< b_q [m]
  ReceiverClock receiver_clock{};  ///< b [m]
  Receiver receiver_p{};           ///< p [m]

  /// `x`: a state, or a packet of particles. `y`: with or without Jacobian.
  template <class X, class Y>
  requires Provides<X, Pseudorange, Source, SourceClock, ReceiverClock, Receiver>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto line = line_of_sight<Source::kDim>(x(receiver_p), x(source_p));
    y.value(0) = line.range + x(receiver_clock)[0] - x(source_clock)[0];
    if constexpr (Y::kJacobian) {
      if (!(line.range > kMinRangeM)) return false;
      line.add_gradient(y.jacobian(receiver_p), y.jacobian(source_p));
      y.jacobian(receiver_clock)(0) += 1.0;
      y.jacobian(source_clock)(0) -= 1.0;
    }
    return true;
  }
};

template <class Derived>
Pseudorange(const Eigen::MatrixBase<Derived>&)
    -> Pseudorange<detail::FrameOfSpace<Derived::RowsAtCompileTime>, Known<1>, Known<Derived::RowsAtCompileTime>>;
template <class Derived, PartOf<1> SourceClock>
Pseudorange(const Eigen::MatrixBase<Derived>&, SourceClock)
    -> Pseudorange<detail::FrameOfSpace<Derived::RowsAtCompileTime>, SourceClock, Known<Derived::RowsAtCompileTime>>;

}  // namespace soopnav
