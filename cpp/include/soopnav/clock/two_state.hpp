#pragma once

#include <cmath>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/core/role.hpp"

namespace soopnav::clock {

/// Clock of two states, bias and drift: the drift wanders, and the bias wanders on top of it.
///
/// Model:   b += d dt + n_b,  d += n_d,
///          Cov = [[S_f dt + S_g dt³/3, S_g dt²/2], [S_g dt²/2, S_g dt]]   (doc/process_models.md eq. 19; pesyna eq.
///          11; Brown and Hwang section 9.3), exact for any step
/// Noise:   normal 0 moves the drift and with it the bias, normal 1 the rest of the bias.
/// Roles:   clock bias [m] and drift [m/s]; blocks for the clock of a source.
/// No allocation.
template <PartOf<1> Bias = Role<1, ClockBiasTag>, PartOf<1> Drift = Role<1, ClockDriftTag>>
struct TwoState {
  static constexpr int kNoise = 2;
  ClockNoise noise{};
  Bias bias{};
  Drift drift{};

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    const double to_drift = std::sqrt(noise.frequency_walk_m2ps3 * dt_s);
    const double to_bias = 0.5 * dt_s * to_drift;
    const double rest =
        std::sqrt(noise.white_frequency_m2ps * dt_s + noise.frequency_walk_m2ps3 * dt_s * dt_s * dt_s / 12.0);
    y.next(bias)[0] += dt_s * x(drift)[0] + (to_bias * w[0] + rest * w[1]);
    y.next(drift)[0] += to_drift * w[0];
    if constexpr (Y::kJacobian) {
      y.transition(bias, drift)(0, 0) = dt_s;
      auto&& of_bias = y.noise(bias);
      of_bias(0, 0) = to_bias;
      of_bias(0, 1) = rest;
      y.noise(drift)(0, 0) = to_drift;
    }
    return true;
  }
};

template <class... Parts>
TwoState(ClockNoise, Parts...) -> TwoState<Parts...>;

}  // namespace soopnav::clock
