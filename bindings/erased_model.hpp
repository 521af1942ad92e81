#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "models.hpp"
#include "soopnav/core/angle.hpp"
#include "soopnav/estimation/prediction.hpp"
#include "soopnav/estimation/rts_smoother.hpp"
#include "soopnav/estimation/transition.hpp"

/// States whose roles lie where a table says, and models behind function pointers. A filter is then compiled once, for
/// the most components any state has, and a model once, instead of each for every state. Components that a state does
/// not have are independent of the others and of every measurement, so they change nothing.
namespace soopnav::python {

/// First components of the roles of a state, -1 where it has none. No attitudes: numbers and tangents are alike.
struct RoleTable {
  int size = 0;
  int position = -1, position_dim = 0;
  int velocity = -1;  ///< as many components as the position
  int heading = -1;
  int turn_rate = -1;
  int clock_bias = -1;
  int clock_drift = -1;

  template <int Dim, class Tag>
  [[nodiscard]] int at(Role<Dim, Tag>) const noexcept {
    if constexpr (std::same_as<Tag, PositionTag>) return position;
    if constexpr (std::same_as<Tag, VelocityTag>) return velocity;
    if constexpr (std::same_as<Tag, HeadingTag>) return heading;
    if constexpr (std::same_as<Tag, TurnRateTag>) return turn_rate;
    if constexpr (std::same_as<Tag, ClockBiasTag>) return clock_bias;
    if constexpr (std::same_as<Tag, ClockDriftTag>) return clock_drift;
  }
};

/// A shipped or custom state, as values.
struct StateInfo {
  std::string name;
  RoleTable roles;
  std::vector<std::string> components;
};
/// Of the state that `name` and the length of x0 mean (see `resolve_state`).
[[nodiscard]] StateInfo state_info(std::string_view name, std::size_t size);

/// A state of at most `N` numbers, of which those in `angles` wrap.
template <int N>
struct ErasedState {
  using Frame = PlanarFrame;
  static constexpr int kDim = N;
  static constexpr int kStored = N;
  static constexpr int kSize = N;
  using Tangent = Eigen::Matrix<double, N, 1>;
  Eigen::Matrix<double, N, 1> x = Eigen::Matrix<double, N, 1>::Zero();
  std::uint32_t angles = 0;  ///< bit i: component i is kept in [-pi, pi)

  [[nodiscard]] ErasedState retract(const Tangent& d) const noexcept {
    ErasedState moved = *this;
    moved.x += d;
    moved.normalize();
    return moved;
  }
  [[nodiscard]] Tangent local(const ErasedState& other) const noexcept {
    Tangent d = other.x - x;
    for (std::uint32_t rest = angles; rest != 0; rest &= rest - 1) d[first(rest)] = wrap_to_pi(d[first(rest)]);
    return d;
  }
  void normalize() noexcept {
    for (std::uint32_t rest = angles; rest != 0; rest &= rest - 1) {
      double& angle = x[first(rest)];
      if (!(angle >= -kPi && angle < kPi)) angle = wrap_to_pi(angle);
    }
  }
  [[nodiscard]] static constexpr std::string_view component_name(int /*i*/) noexcept { return "component"; }

 private:
  [[nodiscard]] static int first(std::uint32_t bits) noexcept { return __builtin_ctz(bits); }
};

/// One row of a measurement model. The context (a model, or a Python callable) must outlive it.
template <int N>
struct ErasedRow {
  static constexpr int kDim = 1;
  /// Writes the row's value and, unless null, its derivatives (zero at entry). False where undefined.
  using Evaluate = bool (*)(const void* context, int row, const RoleTable& roles, const double* x, double* z,
                            double* gradient);
  const void* context = nullptr;
  const RoleTable* roles = nullptr;
  Evaluate evaluate = nullptr;
  int row = 0;
  bool angle = false;  ///< the residual wraps

  template <class Y>
  [[nodiscard]] bool predict(const ErasedState<N>& x, Y& y) const {
    if constexpr (Y::kJacobian) {
      return evaluate(context, row, *roles, x.x.data(), &y.value(0), y.H.data());
    } else {
      return evaluate(context, row, *roles, x.x.data(), &y.value(0), nullptr);
    }
  }
  [[nodiscard]] double residual(int /*row*/, double z, double predicted) const noexcept {
    return angle ? wrap_to_pi(z - predicted) : z - predicted;
  }
};

/// `M` rows as one model.
template <int N, int M>
struct ErasedRows {
  static constexpr int kDim = M;
  const ErasedRow<N>* rows = nullptr;

