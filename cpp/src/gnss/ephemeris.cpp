#include "soopnav/gnss/ephemeris.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "soopnav/core/constants.hpp"

namespace soopnav::gnss {
namespace {

// F of IS-GPS-200N section 20.3.3.3.3.1 [s/√m].
constexpr double kRelativity = -4.442807633e-10;

[[noreturn]] void refuse(const std::string& name, double value, const char* rule) {
  throw std::invalid_argument(name + " = " + std::to_string(value) + " " + rule);
}

double eccentric_anomaly(double mean, double e) noexcept {
  double E = mean + e * std::sin(mean);
  for (int i = 0; i < 30; ++i) {
    const double step = (mean - E + e * std::sin(E)) / (1.0 - e * std::cos(E));
    E += step;
    if (std::abs(step) < 1e-15) break;
  }
  return E;
}

struct ByPrn {
  bool operator()(const Ephemeris& a, int prn) const noexcept { return a.prn < prn; }
  bool operator()(int prn, const Ephemeris& a) const noexcept { return prn < a.prn; }
};

}  // namespace

Epoch gps_epoch(std::int64_t week, double time_of_week_s) noexcept {
  return {TimeScale::kGps, week * static_cast<std::int64_t>(kWeekS), time_of_week_s};
}

std::optional<std::pair<std::int64_t, double>> week_and_second(const Epoch& epoch) noexcept {
  if (epoch.scale() != TimeScale::kGps || !epoch.is_valid()) return std::nullopt;
  constexpr auto kWeek = static_cast<std::int64_t>(kWeekS);
  std::int64_t week = epoch.seconds() / kWeek;
  std::int64_t second = epoch.seconds() % kWeek;
  if (second < 0) {
    second += kWeek;
    --week;
  }
  return std::pair{week, static_cast<double>(second) + epoch.fraction_s()};
}

void Ephemeris::check() const {
  const std::string of = "ephemeris of satellite " + std::to_string(prn) + ": ";
  if (prn <= 0) refuse(of + "prn", prn, "must be positive");
  if (!(sqrt_a > 2500.0) || !(sqrt_a < 1e5)) refuse(of + "sqrt_a", sqrt_a, "must be above 2500 and below 1e5");
  if (!(eccentricity >= 0.0) || !(eccentricity < 1.0)) refuse(of + "eccentricity", eccentricity, "must be in [0, 1)");
  if (!(fit_interval_s > 0.0)) refuse(of + "fit_interval_s", fit_interval_s, "must be positive");
  for (const double x :
       {toe_s,     toc_s,      af0_s,           af1,           af2_ps,      tgd_s,   m0_rad,  delta_n_radps,
        omega_rad, omega0_rad, omega_dot_radps, i0_rad,        i_dot_radps, cuc_rad, cus_rad, crc_m,
        crs_m,     cic_rad,    cis_rad,         fit_interval_s}) {
    if (!std::isfinite(x)) throw std::invalid_argument(of + "every number must be finite");
  }
}

std::optional<SatelliteState> satellite_state(const Ephemeris& eph, const Epoch& t) noexcept {
  const auto since_toe = t - eph.toe();
  if (!since_toe) return std::nullopt;
  const double tk = *since_toe;
  const double tc = tk + (eph.toe_s - eph.toc_s);

  const double a = eph.sqrt_a * eph.sqrt_a;
  const double n = std::sqrt(kGravitationalParameterM3ps2 / (a * a * a)) + eph.delta_n_radps;
  const double e = eph.eccentricity;
  const double E = eccentric_anomaly(eph.m0_rad + n * tk, e);
  const double sin_E = std::sin(E);
  const double cos_E = std::cos(E);
  const double E_dot = n / (1.0 - e * cos_E);

  const double root = std::sqrt(1.0 - e * e);
  const double phi = std::atan2(root * sin_E, cos_E - e) + eph.omega_rad;
  const double phi_dot = root * E_dot / (1.0 - e * cos_E);
  const double s2 = std::sin(2.0 * phi);
  const double c2 = std::cos(2.0 * phi);
  const double u = phi + eph.cus_rad * s2 + eph.cuc_rad * c2;
  const double u_dot = phi_dot * (1.0 + 2.0 * (eph.cus_rad * c2 - eph.cuc_rad * s2));
  const double r = a * (1.0 - e * cos_E) + eph.crs_m * s2 + eph.crc_m * c2;
  const double r_dot = a * e * sin_E * E_dot + 2.0 * phi_dot * (eph.crs_m * c2 - eph.crc_m * s2);
  const double i = eph.i0_rad + eph.i_dot_radps * tk + eph.cis_rad * s2 + eph.cic_rad * c2;
  const double i_dot = eph.i_dot_radps + 2.0 * phi_dot * (eph.cis_rad * c2 - eph.cic_rad * s2);

  const double x = r * std::cos(u);
  const double y = r * std::sin(u);
  const double x_dot = r_dot * std::cos(u) - y * u_dot;
  const double y_dot = r_dot * std::sin(u) + x * u_dot;
  const double node_dot = eph.omega_dot_radps - kEarthRateRadps;
  const double node = eph.omega0_rad + node_dot * tk - kEarthRateRadps * eph.toe_s;
  const double sin_n = std::sin(node);
  const double cos_n = std::cos(node);
  const double sin_i = std::sin(i);
  const double cos_i = std::cos(i);

  SatelliteState out;
  out.position_e = {x * cos_n - y * cos_i * sin_n, x * sin_n + y * cos_i * cos_n, y * sin_i};
  const double in_plane = y_dot * cos_i - y * sin_i * i_dot;
  out.velocity_e = {x_dot * cos_n - in_plane * sin_n - out.position_e[1] * node_dot,
                    x_dot * sin_n + in_plane * cos_n + out.position_e[0] * node_dot, y_dot * sin_i + y * cos_i * i_dot};
  const double relativity = kRelativity * e * eph.sqrt_a;
  out.clock_s = eph.af0_s + eph.af1 * tc + eph.af2_ps * tc * tc + relativity * sin_E - eph.tgd_s;
  out.clock_rate = eph.af1 + 2.0 * eph.af2_ps * tc + relativity * cos_E * E_dot;
  return out;
}

Eigen::Vector3d rotated_for_flight(const Eigen::Vector3d& p_e, double flight_time_s) noexcept {
  const double s = std::sin(kEarthRateRadps * flight_time_s);
  const double c = std::cos(kEarthRateRadps * flight_time_s);
  return {c * p_e[0] + s * p_e[1], -s * p_e[0] + c * p_e[1], p_e[2]};
}

std::optional<Sight> sight(const Ephemeris& eph, const Epoch& t, const Eigen::Vector3d& receiver_p_e,
                           const Eigen::Vector3d& receiver_v_e) noexcept {
  double flight_s = 0.075;
  for (int i = 0; i < 12; ++i) {
    const auto state = satellite_state(eph, t - flight_s);
    if (!state) return std::nullopt;
    Sight out;
    out.at_transmission = *state;
    out.position_e = rotated_for_flight(state->position_e, flight_s);
    const Eigen::Vector3d line = out.position_e - receiver_p_e;
    out.range_m = line.norm();
    if (!(out.range_m > 1.0) || !(out.range_m < 1e12)) return std::nullopt;
    const double next = out.range_m / kSpeedOfLightMps;
    if (std::abs(next - flight_s) < 1e-13) {
      out.velocity_e = rotated_for_flight(state->velocity_e, flight_s);
      out.direction_e = line / out.range_m;
      const Eigen::Vector3d turned(kEarthRateRadps * out.position_e[1], -kEarthRateRadps * out.position_e[0], 0.0);
      out.range_rate_mps = out.direction_e.dot(out.velocity_e - receiver_v_e) /
                           (1.0 + out.direction_e.dot(out.velocity_e - turned) / kSpeedOfLightMps);
      return out;
    }
    flight_s = next;
  }
  return std::nullopt;
}

std::optional<SatelliteState> state_at_transmission(const Ephemeris& eph, const Epoch& receive_clock,
                                                    double pseudorange_m) noexcept {
  const double since = pseudorange_m / kSpeedOfLightMps;
  if (!std::isfinite(since)) return std::nullopt;
  // The clock's own offset moves its reading by less than 1e-12 s for each microsecond; two rounds settle it.
  auto state = satellite_state(eph, receive_clock - since);
  for (int i = 0; i < 2 && state; ++i) state = satellite_state(eph, receive_clock - (since + state->clock_s));
  return state;
}

EphemerisTable::EphemerisTable(std::vector<Ephemeris> ephemerides) : all_(std::move(ephemerides)) {
  for (const Ephemeris& eph : all_) eph.check();
  std::stable_sort(all_.begin(), all_.end(), [](const Ephemeris& a, const Ephemeris& b) {
    if (a.prn != b.prn) return a.prn < b.prn;
    return (a.toe() <=> b.toe()) == std::partial_ordering::less;
  });
}

std::span<const Ephemeris> EphemerisTable::of(int prn) const noexcept {
  const auto [first, last] = std::equal_range(all_.begin(), all_.end(), prn, ByPrn{});
  return {first, last};
}

const Ephemeris* EphemerisTable::find(int prn, const Epoch& t, double max_age_s) const noexcept {
  const Ephemeris* best = nullptr;
  double best_age = 0.0;
  for (const Ephemeris& eph : of(prn)) {
    const auto since = t - eph.toe();
    if (!since) return nullptr;
    const double age = std::abs(*since);
    if (age > (max_age_s > 0.0 ? max_age_s : 0.5 * eph.fit_interval_s)) continue;
    if (best == nullptr || age < best_age) {
      best = &eph;
      best_age = age;
    }
  }
  return best;
}

bool EphemerisTable::has(int prn) const noexcept { return !of(prn).empty(); }

std::vector<int> EphemerisTable::prns() const {
  std::vector<int> out;
  for (const Ephemeris& eph : all_) {
    if (out.empty() || out.back() != eph.prn) out.push_back(eph.prn);
  }
  return out;
}

void WalkerOptions::check() const {
  if (planes <= 0) refuse("planes", planes, "must be positive");
  if (satellites <= 0 || satellites > 64 || satellites % planes != 0) {
    refuse("satellites", satellites, "must be a multiple of planes, 1 to 64");
  }
  if (phasing < 0 || phasing >= planes) refuse("phasing", phasing, "must be in [0, planes)");
  if (!(inclination_rad >= 0.0) || !(inclination_rad <= kPi)) {
    refuse("inclination_rad", inclination_rad, "must be in [0, pi]");
  }
  if (!(radius_m > 6.4e6) || !(radius_m < 1e9)) refuse("radius_m", radius_m, "must be above 6.4e6 and below 1e9");
  if (!std::isfinite(toe_s)) refuse("toe_s", toe_s, "must be finite");
  if (!std::isfinite(first_node_rad)) refuse("first_node_rad", first_node_rad, "must be finite");
  if (!(fit_interval_s > 0.0)) refuse("fit_interval_s", fit_interval_s, "must be positive");
}

std::vector<Ephemeris> walker_constellation(const WalkerOptions& options) {
  options.check();
  std::vector<Ephemeris> out;
  const int per_plane = options.satellites / options.planes;
  for (int plane = 0; plane < options.planes; ++plane) {
    for (int k = 0; k < per_plane; ++k) {
      Ephemeris eph;
      eph.prn = plane * per_plane + k + 1;
      eph.week = options.week;
      eph.toe_s = options.toe_s;
      eph.toc_s = options.toe_s;
      eph.sqrt_a = std::sqrt(options.radius_m);
      eph.i0_rad = options.inclination_rad;
      // The broadcast node counts from the start of the week; the Earth has turned since.
      eph.omega0_rad = options.first_node_rad + kTwoPi * plane / options.planes + kEarthRateRadps * options.toe_s;
      eph.m0_rad = kTwoPi * (static_cast<double>(k) / per_plane +
                             static_cast<double>(options.phasing * plane) / options.satellites);
      eph.fit_interval_s = options.fit_interval_s;
      out.push_back(eph);
    }
  }
  return out;
}

}  // namespace soopnav::gnss
