#pragma once

#include <Eigen/Core>
#include <span>

#include "soopnav/gnss/attitude.hpp"

namespace soopnav::gnss::detail {

/// What the path differences of one epoch say about a small rotation d of the body, at one attitude: the normal
/// equations information * d = gradient, the clocks eliminated (doc/attitude.md eq. 17).
struct AttitudeInformation {
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  double chi_square = 0.0;  ///< at d = 0
  int rows = 0;             ///< finite path differences, less one for each clock
};

[[nodiscard]] AttitudeInformation linearise(const AttitudeModel& model, const Eigen::Matrix3d& T_n_b,
                                            std::span<const Eigen::Vector3d> directions,
                                            const PathDifferences& path) noexcept;

/// Whether `u` may be used: finite and of unit length.
[[nodiscard]] bool is_direction(const Eigen::Vector3d& u) noexcept;

}  // namespace soopnav::gnss::detail
