#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "soopnav/clock/characterization.hpp"

namespace soopnav::clock {

/// Candidate noises of clocks, weighted epoch by epoch by the likelihood of their innovations: multiple models (Li and
/// Bar-Shalom 1994, a static bank; pesyna ref. [9]; doc/characterization.md eq. 15).
///
/// Every candidate has a filter of the channels' biases and drifts, as PhaseLikelihood, started exactly from the first
/// two whole epochs; so a candidate's log-likelihood is that of PhaseLikelihood for the same record. A push costs about
/// 10 ns a candidate with one channel once its gains have settled, 60 ns before, and does not allocate.
class NoiseBank {
 public:
  /// `candidates`: one after another, each `model.clocks` oscillators. `prior`: relative weights, empty for equal ones.
  /// @throws std::invalid_argument as PhaseLikelihood for the model, for no candidate or a broken row of them, and for
  /// priors of another number, negative, not finite or all zero.
  NoiseBank(const PhaseModel& model, std::span<const Oscillator> candidates, std::span<const double> prior = {});
  NoiseBank(NoiseBank&&) noexcept;
  NoiseBank& operator=(NoiseBank&&) noexcept;
  NoiseBank(const NoiseBank&) = delete;
  NoiseBank& operator=(const NoiseBank&) = delete;
  ~NoiseBank();

  /// The next epoch's phases, one for each channel [s]. False when the epoch is skipped: one of them is not finite or
  /// `kLargestPhase` times its noise, or there are not as many as channels; the filters then predict across it.
  bool push(std::span<const double> phase_s) noexcept;

  [[nodiscard]] std::size_t candidates() const noexcept;
  [[nodiscard]] std::size_t innovations() const noexcept;  ///< whole epochs so far less two, 0 before
  [[nodiscard]] const PhaseModel& model() const noexcept;
  /// Posterior probability of each candidate; sums to one. As before while no candidate has a finite likelihood.
  [[nodiscard]] std::span<const double> weights() const noexcept;
  /// Of each candidate, phases in seconds, without its prior; minus infinity where a variance was not positive.
  [[nodiscard]] std::span<const double> log_likelihoods() const noexcept;

  struct Filters;

 private:
  std::unique_ptr<Filters> filters_;
};

}  // namespace soopnav::clock
