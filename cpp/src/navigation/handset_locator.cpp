#include "soopnav/navigation/handset_locator.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <sstream>
#include <stdexcept>

#include "navigation/handset_cloud.hpp"
#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::navigation {
namespace {

void require(bool holds, std::string_view name, double value, std::string_view rule) {
  if (holds) return;
  std::ostringstream text;
  text << name << ": " << value << "; " << rule;
  throw std::invalid_argument(text.str());
}
void positive(std::string_view name, double value) {
  require(value > 0.0 && std::isfinite(value), name, value, "a positive number expected");
}
void not_negative(std::string_view name, double value) {
  require(value >= 0.0 && std::isfinite(value), name, value, "at least 0 expected");
}

// Symmetric, finite and without a negative variance. Off-diagonals beyond what a covariance may have would make
// weights of NaN later.
template <int N>
bool is_covariance(const Eigen::Matrix<double, N, N>& m) noexcept {
  if (!m.allFinite()) return false;
  const double scale = m.diagonal().cwiseAbs().maxCoeff();
  if ((m - m.transpose()).cwiseAbs().maxCoeff() > 1e-9 * scale) return false;
  Eigen::Matrix<double, N, N> lifted = m;
  lifted.diagonal().array() += 1e-9 * scale + 1e-300;
  return Eigen::LLT<Eigen::Matrix<double, N, N>>(lifted).info() == Eigen::Success;
}

}  // namespace

std::string_view to_string(HandsetFilter filter) noexcept {
  switch (filter) {
    case HandsetFilter::kControl:
      return "control";
    case HandsetFilter::kMeasurement:
      return "measurement";
  }
  return "unknown";
}

std::string_view to_string(HandsetClock clock) noexcept {
  switch (clock) {
    case HandsetClock::kCommon:
      return "common";
    case HandsetClock::kSeparate:
      return "separate";
  }
  return "unknown";
}

std::string_view to_string(HandsetUse use) noexcept {
  switch (use) {
    case HandsetUse::kUsed:
      return "used";
    case HandsetUse::kNotFinite:
      return "not finite";
    case HandsetUse::kOutOfOrder:
      return "out of order";
    case HandsetUse::kClocksDisagree:
      return "clocks disagree";
    case HandsetUse::kNothingHeard:
      return "nothing heard";
    case HandsetUse::kCoasted:
      return "coasted";
    case HandsetUse::kOutliers:
      return "outliers";
    case HandsetUse::kRecovered:
      return "recovered";
    case HandsetUse::kWalls:
      return "walls ignored";
    case HandsetUse::kTooFast:
      return "too fast";
  }
  return "unknown";
}

std::string_view to_string(HandsetStatus status) noexcept {
  switch (status) {
    case HandsetStatus::kStarting:
      return "starting";
    case HandsetStatus::kTracking:
      return "tracking";
    case HandsetStatus::kCoasting:
      return "coasting";
    case HandsetStatus::kCameraOnly:
      return "camera only";
    case HandsetStatus::kDeadTime:
      return "dead time";
  }
  return "unknown";
}

HandsetOptions HandsetOptions::lte_alone(std::vector<Eigen::Vector3d> nodes) {
  HandsetOptions o;
  o.nodes_m = std::move(nodes);
  o.filter = HandsetFilter::kMeasurement;
  o.particles = 1;
  o.kernel = 1.0;
  o.kernel_m = o.start_sigma_m;
  o.kernel_rad = kPi;
  o.nlos = false;
  o.outlier_probability = 0.0;
  o.turn_psd_rad2ps = 0.0;
  return o;
}

