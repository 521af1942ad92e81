#include "soopnav/waveform/gps/tracking_noise.hpp"

#include <cmath>
#include <stdexcept>
#include <string>

#include "soopnav/core/constants.hpp"

namespace soopnav::gps {
namespace {

void require(bool holds, const char* name, double value, const char* rule) {
  if (!holds) throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " " + rule);
}

double ratio_hz(double cn0_dbhz) noexcept { return std::pow(10.0, cn0_dbhz / 10.0); }

}  // namespace

void PhaseLoop::check() const {
  require(bandwidth_hz > 0.0 && std::isfinite(bandwidth_hz), "bandwidth_hz", bandwidth_hz, "must be positive, finite");
  require(power_fraction > 0.0 && power_fraction <= 1.0, "power_fraction", power_fraction, "must be in (0, 1]");
  require(oscillator_rad >= 0.0 && std::isfinite(oscillator_rad), "oscillator_rad", oscillator_rad,
          "must be finite and not negative");
  require(dynamics_rad >= 0.0 && std::isfinite(dynamics_rad), "dynamics_rad", dynamics_rad,
          "must be finite and not negative");
  require(integration_s > 0.0, "integration_s", integration_s, "must be positive");
}

double phase_sigma_rad(double cn0_dbhz, const PhaseLoop& loop) noexcept {
  const double signal = loop.power_fraction * ratio_hz(cn0_dbhz);
  const double squaring = std::isfinite(loop.integration_s) ? 1.0 + 0.5 / (loop.integration_s * signal) : 1.0;
  return std::sqrt(loop.bandwidth_hz / signal * squaring + loop.oscillator_rad * loop.oscillator_rad +
                   loop.dynamics_rad * loop.dynamics_rad);
}

double phase_sigma_m(double cn0_dbhz, const PhaseLoop& loop, double carrier_hz) noexcept {
  return phase_sigma_rad(cn0_dbhz, loop) * kSpeedOfLightMps / (kTwoPi * carrier_hz);
}

void CodeLoop::check() const {
  require(bandwidth_hz > 0.0 && std::isfinite(bandwidth_hz), "bandwidth_hz", bandwidth_hz, "must be positive, finite");
  require(early_late_chips > 0.0 && early_late_chips <= 1.0, "early_late_chips", early_late_chips, "must be in (0, 1]");
  require(integration_s > 0.0 && std::isfinite(integration_s), "integration_s", integration_s,
          "must be positive, finite");
}

double code_sigma_m(double cn0_dbhz, const CodeLoop& loop) noexcept {
  const double signal = ratio_hz(cn0_dbhz);
  const double d = loop.early_late_chips;
  const double chips =
      std::sqrt(loop.bandwidth_hz * d / (2.0 * signal) * (1.0 + 2.0 / ((2.0 - d) * loop.integration_s * signal)));
  return chips * kSpeedOfLightMps / kChipRateHz;
}

}  // namespace soopnav::gps
