#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cmath>
#include <stdexcept>

#include "soopnav/core/status.hpp"
#include "soopnav/estimation/covariance_check.hpp"
#include "soopnav/estimation/covariance_floor.hpp"
#include "soopnav/estimation/detail/extended_predict.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"
#include "soopnav/estimation/detail/linearised_updates.hpp"
#include "soopnav/estimation/detail/triangular.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/estimation/update_report.hpp"

namespace soopnav {

/// Extended Kalman filter that carries a triangular root of its covariance, P = S Sᵀ (doc/kalman_filter.md eqs. 18,
/// 19; Kailath, Sayed and Hassibi 2000, chapter 12).
///
/// Prediction and update are one orthogonal triangularisation each; the covariance is never squared, so it cannot lose
/// its positive sign, and a condition number of 1e16 costs what 1e8 costs the covariance form. Reports hold H P Hᵀ + R
/// formed from the roots. Everything else as for `ExtendedKalmanFilter`: surface, statuses, no heap.
template <FixedStateType StateType>
class SquareRootKalmanFilter : public detail::LinearisedUpdates<SquareRootKalmanFilter<StateType>, StateType> {
  using Updates = detail::LinearisedUpdates<SquareRootKalmanFilter<StateType>, StateType>;
  friend Updates;

 public:
  using State = StateType;
  static constexpr int kDim = State::kDim;
  using Tangent = Eigen::Matrix<double, kDim, 1>;
  using Square = Eigen::Matrix<double, kDim, kDim>;

  /// Throws std::invalid_argument when `x0` is not finite or `P0` is no covariance (of the tangent at `x0`).
  SquareRootKalmanFilter(const State& x0, const Square& P0) : state_(x0) {
    detail::check_state(x0.x, "x0");
    check_covariance(P0, "P0");
    if (!detail::semidefinite_root(P0, root_)) {
      throw std::invalid_argument("P0: has no triangular root (negative beyond rounding in its smallest components)");
    }
    state_.normalize();
  }

  [[nodiscard]] const State& state() const noexcept { return state_; }
  /// S Sᵀ, formed for the call.
  [[nodiscard]] Square covariance() const noexcept {
    Square P;
    P.noalias() = root_ * root_.transpose();
    detail::mirror_lower(P);
    return P;
  }
  /// S: lower triangular, diagonal >= 0, in the tangent.
  [[nodiscard]] const Square& root() const noexcept { return root_; }

  /// Puts back a state and covariance. False, nothing changed, when `P` has no triangular root.
  bool restore(const State& x, const Square& P) noexcept {
    Square root;
    if (!P.allFinite() || !detail::semidefinite_root(P, root)) return false;
    restore_root(x, root);
    return true;
  }
  /// Puts back a state and root that this filter (or another of its type) had, to the bit.
  void restore_root(const State& x, const Square& root) noexcept {
    state_ = x;
    root_ = root;
  }

  /// As ExtendedKalmanFilter::predict.
  template <ProcessModelFor<State> Process>
  UpdateStatus predict(const Process& process, const InputOf<Process>& input, double dt_s, Square* cross = nullptr) {
    Transition<State, Process::kNoise> y(state_);
    const UpdateStatus status = detail::linearise(process, state_, input, dt_s, y);
    if (status != UpdateStatus::kAccepted) return status;
    Eigen::Matrix<double, kDim, kDim + Process::kNoise> array;
    array.template leftCols<kDim>().noalias() = y.F.template topLeftCorner<kDim, kDim>() * root_;
    array.template rightCols<Process::kNoise>() = y.G.template topRows<kDim>();
    if (!y.state.x.allFinite() || !array.allFinite()) return UpdateStatus::kNonFinite;
    Square moved = array.template leftCols<kDim>();
    detail::make_lower_triangular(array);
    Square root = array.template leftCols<kDim>();
    if (!root.allFinite()) return UpdateStatus::kNonFinite;
    if (cross != nullptr) cross->noalias() = root_ * moved.transpose();
    raise_to_floor(root);
    state_ = y.state;
    root_ = root;
    return UpdateStatus::kAccepted;
  }
  using Updates::predict;
  using Updates::update;

  /// As ExtendedKalmanFilter::set_covariance_floor; what a variance lacks is added as noise.
  void set_covariance_floor(const Tangent& variance) {
    detail::check_floor(variance);
    floor_ = {variance, {}, true};
  }
  [[nodiscard]] const CovarianceFloor<kDim>& covariance_floor() const noexcept { return floor_; }

 private:
  template <class Rows, class RMatrix, class Report>
  void apply(const Rows& rows, const RMatrix& R, const Gate& gate, Report& report) {
    constexpr int kM = Report::Square::ColsAtCompileTime;
    constexpr int kSize = kM == Eigen::Dynamic ? Eigen::Dynamic : kM + kDim;
    constexpr int kMaxSize = Rows::kMaxRows + kDim;
    typename Rows::Jacobian H = rows.jacobian();
    if (!rows(state_, report.innovation, H)) {
      report.status = UpdateStatus::kUndefined;
      return;
    }
    // [R^1/2  H S; 0  S], which the reflections turn into [S_y^1/2  0; K S_y^1/2  S+].
    const Eigen::Index m = report.innovation.size();
    Eigen::Matrix<double, kSize, kSize, 0, kMaxSize, kMaxSize> array(m + kDim, m + kDim);
    const Eigen::LLT<typename Report::Square> noise(R);
    array.setZero();
    array.topLeftCorner(m, m) = noise.matrixL();
    array.topRightCorner(m, kDim) = H.lazyProduct(root_);
    array.bottomRightCorner(kDim, kDim) = root_;
    report.covariance = array.topRightCorner(m, kDim).lazyProduct(array.topRightCorner(m, kDim).transpose());
    report.covariance += R;
    if (!report.innovation.allFinite() || !report.covariance.allFinite()) {
      report.status = UpdateStatus::kNonFinite;
      return;
    }
    detail::make_lower_triangular(array);
    if (!array.allFinite() || !(array.diagonal().head(m).array() > 0.0).all()) {
      report.status = UpdateStatus::kNotPositiveDefinite;
      return;
    }
    typename Report::Vector whitened = report.innovation;
    for (Eigen::Index i = 0; i < m; ++i) {
      for (Eigen::Index j = 0; j < i; ++j) whitened[i] -= array(i, j) * whitened[j];
      whitened[i] /= array(i, i);
    }
    report.nis = whitened.squaredNorm();
    if (!detail::passes(gate, report)) {
      report.status = UpdateStatus::kGated;
      return;
    }
    const Tangent step = array.bottomLeftCorner(kDim, m).lazyProduct(whitened);
    if (!step.allFinite()) {
      report.status = UpdateStatus::kNonFinite;
      return;
    }
    root_ = array.bottomRightCorner(kDim, kDim);
    raise_to_floor(root_);
    state_ = state_.retract(step);
    report.status = UpdateStatus::kAccepted;
  }

  void raise_to_floor(Square& root) noexcept {
    if (!floor_.active) return;
    Tangent sigma;
    if (!floor_.missing(root.rowwise().squaredNorm(), sigma)) return;
    Eigen::Matrix<double, kDim, 2 * kDim> array;
    array.template leftCols<kDim>() = root;
    array.template rightCols<kDim>() = sigma.asDiagonal();
    detail::make_lower_triangular(array);
    root = array.template leftCols<kDim>();
  }

  State state_;
  Square root_;
  CovarianceFloor<kDim> floor_;
};

}  // namespace soopnav
