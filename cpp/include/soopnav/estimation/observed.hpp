#pragma once

#include <Eigen/Core>
#include <span>

namespace soopnav {

/// One measurement, independent of the others: `z = model(x) + noise`, noise of covariance `R` (units of z squared).
template <class ModelType>
struct Observed {
  using Model = ModelType;
  static constexpr int kDim = Model::kDim;
  Model model;
  Eigen::Matrix<double, kDim, 1> z;
  Eigen::Matrix<double, kDim, kDim> R;

  Observed() = default;
  Observed(const Model& m, const Eigen::Matrix<double, kDim, 1>& value,
           const Eigen::Matrix<double, kDim, kDim>& covariance)
      : model(m), z(value), R(covariance) {}
  Observed(const Model& m, double value, double variance) requires(kDim == 1) : model(m), z(value), R(variance) {}
};

template <class Model>
Observed(const Model&, double, double) -> Observed<Model>;

/// Measurements with a common covariance, for example differences to one reference.
///
/// `z` and `R` hold the rows of the models one behind the other; the memory stays the caller's.
template <class ModelType>
struct Correlated {
  using Model = ModelType;
  std::span<const Model> models;
  Eigen::Ref<const Eigen::VectorXd> z;
  Eigen::Ref<const Eigen::MatrixXd> R;
};

}  // namespace soopnav
