#pragma once

#include <array>
#include <cmath>
#include <cstddef>

#include "soopnav/core/role.hpp"

namespace soopnav {

/// Independent random walks of the components of one part of a state.
///
/// Model:   x_i += sqrt(q_i dt) w_i, the exact discretisation of white noise of power density q_i
/// Roles:   `Part`: any role or block of vector components or headings (for an attitude use a process of its own).
/// In a `JointProcess` it adds to what the part before it wrote: a diffusion on top of a motion. No allocation.
template <StatePart Part>
struct RandomWalk {
  static constexpr int kNoise = Part::kDim;
  Part part{};
  std::array<double, static_cast<std::size_t>(Part::kDim)> psd{};  ///< q_i [unit of the component squared, per second]

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& /*x*/, double dt_s, const W& w, Y& y) const {
    auto&& next = y.next(part);
    for (int i = 0; i < Part::kDim; ++i) {
      const double sigma = std::sqrt(psd[static_cast<std::size_t>(i)] * dt_s);
      next[i] += sigma * w[i];
      if constexpr (Y::kJacobian) y.noise(part)(i, i) = sigma;
    }
    return true;
  }
};

template <StatePart Part>
RandomWalk(Part, std::array<double, static_cast<std::size_t>(Part::kDim)>) -> RandomWalk<Part>;

}  // namespace soopnav
