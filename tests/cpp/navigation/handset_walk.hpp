#pragma once

// Walks for the tests of the handset's locator, and a run of them.

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "soopnav/estimation/consistency.hpp"
#include "soopnav/navigation/handset_locator.hpp"
#include "soopnav/simulation/handset_world.hpp"

namespace soopnav::navigation::walks {

using simulation::HandsetWorld;
using simulation::HandsetWorldOptions;

inline HandsetWorld walk(std::uint64_t seed, double duration_s = 30.0, double foot_sigma_m = 0.0) {
  HandsetWorldOptions o;
  o.duration_s = duration_s;
  o.foot_sigma_m = foot_sigma_m;
  o.nlos.min_clear_share = 0.2;
  return HandsetWorld::generate(o, seed);
}

inline HandsetOptions start_of(const HandsetWorld& w, std::size_t particles = 300) {
  HandsetOptions o;
  o.nodes_m = w.nodes_m;
  o.particles = particles;
  o.start_sigma_m = 6.0;
  o.start_heading_rad = w.told_heading_rad;
  o.start_heading_sigma_rad = 0.1;
  return o;
}

inline HandsetMotion step_of(const Eigen::Vector3d& increment, double foot_sigma_m = 0.0) {
  HandsetMotion m;
  m.increment = increment;
  m.track_covariance.diagonal() << 1e-6, 1e-6, 1.3e-7;
  m.foot_covariance.diagonal().setConstant(foot_sigma_m * foot_sigma_m);
  m.foot_covariance_previous = m.foot_covariance;
  return m;
}

struct Played {
  double rms_m = 0.0;  // of the position after `settled_s`
  double nees = 0.0;   // mean of it
  double right = 0.0;  // share of links and epochs told rightly
  HandsetEstimate last;
};

// The walk through a locator. `change` may alter a copy of each epoch's ranges.
template <class Change>
Played play(HandsetLocator& f, const HandsetWorld& w, double settled_s, bool camera, double foot_sigma_m,
            const Change& change) {
  const std::size_t L = w.nodes_m.size();
  const std::vector<double> sigma(L, 1.0);
  std::vector<double> z(L);
  Played out;
  double n = 0.0;
  std::size_t k = 0;
  for (std::size_t e = 0; e < w.epoch_s.size(); ++e) {
    for (; camera && k + 1 < w.frame_s.size() && w.frame_s[k + 1] <= w.epoch_s[e]; ++k) {
      EXPECT_EQ(f.move(step_of(w.increment[k], foot_sigma_m), w.frame_s[k + 1]).use, HandsetUse::kUsed);
    }
    for (std::size_t l = 0; l < L; ++l) z[l] = w.range_m[e * L + l];
    change(e, z);
    (void)f.update_ranges(z, sigma, w.epoch_s[e]);
    if (w.epoch_s[e] < settled_s) continue;
    const HandsetEstimate x = f.estimate();
    const Eigen::Vector2d d = x.position_m - w.position_m[e];
    out.rms_m += d.squaredNorm();
    out.nees += soopnav::nees(d, x.covariance_m2).value();
    for (std::size_t l = 0; l < L; ++l) {
      out.right += ((x.p_los[l] < 0.5) == (w.nlos.blocked[e * L + l] != 0) ? 1.0 : 0.0) / static_cast<double>(L);
    }
    n += 1.0;
  }
  out.rms_m = std::sqrt(out.rms_m / n);
  out.nees /= n;
  out.right /= n;
  out.last = f.estimate();
  return out;
}
inline Played play(HandsetLocator& f, const HandsetWorld& w, double settled_s = 15.0, bool camera = true,
                   double foot_sigma_m = 0.0) {
  return play(f, w, settled_s, camera, foot_sigma_m, [](std::size_t, std::vector<double>&) {});
}

}  // namespace soopnav::navigation::walks