void HandsetOptions::check() const {
  require(particles >= 1 && particles <= 1000000, "particles", static_cast<double>(particles),
          "1 ... 1 000 000 expected");
  require(ess_threshold > 0.0 && ess_threshold <= 1.0, "ess_threshold", ess_threshold, "in (0, 1] expected");
  require(!nodes_m.empty() && nodes_m.size() <= static_cast<std::size_t>(kMaxHandsetNodes), "nodes_m",
          static_cast<double>(nodes_m.size()), "1 ... 12 nodes expected");
  for (const auto& q : nodes_m) require(q.allFinite(), "nodes_m", q.sum(), "finite numbers expected");
  require(node_sigma_m.empty() || node_sigma_m.size() == nodes_m.size(), "node_sigma_m",
          static_cast<double>(node_sigma_m.size()), "a number for each node, or none, expected");
  for (const double s : node_sigma_m) not_negative("node_sigma_m", s);
  require(std::isfinite(height_m), "height_m", height_m, "a finite number expected");
  require(start_m.allFinite(), "start_m", start_m.sum(), "finite numbers expected");
  positive("start_sigma_m", start_sigma_m);
  require(std::isfinite(start_heading_rad), "start_heading_rad", start_heading_rad, "a finite number expected");
  positive("start_heading_sigma_rad", start_heading_sigma_rad);
  require(kernel > 0.0 && kernel <= 1.0, "kernel", kernel, "in (0, 1] expected");
  positive("kernel_m", kernel_m);
  positive("kernel_rad", kernel_rad);
  require(std::isfinite(clock_start_m), "clock_start_m", clock_start_m, "a finite number expected");
  positive("clock_sigma_m", clock_sigma_m);
  not_negative("clock_noise.white_frequency_m2ps", clock_noise.white_frequency_m2ps);
  not_negative("clock_noise.frequency_walk_m2ps3", clock_noise.frequency_walk_m2ps3);
  not_negative("clock_drift_sigma_mps", clock_drift_sigma_mps);
  not_negative("node_offset_sigma_m", node_offset_sigma_m);
  not_negative("node_offset_walk_m2ps", node_offset_walk_m2ps);
  positive("mean_los_s", mean_los_s);
  positive("mean_nlos_s", mean_nlos_s);
  not_negative("excess_min_m", excess_min_m);
  require(excess_max_m > excess_min_m && std::isfinite(excess_max_m), "excess_max_m", excess_max_m,
          "above excess_min_m expected");
  not_negative("excess_walk_m2ps", excess_walk_m2ps);
  not_negative("multipath_sigma_m", multipath_sigma_m);
  positive("multipath_length_m", multipath_length_m);
  require(outlier_probability >= 0.0 && outlier_probability < 0.5, "outlier_probability", outlier_probability,
          "in [0, 0.5) expected");
  positive("outlier_span_m", outlier_span_m);
  require(recover_after >= 1, "recover_after", recover_after, "at least 1 expected");
  not_negative("acceleration_psd_m2ps3", acceleration_psd_m2ps3);
  positive("start_speed_sigma_mps", start_speed_sigma_mps);
  not_negative("turn_psd_rad2ps", turn_psd_rad2ps);
  not_negative("coast_psd_m2ps", coast_psd_m2ps);
  not_negative("coast_turn_psd_rad2ps", coast_turn_psd_rad2ps);
  positive("coast_after_s", coast_after_s);
  not_negative("max_disagreement_s", max_disagreement_s);
  positive("max_speed_mps", max_speed_mps);
  require(room_m.empty() || room_m.size() >= 3, "room_m", static_cast<double>(room_m.size()),
          "at least 3 corners, or none, expected");
  for (const auto& p : room_m) require(p.allFinite(), "room_m", p.sum(), "finite numbers expected");
  for (const auto& w : walls_m) require(w.allFinite(), "walls_m", w.sum(), "finite numbers expected");
}

struct HandsetLocator::Impl {
  HandsetOptions options;
  detail::HandsetCloud cloud;
  RandomStream plot;
  mutable std::vector<Eigen::Vector2d> places;  // scratch of estimate()
  // Times: of the state, of the last frame, of the last radio epoch; NaN before the first.
  double now = 0.0, frame = 0.0, epoch = 0.0;
  bool started = false, chained = false;  // chained: the next increment starts at the state
  Eigen::Vector2d step_b_mps = Eigen::Vector2d::Zero();
  double turn_radps = 0.0;
  int bad_epochs = 0;
  double walked_m = 0.0;                            // since the last radio epoch
  std::array<double, kMaxHandsetNodes> heard_at{};  // each link's last range: its Boolean's chain runs from there
  std::array<double, kMaxHandsetNodes> silent_s{};

