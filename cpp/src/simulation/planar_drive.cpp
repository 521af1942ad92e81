#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "soopnav/core/angle.hpp"
#include "soopnav/simulation/planar_trajectory.hpp"

// A drive through waypoints: the way (a spline), the speed along it, and both together on a grid of time.
namespace soopnav::simulation {
namespace {

constexpr std::size_t kCells = 256;  // of a piece of the spline

// The way's place and its first two derivatives with respect to its parameter.
struct Place {
  Eigen::Vector2d p;
  Eigen::Vector2d d;
  Eigen::Vector2d dd;

  [[nodiscard]] double curvature() const { return (d[0] * dd[1] - d[1] * dd[0]) / std::pow(d.squaredNorm(), 1.5); }
};

// Natural cubic spline over the waypoints' distances (doc/clocks.md eq. 20).
class Way {
 public:
  explicit Way(std::span<const Eigen::Vector2d> points) : points_(points.begin(), points.end()), knots_(1, 0.0) {
    const std::size_t n = points_.size();
    for (std::size_t i = 1; i < n; ++i) knots_.push_back(knots_.back() + (points_[i] - points_[i - 1]).norm());
    // Second derivatives: tridiagonal, eliminated from the front.
    second_.assign(n, Eigen::Vector2d::Zero());
    std::vector<double> diagonal(n, 1.0);
    for (std::size_t i = 1; i + 1 < n; ++i) {
      const double before = knots_[i] - knots_[i - 1];
      const double after = knots_[i + 1] - knots_[i];
      const double factor = i == 1 ? 0.0 : before / diagonal[i - 1];
      diagonal[i] = 2.0 * (before + after) - factor * before;
      second_[i] = 6.0 * ((points_[i + 1] - points_[i]) / after - (points_[i] - points_[i - 1]) / before) -
                   factor * second_[i - 1];
    }
    for (std::size_t i = n - 2; i > 0; --i) {
      second_[i] = (second_[i] - (knots_[i + 1] - knots_[i]) * (i + 2 < n ? second_[i + 1] : Eigen::Vector2d::Zero())) /
                   diagonal[i];
    }
  }

  [[nodiscard]] double end() const { return knots_.back(); }
  [[nodiscard]] std::size_t pieces() const { return knots_.size() - 1; }
  [[nodiscard]] double knot(std::size_t i) const { return knots_[i]; }

  [[nodiscard]] Place at(double u) const {
    const auto above = std::upper_bound(knots_.begin() + 1, knots_.end() - 1, u);
    const auto i = static_cast<std::size_t>(above - knots_.begin()) - 1;
    const double h = knots_[i + 1] - knots_[i];
    const double b = (u - knots_[i]) / h;
    const double a = 1.0 - b;
    const Eigen::Vector2d& m0 = second_[i];
    const Eigen::Vector2d& m1 = second_[i + 1];
    return {a * points_[i] + b * points_[i + 1] + h * h / 6.0 * ((a * a * a - a) * m0 + (b * b * b - b) * m1),
            (points_[i + 1] - points_[i]) / h + h / 6.0 * ((1.0 - 3.0 * a * a) * m0 + (3.0 * b * b - 1.0) * m1),
            a * m0 + b * m1};
  }

 private:
  std::vector<Eigen::Vector2d> points_;
  std::vector<double> knots_;
  std::vector<Eigen::Vector2d> second_;
};

// Speeds every 1 / rate_hz from rest to rest whose trapezoids cover the way (doc/clocks.md eq. 21).
class SpeedProfile {
 public:
  SpeedProfile(const Way& way, const DriveLimits& limits) : limits_(limits) {
    const std::size_t n = way.pieces() * kCells;
    length_.assign(n + 1, 0.0);
    curvature_.assign(n + 1, 0.0);
    for (std::size_t i = 0; i <= n; ++i) {
      const std::size_t piece = i == 0 ? 0 : (i - 1) / kCells;  // that the cell before belongs to
      const double along = static_cast<double>(i - piece * kCells) / static_cast<double>(kCells);
      const double width = way.knot(piece + 1) - way.knot(piece);
      const double u = way.knot(piece) + along * width;
      const Place here = way.at(u);
      if (!(here.d.norm() > 1e-6)) throw std::invalid_argument("waypoints_m: the way turns back on the spot");
      curvature_[i] = std::abs(here.curvature());
      if (i == 0) continue;
      const double h = width / static_cast<double>(kCells);
      const double aside = 0.5 * h * std::sqrt(0.6);
      const double middle = u - 0.5 * h;
      length_[i] = length_[i - 1] + h / 18.0 *
                                        (5.0 * way.at(middle - aside).d.norm() + 8.0 * way.at(middle).d.norm() +
                                         5.0 * way.at(middle + aside).d.norm());
    }
  }

