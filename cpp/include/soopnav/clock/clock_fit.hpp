#pragma once

#include <span>

#include "soopnav/clock/oscillator.hpp"

namespace soopnav::clock {

struct ClockFitOptions {
  /// White noise of the phase readings is estimated as well. Real records have it; without it in the model it is
  /// taken for white frequency noise.
  bool phase_noise = false;
};

/// A two-state clock that fits a record, with standard deviations from the curvature of the likelihood.
///
/// A coefficient that the record does not show comes back as 0; its sigma is then the value up to which the record
/// would hardly object (a log-likelihood lower by 1/2). A sigma is infinite where a few phases do not bound it.
/// `correlation` is that of the errors of log h0 and log h-2, 0 then.
struct ClockFit {
  Oscillator clock{};            ///< h-1 is 0
  double sigma_h0 = 0.0;         ///< [s]
  double sigma_h_minus_2 = 0.0;  ///< [Hz]
  double phase_noise_s = 0.0;    ///< standard deviation of the readings' white noise; 0 unless asked for
  double correlation = 0.0;
  double log_likelihood = 0.0;  ///< at the fit, of the innovations [phases in seconds]
};

/// Fits a two-state clock to phases every `dt_s` by maximum likelihood: a Kalman filter's innovations are white under
/// the right coefficients (doc/clocks.md eqs. 13 to 16). NaN is a gap, which the filter predicts across.
///
/// Both coefficients are found when the step is near `Oscillator::crossover_s`, or below it by less than the root of
/// the number of phases: the random walk has to outgrow the white noise within the record. O(phases) for each of some
/// 60 evaluations, 300 with phase noise. Allocates.
/// @throws std::invalid_argument unless dt_s is positive and finite, no phase is infinite, at least 8 are there, and
/// they are not on a straight line.
[[nodiscard]] ClockFit fit_clock(std::span<const double> phase_s, double dt_s, const ClockFitOptions& options = {});

}  // namespace soopnav::clock
