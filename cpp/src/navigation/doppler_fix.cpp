#include "soopnav/navigation/doppler_fix.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <string>

#include "navigation/doppler_batch.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/geometry/local_frame.hpp"

namespace soopnav::navigation {
namespace {

using doppler::Batch;
using doppler::cross_rate;
using doppler::kFreeBiasHz;
using doppler::Point;
using doppler::Row;
using doppler::Unknowns;

constexpr std::size_t kGridPoints = 4000;  // about 360 km apart
constexpr std::size_t kGridRows = 100;
constexpr std::size_t kGridStarts = 10;
constexpr double kGridSlackRad = 3.0 / 180.0 * kPi;
constexpr double kDistinctM = 1000.0;
constexpr double kStepSigmas = 1e-5;
constexpr double kLeastPivot = 1e-13;

struct Solution {
  Point x;
  double cost = std::numeric_limits<double>::infinity();
  double data_cost = std::numeric_limits<double>::infinity();
  bool converged = false;
  bool full_rank = false;
  int iterations = 0;
};

// Cholesky factor of A scaled to a unit diagonal. Plain loops: a few dozen unknowns, once for each step.
class Factor {
 public:
  // False when a direction is free.
  bool compute(const Eigen::MatrixXd& A, double damping) {
    const Eigen::Index n = A.rows();
    unit_.resize(n);
    for (Eigen::Index i = 0; i < n; ++i) unit_[i] = A(i, i) > 0.0 ? 1.0 / std::sqrt(A(i, i)) : 1.0;
    L_.resize(n, n);
    for (Eigen::Index j = 0; j < n; ++j) {
      for (Eigen::Index i = j; i < n; ++i) {
        double sum = unit_[i] * A(i, j) * unit_[j] + (i == j ? damping : 0.0);
        for (Eigen::Index k = 0; k < j; ++k) sum -= L_(k, i) * L_(k, j);  // stored by rows of the transpose
        if (i == j) {
          if (!(sum > kLeastPivot)) return false;
          L_(j, j) = std::sqrt(sum);
        } else {
          L_(j, i) = sum / L_(j, j);
        }
      }
    }
    return true;
  }
  // A⁻¹ b.
  [[nodiscard]] Eigen::VectorXd solve(const Eigen::VectorXd& b) const {
    const Eigen::Index n = b.size();
    Eigen::VectorXd x(n);
    for (Eigen::Index i = 0; i < n; ++i) {
      double sum = unit_[i] * b[i];
      for (Eigen::Index k = 0; k < i; ++k) sum -= L_(k, i) * x[k];
      x[i] = sum / L_(i, i);
    }
    for (Eigen::Index i = n; i-- > 0;) {
      double sum = x[i];
      for (Eigen::Index k = i + 1; k < n; ++k) sum -= L_(i, k) * x[k];
      x[i] = sum / L_(i, i);
    }
    for (Eigen::Index i = 0; i < n; ++i) x[i] *= unit_[i];
    return x;
  }

