#include "navigation/handset_cloud.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/target_clones.hpp"
#include "navigation/handset_block.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/particle_loop.hpp"
#include "soopnav/estimation/resampling.hpp"

namespace soopnav::navigation::detail {

HandsetLayout::HandsetLayout(const HandsetOptions& options) : links(static_cast<int>(options.nodes_m.size())) {
  int next = 3;
  const auto take = [&](int n) {
    const int first = next;
    next += n;
    return first;
  };
  if (options.filter == HandsetFilter::kMeasurement) {
    vx = take(2);
    vy = vx + 1;
    dx = take(2);
    dy = dx + 1;
    turn = take(1);
  }
  clocks = options.clock == HandsetClock::kCommon ? 1 : links;
  clock = take(clocks);
  if (options.clock_drift_sigma_mps > 0.0 || options.clock_noise.frequency_walk_m2ps3 > 0.0) drift = take(clocks);
  if (options.nlos) excess = take(links);
  if (options.node_offset_sigma_m > 0.0) offset = take(links);
  if (options.multipath_sigma_m > 0.0) multipath = take(links);
  node.fill(-1);
  for (std::size_t l = 0; l < options.node_sigma_m.size(); ++l) {
    if (options.node_sigma_m[l] > 0.0) node[l] = take(2);
  }
  foot = take(2);
  size = next;
}

HandsetCloud::HandsetCloud(const HandsetOptions& options)
    : o_(options),
      at_(options),
      count_(options.particles),
      blocks_((options.particles + kLanes - 1) / kLanes),
      booleans_(options.nlos ? at_.links : 0),
      first_boolean_(at_.size + at_.size * (at_.size + 1) / 2),
      rows_(first_boolean_ + booleans_),
      excess_mean_(0.5 * (options.excess_min_m + options.excess_max_m)),
      excess_variance_(std::pow(options.excess_max_m - options.excess_min_m, 2) / 12.0),
      data_(blocks_ * static_cast<std::size_t>(rows_) * kLanes),
      other_(data_.size()),
      log_weight_(blocks_ * kLanes),
      weight_(blocks_ * kLanes),
      uniform_(blocks_ * kLanes * static_cast<std::size_t>(at_.links)),
      old_x_(blocks_ * kLanes),
      old_y_(blocks_ * kLanes),
      ancestors_(count_) {}

void HandsetCloud::start(std::uint64_t seed) noexcept {
  random_ = RandomStream(seed, 0x4A5E);
  begin();
}

void HandsetCloud::begin() noexcept {
  feet_ = false;
  dirty_ = false;
  std::fill(data_.begin(), data_.end(), 0.0);
  const bool round = o_.start_heading_sigma_rad >= kPi;
  const double sigma_a = round ? kPi : o_.start_heading_sigma_rad;
  const double own = std::min(o_.kernel * o_.start_sigma_m, o_.kernel_m);
  const double own_a = std::min(o_.kernel * sigma_a, o_.kernel_rad);
  const double between = std::sqrt(std::max(0.0, o_.start_sigma_m * o_.start_sigma_m - own * own));
  const double between_a = std::sqrt(std::max(0.0, sigma_a * sigma_a - own_a * own_a));
  const double blocked = o_.mean_nlos_s / (o_.mean_los_s + o_.mean_nlos_s);
  const std::vector<Eigen::Vector2d>& room = o_.room_m;
  for (std::size_t i = 0; i < blocks_ * kLanes; ++i) {
    const auto put = [&](int row, double number) {
      data_[(i / kLanes * static_cast<std::size_t>(rows_) + static_cast<std::size_t>(row)) * kLanes + i % kLanes] =
          number;
    };
    const auto variance = [&](int row, double sigma) { put(at_.size + row * (row + 1) / 2 + row, sigma * sigma); };
    Eigen::Vector2d p;
    for (int tries = 0; tries < 200; ++tries) {  // inside the room where there is one
      p = o_.start_m + between * Eigen::Vector2d(random_.normal(), random_.normal());
      if (room.empty() || inside(room, p)) break;
    }
    put(at_.x, p[0]);
    put(at_.y, p[1]);
    variance(at_.x, own);
    variance(at_.y, own);
    // All round: one particle in each of so many sectors.
    put(at_.heading, o_.start_heading_rad +
                         (round ? kTwoPi * (static_cast<double>(i) + random_.uniform()) / static_cast<double>(count_)
                                : between_a * random_.normal()));
    variance(at_.heading, own_a);
    if (at_.vx >= 0) {
      variance(at_.vx, o_.start_speed_sigma_mps);
      variance(at_.vy, o_.start_speed_sigma_mps);
    }
    for (int k = 0; k < at_.clocks; ++k) {
      put(at_.clock + k, o_.clock_start_m);
      variance(at_.clock + k, o_.clock_sigma_m);
      if (at_.drift >= 0) variance(at_.drift + k, o_.clock_drift_sigma_mps);
    }
    for (int l = 0; l < at_.links; ++l) {
      if (at_.excess >= 0) {
        put(at_.excess + l, excess_mean_);
        variance(at_.excess + l, std::sqrt(excess_variance_));
        put(first_boolean_ + l, random_.uniform() < blocked ? 1.0 : 0.0);
      }
      if (at_.offset >= 0) variance(at_.offset + l, o_.node_offset_sigma_m);
      if (at_.multipath >= 0) variance(at_.multipath + l, o_.multipath_sigma_m);
      const auto k = static_cast<std::size_t>(l);
      if (at_.node[k] >= 0) {
        for (int axis = 0; axis < 2; ++axis) {
          put(at_.node[k] + axis, o_.nodes_m[k][axis]);
          variance(at_.node[k] + axis, o_.node_sigma_m[k]);
        }
      }
    }
    log_weight_[i] = i < count_ ? -std::log(static_cast<double>(count_)) : -std::numeric_limits<double>::infinity();
    weight_[i] = i < count_ ? 1.0 / static_cast<double>(count_) : 0.0;
  }
  ess_ = static_cast<double>(count_);
  remember_places();
}

void HandsetCloud::remember_places() noexcept {
  if (o_.walls_m.empty()) return;
  for (std::size_t i = 0; i < count_; ++i) {
    old_x_[i] = value(i, at_.x);
    old_y_[i] = value(i, at_.y);
  }
}

// The walk over the blocks, for the widest vectors of the machine: the same bits with any (core/packet.hpp).
struct CloudBlocks {
  static Block block(HandsetCloud& c, std::size_t b) noexcept {
    return {c.data_.data() + b * static_cast<std::size_t>(c.rows_) * HandsetCloud::kLanes, c.at_, c.first_boolean_,
            c.at_.size - (c.feet_ ? 0 : 2)};
  }
  template <class Work>
  SOOPNAV_INLINE static void all(HandsetCloud& c, const Work& work) noexcept {
    for (std::size_t b = 0; b < c.blocks_; ++b) work(block(c, b), b * HandsetCloud::kLanes);
  }
};

namespace {

template <class Work>
void portable(HandsetCloud& c, const Work& work) noexcept {
  CloudBlocks::all(c, work);
}
#if SOOPNAV_WIDE_LOOPS
template <class Work>
[[gnu::flatten, gnu::target("avx2")]] void wide(HandsetCloud& c, const Work& work) noexcept {
  CloudBlocks::all(c, work);
}
#endif
template <class Work>
void each(HandsetCloud& c, const Work& work) noexcept {
#if SOOPNAV_WIDE_LOOPS
  if (soopnav::detail::has_wide_loops()) return wide(c, work);
#endif
  portable(c, work);
}

}  // namespace

void HandsetCloud::move(const HandsetMotion& motion) noexcept {
  const bool feet = motion.foot_covariance.cwiseAbs().maxCoeff() > 0.0;
  remember_places();
  feet_ = feet_ || feet;
  each(*this, MoveWork{motion, feet_});
  feet_ = feet;
}

void HandsetCloud::advance(double dt_s) noexcept {
  if (!(dt_s > 0.0)) return;
  remember_places();
  each(*this, AdvanceWork{dt_s, o_.acceleration_psd_m2ps3 * dt_s, o_.turn_psd_rad2ps * dt_s});
}

void HandsetCloud::recede(double dt_s) noexcept {
  if (!(dt_s > 0.0)) return;
  remember_places();
  each(*this, AdvanceWork{-dt_s, 0.0, 0.0});
}

void HandsetCloud::observe_motion(const HandsetMotion& motion) noexcept {
  const bool feet = motion.foot_covariance.cwiseAbs().maxCoeff() > 0.0;
  feet_ = feet_ || feet;
  each(*this, MotionWork(motion, feet_));
  feet_ = feet;
}

void HandsetCloud::begin_movement() noexcept {
  if (at_.vx >= 0) each(*this, BeginWork{});
}

void HandsetCloud::diffuse(double position_m2, double heading_rad2) noexcept {
  each(*this, DiffuseWork{position_m2, heading_rad2});
}

void HandsetCloud::leave_foot() noexcept {
  if (!feet_) return;
  each(*this, LeaveFootWork{});
  feet_ = false;
}

void HandsetCloud::enter_foot(const Eigen::Matrix2d& covariance) noexcept {
  if (!(covariance.cwiseAbs().maxCoeff() > 0.0)) return;
  feet_ = true;
  each(*this, EnterFootWork{covariance});
}

void HandsetCloud::age_links(double dt_s, double walked_m) noexcept {
  if (at_.multipath >= 0 && walked_m > 0.0) {
    const double kept = std::exp(-walked_m / o_.multipath_length_m);
    each(*this, FadeWork{kept, o_.multipath_sigma_m * o_.multipath_sigma_m * (1.0 - kept * kept)});
  }
  if (!(dt_s > 0.0)) return;
  each(*this, AgeWork{dt_s, o_.clock_noise.white_frequency_m2ps, o_.clock_noise.frequency_walk_m2ps3,
                      o_.excess_walk_m2ps * dt_s, o_.node_offset_walk_m2ps * dt_s});
}

template <class Work>
double HandsetCloud::weigh(Work& work, std::span<const double> links, std::span<const double> sigma,
                           const Eigen::Vector2d& ahead_b_m) noexcept {
  work.links = links.data();
  work.sigma = sigma.data();
  work.nodes = o_.nodes_m.data();
  work.ahead = ahead_b_m;
  work.feet = feet_ && at_.vx < 0;
  work.outlier = o_.outlier_probability;
  work.log_weight = log_weight_.data();
  work.weight = weight_.data();
  work.uniform = uniform_.data();
  work.stride = blocks_ * kLanes;
  double outliers = 0.0;
  work.outliers = &outliers;
  random_.fill_uniform(uniform_);
  each(*this, work);
  dirty_ = true;
  return outliers;
}

double HandsetCloud::weigh_ranges(std::span<const double> range_m, std::span<const double> sigma_m,
                                  std::span<const double> silent_s, const Eigen::Vector2d& ahead_b_m) noexcept {
  RangeWork work{};
  work.height_m = o_.height_m;
  const double rate = 1.0 / o_.mean_los_s + 1.0 / o_.mean_nlos_s;
  const double stationary = o_.mean_nlos_s / (o_.mean_los_s + o_.mean_nlos_s);
  for (std::size_t l = 0; l < range_m.size(); ++l) {
    const double kept = std::exp(-rate * std::max(silent_s[l], 0.0));
    work.stay_blocked[l] = stationary + (1.0 - stationary) * kept;
    work.get_blocked[l] = stationary * (1.0 - kept);
  }
  work.outlier_density = 1.0 / o_.outlier_span_m;
  work.excess_mean = excess_mean_;
  work.excess_variance = excess_variance_;
  return weigh(work, range_m, sigma_m, ahead_b_m);
}

double HandsetCloud::weigh_bearings(std::span<const double> bearing_rad, std::span<const double> sigma_rad,
                                    std::span<const double> mirror_rad, bool of_body,
                                    const Eigen::Vector2d& ahead_b_m) noexcept {
  BearingWork work{};
  work.mirror = mirror_rad.empty() ? nullptr : mirror_rad.data();
  work.of_body = of_body;
  work.booleans = booleans_ > 0;
  return weigh(work, bearing_rad, sigma_rad, ahead_b_m);
}

bool HandsetCloud::keep_inside() noexcept {
  if (o_.room_m.empty() && o_.walls_m.empty()) return true;
  const auto outside = [&](std::size_t i) {
    const Eigen::Vector2d p(value(i, at_.x), value(i, at_.y));
    if (!o_.room_m.empty() && !inside(o_.room_m, p)) return true;
    const Eigen::Vector2d from(old_x_[i], old_y_[i]);
    return std::any_of(o_.walls_m.begin(), o_.walls_m.end(),
                       [&](const Eigen::Vector4d& wall) { return crosses(wall, from, p); });
  };
  std::size_t left = 0;
  bool any_outside = false;
  for (std::size_t i = 0; i < count_; ++i) {
    if (!std::isfinite(log_weight_[i])) continue;
    if (outside(i)) {
      any_outside = true;
    } else {
      ++left;
    }
  }
  if (!any_outside) return true;
  if (left == 0) return false;
  for (std::size_t i = 0; i < count_; ++i) {
    if (std::isfinite(log_weight_[i]) && outside(i)) log_weight_[i] = -std::numeric_limits<double>::infinity();
  }
  dirty_ = true;
  return true;
}

bool HandsetCloud::settle(double& log_evidence) noexcept {
  log_evidence = 0.0;
  if (!dirty_) return true;
  dirty_ = false;
  constexpr double kNever = -std::numeric_limits<double>::infinity();
  double top = kNever;
  bool broken = false;
  for (std::size_t i = 0; i < count_; ++i) {
    if (!(log_weight_[i] < -kNever)) {
      log_weight_[i] = kNever;
      broken = true;
    }
    top = std::max(top, log_weight_[i]);
  }
  if (!(top > kNever)) {
    begin();
    log_evidence = kNever;
    return false;
  }
  double total = 0.0, squares = 0.0;
  for (std::size_t i = 0; i < count_; ++i) {
    weight_[i] = std::exp(log_weight_[i] - top);
    total += weight_[i];
  }
  for (std::size_t i = 0; i < count_; ++i) {
    weight_[i] /= total;
    squares += weight_[i] * weight_[i];
  }
  ess_ = 1.0 / squares;
  // Kept normalised: the evidence of what is new is the sum.
  const double shift = top + std::log(total);
  for (std::size_t i = 0; i < count_; ++i) log_weight_[i] -= shift;
  if (broken) resample();
  log_evidence = shift;
  return true;
}

void HandsetCloud::resample() noexcept {
  if (!soopnav::resample(Resampling::kSystematic, {weight_.data(), count_}, random_, ancestors_)) return;
  const auto rows = static_cast<std::size_t>(rows_);
  for (std::size_t i = 0; i < blocks_ * kLanes; ++i) {
    const std::size_t from = i < count_ ? ancestors_[i] : ancestors_[0];
    const double* source = data_.data() + from / kLanes * rows * kLanes + from % kLanes;
    double* target = other_.data() + i / kLanes * rows * kLanes + i % kLanes;
    for (std::size_t r = 0; r < rows; ++r) target[r * kLanes] = source[r * kLanes];
  }
  data_.swap(other_);
  const double each_weight = 1.0 / static_cast<double>(count_);
  for (std::size_t i = 0; i < count_; ++i) {
    weight_[i] = each_weight;
    log_weight_[i] = -std::log(static_cast<double>(count_));
  }
  ess_ = static_cast<double>(count_);
  remember_places();
}

void HandsetCloud::spread(double position_m, double heading_rad) noexcept {
  const double own = std::min(o_.kernel * position_m, o_.kernel_m);
  const double own_a = std::min(o_.kernel * heading_rad, o_.kernel_rad);
  const double between = std::sqrt(std::max(0.0, position_m * position_m - own * own));
  const double between_a = std::sqrt(std::max(0.0, heading_rad * heading_rad - own_a * own_a));
  for (std::size_t i = 0; i < blocks_ * kLanes; ++i) {
    const auto row = [&](int r) -> double& {
      return data_[(i / kLanes * static_cast<std::size_t>(rows_) + static_cast<std::size_t>(r)) * kLanes + i % kLanes];
    };
    row(at_.x) += between * random_.normal();
    row(at_.y) += between * random_.normal();
    row(at_.heading) += between_a * random_.normal();
    for (int k = 0; k < at_.clocks; ++k) {
      row(at_.size + (at_.clock + k) * (at_.clock + k + 1) / 2 + at_.clock + k) += position_m * position_m;
    }
  }
  diffuse(own * own, own_a * own_a);
  remember_places();
}

}  // namespace soopnav::navigation::detail
