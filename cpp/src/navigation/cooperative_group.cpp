#include "soopnav/navigation/cooperative_group.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "navigation/cooperative_sight.hpp"
#include "soopnav/clock/two_state.hpp"
#include "soopnav/core/joint_process.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/layout_kalman_filter.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/navigation/cooperative_motion.hpp"

namespace soopnav::navigation {
namespace group_parts {  // no anonymous one: `Inside` has members of them

// Two standard normals that several targets share: of the anchor's clock while they move, of its recording while the
// rows of a burst are taken in.
struct SharedNoiseTag {
  static constexpr std::string_view kName = "shared noise";
};
inline constexpr Role<2, SharedNoiseTag> kShared{};

// Forgets the shared normals and draws them anew.
struct FreshNoise {
  static constexpr int kNoise = 2;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& /*x*/, double /*dt_s*/, const W& /*w*/, Y& y) const {
    y.next(kShared).setZero();
    y.transition(kShared, kShared).setZero();
    y.noise(kShared).setIdentity();
    return true;
  }
};

constexpr double kAgreeSigmas = 5.0;   // refused rows that agree with each other do so within this
constexpr double kReopenSigmas = 3.0;  // of the innovation, that a theta which jumped is left open by

// Refused rows of a target against the anchor that agree on another theta, and what they say.
struct JumpSuspect {
  int run = 0;
  double innovation_m = 0.0;
  double variance_m2 = 0.0;
  double since_s = 0.0;
};

struct Target {
  std::int64_t name = -1;
  Block<kPairDim> state{};  // p, v, theta, alpha
  JumpSuspect suspect{};
  double accepted_s = -std::numeric_limits<double>::infinity();
};

inline bool agree(double a, double a_variance, double b, double b_variance) noexcept {
  return (a - b) * (a - b) <= kAgreeSigmas * kAgreeSigmas * (a_variance + b_variance);
}

using Roles = PositionVelocityClock<EcefFrame, 3>;
static_assert(Roles::kDim == kPairDim && Roles::at(kVelocity) == 3 && Roles::at(kClockBias) == 6);

// A target's block as a state with roles: what models of a single target read and write.
template <class X>
struct RolesOf {
  const X& x;
  const Block<kPairDim>& block;
  template <int Dim, class Tag>
  [[nodiscard]] Eigen::Matrix<double, Dim, 1> operator()(Role<Dim, Tag> role) const {
    return x(block).template segment<Dim>(Roles::at(role));
  }
};
template <class Y>
struct MoveOf {
  static constexpr bool kJacobian = Y::kJacobian;
  Y& y;
  const Block<kPairDim>& block;
  template <int Dim, class Tag>
  [[nodiscard]] auto next(Role<Dim, Tag> role) {
    return Eigen::Map<Eigen::Matrix<double, Dim, 1>>(y.next(block).data() + Roles::at(role));
  }
  template <int To, class ToTag, int From, class FromTag>
  [[nodiscard]] auto transition(Role<To, ToTag> to, Role<From, FromTag> from) {
    return part<To, From>(y.transition(block, block), Roles::at(to), Roles::at(from));
  }
  template <int First, int Count, int Dim, class Tag>
  [[nodiscard]] auto noise(Role<Dim, Tag> role) {
    return part<Dim, Count>(y.noise(block), Roles::at(role), First);
  }

