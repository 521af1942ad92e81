#pragma once

#include <array>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <map>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "array.hpp"
#include "soopnav/clock/two_state.hpp"
#include "soopnav/core/joint_process.hpp"
#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/inertial/planar_mechanization.hpp"
#include "soopnav/measurement/azimuth.hpp"
#include "soopnav/measurement/carrier_phase.hpp"
#include "soopnav/measurement/direction.hpp"
#include "soopnav/measurement/planar_increment.hpp"
#include "soopnav/measurement/position_fix.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "soopnav/measurement/range.hpp"
#include "soopnav/measurement/range_difference.hpp"
#include "soopnav/measurement/range_rate.hpp"
#include "soopnav/measurement/received_power.hpp"
#include "soopnav/process/coordinated_turn.hpp"
#include "soopnav/process/nearly_constant_velocity.hpp"
#include "soopnav/process/planar_odometry.hpp"

/// The states, measurement models and process models that Python can name, as values chosen at run time.
///
/// Filters are compiled for each state of `ShippedStates`. `visit_measurement` and `visit_process` give the concrete
/// model to a callable, and refuse (std::invalid_argument) a state that lacks what the model reads.
namespace soopnav::python {

// --- States ---

struct CustomTag {
  static constexpr std::string_view kName = "component";
};
/// `N` plain numbers, for models that are Python callables.
template <int N>
using CustomState = ComposedState<PlanarFrame, Role<N, CustomTag>>;

/// Python's 3-D numbers may be of any Cartesian frame; azimuths count from its second axis.
template <int Dim>
using FrameOf = std::conditional_t<Dim == 3, EnuFrame, PlanarFrame>;

template <int Dim>
using PositionState = ComposedState<FrameOf<Dim>, Role<Dim, PositionTag>>;
template <int Dim>
using PositionVelocityState = ComposedState<FrameOf<Dim>, Role<Dim, PositionTag>, Role<Dim, VelocityTag>>;
template <int Dim>
using PositionClockState = ComposedState<FrameOf<Dim>, Role<Dim, PositionTag>, Role<1, ClockBiasTag>>;
using PositionVelocityBias2 =
    ComposedState<PlanarFrame, Role<2, PositionTag>, Role<2, VelocityTag>, Role<1, ClockBiasTag>>;
template <int Dim>
using PositionVelocityClockState = PositionVelocityClock<FrameOf<Dim>, Dim>;
using Pose2 = ComposedState<PlanarFrame, Role<2, PositionTag>, Role<1, HeadingTag>>;
using CoordinatedTurnState =
    ComposedState<PlanarFrame, Role<2, PositionTag>, Role<2, VelocityTag>, Role<1, TurnRateTag>>;

/// A state and what Python calls it.
template <Name kText, FixedStateType StateType>
struct NamedState {
  using State = StateType;
  static constexpr std::string_view kName = kText.text;
};
template <class... Entries>
struct StateList {};

using ShippedStates = StateList<
    NamedState<"position1", PositionState<1>>, NamedState<"position2", PositionState<2>>,
    NamedState<"position3", PositionState<3>>, NamedState<"position_velocity1", PositionVelocityState<1>>,
    NamedState<"position_velocity2", PositionVelocityState<2>>,
    NamedState<"position_velocity3", PositionVelocityState<3>>, NamedState<"position_clock2", PositionClockState<2>>,
    NamedState<"position_clock3", PositionClockState<3>>, NamedState<"position_velocity_bias2", PositionVelocityBias2>,
    NamedState<"position_velocity_clock2", PositionVelocityClockState<2>>,
    NamedState<"position_velocity_clock3", PositionVelocityClockState<3>>,
    NamedState<"planar_inertial", PlanarInertialState>, NamedState<"pose2", Pose2>,
    NamedState<"coordinated_turn", CoordinatedTurnState>>;

/// Sizes of "custom" states that are compiled.
inline constexpr int kMaxCustomDim = 8;

namespace detail {

template <class State, class List>
struct NameIn;
template <class State, class... Entries>
struct NameIn<State, StateList<Entries...>> {
  static constexpr std::string_view value = [] {
    std::string_view name = "custom";
    ((name = std::same_as<State, typename Entries::State> ? Entries::kName : name), ...);
    return name;
  }();
};
template <class State>
inline constexpr bool kIsCustom = false;
template <int N>
inline constexpr bool kIsCustom<CustomState<N>> = true;

[[nodiscard]] inline bool is_digit(char c) noexcept { return c >= '0' && c <= '9'; }

}  // namespace detail

/// "position2"; "custom" for a custom state.
template <class State>
inline constexpr std::string_view kStateName = detail::NameIn<State, ShippedStates>::value;

/// Names of the tangent's components; "x[0]", "x[1]", ... of a custom state.
template <class State>
[[nodiscard]] std::vector<std::string> component_names() {
  std::vector<std::string> names;
  for (int i = 0; i < State::kDim; ++i) {
    names.push_back(detail::kIsCustom<State> ? "x[" + std::to_string(i) + "]" : std::string(State::component_name(i)));
  }
  return names;
}

/// The full name of the state that `name` and the length of x0 mean: the trailing digit may have been left out. Throws
/// std::invalid_argument that lists the states, or says how many numbers the state has.
[[nodiscard]] std::string resolve_state(std::string_view name, std::size_t size);

/// Calls `f(std::type_identity<State>{})` for the state that `name` and the length of x0 mean (see `resolve_state`).
/// `f` returns the same type for all.
template <class F>
auto with_state(std::string_view name, std::size_t size, F&& f) {
  using Result = decltype(f(std::type_identity<Pose2>{}));
  const std::string full = resolve_state(name, size);
  std::optional<Result> result;
  [&]<class... Entries>(StateList<Entries...>) {
    const auto attempt = [&]<class Entry>(std::type_identity<Entry>) {
      if (!result && full == Entry::kName) result.emplace(f(std::type_identity<typename Entry::State>{}));
    };
    (attempt(std::type_identity<Entries>{}), ...);
  }(ShippedStates{});
  [&]<int... N>(std::integer_sequence<int, N...>) {
    const auto attempt = [&]<int kDim>(std::integral_constant<int, kDim>) {
      if (!result && size == static_cast<std::size_t>(kDim)) result.emplace(f(std::type_identity<CustomState<kDim>>{}));
    };
    if (full == "custom") (attempt(std::integral_constant<int, N + 1>{}), ...);
  }
  (std::make_integer_sequence<int, kMaxCustomDim>{});
  return std::move(*result);
}

// --- Parameters ---

/// Named numbers that a model was made from: what its repr shows and a pickle keeps.
class Parameters {
 public:
  using Values = std::vector<std::pair<std::string, std::vector<double>>>;