  explicit Impl(const HandsetOptions& o) : options((o.check(), o)), cloud(o), places(o.particles) { reset(o.seed); }

  void reset(std::uint64_t seed) noexcept {
    options.seed = seed;
    cloud.start(seed);
    plot = RandomStream(seed, 0x4A5F);
    now = frame = epoch = HandsetEstimate::kNan;
    started = chained = false;
    step_b_mps.setZero();
    turn_radps = 0.0;
    bad_epochs = 0;
    walked_m = 0.0;
    heard_at.fill(HandsetEstimate::kNan);
  }

  [[nodiscard]] bool type2() const noexcept { return options.filter == HandsetFilter::kMeasurement; }
  void resample_if_few() noexcept {
    if (cloud.ess() < options.ess_threshold * static_cast<double>(cloud.count())) cloud.resample();
  }

  // The state goes on to `t` without a camera.
  void drift_to(double t) noexcept {
    const double dt = t - now;
    if (!(dt > 0.0)) return;
    if (type2()) {
      cloud.advance(dt);
      // Up to `coast_after_s` after a frame the next step is still to come, and says how far this was.
      if (!(t - frame <= options.coast_after_s)) walked_m += options.start_speed_sigma_mps * dt;
    } else {
      walked_m += options.start_speed_sigma_mps * dt;
      cloud.leave_foot();
      cloud.diffuse(options.coast_psd_m2ps * dt, options.coast_turn_psd_rad2ps * dt);
    }
    now = t;
  }

  // The cloud began anew: what else is remembered of the walk goes as well, but for the times.
  HandsetUse restarted() noexcept {
    step_b_mps.setZero();
    turn_radps = 0.0;
    bad_epochs = 0;
    chained = false;
    heard_at.fill(HandsetEstimate::kNan);
    return HandsetUse::kRecovered;
  }

  HandsetReport after_motion(HandsetReport report) noexcept {
    if (!cloud.keep_inside()) report.use = HandsetUse::kWalls;
    double evidence = 0.0;
    if (!cloud.settle(evidence)) report.use = restarted();
    report.ess = cloud.ess();
    return report;
  }

  HandsetUse check_frame(double t) const noexcept {
    if (!std::isfinite(t)) return HandsetUse::kNotFinite;
    if (std::isfinite(frame) && t <= frame) return HandsetUse::kOutOfOrder;
    if (std::isfinite(epoch) && t < epoch - options.max_disagreement_s) return HandsetUse::kClocksDisagree;
    return HandsetUse::kUsed;
  }

  HandsetReport move(const HandsetMotion& m, double t) noexcept {
    HandsetReport report;
    report.ess = cloud.ess();
    report.use = check_frame(t);
    if (!m.increment.allFinite() || !is_covariance<3>(m.track_covariance) ||
        !is_covariance<2>(m.foot_covariance_previous) || !is_covariance<2>(m.foot_covariance)) {
      report.use = HandsetUse::kNotFinite;
    }
    if (report.use != HandsetUse::kUsed) return report;
    if (std::isfinite(frame) && !chained) return coast(t);  // it starts before what the state has gone through
    const double since = std::isfinite(frame) ? t - frame : 1.0;
    if (m.increment.head<2>().stableNorm() > options.max_speed_mps * since || std::abs(m.increment[2]) > kTwoPi) {
      report = coast(t);
      if (report.use == HandsetUse::kCoasted) report.use = HandsetUse::kTooFast;
      return report;
    }
    resample_if_few();
    walked_m += m.increment.head<2>().norm();
    if (!cloud.feet()) cloud.enter_foot(m.foot_covariance_previous);
    if (type2()) {
      if (std::isfinite(now)) {
        cloud.recede(now - t);  // a frame that comes after a later epoch
        cloud.advance(t - now);
        cloud.observe_motion(m);
        cloud.advance(now - t);
      } else {  // nothing to be compared with: only the turn is known
        HandsetMotion first = m;
        first.track_covariance.topLeftCorner<2, 2>().diagonal().array() += 1e4;
        cloud.observe_motion(first);
      }
    } else {
      cloud.move(m);
    }
    const double dt = std::isfinite(frame) ? t - frame : 0.0;
    if (dt > 0.0) {
      const double c = std::cos(m.increment[2]), s = std::sin(m.increment[2]);
      step_b_mps = Eigen::Vector2d(c * m.increment[0] + s * m.increment[1], c * m.increment[1] - s * m.increment[0]) /
                   dt;  // in the present body's axes
      turn_radps = m.increment[2] / dt;
    }
    now = type2() ? std::fmax(now, t) : t;
    frame = t;
    started = chained = true;
    return after_motion(report);
  }

