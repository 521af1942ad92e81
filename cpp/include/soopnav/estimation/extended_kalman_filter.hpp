#pragma once

#include <Eigen/Core>
#include <cmath>

#include "soopnav/core/status.hpp"
#include "soopnav/estimation/covariance_check.hpp"
#include "soopnav/estimation/covariance_floor.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"
#include "soopnav/estimation/observed.hpp"
#include "soopnav/estimation/prediction.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/estimation/transition.hpp"
#include "soopnav/estimation/update_report.hpp"

/// Compiles a filter's step as one piece, model and algebra together: a fifth faster, and slower to compile. Define
/// SOOPNAV_NO_FLATTEN where compile time counts for more; results are the same.
#ifndef SOOPNAV_FLATTEN
#ifdef SOOPNAV_NO_FLATTEN
#define SOOPNAV_FLATTEN
#else
#define SOOPNAV_FLATTEN [[gnu::flatten]]
#endif
#endif

namespace soopnav {

/// Extended Kalman filter on a state of fixed size (doc/kalman_filter.md).
///
/// Models are written in roles; the filter linearises in the state's tangent, so headings and quaternions need nothing
/// of their own. Every update goes validate, innovate, gate, update (Joseph's form), and reports. Any status but
/// `kAccepted` left the filter as it was. `predict` and `update` neither allocate nor throw (an exception of a model
/// passes on, the filter unchanged). For states of named blocks see `LayoutState`.
template <class StateType>
class ExtendedKalmanFilter {
  static_assert(FixedStateType<StateType>);

 public:
  using State = StateType;
  static constexpr int kDim = State::kDim;
  using Tangent = Eigen::Matrix<double, kDim, 1>;
  using Square = Eigen::Matrix<double, kDim, kDim>;

  /// Throws std::invalid_argument when `x0` is not finite or `P0` is no covariance (of the tangent at `x0`).
  ExtendedKalmanFilter(const State& x0, const Square& P0) : state_(x0), P_(P0) {
    detail::check_state(x0.x, "x0");
    check_covariance(P0, "P0");
    state_.normalize();
  }

  [[nodiscard]] const State& state() const noexcept { return state_; }
  /// Covariance of the error x.local(truth), in the tangent.
  [[nodiscard]] const Square& covariance() const noexcept { return P_; }

  /// Puts back a state and covariance that this filter (or another of its type) had.
  void restore(const State& x, const Square& P) noexcept {
    state_ = x;
    P_ = P;
  }

  /// Moves the state by `dt_s` > 0 [s]. `cross`, when given, receives Cov(x_k, x_k+1) = P Fᵀ for a smoother.
  /// kTimeNotAdvancing, kUndefined (by the model), kNonFinite: nothing changed.
  template <ProcessModelFor<State> Process>
  SOOPNAV_FLATTEN UpdateStatus predict(const Process& process, const InputOf<Process>& input, double dt_s,
                                       Square* cross = nullptr) {
    if (!(dt_s > 0.0) || std::isinf(dt_s)) return UpdateStatus::kTimeNotAdvancing;
    Transition<State, Process::kNoise> y(state_);
    if (!detail::propagate(process, state_, input, dt_s, ZeroNoise{}, y)) return UpdateStatus::kUndefined;
    y.state.normalize();
    Square A;
    Square P;
    detail::propagate_covariance(y, P_, A, P);
    if (!y.state.x.allFinite() || !P.allFinite()) return UpdateStatus::kNonFinite;
    floor_.apply(P);
    if (cross != nullptr) *cross = A.transpose();
    state_ = y.state;
    P_ = P;
    return UpdateStatus::kAccepted;
  }
  template <ProcessModelFor<State> Process>
  requires(!detail::kDriven<Process>) UpdateStatus
      predict(const Process& process, double dt_s, Square* cross = nullptr) {
    return predict(process, detail::NoInput{}, dt_s, cross);
  }