  Parameters() = default;
  explicit Parameters(Values values) : values_(std::move(values)) {}

  [[nodiscard]] const Values& values() const noexcept { return values_; }
  [[nodiscard]] bool has(std::string_view name) const noexcept { return find(name) != nullptr; }
  /// Finite numbers, one of `sizes` many; std::invalid_argument names the parameter otherwise.
  [[nodiscard]] std::span<const double> numbers(std::string_view name, std::initializer_list<std::size_t> sizes) const;
  /// One finite number; `fallback` when there is none by this name.
  [[nodiscard]] double number(std::string_view name, std::optional<double> fallback = std::nullopt) const;
  [[nodiscard]] double positive(std::string_view name, std::optional<double> fallback = std::nullopt) const;
  [[nodiscard]] double not_negative(std::string_view name, std::optional<double> fallback = std::nullopt) const;
  /// `Dim` finite numbers; zeros when there are none by this name.
  template <int Dim>
  [[nodiscard]] Known<Dim> known(std::string_view name) const {
    Known<Dim> value;
    if (!has(name)) return value;
    const auto from = numbers(name, {static_cast<std::size_t>(Dim)});
    for (std::size_t i = 0; i < from.size(); ++i) value.value[i] = from[i];
    return value;
  }
  /// "source_m=[3, 4], bias_m=1".
  [[nodiscard]] std::string text() const;
  friend bool operator==(const Parameters&, const Parameters&) = default;

