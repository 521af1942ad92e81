#pragma once

#include <array>
#include <cmath>
#include <cstddef>

#include "soopnav/core/role.hpp"

namespace soopnav {

/// Motion with nearly constant velocity: white acceleration in each axis.
///
/// Model:   p += v dt + n_p,  v += n_v,  Cov(n_p, n_v) = q [[dt³/3, dt²/2], [dt²/2, dt]] for each axis
///          (doc/process_models.md eq. 4; Bar-Shalom, Li and Kirubarajan 2001, eq. 6.2.2-12), exact for any step
/// Noise:   two normals per axis: 2i moves velocity and position together, 2i + 1 the rest of the position.
/// Roles:   position and velocity of `Dim` components; other roles or blocks (an emitter's) when they are named.
/// No allocation.
template <int Dim, PartOf<Dim> Position = Role<Dim, PositionTag>, PartOf<Dim> Velocity = Role<Dim, VelocityTag>>
struct NearlyConstantVelocity {
  static constexpr int kNoise = 2 * Dim;
  std::array<double, static_cast<std::size_t>(Dim)> acceleration_psd{};  ///< q >= 0 of each axis [m²/s³]
  Position position{};
  Velocity velocity{};

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    const auto v = x(velocity);
    auto&& next_p = y.next(position);
    auto&& next_v = y.next(velocity);
    for (int i = 0; i < Dim; ++i) {
      const double to_v = std::sqrt(acceleration_psd[static_cast<std::size_t>(i)] * dt_s);
      const double to_p = 0.5 * dt_s * to_v;
      const double rest = to_v * dt_s / std::sqrt(12.0);
      next_p[i] += dt_s * v[i] + (to_p * w[2 * i] + rest * w[2 * i + 1]);
      next_v[i] += to_v * w[2 * i];
      if constexpr (Y::kJacobian) {
        y.transition(position, velocity)(i, i) = dt_s;
        y.noise(velocity)(i, 2 * i) = to_v;
        y.noise(position)(i, 2 * i) = to_p;
        y.noise(position)(i, 2 * i + 1) = rest;
      }
    }
    return true;
  }
};

/// Motion under an acceleration that is constant during each step and new in the next.
///
/// Model:   p += v dt + a dt²/2,  v += a dt,  a ~ N(0, sigma²) for each axis and step
///          (doc/process_models.md eq. 6; Bar-Shalom, Li and Kirubarajan 2001, eq. 6.3.2-3)
/// Noise:   one normal per axis. It belongs to the step: two half steps are less noisy than a whole one, so choose
///          `NearlyConstantVelocity` where steps vary.
/// Roles:   as for `NearlyConstantVelocity`. No allocation.
template <int Dim, PartOf<Dim> Position = Role<Dim, PositionTag>, PartOf<Dim> Velocity = Role<Dim, VelocityTag>>
struct PiecewiseConstantAcceleration {
  static constexpr int kNoise = Dim;
  std::array<double, static_cast<std::size_t>(Dim)> acceleration_sigma_mps2{};  ///< of each axis
  Position position{};
  Velocity velocity{};

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    const auto v = x(velocity);
    auto&& next_p = y.next(position);
    auto&& next_v = y.next(velocity);
    for (int i = 0; i < Dim; ++i) {
      const double to_v = acceleration_sigma_mps2[static_cast<std::size_t>(i)] * dt_s;
      const double to_p = 0.5 * dt_s * to_v;
      next_p[i] += dt_s * v[i] + to_p * w[i];
      next_v[i] += to_v * w[i];
      if constexpr (Y::kJacobian) {
        y.transition(position, velocity)(i, i) = dt_s;
        y.noise(velocity)(i, i) = to_v;
        y.noise(position)(i, i) = to_p;
      }
    }
    return true;
  }
};

}  // namespace soopnav
