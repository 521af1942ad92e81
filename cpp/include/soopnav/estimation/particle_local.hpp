#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>

#include "soopnav/core/packet_math.hpp"
#include "soopnav/estimation/particle_view.hpp"

namespace soopnav::detail {

/// Index in `x` of tangent component `i` of a state without or before its attitude, and behind it.
template <class State>
[[nodiscard]] constexpr int stored_index(int i) noexcept {
  if constexpr (HoldsRole<State, Role<3, AttitudeTag>>) {
    return i < State::at(kAttitude) ? i : i + 1;
  } else {
    return i;
  }
}

template <class State>
[[nodiscard]] constexpr bool is_rotation_component(int i) noexcept {
  if constexpr (HoldsRole<State, Role<3, AttitudeTag>>) {
    return i >= State::at(kAttitude) && i < State::at(kAttitude) + 3;
  } else {
    return false;
  }
}

template <class State>
[[nodiscard]] constexpr bool is_heading_component(int i) noexcept {
  if constexpr (HoldsRole<State, Role<1, HeadingTag>>) {
    return i == State::at(kHeading);
  } else {
    return false;
  }
}

/// mean.local(x) of a packet of particles.
template <class State, class T>
SOOPNAV_INLINE void local_packets(const State& mean, const ParticleView<State, T>& x,
                                  std::array<Packet<T>, static_cast<std::size_t>(State::kDim)>& d) noexcept {
  using P = Packet<T>;
  for (int i = 0; i < State::kDim; ++i) {
    if (is_rotation_component<State>(i)) continue;
    const int s = stored_index<State>(i);
    const P difference = x.values[static_cast<std::size_t>(s)] - P(static_cast<T>(mean.x[s]));
    d[static_cast<std::size_t>(i)] = is_heading_component<State>(i) ? wrap_to_pi(difference) : difference;
  }
  if constexpr (HoldsRole<State, Role<3, AttitudeTag>>) {
    // Logarithm of conj(mean) * x, the shorter of the two turns.
    const auto* q = x.values.data() + State::stored_at(kAttitude);
    const Eigen::Vector4d exact = mean(kAttitude);
    const std::array<T, 4> m{static_cast<T>(exact[0]), static_cast<T>(exact[1]), static_cast<T>(exact[2]),
                             static_cast<T>(exact[3])};
    const P w = q[0] * m[0] + q[1] * m[1] + q[2] * m[2] + q[3] * m[3];
    const P v[3] = {q[1] * m[0] - q[0] * m[1] - q[3] * m[2] + q[2] * m[3],
                    q[2] * m[0] + q[3] * m[1] - q[0] * m[2] - q[1] * m[3],
                    q[3] * m[0] - q[2] * m[1] + q[1] * m[2] - q[0] * m[3]};
    const P sine = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    const P sign = copysign(P(1), w);
    const P turn = P(2) * sign * atan2(sine, abs(w));
    const P scale = select(sine > P(1e-10), turn / sine, P(2) * sign);
    for (std::size_t i = 0; i < 3; ++i) d[static_cast<std::size_t>(State::at(kAttitude)) + i] = scale * v[i];
  }
}

/// x <- x.retract(d) of a packet of particles; a heading is left to be wrapped, a quaternion to be normalised.
template <class State, class T>
SOOPNAV_INLINE void retract_packets(const std::array<Packet<T>, static_cast<std::size_t>(State::kDim)>& d,
                                    ParticleView<State, T>& x) noexcept {
  using P = Packet<T>;
  for (int i = 0; i < State::kDim; ++i) {
    if (is_rotation_component<State>(i)) continue;
    x.values[static_cast<std::size_t>(stored_index<State>(i))] += d[static_cast<std::size_t>(i)];
  }
  if constexpr (HoldsRole<State, Role<3, AttitudeTag>>) {
    const P* v = d.data() + State::at(kAttitude);
    const P half = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) * P(static_cast<T>(0.5));
    const auto turn = sincos(half);
    const P scale = select(half > P(static_cast<T>(1e-10)), turn.sin / half, P(1)) * P(static_cast<T>(0.5));
    const P w = turn.cos;
    const P a[3] = {scale * v[0], scale * v[1], scale * v[2]};
    P* q = x.values.data() + State::stored_at(kAttitude);
    const P r[4] = {
        q[0] * w - q[1] * a[0] - q[2] * a[1] - q[3] * a[2], q[0] * a[0] + q[1] * w + q[2] * a[2] - q[3] * a[1],
        q[0] * a[1] - q[1] * a[2] + q[2] * w + q[3] * a[0], q[0] * a[2] + q[1] * a[1] - q[2] * a[0] + q[3] * w};
    for (int i = 0; i < 4; ++i) q[i] = r[i];
  }
}

}  // namespace soopnav::detail
