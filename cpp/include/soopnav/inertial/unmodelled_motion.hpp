#pragma once

#include <cmath>

namespace soopnav::inertial {

/// How motion that nobody measured adds up: steps of one episode spread together as a single step of their length
/// would.
///
/// A vehicle turns or accelerates one way while its sensors are silent, so the steps of an episode are no independent
/// ones: their deviations add, not their variances. An episode is what silent (missing, saturated, not finite) steps
/// have between them no more than `kEndS` of good samples.
///
/// Model:   sigma_k dt_k with sigma_k² = sigma² (2 T_k + dt_k) / dt_k, T_k the silent time before, so that the
/// variances
///          sum to (sigma T)²                                                     (doc/strapdown.md eq. 47)
class UnmodelledEpisode {
 public:
  static constexpr double kEndS = 2.0;

  /// Takes a silent step in; the factor on its deviations.
  [[nodiscard]] double silent(double dt_s) noexcept {
    const double factor = dt_s > 0.0 ? std::sqrt((2.0 * silent_s_ + dt_s) / dt_s) : 1.0;
    silent_s_ += dt_s > 0.0 ? dt_s : 0.0;
    good_s_ = 0.0;
    return factor;
  }
  /// Takes a measured step in.
  void good(double dt_s) noexcept {
    good_s_ += dt_s;
    if (good_s_ > kEndS) silent_s_ = 0.0;
  }
  /// Silent time of the present episode.
  [[nodiscard]] double silent_s() const noexcept { return silent_s_; }

 private:
  double silent_s_ = 0.0;
  double good_s_ = 0.0;
};

}  // namespace soopnav::inertial
