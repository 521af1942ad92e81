#pragma once

// A place on a line and a bias, both linear, so that the Kalman filter is exact: for the tests of particle filters.

#include <Eigen/Dense>
#include <cmath>
#include <span>

#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/marginalized_particle_filter.hpp"
#include "soopnav/estimation/particle_filter.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav::test {

using Pair = ComposedState<PlanarFrame, Role<1, PositionTag>, Role<1, ClockBiasTag>>;
using PairCloud = ParticleFilter<Pair>;
using PairMarginalized = MarginalizedParticleFilter<Pair, double, Role<1, ClockBiasTag>>;
inline constexpr auto kPlace = kPositionOf<1>;
inline constexpr auto kBias = kClockBias;

/// Random walks of both; standard deviations per square root of a second.
struct Drift {
  static constexpr int kNoise = 2;
  double place = 1.0;
  double bias = 1.0;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    const double root = std::sqrt(dt_s);
    y.next(kPlace)[0] = x(kPlace)[0] + w[0] * (place * root);
    y.next(kBias)[0] = x(kBias)[0] + w[1] * (bias * root);
    if constexpr (Y::kJacobian) {
      y.noise(kPlace)(0, 0) = place * root;
      y.noise(kBias)(0, 1) = bias * root;
    }
    return true;
  }
};

/// One noise for both, or the place driven by the bias: neither can be separated.
struct Coupled {
  static constexpr int kNoise = 1;
  double common = 0.0;
  double rate = 0.0;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    y.next(kPlace)[0] = x(kPlace)[0] + w[0] * common + x(kBias)[0] * (rate * dt_s);
    y.next(kBias)[0] = x(kBias)[0] + w[0] * common;
    if constexpr (Y::kJacobian) {
      y.transition(kPlace, kBias)(0, 0) = rate * dt_s;
      y.noise(kPlace)(0, 0) = common;
      y.noise(kBias)(0, 0) = common;
    }
    return true;
  }
};

/// The place itself.
struct Place {
  static constexpr int kDim = 1;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    y.value(0) = x(kPlace)[0];
    if constexpr (Y::kJacobian) y.jacobian(kPlace)(0, 0) = 1.0;
    return true;
  }
};

/// Place plus a multiple of the bias.
struct Sum {
  static constexpr int kDim = 1;
  double factor = 1.0;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    y.value(0) = x(kPlace)[0] + x(kBias)[0] * factor;
    if constexpr (Y::kJacobian) {
      y.jacobian(kPlace)(0, 0) = 1.0;
      y.jacobian(kBias)(0, 0) = factor;
    }
    return true;
  }
};

/// Place times bias: linear in the bias, but not alike for all particles.
struct Product {
  static constexpr int kDim = 1;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    y.value(0) = x(kPlace)[0] * x(kBias)[0];
    if constexpr (Y::kJacobian) {
      y.jacobian(kPlace)(0, 0) = x(kBias)[0];
      y.jacobian(kBias)(0, 0) = x(kPlace)[0];
    }
    return true;
  }
};

template <class Model>
[[nodiscard]] Correlated<Model> group(const Observed<Model>& observed) {
  return {std::span<const Model>(&observed.model, 1), observed.z, observed.R};
}

struct PairExact {
  Eigen::Vector2d x;
  Eigen::Matrix2d P;
  double log_likelihood;

  void predict(const Drift& drift, double dt_s) {
    P.diagonal() += dt_s * Eigen::Vector2d(drift.place * drift.place, drift.bias * drift.bias);
  }
  void update(const Eigen::MatrixXd& H, const Eigen::VectorXd& z, const Eigen::MatrixXd& R) {
    const Eigen::MatrixXd S = H * P * H.transpose() + R;
    const Eigen::MatrixXd K = S.llt().solve(H * P).transpose();
    const Eigen::VectorXd v = z - H * x;
    log_likelihood -=
        0.5 * (v.dot(S.llt().solve(v)) + std::log(S.determinant()) + static_cast<double>(z.size()) * std::log(kTwoPi));
    x += K * v;
    P = ((Eigen::Matrix2d::Identity() - K * H) * P).eval();
    P = (0.5 * (P + P.transpose())).eval();
  }
  void update(const Eigen::RowVector2d& H, double z, double R) {
    update(Eigen::MatrixXd(H), Eigen::VectorXd::Constant(1, z), Eigen::MatrixXd::Constant(1, 1, R));
  }
};

}  // namespace soopnav::test