  // The mean over `smoothing_s` may be too fast for a bend; its limit is then lowered, and all is done again.
  [[nodiscard]] std::vector<double> speeds(double rate_hz) const {
    double lateral = limits_.lateral_acceleration_mps2;
    for (int i = 0; i < 40; ++i) {
      std::vector<double> v = smoothed(rough(lateral, rate_hz), rate_hz);
      const double worst = worst_lateral(v, rate_hz) / limits_.lateral_acceleration_mps2;
      if (worst <= 1.0) return v;
      lateral *= 0.999 / worst;
    }
    throw std::invalid_argument("lateral_acceleration_mps2 = " + std::to_string(limits_.lateral_acceleration_mps2) +
                                " cannot be kept with smoothing_s = " + std::to_string(limits_.smoothing_s));
  }

 private:
  // As fast as allowed: the cap of speed and bends, then what can be reached from the front, then from the back.
  [[nodiscard]] std::vector<double> rough(double lateral, double rate_hz) const {
    const std::size_t n = length_.size() - 1;
    const double twice = 2.0 * limits_.acceleration_mps2;
    std::vector<double> square(n + 1);
    for (std::size_t i = 0; i <= n; ++i) {
      square[i] = limits_.speed_mps * limits_.speed_mps;
      if (curvature_[i] > 0.0) square[i] = std::min(square[i], lateral / curvature_[i]);
    }
    square[0] = square[n] = 0.0;
    for (std::size_t i = 1; i <= n; ++i) {
      square[i] = std::min(square[i], square[i - 1] + twice * (length_[i] - length_[i - 1]));
    }
    for (std::size_t i = n; i-- > 0;) {
      square[i] = std::min(square[i], square[i + 1] + twice * (length_[i + 1] - length_[i]));
    }
    std::vector<double> time(n + 1, 0.0);
    for (std::size_t i = 1; i <= n; ++i) {
      time[i] = time[i - 1] + 2.0 * (length_[i] - length_[i - 1]) / (std::sqrt(square[i]) + std::sqrt(square[i - 1]));
    }
    if (!(time[n] * rate_hz < 1e8)) throw std::invalid_argument("waypoints_m: more than 1e8 points of the trajectory");
    const auto steps = static_cast<std::size_t>(std::ceil(time[n] * rate_hz));
    std::vector<double> v(steps + 1, 0.0);
    for (std::size_t k = 1, i = 1; k < steps; ++k) {
      const double t = static_cast<double>(k) / rate_hz;
      while (i < n && time[i] < t) ++i;
      const double share = (t - time[i - 1]) / (time[i] - time[i - 1]);
      v[k] = std::sqrt(square[i - 1]) + share * (std::sqrt(square[i]) - std::sqrt(square[i - 1]));
    }
    return v;
  }

  // Mean over the smoothing time, which covers the same way; then the last digits so that the end is met.
  [[nodiscard]] std::vector<double> smoothed(const std::vector<double>& rough, double rate_hz) const {
    const auto width = static_cast<std::size_t>(std::lround(limits_.smoothing_s * rate_hz)) + 1;
    std::vector<double> v(rough.size() + width - 1, 0.0);
    double window = 0.0;
    for (std::size_t k = 0; k < v.size(); ++k) {
      if (k < rough.size()) window += rough[k];
      if (k >= width) window -= rough[k - width];
      v[k] = std::max(0.0, window / static_cast<double>(width));
    }
    v.front() = v.back() = 0.0;
    double covered = 0.0;
    for (const double speed : v) covered += speed / rate_hz;
    for (double& speed : v) speed *= length_.back() / covered;
    return v;
  }