 private:
  Eigen::MatrixXd L_;
  Eigen::VectorXd unit_;
};

Solution descend(const Batch& batch, Point start, int max_iterations) {
  Solution best;
  best.x = std::move(start);
  Eigen::MatrixXd A, next_A;
  Eigen::VectorXd g, next_g;
  Factor f;
  if (!batch.accumulate(best.x, A, g, best.cost, best.data_cost)) {
    best.cost = std::numeric_limits<double>::infinity();
    return best;
  }
  double damping = 0.0;
  for (best.iterations = 1; best.iterations <= max_iterations; ++best.iterations) {
    const bool regular = f.compute(A, damping);
    if (damping == 0.0) best.full_rank = regular;
    if (!regular) {
      damping = std::max(10.0 * damping, 1e-8);
      if (damping > 1e6) return best;
      continue;
    }
    const Eigen::VectorXd d = f.solve(g);
    if (best.full_rank && d.dot(g) <= kStepSigmas * kStepSigmas) {
      best.converged = true;
      return best;
    }
    const auto next = batch.moved(best.x, d);
    double cost = 0.0, data_cost = 0.0;
    if (next && batch.accumulate(*next, next_A, next_g, cost, data_cost) && cost < best.cost) {
      // A step that no longer changes the sum is lost in rounding.
      const bool still = best.cost - cost <= 1e-12 * best.cost;
      best.x = *next;
      best.cost = cost;
      best.data_cost = data_cost;
      A.swap(next_A);
      g.swap(next_g);
      damping = damping > 1e-7 ? 0.1 * damping : 0.0;
      if (still && best.full_rank) {
        best.converged = true;
        return best;
      }
    } else {
      if (best.full_rank && d.dot(g) <= 1e-12 * (1.0 + best.cost)) {
        best.converged = true;
        return best;
      }
      damping = std::max(10.0 * damping, 1e-4);
      if (damping > 1e12) return best;
    }
  }
  best.iterations = max_iterations;
  return best;
}

// The sum of squares with the linear unknowns at their best for a position, and those.
double profile(const Batch& batch, Point& x) {
  Eigen::MatrixXd A;
  Eigen::VectorXd g;
  Factor f;
  double cost = 0.0, data_cost = 0.0;
  if (!batch.accumulate(x, A, g, cost, data_cost)) return std::numeric_limits<double>::infinity();
  const Eigen::Index n = x.nuisance.size();
  const Eigen::MatrixXd inner = A.bottomRightCorner(n, n);
  const Eigen::VectorXd inner_g = g.tail(n);
  if (!f.compute(inner, 1e-10)) return std::numeric_limits<double>::infinity();
  const Eigen::VectorXd d = f.solve(inner_g);
  x.nuisance += d;
  return cost - d.dot(inner_g);
}

// Starts: the best of a grid over the places that see most rows, and the caller's.
std::vector<Point> starts(const Batch& batch, const DopplerFixOptions& options) {
  std::vector<Point> out;
  if (options.start_p_e) {
    // The caller's start, brought to the known height.
    const auto place = geometry::ecef_to_geodetic(*options.start_p_e);
    const double height_m = options.height_m ? *options.height_m : place->height_m;
    Point x = batch.at(geometry::geodetic_to_ecef(place->latitude_rad, place->longitude_rad, height_m));
    profile(batch, x);
    out.push_back(std::move(x));
  }
  if (!options.search) return out;
  const double least = std::sin(options.mask_rad - kGridSlackRad);
  const std::size_t stride = 1 + batch.rows().size() / kGridRows;  // some rows tell where the satellites are seen
  std::vector<Eigen::Vector3d> places;
  std::size_t most = 0;
  for (std::size_t i = 0; i < kGridPoints; ++i) {
    // A spiral whose points have equal areas of the sphere.
    const double z = 1.0 - (2.0 * static_cast<double>(i) + 1.0) / kGridPoints;
    const double longitude = std::remainder(static_cast<double>(i) * kPi * (3.0 - std::sqrt(5.0)), kTwoPi);
    const double latitude = std::asin(z);
    const Eigen::Vector3d p = geometry::geodetic_to_ecef(latitude, longitude, options.height_m.value_or(0.0));
    const double r = std::sqrt(1.0 - z * z);
    const Eigen::Vector3d up(r * std::cos(longitude), r * std::sin(longitude), z);
    std::size_t seen = 0;
    for (std::size_t k = 0; k < batch.rows().size(); k += stride) {
      const Eigen::Vector3d line = batch.rows()[k].data->source_p_e - p;
      if (up.dot(line) >= least * line.norm()) ++seen;
    }
    if (seen > most) {
      most = seen;
      places.clear();
    }
    if (seen == most) places.push_back(p);
  }
  std::vector<std::pair<double, Point>> ranked;
  for (const Eigen::Vector3d& p : places) {
    Point x = batch.at(p);
    const double cost = profile(batch, x);
    if (std::isfinite(cost)) ranked.emplace_back(cost, std::move(x));
  }
  const auto count = std::min(kGridStarts, ranked.size());
  std::partial_sort(ranked.begin(), ranked.begin() + static_cast<std::ptrdiff_t>(count), ranked.end(),
                    [](const auto& a, const auto& b) { return a.first < b.first; });
  for (std::size_t i = 0; i < count; ++i) out.push_back(std::move(ranked[i].second));
  return out;
}

DopplerUse judge(const DopplerRow& row, double max_age_s) noexcept {
  const bool finite = std::isfinite(row.t_s) && std::isfinite(row.doppler_hz) && row.source_p_e.allFinite() &&
                      row.source_v_e.allFinite() && std::isfinite(row.sigma_hz) &&
                      std::isfinite(row.along_track_sigma_m) && std::isfinite(row.age_s);
  if (!finite || !(row.source_p_e.norm() >= geometry::kMinCentreDistanceM)) return DopplerUse::kNotFinite;
  if (!(row.sigma_hz > 0.0) || row.along_track_sigma_m < 0.0) return DopplerUse::kBadSigma;
  return std::abs(row.age_s) > max_age_s ? DopplerUse::kStale : DopplerUse::kUsed;
}

[[noreturn]] void refuse(const char* option, double value, const char* rule) {
  throw std::invalid_argument(std::string(option) + ": " + std::to_string(value) + ", " + rule + " expected");
}

}  // namespace

void DopplerFixOptions::check() const {
  if (!(carrier_hz > 0.0) || !std::isfinite(carrier_hz)) refuse("carrier_hz", carrier_hz, "a positive number");
  if (!velocity_e.allFinite()) throw std::invalid_argument("velocity_e: three finite numbers expected");
  if (height_m && !(std::abs(*height_m) < 1e6)) refuse("height_m", *height_m, "less than 1000 km");
  if (!(height_sigma_m >= 0.0) || !std::isfinite(height_sigma_m))
    refuse("height_sigma_m", height_sigma_m, "a finite number that is not negative");
  if (!(frequency_bias_sigma_hz > 0.0)) refuse("frequency_bias_sigma_hz", frequency_bias_sigma_hz, "a positive number");
  if (!(frequency_drift_sigma_hz_per_s >= 0.0))
    refuse("frequency_drift_sigma_hz_per_s", frequency_drift_sigma_hz_per_s, "a number that is not negative");
  if (!(satellite_bias_sigma_hz >= 0.0) || !std::isfinite(satellite_bias_sigma_hz))
    refuse("satellite_bias_sigma_hz", satellite_bias_sigma_hz, "a finite number that is not negative");
  if (!(max_age_s >= 0.0)) refuse("max_age_s", max_age_s, "a number that is not negative");
  if (!(std::abs(mask_rad) < 0.5 * kPi)) refuse("mask_rad", mask_rad, "an angle below pi/2");
  if (!(ambiguity_gate >= 0.0)) refuse("ambiguity_gate", ambiguity_gate, "a number that is not negative");
  if (max_iterations < 1) refuse("max_iterations", max_iterations, "at least 1");
  if (start_p_e && !geometry::ecef_to_geodetic(*start_p_e))
    throw std::invalid_argument("start_p_e: a place at least 1000 km from the Earth's centre expected");
  if (!search && !start_p_e) throw std::invalid_argument("search: false without start_p_e");
}

std::string_view to_string(DopplerStatus status) noexcept {
  switch (status) {
    case DopplerStatus::kConverged:
      return "converged";
    case DopplerStatus::kAmbiguous:
      return "ambiguous";
    case DopplerStatus::kTooFewRows:
      return "too few rows";
    case DopplerStatus::kTooFewSatellites:
      return "too few satellites";
    case DopplerStatus::kTooManySatellites:
      return "too many satellites";
    case DopplerStatus::kRankDeficient:
      return "rank deficient";
    case DopplerStatus::kNotConverged:
      return "not converged";
  }
  return "unknown";
}

bool predict_doppler(const DopplerRow& row, const DopplerFixOptions& options, const Eigen::Vector3d& p_e,
                     double along_track_m, double& doppler_hz, Eigen::Vector3d& by_position,
                     double& by_along_track) noexcept {
  // In space, along the axes of reception (doc/doppler_fix.md eq. 2-4).
  const Eigen::Vector3d w = row.source_v_e + cross_rate(row.source_p_e);
  const double distance = row.source_p_e.norm();
  const double speed = w.norm();
  const Eigen::Vector3d a = -wgs84::kGravitationalParameterM3ps2 / (distance * distance * distance) * row.source_p_e;
  const double ahead_s = along_track_m != 0.0 ? along_track_m / speed : 0.0;
  const bool back = options.source_instant == SourceInstant::kReception;
  double lag_s = -ahead_s;
  Eigen::Vector3d s = row.source_p_e;
  for (int turn = 0; turn < (back ? 4 : 1); ++turn) {
    s = row.source_p_e - lag_s * w + 0.5 * lag_s * lag_s * a;
    if (back) lag_s = (s - p_e).norm() / kSpeedOfLightMps - ahead_s;
  }
  const Eigen::Vector3d inertial_v = w - lag_s * a;
  const Eigen::Vector3d v = inertial_v - cross_rate(s) - options.velocity_e;
  const Eigen::Vector3d line = s - p_e;
  const double range = line.norm();
  if (!(range > 1.0) || !std::isfinite(range)) return false;
  const Eigen::Vector3d u = line / range;
  const double slope = kSpeedOfLightMps + u.dot(inertial_v);
  const double rate = u.dot(v) / slope;
  doppler_hz = -options.carrier_hz * rate;
  // By the line's turn alone: the change of the light time adds 3e-5 of it.
  const auto across = [&](const Eigen::Vector3d& x) { return Eigen::Vector3d(x - u * u.dot(x)); };
  by_position = options.carrier_hz / (slope * range) * (across(v) - rate * across(inertial_v));
  by_along_track = 0.0;
  if (speed > 0.0) {
    const Eigen::Vector3d turn_u = across(inertial_v) / (range * speed);
    const Eigen::Vector3d turn_v = (a - cross_rate(inertial_v)) / speed;
    by_along_track = -options.carrier_hz *
                     (turn_u.dot(v) + u.dot(turn_v) - rate * (turn_u.dot(inertial_v) + u.dot(a) / speed)) / slope;
  }
  return std::isfinite(doppler_hz);
}

DopplerFix doppler_fix(std::span<const DopplerRow> rows, const DopplerFixOptions& options) {
  options.check();
  DopplerFix fix;
  fix.use.reserve(rows.size());
  fix.residuals_hz.assign(rows.size(), DopplerFix::kNan);
  std::vector<Row> used;
  std::vector<int> names;
  for (const DopplerRow& row : rows) {
    fix.use.push_back(judge(row, options.max_age_s));
    if (fix.use.back() == DopplerUse::kUsed) names.push_back(row.satellite);
  }
  std::sort(names.begin(), names.end());
  names.erase(std::unique(names.begin(), names.end()), names.end());
  fix.satellites.resize(names.size());
  std::vector<double> along_sigmas_m(names.size(), 0.0);
  double sum_s = 0.0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (fix.use[i] != DopplerUse::kUsed) continue;
    const auto k =
        static_cast<std::size_t>(std::lower_bound(names.begin(), names.end(), rows[i].satellite) - names.begin());
    DopplerSatellite& satellite = fix.satellites[k];
    if (satellite.rows++ == 0) along_sigmas_m[k] = rows[i].along_track_sigma_m;
    satellite.satellite = rows[i].satellite;
    used.push_back({&rows[i], static_cast<int>(k), 1.0 / rows[i].sigma_hz});
    sum_s += rows[i].t_s;
  }
  if (used.size() < 4) return fix;
  if (names.size() < 2) {
    fix.status = DopplerStatus::kTooFewSatellites;
    return fix;
  }
  if (names.size() > kMaxDopplerSatellites) {
    fix.status = DopplerStatus::kTooManySatellites;
    return fix;
  }
  fix.reference_s = sum_s / static_cast<double>(used.size());
  const auto batch_of = [&](double bias_sigma_hz, double scale) {
    return Batch(used, options, along_sigmas_m, bias_sigma_hz, fix.reference_s, scale);
  };

