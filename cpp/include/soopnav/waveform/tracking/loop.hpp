#pragma once

#include <array>
#include <cstddef>

/// Code and carrier tracking of spread signals: loops and what theory says of them, correlators, a tracker.
namespace soopnav::tracking {

/// A loop that is updated every `interval_s` with the mean error of the interval: after interval k with the measured
/// mean error y, phase += gain[0] y, rate += gain[1] y / T, rate of the rate += gain[2] y / T².
///
/// Everything here is exact for the discrete loop, at any product of bandwidth and interval (cpp/doc/cdma_tracking.md,
/// eq. 8 ... 14).
struct Loop {
  int order = 2;  ///< 1, 2 or 3
  double interval_s = 1e-3;
  double bandwidth_hz = 10.0;    ///< one-sided noise bandwidth B: variance of the phase B N0 / C [rad²]
  std::array<double, 3> gain{};  ///< of phase, rate, rate of rate; those beyond the order are 0
};

/// The loop of an order with a noise bandwidth: poles z = exp(s T) of a critically scaled prototype, s a circle's
/// Butterworth pattern (order 1: -1; 2: damping 1/sqrt 2; 3: -1 and -1/2 +- j sqrt(3)/2) times the number that gives
/// exactly this bandwidth; no allocation, some 10 us. Throws std::invalid_argument unless order is 1 ... 3, the numbers
/// are positive and finite and B T <= 0.4, 0.9 or 1.6 for the orders (a dead-beat loop has 0.5, 1.25, 2.2).
[[nodiscard]] Loop design_loop(int order, double bandwidth_hz, double interval_s);

/// An oscillator as it shakes a phase: density of the random walks [cycles²/s] and [cycles²/s³], the two-state clock's
/// S_f and S_g over the wavelength squared.
struct PhaseNoise {
  double white_frequency_cycles2ps = 0.0;
  double frequency_walk_cycles2ps3 = 0.0;

  /// From the coefficients of S_y(f) = h0 + h-2 / f² [s], [Hz]: carrier² h0 / 2, 2 pi² carrier² h-2 (pesyna section
  /// IV-C). Throws std::invalid_argument for negative or not finite numbers.
  [[nodiscard]] static PhaseNoise from_allan(double h0, double h_minus_2, double carrier_hz);
};

/// Variances of a settled loop's errors.
struct LoopVariance {
  double phase = 0.0;  ///< of the phase after an update [cycles²]
  double rate = 0.0;   ///< of the rate [Hz²]
};

/// Errors from white noise of the measured means, of variance `mean_variance` (cycles²) each. No allocation.
[[nodiscard]] LoopVariance noise_variance(const Loop& loop, double mean_variance) noexcept;

/// Errors from an oscillator that wanders while the loop follows. Infinite where the order is too low for it (a first
/// order loop and a walk of the frequency). No allocation.
[[nodiscard]] LoopVariance oscillator_variance(const Loop& loop, const PhaseNoise& noise) noexcept;

/// Variance [cycles²] of the phase measured over an interval at a C/N0: 1 / (4 pi² · 2 T C/N0), times 1 + 1/(2 T C/N0)
/// for a Costas discriminator, whose data are wiped by themselves (`integration_s` is then the data's; the measured
/// interval may hold many). Kaplan and Hegarty eq. 5.6.
[[nodiscard]] double phase_variance(double cn0_hz, double interval_s) noexcept;
[[nodiscard]] double costas_phase_variance(double cn0_hz, double interval_s, double integration_s) noexcept;

/// Variance [cycles²] by which the mean of an oscillator's phase over a window differs from its phase amid the window:
/// q T / 12 + g T³ / 320 (eq. 15).
[[nodiscard]] double window_variance(const PhaseNoise& noise, double window_s) noexcept;

/// Variance [chips²] of the code delay from early-late times prompt over `interval_s` of integrations of
/// `integration_s`: d / (4 T C/N0) (1 + 1 / (T_i C/N0)) (eq. 17; d between early and late).
[[nodiscard]] double code_variance(double cn0_hz, double interval_s, double integration_s,
                                   double spacing_chips) noexcept;

}  // namespace soopnav::tracking
