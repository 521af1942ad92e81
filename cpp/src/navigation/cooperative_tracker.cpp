#include "soopnav/navigation/cooperative_tracker.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

#include "navigation/cooperative_checks.hpp"
#include "navigation/cooperative_sight.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/covariance_check.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"
#include "soopnav/geometry/wgs84.hpp"

namespace soopnav::navigation {

namespace {

using Eigen::Vector3d;

constexpr double kAgreeSigmas = 5.0;   // refused bursts that agree with each other do so within this
constexpr double kReopened = 100.0;    // times S: what a jump leaves of a variance, so its burst counts 1 % twice
constexpr double kLeanSquared = 28.4;  // chi-square of one degree at 1e-7: accepted bursts lean to one side
constexpr double kLeanShared = 2.0;    // sigmas that each of two beacons must lean for it to be the frequency
constexpr std::size_t kShortWindow = 5;
constexpr double kMostTdoaS = 1e6;            // eleven days: theta still resolves 0.06 m
constexpr double kMostSkew = 1e-3;            // of a clock
constexpr int kSpareSteps = 8;                // of the smoother, for jumps
constexpr double kOffRoadSigmas = 5.0;        // farther from its road a target is taken to have left it
constexpr double kOrbitSpread = 10.0;         // bursts of a satellite over which its orbit's error is spread first
constexpr double kBatchShare = 2.0;           // 1/2 of what an orbit's error says to the batch, 1/2 to later bursts
constexpr std::size_t kMostBatchOrbits = 24;  // of the batch, whose errors go on

std::unique_ptr<CooperativeFilter> engine_of(const CooperativeOptions& options) {
  options.check();
  return options.form == PairForm::kJoseph ? joseph_filter(options.filter()) : information_filter(options.filter());
}

PairUse use_of(UpdateStatus status) noexcept {
  switch (status) {
    case UpdateStatus::kAccepted:
      return PairUse::kAccepted;
    case UpdateStatus::kGated:
      return PairUse::kGated;
    case UpdateStatus::kUndefined:
      return PairUse::kOutsideEphemeris;
    case UpdateStatus::kNonFinite:
      return PairUse::kNotFinite;
    default:
      return PairUse::kBadState;  // the burst's own covariance was judged before
  }
}

}  // namespace

std::string_view to_string(PairUse use) noexcept {
  switch (use) {
    case PairUse::kAccepted:
      return "accepted";
    case PairUse::kGated:
      return "gated";
    case PairUse::kBelowHorizon:
      return "below the horizon";
    case PairUse::kOutsideEphemeris:
      return "outside the ephemeris";
    case PairUse::kNotFinite:
      return "not finite";
    case PairUse::kNotAdvancing:
      return "time not advancing";
    case PairUse::kUnknownBeacon:
      return "unknown beacon";
    case PairUse::kBadCovariance:
      return "covariance not positive definite";
    case PairUse::kNotStarted:
      return "not started";
    case PairUse::kClockJump:
      return "clock jump";
    case PairUse::kFrequencyJump:
      return "frequency jump";
    case PairUse::kBadState:
      return "state not sound";
  }
  return "unknown";
}

void CooperativeOptions::check() const {
  using pair_options::positive;
  using pair_options::refuse;
  using pair_options::zero_or_more;
  zero_or_more("target_clock.white_frequency_m2ps", target_clock.white_frequency_m2ps);
  zero_or_more("target_clock.frequency_walk_m2ps3", target_clock.frequency_walk_m2ps3);
  zero_or_more("anchor_clock.white_frequency_m2ps", anchor_clock.white_frequency_m2ps);
  zero_or_more("anchor_clock.frequency_walk_m2ps3", anchor_clock.frequency_walk_m2ps3);
  zero_or_more("acceleration_psd_m2ps3", acceleration_psd_m2ps3);
  positive("velocity_sigma_mps", velocity_sigma_mps);
  if (iterations < 1 || iterations > 20) refuse("iterations", iterations, "1 ... 20 expected");
  if (!(gate_probability >= 0.0 && gate_probability < 1.0)) {
    refuse("gate_probability", gate_probability, "0 or more and below 1 expected");
  }
  if (!(std::abs(mask_rad) < kPi / 2)) refuse("mask_rad", mask_rad, "between -pi/2 and pi/2 expected");
  if (!std::isfinite(anchor_drift_mps)) refuse("anchor_drift_mps", anchor_drift_mps, "a finite number expected");
  if (!(std::abs(height_m) <= 1e5)) refuse("height_m", height_m, "-1e5 ... 1e5 expected");
  if (!(height_sigma_m > 0.0)) refuse("height_sigma_m", height_sigma_m, "a positive number or infinity expected");
  positive("road_sigma_m", road_sigma_m);
  if (road_p_e.size() == 1) refuse("road_p_e", 1.0, "none, or two points and more, expected");
  for (std::size_t i = 0; i < road_p_e.size(); ++i) {
    if (!road_p_e[i].allFinite() || (i > 0 && !((road_p_e[i] - road_p_e[i - 1]).norm() > 1e-3))) {
      refuse("road_p_e", static_cast<double>(i),
             "the point of this number: finite, and not on the one before, expected");
    }
  }
  zero_or_more("orbit_sigma_m", orbit_sigma_m);
  zero_or_more("orbit_sigma_mps", orbit_sigma_mps);
  if (along_track_states < 0 || along_track_states > 64) {
    refuse("along_track_states", along_track_states, "0 ... 64 expected");
  }
  if (along_track_states > 0 && !(orbit_sigma_m > 0.0)) {
    refuse("orbit_sigma_m", orbit_sigma_m, "a positive number expected where along_track_states are");
  }
  if (along_track_states > 0 && form == PairForm::kInformation) {
    refuse("along_track_states", along_track_states, "0 expected: the information form has none");
  }
  positive("forget_after_s", forget_after_s);
  if (jump_after < 0) refuse("jump_after", jump_after, "0 or more expected");
  if (smoother_capacity < 0) refuse("smoother_capacity", smoother_capacity, "0 or more expected");
  if (smoother_capacity > 0 && along_track_states > 0) {
    refuse("smoother_capacity", smoother_capacity,
           "0 expected where along_track_states are: p, v and clocks alone are no Markov chain then");
  }
}

PairFilterOptions CooperativeOptions::filter() const noexcept {
  return {.clock_noise = target_clock + anchor_clock,
          .acceleration_psd_m2ps3 = acceleration_psd_m2ps3,
          .iterations = iterations,
          .max_along_track = along_track_states};
}

CooperativeTracker::CooperativeTracker(std::vector<PairBeacon> beacons, const CooperativeOptions& options)
    : CooperativeTracker(std::move(beacons), options, engine_of(options)) {}

CooperativeTracker::CooperativeTracker(std::vector<PairBeacon> beacons, const CooperativeOptions& options,
                                       std::unique_ptr<CooperativeFilter> engine)
    : beacons_(std::move(beacons)), options_(options), engine_(std::move(engine)) {
  options_.check();
  if (beacons_.empty()) throw std::invalid_argument("beacons: at least one expected");
  if (engine_ == nullptr) throw std::invalid_argument("engine: none given");
  if (options_.gate_probability > 0.0) {
    gate_ = Gate::probability(options_.gate_probability, 2);
    single_gate_ = chi_square_upper_quantile(options_.gate_probability, 1);
  } else {
    single_gate_ = std::numeric_limits<double>::infinity();
  }
  heard_t_s_.assign(beacons_.size(), -std::numeric_limits<double>::infinity());
  orbit_uses_.assign(beacons_.size(), 0);
  if (options_.smoother_capacity > 0) {
    smoother_ =
        std::make_unique<RtsSmoother<PositionVelocityClock<EcefFrame, 3>>>(options_.smoother_capacity + kSpareSteps);
    record_t_s_.reserve(static_cast<std::size_t>(smoother_->capacity()));
  }
}

void CooperativeTracker::start_at(double t_s, const PairVector& mean, const PairSquare& P) {
  if (!std::isfinite(t_s)) throw std::invalid_argument("t_s: " + std::to_string(t_s) + "; a finite number expected");
  detail::check_state(mean, "mean");
  check_covariance(P, "covariance", true);
  engine_->restart(t_s, mean, P);
  t_s_ = t_s;
  accepted_t_s_ = t_s;
  started_ = true;
  suspect_ = {};
  waiting_ = {};
  taken_ = 0;
  from_batch_ = false;
  batch_beacons_.clear();
  std::fill(orbit_uses_.begin(), orbit_uses_.end(), 0);
  std::fill(heard_t_s_.begin(), heard_t_s_.end(), -std::numeric_limits<double>::infinity());
  if (smoother_ != nullptr) {
    smoother_->clear();
    record_t_s_.clear();
    smoother_full_ = false;
    spare_used_ = 0;
    step_.predicted.x = step_.filtered.x = mean;
    step_.P_pred = step_.P = P;
    step_.cross.setZero();
    close_step();
    record();
  }
}

PairStart CooperativeTracker::start(std::span<const PairMeasurement> measurements, PairStartOptions search) {
  search.clock_noise = options_.target_clock + options_.anchor_clock;
  search.acceleration_psd_m2ps3 = options_.acceleration_psd_m2ps3;
  search.velocity_sigma_mps = options_.velocity_sigma_mps;
  search.height_m = options_.height_m;
  search.height_sigma_m = options_.height_sigma_m;
  search.mask_rad = options_.mask_rad;
  search.anchor_drift_mps = options_.anchor_drift_mps;
  search.orbit_sigma_m.clear();
  std::vector<geometry::SampledOrbit> orbits;
  orbits.reserve(beacons_.size());
  const double t_s = measurements.empty() ? 0.0 : measurements.front().t_s;
  for (const PairBeacon& beacon : beacons_) {
    orbits.push_back(beacon.orbit);
    // What the batch learns of an orbit is lost to noise: half of its information then, half to the bursts to come.
    const double share = engine_->smoothable() ? std::sqrt(kBatchShare) : 1.0;  // it has no along-track states, or has
    if (options_.orbit_sigma_m > 0.0) search.orbit_sigma_m.push_back(share * orbit_sigma_m(beacon, t_s));
  }
  PairStart found = start_pair(orbits, measurements, search);
  if (found.status != PairStartStatus::kFound && found.status != PairStartStatus::kAmbiguous) return found;
  start_at(found.t_s, found.best.mean, found.best.covariance);
  from_batch_ = true;
  batch_t_s_ = found.t_s;
  for (std::size_t i = 0; i < measurements.size(); ++i) {
    if (found.used[i] == 0) continue;
    const auto number = static_cast<std::size_t>(measurements[i].beacon);
    heard_t_s_[number] = measurements[i].t_s;
    if (measurements[i].t_s == found.t_s) batch_beacons_.push_back(measurements[i].beacon);
  }
  // The errors of orbits go on as the batch left them, those heard last where there is no room for all.
  const std::size_t room =
      std::min({found.along_track.size(), static_cast<std::size_t>(options_.along_track_states), kMostBatchOrbits});
  static_cast<void>(
      engine_->join_along_track(std::span(found.along_track).first(room), found.along_track_m, found.joint_covariance));
  return found;
}

double CooperativeTracker::orbit_sigma_m(const PairBeacon& beacon, double t_s) const noexcept {
  const double age_s = std::isfinite(beacon.epoch_s) ? std::abs(t_s - beacon.epoch_s) : 0.0;
  return options_.orbit_sigma_m + options_.orbit_sigma_mps * (std::isfinite(age_s) ? age_s : 0.0);
}

PairUse CooperativeTracker::check(const PairMeasurement& m, PairObservation& observed) const noexcept {
  if (!started_) return PairUse::kNotStarted;
  if (!pair_observation(m, observed)) return PairUse::kNotFinite;
  if (std::abs(m.tdoa_s) > kMostTdoaS || std::abs(m.fdoa_hz) > kMostSkew * m.carrier_hz) return PairUse::kNotFinite;
  if (m.beacon < 0 || m.beacon >= static_cast<int>(beacons_.size())) return PairUse::kUnknownBeacon;
  if (m.t_s < t_s_) return PairUse::kNotAdvancing;
  // Those that the start used up.
  if (from_batch_ && m.t_s == batch_t_s_ &&
      std::find(batch_beacons_.begin(), batch_beacons_.end(), m.beacon) != batch_beacons_.end()) {
    return PairUse::kNotAdvancing;
  }
  const geometry::SampledOrbit& orbit = beacons_[static_cast<std::size_t>(m.beacon)].orbit;
  geometry::SignalPath path;
  if (!geometry::signal_path(orbit, m.t_s, m.anchor_p_e, m.anchor_v_e, path)) return PairUse::kOutsideEphemeris;
  if (has_horizon(path.source_p_e)) {
    const PairVector mean = engine_->mean();
    const PairSquare P = engine_->covariance();
    // An uncertain target may be where the satellite is up.
    const double dt = m.t_s - t_s_;
    const double variance = P.topLeftCorner<3, 3>().trace() + dt * dt * P.block<3, 3>(3, 3).trace();
    const double margin_rad = 3.0 * std::sqrt(variance) / wgs84::kSemiMajorAxisM;
    const Vector3d p = mean.head<3>() + dt * mean.segment<3>(3);
    const double least = std::sin(std::max(options_.mask_rad - margin_rad, -kPi / 2));
    if (sine_of_elevation(m.anchor_p_e, path.source_p_e) < std::sin(options_.mask_rad) ||
        sine_of_elevation(p, path.source_p_e) < least) {
      return PairUse::kBelowHorizon;
    }
  }
  const double det = observed.R(0, 0) * observed.R(1, 1) - observed.R(0, 1) * observed.R(1, 0);
  if (!(observed.R(0, 0) > 0.0) || !(det > 0.0)) return PairUse::kBadCovariance;
  return PairUse::kAccepted;
}

bool CooperativeTracker::move_to(double t_s) noexcept {
  const double dt = t_s - t_s_;
  step_.cross = engine_->covariance();  // of a step that takes no time
  if (dt > 0.0 && engine_->predict(dt, &step_.cross) != UpdateStatus::kAccepted) return false;
  t_s_ = t_s;
  return true;
}

void CooperativeTracker::hold_to(const Vector3d& normal, const Vector3d& point, double sigma_m) noexcept {
  const PairSquare P = engine_->covariance();
  const double variance = normal.dot(P.topLeftCorner<3, 3>() * normal);
  const double known = sigma_m * sigma_m;
  // Its error stays what it is, so it may never be known better for having been said again (doc eq. 13).
  if (!(variance > 1.0001 * known)) return;
  static_cast<void>(engine_->update(PlaneDistance<>{normal, point}, 0.0, 1.0 / (1.0 / known - 1.0 / variance)));
}

void CooperativeTracker::constrain() noexcept {
  const bool height = std::isfinite(options_.height_sigma_m);
  if (!height && options_.road_p_e.empty()) return;
  const PairVector mean = engine_->mean();
  const Vector3d p = mean.head<3>();
  const auto place = geometry::ecef_to_geodetic(p);
  if (!place) return;
  const Vector3d up = ellipsoid_up(*place);
  if (height) {
    hold_to(up, geometry::geodetic_to_ecef(place->latitude_rad, place->longitude_rad, options_.height_m),
            options_.height_sigma_m);
  }
  if (options_.road_p_e.empty()) return;
  double nearest = std::numeric_limits<double>::infinity();
  Vector3d on = p;
  Vector3d along = Vector3d::UnitX();
  for (std::size_t i = 0; i + 1 < options_.road_p_e.size(); ++i) {
    const Vector3d& a = options_.road_p_e[i];
    const Vector3d side = options_.road_p_e[i + 1] - a;
    const double share = std::clamp((p - a).dot(side) / side.squaredNorm(), 0.0, 1.0);
    const double away = (p - (a + share * side)).squaredNorm();
    if (away < nearest) {
      nearest = away;
      on = a + share * side;
      along = side;
    }
  }
  const Vector3d across = up.cross(along);
  if (!(across.norm() > 0.0)) return;
  const Vector3d normal = across.normalized();
  const double distance = normal.dot(p - on);
  const double variance = normal.dot(engine_->covariance().topLeftCorner<3, 3>() * normal);
  if (distance * distance >
      kOffRoadSigmas * kOffRoadSigmas * (variance + options_.road_sigma_m * options_.road_sigma_m)) {
    return;
  }
  hold_to(normal, on, options_.road_sigma_m);
}

void CooperativeTracker::note_orbit_error(const PairMeasurement& m, const PairModel<>& model,
                                          PairObservation& observed) noexcept {
  if (!(options_.orbit_sigma_m > 0.0) || model.beacon->is_fixed()) return;
  if (options_.along_track_states > 0) {
    int silent = -1;
    for (std::size_t i = 0; i < beacons_.size(); ++i) {
      double mean = 0.0, sigma = 0.0;
      if (!engine_->along_track(static_cast<int>(i), mean, sigma)) continue;
      if (m.t_s - heard_t_s_[i] > options_.forget_after_s) {
        engine_->leave_along_track(static_cast<int>(i));
      } else if (silent < 0 || heard_t_s_[i] < heard_t_s_[static_cast<std::size_t>(silent)]) {
        silent = static_cast<int>(i);
      }
    }
    const double sigma_m = orbit_sigma_m(beacons_[static_cast<std::size_t>(m.beacon)], m.t_s);
    double mean = 0.0, sigma = 0.0;
    const bool held = engine_->along_track(m.beacon, mean, sigma) || engine_->join_along_track(m.beacon, sigma_m);
    if (held) return;
    // No room: the one that was silent longest leaves.
    if (silent >= 0) engine_->leave_along_track(silent);
    if (engine_->join_along_track(m.beacon, sigma_m)) return;
  }
  const PairVector x = engine_->mean();
  PairGeometry g;
  if (!pair_geometry(*model.beacon, m.t_s, {x.head<3>(), x.segment<3>(3)}, {m.anchor_p_e, m.anchor_v_e}, x[6], x[7],
                     options_.anchor_drift_mps, 0.0, g)) {
    return;
  }
  // One error in all bursts of a satellite, taken for errors of their own: variances whose inverses sum to no more than
  // 1 / sigma^2 leave no more said of it than one error says (doc eq. 12a).
  const auto number = static_cast<std::size_t>(m.beacon);
  const double k = kOrbitSpread + static_cast<double>(orbit_uses_[number]);
  const double share = k * (k + 1.0) / kOrbitSpread * (from_batch_ ? kBatchShare : 1.0);
  const double sigma_m = orbit_sigma_m(beacons_[number], m.t_s);
  observed.R += share * sigma_m * sigma_m * g.along_track * g.along_track.transpose();
}

CooperativeTracker::Opening CooperativeTracker::look_for_jump(const PairMeasurement& m,
                                                              const PairReport& report) noexcept {
  if (options_.jump_after == 0) return {};
  const Eigen::Vector2d& r = report.innovation;
  const Eigen::Matrix2d& S = report.covariance;
  const bool rate_fits = r[1] * r[1] <= single_gate_ * S(1, 1);
  // Both kinds must go on as they began: theta's error stays, or grows by that of alpha.
  const int row = rate_fits ? 0 : 1;
  const double apart = r[row] - suspect_.innovation[row];
  const bool agrees = suspect_.run > 0 && suspect_.rate_fits == rate_fits &&
                      apart * apart <= kAgreeSigmas * kAgreeSigmas * (S(row, row) + suspect_.covariance(row, row));
  const bool two = agrees && (suspect_.two_beacons || suspect_.beacon != m.beacon);
  suspect_ = {agrees ? suspect_.run + 1 : 1, r, S, rate_fits, m.beacon, two};
  if (suspect_.run < options_.jump_after) return {};
  if (!rate_fits && !two) {
    // One beacon shows its rate alone, of a place or of a clock: alpha gets vaguer until it fits.
    waiting_ = {.use = PairUse::kFrequencyJump, .alpha_m2ps2 = S(1, 1)};
    return {};
  }
  // The means follow the burst: variances of the square of a jump would leave nothing of the others' to rounding.
  Opening jump;
  jump.use = rate_fits ? PairUse::kClockJump : PairUse::kFrequencyJump;
  if (!rate_fits) {
    jump.alpha_mps = r[1];
    jump.alpha_m2ps2 = kReopened * S(1, 1);
  }
  if (r[0] * r[0] > single_gate_ * S(0, 0)) {
    jump.theta_m = r[0];
    jump.theta_m2 = kReopened * S(0, 0);
  } else {
    jump.theta_m2 = r[0] * r[0];
  }
  return jump;
}

void CooperativeTracker::look_for_lean(int beacon, const PairReport& report) noexcept {
  if (options_.jump_after == 0 || !std::isfinite(single_gate_)) return;
  const Eigen::Vector2d sigmas = report.covariance.diagonal().cwiseSqrt();
  window_[taken_++ % kWindow] = {report.innovation, report.innovation.cwiseQuotient(sigmas), beacon};
  for (const std::size_t n : {kShortWindow, kWindow}) {
    if (taken_ < n) return;
    Eigen::Vector2d sum = Eigen::Vector2d::Zero(), mean = Eigen::Vector2d::Zero();
    double own = 0.0, others = 0.0, of_own = 0.0;
    const auto size = static_cast<double>(n);
    for (std::size_t i = taken_ - n; i < taken_; ++i) {
      const Taken& t = window_[i % kWindow];
      sum += t.sigmas;
      mean += t.innovation / size;
      (t.beacon == beacon ? own : others) += t.sigmas[1];
      of_own += t.beacon == beacon ? 1.0 : 0.0;
    }
    const bool shared = of_own < size && own * others > 0.0 && own * own > kLeanShared * kLeanShared * of_own &&
                        others * others > kLeanShared * kLeanShared * (size - of_own);
    const bool frequency = sum[1] * sum[1] > kLeanSquared * size && shared;
    if (!frequency && !(sum[0] * sum[0] > kLeanSquared * size)) continue;
    // What remained of the bursts is less than the step: the state followed it in part.
    waiting_ = {.use = frequency ? PairUse::kFrequencyJump : PairUse::kClockJump,
                .theta_m2 = 4.0 * mean[0] * mean[0],
                .alpha_m2ps2 = frequency ? 4.0 * mean[1] * mean[1] : 0.0};
    taken_ = 0;
    return;
  }
}

bool CooperativeTracker::open_clock(const Opening& o) noexcept {
  double theta_m2 = o.theta_m2, alpha_m2ps2 = o.alpha_m2ps2;
  if ((o.theta_m != 0.0 || o.alpha_mps != 0.0) &&
      engine_->shift_clock(o.theta_m, o.alpha_mps) != UpdateStatus::kAccepted) {
    theta_m2 += o.theta_m * o.theta_m;
    alpha_m2ps2 += o.alpha_mps * o.alpha_mps;
  }
  return engine_->reopen_clock(theta_m2, alpha_m2ps2) == UpdateStatus::kAccepted;
}

// What was found out by earlier bursts is noise of this prediction; the use of a burst that is then accepted.
PairUse CooperativeTracker::open_waiting() noexcept {
  const Opening opening = std::exchange(waiting_, {});
  const bool opened = opening.use != PairUse::kGated && open_clock(opening);
  return opened ? opening.use : PairUse::kAccepted;
}

void CooperativeTracker::open_step() noexcept {
  if (smoother_ == nullptr) return;
  step_.predicted.x = engine_->mean();
  step_.P_pred = engine_->covariance();
}

void CooperativeTracker::close_step() noexcept {
  if (smoother_ == nullptr) return;
  step_.filtered.x = engine_->mean();
  step_.P = engine_->covariance();
}

void CooperativeTracker::record(bool spare) noexcept {
  if (smoother_ == nullptr || smoother_full_) return;
  if (spare) ++spare_used_;
  const int room = options_.smoother_capacity + std::min(spare_used_, kSpareSteps);
  if (smoother_->size() < room && smoother_->record(step_) == SmoothStatus::kDone) {
    record_t_s_.push_back(t_s_);
  } else {
    smoother_full_ = true;
  }
}

PairReport CooperativeTracker::update(const PairMeasurement& m) noexcept {
  PairReport report;
  PairObservation observed;
  report.use = check(m, observed);
  const auto done = [&]() -> PairReport& {
    ++counts_[static_cast<std::size_t>(report.use)];
    return report;
  };
  if (report.use != PairUse::kAccepted) return done();
  const PairModel<> model{&beacons_[static_cast<std::size_t>(m.beacon)].orbit,
                          m.t_s,
                          m.anchor_p_e,
                          m.anchor_v_e,
                          {},
                          options_.anchor_drift_mps};
  if (!move_to(m.t_s)) {
    report.use = PairUse::kBadState;  // its time is one that can be reached
    return done();
  }
  const PairUse opened = open_waiting();
  open_step();
  constrain();
  const Eigen::Matrix2d noise = observed.R;
  note_orbit_error(m, model, observed);
  const auto take = [&] {
    const auto update = engine_->update(model, m.beacon, observed, gate_);
    report.innovation = update.innovation;
    report.covariance = update.covariance;
    report.nis = update.nis;
    const PairUse use = use_of(update.status);
    const bool burst = use == PairUse::kBadState && soopnav::detail::check_noise(observed.R) != UpdateStatus::kAccepted;
    return burst ? PairUse::kBadCovariance : use;
  };
  report.use = take();
  if (report.use == PairUse::kAccepted) {
    suspect_ = {};
    // An orbit's error within R stays from burst to burst: no lean of a clock's.
    if (observed.R == noise) look_for_lean(m.beacon, report);
    report.use = opened;
    if (opened != PairUse::kAccepted) taken_ = 0;
  } else if (report.use == PairUse::kGated) {
    const Opening jump = look_for_jump(m, report);
    if (jump.use != PairUse::kGated) {
      // The clock alone went astray: a prediction that takes no time, from what was known before it.
      close_step();
      const Step before = step_;
      engine_->save();
      const bool reopened = open_clock(jump);
      open_step();
      const PairUse again = reopened ? take() : PairUse::kGated;
      if (again == PairUse::kAccepted) {
        const Step after = std::exchange(step_, before);
        record(true);
        step_ = after;
        step_.cross = before.P;
        report.use = jump.use;
        suspect_ = {};
        taken_ = 0;
      } else {
        engine_->load();
        step_ = before;
        report.use = again;
      }
    }
  }
  if (report.accepted()) {
    accepted_t_s_ = m.t_s;
    heard_t_s_[static_cast<std::size_t>(m.beacon)] = m.t_s;
    ++orbit_uses_[static_cast<std::size_t>(m.beacon)];
  }
  close_step();
  record();
  return done();
}

bool CooperativeTracker::coast(double t_s) noexcept {
  if (!started_ || !std::isfinite(t_s) || !(t_s > t_s_) || !move_to(t_s)) return false;
  const PairUse opened = open_waiting();
  if (opened != PairUse::kAccepted) waiting_.use = opened;  // the next burst says so
  open_step();
  constrain();
  close_step();
  record();
  return true;
}

PairEstimate CooperativeTracker::estimate() const noexcept {
  if (!started_) return {};
  return {t_s_, engine_->mean(), engine_->covariance(), t_s_ - accepted_t_s_};
}

SmoothStatus CooperativeTracker::smooth() noexcept {
  if (smoother_ == nullptr) return SmoothStatus::kFull;
  const SmoothStatus status = smoother_->smooth();
  return status == SmoothStatus::kDone && smoother_full_ ? SmoothStatus::kFull : status;
}

std::span<const SmoothedState<PositionVelocityClock<EcefFrame, 3>>> CooperativeTracker::smoothed() const noexcept {
  return smoother_ == nullptr ? std::span<const SmoothedState<PositionVelocityClock<EcefFrame, 3>>>{}
                              : smoother_->smoothed();
}

}  // namespace soopnav::navigation