  [[nodiscard]] bool predict(const ErasedState<N>& x, Prediction<M, ErasedState<N>>& y) const {
    for (int i = 0; i < M; ++i) {
      Prediction<1, ErasedState<N>> one;
      if (!rows[i].predict(x, one)) return false;
      y.z[i] = one.z[0];
      y.H.row(i) = one.H;
    }
    return true;
  }
  [[nodiscard]] double residual(int row, double z, double predicted) const noexcept {
    return rows[row].residual(0, z, predicted);
  }
};

/// What a row needs beside its size.
struct RowSource {
  ErasedRow<1>::Evaluate evaluate = nullptr;
  const void* context = nullptr;
  int row = 0;
  bool angle = false;
};
/// The rows of a model, which must outlive them. Throws std::invalid_argument when the state lacks what it reads.
[[nodiscard]] std::vector<RowSource> row_sources(const AnyMeasurement& measurement, const StateInfo& state);

/// Where an erased process writes: next numbers, transition and noise gain (column-major). F and G may be
/// null. The masks say which of their elements were asked for.
struct StepSink {
  double* next = nullptr;
  double* F = nullptr;
  double* G = nullptr;
  int stride = 0;  ///< rows of F and G
  std::uint64_t F_asked = 0;
  std::uint64_t G_asked = 0;
};

/// A process for states of one table. Copyable; owns its parameters.
struct ProcessSource {
  using Step = bool (*)(const void* motion, const RoleTable& roles, const double* x, const double* u, double dt_s,
                        StepSink& y);
  std::shared_ptr<const void> motion;
  Step step = nullptr;
  int motion_noise = 0;  ///< standard normals of the motion
  OptionalClock clock;
  std::vector<double> sigma;  ///< of the diffusion, per root second
  int input_size = 0;

  /// All parts, one behind the other.
  [[nodiscard]] bool propagate(const RoleTable& roles, const double* x, const double* u, double dt_s,
                               StepSink& y) const;
};
/// Throws std::invalid_argument when the state lacks what the process moves.
[[nodiscard]] ProcessSource process_source(const AnyProcess& process, const StateInfo& state);

/// Most standard normals of a motion and a clock for at most `N` components.
template <int N>
inline constexpr int kMostMotionNoise = N <= 5 ? 6 : 8;

/// A process as the filters take it; driven, whether what is inside is or not.
template <int N>
struct ErasedProcess {
  using Input = std::array<double, 3>;
  static constexpr int kNoise = N + kMostMotionNoise<N>;
  const ProcessSource* source = nullptr;
  const RoleTable* roles = nullptr;

  template <class W, class Y>
  [[nodiscard]] bool propagate(const ErasedState<N>& x, const Input& u, double dt_s, const W& /*w: zero*/, Y& y) const {
    StepSink sink{.next = y.state.x.data()};
    if constexpr (Y::kJacobian) {
      sink.F = y.F.data();
      sink.G = y.G.data();
      sink.stride = N;
    }
    if (!source->propagate(*roles, x.x.data(), u.data(), dt_s, sink)) return false;
    if constexpr (Y::kJacobian) {
      y.F_asked = sink.F_asked;
      y.G_asked = sink.G_asked;
    }
    return true;
  }
};

/// A concrete process on an `ErasedState` that lies as `State` does: nothing at run time, for what is hot.
template <class State, class Process>
struct PlacedProcess {
  using Input = InputOf<Process>;
  static constexpr int kNoise = Process::kNoise;
  static constexpr int kN = State::kDim;
  Process process;

  template <class W, class Y>
  [[nodiscard]] bool propagate(const ErasedState<kN>& x, const Input& u, double dt_s, const W& w, Y& y) const {
    Sink<Y> sink{y};
    return soopnav::detail::propagate(process, View{x.x}, u, dt_s, w, sink);
  }

 private:
  struct View {
    using Frame = typename State::Frame;
    const Eigen::Matrix<double, kN, 1>& x;
    template <class R>
    [[nodiscard]] auto operator()(R role) const noexcept {
      return x.template segment<R::kDim>(State::at(role));
    }
  };
  template <class Y>
  struct Sink {
    static constexpr bool kJacobian = Y::kJacobian;
    Y& y;
    template <class R>
    [[nodiscard]] auto next(R role) noexcept {
      return y.state.x.template segment<R::kDim>(State::at(role));
    }
    template <class To, class From>
    [[nodiscard]] auto transition(To to, From from) noexcept {
      y.F_asked |= rectangle(State::at(to), To::kDim, State::at(from), From::kDim);
      return y.F.template block<To::kDim, From::kDim>(State::at(to), State::at(from));
    }
    template <int First = 0, int Count = kNoise, class R>
    [[nodiscard]] auto noise(R role) noexcept {
      y.G_asked |= rectangle(State::at(role), R::kDim, First, Count);
      return y.G.template block<R::kDim, Count>(State::at(role), First);
    }
  };
  [[nodiscard]] static constexpr std::uint64_t rectangle(int row, int rows, int column, int columns) noexcept {
    std::uint64_t bits = 0;
    for (int j = column; j < column + columns; ++j) {
      for (int i = row; i < row + rows; ++i) bits |= std::uint64_t{1} << (i + kN * j);
    }
    return bits;
  }
};

/// What the smoother takes, padded to the most components.
using PaddedRecord = StepRecord<ErasedState<kMaxCustomDim>>;

/// Smooths a recorded run of states of `n` components into row-major arrays of T x n and T x n x n numbers. False when
/// a record or a smoothed step is not finite.
[[nodiscard]] bool smooth_run(std::span<const PaddedRecord> records, int n, double* x, double* P);

}  // namespace soopnav::python
