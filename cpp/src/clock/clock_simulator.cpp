#include "soopnav/clock/clock_simulator.hpp"

#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>

namespace soopnav::clock {
namespace {

void require_density(double value, const char* name) {
  if (!(value >= 0.0) || std::isinf(value)) {
    throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " must be finite and >= 0");
  }
}

void require_finite(double value, const char* name) {
  if (!std::isfinite(value)) throw std::invalid_argument(std::string(name) + " must be finite");
}

}  // namespace

ClockSimulator::ClockSimulator(const ClockNoise& noise, const RandomStream& random, const ClockState& start)
    : noise_(noise), random_(random), state_(start) {
  require_density(noise.white_frequency_m2ps, "white_frequency_m2ps");
  require_density(noise.frequency_walk_m2ps3, "frequency_walk_m2ps3");
  require_finite(start.bias_m, "start.bias_m");
  require_finite(start.drift_mps, "start.drift_mps");
}

bool ClockSimulator::advance(double dt_s) noexcept {
  if (!(dt_s >= 0.0) || std::isinf(dt_s)) return false;
  const double w0 = random_.normal();
  const double w1 = random_.normal();
  // doc/process_models.md eq. 19a
  const double to_drift = std::sqrt(noise_.frequency_walk_m2ps3 * dt_s) * w0;
  const double rest =
      std::sqrt(noise_.white_frequency_m2ps * dt_s + noise_.frequency_walk_m2ps3 * dt_s * dt_s * dt_s / 12.0) * w1;
  state_.bias_m += dt_s * state_.drift_mps + (0.5 * dt_s * to_drift + rest);
  state_.drift_mps += to_drift;
  return true;
}

void simulate(const ClockNoise& noise, const ClockState& start, std::span<const double> time_s,
              const RandomStream& random, std::span<ClockState> out) {
  if (out.size() != time_s.size()) {
    throw std::invalid_argument("out: " + std::to_string(time_s.size()) + " states expected, got " +
                                std::to_string(out.size()));
  }
  ClockSimulator clock(noise, random, start);
  for (std::size_t i = 0; i < time_s.size(); ++i) {
    if (!std::isfinite(time_s[i]) || (i > 0 && !clock.advance(time_s[i] - time_s[i - 1]))) {
      throw std::invalid_argument("time_s[" + std::to_string(i) + "] = " + std::to_string(time_s[i]) +
                                  " must be finite and not before the one in front of it");
    }
    out[i] = clock.state();
  }
}

}  // namespace soopnav::clock
