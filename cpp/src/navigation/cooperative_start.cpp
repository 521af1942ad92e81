#include "soopnav/navigation/cooperative_start.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>

#include "navigation/cooperative_checks.hpp"
#include "navigation/cooperative_rows.hpp"
#include "navigation/cooperative_sight.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/detail/small_matrix.hpp"
#include "soopnav/geometry/wgs84.hpp"

namespace soopnav::navigation {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kThetaSigmaM = 1e7;    // about what the first burst says
constexpr double kFreeSigmaM = 1e7;     // of a position that nothing is known of
constexpr double kPinnedSigmaM = 1e-3;  // of one that is given
constexpr double kOutlierProbability = 1e-6;
constexpr int kMostIterations = 40;
constexpr std::size_t kMostAlongTrack = 64;
constexpr double kSameSigmas = 3.0;  // solutions nearer to each other are one

// A burst that is used.
struct Burst {
  std::size_t index;
  const PairMeasurement* m;
  PairModel<> model;
  PairObservation observed;
  geometry::SignalPath near;
  bool satellite = false;
  bool used = true;
};

// The ellipsoid's point below p raised to a height, and its normal there.
bool to_height(const Vector3d& p_e, double height_m, Vector3d& on, Vector3d& normal) {
  const auto place = geometry::ecef_to_geodetic(p_e);
  if (!place) return false;
  on = geometry::geodetic_to_ecef(place->latitude_rad, place->longitude_rad, height_m);
  normal = ellipsoid_up(*place);
  return true;
}

class Batch {
 public:
  Batch(std::span<const geometry::SampledOrbit> beacons, std::span<const PairMeasurement> measurements,
        const PairStartOptions& options)
      : o_(options), gate_(chi_square_upper_quantile(kOutlierProbability, 2)) {
    double last = -std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < measurements.size(); ++i) {
      const PairMeasurement& m = measurements[i];
      Burst b{.index = i, .m = &m, .model = {}, .observed = {}, .near = {}};
      if (!pair_observation(m, b.observed) || m.t_s < last || m.beacon < 0 ||
          m.beacon >= static_cast<int>(beacons.size()) || !(b.observed.R.determinant() > 0.0) ||
          !(b.observed.R(0, 0) > 0.0)) {
        continue;
      }
      const geometry::SampledOrbit& orbit = beacons[static_cast<std::size_t>(m.beacon)];
      b.model = PairModel<>{&orbit, m.t_s, m.anchor_p_e, m.anchor_v_e, {}, o_.anchor_drift_mps};
      if (!geometry::signal_path(orbit, m.t_s, m.anchor_p_e, m.anchor_v_e, b.near)) continue;
      b.satellite = has_horizon(b.near.source_p_e);
      if (b.satellite && sine_of_elevation(m.anchor_p_e, b.near.source_p_e) < std::sin(o_.mask_rad)) continue;
      last = m.t_s;
      bursts_.push_back(b);
    }
    // One state for each satellite, last heard first.
    bursts_of_.assign(beacons.size(), 0);
    for (auto b = bursts_.rbegin(); b != bursts_.rend(); ++b) {
      int& count = bursts_of_[static_cast<std::size_t>(b->m->beacon)];
      if (sigma_of(*b) > 0.0 && count == 0 && ahead_.size() < kMostAlongTrack) ahead_.push_back(b->m->beacon);
      ++count;
    }
    filter_ = linearised_filter({.clock_noise = options.clock_noise,
                                 .acceleration_psd_m2ps3 = options.acceleration_psd_m2ps3,
                                 .max_along_track = static_cast<int>(ahead_.size())});
  }

  [[nodiscard]] const std::vector<Burst>& bursts() const noexcept { return bursts_; }
  [[nodiscard]] std::vector<Burst>& bursts() noexcept { return bursts_; }
  [[nodiscard]] const std::vector<int>& along_track() const noexcept { return ahead_; }

