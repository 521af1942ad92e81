#pragma once

#include <cstddef>
#include <vector>

#include "navigation/source_filter.hpp"

namespace soopnav::navigation::detail {

/// Velocity and heading bias of a state that starts, and nothing known of their relation to the position.
void finish_start(const SourceOptions& options, const Layout& layout, Gaussian& g) noexcept;

/// A state along a bearing: at `range_m` in direction `azimuth` and the measured elevation, with the stated deviations.
void start_along(const SourceOptions& options, const Layout& layout, const Kept& kept, double azimuth,
                 double sigma_azimuth_rad, double range_m, double sigma_range_m, Gaussian& g) noexcept;

/// Extended Kalman filters that start along the first good bearing, each at its own range, weighted by the likelihood
/// of their innovations (doc/source_location.md section 7).
class EkfBank {
 public:
  EkfBank(const SourceOptions& options, const Layout& layout);

  void clear() noexcept;
  [[nodiscard]] bool started() const noexcept { return started_; }
  BearingUse step(const Kept& kept) noexcept;
  /// ln of the density that the mixture gives a bearing, and the least NIS of a member with a share above 1 %. False
  /// when no member predicts it.
  [[nodiscard]] bool score(const Kept& kept, double& log_density, double& nis) const noexcept;
  /// Mean and covariance of the mixture at the last bearing. False when there is none.
  [[nodiscard]] bool moments(Gaussian& merged) const noexcept;

  [[nodiscard]] std::size_t size() const noexcept { return started_ ? members_.size() : 0; }
  [[nodiscard]] const Gaussian& member(std::size_t i) const noexcept { return members_[i].g; }
  [[nodiscard]] double weight(std::size_t i) const noexcept;

 private:
  struct Member {
    Gaussian g;
    double log_weight = 0.0;
  };
  void start(const Kept& kept) noexcept;

  SourceOptions options_;
  Layout layout_;
  std::vector<Member> members_;
  bool started_ = false;
  double t_s_ = 0.0;
};

}  // namespace soopnav::navigation::detail