 private:
  template <int Rows, int Columns, class Matrix>
  [[nodiscard]] static auto part(Matrix&& whole, int row, int column) {
    using Map = Eigen::Map<Eigen::Matrix<double, Rows, Columns, Rows == 1 && Columns != 1 ? Eigen::RowMajor : 0>, 0,
                           Eigen::Stride<Eigen::Dynamic, Eigen::Dynamic>>;
    const auto outer = whole.outerStride();
    return Map(whole.data() + row + column * outer, Rows == 1 && Columns != 1
                                                        ? Eigen::Stride<Eigen::Dynamic, Eigen::Dynamic>(1, outer)
                                                        : Eigen::Stride<Eigen::Dynamic, Eigen::Dynamic>(outer, 1));
  }
};

// doc/cooperative_motion.md eq. 8: the target's own motion and clock, less the anchor's clock, whose normals are the
// shared ones; or, taken for independent, of this target alone.
struct GroupProcess {
  using Own = JointProcess<GroundConstantVelocity<>, clock::TwoState<>>;
  static constexpr int kNoise = Own::kNoise;
  Own own;
  clock::ClockNoise anchor;
  bool shared;
  Block<kPairDim> block;

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    MoveOf<Y> mine{y, block};
    if (!own.propagate(RolesOf<X>{x, block}, dt_s, w, mine)) return false;
    if (shared) {
      const double to_drift = std::sqrt(anchor.frequency_walk_m2ps3 * dt_s);
      auto&& from_shared = y.transition(block, kShared);
      from_shared(Roles::at(kClockBias), 0) = -0.5 * dt_s * to_drift;
      from_shared(Roles::at(kClockBias), 1) =
          -std::sqrt(anchor.white_frequency_m2ps * dt_s + anchor.frequency_walk_m2ps3 * dt_s * dt_s * dt_s / 12.0);
      from_shared(Roles::at(kClockDrift), 0) = -to_drift;
    }
    return true;
  }
};

// Shifts a target's theta, and opens it by `sigma_m` of a shared normal: one jump of the anchor's clock is in all
// thetas.
struct ThetaJump {
  static constexpr int kNoise = 1;
  Block<kPairDim> block;
  double shift_m;
  double sigma_m;

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& /*x*/, double /*dt_s*/, const W& /*w*/, Y& y) const {
    y.next(block)[Roles::at(kClockBias)] += shift_m;
    y.transition(block, kShared)(Roles::at(kClockBias), 0) = sigma_m;
    return true;
  }
};

// A row of a burst: a target against the anchor, or the difference of two such; and the noise of its recordings.
struct GroupModel {
  using Frame = EcefFrame;
  static constexpr int kDim = 2;
  const geometry::SampledOrbit* beacon = nullptr;
  double t_s = 0.0;
  PairReceiver anchor{};
  const Target* target = nullptr;
  const Target* reference = nullptr;  // none: the anchor
  Block<2> target_noise{};            // none: it is in R
  Block<2> reference_noise{};
  Eigen::Matrix2d target_factor = Eigen::Matrix2d::Zero();
  Eigen::Matrix2d reference_factor = Eigen::Matrix2d::Zero();
  bool anchor_noise = false;

  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    if (!add(x, *target, 1.0, y)) return false;
    if (reference != nullptr && !add(x, *reference, -1.0, y)) return false;
    if (target_noise.slot >= 0) add_noise(x, target_noise, target_factor, y);
    if (reference_noise.slot >= 0) add_noise(x, reference_noise, reference_factor, y);
    if (anchor_noise) add_noise(x, kShared, reference_factor, y);
    return true;
  }

 private:
  template <class X, class Y>
  [[nodiscard]] bool add(const X& x, const Target& one, double sign, Y& y) const {
    const PairVector now = x(one.state);
    PairGeometry g;
    if (!pair_geometry(*beacon, t_s, {now.head<3>(), now.segment<3>(3)}, anchor, now[6], now[7], 0.0, 0.0, g)) {
      return false;
    }
    for (int i = 0; i < 2; ++i) y.value(i) += sign * g.value[i];
    auto&& H = y.jacobian(one.state);
    H.template leftCols<3>() += sign * g.target_p;
    H.template middleCols<3>(3) += sign * g.target_v;
    H.col(6) += sign * g.theta;
    H.col(7) += sign * g.alpha;
    return true;
  }
  template <class X, class Part, class Y>
  static void add_noise(const X& x, const Part& part, const Eigen::Matrix2d& factor, Y& y) {
    const Eigen::Vector2d now = x(part);
    const Eigen::Vector2d value = factor * now;
    for (int i = 0; i < 2; ++i) y.value(i) += value[i];
    y.jacobian(part) += factor;
  }
};