  // Misfit of a cell's middle, whose theta and alpha are fitted: errors of a cell's size are expected. False where the
  // beacons are not seen.
  [[nodiscard]] bool misfit(const Vector3d& p, double& cost) const {
    const double at_range = 0.5 * o_.cell_m;
    const double at_rate = 4e-3 * at_range;  // a low orbit's range rate changes by some 4 m/s per kilometre
    const double sine_of_mask = std::sin(o_.mask_rad - o_.cell_m / wgs84::kSemiMajorAxisM);
    double n00 = 0.0, n01 = 0.0, n11 = 0.0, b0 = 0.0, b1 = 0.0, sum = 0.0;
    std::size_t hidden = 0;
    for (const Burst& b : bursts_) {
      geometry::SignalPath far;
      if (!geometry::signal_path(*b.model.beacon, b.m->t_s, p, Vector3d::Zero(), far)) return false;
      if (b.satellite && sine_of_elevation(p, far.source_p_e) < sine_of_mask && 10 * ++hidden > bursts_.size()) {
        return false;
      }
      const double later = (far.delay_s - b.near.delay_s) / (1.0 - far.delay_rate);
      const Vector2d r = b.observed.z - kSpeedOfLightMps * Vector2d(later, far.delay_rate - b.near.delay_rate);
      const double w0 = 1.0 / (b.observed.R(0, 0) + at_range * at_range);
      const double w1 = 1.0 / (b.observed.R(1, 1) + at_rate * at_rate);
      const double t = b.m->t_s - bursts_.front().m->t_s;
      n00 += w0;
      n01 += w0 * t;
      n11 += w0 * t * t + w1;
      b0 += w0 * r[0];
      b1 += w0 * t * r[0] + w1 * r[1];
      sum += w0 * r[0] * r[0] + w1 * r[1] * r[1];
    }
    const double determinant = n00 * n11 - n01 * n01;
    const double theta = (n11 * b0 - n01 * b1) / determinant;
    const double alpha = (n00 * b1 - n01 * b0) / determinant;
    cost = sum - theta * b0 - alpha * b1;
    return std::isfinite(cost);
  }

  // A Kalman filter over all bursts, linearised along p + v t with theta and alpha as they come. `p_sigma_m` says how
  // freely the position may leave p.
  struct Pass {
    PairVector mean;
    PairSquare P;
    double chi_square = 0.0;
    int rows = 0;
    std::vector<double> nis;  // of each burst
    Eigen::VectorXd whole;    // mean and covariance with the along-track errors
    Eigen::MatrixXd whole_P;
  };
  [[nodiscard]] bool pass(const Vector3d& p, const Vector3d& v, double p_sigma_m, Pass& out) const {
    const double first_s = bursts_.front().m->t_s;
    PairVector at;
    at << p, v, 0.0, 0.0;
    LinearPair<> rows;
    double theta = 0.0, alpha = 0.0;
    int alphas = 0;
    for (const Burst& b : bursts_) {
      if (!b.used) continue;
      at.head<3>() = p + (b.m->t_s - first_s) * v;
      if (!rows.linearise(b.model, at, 0.0)) return false;
      if (alphas == 0) theta = b.observed.z[0] - rows.rows.value[0];
      alpha += b.observed.z[1] - rows.rows.value[1];
      ++alphas;
    }
    if (alphas == 0) return false;
    alpha /= alphas;
    PairVector x0, sigma;
    x0 << p, Vector3d::Zero(), theta, alpha;
    sigma << Vector3d::Constant(p_sigma_m), Vector3d::Constant(o_.velocity_sigma_mps), kThetaSigmaM, o_.alpha_sigma_mps;
    filter_->restart(first_s, x0, PairSquare(sigma.cwiseAbs2().asDiagonal()));
    for (const int number : ahead_) {
      if (!filter_->join_along_track(number, o_.orbit_sigma_m[static_cast<std::size_t>(number)])) return false;
    }
    if (std::isfinite(o_.height_sigma_m)) {
      Vector3d on, normal;
      if (!to_height(p, o_.height_m, on, normal)) return false;
      const auto held = filter_->update(PlaneDistance<>{normal, on}, 0.0, o_.height_sigma_m * o_.height_sigma_m);
      if (!held.accepted()) return false;
      out.chi_square = held.nis;
      out.rows = 1;
    } else {
      out.chi_square = 0.0;
      out.rows = 0;
    }
    out.nis.assign(bursts_.size(), 0.0);
    double now = first_s;
    for (std::size_t i = 0; i < bursts_.size(); ++i) {
      const Burst& b = bursts_[i];
      const double dt = b.m->t_s - now;
      if (dt > 0.0 && filter_->predict(dt, nullptr) != UpdateStatus::kAccepted) return false;
      now = b.m->t_s;
      at << p + (now - first_s) * v, v, filter_->mean().tail<2>();
      if (!rows.linearise(b.model, at, 0.0)) return false;
      Eigen::Matrix2d R = b.observed.R;
      const double deviation = sigma_of(b);
      double known = 0.0, left = 0.0;
      if (deviation > 0.0 && !filter_->along_track(b.m->beacon, known, left)) {
        // One error in n bursts, taken for n of their own: n times the variance leaves no more said of it.
        const double variance = bursts_of_[static_cast<std::size_t>(b.m->beacon)] * deviation * deviation;
        R += variance * rows.rows.along_track * rows.rows.along_track.transpose();
      }
      // Left out: what it would have said is asked all the same, by a gate that nothing passes.
      const auto report = filter_->update(rows, b.m->beacon, {b.observed.z, R}, b.used ? Gate{} : Gate{.nis = -1.0});
      out.nis[i] = report.nis;
      if (!b.used) continue;
      if (!report.accepted()) return false;
      out.chi_square += report.nis;
      out.rows += 2;
    }
    out.mean = filter_->mean();
    out.P = filter_->covariance();
    out.whole = filter_->whole_mean();
    out.whole_P = filter_->whole_covariance();
    return out.mean.allFinite() && std::isfinite(out.chi_square);
  }

