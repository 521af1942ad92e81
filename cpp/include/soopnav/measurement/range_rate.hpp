#pragma once

#include "soopnav/core/constants.hpp"
#include "soopnav/core/role.hpp"
#include "soopnav/measurement/arithmetic.hpp"
#include "soopnav/measurement/line_of_sight.hpp"

namespace soopnav {

/// Rate of a pseudorange: how fast a source recedes, by the receiver's clock.
///
/// Model:   z = u.(v - v_q) + d - d_q,  u = (p - q) / |p - q|      (doc/measurement_models.md eq. 8) [m/s]
/// Frames:  p, v position and velocity of the receiver, q, v_q of the source, all in `FrameTag` [m, m/s]. Velocities
///          are those of the frame: in ECEF a source fixed to the ground has none.
/// Signs:   positive when receding. d, d_q are the drifts c * d(clock)/dt of receiver and source [m/s]; a receiver
///          clock that runs fast makes everything recede.
/// Roles:   the receiver's position, velocity and clock drift (`Drift = Known<1>` where clocks do not enter), and
///          whatever of the source is a `Block` or a role.
/// Left out: the motion during the time of flight, of the order of v²/c.
/// Refused: `predict` with a Jacobian answers false within `kMinRangeM` of the source; without one the value there is
///          NaN. No allocation.
template <class FrameTag = EcefFrame, StatePart Source = Known<3>,
          PartOf<Source::kDim> SourceVelocity = Known<Source::kDim>, PartOf<1> SourceDrift = Known<1>,
          PartOf<1> Drift = Role<1, ClockDriftTag>, PartOf<Source::kDim> Receiver = Role<Source::kDim, PositionTag>,
          PartOf<Source::kDim> ReceiverVelocity = Role<Source::kDim, VelocityTag>>
struct RangeRate {
  static_assert(Source::kDim == 2 || Source::kDim == 3, "a source has two or three coordinates");
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  Source source_p{};              ///< q [m]
  SourceVelocity source_v{};      ///< v_q [m/s]
  SourceDrift source_drift{};     ///< d_q [m/s]
  Drift drift{};                  ///< d [m/s]
  Receiver receiver_p{};          ///< p [m]
  ReceiverVelocity receiver_v{};  ///< v [m/s]

  template <class X, class Y>
  requires Provides<X, RangeRate, Source, SourceVelocity, SourceDrift, Drift, Receiver, ReceiverVelocity>
  [[nodiscard]] bool predict(const X& x, Y& y) const { return predict_scaled(x, y, 1.0); }

  /// `scale` times the range rate: what a Doppler shift is.
  template <class X, class Y>
  [[nodiscard]] bool predict_scaled(const X& x, Y& y, double scale) const {
    const auto motion = moving_line<Source::kDim>(x(receiver_p), x(source_p), x(receiver_v), x(source_v));
    y.value(0) = scale * (motion.rate + (x(drift)[0] - x(source_drift)[0]));
    if constexpr (Y::kJacobian) {
      if (!(motion.line.range > kMinRangeM)) return false;
      motion.add_gradient(y.jacobian(receiver_p), y.jacobian(source_p), y.jacobian(receiver_v), y.jacobian(source_v),
                          scale);
      y.jacobian(drift)(0) += scale;
      y.jacobian(source_drift)(0) -= scale;
    }
    return true;
  }
};

/// Doppler shift of a carrier.
///
/// Model:   z = -range_rate / lambda = -range_rate * f / c        (doc/measurement_models.md eq. 9) [Hz]
/// Signs:   negative when receding; a receiver clock that runs fast lowers it. Frames, roles and refusals: `RangeRate`.
template <class FrameTag = EcefFrame, StatePart Source = Known<3>,
          PartOf<Source::kDim> SourceVelocity = Known<Source::kDim>, PartOf<1> SourceDrift = Known<1>,
          PartOf<1> Drift = Role<1, ClockDriftTag>, PartOf<Source::kDim> Receiver = Role<Source::kDim, PositionTag>,
          PartOf<Source::kDim> ReceiverVelocity = Role<Source::kDim, VelocityTag>>
struct Doppler {
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  double carrier_hz = 0.0;        ///< f
  Source source_p{};              ///< q [m]
  SourceVelocity source_v{};      ///< v_q [m/s]
  SourceDrift source_drift{};     ///< d_q [m/s]
  Drift drift{};                  ///< d [m/s]
  Receiver receiver_p{};          ///< p [m]
  ReceiverVelocity receiver_v{};  ///< v [m/s]