  // Starts need only the model without the satellites' constants: few unknowns, and the same minima.
  const Batch plain = batch_of(0.0, 1.0);
  if (plain.degrees() < 0) return fix;
  std::vector<Solution> found;
  for (Point& start : starts(plain, options)) {
    Solution s = descend(plain, std::move(start), options.max_iterations);
    if (std::isfinite(s.cost)) found.push_back(std::move(s));
  }
  if (found.empty()) {
    fix.status = DopplerStatus::kNotConverged;
    return fix;
  }

  // Every minimum again with all unknowns.
  double scale = 1.0;
  const auto refine = [&](const Batch& batch) {
    std::vector<Solution> out;
    for (const Solution& s : found) {
      Point x = batch.at(s.x.p_e);
      x.nuisance.head(std::min(x.nuisance.size(), s.x.nuisance.size())).setZero();
      profile(batch, x);
      Solution better = descend(batch, std::move(x), options.max_iterations);
      if (!std::isfinite(better.cost)) continue;
      const auto same = [&](const Solution& o) { return (o.x.p_e - better.x.p_e).norm() < kDistinctM; };
      const auto twin = std::find_if(out.begin(), out.end(), same);
      if (twin == out.end()) {
        out.push_back(std::move(better));
      } else if (better.converged > twin->converged ||
                 (better.converged == twin->converged && better.cost < twin->cost)) {
        *twin = std::move(better);
      }
    }
    std::sort(out.begin(), out.end(), [](const Solution& a, const Solution& b) {
      return a.converged != b.converged ? a.converged : a.cost < b.cost;
    });
    return out;
  };
  std::sort(found.begin(), found.end(), [](const Solution& a, const Solution& b) { return a.cost < b.cost; });
  if (options.estimate_sigma) {
    for (int round = 0; round < 3; ++round) {
      const Batch batch = batch_of(options.satellite_bias_sigma_hz, scale);
      if (batch.degrees() < 1) break;
      Point x = batch.at(found.front().x.p_e);
      profile(batch, x);
      const Solution s = descend(batch, std::move(x), options.max_iterations);
      if (!(std::isfinite(s.cost) && s.cost > 0.0)) break;
      scale *= std::sqrt(s.cost / batch.degrees());
    }
    fix.sigma_scale = scale;
  }
  const Batch batch = batch_of(options.satellite_bias_sigma_hz, scale);
  if (batch.degrees() < 0) return fix;
  const std::vector<Solution> solutions = refine(batch);
  if (solutions.empty()) {
    fix.status = DopplerStatus::kNotConverged;
    return fix;
  }
  const Solution& best = solutions.front();
  const Unknowns& u = batch.unknowns();
  fix.position_e = best.x.p_e;
  const auto place = geometry::ecef_to_geodetic(best.x.p_e);
  if (place) fix.place = *place;
  fix.iterations = best.iterations;
  fix.chi_square = best.cost;
  fix.degrees_of_freedom = batch.degrees();
  fix.frequency_bias_hz = best.x.nuisance[0];
  fix.frequency_drift_hz_per_s = u.drift >= 0 ? best.x.nuisance[u.drift - u.position] : 0.0;