  /// Takes `z = h(x) + noise` of covariance `R` in. Refused: what is not finite, `R` not positive definite, what `gate`
  /// keeps out, and where the model has no Jacobian.
  template <MeasurementModelFor<State> Model>
  SOOPNAV_FLATTEN UpdateReport<Model::kDim> update(const Model& model, const Eigen::Matrix<double, Model::kDim, 1>& z,
                                                   const Eigen::Matrix<double, Model::kDim, Model::kDim>& R,
                                                   const Gate& gate = {}) {
    UpdateReport<Model::kDim> report;
    if (!detail::all_finite(z)) {
      report.status = UpdateStatus::kNonFinite;
      return report;
    }
    report.status = detail::check_noise(R);
    if (!report.accepted()) return report;
    Prediction<Model::kDim, State> y;
    if (!model.predict(state_, y)) {
      report.status = UpdateStatus::kUndefined;
      return report;
    }
    for (int i = 0; i < Model::kDim; ++i) report.innovation[i] = detail::residual(model, i, z[i], y.z[i]);
    apply(y.estimated(), R, gate, report);
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
    const auto rows = static_cast<Eigen::Index>(group.models.size()) * Model::kDim;
    if (rows > MaxRows || rows != group.z.size() || rows != group.R.rows() || rows != group.R.cols()) {
      UpdateReport<Eigen::Dynamic, MaxRows> report;
      report.status = rows > MaxRows ? UpdateStatus::kTooManyRows : UpdateStatus::kNotPositiveDefinite;
      return report;
    }
    UpdateReport<Eigen::Dynamic, MaxRows> report(static_cast<int>(rows));
    const typename UpdateReport<Eigen::Dynamic, MaxRows>::Square R = group.R;
    if (!group.z.allFinite()) {
      report.status = UpdateStatus::kNonFinite;
      return report;
    }
    report.status = detail::check_noise(R);
    if (!report.accepted()) return report;
    Eigen::Matrix<double, Eigen::Dynamic, kDim, kDim == 1 ? Eigen::ColMajor : Eigen::RowMajor, MaxRows, kDim> H(rows,
                                                                                                                kDim);
    Eigen::Index row = 0;
    for (const Model& model : group.models) {
      Prediction<Model::kDim, State> y;
      if (!model.predict(state_, y)) {
        report.status = UpdateStatus::kUndefined;
        return report;
      }
      for (int i = 0; i < Model::kDim; ++i, ++row) {
        report.innovation[row] = detail::residual(model, i, static_cast<double>(group.z[row]), y.z[i]);
        H.row(row) = y.estimated().row(i);
      }
    }
    apply(H, R, gate, report);
    return report;
  }

  /// Least variances from now on, each >= 0 (std::invalid_argument names the component otherwise); resets the counters.
  void set_covariance_floor(const Tangent& variance) {
    detail::check_floor(variance);
    floor_ = {variance, {}, true};
  }
  [[nodiscard]] const CovarianceFloor<kDim>& covariance_floor() const noexcept { return floor_; }

 private:
  template <class HMatrix, class RMatrix, class Report>
  void apply(const HMatrix& H, const RMatrix& R, const Gate& gate, Report& report) {
    using Gain =
        detail::BoundedMatrix<kDim, Report::Square::ColsAtCompileTime, kDim, Report::Square::MaxColsAtCompileTime>;
    Gain PH(kDim, report.innovation.size());
    detail::project(H, P_, R, PH, report.covariance);
    Gain K(kDim, report.innovation.size());
    if (!detail::innovate(report, PH, gate, K)) return;
    Tangent step;
    detail::correct(K, report.innovation, step);
    Square P = P_;
    detail::joseph_update(P, H, R, PH, K);
    const bool finite = detail::all_finite(step);
    if (!finite || !detail::is_sound(P)) {
      report.status = finite ? UpdateStatus::kNotPositiveDefinite : UpdateStatus::kNonFinite;
      return;
    }
    floor_.apply(P);
    state_ = state_.retract(step);
    P_ = P;
    report.status = UpdateStatus::kAccepted;
  }

  State state_;
  Square P_;
  CovarianceFloor<kDim> floor_;
};

}  // namespace soopnav
