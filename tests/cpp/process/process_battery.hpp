#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include "measurement/jacobian_battery.hpp"
#include "soopnav/core/joint_process.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/particle_view.hpp"
#include "soopnav/estimation/transition.hpp"

namespace soopnav::test {

/// Normals that are zero but for one.
struct OneNormal {
  int index = 0;
  double value = 0.0;
  [[nodiscard]] double operator[](int i) const noexcept { return i == index ? value : 0.0; }
};

/// The next state for given normals, headings wrapped and quaternions unit.
template <class Process, class State, class Noise = ZeroNoise>
State next_state(const Process& process, const State& x, double dt_s, const Noise& w = {},
                 const InputOf<Process>& u = {}) {
  ValueTransition<State> y(x);
  if (!soopnav::detail::propagate(process, x, u, dt_s, w, y)) y.state.x.setConstant(std::nan(""));
  y.state.normalize();
  return y.state;
}

/// F and G of a step, in the tangent.
template <class State>
struct Linear {
  Eigen::MatrixXd F = Eigen::MatrixXd::Identity(State::kDim, State::kDim);
  Eigen::MatrixXd G;
  [[nodiscard]] Eigen::MatrixXd Q() const { return G * G.transpose(); }
};
template <class Process, class State>
Linear<State> linearise(const Process& process, const State& x, double dt_s, const InputOf<Process>& u = {}) {
  Transition<State, Process::kNoise> y(x);
  Linear<State> out;
  if (!soopnav::detail::propagate(process, x, u, dt_s, ZeroNoise{}, y)) return out;
  out.F = y.F.template topLeftCorner<State::kDim, State::kDim>();
  out.G = y.G.template topRows<State::kDim>();
  return out;
}

/// Largest difference of F and G from central differences of the next state, as a part of the row (see
/// `worst_jacobian_error`: the better of two neighbouring steps of a sweep). `scale` as for `Place`. The Transition's
/// own next state is held against the one without Jacobian.
template <class Process, class State>
double worst_transition_error(const Process& process, const State& x, const Eigen::VectorXd& scale, double dt_s,
                              const InputOf<Process>& u = {}) {
  constexpr int kN = State::kDim;
  constexpr int kW = Process::kNoise;
  const auto bad = std::numeric_limits<double>::infinity();
  Transition<State, kW> y(x);
  if (!soopnav::detail::propagate(process, x, u, dt_s, ZeroNoise{}, y)) return bad;
  y.state.normalize();
  const State middle = next_state(process, x, dt_s, ZeroNoise{}, u);
  if (middle.x != y.state.x) return bad;

  double worst = 0.0;
  const auto hold = [&](const auto& column, const auto& row_size, double weight, auto&& rise) {
    Eigen::VectorXd best = Eigen::VectorXd::Constant(kN, bad);
    Eigen::VectorXd last = best;
    for (int k = 0; k <= 8; ++k) {
      const Eigen::VectorXd error = (rise(std::pow(10.0, -k)) - column).cwiseAbs();
      for (int i = 0; i < kN; ++i) {
        best[i] = std::min(best[i], std::max(last[i], error[i]));
        last[i] = error[i];
      }
    }
    for (int i = 0; i < kN; ++i) {
      const double share = best[i] == 0.0 ? 0.0 : best[i] * weight / row_size[i];
      worst = std::isfinite(share) ? std::max(worst, share) : bad;
    }
  };
  const auto F = y.F.template topLeftCorner<kN, kN>();
  const Eigen::VectorXd moves = F.cwiseAbs() * scale;
  for (int j = 0; j < kN; ++j) {
    hold(F.col(j), moves, scale[j], [&](double part) -> Eigen::VectorXd {
      const State up = moved(x, j, 0.1 * part * scale[j]);
      const State down = moved(x, j, -0.1 * part * scale[j]);
      return (middle.local(next_state(process, up, dt_s, ZeroNoise{}, u)) -
              middle.local(next_state(process, down, dt_s, ZeroNoise{}, u))) /
             step_between(down, up, j);
    });
  }
  // Noises: steps from 1000 sigmas (small noises on large numbers) downwards.
  const auto G = y.G.template topRows<kN>();
  const Eigen::VectorXd spread = G.cwiseAbs().rowwise().sum();
  for (int j = 0; j < kW; ++j) {
    hold(G.col(j), spread, 1.0, [&](double part) -> Eigen::VectorXd {
      const double step = 1e3 * part;
      return (middle.local(next_state(process, x, dt_s, OneNormal{j, step}, u)) -
              middle.local(next_state(process, x, dt_s, OneNormal{j, -step}, u))) /
             (2.0 * step);
    });
  }
  return worst;
}

/// F and Q of `steps` equal steps that make up `dt_s`, each linearised where the last one led.
template <class Process, class State>
Linear<State> compose(const Process& process, State x, double dt_s, int steps, Eigen::MatrixXd& Q) {
  Linear<State> all;
  Q = Eigen::MatrixXd::Zero(State::kDim, State::kDim);
  for (int k = 0; k < steps; ++k) {
    const Linear<State> one = linearise(process, x, dt_s / steps);
    all.F = one.F * all.F;
    Q = one.F * Q * one.F.transpose() + one.Q();
    x = next_state(process, x, dt_s / steps);
  }
  return all;
}

/// Largest difference between a packet of particles and the same particles one by one, same normals, in units in the
/// last place of each component's scale.
template <class State, class Process>
double worst_packet_ulps(const Process& process, double dt_s, const InputOf<Process>& u = {}) {
  using P = Packet<double>;
  constexpr auto kWidth = static_cast<std::size_t>(P::kWidth);
  RandomStream random(31);
  double worst = 0.0;
  for (int k = 0; k < 64; ++k) {
    std::array<State, kWidth> states;
    std::array<std::array<double, static_cast<std::size_t>(Process::kNoise)>, kWidth> normals;
    std::array<P, static_cast<std::size_t>(Process::kNoise)> w;
    ParticleView<State, double> view;
    Eigen::VectorXd scale;
    for (std::size_t lane = 0; lane < kWidth; ++lane) {
      const Place<State> place(kLocal, random);
      states[lane] = place.x;
      scale = place.scale;
      for (std::size_t i = 0; i < view.values.size(); ++i) {
        view.values[i].set(static_cast<int>(lane), place.x.x[static_cast<Eigen::Index>(i)]);
      }
      for (std::size_t i = 0; i < w.size(); ++i) {
        normals[lane][i] = random.normal();
        w[i].set(static_cast<int>(lane), normals[lane][i]);
      }
    }
    struct Normals {
      const P* first;
      P operator[](int i) const { return first[i]; }
    };
    struct LaneNormals {
      const double* first;
      double operator[](int i) const { return first[i]; }
    };
    ParticleNext<State, double> y{view};
    if (!soopnav::detail::propagate(process, view, u, dt_s, Normals{w.data()}, y)) return 1e300;
    soopnav::detail::normalize(y.state);
    for (std::size_t lane = 0; lane < kWidth; ++lane) {
      const State one = next_state(process, states[lane], dt_s, LaneNormals{normals[lane].data()}, u);
      State many = one;
      for (std::size_t i = 0; i < view.values.size(); ++i) {
        many.x[static_cast<Eigen::Index>(i)] = y.state.values[i][static_cast<int>(lane)];
      }
      if (many.x == one.x) continue;
      const Eigen::VectorXd difference = one.local(many).cwiseAbs().cwiseQuotient(scale);
      const double ulps = difference.maxCoeff() / std::numeric_limits<double>::epsilon();
      if (!(ulps <= worst)) worst = std::isfinite(ulps) ? ulps : 1e300;
    }
  }
  return worst;
}

}  // namespace soopnav::test
