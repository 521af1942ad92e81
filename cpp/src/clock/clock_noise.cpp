#include "soopnav/clock/clock_noise.hpp"

#include <cmath>
#include <stdexcept>
#include <string>

#include "soopnav/core/constants.hpp"

namespace soopnav::clock {
namespace {

void require_density(double value, const char* name) {
  if (!(value >= 0.0) || std::isinf(value)) {
    throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " must be finite and >= 0");
  }
}

}  // namespace

ClockNoise ClockNoise::from_allan(double h0, double h_minus_2) {
  require_density(h0, "h0");
  require_density(h_minus_2, "h_minus_2");
  constexpr double kC2 = kSpeedOfLightMps * kSpeedOfLightMps;
  return {0.5 * kC2 * h0, 2.0 * kPi * kPi * kC2 * h_minus_2};
}

double allan_deviation(const ClockNoise& noise, double tau_s) {
  if (!(tau_s > 0.0) || std::isinf(tau_s)) {
    throw std::invalid_argument("tau_s = " + std::to_string(tau_s) + " must be positive and finite");
  }
  return std::sqrt(noise.white_frequency_m2ps / tau_s + noise.frequency_walk_m2ps3 * tau_s / 3.0) / kSpeedOfLightMps;
}

}  // namespace soopnav::clock