 private:
  [[nodiscard]] const std::vector<double>* find(std::string_view name) const noexcept;
  Values values_;
};

// --- Measurement models ---

template <int Dim>
using Range_ = Range<FrameOf<Dim>, Known<Dim>>;
template <int Dim>
using RangeDifference_ = RangeDifference<FrameOf<Dim>, Known<Dim>>;
template <int Dim>
using Pseudorange_ = Pseudorange<FrameOf<Dim>, Known<1>, Known<Dim>>;
template <int Dim, class Clock>
using Tdoa_ = Tdoa<FrameOf<Dim>, Known<Dim>, Known<Dim>, Clock>;
template <int Dim, class Drift>
using RangeRate_ = RangeRate<FrameOf<Dim>, Known<Dim>, Known<Dim>, Known<1>, Drift>;
template <int Dim, class Drift>
using Doppler_ = Doppler<FrameOf<Dim>, Known<Dim>, Known<Dim>, Known<1>, Drift>;
template <int Dim, class Drift>
using Fdoa_ = Fdoa<FrameOf<Dim>, Known<Dim>, Known<Dim>, Known<Dim>, Known<Dim>, Drift>;
template <int Dim>
using Azimuth_ = Azimuth<FrameOf<Dim>, Known<1>, Known<Dim>>;
using RelativeAzimuth2 = Azimuth<PlanarFrame, Role<1, HeadingTag>, Known<2>>;
template <int Dim>
using ReceivedPower_ = ReceivedPower<FrameOf<Dim>, Known<Dim>>;
template <int Dim>
using CarrierPhase_ = CarrierPhase<FrameOf<Dim>, Known<1>, Known<1>, Known<Dim>>;
using ClockBiasRole = Role<1, ClockBiasTag>;
using ClockDriftRole = Role<1, ClockDriftTag>;

using MeasurementVariant = std::variant<
    PositionFix<PlanarFrame, 1>, PositionFix<PlanarFrame, 2>, PositionFix<EnuFrame, 3>,                              //
    Range_<2>, Range_<3>, RangeDifference_<2>, RangeDifference_<3>,                                                  //
    Pseudorange_<2>, Pseudorange_<3>,                                                                                //
    Tdoa_<2, Known<1>>, Tdoa_<3, Known<1>>, Tdoa_<2, ClockBiasRole>, Tdoa_<3, ClockBiasRole>,                        //
    RangeRate_<2, Known<1>>, RangeRate_<3, Known<1>>, RangeRate_<2, ClockDriftRole>, RangeRate_<3, ClockDriftRole>,  //
    Doppler_<2, Known<1>>, Doppler_<3, Known<1>>, Doppler_<2, ClockDriftRole>, Doppler_<3, ClockDriftRole>,          //
    Fdoa_<2, Known<1>>, Fdoa_<3, Known<1>>, Fdoa_<2, ClockDriftRole>, Fdoa_<3, ClockDriftRole>,                      //
    Azimuth_<2>, Azimuth_<3>, RelativeAzimuth2, Elevation<EnuFrame>, AzimuthElevation<EnuFrame>,                     //
    ReceivedPower_<2>, ReceivedPower_<3>, CarrierPhase_<2>, CarrierPhase_<3>, PlanarIncrement<PlanarFrame>>;

/// A measurement model chosen at run time. Immutable.
class AnyMeasurement {
 public:
  /// `kind`: "Range", "Pseudorange", ...; std::invalid_argument for parameters that break its rules.
  AnyMeasurement(std::string kind, Parameters parameters);

