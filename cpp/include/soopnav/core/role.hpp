#pragma once

#include <Eigen/Core>
#include <array>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace soopnav {

/// A role: what `Dim` components of a state mean, whichever state holds them and wherever it puts them.
///
/// A measurement model reads `x(role)` and writes `y.jacobian(role)`; the state (or the particle cloud, or the
/// simulator) says at compile time where the role lies. A role has no data: it is passed by value and costs nothing.
/// `Tag` may be incomplete. Roles of one tag and different `Dim` are different types.
template <int Dim, class Tag>
struct Role {
  static_assert(Dim >= 1, "a role has at least one component");
  static constexpr int kDim = Dim;
};

struct PositionTag;
struct VelocityTag;
struct HeadingTag;
struct TurnRateTag;
struct AttitudeTag;
struct ClockBiasTag;
struct ClockDriftTag;

/// Position of the receiver in the state's Cartesian frame, `Dim` components [m]. For models written once for 2-D and
/// 3-D.
template <int Dim>
inline constexpr Role<Dim, PositionTag> kPositionOf{};

/// Velocity of the receiver in the state's Cartesian frame, `Dim` components [m/s].
template <int Dim>
inline constexpr Role<Dim, VelocityTag> kVelocityOf{};

inline constexpr auto kPosition = kPositionOf<3>;        ///< position, three components [m]
inline constexpr auto kPlanarPosition = kPositionOf<2>;  ///< position in a plane, two components [m]
inline constexpr auto kVelocity = kVelocityOf<3>;        ///< velocity, three components [m/s]
inline constexpr auto kPlanarVelocity = kVelocityOf<2>;  ///< velocity in a plane, two components [m/s]

/// Heading of a planar state [rad]: from its first axis towards its second, wrapped to [-pi, pi) by the state.
inline constexpr Role<1, HeadingTag> kHeading{};

/// Turn rate of a planar state [rad/s]: the time derivative of `kHeading`, or of the direction of the velocity.
inline constexpr Role<1, TurnRateTag> kTurnRate{};

/// Attitude: the rotation from the body frame b to the state's Cartesian frame n. Its value is the unit quaternion
/// q_n_b as four numbers w, x, y, z; its tangent is a rotation vector in the body frame [rad], q <- q * exp(d).
inline constexpr Role<3, AttitudeTag> kAttitude{};

/// Receiver clock bias, c * (receiver clock - system time) [m]; it lengthens every pseudorange.
inline constexpr Role<1, ClockBiasTag> kClockBias{};

/// Receiver clock drift, the time derivative of `kClockBias` [m/s].
inline constexpr Role<1, ClockDriftTag> kClockDrift{};

/// Handle of `Dim` states that a `StateLayout` placed at run time (the clock of source k, the position of an emitter).
///
/// The layout gives it out and alone knows the offset. `generation` counts how often the slot was given out, so a
/// handle that outlived its states is told from the one that took its slot, and is refused. A default-made handle
/// names nothing and every layout refuses it.
template <int Dim>
struct Block {
  static_assert(Dim >= 1, "a block has at least one component");
  static constexpr int kDim = Dim;
  int slot = -1;
  std::uint32_t generation = 0;
  friend constexpr bool operator==(const Block&, const Block&) = default;
};

/// A number where a model can also take a `Block`: known, so not estimated. Its Jacobian is dropped.
///
/// `Known<1>{3.0}`, `Known<3>{1.0, 2.0, 3.0}`, or from an Eigen vector; zero by default. The unit is that of the
/// parameter it stands for.
template <int Dim>
struct Known {
  static_assert(Dim >= 1, "a known has at least one component");
  static constexpr int kDim = Dim;
  std::array<double, static_cast<std::size_t>(Dim)> value{};

  constexpr Known() = default;
  template <std::convertible_to<double>... T>
  requires(sizeof...(T) == Dim) constexpr Known(T... components)  // NOLINT(google-explicit-constructor): a number is
      : value{static_cast<double>(components)...} {}              // known
  template <class Derived>
  Known(const Eigen::MatrixBase<Derived>& v) {  // NOLINT(google-explicit-constructor): so is a point
    EIGEN_STATIC_ASSERT_VECTOR_SPECIFIC_SIZE(Derived, Dim)
    for (int i = 0; i < Dim; ++i) value[static_cast<std::size_t>(i)] = v[i];
  }
  [[nodiscard]] constexpr double operator[](int i) const noexcept { return value[static_cast<std::size_t>(i)]; }
  friend constexpr bool operator==(const Known&, const Known&) = default;
};

template <class T>
inline constexpr bool kIsRole = false;
template <int Dim, class Tag>
inline constexpr bool kIsRole<Role<Dim, Tag>> = true;
template <class T>
inline constexpr bool kIsBlock = false;
template <int Dim>
inline constexpr bool kIsBlock<Block<Dim>> = true;
template <class T>
inline constexpr bool kIsKnown = false;
template <int Dim>
inline constexpr bool kIsKnown<Known<Dim>> = true;

/// A `Role`: states that lie where the state's type says.
template <class T>
concept RoleType = kIsRole<std::remove_cvref_t<T>>;

/// Anything a state can be asked for: a role, a block or a known.
template <class T>
concept StatePart = RoleType<T> || kIsBlock<std::remove_cvref_t<T>> || kIsKnown<std::remove_cvref_t<T>>;

/// What a model takes for a quantity that may be estimated or not: `Known<Dim>`, `Block<Dim>` or a role of `Dim`
/// components.
template <class T, int Dim>
concept PartOf = StatePart<T> && std::remove_cvref_t<T>::kDim == Dim;

/// Where the Jacobian of a `Known` goes: takes everything a block of a matrix takes (`<<` with commas, `=`, elements),
/// keeps nothing.
struct DiscardedJacobian {
  template <class T>
  constexpr DiscardedJacobian& operator=(const T&) noexcept {
    return *this;
  }
  template <class T>
  constexpr DiscardedJacobian& operator<<(const T&) noexcept {
    return *this;
  }
  template <class T>
  constexpr DiscardedJacobian& operator,(const T&) noexcept {
    return *this;
  }
  template <class T>
  constexpr DiscardedJacobian& operator+=(const T&) noexcept {
    return *this;
  }
  template <class T>
  constexpr DiscardedJacobian& operator-=(const T&) noexcept {
    return *this;
  }
  constexpr DiscardedJacobian& operator()(int /*row*/) noexcept { return *this; }
  constexpr DiscardedJacobian& operator()(int /*row*/, int /*column*/) noexcept { return *this; }
  constexpr DiscardedJacobian& setZero() noexcept { return *this; }
  template <int Rows>
  constexpr DiscardedJacobian middleRows(int /*first*/) noexcept {
    return {};
  }
  constexpr DiscardedJacobian row(int /*row*/) noexcept { return {}; }
  constexpr DiscardedJacobian col(int /*column*/) noexcept { return {}; }
};

/// Cartesian frames a state or a model names with `using Frame = ...`.
struct EcefFrame;    ///< Earth-centred, Earth-fixed
struct EnuFrame;     ///< local east-north-up
struct NedFrame;     ///< local north-east-down
struct PlanarFrame;  ///< a plane with two axes of the user's choice

/// Whether a model may be used with a state: they name the same `Frame`, or the model names none
/// (a range between two points is the same in every Cartesian frame).
template <class Model, class State>
concept FrameCompatible = !requires {
  typename Model::Frame;
}
|| requires { requires std::same_as<typename Model::Frame, typename State::Frame>; };

}  // namespace soopnav
