#pragma once

#include <Eigen/Core>
#include <cmath>
#include <concepts>
#include <string_view>
#include <type_traits>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/role.hpp"

namespace soopnav {

/// A state whose roles lie at places known to the compiler.
///
/// `kDim` tangent components are estimated; Jacobians have `kStored >= kDim` columns, the estimated ones first, so that
/// a state may also carry numbers a model reads but nobody estimates (the stated height of a planar fix). `x` holds the
/// numbers themselves. `retract` moves along a tangent vector, `local` is its inverse: `x.local(x.retract(d)) == d`.
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

/// What a component of a role is called. A tag of a user's own says `static constexpr std::string_view kName`.
template <class Frame, int Dim, class Tag>
constexpr std::string_view role_component_name(Role<Dim, Tag>, int i) {
  if constexpr (std::same_as<Tag, PositionTag>) {
    return axis_name<Frame>(i);
  } else if constexpr (std::same_as<Tag, VelocityTag>) {
    constexpr std::string_view kNames[][3] = {{"east velocity", "north velocity", "up velocity"},
                                              {"north velocity", "east velocity", "down velocity"},
                                              {"x velocity", "y velocity", "z velocity"}};
    return kNames[std::same_as<Frame, EnuFrame> ? 0 : std::same_as<Frame, NedFrame> ? 1 : 2][i];
  } else if constexpr (std::same_as<Tag, HeadingTag>) {
    return "heading";
  } else if constexpr (std::same_as<Tag, TurnRateTag>) {
    return "turn rate";
  } else if constexpr (std::same_as<Tag, AttitudeTag>) {
    constexpr std::string_view kNames[] = {"rotation about body x", "rotation about body y", "rotation about body z"};
    return kNames[i];
  } else if constexpr (std::same_as<Tag, ClockBiasTag>) {
    return "clock bias";
  } else if constexpr (std::same_as<Tag, ClockDriftTag>) {
    return "clock drift";
  } else {
    return Tag::kName;
  }
}

template <class Tag>
inline constexpr bool kIsAngle = std::same_as<Tag, HeadingTag>;
template <class Tag>
inline constexpr bool kIsRotation = std::same_as<Tag, AttitudeTag>;

// Numbers kept for a role: four for a rotation of three degrees of freedom.
template <class R>
inline constexpr int kStoredSize = R::kDim;
template <int Dim, class Tag>
inline constexpr int kStoredSize<Role<Dim, Tag>> = kIsRotation<Tag> ? 4 : Dim;

// Products and logarithms of unit quaternions w, x, y, z.
using Quaternion4 = Eigen::Vector4d;

inline Quaternion4 quaternion_product(const Quaternion4& a, const Quaternion4& b) noexcept {
  return {a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
          a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1], a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]};
}

inline Quaternion4 rotation_exp(const Eigen::Vector3d& v) noexcept {
  const double angle2 = v.squaredNorm();
  const double half = 0.5 * std::sqrt(angle2);
  // sin(half) / (2 half), by its series where the quotient loses digits.
  const double s = angle2 < 1e-6 ? 0.5 - angle2 / 48.0 + angle2 * angle2 / 3840.0 : 0.5 * std::sin(half) / half;
  return {std::cos(half), s * v[0], s * v[1], s * v[2]};
}

inline Eigen::Vector3d rotation_log(const Quaternion4& q) noexcept {
  const Eigen::Vector3d v = q.tail<3>();
  const double sine = v.norm();
  // q and -q are one rotation: the one of the shorter turn.
  const double turn = 2.0 * (q[0] < 0.0 ? std::atan2(-sine, -q[0]) : std::atan2(sine, q[0]));
  const double scale = sine < 1e-10 ? (q[0] < 0.0 ? -2.0 : 2.0) : turn / sine;
  return scale * v;
}

}  // namespace detail

/// A fixed state made of `Roles`, one behind the other, in `FrameTag`; metres, metres per second, radians.
///
/// `x` keeps kSize numbers; the tangent has kDim components. They differ for attitudes: four numbers (the unit
/// quaternion q_n_b as w, x, y, z) and three degrees of freedom. Headings are kept in [-pi, pi). `retract` and `local`
/// add and subtract tangents: plainly for vectors, the short way round for headings, q * exp(d) for attitudes. No heap.
template <class FrameTag, RoleType... Roles>
struct ComposedState {
  using Frame = FrameTag;
  static constexpr int kDim = (Roles::kDim + ...);
  static constexpr int kStored = kDim;
  static constexpr int kSize = (detail::kStoredSize<Roles> + ...);
  using Tangent = Eigen::Matrix<double, kDim, 1>;

  Eigen::Matrix<double, kSize, 1> x = origin();  ///< the numbers, in the order of the roles

  /// First tangent component of a role.
  template <class R>
  requires(std::same_as<R, Roles> || ...) [[nodiscard]] static constexpr int at(R) noexcept {
    int offset = 0;
    bool found = false;
    ((found = found || std::same_as<R, Roles>, offset += found ? 0 : Roles::kDim), ...);
    return offset;
  }
  /// First number of a role in `x`.
  template <class R>
  requires(std::same_as<R, Roles> || ...) [[nodiscard]] static constexpr int stored_at(R) noexcept {
    int offset = 0;
    bool found = false;
    ((found = found || std::same_as<R, Roles>, offset += found ? 0 : detail::kStoredSize<Roles>), ...);
    return offset;
  }

