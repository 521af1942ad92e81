#pragma once

#include "soopnav/core/role.hpp"
#include "soopnav/measurement/arithmetic.hpp"
#include "soopnav/measurement/line_of_sight.hpp"

namespace soopnav {

/// Accumulated phase of a carrier.
///
/// Model:   z = (|p - q| + b - b_q) / lambda + N         (doc/measurement_models.md eq. 7; pesyna eq. 4, 5) [cycles]
/// Frames:  p receiver, q source, both in `FrameTag` [m].
/// Signs:   grows with range, as a pseudorange does, so its rate is minus the Doppler shift. b, b_q as in
///          `Pseudorange`; N [cycles] is pesyna's gamma: it stays while the signal is tracked, and need not be whole.
/// Roles:   the receiver's position and clock; source, source clock and N when they are a `Block` or a role (one N for
///          each signal and receiver).
/// Refused: `predict` with a Jacobian answers false within `kMinRangeM` of the source. No allocation.
template <class FrameTag = EcefFrame, PartOf<1> Ambiguity = Known<1>, PartOf<1> SourceClock = Known<1>,
          StatePart Source = Known<3>, PartOf<1> ReceiverClock = Role<1, ClockBiasTag>,
          PartOf<Source::kDim> Receiver = Role<Source::kDim, PositionTag>>
struct CarrierPhase {
  static_assert(Source::kDim == 2 || Source::kDim == 3, "a source has two or three coordinates");
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  double wavelength_m = 1.0;       ///< lambda > 0
  Source source_p{};               ///< q, the source's antenna [m]
  Ambiguity ambiguity_cycles{};    ///< N
  SourceClock source_clock{};      ///< b_q [m]
  ReceiverClock receiver_clock{};  ///< b [m]
  Receiver receiver_p{};           ///< p [m]

  template <class X, class Y>
  requires Provides<X, CarrierPhase, Ambiguity, SourceClock, Source, ReceiverClock, Receiver>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const double per_metre = 1.0 / wavelength_m;
    const auto line = line_of_sight<Source::kDim>(x(receiver_p), x(source_p));
    y.value(0) = (line.range + x(receiver_clock)[0] - x(source_clock)[0]) * per_metre + x(ambiguity_cycles)[0];
    if constexpr (Y::kJacobian) {
      if (!(line.range > kMinRangeM)) return false;
      line.add_gradient(y.jacobian(receiver_p), y.jacobian(source_p), per_metre);
      y.jacobian(receiver_clock)(0) += per_metre;
      y.jacobian(source_clock)(0) -= per_metre;
      y.jacobian(ambiguity_cycles)(0) += 1.0;
    }
    return true;
  }
};

}  // namespace soopnav
