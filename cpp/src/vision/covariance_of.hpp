#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>

namespace soopnav::vision {

/// Covariance of what normal equations estimate, for noise of unit variance: symmetric.
[[nodiscard]] inline Eigen::Matrix3d covariance_of(const Eigen::Matrix3d& information) {
  const Eigen::Matrix3d solved = information.ldlt().solve(Eigen::Matrix3d::Identity());
  return 0.5 * (solved + solved.transpose());
}

}  // namespace soopnav::vision
