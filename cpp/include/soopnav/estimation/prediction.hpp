#pragma once

#include <Eigen/Core>
#include <array>
#include <concepts>
#include <cstddef>

#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav {

/// What a model writes when it is asked for values and Jacobian at a fixed state: `M` rows.
///
/// The Jacobian is zero where the model wrote nothing; each role is written at most once. No heap.
template <int M, FixedStateType State>
struct Prediction {
  static constexpr bool kJacobian = true;
  Eigen::Matrix<double, M, 1> z = Eigen::Matrix<double, M, 1>::Zero();
  Eigen::Matrix<double, M, State::kStored> H = Eigen::Matrix<double, M, State::kStored>::Zero();

  [[nodiscard]] double& value(int i) noexcept { return z[i]; }
  template <int Dim, class Tag>
  requires HoldsRole<State, Role<Dim, Tag>>
  [[nodiscard]] auto jacobian(Role<Dim, Tag> role) noexcept { return H.template middleCols<Dim>(State::at(role)); }
  template <int Dim>
  [[nodiscard]] DiscardedJacobian jacobian(const Known<Dim>&) noexcept {
    return {};
  }
  /// d z / d tangent: the columns that are estimated.
  [[nodiscard]] auto estimated() const noexcept { return H.template leftCols<State::kDim>(); }
};

/// What a model writes when only values are wanted: `M` of them, each a double or a packet (an `Eigen::Array`).
template <class Scalar, int M>
struct ValuePrediction {
  static constexpr bool kJacobian = false;
  std::array<Scalar, static_cast<std::size_t>(M)> z;

  [[nodiscard]] Scalar& value(int i) noexcept { return z[static_cast<std::size_t>(i)]; }
};

namespace detail {

/// z - h of one row: as the model says (angles wrap), else plainly.
template <class Model, class T>
[[nodiscard]] T residual(int row, const T& z, const T& predicted) {
  if constexpr (requires { Model::residual(row, z, predicted); }) {
    return Model::residual(row, z, predicted);
  } else {
    return z - predicted;
  }
}

/// The same by a model's own object: its residual need not be static.
template <class Model, class T>
[[nodiscard]] T residual(const Model& model, int row, const T& z, const T& predicted) {
  if constexpr (requires { model.residual(row, z, predicted); }) {
    return model.residual(row, z, predicted);
  } else {
    return z - predicted;
  }
}

}  // namespace detail

/// A measurement model of `Model::kDim` rows that can be asked at `State`: `predict` writes value and Jacobian and
/// answers false where they are undefined (a receiver on top of its source).
template <class Model, class State>
concept MeasurementModelFor = FixedStateType<State> && FrameCompatible<Model, State> &&
    requires(const Model& m, const State& x, Prediction<Model::kDim, State>& y) {
  { m.predict(x, y) } -> std::same_as<bool>;
};

}  // namespace soopnav