  HandsetReport coast(double t) noexcept {
    HandsetReport report;
    report.ess = cloud.ess();
    report.use = check_frame(t);
    if (report.use != HandsetUse::kUsed) return report;
    report.use = HandsetUse::kCoasted;
    if (std::isfinite(now)) {
      if (type2() && t - frame <= options.coast_after_s) walked_m += options.start_speed_sigma_mps * (t - frame);
      drift_to(t);
    } else {
      now = t;
    }
    cloud.leave_foot();
    const double late = type2() ? now - t : 0.0;
    cloud.recede(late);
    cloud.begin_movement();
    cloud.advance(late);
    frame = t;
    step_b_mps.setZero();
    turn_radps = 0.0;
    started = chained = true;
    return after_motion(report);
  }

  // Where the state is brought for an epoch of the radio; false when it is not to be used.
  HandsetUse begin_epoch(double t) noexcept {
    if (!std::isfinite(t)) return HandsetUse::kNotFinite;
    if (std::isfinite(epoch) && t < epoch) return HandsetUse::kOutOfOrder;
    if (std::isfinite(frame) && t < frame - options.max_disagreement_s) return HandsetUse::kClocksDisagree;
    resample_if_few();
    if (type2()) {
      if (std::isfinite(now)) drift_to(t);
      if (!std::isfinite(now) || t > now) now = t;
    } else if (std::isfinite(frame) ? t - frame > options.coast_after_s : std::isfinite(now)) {
      step_b_mps.setZero();
      drift_to(t);
      chained = false;
    } else if (!std::isfinite(now)) {
      now = t;
    }
    return HandsetUse::kUsed;
  }
  // From the pose to the handset at `t`, in the body's axes.
  [[nodiscard]] Eigen::Vector2d ahead(double t) const noexcept {
    if (!std::isfinite(frame) || (t > frame && now > frame && !type2())) return Eigen::Vector2d::Zero();
    if (type2()) return t < now ? Eigen::Vector2d(step_b_mps * (t - now)) : Eigen::Vector2d::Zero();
    return step_b_mps * (t - frame);
  }

  HandsetReport finish_epoch(HandsetReport report, double t, double outliers) noexcept {
    const bool inside = cloud.keep_inside();
    const bool settled = cloud.settle(report.log_evidence);
    report.ess = cloud.ess();
    report.outliers = outliers / report.heard;
    epoch = t;
    started = true;
    if (!inside) report.use = HandsetUse::kWalls;
    if (!settled) {
      report.use = restarted();
    } else if (report.outliers > 0.5) {
      report.use = HandsetUse::kOutliers;
      if (++bad_epochs >= options.recover_after) {
        cloud.spread(options.start_sigma_m, std::min(options.start_heading_sigma_rad, kPi));
        bad_epochs = 0;
        report.use = HandsetUse::kRecovered;
      }
    } else {
      bad_epochs = 0;
    }
    return report;
  }

