#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <string_view>

#include "soopnav/core/random.hpp"
#include "soopnav/estimation/prediction.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav::test {

// What the battery asks of a state; for others than fixed ones there are overloads.
template <class Model, FixedStateType State>
[[nodiscard]] std::optional<Eigen::MatrixXd> jacobian_of(const Model& model, const State& x) {
  Prediction<Model::kDim, State> y;
  if (!model.predict(x, y)) return std::nullopt;
  return Eigen::MatrixXd(y.estimated());
}
template <FixedStateType State>
[[nodiscard]] State moved(const State& x, int j, double step) {
  typename State::Tangent d = State::Tangent::Zero();
  d[j] = step;
  return x.retract(d);
}
template <FixedStateType State>
[[nodiscard]] double step_between(const State& below, const State& above, int j) {
  return below.local(above)[j];
}

/// Largest difference between a model's Jacobian at `x` and central differences, as a part of the row: `scale[j]` is
/// how far component j can be moved before the model bends, and the size of its share.
///
/// Steps run from 1e-1 to 1e-7 of the scale. Large ones bend and small ones drown in rounding, so each element is held
/// against the pair of neighbouring steps that suits it best: a wrong element may meet one step's error by chance, not
/// those of two. Steps are what the state's numbers really moved by. Differences of angles are taken the short way.
template <class Model, class State>
double worst_jacobian_error(const Model& model, const State& x, const Eigen::VectorXd& scale) {
  const auto H = jacobian_of(model, x);
  if (!H) return std::numeric_limits<double>::infinity();
  constexpr int kSteps = 7;
  const Eigen::Index n = H->cols();
  Eigen::MatrixXd best = Eigen::MatrixXd::Constant(Model::kDim, n, std::numeric_limits<double>::infinity());
  for (int j = 0; j < n; ++j) {
    Eigen::VectorXd last = best.col(j);
    for (int k = 1; k <= kSteps; ++k) {
      const double step = scale[j] * std::pow(10.0, -k);
      const State up = moved(x, j, step);
      const State down = moved(x, j, -step);
      ValuePrediction<double, Model::kDim> above{};
      ValuePrediction<double, Model::kDim> below{};
      if (!model.predict(up, above) || !model.predict(down, below)) continue;
      for (int i = 0; i < Model::kDim; ++i) {
        const double rise = soopnav::detail::residual<Model>(i, above.value(i), below.value(i));
        const double error = std::abs(rise / step_between(down, up, j) - (*H)(i, j));
        best(i, j) = std::min(best(i, j), std::max(last[i], error));
        last[i] = error;
      }
    }
  }
  double worst = 0.0;
  for (int i = 0; i < Model::kDim; ++i) {
    const double row = H->row(i).cwiseAbs().dot(scale);
    for (int j = 0; j < n; ++j) {
      const double share = best(i, j) * scale[j] / row;
      if (!std::isfinite(share)) return std::numeric_limits<double>::infinity();
      worst = std::max(worst, share);
    }
  }
  return worst;
}

// Roles of a source that is estimated with the receiver.
struct EmitterTag {
  static constexpr std::string_view kNames[] = {"emitter x", "emitter y", "emitter z"};
  static constexpr std::string_view kName = "emitter";
};
struct EmitterVelocityTag {
  static constexpr std::string_view kName = "emitter velocity";
};
struct EmitterClockTag {
  static constexpr std::string_view kName = "emitter clock";
};
struct EmitterDriftTag {
  static constexpr std::string_view kName = "emitter drift";
};
struct PowerTag {
  static constexpr std::string_view kName = "power";
};
struct ExponentTag {
  static constexpr std::string_view kName = "exponent";
};
struct AmbiguityTag {
  static constexpr std::string_view kName = "ambiguity";
};
struct PreviousTag {
  static constexpr std::string_view kName = "previous";
};
template <int Dim>
using Emitter = Role<Dim, EmitterTag>;
template <int Dim>
using EmitterVelocity = Role<Dim, EmitterVelocityTag>;
using EmitterClock = Role<1, EmitterClockTag>;
using EmitterDrift = Role<1, EmitterDriftTag>;
using Power = Role<1, PowerTag>;
using Exponent = Role<1, ExponentTag>;
using Ambiguity = Role<1, AmbiguityTag>;

