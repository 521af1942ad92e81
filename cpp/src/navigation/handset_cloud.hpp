#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/navigation/handset_locator.hpp"

namespace soopnav::navigation::detail {

/// Where each number of a particle's Gaussian lies; -1 where there is none (doc/handset.md eq. 5).
struct HandsetLayout {
  int x = 0, y = 1, heading = 2;
  int vx = -1, vy = -1, dx = -1, dy = -1, turn = -1;  ///< type 2: velocity; movement and turn since the last frame
  int clock = -1, drift = -1;                         ///< of the first (only) clock
  int excess = -1;                                    ///< of the first link
  int offset = -1;
  int multipath = -1;  ///< of the first link
  int clocks = 1;
  int foot = -1;  ///< two numbers
  std::array<int, kMaxHandsetNodes> node{};
  int links = 0;
  int size = 0;

  explicit HandsetLayout(const HandsetOptions& options);
  [[nodiscard]] int bias_of(int link) const noexcept { return clock + (clocks > 1 ? link : 0); }
};

/// Particles in blocks of eight: block b, row r, lane i is `data[(b * rows + r) * 8 + i]`. Rows: the means, the lower
/// triangle of the covariance, the Booleans (1: excess delay).
class HandsetCloud {
 public:
  static constexpr int kLanes = 8;
  static constexpr int kMaxSize = 3 + 5 + 2 * kMaxHandsetNodes + 5 * kMaxHandsetNodes + 2;

  explicit HandsetCloud(const HandsetOptions& options);

  void start(std::uint64_t seed) noexcept;
  /// Type 1: the pose moves by `motion`. Its foot points' noise replaces the last one's.
  void move(const HandsetMotion& motion) noexcept;
  /// Type 2: the pose moves on with its velocity.
  void advance(double dt_s) noexcept;
  /// Type 2: back by `dt_s` with the velocity that it came with; what was learnt since goes along.
  void recede(double dt_s) noexcept;
  /// Type 2: `motion` is a measurement of the movement since the last frame, which ends here.
  void observe_motion(const HandsetMotion& motion) noexcept;
  /// Type 2: the movement since the last frame begins anew.
  void begin_movement() noexcept;
  /// Noise of the position [m²] and the heading [rad²].
  void diffuse(double position_m2, double heading_rad2) noexcept;
  /// Foot point -> handset: what the last frame's plane said of it ends.
  void leave_foot() noexcept;
  /// Handset -> foot point of a frame whose plane has this noise.
  void enter_foot(const Eigen::Matrix2d& covariance) noexcept;
  /// Clocks, offsets and excess delays after `dt_s`, and the ranges' errors by multipath after `walked_m`.
  void age_links(double dt_s, double walked_m) noexcept;

  /// `silent_s`: since each link's last range. `ahead_b_m`: from the pose to the handset at this epoch, in the body's
  /// axes. Share of outliers returned.
  double weigh_ranges(std::span<const double> range_m, std::span<const double> sigma_m,
                      std::span<const double> silent_s, const Eigen::Vector2d& ahead_b_m) noexcept;
  double weigh_bearings(std::span<const double> bearing_rad, std::span<const double> sigma_rad,
                        std::span<const double> mirror_rad, bool of_body, const Eigen::Vector2d& ahead_b_m) noexcept;
  /// Weights of those outside `room` or that crossed a wall become zero. False when none are left: nothing done.
  [[nodiscard]] bool keep_inside() noexcept;
  /// Normalises; `log_evidence` of what came since, and the effective number of particles. Particles whose weight is no
  /// number are replaced by others; false when no other was left: then all begin anew as at the start.
  [[nodiscard]] bool settle(double& log_evidence) noexcept;
  [[nodiscard]] double ess() const noexcept { return ess_; }
  void resample() noexcept;
  /// Pose as uncertain again as at the start, about where it is.
  void spread(double position_m, double heading_rad) noexcept;

  [[nodiscard]] const HandsetLayout& layout() const noexcept { return at_; }
  [[nodiscard]] std::size_t count() const noexcept { return count_; }
  [[nodiscard]] double weight(std::size_t i) const noexcept { return weight_[i]; }
  [[nodiscard]] double mean(std::size_t i, int row) const noexcept { return value(i, row); }
  [[nodiscard]] double covariance(std::size_t i, int a, int b) const noexcept {
    return value(i, at_.size + (a >= b ? a * (a + 1) / 2 + b : b * (b + 1) / 2 + a));
  }
  [[nodiscard]] bool blocked(std::size_t i, int link) const noexcept {
    return booleans_ > 0 && value(i, first_boolean_ + link) > 0.5;
  }
  [[nodiscard]] bool feet() const noexcept { return feet_; }

 private:
  friend struct CloudBlocks;
  [[nodiscard]] double value(std::size_t i, int row) const noexcept {
    return data_[(i / kLanes * static_cast<std::size_t>(rows_) + static_cast<std::size_t>(row)) * kLanes + i % kLanes];
  }
  void begin() noexcept;
  /// What ranges and bearings share: `links` and `sigma` of each node into the particles' weights.
  template <class Work>
  double weigh(Work& work, std::span<const double> links, std::span<const double> sigma,
               const Eigen::Vector2d& ahead_b_m) noexcept;
  void remember_places() noexcept;

  HandsetOptions o_;
  HandsetLayout at_;
  std::size_t count_, blocks_;
  int booleans_, first_boolean_, rows_;
  bool feet_ = false;
  bool dirty_ = false;
  double excess_mean_, excess_variance_;
  double ess_ = 0.0;
  RandomStream random_;
  std::vector<double> data_, other_;
  std::vector<double> log_weight_, weight_, uniform_, old_x_, old_y_;
  std::vector<std::uint32_t> ancestors_;
};

}  // namespace soopnav::navigation::detail
