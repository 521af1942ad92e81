#pragma once

#include <cmath>

#include "soopnav/core/constants.hpp"

namespace soopnav {

/// The angle of `degrees` in radians.
[[nodiscard]] constexpr double radians(double degrees) noexcept { return degrees * (kPi / 180.0); }

/// The angle of `angle_rad` in degrees.
[[nodiscard]] constexpr double degrees(double angle_rad) noexcept { return angle_rad * (180.0 / kPi); }

/// `angle_rad` plus the multiple of 2 pi that brings it into [-pi, pi). Not finite in, NaN out.
///
/// Exact with respect to the double nearest 2 pi (IEEE remainder): an argument already inside comes back unchanged.
[[nodiscard]] inline double wrap_to_pi(double angle_rad) noexcept {
  const double wrapped = std::remainder(angle_rad, kTwoPi);
  return wrapped >= kPi ? wrapped - kTwoPi : wrapped;
}

/// `angle_rad` plus the multiple of 2 pi that brings it into [0, 2 pi). Not finite in, NaN out.
[[nodiscard]] inline double wrap_to_two_pi(double angle_rad) noexcept {
  double wrapped = std::fmod(angle_rad, kTwoPi);
  if (wrapped < 0.0) wrapped += kTwoPi;
  return wrapped >= kTwoPi ? 0.0 : wrapped;  // -1e-20 + 2 pi rounds to 2 pi
}

/// The turn from `from_rad` to `to_rad` the short way, in [-pi, pi).
[[nodiscard]] inline double angle_difference(double to_rad, double from_rad) noexcept {
  return wrap_to_pi(to_rad - from_rad);
}

}  // namespace soopnav
