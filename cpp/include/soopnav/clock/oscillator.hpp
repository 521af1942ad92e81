#pragma once

#include <Eigen/Core>

#include "soopnav/clock/clock_noise.hpp"

namespace soopnav::clock {

/// An oscillator by the coefficients of its fractional-frequency noise, S_y(f) = h0 + h-1 / f + h-2 / f² (one-sided).
///
/// h-1, flicker of frequency, is reported and not modelled: no finite number of states has it (doc/clocks.md). The
/// named ones do not allocate and do not throw.
struct Oscillator {
  double h0 = 0.0;         ///< white frequency noise [s]
  double h_minus_2 = 0.0;  ///< random walk of frequency [Hz]
  double h_minus_1 = 0.0;  ///< flicker of frequency, not modelled; 0 where the source gives none

  /// Temperature-compensated crystal of a receiver: 1e-20, 1e-22 (pesyna, the receiver's TCXO).
  [[nodiscard]] static Oscillator tcxo() noexcept { return {1e-20, 1e-22}; }
  /// Oven-controlled crystal of a receiver: 1e-23, 1e-25 (pesyna, the receiver's OCXO; better than most on sale).
  [[nodiscard]] static Oscillator ocxo() noexcept { return {1e-23, 1e-25}; }
  /// The steadier of pesyna's two cellular basestations: 3e-25, 3e-27.
  [[nodiscard]] static Oscillator basestation() noexcept { return {3e-25, 3e-27}; }
  /// Chip-scale atomic clock: an Allan deviation of 3e-10 / sqrt(tau), the limit that data sheets of caesium vapour
  /// cells state at 1 s, hence h0 = 2 (3e-10)²; and a random walk of 1e-11 at a day, below their ageing of 9e-10 a
  /// month.
  [[nodiscard]] static Oscillator csac() noexcept;
  /// Rubidium clock of a GPS satellite: 3e-12 / sqrt(tau) down to a flicker floor of 5e-14, the specification of Block
  /// IIR's; and a random walk that reaches the floor after a day.
  [[nodiscard]] static Oscillator gps() noexcept;
  /// The transmitters' clock of crosby fig. 3.4: S_f = 0.036 (m/s)²/Hz, S_g = 0.141 (m/s²)²/Hz (the crystal of Brown
  /// and Hwang).
  [[nodiscard]] static Oscillator crosby() noexcept { return from_noise({0.036, 0.141}); }

  /// The coefficients of a two-state clock's power densities: the inverse of `noise`.
  [[nodiscard]] static Oscillator from_noise(const ClockNoise& noise) noexcept;

  /// Power densities of its two-state model; throws as `ClockNoise::from_allan`.
  [[nodiscard]] ClockNoise noise() const { return ClockNoise::from_allan(h0, h_minus_2); }

  /// Step at which the two noises add the same variance rate, sqrt(S_f / S_g) [s]: sampled near it both coefficients
  /// are found about equally well. Infinite without a random walk of frequency; 0 without white frequency noise.
  [[nodiscard]] double crossover_s() const noexcept;

  friend constexpr bool operator==(const Oscillator&, const Oscillator&) = default;
};

/// Variance of a clock's bias `tau_s` ahead [m²] (doc/clocks.md eq. 5):
/// P_bb + 2 tau P_bd + tau² P_dd + S_f tau + S_g tau³ / 3.
///
/// `covariance` is that of bias [m] and drift [m/s] now. No allocation.
/// @throws std::invalid_argument unless tau_s is finite and >= 0 and the covariance has finite numbers and no negative
/// variance.
[[nodiscard]] double prediction_variance_m2(const ClockNoise& noise, double tau_s,
                                            const Eigen::Matrix2d& covariance = Eigen::Matrix2d::Zero());

}  // namespace soopnav::clock
