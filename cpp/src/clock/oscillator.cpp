#include "soopnav/clock/oscillator.hpp"

#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <string>

#include "soopnav/core/constants.hpp"

namespace soopnav::clock {
namespace {

constexpr double kDayS = 86400.0;

// h-2 of the random walk whose Allan deviation at `tau_s` is `deviation`.
double walk_through(double deviation, double tau_s) { return 3.0 * deviation * deviation / (2.0 * kPi * kPi * tau_s); }

}  // namespace

Oscillator Oscillator::csac() noexcept {
  constexpr double kAtOneSecond = 3e-10;
  constexpr double kAtOneDay = 1e-11;
  return {2.0 * kAtOneSecond * kAtOneSecond, walk_through(kAtOneDay, kDayS)};
}

Oscillator Oscillator::gps() noexcept {
  constexpr double kAtOneSecond = 3e-12;
  constexpr double kFloor = 5e-14;
  return {2.0 * kAtOneSecond * kAtOneSecond, walk_through(kFloor, kDayS),
          kFloor * kFloor / (2.0 * std::numbers::ln2_v<double>)};
}

Oscillator Oscillator::from_noise(const ClockNoise& noise) noexcept {
  constexpr double kC2 = kSpeedOfLightMps * kSpeedOfLightMps;
  return {2.0 * noise.white_frequency_m2ps / kC2, noise.frequency_walk_m2ps3 / (2.0 * kPi * kPi * kC2)};
}

double Oscillator::crossover_s() const noexcept {
  if (!(h_minus_2 > 0.0)) return std::numeric_limits<double>::infinity();
  return std::sqrt(h0 / h_minus_2) / kTwoPi;
}

double prediction_variance_m2(const ClockNoise& noise, double tau_s, const Eigen::Matrix2d& covariance) {
  if (!(tau_s >= 0.0) || std::isinf(tau_s)) {
    throw std::invalid_argument("tau_s = " + std::to_string(tau_s) + " must be finite and >= 0");
  }
  if (!covariance.allFinite() || covariance(0, 0) < 0.0 || covariance(1, 1) < 0.0) {
    throw std::invalid_argument("covariance must have finite numbers and no negative variance");
  }
  return covariance(0, 0) + tau_s * (covariance(0, 1) + covariance(1, 0)) + tau_s * tau_s * covariance(1, 1) +
         noise.white_frequency_m2ps * tau_s + noise.frequency_walk_m2ps3 * tau_s * tau_s * tau_s / 3.0;
}

}  // namespace soopnav::clock
