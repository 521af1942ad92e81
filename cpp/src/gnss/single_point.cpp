#include "soopnav/gnss/single_point.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <stdexcept>
#include <utility>

#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/least_squares.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/measurement/pseudorange.hpp"

namespace soopnav::gnss {
namespace {

using State = PositionClock<EcefFrame>;
using Model = Pseudorange<EcefFrame, Known<1>>;
constexpr int kMaxRows = static_cast<int>(kMaxSatellites);
using Solution = LeastSquaresResult<State, kMaxRows>;

[[noreturn]] void refuse(const char* name, double value, const char* rule) {
  throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " " + rule);
}

// One satellite on its way through a fix.
struct Line {
  std::size_t index = 0;                               // of its measurement
  SatelliteState state;                                // at transmission
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // in the axes of the reception
  double flight_s = 0.075;
  double sigma_m = 1.0;
  double correction_m = 0.0;
};

struct Lines {
  std::array<Line, kMaxSatellites> items;
  std::size_t count = 0;
  [[nodiscard]] std::size_t size() const { return count; }
  Line& operator[](std::size_t k) { return items[k]; }
  const Line& operator[](std::size_t k) const { return items[k]; }
  [[nodiscard]] const Line* begin() const { return items.data(); }
  [[nodiscard]] const Line* end() const { return items.data() + count; }
};

double elevation_factor(double elevation) { return 1.0 / std::sin(std::max(elevation, 0.05)); }

// What one epoch is solved with.
struct Epochal {
  const PointOptions& options;
  const std::optional<Klobuchar>& klobuchar;
  double second_of_week = 0.0;
  std::span<const PointMeasurement> measurements;

  // Flight times, corrections, weights at `x`; below the mask satellites leave.
  void correct(const State& x, Lines& lines, PointFix& fix, bool may_leave) const {
    const Eigen::Vector3d p = x(kPosition);
    const auto place = geometry::ecef_to_geodetic(p);
    const bool near_ground = place && place->height_m > -50'000.0 && place->height_m < 5e6;
    const Eigen::Matrix3d T_enu_e = near_ground
                                        ? geometry::rotation_ecef_to_enu(place->latitude_rad, place->longitude_rad)
                                        : Eigen::Matrix3d::Identity();
    std::size_t kept = 0;
    for (std::size_t k = 0; k < lines.size(); ++k) {
      Line line = lines[k];
      line.position = rotated_for_flight(line.state.position_e, line.flight_s);
      line.flight_s = (line.position - p).norm() / kSpeedOfLightMps;
      line.position = rotated_for_flight(line.state.position_e, line.flight_s);
      line.correction_m = 0.0;
      const double own_sigma = measurements[line.index].sigma_m;
      line.sigma_m = std::isfinite(own_sigma) ? own_sigma : options.sigma_m;
      const auto seen =
          near_ground ? geometry::direction_enu(Eigen::Vector3d::Zero(), T_enu_e * (line.position - p)) : std::nullopt;
      if (seen) {
        fix.azimuths_rad[line.index] = seen->azimuth_rad;
        fix.elevations_rad[line.index] = seen->elevation_rad;
        if (may_leave && seen->elevation_rad < options.elevation_mask_rad) {
          fix.use[line.index] = SatelliteUse::kLow;
          continue;
        }
        if (klobuchar && options.ionosphere) {
          line.correction_m +=
              ionosphere_delay_m(*klobuchar, *place, seen->azimuth_rad, seen->elevation_rad, second_of_week);
        }
        if (options.troposphere) {
          line.correction_m += troposphere_delay_m(*place, seen->elevation_rad, options.relative_humidity);
        }
        if (options.weight_by_elevation && !std::isfinite(own_sigma)) {
          line.sigma_m *= elevation_factor(seen->elevation_rad);
        }
      }
      lines[kept++] = line;
    }
    lines.count = kept;
  }

