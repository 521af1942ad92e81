#pragma once

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
    detail::product_transposed(root_, root_, P);
    detail::mirror_lower(P);
    return P;
  }
  /// S: lower triangular, diagonal >= 0, in the tangent.
  [[nodiscard]] const Square& root() const noexcept { return root_; }

  /// Puts back a state and covariance. False, nothing changed, when `P` has no triangular root.
  bool restore(const State& x, const Square& P) noexcept {
    Square root;
    if (!detail::all_finite(P) || !detail::semidefinite_root(P, root)) return false;
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
    Square moved;
    detail::product(y.F, root_, moved);
    detail::copy_block(moved, 0, 0, kDim, kDim, array, 0, 0);
    detail::copy_block(y.G, 0, 0, kDim, Process::kNoise, array, 0, kDim);
    if (!detail::all_finite(y.state.x) || !detail::all_finite(array)) return UpdateStatus::kNonFinite;
    detail::make_lower_triangular(array);
    Square root;
    detail::copy_block(array, 0, 0, kDim, kDim, root, 0, 0);
    if (!detail::all_finite(root)) return UpdateStatus::kNonFinite;
    if (cross != nullptr) detail::product_transposed(root_, moved, *cross);
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
    const detail::CholeskyFactor<typename Report::Square> noise(R);
    detail::BoundedMatrix<kM, kDim, Rows::kMaxRows, kDim> HS(m, kDim);
    detail::product(H, root_, HS);
    array.setZero();
    for (Eigen::Index j = 0; j < m; ++j) {
      for (Eigen::Index i = j; i < m; ++i) array(i, j) = noise.L(i, j);
    }
    detail::copy_block(HS, 0, 0, m, kDim, array, 0, m);
    detail::copy_block(root_, 0, 0, kDim, kDim, array, m, m);
    report.covariance = R;
    detail::accumulate_product_transposed<1>(HS, HS, report.covariance);
    if (!detail::all_finite(report.innovation) || !detail::all_finite(report.covariance)) {
      report.status = UpdateStatus::kNonFinite;
      return;
    }
    detail::make_lower_triangular(array);
    bool sound = detail::all_finite(array);
    for (Eigen::Index i = 0; i < m; ++i) sound &= array(i, i) > 0.0;
    if (!sound) {
      report.status = UpdateStatus::kNotPositiveDefinite;
      return;
    }
    typename Report::Vector whitened = report.innovation;
    for (Eigen::Index i = 0; i < m; ++i) {
      for (Eigen::Index j = 0; j < i; ++j) whitened[i] -= array(i, j) * whitened[j];
      whitened[i] /= array(i, i);
    }
    report.nis = detail::squared_norm(whitened);
    if (!detail::passes(gate, report)) {
      report.status = UpdateStatus::kGated;
      return;
    }
    Tangent step = Tangent::Zero();
    for (Eigen::Index j = 0; j < m; ++j) {
      for (int i = 0; i < kDim; ++i) step[i] += array(m + i, j) * whitened[j];
    }
    if (!detail::all_finite(step)) {
      report.status = UpdateStatus::kNonFinite;
      return;
    }
    detail::copy_block(array, m, m, kDim, kDim, root_, 0, 0);
    raise_to_floor(root_);
    state_ = state_.retract(step);
    report.status = UpdateStatus::kAccepted;
  }

  void raise_to_floor(Square& root) noexcept {
    if (!floor_.active) return;
    Tangent sigma;
    Tangent variances = Tangent::Zero();
    for (int j = 0; j < kDim; ++j) {
      for (int i = j; i < kDim; ++i) variances[i] += root.coeff(i, j) * root.coeff(i, j);
    }
    if (!floor_.missing(variances, sigma)) return;
    Eigen::Matrix<double, kDim, 2 * kDim> array = Eigen::Matrix<double, kDim, 2 * kDim>::Zero();
    detail::copy_block(root, 0, 0, kDim, kDim, array, 0, 0);
    for (int i = 0; i < kDim; ++i) array.coeffRef(i, kDim + i) = sigma[i];
    detail::make_lower_triangular(array);
    detail::copy_block(array, 0, 0, kDim, kDim, root, 0, 0);
  }

  State state_;
  Square root_;
  CovarianceFloor<kDim> floor_;
};

}  // namespace soopnav
