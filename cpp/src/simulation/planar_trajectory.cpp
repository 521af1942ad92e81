#include "soopnav/simulation/planar_trajectory.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>

#include "soopnav/core/constants.hpp"

namespace soopnav::simulation {
namespace {

void require_positive(double value, const char* name) {
  if (!(value > 0.0) || std::isinf(value)) {
    throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " must be positive and finite");
  }
}

void require_finite(bool finite, const char* name) {
  if (!finite) throw std::invalid_argument(std::string(name) + " must be finite");
}

Eigen::Vector2d turned(double heading_rad, const Eigen::Vector2d& b) {
  const double c = std::cos(heading_rad);
  const double s = std::sin(heading_rad);
  return {c * b[0] - s * b[1], s * b[0] + c * b[1]};
}

Eigen::Vector2d acceleration(const PlanarMotion& m) { return turned(m.heading_rad, m.specific_force_b_mps2); }

// Value and derivative of the cubic with values and slopes at both ends of [0, h].
template <class T>
std::pair<T, T> cubic(const T& y0, const T& d0, const T& y1, const T& d1, double h, double u) {
  const T rise = (y1 - y0) / h;
  const T bend = 3.0 * rise - 2.0 * d0 - d1;
  const T twist = d0 + d1 - 2.0 * rise;
  return {y0 + h * u * (d0 + u * (bend + u * twist)), d0 + u * (2.0 * bend + 3.0 * u * twist)};
}

// Quintic with values, slopes and curvatures at both ends of [0, h].
Eigen::Vector2d quintic(const PlanarMotion& m0, const PlanarMotion& m1, double h, double u) {
  const Eigen::Vector2d a0 = h * h * acceleration(m0);
  const Eigen::Vector2d a1 = h * h * acceleration(m1);
  const Eigen::Vector2d v0 = h * m0.velocity_mps;
  const Eigen::Vector2d left = (m1.position_m - m0.position_m) - v0 - 0.5 * a0;
  const Eigen::Vector2d slope = h * m1.velocity_mps - v0 - a0;
  const Eigen::Vector2d curve = a1 - a0;
  const Eigen::Vector2d c3 = 10.0 * left - 4.0 * slope + 0.5 * curve;
  const Eigen::Vector2d c4 = -15.0 * left + 7.0 * slope - curve;
  const Eigen::Vector2d c5 = 6.0 * left - 3.0 * slope + 0.5 * curve;
  return m0.position_m + u * (v0 + u * (0.5 * a0 + u * (c3 + u * (c4 + u * c5))));
}

std::size_t steps_of(double duration_s, double rate_hz) {
  const double steps = std::ceil(duration_s * rate_hz * (1.0 - 1e-12));
  if (!(steps <= 1e9)) throw std::invalid_argument("duration_s * rate_hz must be at most 1e9 points");
  return static_cast<std::size_t>(std::max(1.0, steps));
}

}  // namespace

PlanarTrajectory PlanarTrajectory::continuous_turn(const ContinuousTurn& turn, double rate_hz) {
  require_positive(rate_hz, "rate_hz");
  require_positive(turn.duration_s, "duration_s");
  require_positive(turn.ramp_s, "ramp_s");
  require_positive(turn.turn_period_s, "turn_period_s");
  require_finite(std::isfinite(turn.speed_mps), "speed_mps");
  require_finite(std::isfinite(turn.turn_rate_radps), "turn_rate_radps");
  require_finite(std::isfinite(turn.turn_amplitude_radps), "turn_amplitude_radps");
  require_finite(std::isfinite(turn.heading_rad), "heading_rad");
  require_finite(turn.position_m.allFinite(), "position_m");
  if (turn.ramp_s > turn.duration_s) {
    throw std::invalid_argument("ramp_s = " + std::to_string(turn.ramp_s) +
                                " must not be longer than duration_s = " + std::to_string(turn.duration_s));
  }
  const double w = kTwoPi / turn.turn_period_s;
  const auto motion = [&](double t) {
    const double u = std::min(1.0, t / turn.ramp_s);
    const double speed = turn.speed_mps * u * u * u * (10.0 + u * (-15.0 + 6.0 * u));
    PlanarMotion m;
    m.t_s = t;
    m.heading_rad = turn.heading_rad + turn.turn_rate_radps * t +
                    turn.turn_amplitude_radps / w * 2.0 * std::sin(0.5 * w * t) * std::sin(0.5 * w * t);
    m.yaw_rate_radps = turn.turn_rate_radps + turn.turn_amplitude_radps * std::sin(w * t);
    m.specific_force_b_mps2 = {30.0 * turn.speed_mps / turn.ramp_s * u * u * (1.0 - u) * (1.0 - u),
                               speed * m.yaw_rate_radps};
    m.velocity_mps = turned(m.heading_rad, {speed, 0.0});
    return m;
  };
  const std::size_t steps = steps_of(turn.duration_s, rate_hz);
  std::vector<PlanarMotion> points(steps + 1);
  points[0] = motion(0.0);
  points[0].position_m = turn.position_m;
  for (std::size_t k = 1; k <= steps; ++k) {
    const double from = points[k - 1].t_s;
    points[k] = motion(static_cast<double>(k) / rate_hz);
    // Gauss and Legendre's three points: exact to the fifth power of the step.
    const double h = points[k].t_s - from;
    const double aside = 0.5 * h * std::sqrt(0.6);
    const double middle = from + 0.5 * h;
    points[k].position_m =
        points[k - 1].position_m + h / 18.0 *
                                       (5.0 * motion(middle - aside).velocity_mps + 8.0 * motion(middle).velocity_mps +
                                        5.0 * motion(middle + aside).velocity_mps);
  }
  return {std::move(points), rate_hz};
}

