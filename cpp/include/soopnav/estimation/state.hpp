#pragma once

#include <Eigen/Core>
#include <concepts>
#include <string_view>
#include <type_traits>

#include "soopnav/core/role.hpp"

namespace soopnav {

/// A state whose roles lie at places known to the compiler.
///
/// `kDim` components are estimated; `kStored >= kDim` are kept, the estimated ones first, so that a state may also
/// carry numbers a model reads but nobody estimates (the stated height of a planar fix). `retract` moves along a
/// tangent vector, `local` is its inverse: `x.local(x.retract(d)) == d`.
template <class S>
concept FixedStateType = requires(const S& s, const typename S::Tangent& d) {
  typename S::Frame;
  { S::kDim } -> std::convertible_to<int>;
  { S::kStored } -> std::convertible_to<int>;
  { s.x.size() } -> std::convertible_to<Eigen::Index>;
  { s.retract(d) } -> std::same_as<S>;
  { s.local(s) } -> std::same_as<typename S::Tangent>;
  { S::component_name(0) } -> std::same_as<std::string_view>;
};

/// Whether state `S` holds `role`.
template <class S, class R>
concept HoldsRole = requires(const S& s, R role) {
  { S::at(role) } -> std::same_as<int>;
  s(role);
};

namespace detail {

template <class Frame>
constexpr std::string_view axis_name(int axis) {
  constexpr std::string_view kNames[][3] = {{"east", "north", "up"}, {"north", "east", "down"}, {"x", "y", "z"}};
  const int row = std::same_as<Frame, EnuFrame> ? 0 : std::same_as<Frame, NedFrame> ? 1 : 2;
  return kNames[row][axis];
}

template <class Frame, int Dim, class Tag>
constexpr std::string_view role_component_name(Role<Dim, Tag>, int i) {
  if constexpr (std::same_as<Tag, PositionTag>) {
    return axis_name<Frame>(i);
  } else if constexpr (std::same_as<Tag, VelocityTag>) {
    constexpr std::string_view kNames[][3] = {{"east velocity", "north velocity", "up velocity"},
                                              {"north velocity", "east velocity", "down velocity"},
                                              {"x velocity", "y velocity", "z velocity"}};
    return kNames[std::same_as<Frame, EnuFrame> ? 0 : std::same_as<Frame, NedFrame> ? 1 : 2][i];
  } else if constexpr (std::same_as<Tag, ClockBiasTag>) {
    return "clock bias";
  } else {
    static_assert(std::same_as<Tag, ClockDriftTag>, "a VectorState holds position, velocity, clock bias, clock drift");
    return "clock drift";
  }
}

}  // namespace detail

/// A fixed state that is a vector: `Roles` one behind the other, metres and metres per second, in `FrameTag`.
///
/// No heap. Holds no heading (angles wrap, so their states bring their own `retract`).
template <class FrameTag, RoleType... Roles>
struct VectorState {
  using Frame = FrameTag;
  static constexpr int kDim = (Roles::kDim + ...);
  static constexpr int kStored = kDim;
  using Tangent = Eigen::Matrix<double, kDim, 1>;

  Tangent x = Tangent::Zero();  ///< the components, in the order of the roles

  /// First component of a role.
  template <class R>
  requires(std::same_as<R, Roles> || ...) [[nodiscard]] static constexpr int at(R) noexcept {
    int offset = 0;
    bool found = false;
    ((found = found || std::same_as<R, Roles>, offset += found ? 0 : Roles::kDim), ...);
    return offset;
  }

  template <class R>
  requires(std::same_as<R, Roles> || ...) [[nodiscard]] auto operator()(R role) const noexcept {
    return x.template segment<R::kDim>(at(role));
  }
  template <class R>
  requires(std::same_as<R, Roles> || ...) [[nodiscard]] auto operator()(R role) noexcept {
    return x.template segment<R::kDim>(at(role));
  }
  template <int Dim>
  [[nodiscard]] const Known<Dim>& operator()(const Known<Dim>& known) const noexcept {
    return known;
  }

  [[nodiscard]] VectorState retract(const Tangent& d) const noexcept { return {x + d}; }
  [[nodiscard]] Tangent local(const VectorState& other) const noexcept { return other.x - x; }

  /// What component `i` (0 ... kDim-1) is called in a sentence.
  [[nodiscard]] static constexpr std::string_view component_name(int i) noexcept {
    std::string_view name;
    int offset = 0;
    ((name = (i >= offset && i < offset + Roles::kDim) ? detail::role_component_name<Frame>(Roles{}, i - offset) : name,
      offset += Roles::kDim),
     ...);
    return name;
  }
};

/// Position and receiver clock bias [m]: components x, y, z (east, north, up in `EnuFrame`), c * clock bias.
template <class Frame>
using PositionClock = VectorState<Frame, Role<3, PositionTag>, Role<1, ClockBiasTag>>;

/// Position in a plane of stated height, and receiver clock bias [m].
///
/// Estimated: c * clock bias, first axis, second axis (in this order, so that the position stays one segment). The
/// third axis is stored and not estimated: models read a position of three components and their third column is
/// dropped.
template <class FrameTag>
struct PlanarPositionClock {
  static_assert(!std::same_as<FrameTag, EcefFrame>, "a height is stated in a local frame");
  using Frame = FrameTag;
  static constexpr int kDim = 3;
  static constexpr int kStored = 4;
  using Tangent = Eigen::Vector3d;

  Eigen::Vector4d x = Eigen::Vector4d::Zero();  ///< clock bias, first, second, third axis

  [[nodiscard]] static PlanarPositionClock make(const Eigen::Vector3d& position_m, double clock_bias_m) noexcept {
    PlanarPositionClock state;
    state.x << clock_bias_m, position_m;
    return state;
  }

  [[nodiscard]] static constexpr int at(Role<1, ClockBiasTag>) noexcept { return 0; }
  [[nodiscard]] static constexpr int at(Role<3, PositionTag>) noexcept { return 1; }
  [[nodiscard]] static constexpr int at(Role<2, PositionTag>) noexcept { return 1; }
  template <int Dim, class Tag>
  requires requires { PlanarPositionClock::at(Role<Dim, Tag>{}); }
  [[nodiscard]] auto operator()(Role<Dim, Tag> role) const noexcept { return x.template segment<Dim>(at(role)); }
  template <int Dim>
  [[nodiscard]] const Known<Dim>& operator()(const Known<Dim>& known) const noexcept {
    return known;
  }

  [[nodiscard]] PlanarPositionClock retract(const Tangent& d) const noexcept {
    PlanarPositionClock moved = *this;
    moved.x.template head<3>() += d;
    return moved;
  }
  [[nodiscard]] Tangent local(const PlanarPositionClock& other) const noexcept {
    return (other.x - x).template head<3>();
  }
  [[nodiscard]] static constexpr std::string_view component_name(int i) noexcept {
    return i == 0 ? std::string_view("clock bias") : detail::axis_name<Frame>(i - 1);
  }
};

}  // namespace soopnav
