#include "soopnav/gnss/atmosphere.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "soopnav/core/constants.hpp"

namespace soopnav::gnss {

void Klobuchar::check() const {
  for (const auto& coefficients : {alpha, beta}) {
    for (const double c : coefficients) {
      if (!std::isfinite(c)) throw std::invalid_argument("klobuchar: every coefficient must be finite");
    }
  }
}

double ionosphere_delay_m(const Klobuchar& k, const geometry::Geodetic& place, double azimuth_rad, double elevation_rad,
                          double time_of_week_s) noexcept {
  // IS-GPS-200N section 20.3.3.5.2.5, angles in semicircles.
  const double el = std::max(elevation_rad, 0.0) / kPi;
  const double psi = 0.0137 / (el + 0.11) - 0.022;
  const double phi = std::clamp(place.latitude_rad / kPi + psi * std::cos(azimuth_rad), -0.416, 0.416);
  const double lambda = place.longitude_rad / kPi + psi * std::sin(azimuth_rad) / std::cos(phi * kPi);
  const double magnetic = phi + 0.064 * std::cos((lambda - 1.617) * kPi);
  constexpr double kDayS = 86'400.0;
  double t = std::fmod(0.5 * kDayS * lambda + time_of_week_s, kDayS);
  if (t < 0.0) t += kDayS;
  const double slant = 1.0 + 16.0 * std::pow(0.53 - el, 3);
  const auto cubic = [magnetic](const std::array<double, 4>& c) {
    return c[0] + magnetic * (c[1] + magnetic * (c[2] + magnetic * c[3]));
  };
  const double amplitude = std::max(cubic(k.alpha), 0.0);
  const double period = std::max(cubic(k.beta), 72'000.0);
  const double x = kTwoPi * (t - 50'400.0) / period;
  constexpr double kNight = 5e-9;
  const double day = std::abs(x) < 1.57 ? amplitude * (1.0 - x * x / 2.0 + x * x * x * x / 24.0) : 0.0;
  return kSpeedOfLightMps * slant * (kNight + day);
}

double troposphere_delay_m(const geometry::Geodetic& place, double elevation_rad, double relative_humidity) noexcept {
  if (!(place.height_m < 40'000.0)) return 0.0;
  const double h = std::max(place.height_m, -1000.0);
  const double pressure = 1013.25 * std::pow(1.0 - 2.2557e-5 * h, 5.2568);
  const double kelvin = 288.15 - 6.5e-3 * h;
  const double vapour = 6.108 * relative_humidity * std::exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45));
  const double dry = 0.0022768 * pressure / (1.0 - 0.00266 * std::cos(2.0 * place.latitude_rad) - 0.28e-6 * h);
  const double wet = 0.0022768 * (1255.0 / kelvin + 0.05) * vapour;
  const double s = std::sin(std::max(elevation_rad, 0.0));
  return (dry + wet) * 1.001 / std::sqrt(0.002001 + s * s);
}

}  // namespace soopnav::gnss
