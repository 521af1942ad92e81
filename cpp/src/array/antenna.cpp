#include "soopnav/array/antenna.hpp"

#include <algorithm>
#include <cmath>

#include "array/require.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::array {

namespace {

constexpr double kMuchGreater = 10.0;

void require_positive(const char* name, double value) {
  require(std::isfinite(value) && value > 0.0, name, value, "a positive finite number expected");
}

void require_share(const char* name, double value) {
  require(value >= 0.0 && value <= 1.0, name, value, "0 to 1 expected");
}

}  // namespace

double polarization_factor(const Polarization& a, const Polarization& b) noexcept {
  const double cosine =
      std::sin(2.0 * a.ellipticity_rad) * std::sin(2.0 * b.ellipticity_rad) +
      std::cos(2.0 * a.ellipticity_rad) * std::cos(2.0 * b.ellipticity_rad) * std::cos(2.0 * (a.tilt_rad - b.tilt_rad));
  return 0.5 * (1.0 + cosine);
}

double impedance_factor(Cf64 antenna_ohm, Cf64 load_ohm) {
  for (const Cf64& z : {antenna_ohm, load_ohm}) {
    require(std::isfinite(z.real()) && std::isfinite(z.imag()) && z.real() >= 0.0, "impedance", z,
            "a finite impedance with a resistance >= 0 expected");
  }
  require(antenna_ohm.real() + load_ohm.real() > 0.0, "impedance", load_ohm, "one resistance must be positive");
  return 4.0 * antenna_ohm.real() * load_ohm.real() / std::norm(antenna_ohm + load_ohm);
}

double received_power_dbm(double transmit_power_dbm, double transmit_gain_db, double receive_gain_db, double distance_m,
                          double frequency_hz, double polarization, double impedance) {
  require_positive("distance_m", distance_m);
  require_positive("frequency_hz", frequency_hz);
  require_share("polarization", polarization);
  require_share("impedance", impedance);
  const double spreading = kSpeedOfLightMps / (2.0 * kTwoPi * distance_m * frequency_hz);
  return transmit_power_dbm + transmit_gain_db + receive_gain_db + 20.0 * std::log10(spreading) +
         10.0 * std::log10(polarization * impedance);
}

double FarField::limit_m() const noexcept { return std::max({radiating_m, phase_m, amplitude_m}); }

FieldRegion FarField::region(double distance_m) const noexcept {
  if (!(distance_m > limit_m())) return FieldRegion::kNear;
  return distance_m >= kMuchGreater * std::max(radiating_m, amplitude_m) ? FieldRegion::kFar : FieldRegion::kMarginal;
}

FarField far_field(double aperture_m, double wavelength_m) {
  require_positive("aperture_m", aperture_m);
  require_positive("wavelength_m", wavelength_m);
  return {1.6 * wavelength_m, 2.0 * aperture_m * aperture_m / wavelength_m, 5.0 * aperture_m};
}

}  // namespace soopnav::array
