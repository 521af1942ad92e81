#pragma once

namespace soopnav::clock {

/// How an oscillator wanders: the two power densities of a two-state clock model, times c² so that clocks are in
/// metres.
struct ClockNoise {
  double white_frequency_m2ps = 0.0;  ///< S_f, the bias' random walk [m²/s = (m/s)²/Hz]
  double frequency_walk_m2ps3 = 0.0;  ///< S_g, the drift's random walk [m²/s³ = (m/s²)²/Hz]

  /// From the coefficients of the oscillator's fractional-frequency noise S_y(f) = h0 + h-2 / f²:
  /// S_f = c² h0 / 2 and S_g = 2 pi² c² h-2 (doc/process_models.md eq. 20; Brown and Hwang, Random Signals and Applied
  /// Kalman Filtering, section 9.3). `h0` in seconds, `h_minus_2` in hertz. Throws std::invalid_argument when one is
  /// negative or not finite.
  [[nodiscard]] static ClockNoise from_allan(double h0, double h_minus_2);

  /// Of the difference of two independent clocks.
  [[nodiscard]] friend constexpr ClockNoise operator+(const ClockNoise& a, const ClockNoise& b) noexcept {
    return {a.white_frequency_m2ps + b.white_frequency_m2ps, a.frequency_walk_m2ps3 + b.frequency_walk_m2ps3};
  }
  friend constexpr bool operator==(const ClockNoise&, const ClockNoise&) = default;
};

/// Allan deviation of fractional frequency that the two-state model has at an averaging time:
/// sqrt(S_f / tau + S_g tau / 3) / c (doc/process_models.md eq. 21). Throws std::invalid_argument unless `tau_s` is
/// positive and finite.
[[nodiscard]] double allan_deviation(const ClockNoise& noise, double tau_s);

}  // namespace soopnav::clock