  [[nodiscard]] Solution solve_lines(const State& start, const Lines& lines) const {
    std::array<Observed<Model>, kMaxSatellites> observed;
    std::size_t count = 0;
    for (const Line& line : lines) {
      Model model;
      model.source_p = line.position;
      model.source_clock = Known<1>(kSpeedOfLightMps * line.state.clock_s);
      observed[count++] = Observed<Model>(model, measurements[line.index].pseudorange_m - line.correction_m,
                                          line.sigma_m * line.sigma_m);
    }
    return solve<kMaxRows>(start, LeastSquaresOptions{}, std::span<const Observed<Model>>(observed.data(), count));
  }

  // The solution with corrections at its own place; `start` moves there.
  [[nodiscard]] std::pair<PointStatus, Solution> iterate(State& start, Lines& lines, PointFix& fix,
                                                         bool may_leave) const {
    Solution solution;
    for (int k = 0; k < options.max_iterations; ++k) {
      // The mask decides in the first rounds near the ground; then the set stays.
      correct(start, lines, fix, may_leave && k < 4);
      if (lines.size() < 4) return {PointStatus::kTooFewSatellites, solution};
      solution = solve_lines(start, lines);
      fix.iterations = k + 1;
      if (solution.status == SolveStatus::kRankDeficient) return {PointStatus::kRankDeficient, solution};
      if (solution.status != SolveStatus::kConverged) return {PointStatus::kNotConverged, solution};
      const double moved = (solution.state(kPosition) - start(kPosition)).norm();
      start = solution.state;
      if (moved < 1e-6 && k >= 2) return {PointStatus::kConverged, solution};
    }
    return {PointStatus::kNotConverged, solution};
  }

  void velocity(const Eigen::Vector3d& p, const Lines& lines, PointFix& fix) const {
    Eigen::Matrix4d N = Eigen::Matrix4d::Zero();
    Eigen::Vector4d g = Eigen::Vector4d::Zero();
    int rows = 0;
    for (const Line& line : lines) {
      const double rate = measurements[line.index].range_rate_mps;
      if (!std::isfinite(rate)) continue;
      const Eigen::Vector3d u = (line.position - p).normalized();
      const Eigen::Vector3d v = rotated_for_flight(line.state.velocity_e, line.flight_s);
      const Eigen::Vector3d turned(kEarthRateRadps * line.position[1], -kEarthRateRadps * line.position[0], 0.0);
      const double stretch = 1.0 + u.dot(v - turned) / kSpeedOfLightMps;
      double sigma = options.sigma_rate_mps;
      if (options.weight_by_elevation) sigma *= elevation_factor(fix.elevations_rad[line.index]);
      Eigen::Vector4d h;
      h << -u / stretch, 1.0;
      const double z = rate + kSpeedOfLightMps * line.state.clock_rate - u.dot(v) / stretch;
      N += h * h.transpose() / (sigma * sigma);
      g += h * z / (sigma * sigma);
      ++rows;
    }
    if (rows < 4) return;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(N);
    if (!(eigen.eigenvalues()[0] > 1e-10 * eigen.eigenvalues()[3])) return;
    const Eigen::LLT<Eigen::Matrix4d> factor(N);
    const Eigen::Vector4d x = factor.solve(g);
    if (!x.allFinite()) return;
    fix.has_velocity = true;
    fix.velocity_e = x.head<3>();
    fix.clock_drift_mps = x[3];
    fix.velocity_covariance = factor.solve(Eigen::Matrix<double, 4, 3>::Identity()).topRows<3>();
  }
};

// Dilutions in the level frame, from lines of sight alone.
Dop level_dop(const Eigen::Vector3d& p, const Lines& lines, const Eigen::Matrix3d& T_enu_e) {
  Eigen::Matrix4d N = Eigen::Matrix4d::Zero();
  for (const Line& line : lines) {
    Eigen::Vector4d h;
    h << T_enu_e * (p - line.position).normalized(), 1.0;
    N += h * h.transpose();
  }
  Dop dop;
  const Eigen::Matrix4d Q = N.llt().solve(Eigen::Matrix4d::Identity());
  dop.gdop = std::sqrt(Q.trace());
  dop.pdop = std::sqrt(Q(0, 0) + Q(1, 1) + Q(2, 2));
  dop.hdop = std::sqrt(Q(0, 0) + Q(1, 1));
  dop.vdop = std::sqrt(Q(2, 2));
  dop.tdop = std::sqrt(Q(3, 3));
  return dop;
}

}  // namespace