  // Damped Gauss-Newton steps from `p`. False when none descends to rest.
  [[nodiscard]] bool follow(Vector3d p, Pass& out, int& iterations) const {
    Vector3d v = Vector3d::Zero();
    double trust = 0.5 * std::max(o_.cell_m, 1e5);
    Pass pinned, free, trial;
    if (!pass(p, v, kPinnedSigmaM, pinned)) return false;
    const double span = bursts_.back().m->t_s - bursts_.front().m->t_s;
    for (iterations = 1; iterations <= kMostIterations; ++iterations) {
      if (!pass(p, v, trust, free)) return false;
      const Vector3d next_v = free.mean.segment<3>(3);
      Vector3d next = free.mean.head<3>() - span * next_v;
      Vector3d on, normal;
      // The height is held in the plane that touches the ellipsoid at p: a long step is taken along the ellipsoid.
      if (std::isfinite(o_.height_sigma_m) && (next - p).norm() > 1e3) {
        if (!to_height(next, o_.height_m, on, normal)) return false;
        next = on;
      }
      const double moved = (next - p).norm();
      const double sigma = std::sqrt(free.P.topLeftCorner<3, 3>().trace());
      const bool better = pass(next, next_v, kPinnedSigmaM, trial) && trial.chi_square <= pinned.chi_square + 1e-3;
      if (better) {
        p = next;
        v = next_v;
        pinned = trial;
        trust = std::min(4.0 * trust, kFreeSigmaM);
      } else {
        trust = std::min(0.3 * trust, 0.5 * moved);
      }
      // A target that moves under noise has no straight way: a step well inside the uncertainty is rest.
      const double rest = std::max(1e-2, (o_.acceleration_psd_m2ps3 > 0.0 ? 0.1 : 1e-3) * sigma);
      if (moved < rest) return pass(p, v, kFreeSigmaM, out);
      if (trust < 1e-2) return false;
    }
    return false;
  }

  [[nodiscard]] double gate() const noexcept { return gate_; }

 private:
  [[nodiscard]] double sigma_of(const Burst& b) const noexcept {
    if (o_.orbit_sigma_m.empty() || b.model.beacon->is_fixed()) return 0.0;
    return o_.orbit_sigma_m[static_cast<std::size_t>(b.m->beacon)];
  }

  PairStartOptions o_;
  std::unique_ptr<LinearisedFilter> filter_;
  double gate_;
  std::vector<Burst> bursts_;
  std::vector<int> ahead_;      // beacons whose along-track error is a state, last heard first
  std::vector<int> bursts_of_;  // of each beacon
};

struct Cell {
  Vector3d p;
  double cost;
};

// Places to begin at: the middle, and the best cells of the grid, no two of them neighbours.
std::vector<Vector3d> candidates(const Batch& batch, const Vector3d& middle, const PairStartOptions& o, int& seen) {
  std::vector<Vector3d> places;
  Vector3d on, up;
  if (!to_height(middle, o.height_m, on, up)) return places;
  if (o.search_radius_m <= 0.0) return {on};
  const Vector3d east = (std::abs(up.z()) < 0.999 ? Vector3d::UnitZ() : Vector3d::UnitX()).cross(up).normalized();
  const Vector3d north = up.cross(east);
  const int n = static_cast<int>(std::ceil(o.search_radius_m / o.cell_m));
  std::vector<Cell> cells;
  for (int i = -n; i <= n; ++i) {
    for (int j = -n; j <= n; ++j) {
      const double away = o.cell_m * std::hypot(i, j);
      if (away > o.search_radius_m + 0.5 * o.cell_m) continue;
      const double angle = away / wgs84::kSemiMajorAxisM;
      Vector3d q = on;
      if (away > 0.0) {
        const Vector3d side = (i * east + j * north).normalized();
        q = on.norm() * (std::cos(angle) * on.normalized() + std::sin(angle) * side);
      }
      Cell cell{};
      Vector3d normal;
      if (!to_height(q, o.height_m, cell.p, normal) || !batch.misfit(cell.p, cell.cost)) continue;
      cells.push_back(cell);
    }
  }
  seen = static_cast<int>(cells.size());
  std::sort(cells.begin(), cells.end(), [](const Cell& a, const Cell& b) { return a.cost < b.cost; });
  for (const Cell& cell : cells) {
    const bool apart = std::all_of(places.begin(), places.end(),
                                   [&](const Vector3d& p) { return (p - cell.p).norm() > 1.6 * o.cell_m; });
    if (apart) places.push_back(cell.p);
    if (static_cast<int>(places.size()) >= o.candidates) break;
  }
  double cost = 0.0;
  if (!places.empty() && batch.misfit(on, cost)) places.push_back(on);
  return places;
}

}  // namespace

