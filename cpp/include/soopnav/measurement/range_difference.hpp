#pragma once

#include "soopnav/core/role.hpp"
#include "soopnav/measurement/arithmetic.hpp"
#include "soopnav/measurement/line_of_sight.hpp"

namespace soopnav {

/// How much farther a receiver is from a source than a reference point is.
///
/// Model:   z = |p - q| - |r - q|                        (doc/measurement_models.md eq. 5) [m]
/// Frames:  p receiver, q source, r reference, all in `FrameTag` [m].
/// Signs:   receiver minus reference: positive when the receiver is the farther one. The self-TDOA of crosby (3.9),
///          with the start of the run as reference, is initial minus present range, so minus this; times c.
/// Roles:   the receiver's position, and source and reference when they are a `Block` or a role rather than `Known`.
///          With `Receiver = Known<N>` it locates the source.
/// Refused: `predict` with a Jacobian answers false when either end is within `kMinRangeM` of the source. No
///          allocation.
template <class FrameTag = EcefFrame, StatePart Source = Known<3>, PartOf<Source::kDim> Reference = Known<Source::kDim>,
          PartOf<Source::kDim> Receiver = Role<Source::kDim, PositionTag>>
struct RangeDifference {
  static_assert(Source::kDim == 2 || Source::kDim == 3, "a source has two or three coordinates");
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  Source source_p{};        ///< q [m]
  Reference reference_p{};  ///< r [m]
  Receiver receiver_p{};    ///< p [m]

  template <class X, class Y>
  requires Provides<X, RangeDifference, Source, Reference, Receiver>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto far = line_of_sight<Source::kDim>(x(receiver_p), x(source_p));
    const auto near = line_of_sight<Source::kDim>(x(reference_p), x(source_p));
    y.value(0) = far.range - near.range;
    if constexpr (Y::kJacobian) {
      if (!(far.range > kMinRangeM) || !(near.range > kMinRangeM)) return false;
      auto&& to_q = y.jacobian(source_p);
      far.add_gradient(y.jacobian(receiver_p), to_q);
      near.add_gradient(y.jacobian(reference_p), to_q, -1.0);
    }
    return true;
  }
};

/// Time difference of arrival of one signal at two receivers, times the speed of light.
///
/// Model:   z = |p - q| + b - (|r - q| + b_r)            (doc/measurement_models.md eq. 6; mei eq. 1a) [m]
/// Frames:  p receiver, q source, r reference receiver, all in `FrameTag` [m].
/// Signs:   receiver minus reference, z = c * tdoa_s. b, b_r are c * (clock - system time) of receiver and reference:
///          only their difference matters, so with the reference's clock as system time b alone is it (mei's theta, its
///          skew being the drift of b). The source's clock cancels.
/// Roles:   any of the positions and clocks that is a `Block` or a role; clocks are zero unless said otherwise. Source
///          known: a receiver finds itself. `Receiver = Known<N>`, `Source` a role or block: receivers find the source.
/// Noise:   differences to one reference share its error: their R is full.
/// Refused: `predict` with a Jacobian answers false when either receiver is within `kMinRangeM` of the source. No
///          allocation.
template <class FrameTag = EcefFrame, StatePart Source = Known<3>, PartOf<Source::kDim> Reference = Known<Source::kDim>,
          PartOf<1> ReceiverClock = Known<1>, PartOf<1> ReferenceClock = Known<1>,
          PartOf<Source::kDim> Receiver = Role<Source::kDim, PositionTag>>
struct Tdoa {
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  Source source_p{};                 ///< q [m]
  Reference reference_p{};           ///< r [m]
  ReceiverClock receiver_clock{};    ///< b [m]
  ReferenceClock reference_clock{};  ///< b_r [m]
  Receiver receiver_p{};             ///< p [m]

  template <class X, class Y>
  requires Provides<X, Tdoa, Source, Reference, ReceiverClock, ReferenceClock, Receiver>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const RangeDifference<Frame, Source, Reference, Receiver> ranges{source_p, reference_p, receiver_p};
    if (!ranges.predict(x, y)) return false;
    y.value(0) = y.value(0) + (x(receiver_clock)[0] - x(reference_clock)[0]);
    if constexpr (Y::kJacobian) {
      y.jacobian(receiver_clock)(0) += 1.0;
      y.jacobian(reference_clock)(0) -= 1.0;
    }
    return true;
  }
};

}  // namespace soopnav