  [[nodiscard]] double worst_lateral(const std::vector<double>& v, double rate_hz) const {
    double worst = 0.0;
    double along = 0.0;
    for (std::size_t k = 1, i = 1; k < v.size(); ++k) {
      along += 0.5 * (v[k] + v[k - 1]) / rate_hz;
      while (i + 1 < length_.size() && length_[i] < along) ++i;
      worst = std::max(worst, v[k] * v[k] * std::max(curvature_[i], curvature_[i - 1]));
    }
    return worst;
  }

  DriveLimits limits_;
  std::vector<double> length_;     // from the start to each cell's end [m]
  std::vector<double> curvature_;  // there [1/m]
};

void check(std::span<const Eigen::Vector2d> waypoints_m, const DriveLimits& limits, double rate_hz) {
  const auto require = [](double value, const char* name) {
    if (!(value > 0.0) || std::isinf(value)) {
      throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " must be positive and finite");
    }
  };
  require(rate_hz, "rate_hz");
  require(limits.speed_mps, "speed_mps");
  require(limits.acceleration_mps2, "acceleration_mps2");
  require(limits.lateral_acceleration_mps2, "lateral_acceleration_mps2");
  if (!(limits.smoothing_s >= 0.0 && limits.smoothing_s <= 3600.0)) {
    throw std::invalid_argument("smoothing_s = " + std::to_string(limits.smoothing_s) + " must be in 0 ... 3600");
  }
  if (waypoints_m.size() < 2) {
    throw std::invalid_argument("waypoints_m: at least 2 points expected, got " + std::to_string(waypoints_m.size()));
  }
  for (std::size_t i = 0; i < waypoints_m.size(); ++i) {
    if (!waypoints_m[i].allFinite()) {
      throw std::invalid_argument("waypoints_m[" + std::to_string(i) + "] must be finite");
    }
    if (i > 0 && !((waypoints_m[i] - waypoints_m[i - 1]).norm() > 1e-3)) {
      throw std::invalid_argument("waypoints_m[" + std::to_string(i) + "] must be over 1 mm from the one before it");
    }
  }
}

}  // namespace

PlanarTrajectory PlanarTrajectory::through(std::span<const Eigen::Vector2d> waypoints_m, const DriveLimits& limits,
                                           double rate_hz) {
  check(waypoints_m, limits, rate_hz);
  const Way way(waypoints_m);
  const std::vector<double> v = SpeedProfile(way, limits).speeds(rate_hz);
  const double h = 1.0 / rate_hz;
  std::vector<PlanarMotion> points(v.size());
  double u = 0.0;
  for (std::size_t k = 0; k < v.size(); ++k) {
    const auto slope = [&way](double at, double speed) {
      return speed / way.at(std::clamp(at, 0.0, way.end())).d.norm();
    };
    if (k > 0) {  // Runge and Kutta's fourth order on u' = v / |r'(u)|, the speed being linear within a step
      const double middle = 0.5 * (v[k - 1] + v[k]);
      const double k1 = slope(u, v[k - 1]);
      const double k2 = slope(u + 0.5 * h * k1, middle);
      const double k3 = slope(u + 0.5 * h * k2, middle);
      const double k4 = slope(u + h * k3, v[k]);
      u = std::clamp(u + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4), 0.0, way.end());
    }
    const Place here = way.at(u);
    const Eigen::Vector2d forward = here.d.normalized();
    const double curvature = here.curvature();
    // The derivative of the speed: from both sides, for within the steps it is constant.
    const double before = k > 0 ? v[k] - v[k - 1] : v[1] - v[0];
    const double after = k + 1 < v.size() ? v[k + 1] - v[k] : before;
    PlanarMotion& m = points[k];
    m.t_s = static_cast<double>(k) / rate_hz;
    const double heading = std::atan2(forward[1], forward[0]);
    m.heading_rad = k == 0 ? heading : points[k - 1].heading_rad + angle_difference(heading, points[k - 1].heading_rad);
    m.yaw_rate_radps = curvature * v[k];
    m.velocity_mps = v[k] * forward;
    m.position_m = here.p;
    m.specific_force_b_mps2 = {0.5 * (before + after) * rate_hz, curvature * v[k] * v[k]};
  }
  return {std::move(points), rate_hz};
}

}  // namespace soopnav::simulation