inline void require_group(bool holds, const char* name, double value, const char* rule) {
  if (holds) return;
  std::ostringstream text;
  text << name << ": " << value << "; " << rule;
  throw std::invalid_argument(text.str());
}

inline const GroupOptions& checked_group(const GroupOptions& o, double start_s) {
  const auto not_negative = [](double value, const char* name) {
    require_group(value >= 0.0 && std::isfinite(value), name, value, "it must be finite and not negative");
  };
  for (const auto* noise : {&o.anchor_clock, &o.target_clock}) {
    not_negative(noise->white_frequency_m2ps, "white_frequency_m2ps");
    not_negative(noise->frequency_walk_m2ps3, "frequency_walk_m2ps3");
  }
  not_negative(o.horizontal_psd_m2ps3, "horizontal_psd_m2ps3");
  not_negative(o.vertical_psd_m2ps3, "vertical_psd_m2ps3");
  require_group(o.gate_probability >= 0.0 && o.gate_probability < 1.0, "gate_probability", o.gate_probability,
                "it must lie in [0, 1)");
  require_group(o.max_targets >= 1 && o.max_targets <= 64, "max_targets", o.max_targets, "it must lie in 1 ... 64");
  require_group(o.jump_after >= 0, "jump_after", o.jump_after, "it must be 0 or more");
  require_group(std::abs(o.mask_rad) < kPi / 2, "mask_rad", o.mask_rad, "it must lie between -pi/2 and pi/2");
  require_group(std::isfinite(start_s), "start_s", start_s, "it must be finite");
  return o;
}

// The symmetric root's stand-in: lower triangular, L L' = R. False when R is not positive definite.
inline bool lower_root(const Eigen::Matrix2d& R, Eigen::Matrix2d& L) noexcept {
  if (!(R(0, 0) > 0.0) || std::abs(R(0, 1) - R(1, 0)) > 1e-9 * std::sqrt(std::abs(R(0, 0) * R(1, 1)))) return false;
  L.setZero();
  L(0, 0) = std::sqrt(R(0, 0));
  L(1, 0) = R(1, 0) / L(0, 0);
  const double left = R(1, 1) - L(1, 0) * L(1, 0);
  if (!(left > 0.0)) return false;
  L(1, 1) = std::sqrt(left);
  return true;
}

using GroupFilter = ExtendedKalmanFilter<LayoutState<EcefFrame, Role<2, SharedNoiseTag>>>;

}  // namespace group_parts

PairNoiseShares pair_noise_shares(double first_snr, double second_snr) noexcept {
  if (!(first_snr > 0.0) || !(second_snr > 0.0)) {
    constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
    return {kNan, kNan, kNan};
  }
  const double a = 1.0 / first_snr;
  const double b = 1.0 / second_snr;
  const double all = a + b + a * b;
  if (!(all > 0.0)) return {0.5, 0.5, 0.0};  // no noise at all: the limit of equal ones
  return {a / all, b / all, a * b / all};
}

double shared_anchor_correlation(double first_snr, double second_snr, double anchor_snr) noexcept {
  return std::sqrt(pair_noise_shares(first_snr, anchor_snr).second * pair_noise_shares(second_snr, anchor_snr).second);
}

using namespace group_parts;

struct CooperativeGroup::Inside {
  std::vector<geometry::SampledOrbit> beacons;
  GroupOptions options;
  GroupFilter filter;
  double time_s;
  std::vector<Target> targets;      // in the order of joining
  std::vector<std::int64_t> names;  // theirs
  std::vector<Block<2>> noises;     // of their recordings, during a burst
  std::int64_t next_name = 0;
  Gate gate{};
  double single_gate = std::numeric_limits<double>::infinity();  // of the FDOA alone
  GroupJumps jumps{};