  template <class Weigh>
  HandsetReport update(std::span<const double> z, std::span<const double> sigma, double t,
                       const Weigh& weigh) noexcept {
    HandsetReport report;
    report.ess = cloud.ess();
    if (z.size() != options.nodes_m.size() || sigma.size() != z.size()) {
      report.use = HandsetUse::kNotFinite;
      return report;
    }
    report.use = begin_epoch(t);
    if (report.use != HandsetUse::kUsed) return report;
    for (std::size_t l = 0; l < z.size(); ++l) {
      report.heard += std::isfinite(z[l]) && sigma[l] > 0.0 && std::isfinite(sigma[l]) ? 1 : 0;
    }
    cloud.age_links(std::isfinite(epoch) ? t - epoch : 0.0, walked_m);
    walked_m = 0.0;
    if (report.heard == 0) {
      epoch = t;
      report.use = HandsetUse::kNothingHeard;
      return report;
    }
    return finish_epoch(report, t, weigh());
  }

  [[nodiscard]] HandsetEstimate estimate() const noexcept;
};

HandsetEstimate HandsetLocator::Impl::estimate() const noexcept {
  const detail::HandsetLayout& at = cloud.layout();
  HandsetEstimate e;
  e.nodes = at.links;
  e.node_m.fill(Eigen::Vector2d::Zero());  // Eigen's default is no value
  const std::size_t n = cloud.count();
  const bool has_frame = std::isfinite(frame), has_epoch = std::isfinite(epoch);
  if (has_frame || has_epoch) {
    e.t_s = std::fmax(frame, epoch);
    const bool camera = has_frame && e.t_s - frame <= options.coast_after_s && chained;
    const bool radio = has_epoch && e.t_s - epoch <= options.coast_after_s;
    e.status = camera ? (radio ? HandsetStatus::kTracking : HandsetStatus::kCameraOnly)
                      : (radio ? HandsetStatus::kCoasting : HandsetStatus::kDeadTime);
  }
  const Eigen::Vector2d way = ahead(e.t_s);
  const bool feet = cloud.feet() && !type2();
  // A particle's place now, and its covariance.
  const auto place = [&](std::size_t i, Eigen::Matrix2d& own) {
    const double a = cloud.mean(i, at.heading);
    Eigen::Matrix2d R;
    R << std::cos(a), -std::sin(a), std::sin(a), std::cos(a);
    Eigen::Vector2d b = std::isfinite(way[0]) ? way : Eigen::Vector2d::Zero();
    if (feet) b -= Eigen::Vector2d(cloud.mean(i, at.foot), cloud.mean(i, at.foot + 1));
    for (int r = 0; r < 2; ++r) {
      for (int c = 0; c < 2; ++c) own(r, c) = cloud.covariance(i, r, c);
    }
    if (feet) {
      Eigen::Matrix2d cross, foot;
      for (int r = 0; r < 2; ++r) {
        for (int c = 0; c < 2; ++c) {
          cross(r, c) = cloud.covariance(i, r, at.foot + c);
          foot(r, c) = cloud.covariance(i, at.foot + r, at.foot + c);
        }
      }
      const Eigen::Matrix2d mixed = cross * R.transpose();
      own += R * foot * R.transpose() - mixed - mixed.transpose();
    }
    return Eigen::Vector2d(Eigen::Vector2d(cloud.mean(i, at.x), cloud.mean(i, at.y)) + R * b);
  };
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  Eigen::Matrix2d within = Eigen::Matrix2d::Zero();
  double c = 0.0, s = 0.0, clock = 0.0, clock_square = 0.0;
  Eigen::Vector2d velocity = Eigen::Vector2d::Zero();
  std::array<double, kMaxHandsetNodes> blocked{}, node_square{};
  std::size_t heaviest = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const double w = cloud.weight(i);
    if (w > cloud.weight(heaviest)) heaviest = i;
    if (!(w > 0.0)) continue;
    Eigen::Matrix2d own;
    places[i] = place(i, own);
    mean += w * places[i];
    within += w * own;
    const double a = cloud.mean(i, at.heading);
    const double damped = w * std::exp(-0.5 * cloud.covariance(i, at.heading, at.heading));
    c += damped * std::cos(a);
    s += damped * std::sin(a);
    const double b = cloud.mean(i, at.clock);
    clock += w * b;
    clock_square += w * cloud.covariance(i, at.clock, at.clock);
    if (at.vx >= 0) {
      velocity += w * Eigen::Vector2d(cloud.mean(i, at.vx), cloud.mean(i, at.vy));
    } else {
      velocity += w * Eigen::Vector2d(std::cos(a) * step_b_mps[0] - std::sin(a) * step_b_mps[1],
                                      std::sin(a) * step_b_mps[0] + std::cos(a) * step_b_mps[1]);
    }
    for (int l = 0; l < at.links; ++l) {
      const auto k = static_cast<std::size_t>(l);
      if (cloud.blocked(i, l)) {
        blocked[k] += w;
        e.excess_m[k] += w * cloud.mean(i, at.excess + l);
      }
      if (at.offset >= 0) e.offset_m[k] += w * cloud.mean(i, at.offset + l);
      if (at.offset < 0 && at.clocks > 1) e.offset_m[k] += w * cloud.mean(i, at.clock + l);
      if (at.node[k] >= 0) {
        e.node_m[k] += w * Eigen::Vector2d(cloud.mean(i, at.node[k]), cloud.mean(i, at.node[k] + 1));
        node_square[k] +=
            0.5 * w *
            (cloud.covariance(i, at.node[k], at.node[k]) + cloud.covariance(i, at.node[k] + 1, at.node[k] + 1));
      }
    }
  }
  Eigen::Matrix2d between = Eigen::Matrix2d::Zero();
  for (std::size_t i = 0; i < n; ++i) {
    const double w = cloud.weight(i);
    if (!(w > 0.0)) continue;
    const Eigen::Vector2d d = places[i] - mean;
    between += w * d * d.transpose();
    clock_square += w * std::pow(cloud.mean(i, at.clock) - clock, 2);
    for (int l = 0; l < at.links; ++l) {
      const auto k = static_cast<std::size_t>(l);
      if (at.node[k] < 0) continue;
      const Eigen::Vector2d off =
          Eigen::Vector2d(cloud.mean(i, at.node[k]), cloud.mean(i, at.node[k] + 1)) - e.node_m[k];
      node_square[k] += 0.5 * w * off.squaredNorm();
    }
  }
  for (int l = 0; l < at.links; ++l) {
    const auto k = static_cast<std::size_t>(l);
    e.p_los[k] = 1.0 - std::min(1.0, blocked[k]);
    e.excess_m[k] = blocked[k] > 0.0 ? e.excess_m[k] / blocked[k] : HandsetEstimate::kNan;
    if (at.node[k] < 0) e.node_m[k] = options.nodes_m[k].head<2>();
    e.node_sigma_m[k] = std::sqrt(node_square[k]);
  }
  e.position_m = mean;
  e.covariance_m2 = within + between;
  e.heading_rad = wrap_to_pi(std::atan2(s, c));
  e.heading_sigma_rad = std::sqrt(std::max(0.0, -std::log(std::max(1e-300, c * c + s * s))));
  e.velocity_mps = velocity;
  e.clock_m = clock;
  e.clock_sigma_m = std::sqrt(clock_square);
  e.ess = cloud.ess();
  // The heaviest particle's surroundings, once recentred.
  e.mode_m = places[heaviest];
  for (int pass = 0; pass < 2; ++pass) {
    const Eigen::Matrix2d near = within + 0.01 * Eigen::Matrix2d::Identity();
    const Eigen::LLT<Eigen::Matrix2d> root(near);
    Eigen::Vector2d centre = Eigen::Vector2d::Zero();
    double share = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      const double w = cloud.weight(i);
      if (!(w > 0.0)) continue;
      const Eigen::Vector2d& p = places[i];
      if (root.matrixL().solve(p - e.mode_m).squaredNorm() > 9.0) continue;
      centre += w * p;
      share += w;
    }
    if (share > 0.0) e.mode_m = centre / share;
    e.mode_share = share;
  }
  e.multimodal = e.mode_share < 0.9;
  return e;
}