  [[nodiscard]] const std::string& kind() const noexcept { return kind_; }
  [[nodiscard]] const Parameters& parameters() const noexcept { return parameters_; }
  [[nodiscard]] const MeasurementVariant& model() const noexcept { return model_; }
  /// Rows of z.
  [[nodiscard]] int rows() const noexcept;
  [[nodiscard]] std::string text() const { return kind_ + "(" + parameters_.text() + ")"; }
  friend bool operator==(const AnyMeasurement& a, const AnyMeasurement& b) {
    return a.kind_ == b.kind_ && a.parameters_ == b.parameters_;
  }

 private:
  std::string kind_;
  Parameters parameters_;
  MeasurementVariant model_;
};

namespace detail {

// Whether a state has every role among the template arguments of a model.
template <class State, class Part>
inline constexpr bool kHoldsPart = !RoleType<Part> || HoldsRole<State, std::remove_cvref_t<Part>>;
template <class State, class Model>
struct CanRead;
template <class State, template <class...> class Model, class... Parts>
struct CanRead<State, Model<Parts...>> : std::bool_constant<(kHoldsPart<State, Parts> && ...)> {};
template <class State, class Frame, int Dim, class Part>
struct CanRead<State, PositionFix<Frame, Dim, Part>> : std::bool_constant<kHoldsPart<State, Part>> {};

/// std::invalid_argument: "Pseudorange: state 'position2' has no clock bias; states that have all it reads: ...".
[[noreturn]] void refuse_state(const AnyMeasurement& measurement, std::string_view state);

}  // namespace detail

/// Throws std::invalid_argument when the shipped state of that name lacks what a measurement model reads.
void require_readable(const AnyMeasurement& measurement, std::string_view state);

/// Whether a state has all that a measurement model reads, in its frame.
template <class State, class Model>
inline constexpr bool kCanRead = FrameCompatible<Model, State>&& detail::CanRead<State, Model>::value;

/// Calls `f(model)` with the concrete model, which lies inside `measurement`. Throws std::invalid_argument when `State`
/// lacks what it reads.
template <class Result, class State, class F>
Result visit_measurement(const AnyMeasurement& measurement, F&& f) {
  return std::visit(
      [&]<class Model>(const Model& model) -> Result {
        if constexpr (kCanRead<State, Model>) {
          return f(model);
        } else {
          detail::refuse_state(measurement, kStateName<State>);
        }
      },
      measurement.model());
}

// --- Process models ---

/// No motion.
struct Still {
  static constexpr int kNoise = 0;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& /*x*/, double /*dt_s*/, const W& /*w*/, Y& /*y*/) const {
    return true;
  }
};

/// A two-state clock, or none: bias and drift then stay.
struct OptionalClock {
  static constexpr int kNoise = 2;
  std::optional<clock::ClockNoise> noise;

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    return !noise || clock::TwoState<>{*noise}.propagate(x, dt_s, w, y);
  }
};

/// Independent random walks of all components of a state, on top of what another process wrote.
template <class State>
struct Diffusion;
template <class Frame, class... Roles>
struct Diffusion<ComposedState<Frame, Roles...>> {
  using State = ComposedState<Frame, Roles...>;
  static constexpr int kNoise = State::kDim;
  std::array<double, static_cast<std::size_t>(State::kDim)> sigma{};  ///< square roots of the power densities

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& /*x*/, double dt_s, const W& w, Y& y) const {
    const double root = std::sqrt(dt_s);
    const auto add = [&]<class R>(R role) {
      static_assert(!soopnav::detail::kIsRotation<R>);
      auto&& next = y.next(role);
      for (int i = 0; i < R::kDim; ++i) {
        const double step = sigma[static_cast<std::size_t>(State::at(role) + i)] * root;
        next[i] += step * w[State::at(role) + i];
        if constexpr (Y::kJacobian) y.noise(role)(i, State::at(role) + i) = step;
      }
    };
    (add(Roles{}), ...);
    return true;
  }
};

/// A state with a clock of two states.
template <class State>
inline constexpr bool kHasClock = HoldsRole<State, Role<1, ClockBiasTag>>&& HoldsRole<State, Role<1, ClockDriftTag>>;