/// States that hold whatever a model may want to estimate.
template <class Frame>
using Space = ComposedState<Frame, Role<3, PositionTag>, Role<3, VelocityTag>, Role<3, AttitudeTag>,
                            Role<1, ClockBiasTag>, Role<1, ClockDriftTag>, Emitter<3>, EmitterVelocity<3>, EmitterClock,
                            EmitterDrift, Power, Exponent, Ambiguity>;
template <class Frame>
using Plane = ComposedState<Frame, Role<1, HeadingTag>, Role<2, VelocityTag>, Role<2, PositionTag>,
                            Role<1, ClockBiasTag>, Role<1, ClockDriftTag>, Emitter<2>, EmitterVelocity<2>, EmitterClock,
                            Power, Exponent, Role<2, PreviousTag>, Role<1, PreviousTag>>;

/// Where everything is: positions scatter by `size` about `centre`, metres.
struct Scene {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double size = 1e3;
  template <int Dim>
  [[nodiscard]] Eigen::Matrix<double, Dim, 1> point(RandomStream& random) const {
    Eigen::Matrix<double, Dim, 1> p = centre.template head<Dim>();
    for (int i = 0; i < Dim; ++i) p[i] += size * random.normal();
    return p;
  }
  template <int Dim>
  [[nodiscard]] static Eigen::Matrix<double, Dim, 1> velocity(RandomStream& random) {
    Eigen::Matrix<double, Dim, 1> v;
    for (int i = 0; i < Dim; ++i) v[i] = 20.0 * random.normal();
    return v;
  }
};
inline const Scene kLocal{};
inline const Scene kEarth{{3912960.8, 299353.1, 5014176.3}, 1e4};

/// A random state in a scene, and the scale of each of its components.
template <class State>
struct Place {
  State x;
  Eigen::VectorXd scale = Eigen::VectorXd::Ones(State::kDim);

  Place(const Scene& scene, RandomStream& random) {
    const auto fill = [&]<int Dim, class Tag>(Role<Dim, Tag> role, auto&& draw, double size) {
      if constexpr (HoldsRole<State, Role<Dim, Tag>>) {
        x.x.template segment<Dim>(State::stored_at(role)) = draw();
        for (int i = 0; i < Dim && State::at(role) + i < State::kDim; ++i) scale[State::at(role) + i] = size;
      }
    };
    const auto number = [&](double mean, double sigma) {
      return [&random, mean, sigma] { return Eigen::Matrix<double, 1, 1>(mean + sigma * random.normal()); };
    };
    fill(
        kPosition, [&] { return scene.point<3>(random); }, scene.size);
    fill(
        kPlanarPosition, [&] { return scene.point<2>(random); }, scene.size);
    fill(
        Emitter<3>{}, [&] { return scene.point<3>(random); }, scene.size);
    fill(
        Emitter<2>{}, [&] { return scene.point<2>(random); }, scene.size);
    fill(
        Role<2, PreviousTag>{}, [&] { return scene.point<2>(random); }, scene.size);
    fill(
        kVelocity, [&] { return Scene::velocity<3>(random); }, 20.0);
    fill(
        kPlanarVelocity, [&] { return Scene::velocity<2>(random); }, 20.0);
    fill(
        EmitterVelocity<3>{}, [&] { return Scene::velocity<3>(random); }, 20.0);
    fill(
        EmitterVelocity<2>{}, [&] { return Scene::velocity<2>(random); }, 20.0);
    fill(kClockBias, number(300.0, 100.0), scene.size);
    fill(EmitterClock{}, number(-40.0, 100.0), scene.size);
    fill(kClockDrift, number(3.0, 5.0), 20.0);
    fill(EmitterDrift{}, number(-3.0, 5.0), 20.0);
    fill(kTurnRate, number(0.0, 0.3), 1.0);
    fill(Power{}, number(-40.0, 5.0), 10.0);
    fill(Exponent{}, number(2.5, 0.2), 1.0);
    fill(Ambiguity{}, number(500.0, 1e3), 1e3);
    const auto angle = [&] { return Eigen::Matrix<double, 1, 1>(random.uniform(-3.1, 3.1)); };
    fill(kHeading, angle, 1.0);
    fill(Role<1, PreviousTag>{}, angle, 1.0);
    if constexpr (HoldsRole<State, Role<3, AttitudeTag>>) {
      for (int i = 0; i < 4; ++i) x.x[State::stored_at(kAttitude) + i] = random.normal();
      x.normalize();
    }
  }
};

}  // namespace soopnav::test