void PointOptions::check() const {
  if (!(elevation_mask_rad >= -kPi / 2) || !(elevation_mask_rad < kPi / 2)) {
    refuse("elevation_mask_rad", elevation_mask_rad, "must be in [-pi/2, pi/2)");
  }
  if (!(sigma_m > 0.0) || !std::isfinite(sigma_m)) refuse("sigma_m", sigma_m, "must be positive and finite");
  if (!(sigma_rate_mps > 0.0) || !std::isfinite(sigma_rate_mps)) {
    refuse("sigma_rate_mps", sigma_rate_mps, "must be positive and finite");
  }
  if (!(relative_humidity >= 0.0) || !(relative_humidity <= 1.0)) {
    refuse("relative_humidity", relative_humidity, "must be in [0, 1]");
  }
  if (!(false_alarm_probability > 0.0) || !(false_alarm_probability < 0.5)) {
    refuse("false_alarm_probability", false_alarm_probability, "must be in (0, 0.5)");
  }
  if (!(max_age_s >= 0.0)) refuse("max_age_s", max_age_s, "must not be negative");
  if (max_iterations < 3) refuse("max_iterations", max_iterations, "must be at least 3");
}

std::string_view to_string(PointStatus status) noexcept {
  switch (status) {
    case PointStatus::kConverged:
      return "converged";
    case PointStatus::kInconsistent:
      return "inconsistent";
    case PointStatus::kTooFewSatellites:
      return "too few satellites";
    case PointStatus::kRankDeficient:
      return "rank deficient";
    case PointStatus::kNotConverged:
      return "not converged";
  }
  return "unknown";
}

std::size_t PointFix::used_count() const noexcept {
  return static_cast<std::size_t>(std::count(use.begin(), use.end(), SatelliteUse::kUsed));
}

std::string PointFix::message() const {
  const auto number = [this](SatelliteUse which) { return std::count(use.begin(), use.end(), which); };
  std::string text(to_string(status));
  text += ": " + std::to_string(used_count()) + " of " + std::to_string(use.size()) + " satellites used";
  constexpr std::array<std::pair<SatelliteUse, const char*>, 6> kReasons{
      {{SatelliteUse::kNotFinite, "without a number"},
       {SatelliteUse::kNoEphemeris, "without ephemeris"},
       {SatelliteUse::kStale, "with a stale ephemeris"},
       {SatelliteUse::kUnhealthy, "unhealthy"},
       {SatelliteUse::kLow, "below the mask"},
       {SatelliteUse::kRejected, "rejected"}}};
  for (const auto& [which, words] : kReasons) {
    if (number(which) > 0) text += ", " + std::to_string(number(which)) + " " + words;
  }
  return text;
}

SinglePoint::SinglePoint(EphemerisTable ephemerides, const std::optional<Klobuchar>& klobuchar,
                         const PointOptions& options)
    : table_(std::move(ephemerides)), klobuchar_(klobuchar), options_(options) {
  options_.check();
  if (klobuchar_) klobuchar_->check();
}

