#include "soopnav/geometry/sampled_orbit.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "soopnav/core/constants.hpp"

namespace soopnav::geometry {
namespace {

constexpr double kOmega = wgs84::kEarthRateRadps;
constexpr double kC = kSpeedOfLightMps;
constexpr int kMostTurns = 20;
constexpr double kDelayToleranceS = 3e-18;  // 1 nm; a step this short is rounding
constexpr double kTimeRounding = 1e-20;     // of a time [s/s]: its last digit by the delay's rate, 3e-5 of a satellite

// Turns coordinates of the ECEF axes into those `seconds` later (doc/orbits.md eq. 2).
Eigen::Vector3d turned(const Eigen::Vector3d& v, double c, double s) noexcept {
  return {c * v.x() + s * v.y(), -s * v.x() + c * v.y(), v.z()};
}

Eigen::Vector3d earth_rate_cross(const Eigen::Vector3d& v) noexcept { return {-kOmega * v.y(), kOmega * v.x(), 0.0}; }

// What the transmitter did at the instant of sending, in the axes of reception, and the acceleration there.
struct Sending {
  double delay_s;
  Eigen::Vector3d p, v, a;
};

bool solve(const SampledOrbit& orbit, double t_receive_s, const Eigen::Vector3d& p_e, double ahead_s,
           Sending& sending) noexcept {
  OrbitState state;
  if (orbit.is_fixed()) ahead_s = 0.0;
  const double received_s = orbit.is_fixed() ? 0.0 : t_receive_s - orbit.start_s();
  if (!std::isfinite(t_receive_s) || !std::isfinite(ahead_s)) return false;
  double delay_s = 0.0;
  for (int turn = 0; turn < kMostTurns; ++turn) {
    const double lag_s = delay_s - ahead_s;
    orbit.interpolate(received_s - lag_s, state, sending.a);
    const double c = std::cos(kOmega * lag_s);
    const double s = std::sin(kOmega * lag_s);
    sending.p = turned(state.p_e, c, s);
    const double next_s = (sending.p - p_e).norm() / kC;
    if (!std::isfinite(next_s)) return false;
    const double step_s = std::abs(next_s - delay_s);
    delay_s = next_s;
    if (step_s > kDelayToleranceS + 4e-16 * delay_s + kTimeRounding * std::abs(received_s)) continue;
    if (!orbit.is_fixed()) {
      const double sent_s = received_s - lag_s;
      if (!(sent_s >= 0.0 && sent_s <= orbit.end_s() - orbit.start_s())) return false;
    }
    sending.delay_s = delay_s;
    sending.v = turned(state.v_e, c, s);
    sending.a = turned(sending.a, c, s);
    return delay_s > 0.0;
  }
  return false;
}

}  // namespace

SampledOrbit::SampledOrbit(double start_s, double step_s, std::span<const double> p_e, std::span<const double> v_e)
    : start_s_(start_s), step_s_(step_s) {
  if (!std::isfinite(start_s)) {
    throw std::invalid_argument("start_s: " + std::to_string(start_s) + " is not finite");
  }
  if (!(step_s > 0.0) || !std::isfinite(step_s)) {
    throw std::invalid_argument("step_s: " + std::to_string(step_s) + ", a positive number expected");
  }
  if (p_e.size() % 3 != 0 || p_e.size() < 6) {
    throw std::invalid_argument("p_e: at least two rows of three numbers expected, got " + std::to_string(p_e.size()) +
                                " numbers");
  }
  if (v_e.size() != p_e.size()) {
    throw std::invalid_argument("v_e: " + std::to_string(p_e.size()) + " numbers expected, as in p_e, got " +
                                std::to_string(v_e.size()));
  }
  const auto check = [](const char* name, std::span<const double> values) {
    const auto bad = std::find_if(values.begin(), values.end(), [](double x) { return !std::isfinite(x); });
    if (bad == values.end()) return;
    throw std::invalid_argument(std::string(name) + ": row " + std::to_string((bad - values.begin()) / 3) +
                                " is not finite");
  };
  check("p_e", p_e);
  check("v_e", v_e);
  samples_.resize(p_e.size() / 3);
  for (std::size_t i = 0; i < samples_.size(); ++i) {
    samples_[i].p_e = {p_e[3 * i], p_e[3 * i + 1], p_e[3 * i + 2]};
    samples_[i].v_e = {v_e[3 * i], v_e[3 * i + 1], v_e[3 * i + 2]};
  }
}

SampledOrbit SampledOrbit::fixed(const Eigen::Vector3d& p_e) {
  if (!p_e.allFinite()) throw std::invalid_argument("p_e: three finite numbers expected");
  SampledOrbit orbit;
  orbit.start_s_ = -std::numeric_limits<double>::infinity();
  orbit.samples_.push_back({p_e, Eigen::Vector3d::Zero()});
  return orbit;
}

double SampledOrbit::end_s() const noexcept {
  if (is_fixed()) return std::numeric_limits<double>::infinity();
  return start_s_ + step_s_ * static_cast<double>(samples_.size() - 1);
}

bool SampledOrbit::at(double t_s, OrbitState& state) const noexcept {
  if (std::isnan(t_s) || t_s < start_s_ || t_s > end_s()) return false;
  Eigen::Vector3d unused;
  interpolate(is_fixed() ? 0.0 : t_s - start_s_, state, unused);
  return true;
}

void SampledOrbit::interpolate(double since_s, OrbitState& state, Eigen::Vector3d& acceleration_e) const noexcept {
  if (is_fixed()) {
    state = samples_[0];
    acceleration_e.setZero();
    return;
  }
  const double last = static_cast<double>(samples_.size() - 2);
  const double index = std::clamp(std::floor(since_s / step_s_), 0.0, last);
  if (std::isnan(index)) {
    state.p_e.setConstant(since_s);
    state.v_e.setConstant(since_s);
    acceleration_e.setConstant(since_s);
    return;
  }
  const auto i = static_cast<std::size_t>(index);
  const OrbitState& a = samples_[i];
  const OrbitState& b = samples_[i + 1];
  const double h = step_s_;
  const double u = (since_s - index * h) / h;
  // About the nearer sample: the polynomial's terms are then small beside the sample, and its rounding is too.
  const Eigen::Vector3d chord = (b.p_e - a.p_e) / h;
  const Eigen::Vector3d bend = a.v_e + b.v_e - 2.0 * chord;         // of u³, over h
  const Eigen::Vector3d curve = 3.0 * chord - 2.0 * a.v_e - b.v_e;  // of u², over h
  state.p_e = a.p_e + h * u * (a.v_e + u * (curve + u * bend));
  state.v_e = a.v_e + u * (2.0 * curve + 3.0 * u * bend);
  acceleration_e = (2.0 * curve + 6.0 * u * bend) / h;
}

bool signal_path(const SampledOrbit& orbit, double t_receive_s, const Eigen::Vector3d& p_e, const Eigen::Vector3d& v_e,
                 SignalPath& path, double ahead_s) noexcept {
  Sending sending;
  if (!p_e.allFinite() || !v_e.allFinite() || !solve(orbit, t_receive_s, p_e, ahead_s, sending)) return false;
  const Eigen::Vector3d line = sending.p - p_e;
  const double range_m = line.norm();
  if (!(range_m > 0.0)) return false;
  path.delay_s = sending.delay_s;
  path.source_p_e = sending.p;
  path.source_v_e = sending.v;
  path.range_m = range_m;
  path.direction_e = line / range_m;
  const Eigen::Vector3d& u = path.direction_e;
  path.delay_rate = u.dot(sending.v - v_e) / (kC + u.dot(sending.v + earth_rate_cross(sending.p)));  // eq. 5
  return true;
}

bool signal_path(const SampledOrbit& orbit, double t_receive_s, const Eigen::Vector3d& p_e, const Eigen::Vector3d& v_e,
                 SignalPath& path, PathGradient& gradient, double ahead_s) noexcept {
  Sending sending;
  if (!p_e.allFinite() || !v_e.allFinite() || !solve(orbit, t_receive_s, p_e, ahead_s, sending)) return false;
  const Eigen::Vector3d line = sending.p - p_e;
  const double range_m = line.norm();
  if (!(range_m > 0.0)) return false;
  path.delay_s = sending.delay_s;
  path.source_p_e = sending.p;
  path.source_v_e = sending.v;
  path.range_m = range_m;
  path.direction_e = line / range_m;
  const Eigen::Vector3d& u = path.direction_e;
  const Eigen::Vector3d inertial_v = sending.v + earth_rate_cross(sending.p);  // of the source, in space
  const Eigen::Vector3d relative_v = sending.v - v_e;
  const double slope = kC + u.dot(inertial_v);
  path.delay_rate = u.dot(relative_v) / slope;

  // Eq. 6. The source moves by inertial_v for each second that it is ahead, and back by it for each second of delay.
  const Eigen::Vector3d turn_v = sending.a + earth_rate_cross(sending.v);  // d source_v_e / d ahead
  const Eigen::Vector3d inertial_a = turn_v + earth_rate_cross(inertial_v);
  // d rate for a displacement of the line and so many seconds ahead.
  const auto rate_change = [&](const Eigen::Vector3d& line_change, double ahead) {
    const Eigen::Vector3d u_change = (line_change - u * u.dot(line_change)) / range_m;
    const double numerator = u_change.dot(relative_v) + ahead * u.dot(turn_v);
    const double denominator = u_change.dot(inertial_v) + ahead * u.dot(inertial_a);
    return (numerator - path.delay_rate * denominator) / slope;
  };
  gradient.delay_p = -u / slope;
  gradient.rate_v = -u / slope;
  for (int k = 0; k < 3; ++k) {
    const double ahead = -gradient.delay_p[k];
    gradient.rate_p[k] = rate_change(inertial_v * ahead - Eigen::Vector3d::Unit(k), ahead);
  }
  if (orbit.is_fixed()) {
    gradient.delay_ahead = 0.0;
    gradient.rate_ahead = 0.0;
  } else {
    gradient.delay_ahead = u.dot(inertial_v) / slope;
    const double ahead = 1.0 - gradient.delay_ahead;
    gradient.rate_ahead = rate_change(inertial_v * ahead, ahead);
  }
  return true;
}

bool look_at(const SampledOrbit& orbit, double t_s, const LocalFrame& from, Direction& seen) noexcept {
  SignalPath path;
  if (!signal_path(orbit, t_s, from.origin_ecef(), Eigen::Vector3d::Zero(), path)) return false;
  const auto direction = from.direction_to(path.source_p_e);
  if (!direction) return false;
  seen = *direction;
  return true;
}

}  // namespace soopnav::geometry
