#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <span>

#include "soopnav/inertial/imu_increment.hpp"

namespace soopnav::inertial {

/// Coning and sculling: what a step turns and gains beyond the plain integrals because rate and force change in it.
///
/// The corrected `delta_theta_b` is the rotation vector of the step; the corrected `delta_velocity_b` is in the axes of
/// the body at the step's beginning but for the turn of the step at its mean rate, which the mechanisation adds
/// exactly. A constant rate and force need no correction and get none.
///
/// Model:   phi = d + D x d,  u = s + D x s + S x d,  D = sum c_j d[k-j],  S = sum c_j s[k-j],  j = 1 ... previous
///          (doc/strapdown.md eq. 9-11). One earlier sample: c = 1/12 (Savage, J. Guid. Control Dyn. 21, 1998,
///          parts 1 and 2); more make the error of a coning motion fall by two orders of frequency times step each.
/// Until so many samples were seen, a formula of as many as there are is used. Nothing allocates.
class ConingSculling {
 public:
  static constexpr int kMaxPrevious = 4;

  /// `previous` earlier samples are used, 0 ... 4 (0: no correction). Throws std::invalid_argument otherwise.
  explicit ConingSculling(int previous = kMaxPrevious);

  /// The step with its corrections, and remembers it. Steps are taken to be equally long; a step longer or shorter than
  /// the one before by more than a tenth begins a new history. What is not finite comes back unchanged and is
  /// forgotten.
  [[nodiscard]] ImuIncrement correct(const ImuIncrement& increment) noexcept;

  /// Forgets what was seen: after a gap.
  void reset() noexcept { seen_ = 0; }

  /// Two halves of one step, as one corrected step: phi = a + b + 2/3 a x b, and likewise the velocity
  /// (doc/strapdown.md eq. 12). The turn at the mean rate is left to the mechanisation.
  [[nodiscard]] static ImuIncrement two_sample(const ImuIncrement& first, const ImuIncrement& second) noexcept;

  /// A whole recording at once, in place. Its first samples use the later ones instead of the earlier, so that the
  /// start is as good as the rest. Up to 2 `previous` samples, or one of the first that is not finite: as `correct`.
  static void correct_all(std::span<ImuIncrement> increments, int previous = kMaxPrevious);

 private:
  int previous_;
  int seen_ = 0;
  std::array<ImuIncrement, kMaxPrevious> last_{};  // newest first
};

/// Integral of exp([phi x] s) over s = 0 ... 1, times d: a velocity increment at constant rate, in the axes at the
/// step's beginning (doc/strapdown.md eq. 13).
[[nodiscard]] Eigen::Vector3d rotated_increment(const Eigen::Vector3d& phi_rad, const Eigen::Vector3d& d) noexcept;

/// The coefficients of the same matrix, J = I + a [phi x] + b [phi x]², and their derivatives by |phi|, over |phi|.
struct IncrementRotation {
  double a, b, a_slope, b_slope;
  explicit IncrementRotation(const Eigen::Vector3d& phi_rad) noexcept;
  [[nodiscard]] Eigen::Matrix3d matrix(const Eigen::Vector3d& phi_rad) const noexcept;
  /// d (J d) / d phi.
  [[nodiscard]] Eigen::Matrix3d slope(const Eigen::Vector3d& phi_rad, const Eigen::Vector3d& d) const noexcept;
};

}  // namespace soopnav::inertial