HandsetLocator::HandsetLocator(const HandsetOptions& options) : impl_(std::make_unique<Impl>(options)) {}
HandsetLocator::HandsetLocator(HandsetLocator&&) noexcept = default;
HandsetLocator& HandsetLocator::operator=(HandsetLocator&&) noexcept = default;
HandsetLocator::~HandsetLocator() = default;

HandsetReport HandsetLocator::move(const HandsetMotion& motion, double t_s) noexcept {
  return impl_->move(motion, t_s);
}
HandsetReport HandsetLocator::coast(double t_s) noexcept { return impl_->coast(t_s); }

HandsetReport HandsetLocator::update_ranges(std::span<const double> range_m, std::span<const double> sigma_m,
                                            double t_s) noexcept {
  return impl_->update(range_m, sigma_m, t_s, [&] {
    for (std::size_t l = 0; l < range_m.size(); ++l) {
      impl_->silent_s[l] = std::isfinite(impl_->heard_at[l]) ? t_s - impl_->heard_at[l] : 0.0;
      if (std::isfinite(range_m[l]) && sigma_m[l] > 0.0) impl_->heard_at[l] = t_s;
    }
    return impl_->cloud.weigh_ranges(range_m, sigma_m, impl_->silent_s, impl_->ahead(t_s));
  });
}

