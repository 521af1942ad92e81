#include "soopnav/geometry/orbit.hpp"

#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>

#include "soopnav/core/constants.hpp"

namespace soopnav::geometry {
namespace {

constexpr double kDayS = 86400.0;
constexpr double kCenturyDays = 36525.0;
constexpr double kJ2000 = 2451545.0;
constexpr double kMostSamples = 1e8;

Eigen::Vector3d about_z(const Eigen::Vector3d& v, double angle_rad) noexcept {
  const double c = std::cos(angle_rad);
  const double s = std::sin(angle_rad);
  return {c * v.x() + s * v.y(), c * v.y() - s * v.x(), v.z()};
}

double wrapped(double angle_rad) noexcept {
  const double turn = std::fmod(angle_rad, kTwoPi);
  return turn < 0.0 ? turn + kTwoPi : turn;
}

void need_finite(const char* name, double value) {
  if (!std::isfinite(value)) throw std::invalid_argument(std::string(name) + ": a finite number expected");
}

// Eccentric anomaly of a mean one (doc/orbits.md eq. 11): Newton from a start that converges for every e < 1.
double eccentric_anomaly(double mean_rad, double e) noexcept {
  const double mean = std::remainder(mean_rad, kTwoPi);
  double anomaly = e < 0.8 ? mean + e * std::sin(mean) : std::copysign(kPi, mean);
  for (int i = 0; i < 50; ++i) {
    const double step = (anomaly - e * std::sin(anomaly) - mean) / (1.0 - e * std::cos(anomaly));
    anomaly -= step;
    if (!(std::abs(step) > 1e-15)) break;
  }
  return anomaly;
}

WalkerConstellation walker(int total, int planes, int phasing, double inclination_rad, double altitude_m,
                           double span_rad) {
  if (planes < 1 || total < 1 || total % planes != 0) {
    throw std::invalid_argument("total, planes: " + std::to_string(total) + " satellites do not fill " +
                                std::to_string(planes) + " planes evenly");
  }
  WalkerConstellation made;
  made.planes = planes;
  made.per_plane = total / planes;
  made.altitude_m = altitude_m;
  made.inclination_rad = inclination_rad;
  made.plane_spacing_rad = span_rad / planes;
  made.phase_step_rad = kTwoPi * phasing / total;
  return made;
}

}  // namespace

double gmst82_rad(double jd_ut1, double fraction) noexcept {
  // Whole days drop out of the turn: 876600 hours a century are one turn a day.
  const double days = (jd_ut1 - kJ2000) + fraction;
  const double T = days / kCenturyDays;
  const double turns = std::remainder(jd_ut1 - kJ2000, 1.0) + std::remainder(fraction, 1.0);
  const double rest_s = 67310.54841 + T * (8640184.812866 + T * (0.093104 - 6.2e-6 * T));
  return wrapped(kTwoPi * (turns + rest_s / kDayS));
}

OrbitState teme_to_ecef(double jd_ut1, double fraction, const Eigen::Vector3d& p_teme,
                        const Eigen::Vector3d& v_teme) noexcept {
  const double gmst = gmst82_rad(jd_ut1, fraction);
  OrbitState state;
  state.p_e = about_z(p_teme, gmst);
  state.v_e = about_z(v_teme, gmst);
  state.v_e.x() += kSiderealRateRadps * state.p_e.y();
  state.v_e.y() -= kSiderealRateRadps * state.p_e.x();
  return state;
}

J2Orbit::J2Orbit(const MeanElements& elements, double epoch_s, double gmst_rad, double j2)
    : elements_(elements), epoch_s_(epoch_s), gmst_rad_(gmst_rad) {
  need_finite("epoch_s", epoch_s);
  need_finite("gmst_rad", gmst_rad);
  need_finite("j2", j2);
  need_finite("inclination_rad", elements.inclination_rad);
  need_finite("node_rad", elements.node_rad);
  need_finite("perigee_rad", elements.perigee_rad);
  need_finite("mean_anomaly_rad", elements.mean_anomaly_rad);
  const double a = elements.semi_major_axis_m;
  const double e = elements.eccentricity;
  if (!(e >= 0.0 && e < 1.0)) {
    throw std::invalid_argument("eccentricity: " + std::to_string(e) + ", at least 0 and below 1 expected");
  }
  if (!(a * (1.0 - e) >= wgs84::kSemiMajorAxisM) || !std::isfinite(a)) {
    throw std::invalid_argument("semi_major_axis_m: " + std::to_string(a) + " puts the perigee below the ground");
  }
  const double ratio = wgs84::kSemiMajorAxisM / (a * (1.0 - e * e));
  const double k = 1.5 * j2 * ratio * ratio;
  const double n = std::sqrt(wgs84::kGravitationalParameterM3ps2 / (a * a * a));
  const double s2 = std::sin(elements.inclination_rad) * std::sin(elements.inclination_rad);
  node_rate_ = -k * n * std::cos(elements.inclination_rad);
  perigee_rate_ = k * n * (2.0 - 2.5 * s2);
  anomaly_rate_ = n * (1.0 + k * std::sqrt(1.0 - e * e) * (1.0 - 1.5 * s2));
}

OrbitState J2Orbit::at(double t_s) const noexcept {
  const double since_s = t_s - epoch_s_;
  const double e = elements_.eccentricity;
  const double a = elements_.semi_major_axis_m;
  const double E = eccentric_anomaly(elements_.mean_anomaly_rad + anomaly_rate_ * since_s, e);
  const double root = std::sqrt(1.0 - e * e);
  const double ce = std::cos(E);
  const double se = std::sin(E);
  const double E_rate = anomaly_rate_ / (1.0 - e * ce);
  // In the orbit's plane, x to the perigee; the perigee's own drift turns it.
  const double x = a * (ce - e);
  const double y = a * root * se;
  const double vx = -a * se * E_rate - perigee_rate_ * y;
  const double vy = a * root * ce * E_rate + perigee_rate_ * x;
  const double perigee = elements_.perigee_rad + perigee_rate_ * since_s;
  const double cw = std::cos(perigee);
  const double sw = std::sin(perigee);
  const double ci = std::cos(elements_.inclination_rad);
  const double si = std::sin(elements_.inclination_rad);
  const Eigen::Vector2d p(cw * x - sw * y, sw * x + cw * y);
  const Eigen::Vector2d v(cw * vx - sw * vy, sw * vx + cw * vy);
  // The node as the turning Earth sees it.
  const double longitude_rate = node_rate_ - wgs84::kEarthRateRadps;
  const double longitude = std::remainder(elements_.node_rad - gmst_rad_ + longitude_rate * since_s, kTwoPi);
  OrbitState state;
  state.p_e = about_z({p.x(), ci * p.y(), si * p.y()}, -longitude);
  state.v_e = about_z({v.x(), ci * v.y(), si * v.y()}, -longitude);
  state.v_e.x() -= longitude_rate * state.p_e.y();
  state.v_e.y() += longitude_rate * state.p_e.x();
  return state;
}

SampledOrbit J2Orbit::sampled(double start_s, double duration_s, double step_s) const {
  need_finite("start_s", start_s);
  if (!(duration_s > 0.0) || !std::isfinite(duration_s)) {
    throw std::invalid_argument("duration_s: " + std::to_string(duration_s) + ", a positive number expected");
  }
  if (!(step_s > 0.0) || !std::isfinite(step_s)) {
    throw std::invalid_argument("step_s: " + std::to_string(step_s) + ", a positive number expected");
  }
  const double count = std::ceil(duration_s / step_s * (1.0 - 1e-12)) + 1.0;
  if (!(count <= kMostSamples)) {
    throw std::invalid_argument("duration_s, step_s: at most 1e8 samples expected, not " + std::to_string(count));
  }
  const auto n = static_cast<std::size_t>(count);
  std::vector<double> p(3 * n);
  std::vector<double> v(3 * n);
  for (std::size_t i = 0; i < n; ++i) {
    const OrbitState state = at(start_s + step_s * static_cast<double>(i));
    for (std::size_t k = 0; k < 3; ++k) {
      p[3 * i + k] = state.p_e[static_cast<Eigen::Index>(k)];
      v[3 * i + k] = state.v_e[static_cast<Eigen::Index>(k)];
    }
  }
  return {start_s, step_s, p, v};
}

WalkerConstellation WalkerConstellation::delta(int total, int planes, int phasing, double inclination_rad,
                                               double altitude_m) {
  return walker(total, planes, phasing, inclination_rad, altitude_m, kTwoPi);
}

WalkerConstellation WalkerConstellation::star(int total, int planes, int phasing, double inclination_rad,
                                              double altitude_m) {
  return walker(total, planes, phasing, inclination_rad, altitude_m, kPi);
}

WalkerConstellation WalkerConstellation::iridium() {
  constexpr double kDegree = kPi / 180.0;
  WalkerConstellation made;
  made.inclination_rad = 86.4 * kDegree;
  made.plane_spacing_rad = 31.6 * kDegree;
  made.phase_step_rad = 15.1 * kDegree;
  return made;
}

std::vector<J2Orbit> WalkerConstellation::orbits(double epoch_s, double gmst_rad) const {
  if (planes < 1 || per_plane < 1 || planes > 10000 || per_plane > 10000) {
    throw std::invalid_argument("planes, per_plane: 1 ... 10000 expected, got " + std::to_string(planes) + " and " +
                                std::to_string(per_plane));
  }
  std::vector<J2Orbit> made;
  made.reserve(static_cast<std::size_t>(planes) * static_cast<std::size_t>(per_plane));
  for (int plane = 0; plane < planes; ++plane) {
    for (int s = 0; s < per_plane; ++s) {
      MeanElements elements;
      elements.semi_major_axis_m = wgs84::kSemiMajorAxisM + altitude_m;
      elements.inclination_rad = inclination_rad;
      elements.node_rad = first_node_rad + plane * plane_spacing_rad;
      elements.mean_anomaly_rad = first_phase_rad + plane * phase_step_rad + s * kTwoPi / per_plane;
      made.emplace_back(elements, epoch_s, gmst_rad);
    }
  }
  return made;
}

}  // namespace soopnav::geometry