std::string_view to_string(PairStartStatus status) noexcept {
  switch (status) {
    case PairStartStatus::kFound:
      return "found";
    case PairStartStatus::kAmbiguous:
      return "ambiguous";
    case PairStartStatus::kVague:
      return "vague";
    case PairStartStatus::kPoorFit:
      return "poor fit";
    case PairStartStatus::kNotConverged:
      return "not converged";
    case PairStartStatus::kNoView:
      return "no view";
    case PairStartStatus::kTooFew:
      return "too few";
  }
  return "unknown";
}

void PairStartOptions::check() const {
  using pair_options::positive;
  using pair_options::refuse;
  using pair_options::zero_or_more;
  zero_or_more("clock_noise.white_frequency_m2ps", clock_noise.white_frequency_m2ps);
  zero_or_more("clock_noise.frequency_walk_m2ps3", clock_noise.frequency_walk_m2ps3);
  zero_or_more("acceleration_psd_m2ps3", acceleration_psd_m2ps3);
  zero_or_more("search_radius_m", search_radius_m);
  if (!std::isfinite(anchor_drift_mps)) refuse("anchor_drift_mps", anchor_drift_mps, "a finite number expected");
  for (const double sigma : orbit_sigma_m) zero_or_more("orbit_sigma_m", sigma);
  positive("velocity_sigma_mps", velocity_sigma_mps);
  positive("cell_m", cell_m);
  positive("ambiguous_chi_square", ambiguous_chi_square);
  positive("alpha_sigma_mps", alpha_sigma_mps);
  positive("max_sigma_m", max_sigma_m);
  if (!(height_sigma_m > 0.0)) refuse("height_sigma_m", height_sigma_m, "a positive number or infinity expected");
  if (!(std::abs(height_m) <= 1e5)) refuse("height_m", height_m, "-1e5 ... 1e5 expected");
  if (!(std::abs(mask_rad) < kPi / 2)) refuse("mask_rad", mask_rad, "between -pi/2 and pi/2 expected");
  if (candidates < 1 || candidates > 64) refuse("candidates", candidates, "1 ... 64 expected");
  if (min_bursts < 3) refuse("min_bursts", min_bursts, "3 or more expected");
  if (search_radius_m / cell_m > 500.0) refuse("cell_m", cell_m, "at least a 500th of search_radius_m expected");
  if (guess_p_e && !geometry::ecef_to_geodetic(*guess_p_e)) {
    throw std::invalid_argument("guess_p_e: three finite numbers, 1e6 ... 1e15 m from the Earth's centre, expected");
  }
}

