#pragma once

// A vehicle in a plane, moved by a process model with its own noise: what the tests of the Kalman filters' variants
// share.

#include <Eigen/Core>

#include "soopnav/core/random.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/estimation/transition.hpp"
#include "soopnav/measurement/position_fix.hpp"
#include "soopnav/measurement/range.hpp"
#include "soopnav/process/nearly_constant_velocity.hpp"

namespace soopnav::test {

using Vehicle = PositionVelocity<PlanarFrame, 2>;
using Motion = NearlyConstantVelocity<2>;
using Fix = PositionFix<PlanarFrame, 2>;
using PlanarRange = Range<PlanarFrame, Known<2>>;

[[nodiscard]] inline Vehicle vehicle(double x, double y, double vx, double vy) {
  Vehicle state;
  state.x << x, y, vx, vy;
  return state;
}

/// `N` standard normals.
template <int N>
[[nodiscard]] Eigen::Matrix<double, N, 1> normals(RandomStream& random) {
  Eigen::Matrix<double, N, 1> w;
  for (int i = 0; i < N; ++i) w[i] = random.normal();
  return w;
}

/// The state `dt_s` later, its noise drawn from `random`.
template <class State, class Process>
[[nodiscard]] State moved(const State& state, const Process& process, double dt_s, RandomStream& random) {
  const auto w = normals<Process::kNoise>(random);
  ValueTransition<State> next(state);
  static_cast<void>(process.propagate(state, dt_s, w, next));
  next.state.normalize();
  return next.state;
}

}  // namespace soopnav::test
