#pragma once

#include <string_view>

#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav::inertial {

/// Constant parts of what gyros and accelerometers read too much, along the body's axes.
struct GyroBiasTag {
  static constexpr std::string_view kName = "gyro bias";
};
struct AccelerometerBiasTag {
  static constexpr std::string_view kName = "accelerometer bias";
};

inline constexpr Role<3, GyroBiasTag> kGyroBias{};                    ///< [rad/s]
inline constexpr Role<3, AccelerometerBiasTag> kAccelerometerBias{};  ///< [m/s²]

/// Attitude q_n_b, velocity, position, gyro bias, accelerometer bias. n is a frame fixed to the Earth with its origin
/// near by; 16 numbers, and the 15 error states of an inertial system as tangent (doc/strapdown.md eq. 20).
template <class Frame>
using StrapdownState = ComposedState<Frame, Role<3, AttitudeTag>, Role<3, VelocityTag>, Role<3, PositionTag>,
                                     Role<3, GyroBiasTag>, Role<3, AccelerometerBiasTag>>;

}  // namespace soopnav::inertial