HandsetReport HandsetLocator::update_bearings(std::span<const double> bearing_rad, std::span<const double> sigma_rad,
                                              double t_s, bool of_body, std::span<const double> mirror_rad) noexcept {
  if (!mirror_rad.empty() && mirror_rad.size() != bearing_rad.size()) {
    HandsetReport report;
    report.use = HandsetUse::kNotFinite;
    report.ess = impl_->cloud.ess();
    return report;
  }
  return impl_->update(bearing_rad, sigma_rad, t_s, [&] {
    return impl_->cloud.weigh_bearings(bearing_rad, sigma_rad, mirror_rad, of_body, impl_->ahead(t_s));
  });
}

HandsetEstimate HandsetLocator::estimate() const noexcept { return impl_->estimate(); }

void HandsetLocator::particles(std::span<double> x_m, std::span<double> y_m, std::span<double> heading_rad,
                               std::span<double> weight, bool draw) const noexcept {
  const detail::HandsetCloud& cloud = impl_->cloud;
  const auto& at = cloud.layout();
  RandomStream random = impl_->plot;
  for (std::size_t i = 0; i < cloud.count(); ++i) {
    Eigen::Vector3d p(cloud.mean(i, at.x), cloud.mean(i, at.y), cloud.mean(i, at.heading));
    if (draw) {
      Eigen::Matrix3d own;
      for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) own(r, c) = cloud.covariance(i, r, c);
      }
      own.diagonal().array() += 1e-18;
      const Eigen::Vector3d normal(random.normal(), random.normal(), random.normal());
      const Eigen::LLT<Eigen::Matrix3d> root(own);
      if (root.info() == Eigen::Success) p += root.matrixL() * normal;
    }
    if (i < x_m.size()) x_m[i] = p[0];
    if (i < y_m.size()) y_m[i] = p[1];
    if (i < heading_rad.size()) heading_rad[i] = p[2];
    if (i < weight.size()) weight[i] = cloud.weight(i);
  }
}

void HandsetLocator::reset(std::uint64_t seed) noexcept { impl_->reset(seed); }
const HandsetOptions& HandsetLocator::options() const noexcept { return impl_->options; }
int HandsetLocator::dimension() const noexcept { return impl_->cloud.layout().size; }

}  // namespace soopnav::navigation
