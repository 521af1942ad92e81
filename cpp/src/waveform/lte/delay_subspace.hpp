#pragma once

#include <Eigen/Core>

#include "soopnav/core/iq.hpp"

namespace soopnav::lte {

/// Least squares onto the channels that delays within a window can make.
///
/// The covariance over frequency of a channel whose power is spread evenly over the window has few eigenvalues that
/// count; projecting on their vectors keeps such channels whole and rejects the rest of the noise
/// (cpp/doc/lte_cell_search.md eq. 10).
class DelaySubspace {
 public:
  /// `from`: frequencies observed, in units of 15 kHz; window in seconds; eigenvalues below `floor` of the largest are
  /// noise.
  DelaySubspace(const Eigen::VectorXd& from, double earliest_s, double latest_s, double floor);

  /// Channel at the frequencies observed, smoothed.
  void project(const Cf32* in, Cf32* out) const;
  [[nodiscard]] int rank() const noexcept { return static_cast<int>(basis_.cols()); }

  /// Also makes the matrix for `to`, frequencies at which `interpolate` is to give the channel.
  void set_targets(const Eigen::VectorXd& to);
  void interpolate(const Cf32* in, Cf32* out) const;

 private:
  Eigen::VectorXd from_;
  double earliest_s_, latest_s_;
  Eigen::MatrixXcf basis_;
  Eigen::VectorXd eigenvalues_;
  Eigen::MatrixXcf target_;
};

}  // namespace soopnav::lte
