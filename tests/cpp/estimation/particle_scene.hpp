#pragma once

// A planar receiver with a clock among four sources, for the tests of the particle filter.

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/estimation/observed.hpp"
#include "soopnav/estimation/particle_filter.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/measurement/pseudorange.hpp"

namespace soopnav::test {

using PlanarClock = ComposedState<PlanarFrame, Role<2, PositionTag>, Role<2, VelocityTag>, Role<1, ClockBiasTag>>;
using PlanarPseudorange = Pseudorange<PlanarFrame, Known<1>, Known<2>>;

/// Nearly constant velocity with a piecewise constant acceleration, and a random walk of the clock: three normals.
struct PlanarMotion {
  static constexpr int kNoise = 3;
  double acceleration_mps2 = 0.3;
  double clock_m = 0.5;  ///< per square root of a second

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    const auto p = x(kPlanarPosition);
    const auto v = x(kPlanarVelocity);
    auto next_p = y.next(kPlanarPosition);
    auto next_v = y.next(kPlanarVelocity);
    for (int i = 0; i < 2; ++i) {
      const auto a = w[i] * acceleration_mps2;
      next_p[i] = p[i] + v[i] * dt_s + a * (0.5 * dt_s * dt_s);
      next_v[i] = v[i] + a * dt_s;
    }
    y.next(kClockBias)[0] = x(kClockBias)[0] + w[2] * (clock_m * std::sqrt(dt_s));
    return true;
  }
};

inline const std::array<Eigen::Vector2d, 4> kSources = {Eigen::Vector2d{0, 0}, Eigen::Vector2d{50, 0},
                                                        Eigen::Vector2d{0, 50}, Eigen::Vector2d{50, 50}};

/// Four pseudoranges (sigma 1 m) of a receiver that walks from (3, 4).
inline std::vector<Observed<PlanarPseudorange>> planar_epoch(int k, std::uint64_t seed = 5) {
  RandomStream random = RandomStream(seed).substream(static_cast<std::uint64_t>(k));
  const Eigen::Vector2d p(3.0 + 0.1 * k, 4.0 + 0.05 * k);
  std::vector<Observed<PlanarPseudorange>> observed;
  for (const Eigen::Vector2d& q : kSources) {
    observed.emplace_back(PlanarPseudorange{q}, (p - q).norm() + 2.0 + random.normal(), 1.0);
  }
  return observed;
}

inline PlanarClock planar_start() {
  PlanarClock x;
  x.x << 3, 4, 1, 0.5, 2;
  return x;
}

}  // namespace soopnav::test
