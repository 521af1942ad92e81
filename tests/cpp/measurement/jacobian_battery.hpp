#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>

#include "soopnav/estimation/prediction.hpp"

namespace soopnav::test {

/// Largest difference between a model's Jacobian at `x` and central differences, over the best of a sweep of steps.
///
/// Steps run from 1e-3 to 1e3 (in the units of the state) by factors of ten: at the magnitude of an Earth-centred
/// position small steps drown in rounding and large ones bend, so each element is held against the step that suits it
/// best. A wrong element is wrong for all of them.
template <class Model, class State>
double worst_jacobian_error(const Model& model, const State& x) {
  Prediction<Model::kDim, State> y;
  if (!model.predict(x, y)) return std::numeric_limits<double>::infinity();
  double worst = 0.0;
  for (int i = 0; i < Model::kDim; ++i) {
    for (int j = 0; j < State::kDim; ++j) {
      double best = std::numeric_limits<double>::infinity();
      for (double step = 1e-3; step < 2e3; step *= 10.0) {
        typename State::Tangent d = State::Tangent::Zero();
        d[j] = step;
        ValuePrediction<double, Model::kDim> above{};
        ValuePrediction<double, Model::kDim> below{};
        if (!model.predict(x.retract(d), above) || !model.predict(x.retract(-d), below)) continue;
        const double slope = (above.value(i) - below.value(i)) / (2.0 * step);
        best = std::min(best, std::abs(slope - y.estimated()(i, j)));
      }
      worst = std::max(worst, best);
    }
  }
  return worst;
}

}  // namespace soopnav::test
