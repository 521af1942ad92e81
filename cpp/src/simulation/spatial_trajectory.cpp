#include "soopnav/simulation/spatial_trajectory.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "soopnav/core/angle.hpp"
#include "soopnav/geometry/gravity.hpp"
#include "soopnav/geometry/rotation.hpp"

namespace soopnav::simulation {
namespace {

constexpr int kDegree = 5;
constexpr std::size_t kLeastPoints = kDegree + 1;

void require(bool holds, const char* name, double value, const char* rule) {
  if (holds) return;
  std::ostringstream text;
  text << name << ": " << value << "; " << rule;
  throw std::invalid_argument(text.str());
}

void check(const Oscillation& oscillation, const char* name) {
  require(std::isfinite(oscillation.amplitude_rad) && std::isfinite(oscillation.frequency_hz) &&
              std::isfinite(oscillation.phase_rad),
          name, oscillation.amplitude_rad, "amplitude, frequency and phase must be finite");
}

// Values of the uniform B-splines of one degree that are not zero at u in [0, 1).
template <int Degree>
std::array<double, std::size_t{Degree + 1}> basis(double u) noexcept {
  std::array<double, std::size_t{Degree + 1}> n{1.0};
  for (int d = 1; d <= Degree; ++d) {
    for (int j = d; j >= 0; --j) {
      const auto i = static_cast<std::size_t>(j);
      const double left = j > 0 ? (d - j + u) * n[i - 1] : 0.0;
      const double right = j < d ? (1 + j - u) * n[i] : 0.0;
      n[i] = (left + right) / d;
    }
  }
  return n;
}

// Angle, first and second derivative are not all needed: angle and rate.
struct Angle {
  double value, rate;
  Angle(const Oscillation& o, double t) noexcept {
    const double w = kTwoPi * o.frequency_hz;
    value = o.amplitude_rad * std::sin(w * t + o.phase_rad);
    rate = o.amplitude_rad * w * std::cos(w * t + o.phase_rad);
  }
};

// Straight lines by the length along them.
class Polyline {
 public:
  explicit Polyline(const std::vector<Eigen::Vector3d>& points) : points_(points), length_(points.size(), 0.0) {
    for (std::size_t i = 1; i < points.size(); ++i) length_[i] = length_[i - 1] + (points[i] - points[i - 1]).norm();
  }
  [[nodiscard]] double length() const noexcept { return length_.back(); }
  // Beyond the ends, straight on.
  [[nodiscard]] Eigen::Vector3d at(double s) const noexcept {
    const auto after = std::upper_bound(length_.begin() + 1, length_.end() - 1, s);
    const auto i = static_cast<std::size_t>(after - length_.begin());
    return points_[i - 1] + (s - length_[i - 1]) / (length_[i] - length_[i - 1]) * (points_[i] - points_[i - 1]);
  }

