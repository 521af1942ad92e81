#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "soopnav/core/constants.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/gnss/gps_phase.hpp"

namespace soopnav::gnss {

namespace {

// By hand: <Eigen/Geometry> is long to compile.
Eigen::Vector3d cross(const Eigen::Vector3d& a, const Eigen::Vector3d& b) noexcept {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

void phase_require(bool ok, const char* name, double value, const char* rule) {
  if (!ok) throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + ": " + rule + " expected");
}

}  // namespace

void StaticPhaseOptions::check() const {
  const auto positive = [](double v) { return std::isfinite(v) && v > 0.0; };
  phase_require(elevation_mask_rad >= 0.0 && elevation_mask_rad < 0.5 * kPi, "elevation_mask_rad", elevation_mask_rad,
                "0 to below pi/2");
  phase_require(positive(code_sigma_m), "code_sigma_m", code_sigma_m, "a positive number");
  phase_require(positive(phase_sigma_m), "phase_sigma_m", phase_sigma_m, "a positive number");
  phase_require(std::isfinite(phase_correlation_s) && phase_correlation_s >= 0.0, "phase_correlation_s",
                phase_correlation_s, "a number not below 0");
  phase_require(positive(range_error_sigma_m), "range_error_sigma_m", range_error_sigma_m, "a positive number");
  phase_require(positive(range_error_rate_mps), "range_error_rate_mps", range_error_rate_mps, "a positive number");
  phase_require(std::isfinite(zenith_sigma_m) && zenith_sigma_m >= 0.0, "zenith_sigma_m", zenith_sigma_m,
                "a number not below 0");
  phase_require(relative_humidity >= 0.0 && relative_humidity <= 1.0, "relative_humidity", relative_humidity,
                "0 ... 1");
  phase_require(positive(max_gap_s), "max_gap_s", max_gap_s, "a positive number");
  phase_require(positive(slip_m), "slip_m", slip_m, "a positive number");
  phase_require(min_arc_epochs >= 2, "min_arc_epochs", min_arc_epochs, "at least 2");
  phase_require(std::isfinite(max_age_s) && max_age_s >= 0.0, "max_age_s", max_age_s, "a number not below 0");
}

std::string_view to_string(StaticPhaseStatus status) noexcept {
  switch (status) {
    case StaticPhaseStatus::kSolved:
      return "solved";
    case StaticPhaseStatus::kTooFewSatellites:
      return "too few satellites";
    case StaticPhaseStatus::kTooShort:
      return "too short";
    case StaticPhaseStatus::kRankDeficient:
      return "rank deficient";
    case StaticPhaseStatus::kTooManyArcs:
      return "too many arcs";
  }
  return "unknown";
}

double ionosphere_free_m(double first_m, double second_m, double f1_hz, double f2_hz) noexcept {
  const double a = f1_hz * f1_hz, b = f2_hz * f2_hz;
  return (a * first_m - b * second_m) / (a - b);
}

double wide_lane_cycles(double phase1_cycles, double phase2_cycles, double code1_m, double code2_m, double f1_hz,
                        double f2_hz) noexcept {
  const double narrow_m = (f1_hz * code1_m + f2_hz * code2_m) / (f1_hz + f2_hz);
  return phase1_cycles - phase2_cycles - narrow_m * (f1_hz - f2_hz) / kSpeedOfLightMps;
}

Eigen::Vector3d sun_direction_e(const Epoch& t) noexcept {
  if (!t.is_valid() || t.scale() != TimeScale::kGps) {
    return Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  }
  constexpr double kDegree = kPi / 180.0;
  // Days since 2000-01-01 12:00; the 18 s between GPS time and UTC turn the Earth by less than the formulas' error.
  const double days = t.seconds_since_origin() / 86'400.0 - 7300.5;
  const double anomaly = (357.528 + 0.9856003 * days) * kDegree;
  const double longitude =
      (280.460 + 0.9856474 * days + 1.915 * std::sin(anomaly) + 0.020 * std::sin(2.0 * anomaly)) * kDegree;
  const double obliquity = (23.439 - 4e-7 * days) * kDegree;
  const double x = std::cos(longitude), y = std::cos(obliquity) * std::sin(longitude);
  const double turn = (280.46062 + 360.98564737 * days) * kDegree;
  const double c = std::cos(turn), s = std::sin(turn);
  return {c * x + s * y, c * y - s * x, std::sin(obliquity) * std::sin(longitude)};
}

std::optional<double> phase_wind_up_cycles(const Eigen::Vector3d& satellite_e, const Eigen::Vector3d& sun_direction,
                                           const Eigen::Vector3d& receiver_e, double before) noexcept {
  const auto place = geometry::ecef_to_geodetic(receiver_e);
  const Eigen::Vector3d way = receiver_e - satellite_e;
  const double length = way.norm(), radius = satellite_e.norm();
  if (!place || !(length > 1.0) || !(radius > 1.0) || !std::isfinite(length + before) || !sun_direction.allFinite()) {
    return std::nullopt;
  }
  const Eigen::Vector3d k = way / length;
  // The satellite: z down, y along the panels' axis, across Sun and Earth; the Sun is far away.
  const Eigen::Vector3d z = -satellite_e / radius;
  const Eigen::Vector3d across = cross(z, sun_direction);
  if (!(across.norm() > 1e-9)) return std::nullopt;
  const Eigen::Vector3d y = across.normalized();
  const Eigen::Vector3d x = cross(y, z);
  const Eigen::Matrix3d enu = geometry::rotation_ecef_to_enu(place->latitude_rad, place->longitude_rad);
  const Eigen::Vector3d north = enu.row(1), west = -enu.row(0).transpose();
  const Eigen::Vector3d sent = x - k * k.dot(x) - cross(k, y);
  const Eigen::Vector3d received = north - k * k.dot(north) + cross(k, west);
  const double norms = sent.norm() * received.norm();
  if (!(norms > 0.0)) return std::nullopt;
  double turn = std::acos(std::clamp(sent.dot(received) / norms, -1.0, 1.0)) / kTwoPi;
  if (k.dot(cross(sent, received)) < 0.0) turn = -turn;
  return turn + std::floor(before - turn + 0.5);
}

}  // namespace soopnav::gnss