  Inside(std::vector<geometry::SampledOrbit> orbits, double start_s, const GroupOptions& o)
      : beacons(std::move(orbits)),
        options(checked_group(o, start_s)),
        filter(GroupFilter::Fixed{}, Eigen::Matrix2d::Identity(), 2 + (kPairDim + 2) * o.max_targets,
               2 * o.max_targets),
        time_s(start_s) {
    if (beacons.empty()) throw std::invalid_argument("beacons: at least one expected");
    const auto room = static_cast<std::size_t>(o.max_targets);
    targets.reserve(room);
    names.reserve(room);
    noises.resize(room);
    if (o.gate_probability > 0.0) {
      gate = Gate::probability(o.gate_probability, 2);
      single_gate = chi_square_upper_quantile(o.gate_probability, 1);
    }
  }

  [[nodiscard]] std::size_t index(std::int64_t name) const noexcept {
    return static_cast<std::size_t>(std::find(names.begin(), names.end(), name) - names.begin());
  }

  bool move(double t_s) noexcept {
    const double dt_s = t_s - time_s;
    if (!(dt_s >= 0.0) || std::isinf(dt_s)) return false;
    if (dt_s == 0.0) return true;
    const clock::ClockNoise clock_noise =
        options.shared_anchor_clock ? options.target_clock : options.target_clock + options.anchor_clock;
    bool sound = filter.predict(FreshNoise{}, 1.0) == UpdateStatus::kAccepted;
    for (const Target& one : targets) {
      const GroupProcess process{{{options.horizontal_psd_m2ps3, options.vertical_psd_m2ps3}, {clock_noise}},
                                 options.anchor_clock,
                                 options.shared_anchor_clock,
                                 one.state};
      sound = filter.predict(process, dt_s) == UpdateStatus::kAccepted && sound;
    }
    time_s = t_s;
    return sound;
  }

  // Whether a satellite is above the mask at the anchor and may be at the target, 3 sigmas of which are allowed for.
  [[nodiscard]] bool in_sight(const GroupBurst& burst, const Target& one) const noexcept {
    geometry::SignalPath path;
    const geometry::SampledOrbit& orbit = beacons[static_cast<std::size_t>(burst.beacon)];
    if (!geometry::signal_path(orbit, burst.t_s, burst.anchor_p_e, burst.anchor_v_e, path)) return true;  // told later
    if (!has_horizon(path.source_p_e)) return true;
    const int at = filter.state().layout().offset(one.state);
    const double sigma_m = std::sqrt(filter.covariance().diagonal().segment<3>(at).sum());
    const double least = std::sin(std::max(options.mask_rad - 3.0 * sigma_m / wgs84::kSemiMajorAxisM, -kPi / 2));
    return sine_of_elevation(burst.anchor_p_e, path.source_p_e) >= std::sin(options.mask_rad) &&
           sine_of_elevation(filter.state()(one.state).head<3>(), path.source_p_e) >= least;
  }

  // A refused row whose FDOA fits and whose TDOA goes on as those before (doc/cooperative_motion.md eq. 14).
  void suspect(Target& one, double t_s, const UpdateReport<2>& report) const noexcept {
    const double r = report.innovation[0];
    const double S = report.covariance(0, 0);
    const double rate = report.innovation[1];
    JumpSuspect& so_far = one.suspect;
    if (!(rate * rate <= single_gate * report.covariance(1, 1))) {
      so_far = {};
      return;
    }
    const bool goes_on = so_far.run > 0 && agree(r, S, so_far.innovation_m, so_far.variance_m2);
    so_far = {goes_on ? so_far.run + 1 : 1, r, S, goes_on ? so_far.since_s : t_s};
  }