PairStart start_pair(std::span<const geometry::SampledOrbit> beacons, std::span<const PairMeasurement> measurements,
                     const PairStartOptions& options) {
  options.check();
  if (!options.orbit_sigma_m.empty() && options.orbit_sigma_m.size() != beacons.size()) {
    throw std::invalid_argument("orbit_sigma_m: " + std::to_string(options.orbit_sigma_m.size()) +
                                " numbers; one for each of " + std::to_string(beacons.size()) + " beacons expected");
  }
  PairStart result;
  result.used.assign(measurements.size(), 0);
  Batch batch(beacons, measurements, options);
  if (static_cast<int>(batch.bursts().size()) < options.min_bursts) return result;
  result.t_s = batch.bursts().back().m->t_s;
  const Vector3d middle = options.guess_p_e.value_or(batch.bursts().front().m->anchor_p_e);
  const std::vector<Vector3d> places = candidates(batch, middle, options, result.cells);
  if (places.empty()) {
    result.status = PairStartStatus::kNoView;
    return result;
  }

  struct Found {
    Vector3d from;
    Batch::Pass pass;
    int iterations;
  };
  std::vector<Found> found;
  for (const Vector3d& place : places) {
    Found f{place, {}, 0};
    if (batch.follow(place, f.pass, f.iterations)) found.push_back(std::move(f));
  }
  if (found.empty()) {
    result.status = PairStartStatus::kNotConverged;
    return result;
  }
  const auto by_fit = [](const Found& a, const Found& b) { return a.pass.chi_square < b.pass.chi_square; };
  std::sort(found.begin(), found.end(), by_fit);
  constexpr int kDirections = 5;  // position, theta, alpha; the velocity has its prior
  const auto fits = [&](const Batch::Pass& pass) {
    return pass.chi_square <= chi_square_upper_quantile(kOutlierProbability, std::max(pass.rows - kDirections, 1));
  };
  const auto follow_on = [&] {
    std::vector<Found> again;
    const double span = batch.bursts().back().m->t_s - batch.bursts().front().m->t_s;
    for (const Found& f : found) {
      Found g{f.pass.mean.head<3>() - span * f.pass.mean.segment<3>(3), {}, 0};
      if (batch.follow(g.from, g.pass, g.iterations)) again.push_back(std::move(g));
    }
    if (again.empty()) return false;
    found = std::move(again);
    std::sort(found.begin(), found.end(), by_fit);
    return true;
  };
  // Bursts that contradict the best are left out, the worst first, and it is followed on; those that turn out to fit
  // come back.
  const std::size_t most = batch.bursts().size() / 5;
  std::size_t out = 0;
  while (out < most && !fits(found[0].pass)) {
    const std::vector<double>& nis = found[0].pass.nis;
    double worst = batch.gate();
    for (std::size_t i = 0; i < nis.size(); ++i) {
      if (batch.bursts()[i].used) worst = std::max(worst, nis[i]);
    }
    const std::size_t before = out;
    for (std::size_t i = 0; i < nis.size() && out < most; ++i) {
      Burst& b = batch.bursts()[i];
      if (!b.used || !(nis[i] > std::max(batch.gate(), 0.5 * worst))) continue;
      b.used = false;
      ++out;
    }
    if (out == before || !follow_on()) break;
  }
  if (out > 0 && fits(found[0].pass)) {
    bool back = false;
    for (std::size_t i = 0; i < found[0].pass.nis.size(); ++i) {
      Burst& b = batch.bursts()[i];
      if (b.used || !(found[0].pass.nis[i] < batch.gate())) continue;
      b.used = back = true;
    }
    if (back) static_cast<void>(follow_on());
  }

  const auto solution = [](const Batch::Pass& pass) { return PairSolution{pass.mean, pass.P, pass.chi_square}; };
  const Batch::Pass& best = found[0].pass;
  result.best = solution(best);
  result.along_track = batch.along_track();
  result.along_track_m = best.whole.tail(static_cast<Eigen::Index>(result.along_track.size()));
  result.joint_covariance = best.whole_P;
  result.iterations = found[0].iterations;
  result.degrees_of_freedom = best.rows - kDirections;
  for (const Burst& b : batch.bursts()) result.used[b.index] = b.used ? 1 : 0;
  const double sigma = std::sqrt(best.P.topLeftCorner<3, 3>().trace());
  for (const Found& f : found) {
    if (f.pass.chi_square > best.chi_square + options.ambiguous_chi_square) break;
    // One and the same where the best one's own covariance says so, in every direction.
    const detail::CholeskyFactor<Eigen::Matrix3d> root(Eigen::Matrix3d(best.P.topLeftCorner<3, 3>()));
    const auto near = [&](const PairVector& mean) {
      Vector3d apart = (mean - f.pass.mean).head<3>();
      if (apart.norm() < 100.0) return true;
      root.whiten(apart);
      return root.definite && apart.squaredNorm() < kSameSigmas * kSameSigmas;
    };
    const bool known = near(best.mean) || std::any_of(result.alternatives.begin(), result.alternatives.end(),
                                                      [&](const PairSolution& s) { return near(s.mean); });
    if (!known) result.alternatives.push_back(solution(f.pass));
  }
  result.status = !fits(best)                      ? PairStartStatus::kPoorFit
                  : !result.alternatives.empty()   ? PairStartStatus::kAmbiguous
                  : !(sigma < options.max_sigma_m) ? PairStartStatus::kVague
                                                   : PairStartStatus::kFound;
  return result;
}

}  // namespace soopnav::navigation
