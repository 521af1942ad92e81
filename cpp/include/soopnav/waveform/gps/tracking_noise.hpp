#pragma once

#include <limits>

#include "soopnav/waveform/gps/ca_code.hpp"

namespace soopnav::gps {

/// What a carrier loop is made of (carter eq. 2.23 and 2.24).
struct PhaseLoop {
  double bandwidth_hz = 15.0;   ///< B_l, one-sided noise bandwidth, > 0
  double power_fraction = 1.0;  ///< γ, share of the signal's power in the component tracked, in (0, 1]
  double oscillator_rad = 0.0;  ///< phase noise of the receiver's oscillator, 1 σ, >= 0
  double dynamics_rad = 0.0;    ///< change of phase along the line of sight during a loop update, >= 0
  /// Coherent integration of a Costas loop; its squaring loss 1 + 1/(2 T γ C/N0) is left out at infinity, as the paper
  /// leaves it out. > 0
  double integration_s = std::numeric_limits<double>::infinity();

  /// Throws std::invalid_argument naming the field that breaks its rule.
  void check() const;
};

/// Standard deviation of a tracked carrier's phase [rad]: the root of
/// σ² = B_l / (γ C/N0) · squaring loss + oscillator² + dynamics² (carter eq. 2.23, 2.24; the print calls the variance
/// σ_PLL). `cn0_dbhz`: any; at a very low one the loop has long lost lock (beyond 0.26 rad, 15 degrees). NaN in, NaN
/// out.
[[nodiscard]] double phase_sigma_rad(double cn0_dbhz, const PhaseLoop& loop = {}) noexcept;

/// The same as a length: phase times λ / 2π [m].
[[nodiscard]] double phase_sigma_m(double cn0_dbhz, const PhaseLoop& loop = {},
                                   double carrier_hz = kCarrierHz) noexcept;

/// What a code loop is made of.
struct CodeLoop {
  double bandwidth_hz = 0.5;      ///< one-sided noise bandwidth (carrier-aided), > 0
  double early_late_chips = 0.5;  ///< spacing d between early and late, in (0, 1]
  double integration_s = 20e-3;   ///< predetection integration, > 0

  /// Throws std::invalid_argument naming the field that breaks its rule.
  void check() const;
};

/// Standard deviation of a tracked code [m], a non-coherent early-minus-late-power loop in wide bandwidth
/// (Kaplan and Hegarty, Understanding GPS, 2nd ed., eq. 5.14 simplified for unlimited bandwidth):
/// σ² = (B d / (2 C/N0)) (1 + 2 / ((2 - d) T C/N0)) in chips².
[[nodiscard]] double code_sigma_m(double cn0_dbhz, const CodeLoop& loop = {}) noexcept;

}  // namespace soopnav::gps