PointFix SinglePoint::fix(const Epoch& receive_clock, std::span<const PointMeasurement> measurements) const noexcept {
  PointFix fix;
  measurements = measurements.first(std::min(measurements.size(), kMaxSatellites));
  Lines lines;
  for (std::size_t i = 0; i < measurements.size(); ++i) {
    const PointMeasurement& z = measurements[i];
    static_cast<void>(fix.use.push_back(SatelliteUse::kUsed));
    static_cast<void>(fix.residuals_m.push_back(PointFix::kNan));
    static_cast<void>(fix.azimuths_rad.push_back(PointFix::kNan));
    static_cast<void>(fix.elevations_rad.push_back(PointFix::kNan));
    SatelliteUse& use = fix.use[i];
    if (!std::isfinite(z.pseudorange_m) || z.sigma_m <= 0.0 || std::isinf(z.sigma_m)) {
      use = SatelliteUse::kNotFinite;
      continue;
    }
    const Ephemeris* eph = table_.find(z.prn, receive_clock, options_.max_age_s);
    if (eph == nullptr) {
      use = table_.has(z.prn) ? SatelliteUse::kStale : SatelliteUse::kNoEphemeris;
      continue;
    }
    if (eph->health != 0) {
      use = SatelliteUse::kUnhealthy;
      continue;
    }
    const auto state = state_at_transmission(*eph, receive_clock, z.pseudorange_m);
    if (!state) {
      use = SatelliteUse::kNotFinite;
      continue;
    }
    Line line;
    line.index = i;
    line.state = *state;
    lines[lines.count++] = line;
  }

  const auto when = week_and_second(receive_clock);
  const Epochal epoch{options_, klobuchar_, when ? when->second : 0.0, measurements};
  State x;
  x.x.setZero();
  auto [status, solution] = epoch.iterate(x, lines, fix, true);
  fix.status = status;
  const auto limit = [this](int dof) { return chi_square_upper_quantile(options_.false_alarm_probability, dof); };
  while (fix.status == PointStatus::kConverged && solution.degrees_of_freedom > 0 &&
         solution.chi_square > limit(solution.degrees_of_freedom)) {
    if (!options_.reject_outliers || solution.degrees_of_freedom < 2) {
      fix.status = PointStatus::kInconsistent;
      break;
    }
    Eigen::Index worst = 0;
    solution.normalized_residuals.cwiseAbs().maxCoeff(&worst);
    fix.use[lines[static_cast<std::size_t>(worst)].index] = SatelliteUse::kRejected;
    for (auto k = static_cast<std::size_t>(worst); k + 1 < lines.size(); ++k) lines[k] = lines[k + 1];
    --lines.count;
    std::tie(fix.status, solution) = epoch.iterate(x, lines, fix, false);
  }
  fix.unobservable = solution.unobservable;
  if (fix.status != PointStatus::kConverged && fix.status != PointStatus::kInconsistent) return fix;

  const Eigen::Vector3d p = solution.state(kPosition);
  const auto place = geometry::ecef_to_geodetic(p);
  if (!place || !solution.covariance.allFinite()) {
    fix.status = PointStatus::kNotConverged;
    return fix;
  }
  const Eigen::Matrix3d T_enu_e = geometry::rotation_ecef_to_enu(place->latitude_rad, place->longitude_rad);
  fix.position_e = p;
  fix.clock_bias_m = solution.state(kClockBias)[0];
  fix.covariance_m2 = solution.covariance.topLeftCorner<3, 3>();
  fix.covariance_enu_m2 = T_enu_e * fix.covariance_m2 * T_enu_e.transpose();
  fix.clock_sigma_m = std::sqrt(solution.covariance(3, 3));
  fix.chi_square = solution.chi_square;
  fix.degrees_of_freedom = solution.degrees_of_freedom;
  fix.dop = level_dop(p, lines, T_enu_e);
  for (std::size_t k = 0; k < lines.size(); ++k) {
    fix.residuals_m[lines[k].index] = solution.residuals[static_cast<Eigen::Index>(k)];
  }
  epoch.velocity(p, lines, fix);
  return fix;
}

}  // namespace soopnav::gnss
