#pragma once

#include <span>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/core/random.hpp"

namespace soopnav::clock {

/// Bias and drift of a clock at one time.
struct ClockState {
  double bias_m = 0.0;     ///< c times the offset from true time, positive when the clock is ahead [m]
  double drift_mps = 0.0;  ///< c times the fractional frequency offset [m/s]

  friend constexpr bool operator==(const ClockState&, const ClockState&) = default;
};

/// A two-state clock as it runs: exact for any step, so that a long step has the distribution of the short ones it is
/// made of (doc/process_models.md eq. 19).
///
/// Each step draws two normals from its stream, whatever the noise. No allocation.
class ClockSimulator {
 public:
  /// @throws std::invalid_argument unless the densities are finite and >= 0 and the start is finite.
  ClockSimulator(const ClockNoise& noise, const RandomStream& random, const ClockState& start = {});

  [[nodiscard]] const ClockState& state() const noexcept { return state_; }

  /// Moves the clock on by `dt_s`. False, and nothing has moved, unless dt_s is finite and >= 0.
  [[nodiscard]] bool advance(double dt_s) noexcept;

 private:
  ClockNoise noise_;
  RandomStream random_;
  ClockState state_;
};

/// Runs a clock along `time_s`, which rises or stands: the first of `out` is the start, each next one is the clock at
/// that time. No allocation.
/// @throws std::invalid_argument unless the spans have one size, times are finite and none is before the last, and as
/// ClockSimulator.
void simulate(const ClockNoise& noise, const ClockState& start, std::span<const double> time_s,
              const RandomStream& random, std::span<ClockState> out);

}  // namespace soopnav::clock
