#pragma once

#include <Eigen/Core>
#include <cmath>

#include "soopnav/core/status.hpp"
#include "soopnav/estimation/covariance_floor.hpp"
#include "soopnav/estimation/detail/small_matrix.hpp"
#include "soopnav/estimation/transition.hpp"

namespace soopnav::detail {

[[nodiscard]] inline bool advances(double dt_s) noexcept { return dt_s > 0.0 && !std::isinf(dt_s); }

/// Asks `process` for the next state, its transition and its noise. kAccepted, kTimeNotAdvancing, kUndefined.
template <class Process, class State>
[[nodiscard]] UpdateStatus linearise(const Process& process, const State& x, const InputOf<Process>& input, double dt_s,
                                     Transition<State, Process::kNoise>& y) {
  if (!advances(dt_s)) return UpdateStatus::kTimeNotAdvancing;
  if (!propagate(process, x, input, dt_s, ZeroNoise{}, y)) return UpdateStatus::kUndefined;
  y.state.normalize();
  return UpdateStatus::kAccepted;
}

/// The extended filter's prediction of state and covariance, F P Fᵀ + G Gᵀ, for filters that share it.
template <class Process, class State, class Square>
[[nodiscard]] UpdateStatus extended_predict(const Process& process, const InputOf<Process>& input, double dt_s,
                                            State& state, Square& P, CovarianceFloor<State::kDim>& floor,
                                            Square* cross) {
  Transition<State, Process::kNoise> y(state);
  const UpdateStatus status = linearise(process, state, input, dt_s, y);
  if (status != UpdateStatus::kAccepted) return status;
  Square A;
  Square next;
  propagate_covariance(y, P, A, next);
  if (!all_finite(y.state.x) || !all_finite(next)) return UpdateStatus::kNonFinite;
  floor.apply(next);
  if (cross != nullptr) *cross = A.transpose();
  state = y.state;
  P = next;
  return UpdateStatus::kAccepted;
}

}  // namespace soopnav::detail