  for (const Row& row : used) {
    double r = DopplerFix::kNan, by_along = 0.0;
    Eigen::Vector3d unused;
    if (batch.residual(row, best.x, r, unused, by_along))
      fix.residuals_hz[static_cast<std::size_t>(row.data - rows.data())] = r;
  }

  Eigen::MatrixXd A;
  Eigen::VectorXd g;
  Factor f;
  double cost = 0.0, data_cost = 0.0;
  const bool regular = batch.accumulate(best.x, A, g, cost, data_cost) && f.compute(A, 0.0);
  if (!regular) {
    fix.status = DopplerStatus::kRankDeficient;
    return fix;
  }
  const auto column = [&](int i) {
    Eigen::VectorXd e = Eigen::VectorXd::Zero(u.count);
    e[i] = 1.0;
    return f.solve(e);
  };
  fix.covariance_enu.setZero();
  for (int k = 0; k < u.position; ++k) fix.covariance_enu.col(k).head(u.position) = column(k).head(u.position);
  fix.covariance_enu = (0.5 * (fix.covariance_enu + fix.covariance_enu.transpose())).eval();
  fix.sigma_2d_m = std::sqrt(fix.covariance_enu(0, 0) + fix.covariance_enu(1, 1));
  const auto sigma = [&](int i) { return std::sqrt(std::max(0.0, column(i)[i])); };
  fix.frequency_bias_sigma_hz = sigma(u.bias());
  fix.frequency_drift_sigma_hz_per_s = u.drift >= 0 ? sigma(u.drift) : 0.0;
  for (int k = 0; k < static_cast<int>(names.size()); ++k) {
    DopplerSatellite& satellite = fix.satellites[static_cast<std::size_t>(k)];
    satellite.bias_hz = batch.value(best.x, u.biases, k);
    satellite.bias_sigma_hz = u.biases >= 0 ? sigma(u.biases + k) : 0.0;
    satellite.along_track_m = batch.value(best.x, u.along, k);
    satellite.along_track_sigma_m = u.along >= 0 ? sigma(u.along + k) : 0.0;
  }
  fix.status = best.converged ? DopplerStatus::kConverged : DopplerStatus::kNotConverged;
  if (best.converged) {
    for (std::size_t i = 1; i < solutions.size(); ++i) {
      const double excess = solutions[i].cost - best.cost;
      if (!solutions[i].converged || !(excess <= options.ambiguity_gate)) continue;
      fix.alternatives.push_back({solutions[i].x.p_e, excess});
      fix.status = DopplerStatus::kAmbiguous;
    }
  }

  // Do the satellites' constants belong? Both models at their own minima near the place found.
  const auto from_best = [&](const Batch& other) {
    Point x = other.at(best.x.p_e);
    profile(other, x);
    return descend(other, std::move(x), options.max_iterations);
  };
  double judged = 1.0;
  if (options.estimate_sigma) {
    const Solution s = from_best(batch_of(kFreeBiasHz, 1.0));
    const int left = static_cast<int>(used.size()) - plain.unknowns().count - static_cast<int>(names.size()) + 1;
    if (left > 0 && s.data_cost > 0.0) judged = std::sqrt(s.data_cost / left);
  }
  const Solution without = from_best(batch_of(0.0, judged));
  const Solution with = from_best(batch_of(kFreeBiasHz, judged));
  if (without.converged && with.converged) {
    fix.bias_chi_square = without.data_cost - with.data_cost;
    fix.bias_degrees_of_freedom = static_cast<int>(names.size()) - 1;
    fix.bias_probability = 1.0 - chi_square_cdf(std::max(0.0, fix.bias_chi_square), fix.bias_degrees_of_freedom);
  }
  return fix;
}

}  // namespace soopnav::navigation
