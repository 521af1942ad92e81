#pragma once

#include <Eigen/Core>

#include "soopnav/core/status.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"
#include "soopnav/estimation/observed.hpp"
#include "soopnav/estimation/prediction.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/estimation/transition.hpp"
#include "soopnav/estimation/update_report.hpp"

namespace soopnav::detail {

/// One observation as rows that can be asked at any state: innovation and Jacobian there.
template <class State, class Model>
struct SingleRows {
  using Report = UpdateReport<Model::kDim>;
  using Jacobian = Eigen::Matrix<double, Model::kDim, State::kDim,
                                 Model::kDim == 1 && State::kDim != 1 ? Eigen::RowMajor : Eigen::ColMajor>;
  static constexpr int kMaxRows = Model::kDim;
  const Model& model;
  const Eigen::Matrix<double, Model::kDim, 1>& z;

  [[nodiscard]] Jacobian jacobian() const noexcept { return Jacobian::Zero(); }
  /// False where the model is undefined.
  template <class Vector>
  [[nodiscard]] bool operator()(const State& x, Vector& innovation, Jacobian& H) const {
    Prediction<Model::kDim, State> y;
    if (!model.predict(x, y)) return false;
    for (int i = 0; i < Model::kDim; ++i) innovation[i] = residual(model, i, z[i], y.z[i]);
    H = y.estimated();
    return true;
  }
};

/// The same for a group of observations with a common covariance, at most `MaxRows` rows.
template <class State, class Model, int MaxRows>
struct GroupRows {
  using Report = UpdateReport<Eigen::Dynamic, MaxRows>;
  using Jacobian = Eigen::Matrix<double, Eigen::Dynamic, State::kDim,
                                 State::kDim == 1 ? Eigen::ColMajor : Eigen::RowMajor, MaxRows, State::kDim>;
  static constexpr int kMaxRows = MaxRows;
  const Correlated<Model>& group;

  [[nodiscard]] Jacobian jacobian() const noexcept { return Jacobian::Zero(group.z.size(), State::kDim); }
  template <class Vector>
  [[nodiscard]] bool operator()(const State& x, Vector& innovation, Jacobian& H) const {
    Eigen::Index row = 0;
    for (const Model& model : group.models) {
      Prediction<Model::kDim, State> y;
      if (!model.predict(x, y)) return false;
      for (int i = 0; i < Model::kDim; ++i, ++row) {
        innovation[row] = residual(model, i, static_cast<double>(group.z[row]), y.z[i]);
        H.row(row) = y.estimated().row(i);
      }
    }
    return true;
  }
};

/// The updates every filter that linearises has. `Derived` gives `apply(rows, R, gate, report)`, which fills `report`
/// from checked `R` and changes itself only to accept.
template <class Derived, FixedStateType State>
class LinearisedUpdates {
 public:
  /// Takes `z = h(x) + noise` of covariance `R` in. Refused: what is not finite, `R` not positive definite, what `gate`
  /// keeps out, and where the model has no Jacobian.
  template <MeasurementModelFor<State> Model>
  UpdateReport<Model::kDim> update(const Model& model, const Eigen::Matrix<double, Model::kDim, 1>& z,
                                   const Eigen::Matrix<double, Model::kDim, Model::kDim>& R, const Gate& gate = {}) {
    UpdateReport<Model::kDim> report;
    report.status = all_finite(z) ? check_noise(R) : UpdateStatus::kNonFinite;
    if (report.accepted()) derived().apply(SingleRows<State, Model>{model, z}, R, gate, report);
    return report;
  }
  template <MeasurementModelFor<State> Model>
  requires(Model::kDim == 1) UpdateReport<1> update(const Model& model, double z, double variance,
                                                    const Gate& gate = {}) {
    return update(model, Eigen::Matrix<double, 1, 1>(z), Eigen::Matrix<double, 1, 1>(variance), gate);
  }
  template <class Model>
  UpdateReport<Model::kDim> update(const Observed<Model>& observed, const Gate& gate = {}) {
    return update(observed.model, observed.z, observed.R, gate);
  }

  /// Takes observations with a common covariance in at once, at most `MaxRows` rows (kTooManyRows beyond).
  template <int MaxRows = 16, class Model>
  UpdateReport<Eigen::Dynamic, MaxRows> update(const Correlated<Model>& group, const Gate& gate = {}) {
    using Report = UpdateReport<Eigen::Dynamic, MaxRows>;
    const auto rows = static_cast<Eigen::Index>(group.models.size()) * Model::kDim;
    if (rows > MaxRows || rows != group.z.size() || rows != group.R.rows() || rows != group.R.cols()) {
      Report report;
      report.status = rows > MaxRows ? UpdateStatus::kTooManyRows : UpdateStatus::kNotPositiveDefinite;
      return report;
    }
    Report report(static_cast<int>(rows));
    const typename Report::Square R = group.R;
    report.status = group.z.allFinite() ? check_noise(R) : UpdateStatus::kNonFinite;
    if (report.accepted()) derived().apply(GroupRows<State, Model, MaxRows>{group}, R, gate, report);
    return report;
  }

  /// For processes that are driven by nothing.
  template <ProcessModelFor<State> Process>
  requires(!kDriven<Process>) UpdateStatus
      predict(const Process& process, double dt_s, Eigen::Matrix<double, State::kDim, State::kDim>* cross = nullptr) {
    return derived().predict(process, NoInput{}, dt_s, cross);
  }

 private:
  friend Derived;
  LinearisedUpdates() = default;
  [[nodiscard]] Derived& derived() noexcept { return static_cast<Derived&>(*this); }
};

}  // namespace soopnav::detail
