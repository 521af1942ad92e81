#pragma once

#include <array>
#include <cstddef>
#include <string_view>
#include <type_traits>

#include "soopnav/core/packet.hpp"
#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state.hpp"

/// A cloud whose state is known at run time only: roles are columns of numbers, found by their offsets.
namespace soopnav::python {

/// Most numbers of a state of a cloud.
inline constexpr std::size_t kMaxColumns = 8;

/// Where a state keeps its roles: the first column of each, -1 for those it does not hold.
struct RoleMap {
  int position = -1;
  int position_dim = 0;
  int velocity = -1;
  int velocity_dim = 0;
  int heading = -1;
  int turn_rate = -1;
  int clock_bias = -1;
  int clock_drift = -1;

  /// First column of a role, -1 when the state does not hold it.
  template <int Dim, class Tag>
  [[nodiscard]] constexpr int find(Role<Dim, Tag>) const noexcept {
    if constexpr (std::is_same_v<Tag, PositionTag>) return position_dim == Dim ? position : -1;
    if constexpr (std::is_same_v<Tag, VelocityTag>) return velocity_dim == Dim ? velocity : -1;
    if constexpr (std::is_same_v<Tag, HeadingTag>) return heading;
    if constexpr (std::is_same_v<Tag, TurnRateTag>) return turn_rate;
    if constexpr (std::is_same_v<Tag, ClockBiasTag>) return clock_bias;
    if constexpr (std::is_same_v<Tag, ClockDriftTag>) return clock_drift;
    return -1;
  }
};

/// The roles of a state that the compiler knows.
template <class State>
[[nodiscard]] constexpr RoleMap role_map() {
  RoleMap map;
  const auto set = [&map]<int Dim>(std::integral_constant<int, Dim>) {
    if constexpr (HoldsRole<State, Role<Dim, PositionTag>>) {
      map.position = State::stored_at(kPositionOf<Dim>);
      map.position_dim = Dim;
    }
    if constexpr (HoldsRole<State, Role<Dim, VelocityTag>>) {
      map.velocity = State::stored_at(kVelocityOf<Dim>);
      map.velocity_dim = Dim;
    }
  };
  set(std::integral_constant<int, 1>{});
  set(std::integral_constant<int, 2>{});
  set(std::integral_constant<int, 3>{});
  if constexpr (HoldsRole<State, Role<1, HeadingTag>>) map.heading = State::stored_at(kHeading);
  if constexpr (HoldsRole<State, Role<1, TurnRateTag>>) map.turn_rate = State::stored_at(kTurnRate);
  if constexpr (HoldsRole<State, Role<1, ClockBiasTag>>) map.clock_bias = State::stored_at(kClockBias);
  if constexpr (HoldsRole<State, Role<1, ClockDriftTag>>) map.clock_drift = State::stored_at(kClockDrift);
  return map;
}

/// `Packet<T>::kWidth` particles as a measurement model sees them: columns, read where they lie.
template <class FrameTag, class T>
struct ColumnView {
  using Frame = FrameTag;
  const RoleMap& roles;
  const T* const* columns;
  std::size_t at;

  struct Components {
    const T* const* first;
    std::size_t at;
    [[nodiscard]] SOOPNAV_INLINE Packet<T> operator[](int i) const noexcept { return Packet<T>::load(first[i] + at); }
  };
  template <int Dim, class Tag>
  [[nodiscard]] SOOPNAV_INLINE Components operator()(Role<Dim, Tag> role) const noexcept {
    return {columns + roles.find(role), at};
  }
  template <int Dim>
  [[nodiscard]] SOOPNAV_INLINE const Known<Dim>& operator()(const Known<Dim>& known) const noexcept {
    return known;
  }
};

}  // namespace soopnav::python