  template <class R>
  requires(std::same_as<R, Roles> || ...) [[nodiscard]] auto operator()(R role) const noexcept {
    return x.template segment<detail::kStoredSize<R>>(stored_at(role));
  }
  template <class R>
  requires(std::same_as<R, Roles> || ...) [[nodiscard]] auto operator()(R role) noexcept {
    return x.template segment<detail::kStoredSize<R>>(stored_at(role));
  }
  template <int Dim>
  [[nodiscard]] const Known<Dim>& operator()(const Known<Dim>& known) const noexcept {
    return known;
  }

  [[nodiscard]] ComposedState retract(const Tangent& d) const noexcept {
    ComposedState moved = *this;
    if constexpr (kIsVector) {
      moved.x += d;
    } else {
      (moved.move(Roles{}, d), ...);
    }
    return moved;
  }
  [[nodiscard]] Tangent local(const ComposedState& other) const noexcept {
    if constexpr (kIsVector) {
      return other.x - x;
    } else {
      Tangent d;
      (difference(Roles{}, other, d), ...);
      return d;
    }
  }
  /// Brings headings back into [-pi, pi) and quaternions to unit length, after a process model wrote `x`.
  void normalize() noexcept {
    if constexpr (!kIsVector) (normalize(Roles{}), ...);
  }

  /// What tangent component `i` (0 ... kDim-1) is called in a sentence.
  [[nodiscard]] static constexpr std::string_view component_name(int i) noexcept {
    std::string_view name;
    int offset = 0;
    ((name = (i >= offset && i < offset + Roles::kDim) ? detail::role_component_name<Frame>(Roles{}, i - offset) : name,
      offset += Roles::kDim),
     ...);
    return name;
  }

 private:
  template <int Dim, class Tag>
  static constexpr bool is_vector(Role<Dim, Tag>) {
    return !detail::kIsAngle<Tag> && !detail::kIsRotation<Tag>;
  }
  static constexpr bool kIsVector = (is_vector(Roles{}) && ...);

  [[nodiscard]] static Eigen::Matrix<double, kSize, 1> origin() noexcept {
    Eigen::Matrix<double, kSize, 1> zero = Eigen::Matrix<double, kSize, 1>::Zero();
    const auto identity = [&zero]<int Dim, class Tag>(Role<Dim, Tag> role) {
      if constexpr (detail::kIsRotation<Tag>) zero[stored_at(role)] = 1.0;
    };
    (identity(Roles{}), ...);
    return zero;
  }
  template <int Dim, class Tag>
  void move(Role<Dim, Tag> role, const Tangent& d) noexcept {
    if constexpr (detail::kIsRotation<Tag>) {
      const detail::Quaternion4 q = (*this)(role);
      (*this)(role) = detail::quaternion_product(q, detail::rotation_exp(d.template segment<3>(at(role)))).normalized();
    } else {
      (*this)(role) += d.template segment<Dim>(at(role));
      if constexpr (detail::kIsAngle<Tag>) normalize(role);
    }
  }
  template <int Dim, class Tag>
  void difference(Role<Dim, Tag> role, const ComposedState& other, Tangent& d) const noexcept {
    if constexpr (detail::kIsRotation<Tag>) {
      detail::Quaternion4 conjugate = (*this)(role);
      conjugate.template tail<3>() *= -1.0;
      d.template segment<3>(at(role)) = detail::rotation_log(detail::quaternion_product(conjugate, other(role)));
    } else {
      d.template segment<Dim>(at(role)) = other(role) - (*this)(role);
      if constexpr (detail::kIsAngle<Tag>) d[at(role)] = wrap_to_pi(d[at(role)]);
    }
  }
  template <int Dim, class Tag>
  void normalize(Role<Dim, Tag> role) noexcept {
    if constexpr (detail::kIsRotation<Tag>) {
      (*this)(role).normalize();
    } else if constexpr (detail::kIsAngle<Tag>) {
      double& angle = x[stored_at(role)];
      if (!(angle >= -kPi && angle < kPi)) angle = wrap_to_pi(angle);
    }
  }
};

/// Position and receiver clock bias [m]: components x, y, z (east, north, up in `EnuFrame`), c * clock bias.
template <class Frame>
using PositionClock = ComposedState<Frame, Role<3, PositionTag>, Role<1, ClockBiasTag>>;

/// The planar inertial state of crosby section 2.5: heading [rad], velocity [m/s], position [m].
using PlanarInertialState = ComposedState<PlanarFrame, Role<1, HeadingTag>, Role<2, VelocityTag>, Role<2, PositionTag>>;

/// Position and velocity in `Dim` (2 or 3) dimensions [m, m/s].
template <class Frame, int Dim>
using PositionVelocity = ComposedState<Frame, Role<Dim, PositionTag>, Role<Dim, VelocityTag>>;

/// Position, velocity, clock bias and clock drift in `Dim` (2 or 3) dimensions [m, m/s, m, m/s].
template <class Frame, int Dim>
using PositionVelocityClock =
    ComposedState<Frame, Role<Dim, PositionTag>, Role<Dim, VelocityTag>, Role<1, ClockBiasTag>, Role<1, ClockDriftTag>>;

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
  template <class R>
  [[nodiscard]] static constexpr int stored_at(R role) noexcept {
    return at(role);
  }
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
  void normalize() noexcept {}
  [[nodiscard]] static constexpr std::string_view component_name(int i) noexcept {
    return i == 0 ? std::string_view("clock bias") : detail::axis_name<Frame>(i - 1);
  }
};

}  // namespace soopnav