/// What `visit_process` hands out for a motion: with the clock where the state has one, and a diffusion.
template <class State, class Motion>
using ComposedProcess =
    std::conditional_t<kHasClock<State>, JointProcess<Motion, JointProcess<OptionalClock, Diffusion<State>>>,
                       JointProcess<Motion, Diffusion<State>>>;

enum class MotionKind {
  kRandomWalk,
  kNearlyConstantVelocity,
  kPiecewiseConstantAcceleration,
  kCoordinatedTurn,
  kPlanarMechanization,
  kPlanarOdometry,
};

/// A process model chosen at run time: a motion, a two-state clock or none, and a diffusion. Immutable.
class AnyProcess {
 public:
  /// `kind`: "RandomWalk", "NearlyConstantVelocity", ...; std::invalid_argument for parameters that break its rules.
  AnyProcess(std::string kind, Parameters parameters);

  [[nodiscard]] const std::string& kind() const noexcept { return kind_; }
  [[nodiscard]] const Parameters& parameters() const noexcept { return parameters_; }
  [[nodiscard]] MotionKind motion() const noexcept { return motion_; }
  [[nodiscard]] const std::optional<clock::ClockNoise>& clock() const noexcept { return clock_; }
  /// Numbers of an input: 3 for an inertial sample or an increment of odometry, else 0.
  [[nodiscard]] int input_size() const noexcept {
    return motion_ == MotionKind::kPlanarMechanization || motion_ == MotionKind::kPlanarOdometry ? 3 : 0;
  }
  [[nodiscard]] std::string text() const { return kind_ + "(" + parameters_.text() + ")"; }
  friend bool operator==(const AnyProcess& a, const AnyProcess& b) {
    return a.kind_ == b.kind_ && a.parameters_ == b.parameters_;
  }

  /// The motion's one parameter per axis, a single number standing for all. std::invalid_argument names the parameter.
  template <int Dim>
  [[nodiscard]] std::array<double, static_cast<std::size_t>(Dim)> per_axis() const {
    std::array<double, static_cast<std::size_t>(Dim)> values{};
    spread(per_axis_name_, values);
    return values;
  }
  /// Per component of `State`; a single number stands for all. std::invalid_argument names the parameter.
  template <class State>
  [[nodiscard]] Diffusion<State> diffusion() const {
    Diffusion<State> diffusion;
    spread(diffusion_name_, diffusion.sigma);
    for (double& value : diffusion.sigma) value = std::sqrt(value);
    return diffusion;
  }
  /// Standard deviations of the diffusion per root second, `size` of them.
  [[nodiscard]] std::vector<double> diffusion_sigma(int size) const;
  [[nodiscard]] CoordinatedTurn<> coordinated_turn() const;
  [[nodiscard]] inertial::PlanarMechanization planar_mechanization() const;
  [[nodiscard]] PlanarOdometry planar_odometry() const;
  /// Throws std::invalid_argument when a clock is given to a state without one, or the other way round.
  void check_clock(bool state_has_clock, std::string_view state) const;
  [[noreturn]] void refuse_state(std::string_view state, std::string_view lacking) const;

 private:
  void spread(const char* name, std::span<double> values) const;

  std::string kind_;
  Parameters parameters_;
  MotionKind motion_ = MotionKind::kRandomWalk;
  std::optional<clock::ClockNoise> clock_;
  const char* per_axis_name_ = "";
  const char* diffusion_name_ = "diffusion_psd";
};

/// What a motion is driven with, from the numbers Python gave (`AnyProcess::input_size` of them).
template <class Motion>
[[nodiscard]] InputOf<Motion> input_of([[maybe_unused]] const double* numbers) noexcept {
  InputOf<Motion> input{};
  if constexpr (std::same_as<InputOf<Motion>, inertial::PlanarImuSample>) {
    input.yaw_rate_radps = numbers[0];
    input.specific_force_b_mps2 = {numbers[1], numbers[2]};
  } else if constexpr (std::same_as<InputOf<Motion>, PlanarDisplacement>) {
    input.translation_b_m = {numbers[0], numbers[1]};
    input.turn_rad = numbers[2];
  }
  return input;
}

