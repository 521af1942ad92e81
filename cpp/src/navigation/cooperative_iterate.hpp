#pragma once

#include "soopnav/navigation/cooperative_filter.hpp"

namespace soopnav::navigation {

/// Gauss-Newton steps after an update was taken: the rows are linearised where it ended, and it is taken again from
/// what was before it. `take(rows)` updates; ends early when the position no longer moves. A step that is refused is
/// undone: what was reported as accepted stays taken.
template <class Rows, class Engine, class Take>
void iterate_pair(Engine& engine, const PairModel<>& model, Rows rows, double along_track_m, int iterations,
                  const Take& take) noexcept {
  constexpr double kStill = 1e-3;  // [m]
  for (int k = 1; k < iterations; ++k) {
    const PairVector before = engine.mean();
    if (!rows.linearise(model, before, along_track_m)) return;
    engine.revert();
    if (!take(rows)) {
      engine.restore_taken();
      return;
    }
    if ((engine.mean() - before).template head<3>().norm() < kStill) return;
  }
}

}  // namespace soopnav::navigation
