#pragma once

#include <Eigen/Core>
#include <concepts>
#include <cstdint>
#include <utility>

#include "soopnav/core/joint_process.hpp"
#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav {

/// What a process model writes when it is asked for the next state, its transition matrix and its noise.
///
/// On entry `state` is the present state, `F` the identity and `G` zero; the model writes what it changes. In the
/// tangent, `d_next = F d + G w` with `w` of `Noise` independent standard normals, so the covariance becomes
/// F P Fᵀ + G Gᵀ. Small transitions remember which elements a model asked for, so that only those cost. No heap.
template <FixedStateType StateType, int Noise>
struct Transition {
  using State = StateType;
  static constexpr bool kJacobian = true;
  static constexpr int kN = State::kStored;
  /// Whether the elements asked for are remembered.
  static constexpr bool kTracked = kN <= 5 && kN * Noise <= 64;

  State state;
  Eigen::Matrix<double, kN, kN> F = Eigen::Matrix<double, kN, kN>::Identity();
  Eigen::Matrix<double, kN, Noise> G = Eigen::Matrix<double, kN, Noise>::Zero();
  std::uint64_t F_asked = 0;  ///< bit i + kN * j: element (i, j) of F may differ from the identity's
  std::uint64_t G_asked = 0;  ///< bit i + kN * k: element (i, k) of G may differ from zero

  explicit Transition(const State& x) noexcept : state(x) {}

  /// The numbers of a role in the next state.
  template <class R>
  requires HoldsRole<State, R>
  [[nodiscard]] auto next(R role) noexcept { return state(role); }
  /// d next(to) / d now(from), in the tangent.
  template <class To, class From>
  requires HoldsRole<State, To> && HoldsRole<State, From>
  [[nodiscard]] auto transition(To to, From from) noexcept {
    F_asked |= rectangle(State::at(to), To::kDim, State::at(from), From::kDim);
    return F.template block<To::kDim, From::kDim>(State::at(to), State::at(from));
  }
  /// Rows of G of a role; `Count` of its columns from `First` on.
  template <int First = 0, int Count = Noise, class R>
  requires HoldsRole<State, R>
  [[nodiscard]] auto noise(R role) noexcept {
    G_asked |= rectangle(State::at(role), R::kDim, First, Count);
    return G.template block<R::kDim, Count>(State::at(role), First);
  }
  /// Multiplies what was written to G so far; `Count` of its columns from `First` on.
  template <int First = 0, int Count = Noise>
  void scale_noise(double factor) noexcept {
    G.template middleCols<Count>(First) *= factor;
  }

 private:
  [[nodiscard]] static constexpr std::uint64_t rectangle(int row, int rows, int column, int columns) noexcept {
    std::uint64_t bits = 0;
    if constexpr (kTracked) {
      for (int j = column; j < column + columns; ++j) {
        for (int i = row; i < row + rows; ++i) bits |= std::uint64_t{1} << (i + kN * j);
      }
    }
    return bits;
  }
};

namespace detail {

// Calls body(i, j) for the elements of a kRows x kColumns matrix (bits at i + kStride * j) that are asked for.
template <int kRows, int kColumns, int kStride, class Body>
[[gnu::always_inline]] inline void for_each_asked(std::uint64_t asked, const Body& body) noexcept {
  [&]<int... K>(std::integer_sequence<int, K...>) {
    ((asked >> (K % kRows + kStride * (K / kRows)) & 1 ? body(K % kRows, K / kRows) : void()), ...);
  }
  (std::make_integer_sequence<int, kRows * kColumns>{});
}

/// A = F P and P_next = A Fᵀ + G Gᵀ, symmetric, over the estimated components.
template <class State, int Noise, class Square>
void propagate_covariance(const Transition<State, Noise>& y, const Square& P, Square& A, Square& next) noexcept {
  constexpr int kDim = State::kDim;
  constexpr int kN = State::kStored;
  if constexpr (Transition<State, Noise>::kTracked) {
    // With E = F - I: A = P + E P, then P_next = A + A Eᵀ + G Gᵀ. The lists of elements are unrolled, so that those
    // nobody asked for leave no trace once the model is inlined.
    const auto E = [&y](int i, int j) { return i == j ? y.F(i, j) - 1.0 : y.F(i, j); };
    A = P;
    for_each_asked<kDim, kDim, kN>(y.F_asked, [&](int i, int j) {
      const double e = E(i, j);
      for (int c = 0; c < kDim; ++c) A(i, c) += e * P(j, c);
    });
    next = A;
    for_each_asked<kDim, kDim, kN>(y.F_asked, [&](int i, int j) {
      const double e = E(i, j);
      for (int r = 0; r < kDim; ++r) next(r, i) += e * A(r, j);
    });
    for_each_asked<kDim, Noise, kN>(y.G_asked, [&](int i, int k) {
      const double g = y.G(i, k);
      for (int r = i; r < kDim; ++r) next(r, i) += g * y.G(r, k);
    });
  } else {
    const auto F = y.F.template topLeftCorner<kDim, kDim>();
    const auto G = y.G.template topRows<kDim>();
    A.noalias() = F * P;
    next.noalias() = A * F.transpose();
    next.noalias() += G * G.transpose();
  }
  for (int j = 1; j < kDim; ++j) {
    for (int i = 0; i < j; ++i) next(i, j) = next(j, i);
  }
}

}  // namespace detail

/// What a process model writes when only the next state is wanted (sigma points, simulation).
template <FixedStateType StateType>
struct ValueTransition {
  using State = StateType;
  static constexpr bool kJacobian = false;
  State state;

  explicit ValueTransition(const State& x) noexcept : state(x) {}
  template <class R>
  requires HoldsRole<State, R>
  [[nodiscard]] auto next(R role) noexcept { return state(role); }
};

/// The noise of a Kalman filter's prediction: every standard normal at its mean.
struct ZeroNoise {
  [[nodiscard]] constexpr double operator[](int /*i*/) const noexcept { return 0.0; }
};

/// A process model that can move `State`: `propagate` writes the next state, its transition and the gain of its
/// `Process::kNoise` standard normals, and answers false where it is undefined.
template <class Process, class State>
concept ProcessModelFor = FixedStateType<State> && FrameCompatible<Process, State> &&
    requires(const Process& m, const State& x, const InputOf<Process>& u, Transition<State, Process::kNoise>& y) {
  { Process::kNoise } -> std::convertible_to<int>;
  { detail::propagate(m, x, u, 1.0, ZeroNoise{}, y) } -> std::same_as<bool>;
};

}  // namespace soopnav