/// Components of a state's position; 0 without one.
template <class State>
inline constexpr int kPositionDim = HoldsRole<State, Role<1, PositionTag>>   ? 1
                                    : HoldsRole<State, Role<2, PositionTag>> ? 2
                                    : HoldsRole<State, Role<3, PositionTag>> ? 3
                                                                             : 0;
/// Whether a state has position and velocity of as many components.
template <class State>
inline constexpr bool kMoves =
    kPositionDim<State> != 0 && HoldsRole<State, Role<kPositionDim<State> == 0 ? 1 : kPositionDim<State>, VelocityTag>>;

/// Calls `f(motion)` with the bare motion: `Still`, `NearlyConstantVelocity`, ... Throws std::invalid_argument when
/// `State` lacks what it moves.
template <class Result, class State, class F>
Result visit_motion(const AnyProcess& process, F&& f) {
  constexpr std::string_view kState = kStateName<State>;
  if (process.motion() != MotionKind::kRandomWalk || process.clock()) process.check_clock(kHasClock<State>, kState);
  switch (process.motion()) {
    case MotionKind::kRandomWalk:
      return f(Still{});
    case MotionKind::kNearlyConstantVelocity:
      if constexpr (kMoves<State>) {
        constexpr int kDim = kPositionDim<State>;
        return f(NearlyConstantVelocity<kDim>{.acceleration_psd = process.per_axis<kDim>()});
      }
      process.refuse_state(kState, "a velocity");
    case MotionKind::kPiecewiseConstantAcceleration:
      if constexpr (kMoves<State>) {
        constexpr int kDim = kPositionDim<State>;
        return f(PiecewiseConstantAcceleration<kDim>{.acceleration_sigma_mps2 = process.per_axis<kDim>()});
      }
      process.refuse_state(kState, "a velocity");
    case MotionKind::kCoordinatedTurn:
      if constexpr (HoldsRole<State, Role<1, TurnRateTag>>) return f(process.coordinated_turn());
      process.refuse_state(kState, "a turn rate");
    case MotionKind::kPlanarMechanization:
      if constexpr (HoldsRole<State, Role<1, HeadingTag>> && HoldsRole<State, Role<2, VelocityTag>>) {
        return f(process.planar_mechanization());
      }
      process.refuse_state(kState, "a heading and a velocity");
    case MotionKind::kPlanarOdometry:
      if constexpr (HoldsRole<State, Role<1, HeadingTag>>) return f(process.planar_odometry());
      process.refuse_state(kState, "a heading");
  }
  process.refuse_state(kState, "its motion");
}

/// `motion` with the clock and the diffusion of `process`.
template <class State, class Motion>
[[nodiscard]] ComposedProcess<State, Motion> compose(const AnyProcess& process, const Motion& motion) {
  if constexpr (kHasClock<State>) {
    return {motion, {OptionalClock{process.clock()}, process.diffusion<State>()}};
  } else {
    return {motion, process.diffusion<State>()};
  }
}

/// Calls `f(composed)` with a `ComposedProcess<State, Motion>`. Throws std::invalid_argument when `State` does not fit.
template <class Result, class State, class F>
Result visit_process(const AnyProcess& process, F&& f) {
  return visit_motion<Result, State>(process,
                                     [&](const auto& motion) -> Result { return f(compose<State>(process, motion)); });
}

/// Most standard normals that a process of `State` consumes.
template <class State>
inline constexpr int kMostNoise = State::kDim + (kHasClock<State> ? 2 : 0) +
                                  (HoldsRole<State, Role<1, TurnRateTag>>  ? 6
                                   : kMoves<State>                         ? 2 * kPositionDim<State>
                                   : HoldsRole<State, Role<1, HeadingTag>> ? 3
                                                                           : 0);

}  // namespace soopnav::python
