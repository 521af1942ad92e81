#pragma once

#include <Eigen/Core>
#include <array>
#include <concepts>
#include <cstddef>
#include <type_traits>

#include "soopnav/core/packet.hpp"
#include "soopnav/core/packet_math.hpp"
#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav {
namespace detail {

/// Numbers a state keeps.
template <class State>
inline constexpr int kStateSize = decltype(State::x)::RowsAtCompileTime;

template <class State, int Dim, class Tag>
inline constexpr int kRoleSize = kIsRotation<Tag> ? 4 : Dim;

// Components of a role, as `x(role)[i]`. Read or written in place.
template <class P>
struct RolePackets {
  P* first;
  [[nodiscard]] SOOPNAV_INLINE P& operator[](int i) const noexcept { return first[i]; }
};

}  // namespace detail

/// `Packet<T>::kWidth` particles as a model sees them: `x(role)[i]` is a packet, a `Known` what it is.
template <FixedStateType StateType, std::floating_point T>
struct ParticleView {
  using State = StateType;
  using Frame = typename State::Frame;
  using Pack = Packet<T>;
  static constexpr int kSize = detail::kStateSize<State>;

  std::array<Pack, static_cast<std::size_t>(kSize)> values;  ///< the state's stored numbers, in their order

  template <int Dim, class Tag>
  requires HoldsRole<State, Role<Dim, Tag>>
  [[nodiscard]] SOOPNAV_INLINE detail::RolePackets<const Pack> operator()(Role<Dim, Tag> role) const noexcept {
    return {values.data() + State::stored_at(role)};
  }
  template <int Dim>
  [[nodiscard]] SOOPNAV_INLINE const Known<Dim>& operator()(const Known<Dim>& known) const noexcept {
    return known;
  }
};

/// Where a process model writes the next states of a packet of particles.
template <FixedStateType StateType, std::floating_point T>
struct ParticleNext {
  static constexpr bool kJacobian = false;
  using State = StateType;
  using Pack = Packet<T>;

  ParticleView<State, T> state;

  template <int Dim, class Tag>
  requires HoldsRole<State, Role<Dim, Tag>>
  [[nodiscard]] SOOPNAV_INLINE detail::RolePackets<Pack> next(Role<Dim, Tag> role) noexcept {
    return {state.values.data() + State::stored_at(role)};
  }
};

namespace detail {

/// The standard normals of a packet of particles: number k lies `stride` floats behind number k - 1.
template <std::floating_point T>
struct ParticleNoise {
  const float* first;
  std::size_t stride;
  [[nodiscard]] SOOPNAV_INLINE Packet<T> operator[](int k) const noexcept {
    return Packet<T>::load_float(first + static_cast<std::size_t>(k) * stride);
  }
};

// Headings back into [-pi, pi), quaternions to unit length.
template <class State, class T>
SOOPNAV_INLINE void normalize(ParticleView<State, T>& x) noexcept {
  if constexpr (HoldsRole<State, Role<1, HeadingTag>>) {
    auto& heading = x.values[static_cast<std::size_t>(State::stored_at(kHeading))];
    heading = wrap_to_pi(heading);
  }
  if constexpr (HoldsRole<State, Role<3, AttitudeTag>>) {
    auto* q = x.values.data() + State::stored_at(kAttitude);
    const auto length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; ++i) q[i] = q[i] / length;
  }
}

// Which particles have nothing but finite numbers.
template <class State, class T>
[[nodiscard]] SOOPNAV_INLINE PacketMask<T> finite(const ParticleView<State, T>& x) noexcept {
  auto zero = x.values[0] - x.values[0];
  for (std::size_t i = 1; i < x.values.size(); ++i) zero = zero + (x.values[i] - x.values[i]);
  return zero == Packet<T>(0);
}

/// A chunk of particles by component.
template <class T, int Size>
struct ParticleColumns {
  std::array<const T*, static_cast<std::size_t>(Size)> component;
  template <class State>
  SOOPNAV_INLINE void load(std::size_t at, ParticleView<State, T>& x) const noexcept {
    for (std::size_t c = 0; c < component.size(); ++c) x.values[c] = Packet<T>::load(component[c] + at);
  }
};

}  // namespace detail
}  // namespace soopnav
