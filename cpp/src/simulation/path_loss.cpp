#include "soopnav/simulation/path_loss.hpp"

#include <cmath>

#include "simulation/require.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::simulation {
namespace {

void require_positive(std::string_view name, double value) {
  require(std::isfinite(value) && value > 0.0, name, value, "it must be finite and positive");
}

void require_finite(std::string_view name, double value) {
  require(std::isfinite(value), name, value, "it must be finite");
}

}  // namespace

double free_space_path_loss_db(double distance_m, double frequency_hz) {
  require_positive("distance_m", distance_m);
  require_positive("frequency_hz", frequency_hz);
  return 20.0 * (std::log10(distance_m) + std::log10(frequency_hz) + std::log10(4.0 * kPi / kSpeedOfLightMps));
}

double log_distance_path_loss_db(double distance_m, double exponent, double reference_distance_m,
                                 double reference_loss_db) {
  require_positive("distance_m", distance_m);
  require(std::isfinite(exponent) && exponent >= 0.0, "exponent", exponent, "it must be finite and not negative");
  require_positive("reference_distance_m", reference_distance_m);
  require_finite("reference_loss_db", reference_loss_db);
  return reference_loss_db + 10.0 * exponent * (std::log10(distance_m) - std::log10(reference_distance_m));
}

double shadowing_db(double sigma_db, RandomStream& random) {
  require(std::isfinite(sigma_db) && sigma_db >= 0.0, "sigma_db", sigma_db, "it must be finite and not negative");
  return sigma_db * random.normal();
}

double friis_received_power_dbm(double transmit_power_dbm, double transmit_gain_dbi, double receive_gain_dbi,
                                double distance_m, double frequency_hz) {
  require_finite("transmit_power_dbm", transmit_power_dbm);
  require_finite("transmit_gain_dbi", transmit_gain_dbi);
  require_finite("receive_gain_dbi", receive_gain_dbi);
  return transmit_power_dbm + transmit_gain_dbi + receive_gain_dbi - free_space_path_loss_db(distance_m, frequency_hz);
}

double thermal_noise_dbm(double bandwidth_hz, double noise_figure_db) {
  require_positive("bandwidth_hz", bandwidth_hz);
  require(std::isfinite(noise_figure_db) && noise_figure_db >= 0.0, "noise_figure_db", noise_figure_db,
          "it must be finite and not negative");
  const double density_mw = kBoltzmannJpk * kStandardNoiseTemperatureK * 1e3;
  return 10.0 * (std::log10(density_mw) + std::log10(bandwidth_hz)) + noise_figure_db;
}

}  // namespace soopnav::simulation