  // Reopens what jumped: a target's theta, or all of them where no other target contradicts and one at least agrees.
  // The rows of the burst stay refused.
  void reopen(std::span<const GroupRow> rows, std::span<GroupStatus> out) noexcept {
    if (options.jump_after == 0) return;
    for (Target& one : targets) {
      const JumpSuspect said = one.suspect;
      if (said.run < options.jump_after) continue;
      bool any = false;
      bool all = true;
      for (const Target& other : targets) {
        if (other.name == one.name) continue;
        if (other.suspect.run > 0) {
          const bool same =
              agree(said.innovation_m, said.variance_m2, other.suspect.innovation_m, other.suspect.variance_m2);
          any = any || same;
          all = all && same;
        } else if (other.accepted_s >= said.since_s) {
          all = false;
        }
      }
      const bool anchor = any && all;
      const double sigma_m = kReopenSigmas * std::sqrt(said.variance_m2);
      static_cast<void>(filter.predict(FreshNoise{}, 1.0));
      for (Target& each : targets) {
        if (!anchor && each.name != one.name) continue;
        static_cast<void>(filter.predict(ThetaJump{each.state, said.innovation_m, sigma_m}, 1.0));
        each.suspect = {};
        for (std::size_t i = 0; i < out.size(); ++i) {
          const bool its = rows[i].target == each.name && rows[i].reference < 0;
          if (its && out[i] == GroupStatus::kGated) out[i] = GroupStatus::kClockJump;
        }
      }
      ++(anchor ? jumps.anchor : jumps.targets);
    }
  }

  // The state of a recording's noise in this burst: made when it is first asked for.
  [[nodiscard]] Block<2> noise_of(std::size_t target) noexcept {
    Block<2>& block = noises[target];
    if (!filter.state().layout().holds(block)) {
      block = filter.join<2>(Eigen::Vector2d::Zero(), Eigen::Matrix2d::Identity(), "noise");
    }
    return block;
  }

  GroupStatus take(const GroupBurst& burst, const GroupRow& row, bool crossed) noexcept {
    const bool against_anchor = row.reference < 0;
    const std::size_t target = index(row.target);
    const std::size_t reference = against_anchor ? names.size() : index(row.reference);
    if (target == names.size() || (!against_anchor && reference == names.size()) || target == reference) {
      return GroupStatus::kUnknownTarget;
    }
    PairObservation observed;
    const PairMeasurement measured{burst.t_s,      burst.beacon,     row.tdoa_s,       row.fdoa_hz,
                                   row.covariance, burst.carrier_hz, burst.anchor_p_e, burst.anchor_v_e};
    if (!pair_observation(measured, observed) || !(row.target_snr > 0.0) || !(row.reference_snr > 0.0)) {
      return GroupStatus::kNonFinite;
    }
    Eigen::Matrix2d root;
    if (!lower_root(observed.R, root)) return GroupStatus::kRefused;
    if (!in_sight(burst, targets[target]) || (!against_anchor && !in_sight(burst, targets[reference]))) {
      return GroupStatus::kBelowHorizon;
    }
    GroupModel model;
    model.beacon = &beacons[static_cast<std::size_t>(burst.beacon)];
    model.t_s = burst.t_s;
    model.anchor = {burst.anchor_p_e, burst.anchor_v_e};
    model.target = &targets[target];
    model.reference = against_anchor ? nullptr : &targets[reference];
    double left = 1.0;
    if (options.shared_anchor_noise) {
      const PairNoiseShares shares = pair_noise_shares(row.target_snr, row.reference_snr);
      model.reference_factor = -std::sqrt(shares.second) * root;
      left -= shares.second;
      if (against_anchor) {
        model.anchor_noise = true;
      } else {
        model.reference_noise = noise_of(reference);
      }
      if (crossed) {
        model.target_noise = noise_of(target);
        model.target_factor = std::sqrt(shares.first) * root;
        left -= shares.first;
      }
    }
    // A recording without noise leaves nothing for R but rounding.
    const Eigen::Matrix2d R = std::max(left, 1e-9) * observed.R;
    const auto report = filter.update(model, observed.z, R, gate);
    switch (report.status) {
      case UpdateStatus::kAccepted:
        if (against_anchor) {
          targets[target].suspect = {};
          targets[target].accepted_s = burst.t_s;
        }
        return GroupStatus::kAccepted;
      case UpdateStatus::kGated:
        if (against_anchor) suspect(targets[target], burst.t_s, report);
        return GroupStatus::kGated;
      case UpdateStatus::kUndefined:
        return GroupStatus::kOutsideOrbit;
      case UpdateStatus::kNonFinite:
        return GroupStatus::kNonFinite;
      default:
        return GroupStatus::kRefused;
    }
  }
};