 private:
  const std::vector<Eigen::Vector3d>& points_;
  std::vector<double> length_;
};

constexpr std::array<double, 6> kNode{-0.932469514203152028, -0.661209386466264514, -0.238619186083196909,
                                      0.238619186083196909,  0.661209386466264514,  0.932469514203152028};
constexpr std::array<double, 6> kWeight{0.171324492379170345, 0.360761573048138608, 0.467913934572691047,
                                        0.467913934572691047, 0.360761573048138608, 0.171324492379170345};
constexpr double kPanelS = 0.02;

}  // namespace

SpatialTrajectory::SpatialTrajectory(const geometry::LocalFrame& frame, std::vector<Eigen::Vector3d> control_points,
                                     double knot_s, const Attitude& attitude)
    : frame_(frame),
      ned_(frame.origin(), geometry::LocalAxes::kNed),
      knot_s_(knot_s),
      duration_s_(0.0),
      attitude_(attitude),
      omega_ie_ned_(geometry::earth_rate_ned(frame.origin().latitude_rad)) {
  const std::size_t n = control_points.size();
  require(n >= kLeastPoints, "control_points", static_cast<double>(n), "at least six are needed");
  require(knot_s > 0.0 && std::isfinite(knot_s), "knot_s", knot_s, "it must be positive and finite");
  check(attitude.roll, "roll");
  check(attitude.pitch, "pitch");
  for (const Eigen::Vector3d& c : control_points) {
    require(c.allFinite(), "control_points", c.sum(), "they must be finite");
  }
  if (frame.axes() == geometry::LocalAxes::kEnu) {
    for (Eigen::Vector3d& c : control_points) c = geometry::swap_enu_ned(c);
  }
  duration_s_ = static_cast<double>(n - kDegree) * knot_s;
  control_.resize(n);
  // Yaw: the direction from the control point before to the one behind; where the path stands, that of its next move.
  double yaw = std::numeric_limits<double>::quiet_NaN();
  for (std::size_t i = n; i-- > 0;) {
    const Eigen::Vector3d along = control_points[std::min(i + 1, n - 1)] - control_points[i == 0 ? 0 : i - 1];
    if (along.head<2>().norm() > 1e-6 * knot_s) {
      const double direction = std::atan2(along.y(), along.x());
      yaw = std::isnan(yaw) ? direction : yaw + angle_difference(direction, yaw);
    }
    control_[i] << control_points[i], yaw;
  }
  double next = 0.0;
  for (Control& c : control_) {  // the end may stand as well
    if (std::isnan(c[3])) c[3] = next;
    next = c[3];
  }
}

SpatialTrajectory SpatialTrajectory::through(const geometry::LocalFrame& frame,
                                             const std::vector<Eigen::Vector3d>& waypoints, const PathOptions& options,
                                             const Attitude& attitude) {
  require(waypoints.size() >= 2, "waypoints", static_cast<double>(waypoints.size()), "at least two are needed");
  const double speed = options.speed_mps;
  const double bound = options.max_acceleration_mps2;
  require(speed > 0.0 && std::isfinite(speed), "speed_mps", speed, "it must be positive and finite");
  require(bound > 0.0 && std::isfinite(bound), "max_acceleration_mps2", bound, "it must be positive and finite");
  const double rest = options.rest_s.value_or(0.0);
  require(rest >= 0.0 && std::isfinite(rest), "rest_s", rest, "it must be finite and not negative");
  double greatest_turn = 0.0;
  for (std::size_t i = 0; i < waypoints.size(); ++i) {
    require(waypoints[i].allFinite(), "waypoints", waypoints[i].sum(), "they must be finite");
    if (i == 0) continue;
    const Eigen::Vector3d leg = waypoints[i] - waypoints[i - 1];
    require(leg.norm() > 1e-3, "waypoints", static_cast<double>(i), "this one is where the one before it is");
    if (i == 1) continue;
    greatest_turn =
        std::max(greatest_turn, (leg.normalized() - (waypoints[i - 1] - waypoints[i - 2]).normalized()).norm());
  }
  const Polyline line(waypoints);
  const double push = 0.5 * bound;
  const double ramp_s = options.rest_s ? speed / push : 0.0;
  const auto along = [&](double t) {
    if (!options.rest_s) return speed * t;
    const double moving = t - rest;
    if (moving <= 0.0) return 0.0;
    return moving < ramp_s ? 0.5 * push * moving * moving : speed * (moving - 0.5 * ramp_s);
  };
  const double duration = rest + 0.5 * ramp_s + line.length() / speed;
  // One corner takes 2/3 |dv| / knot (doc/strapdown.md eq. 44); corners that follow closely may add up.
  double knot = std::max(0.5, 2.0 / 3.0 * speed * greatest_turn / bound);
  for (int attempt = 0; attempt < 40; ++attempt, knot *= 1.15) {
    const auto spans = static_cast<std::size_t>(std::ceil(duration / knot));
    std::vector<Eigen::Vector3d> control(spans + kDegree);
    for (std::size_t i = 0; i < control.size(); ++i) {
      control[i] = line.at(along((static_cast<double>(i) - 2.0) * knot));
    }
    SpatialTrajectory path(frame, std::move(control), knot, attitude);
    if (path.greatest_acceleration_mps2() <= bound) return path;
    if (knot > duration) break;
  }
  require(false, "max_acceleration_mps2", bound, "corners follow each other too closely to round them within it");
  return {frame, {}, knot, attitude};
}

SpatialTrajectory::Curve SpatialTrajectory::curve(double t_s) const noexcept {
  const double along = t_s / knot_s_;
  const auto last = static_cast<double>(control_.size() - kLeastPoints);
  const double span = std::clamp(std::floor(along), 0.0, last);
  const double u = along - span;
  const auto i0 = static_cast<std::size_t>(span);
  std::array<Control, kLeastPoints> c;
  for (std::size_t i = 0; i < c.size(); ++i) c[i] = control_[i0 + i];
  const auto sum = [&c](const auto& weights) {
    Control value = Control::Zero();
    for (std::size_t i = 0; i < weights.size(); ++i) value += weights[i] * c[i];
    return value;
  };
  Curve out;
  out.value = sum(basis<5>(u));
  for (std::size_t i = 0; i < 5; ++i) c[i] = c[i + 1] - c[i];
  out.first = sum(basis<4>(u)) / knot_s_;
  for (std::size_t i = 0; i < 4; ++i) c[i] = c[i + 1] - c[i];
  out.second = sum(basis<3>(u)) / (knot_s_ * knot_s_);
  return out;
}

SpatialMotion SpatialTrajectory::motion_ned(double t_s) const noexcept {
  const Curve at = curve(t_s);
  const Angle roll(attitude_.roll, t_s);
  const Angle pitch(attitude_.pitch, t_s);
  const double yaw_rate = at.first[3];
  SpatialMotion m;
  m.p_n_m = at.value.head<3>();
  m.v_n_mps = at.first.head<3>();
  m.a_n_mps2 = at.second.head<3>();
  const double cr = std::cos(0.5 * roll.value), sr = std::sin(0.5 * roll.value);
  const double cp = std::cos(0.5 * pitch.value), sp = std::sin(0.5 * pitch.value);
  const double cy = std::cos(0.5 * at.value[3]), sy = std::sin(0.5 * at.value[3]);
  m.q_n_b = Eigen::Quaterniond(cy * cp * cr + sy * sp * sr, cy * cp * sr - sy * sp * cr, cy * sp * cr + sy * cp * sr,
                               sy * cp * cr - cy * sp * sr);
  const double c = std::cos(roll.value), s = std::sin(roll.value);
  const double cos_pitch = std::cos(pitch.value);
  m.w_nb_b_radps = {roll.rate - yaw_rate * std::sin(pitch.value), pitch.rate * c + yaw_rate * cos_pitch * s,
                    yaw_rate * cos_pitch * c - pitch.rate * s};
  return m;
}

SpatialMotion SpatialTrajectory::at(double t_s) const noexcept {
  SpatialMotion m = motion_ned(t_s);
  if (frame_.axes() == geometry::LocalAxes::kEnu) {
    m.p_n_m = geometry::swap_enu_ned(m.p_n_m);
    m.v_n_mps = geometry::swap_enu_ned(m.v_n_mps);
    m.a_n_mps2 = geometry::swap_enu_ned(m.a_n_mps2);
    // The swap is half a turn about the line between the first two axes.
    const double h = std::sqrt(0.5);
    m.q_n_b = Eigen::Quaterniond(0.0, h, h, 0.0) * m.q_n_b;
  }
  return m;
}

double SpatialTrajectory::greatest_acceleration_mps2() const noexcept {
  double greatest = 0.0;
  const std::size_t spans = control_.size() - kDegree;
  for (std::size_t i = 0; i <= 16 * spans; ++i) {
    const double t = static_cast<double>(i) * knot_s_ / 16.0;
    greatest = std::max(greatest, curve(t).second.head<3>().norm());
  }
  return greatest;
}

inertial::NavigationState SpatialTrajectory::navigation_state(double t_s) const {
  const SpatialMotion m = motion_ned(t_s);
  inertial::NavigationState out;
  const auto place = ned_.position_to_geodetic(m.p_n_m);
  if (!place) throw std::invalid_argument("t_s: the path is not near the Earth there");
  out.place = *place;
  const Eigen::Matrix3d turn =
      geometry::rotation_ecef_to_ned(place->latitude_rad, place->longitude_rad) * ned_.rotation_from_ecef().transpose();
  out.v_n_mps = turn * m.v_n_mps;
  out.q_n_b = geometry::quaternion_from_rotation(turn * m.q_n_b.toRotationMatrix());
  return out;
}

std::vector<inertial::ImuIncrement> SpatialTrajectory::imu_increments(double rate_hz, double start_s,
                                                                      double end_s) const {
  require(rate_hz > 0.0 && std::isfinite(rate_hz), "rate_hz", rate_hz, "it must be positive and finite");
  const double slack = 1e-9 * duration_s_;
  require(start_s >= -slack && start_s <= duration_s_ + slack, "start_s", start_s, "it must lie on the path");
  require(end_s >= start_s && end_s <= duration_s_ + slack, "end_s", end_s,
          "it must not lie before start_s nor behind the path's end");
  const auto count = static_cast<std::size_t>(std::floor((end_s - start_s) * rate_hz * (1.0 + 1e-12) + 1e-6));
  const double dt = 1.0 / rate_hz;
  const int panels = std::max(1, static_cast<int>(std::ceil(dt / kPanelS - 1e-9)));
  const double half = 0.5 * dt / panels;
  std::vector<inertial::ImuIncrement> out(count);
  for (std::size_t k = 0; k < count; ++k) {
    inertial::ImuIncrement& u = out[k];
    u.dt_s = dt;
    const double begin = start_s + static_cast<double>(k) * dt;
    for (int panel = 0; panel < panels; ++panel) {
      const double middle = begin + (2.0 * panel + 1.0) * half;
      for (std::size_t i = 0; i < kNode.size(); ++i) {
        const SpatialMotion m = motion_ned(middle + half * kNode[i]);
        const Eigen::Vector3d g =
            ned_.velocity_from_ecef(geometry::normal_gravity_ecef(ned_.position_to_ecef(m.p_n_m)));
        const Eigen::Matrix3d T_b_n = m.q_n_b.conjugate().toRotationMatrix();
        const double weight = half * kWeight[i];
        u.delta_theta_b += weight * (m.w_nb_b_radps + T_b_n * omega_ie_ned_);
        u.delta_velocity_b += weight * (T_b_n * (m.a_n_mps2 + 2.0 * omega_ie_ned_.cross(m.v_n_mps) - g));
      }
    }
  }
  return out;
}

}  // namespace soopnav::simulation
