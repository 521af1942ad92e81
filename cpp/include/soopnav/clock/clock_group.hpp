#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/clock/characterization.hpp"

namespace soopnav::clock {

/// Estimates of a group's clocks along a record; epochs x clocks, row by row.
struct ClockGroupRun {
  std::size_t epochs = 0;
  std::size_t clocks = 0;
  std::vector<double> filtered_s;        ///< bias, from the phases up to its epoch [s]
  std::vector<double> filtered_sigma_s;  ///< its standard deviation
  std::vector<double> bias_s;            ///< smoothed: from all phases [s]
  std::vector<double> drift;             ///< smoothed fractional frequency offset
  std::vector<double> sigma_s;           ///< standard deviation of the smoothed bias
};

/// Clocks of known noise from phase records: Kalman filter and fixed-interval smoother of a bias and a drift for each
/// clock (doc/characterization.md eqs. 16 to 19). With `clocks` = receiver and sources this is pesyna's estimator for a
/// receiver that stands at a known place: stage 1 (satellites), 2 (satellites and basestations) or 3 (basestations).
///
/// Fewer channels than clocks leave common biases and drifts unobservable: the first `clocks - channels` clocks are
/// then referred to themselves, bias and drift zero at the first whole epoch, so that estimates are right up to a
/// straight line. The constants of phases are the clocks' own: as many as channels are free.
/// Cost: about 2 µs an epoch with three clocks. Smoothing uses no inverse of a covariance (Durbin and Koopman 2012,
/// section 4.4).
class ClockGroup {
 public:
  /// @throws std::invalid_argument as check_model, for another number of clocks than the model's, more channels than
  /// clocks, and for a mixing of which the last clocks' columns are dependent.
  ClockGroup(const PhaseModel& model, std::span<const Oscillator> clocks);

  [[nodiscard]] const PhaseModel& model() const noexcept { return model_; }

  /// `phase_s`: epochs x channels, row by row [s]; an epoch with a NaN is predicted across.
  /// @throws std::invalid_argument for a phase that is infinite or `kLargestPhase` times its noise, no whole epochs or
  /// fewer than 2 of them.
  [[nodiscard]] ClockGroupRun run(std::span<const double> phase_s) const;

  /// Allan variance of the error of the smoothed bias of one clock at averaging times of `factors` steps, from the
  /// smoother's covariance with its lags, mean over a record of `epochs` (doc/characterization.md eq. 19). The record's
  /// phases do not matter. O(epochs * largest factor).
  /// @throws std::invalid_argument for a clock that is not there, fewer than 3 epochs, a factor of 0 or one that
  /// needs more: `epochs` > 2 factor.
  [[nodiscard]] std::vector<double> error_allan_variance(std::size_t clock, std::span<const std::size_t> factors,
                                                         std::size_t epochs) const;

 private:
  struct Pass;
  Pass forward(std::span<const double> phase, std::size_t epochs) const;

  PhaseModel model_;
  std::vector<Oscillator> clocks_;
  double unit_s_ = 1.0;
  std::vector<double> start_;  // inverse of the last clocks' columns applied to unit phases, channels x channels
};

/// How pesyna fig. 2 may read "analysis" of a smoothed clock.
enum class NoiseAnalysis : std::uint8_t {
  kIncrements,  ///< variances of the smoothed state's own steps
  kAllanFit,    ///< h0 / (2 tau) + (2 pi² / 3) h-2 tau fitted to the smoothed bias' Allan variance, both >= 0
};

/// The iteration of pesyna fig. 2 as printed: smooth with the present noise, take the noise from the smoothed clocks,
/// repeat. Kept to show where it collapses (doc/characterization.md eq. 14): the smoothed clocks move less than the
/// clocks by the smoother's own error, so noise near the phases' is lost at each turn. Use `characterize`.
///
/// Returns the noise before each of the iterations and after the last: (iterations + 1) x clocks, row by row; known
/// clocks stay. A coefficient is not let below 1e-12 of its start.
/// @throws std::invalid_argument as ClockGroup, its run, for an index beyond the clocks and for fewer than 8 whole
/// epochs.
[[nodiscard]] std::vector<Oscillator> iterate_noise(std::span<const double> phase_s, const PhaseModel& model,
                                                    std::span<const Oscillator> start,
                                                    std::span<const std::size_t> estimated, NoiseAnalysis analysis,
                                                    int iterations);

}  // namespace soopnav::clock
