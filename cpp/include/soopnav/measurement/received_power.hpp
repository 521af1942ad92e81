#pragma once

#include <cmath>
#include <numbers>

#include "soopnav/core/role.hpp"
#include "soopnav/measurement/arithmetic.hpp"
#include "soopnav/measurement/line_of_sight.hpp"

namespace soopnav {

/// Received signal strength that falls with the logarithm of distance.
///
/// Model:   z = P0 - 10 n log10(|p - q| / d0)            (doc/measurement_models.md eq. 15; Rappaport, Wireless
///          Communications, 2nd ed., eq. 4.69a) [dBm]
/// Frames:  p receiver, q source, both in `FrameTag` [m].
/// Signs:   falls with distance for n > 0; n = 2 in free space.
/// Roles:   the receiver's position; P0 [dBm], n and the source when they are a `Block` or a role.
/// Noise:   shadowing, normal in dB.
/// Refused: `predict` with a Jacobian answers false within `kMinRangeM` of the source; without one the value there is
///          infinite. No allocation.
template <class FrameTag = EcefFrame, StatePart Source = Known<3>, PartOf<1> Power = Known<1>,
          PartOf<1> Exponent = Known<1>, PartOf<Source::kDim> Receiver = Role<Source::kDim, PositionTag>>
struct ReceivedPower {
  static_assert(Source::kDim == 2 || Source::kDim == 3, "a source has two or three coordinates");
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  Source source_p{};                  ///< q [m]
  Power power_dbm{};                  ///< P0, received at the reference distance [dBm]
  Exponent exponent{};                ///< n
  double reference_distance_m = 1.0;  ///< d0 > 0 [m]
  Receiver receiver_p{};              ///< p [m]

  template <class X, class Y>
  requires Provides<X, ReceivedPower, Source, Power, Exponent, Receiver>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    using std::log;
    constexpr double kPerNeper = 10.0 / std::numbers::ln10;
    const auto line = line_of_sight<Source::kDim>(x(receiver_p), x(source_p));
    const auto decay = eval(kPerNeper * log(eval(line.range / reference_distance_m)));
    const auto n = x(exponent);
    y.value(0) = x(power_dbm)[0] - n[0] * decay;
    if constexpr (Y::kJacobian) {
      if (!(line.range > kMinRangeM)) return false;
      line.add_gradient(y.jacobian(receiver_p), y.jacobian(source_p), -kPerNeper * n[0] / line.range);
      y.jacobian(power_dbm)(0) += 1.0;
      y.jacobian(exponent)(0) -= decay;
    }
    return true;
  }
};

}  // namespace soopnav