  template <class X, class Y>
  requires Provides<X, Doppler, Source, SourceVelocity, SourceDrift, Drift, Receiver, ReceiverVelocity>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const RangeRate<Frame, Source, SourceVelocity, SourceDrift, Drift, Receiver, ReceiverVelocity> rate{
        source_p, source_v, source_drift, drift, receiver_p, receiver_v};
    return rate.predict_scaled(x, y, -carrier_hz / kSpeedOfLightMps);
  }
};

/// Frequency difference of arrival of one signal at two receivers.
///
/// Model:   z = -(rate(p, v, d) - rate(r, v_r, d_r)) f / c        (doc/measurement_models.md eq. 10; mei eq. 1b) [Hz]
/// Frames:  p, v receiver, r, v_r reference receiver, q, v_q source, all in `FrameTag` [m, m/s].
/// Signs:   receiver minus reference: the Doppler shift at the receiver less that at the reference. (mei's xi is the
///          difference of the range rates, minus lambda times this.) d, d_r are clock drifts [m/s], zero unless said
///          otherwise; the source's drift cancels.
/// Roles:   any of positions, velocities and drifts that is a `Block` or a role, as for `Tdoa`.
/// Refused: `predict` with a Jacobian answers false when either receiver is within `kMinRangeM` of the source. No
///          allocation.
template <class FrameTag = EcefFrame, StatePart Source = Known<3>,
          PartOf<Source::kDim> SourceVelocity = Known<Source::kDim>,
          PartOf<Source::kDim> Reference = Known<Source::kDim>,
          PartOf<Source::kDim> ReferenceVelocity = Known<Source::kDim>, PartOf<1> Drift = Known<1>,
          PartOf<1> ReferenceDrift = Known<1>, PartOf<Source::kDim> Receiver = Role<Source::kDim, PositionTag>,
          PartOf<Source::kDim> ReceiverVelocity = Role<Source::kDim, VelocityTag>>
struct Fdoa {
  static_assert(Source::kDim == 2 || Source::kDim == 3, "a source has two or three coordinates");
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  double carrier_hz = 0.0;           ///< f
  Source source_p{};                 ///< q [m]
  SourceVelocity source_v{};         ///< v_q [m/s]
  Reference reference_p{};           ///< r [m]
  ReferenceVelocity reference_v{};   ///< v_r [m/s]
  Drift drift{};                     ///< d [m/s]
  ReferenceDrift reference_drift{};  ///< d_r [m/s]
  Receiver receiver_p{};             ///< p [m]
  ReceiverVelocity receiver_v{};     ///< v [m/s]

  template <class X, class Y>
  requires Provides<X, Fdoa, Source, SourceVelocity, Reference, ReferenceVelocity, Drift, ReferenceDrift, Receiver,
                    ReceiverVelocity>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    constexpr int kSpace = Source::kDim;
    const double scale = -carrier_hz / kSpeedOfLightMps;
    const auto here = moving_line<kSpace>(x(receiver_p), x(source_p), x(receiver_v), x(source_v));
    const auto there = moving_line<kSpace>(x(reference_p), x(source_p), x(reference_v), x(source_v));
    y.value(0) = scale * ((here.rate - there.rate) + (x(drift)[0] - x(reference_drift)[0]));
    if constexpr (Y::kJacobian) {
      if (!(here.line.range > kMinRangeM) || !(there.line.range > kMinRangeM)) return false;
      auto&& to_q = y.jacobian(source_p);
      auto&& to_vq = y.jacobian(source_v);
      here.add_gradient(y.jacobian(receiver_p), to_q, y.jacobian(receiver_v), to_vq, scale);
      there.add_gradient(y.jacobian(reference_p), to_q, y.jacobian(reference_v), to_vq, -scale);
      y.jacobian(drift)(0) += scale;
      y.jacobian(reference_drift)(0) -= scale;
    }
    return true;
  }
};

}  // namespace soopnav