PlanarTrajectory PlanarTrajectory::from_profiles(std::span<const double> yaw_rate_radps,
                                                 std::span<const Eigen::Vector2d> force_b_mps2, double rate_hz,
                                                 const PlanarStart& start) {
  require_positive(rate_hz, "rate_hz");
  const std::size_t n = yaw_rate_radps.size();
  if (n < 2) throw std::invalid_argument("yaw_rate_radps: at least 2 samples expected, got " + std::to_string(n));
  if (force_b_mps2.size() != n) {
    throw std::invalid_argument("specific_force_b_mps2: " + std::to_string(n) + " samples expected, got " +
                                std::to_string(force_b_mps2.size()));
  }
  require_finite(std::isfinite(start.heading_rad), "heading_rad");
  require_finite(start.velocity_mps.allFinite(), "velocity_mps");
  require_finite(start.position_m.allFinite(), "position_m");
  const double half = 0.5 / rate_hz;
  std::vector<PlanarMotion> points(n);
  for (std::size_t k = 0; k < n; ++k) {
    PlanarMotion& m = points[k];
    if (!std::isfinite(yaw_rate_radps[k]) || !force_b_mps2[k].allFinite()) {
      const bool rate = !std::isfinite(yaw_rate_radps[k]);
      throw std::invalid_argument(std::string(rate ? "yaw_rate_radps[" : "specific_force_b_mps2[") + std::to_string(k) +
                                  "] must be finite");
    }
    m.t_s = static_cast<double>(k) / rate_hz;
    m.yaw_rate_radps = yaw_rate_radps[k];
    m.specific_force_b_mps2 = force_b_mps2[k];
    if (k == 0) {
      m.heading_rad = start.heading_rad;
      m.velocity_mps = start.velocity_mps;
      m.position_m = start.position_m;
      continue;
    }
    const PlanarMotion& before = points[k - 1];
    m.heading_rad = before.heading_rad + half * (before.yaw_rate_radps + m.yaw_rate_radps);
    m.velocity_mps = before.velocity_mps + half * (acceleration(before) + acceleration(m));
    m.position_m = before.position_m + half * (before.velocity_mps + m.velocity_mps);
  }
  return {std::move(points), rate_hz};
}

std::optional<PlanarMotion> PlanarTrajectory::at(double t_s) const noexcept {
  if (!(t_s >= 0.0 && t_s <= duration_s())) return std::nullopt;
  const std::size_t last = points_.size() - 2;
  auto i = std::min(last, static_cast<std::size_t>(t_s * rate_hz_));
  if (i < last && points_[i + 1].t_s <= t_s) ++i;
  if (i > 0 && points_[i].t_s > t_s) --i;
  const PlanarMotion& m0 = points_[i];
  const PlanarMotion& m1 = points_[i + 1];
  if (t_s == m0.t_s) return m0;
  if (t_s == m1.t_s) return m1;
  const double h = m1.t_s - m0.t_s;
  const double u = (t_s - m0.t_s) / h;
  PlanarMotion m;
  m.t_s = t_s;
  std::tie(m.heading_rad, m.yaw_rate_radps) =
      cubic(m0.heading_rad, m0.yaw_rate_radps, m1.heading_rad, m1.yaw_rate_radps, h, u);
  const auto [velocity, rate] =
      cubic<Eigen::Vector2d>(m0.velocity_mps, acceleration(m0), m1.velocity_mps, acceleration(m1), h, u);
  m.velocity_mps = velocity;
  m.specific_force_b_mps2 = turned(-m.heading_rad, rate);
  m.position_m = quintic(m0, m1, h, u);
  return m;
}

std::vector<PlanarImuReading> planar_imu(const PlanarTrajectory& trajectory, double rate_hz,
                                         const inertial::ImuErrorModel& errors, const RandomStream& random,
                                         PlanarSampling sampling) {
  require_positive(rate_hz, "rate_hz");
  const double intervals = std::floor(trajectory.duration_s() * rate_hz * (1.0 + 1e-12));
  if (!(intervals >= 1.0)) {
    throw std::invalid_argument("rate_hz = " + std::to_string(rate_hz) + ": no whole interval in " +
                                std::to_string(trajectory.duration_s()) + " s");
  }
  inertial::PlanarImuErrors unit(errors, random);
  std::vector<PlanarImuReading> out(static_cast<std::size_t>(intervals));
  PlanarMotion from = trajectory.points().front();
  for (std::size_t k = 0; k < out.size(); ++k) {
    PlanarImuReading& reading = out[k];
    reading.t_s = static_cast<double>(k + 1) / rate_hz;
    const double end = std::min(reading.t_s, trajectory.duration_s());
    const double dt = end - from.t_s;
    const PlanarMotion to = trajectory.at(end).value_or(from);
    if (sampling == PlanarSampling::kMean) {
      reading.sample.yaw_rate_radps = (to.heading_rad - from.heading_rad) / dt;
      reading.sample.specific_force_b_mps2 = turned(-from.heading_rad, (to.velocity_mps - from.velocity_mps) / dt);
    } else {
      const PlanarMotion here =
          sampling == PlanarSampling::kLeft ? from : trajectory.at(0.5 * (from.t_s + end)).value_or(from);
      reading.sample = {here.yaw_rate_radps, here.specific_force_b_mps2};
    }
    reading.status = unit.apply(reading.sample, 1.0 / rate_hz);
    from = to;
  }
  return out;
}

}  // namespace soopnav::simulation
