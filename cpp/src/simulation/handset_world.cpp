#include "soopnav/simulation/handset_world.hpp"

#include <algorithm>
#include <cmath>

#include "simulation/require.hpp"
#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"

namespace soopnav::simulation {
namespace {

constexpr double kTurnRate = 0.8;     // rad/s
constexpr double kFineStep = 0.01;    // s
constexpr double kWallMargin = 2.75;  // m: more than two turning circles at 1 m/s
constexpr double kSway = 0.35;        // rad

void number(std::string_view name, double value, double low) {
  require(value >= low && std::isfinite(value), name, value, low > 0.0 ? "a positive number expected" : "at least 0");
}
void above(std::string_view name, double value, double low) {
  require(value > low && std::isfinite(value), name, value, "a larger, finite number expected");
}

double reflected(double value, double low, double high) noexcept {
  if (value >= low && value <= high) return value;
  const double width = high - low;
  const double folded = std::abs(std::fmod(value - low, 2.0 * width));
  return std::clamp(folded > width ? high - (folded - width) : low + folded, low, high);
}

// One draw of all chains; the worst link's share of line of sight.
double draw(const NlosOptions& o, double step_s, RandomStream& random, NlosSchedule& out) {
  const auto links = static_cast<std::size_t>(o.links);
  const double stationary = o.mean_nlos_s / (o.mean_los_s + o.mean_nlos_s);
  const double kept = std::exp(-step_s * (1.0 / o.mean_los_s + 1.0 / o.mean_nlos_s));
  const double step = std::sqrt(o.excess_walk_m2ps * step_s);
  std::vector<int> clear(links, 0);
  int blocked = 0;
  for (std::size_t k = 0; k < out.epochs; ++k) {
    for (std::size_t turn = 0; turn < links; ++turn) {
      const std::size_t l = (turn + k) % links;  // no link is always the first to be let in
      const std::size_t at = k * links + l;
      const bool was = k > 0 && out.blocked[at - links] != 0;
      const double chance =
          k == 0 ? stationary : (was ? stationary + (1.0 - stationary) * kept : stationary * (1.0 - kept));
      const bool wants = random.uniform() < chance;
      const double begin = random.uniform(o.excess_min_m, o.excess_max_m);
      const double wander = step * random.normal();
      if (was && !wants) --blocked;
      const bool is = wants && (was || blocked < o.max_blocked);
      if (is && !was) ++blocked;
      out.blocked[at] = is ? 1 : 0;
      out.excess_m[at] = !is   ? 0.0
                         : was ? reflected(out.excess_m[at - links] + wander, o.excess_min_m, o.excess_max_m)
                               : begin;
      clear[l] += is ? 0 : 1;
    }
  }
  return static_cast<double>(*std::min_element(clear.begin(), clear.end())) / static_cast<double>(out.epochs);
}

}  // namespace

void NlosOptions::check() const {
  require(links >= 1 && links <= 64, "links", links, "1 ... 64 expected");
  require(max_blocked >= 0 && max_blocked <= links, "max_blocked", max_blocked, "0 ... links expected");
  require(min_clear_share >= 0.0 && min_clear_share <= 1.0, "min_clear_share", min_clear_share, "in [0, 1] expected");
  above("mean_los_s", mean_los_s, 0.0);
  above("mean_nlos_s", mean_nlos_s, 0.0);
  number("excess_min_m", excess_min_m, 0.0);
  above("excess_max_m", excess_max_m, excess_min_m);
  number("excess_walk_m2ps", excess_walk_m2ps, 0.0);
  require(attempts >= 1, "attempts", attempts, "at least 1 expected");
}

NlosSchedule NlosSchedule::generate(const NlosOptions& options, std::size_t epochs, double step_s, std::uint64_t seed) {
  options.check();
  require(epochs >= 1, "epochs", static_cast<double>(epochs), "at least 1 expected");
  above("step_s", step_s, 0.0);
  number("excess_walk_m2ps * step_s", options.excess_walk_m2ps * step_s, 0.0);
  RandomStream random(seed, 0x4105);
  NlosSchedule best, next;
  next.epochs = epochs;
  next.links = options.links;
  next.blocked.resize(epochs * static_cast<std::size_t>(options.links));
  next.excess_m.resize(next.blocked.size());
  best.clear_share = -1.0;
  for (int k = 1; k <= options.attempts; ++k) {
    next.clear_share = draw(options, step_s, random, next);
    if (next.clear_share > best.clear_share) best = next;
    best.attempts = k;
    if (best.clear_share >= options.min_clear_share) break;
  }
  best.guarded = best.clear_share >= options.min_clear_share;
  return best;
}

void HandsetWorldOptions::check() const {
  nlos.check();
  above("duration_s", duration_s, 0.0);
  require(duration_s <= 10000.0, "duration_s", duration_s, "at most 10 000 expected");
  above("room_m", room_m, 2.0 * kWallMargin + 0.5);
  above("min_node_m", min_node_m, 0.0);
  require(max_node_m >= min_node_m && std::isfinite(max_node_m), "max_node_m", max_node_m,
          "not below min_node_m expected");
  number("min_speed_mps", min_speed_mps, 0.0);
  require(max_speed_mps >= min_speed_mps && max_speed_mps <= 1.05, "max_speed_mps", max_speed_mps,
          "min_speed_mps ... 1.05 expected (a walk that turns within the room)");
  require(range_rate_hz > 0.0 && range_rate_hz <= 100.0, "range_rate_hz", range_rate_hz, "in (0, 100] expected");
  require(frame_rate_hz > 0.0 && frame_rate_hz <= 100.0, "frame_rate_hz", frame_rate_hz, "in (0, 100] expected");
  number("range_sigma_m", range_sigma_m, 0.0);
  number("clock_walk_m2ps", clock_walk_m2ps, 0.0);
  number("clock_sigma_m", clock_sigma_m, 0.0);
  number("step_sigma_m", step_sigma_m, 0.0);
  number("turn_sigma_rad", turn_sigma_rad, 0.0);
  number("foot_sigma_m", foot_sigma_m, 0.0);
  number("heading_error_rad", heading_error_rad, 0.0);
  number("epoch_offset_s", epoch_offset_s, 0.0);
}

HandsetWorld HandsetWorld::generate(const HandsetWorldOptions& o, std::uint64_t seed) {
  o.check();
  const RandomStream root(seed, 0x3A1D);
  HandsetWorld w;

  RandomStream place = root.substream(0);
  const int links = o.nlos.links;
  const double turn0 = place.uniform(0.0, kTwoPi);
  for (int l = 0; l < links; ++l) {
    const double azimuth = turn0 + kTwoPi * (l + place.uniform(-1.0 / 3.0, 1.0 / 3.0)) / links;
    const double distance = place.uniform(o.min_node_m, o.max_node_m);
    w.nodes_m.emplace_back(distance * std::cos(azimuth), distance * std::sin(azimuth), 0.0);
  }

  // The walk, finely; poses between the fine steps are linear.
  RandomStream walk = root.substream(1);
  const double half = 0.5 * o.room_m - kWallMargin;
  const auto fine = static_cast<std::size_t>(std::ceil((o.duration_s + o.epoch_offset_s) / kFineStep)) + 2;
  std::vector<Eigen::Vector3d> pose(fine);
  std::vector<double> length(fine, 0.0);
  const auto point = [&] { return Eigen::Vector2d(walk.uniform(-half, half), walk.uniform(-half, half)); };
  Eigen::Vector2d p = point(), goal = point();
  double course = walk.uniform(-kPi, kPi);
  const double swing_s = walk.uniform(8.0, 15.0), swing = walk.uniform(0.0, kTwoPi);
  const double sway_s = walk.uniform(5.0, 9.0), sway = walk.uniform(0.0, kTwoPi);
  const double facing = walk.uniform(-kPi, kPi);
  double goal_s = 0.0;
  for (std::size_t i = 0; i < fine; ++i) {
    const double t = kFineStep * static_cast<double>(i);
    const double heading = course + facing + kSway * std::sin(kTwoPi * t / sway_s + sway);
    pose[i] << p, heading;
    const double speed = 0.5 * (o.min_speed_mps + o.max_speed_mps) +
                         0.5 * (o.max_speed_mps - o.min_speed_mps) * std::sin(kTwoPi * t / swing_s + swing);
    const Eigen::Vector2d to = goal - p;
    if (to.norm() < 1.0 || t - goal_s > 20.0) {
      goal = point();
      goal_s = t;
    }
    const double wanted = wrap_to_pi(std::atan2(to[1], to[0]) - course);
    const double turn = std::clamp(wanted, -kTurnRate, kTurnRate) * kFineStep;
    p += speed * kFineStep * Eigen::Vector2d(std::cos(course + 0.5 * turn), std::sin(course + 0.5 * turn));
    course += turn;
    if (i + 1 < fine) length[i + 1] = length[i] + speed * kFineStep;
  }
  const auto at = [&](const auto& values, double t) {
    const double x = t / kFineStep;
    const auto i = std::min(static_cast<std::size_t>(x), fine - 2);
    const double f = x - static_cast<double>(i);
    return std::decay_t<decltype(values[0])>((1.0 - f) * values[i] + f * values[i + 1]);
  };

  RandomStream camera = root.substream(2);
  const auto frames = static_cast<std::size_t>(std::floor(o.duration_s * o.frame_rate_hz + 1e-9)) + 1;
  Eigen::Vector2d foot_before = Eigen::Vector2d::Zero();
  for (std::size_t k = 0; k < frames; ++k) {
    w.frame_s.push_back(static_cast<double>(k) / o.frame_rate_hz);
    w.pose.push_back(at(pose, w.frame_s[k]));
    w.walked_m.push_back(at(length, w.frame_s[k]));
    const double e0 = camera.normal(), e1 = camera.normal();
    const double a = w.pose[k][2];
    const auto turned = [](double angle, double x, double y) {
      return Eigen::Vector2d(std::cos(angle) * x - std::sin(angle) * y, std::sin(angle) * x + std::cos(angle) * y);
    };
    const Eigen::Vector2d foot = w.pose[k].head<2>() + turned(a, o.foot_sigma_m * e0, o.foot_sigma_m * e1);
    const double n0 = camera.normal(), n1 = camera.normal(), n2 = camera.normal();
    if (k > 0) {
      const double before = w.pose[k - 1][2];
      const Eigen::Vector2d step = foot - foot_before;
      const Eigen::Vector2d seen = turned(-before, step[0], step[1]);
      w.increment.emplace_back(seen[0] + o.step_sigma_m * n0, seen[1] + o.step_sigma_m * n1,
                               a - before + o.turn_sigma_rad * n2);
    }
    foot_before = foot;
  }
  w.told_heading_rad = w.pose[0][2] + o.heading_error_rad * root.substream(3).uniform(-1.0, 1.0);

  RandomStream radio = root.substream(4);
  const auto epochs =
      std::max<std::size_t>(1, static_cast<std::size_t>(std::floor(o.duration_s * o.range_rate_hz + 1e-9)));
  w.nlos = NlosSchedule::generate(o.nlos, epochs, 1.0 / o.range_rate_hz, root.substream(5).next_u64());
  double clock = o.clock_sigma_m * radio.normal();
  for (std::size_t k = 0; k < epochs; ++k) {
    const double t = static_cast<double>(k) / o.range_rate_hz + o.epoch_offset_s;
    const Eigen::Vector2d here = at(pose, t).template head<2>();
    w.epoch_s.push_back(t);
    w.position_m.push_back(here);
    w.clock_m.push_back(clock);
    for (std::size_t l = 0; l < static_cast<std::size_t>(links); ++l) {
      w.range_m.push_back((w.nodes_m[l].head<2>() - here).norm() + clock +
                          w.nlos.excess_m[k * static_cast<std::size_t>(links) + l] + o.range_sigma_m * radio.normal());
    }
    clock += std::sqrt(o.clock_walk_m2ps / o.range_rate_hz) * radio.normal();
  }
  return w;
}

}  // namespace soopnav::simulation
