#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <string_view>

#include "soopnav/geometry/wgs84.hpp"
#include "soopnav/inertial/imu_increment.hpp"

namespace soopnav::inertial {

/// Where a strapdown system is, how fast and how it is turned; n is north-east-down at its own place.
struct NavigationState {
  geometry::Geodetic place;                                   ///< latitude, longitude [rad], height [m], WGS 84
  Eigen::Vector3d v_n_mps = Eigen::Vector3d::Zero();          ///< relative to the Earth, north, east, down
  Eigen::Quaterniond q_n_b = Eigen::Quaterniond::Identity();  ///< body to north-east-down
};

/// What became of a step of a mechanisation. Anything but `kIntegrated` left the state as it was.
enum class IntegrationStatus : std::uint8_t {
  kIntegrated,        ///< the state moved
  kNonFinite,         ///< NaN or infinity in the increment
  kTimeNotAdvancing,  ///< the length of the step is not a positive finite number
  kNearPole,          ///< within 0.01 degree of a pole north has no direction that can be followed
};

/// A lower-case phrase for reports; "unknown" for a value that is no enumerator.
[[nodiscard]] constexpr std::string_view to_string(IntegrationStatus status) noexcept {
  switch (status) {
    case IntegrationStatus::kIntegrated:
      return "integrated";
    case IntegrationStatus::kNonFinite:
      return "not finite";
    case IntegrationStatus::kTimeNotAdvancing:
      return "time not advancing";
    case IntegrationStatus::kNearPole:
      return "near a pole";
  }
  return "unknown";
}

/// Inertial navigation in the moving local level frame (north-east-down), the classical strapdown mechanisation.
///
/// Model:   dq_n_b/dt by w_ib_b and w_in_n = w_ie_n + w_en_n,  dv_n/dt = C_n_b f_b + g_n - (2 w_ie_n + w_en_n) x v_n,
///          dlat/dt = v_N / (M + h), dlon/dt = v_E / ((N + h) cos(lat)), dh/dt = -v_D      (doc/strapdown.md eq. 14-19)
/// Gravity: normal gravity at the place and height, its bend with height included.
/// Input:   increments after `ConingSculling`. The turn of the body in a step and that of the frame are exact for
///          constant rates; place, Coriolis and gravity are taken at the step's middle; the place moves by the
///          trapezoid.
/// No allocation; about a microsecond for a step.
class StrapdownIntegrator {
 public:
  /// Throws std::invalid_argument for a start that is not finite, a quaternion that is not unit to 1e-6, |latitude|
  /// above pi/2 or a height outside -10 km ... 1000 km.
  explicit StrapdownIntegrator(const NavigationState& start);

  [[nodiscard]] const NavigationState& state() const noexcept { return state_; }
  IntegrationStatus step(const ImuIncrement& increment) noexcept;

 private:
  NavigationState state_;
};

}  // namespace soopnav::inertial