CooperativeGroup::CooperativeGroup(std::vector<geometry::SampledOrbit> beacons, double start_s,
                                   const GroupOptions& options)
    : inside_(std::make_unique<Inside>(std::move(beacons), start_s, options)) {}
CooperativeGroup::CooperativeGroup(CooperativeGroup&&) noexcept = default;
CooperativeGroup& CooperativeGroup::operator=(CooperativeGroup&&) noexcept = default;
CooperativeGroup::~CooperativeGroup() = default;

std::int64_t CooperativeGroup::join(const PairVector& mean, const PairSquare& covariance) noexcept {
  Inside& me = *inside_;
  if (static_cast<int>(me.targets.size()) == me.options.max_targets) return -1;
  const auto block = me.filter.join<kPairDim>(mean, covariance, "target");
  if (!me.filter.state().layout().holds(block)) return -1;
  me.targets.push_back({.name = me.next_name, .state = block});
  me.names.push_back(me.next_name);
  return me.next_name++;
}

bool CooperativeGroup::leave(std::int64_t target) noexcept {
  Inside& me = *inside_;
  const std::size_t at = me.index(target);
  if (at == me.names.size()) return false;
  me.filter.marginalise(me.targets[at].state);
  me.targets.erase(me.targets.begin() + static_cast<std::ptrdiff_t>(at));
  me.names.erase(me.names.begin() + static_cast<std::ptrdiff_t>(at));
  return true;
}

bool CooperativeGroup::update(const GroupBurst& burst, std::span<const GroupRow> rows,
                              std::span<GroupStatus> out) noexcept {
  Inside& me = *inside_;
  const std::size_t n = std::min(rows.size(), out.size());
  const auto all = [&](GroupStatus status) { std::fill_n(out.begin(), n, status); };
  if (!(burst.t_s >= me.time_s) || std::isinf(burst.t_s)) {
    all(GroupStatus::kTimeNotAdvancing);
    return false;
  }
  if (!me.move(burst.t_s)) {
    all(GroupStatus::kRefused);
    return false;
  }
  if (burst.beacon < 0 || static_cast<std::size_t>(burst.beacon) >= me.beacons.size()) {
    all(GroupStatus::kUnknownBeacon);
    return true;
  }
  if (me.filter.predict(FreshNoise{}, 1.0) != UpdateStatus::kAccepted) {
    all(GroupStatus::kRefused);
    return false;
  }
  const bool crossed = std::any_of(rows.begin(), rows.end(), [](const GroupRow& row) { return row.reference >= 0; });
  for (std::size_t i = 0; i < n; ++i) out[i] = me.take(burst, rows[i], crossed);
  // The noise of this burst's recordings has done its part.
  for (Block<2>& block : me.noises) {
    me.filter.marginalise(block);
    block = {};
  }
  me.reopen(rows.first(n), out.first(n));
  return true;
}

double CooperativeGroup::time_s() const noexcept { return inside_->time_s; }
std::size_t CooperativeGroup::beacons() const noexcept { return inside_->beacons.size(); }
GroupJumps CooperativeGroup::jumps() const noexcept { return inside_->jumps; }
std::span<const std::int64_t> CooperativeGroup::targets() const noexcept { return inside_->names; }

Eigen::VectorXd CooperativeGroup::mean() const {
  return inside_->filter.state().x().tail(static_cast<Eigen::Index>(inside_->names.size()) * kPairDim);
}
Eigen::MatrixXd CooperativeGroup::covariance() const {
  const auto n = static_cast<Eigen::Index>(inside_->names.size()) * kPairDim;
  return inside_->filter.covariance().bottomRightCorner(n, n);
}

}  // namespace soopnav::navigation
