#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>

#include "soopnav/core/status.hpp"
#include "soopnav/estimation/covariance_check.hpp"
#include "soopnav/estimation/covariance_floor.hpp"
#include "soopnav/estimation/detail/extended_predict.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"
#include "soopnav/estimation/detail/information_solver.hpp"
#include "soopnav/estimation/detail/linearised_updates.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/estimation/update_report.hpp"

namespace soopnav {

/// Extended Kalman filter that carries the information matrix Y = P⁻¹ (doc/kalman_filter.md eqs. 25 to 29).
///
/// An update adds Hᵀ R⁻¹ H. There need be no prior: Y may start at zero or singular, and the state then serves as the
/// point of linearisation in the directions nothing has determined yet, which stay where they are; on a linear model
/// the start does not matter. `rank()` says how many directions are determined. Refused beside what
/// `ExtendedKalmanFilter` refuses: a prediction whose transition is singular (kUndefined). No heap. An update costs
/// O(n³).
template <FixedStateType StateType>
class InformationFilter : public detail::LinearisedUpdates<InformationFilter<StateType>, StateType> {
  using Updates = detail::LinearisedUpdates<InformationFilter<StateType>, StateType>;
  friend Updates;

 public:
  using State = StateType;
  static constexpr int kDim = State::kDim;
  using Tangent = Eigen::Matrix<double, kDim, 1>;
  using Square = Eigen::Matrix<double, kDim, kDim>;

  /// Throws std::invalid_argument when `x0` is not finite or `P0` is not a positive definite covariance.
  InformationFilter(const State& x0, const Square& P0) : state_(x0) {
    detail::check_state(x0.x, "x0");
    check_covariance(P0, "P0", true);
    state_.normalize();
    Y_ = Solver(P0).solve(Square(Square::Identity()));
    detail::mirror_lower(Y_);
  }
  /// Starts from an information matrix, positive semi-definite (std::invalid_argument otherwise). Zero: no prior.
  [[nodiscard]] static InformationFilter from_information(const State& x0, const Square& Y0) {
    check_covariance(Y0, "Y0");
    InformationFilter filter(x0, Square::Identity());
    filter.Y_ = Y0;
    return filter;
  }

  [[nodiscard]] const State& state() const noexcept { return state_; }
  /// Y, in the tangent.
  [[nodiscard]] const Square& information() const noexcept { return Y_; }
  /// Y⁻¹, formed for the call. A component that is not determined has infinite variance, and zero covariance with the
  /// others.
  [[nodiscard]] Square covariance() const noexcept { return covariance(Solver(Y_)); }
  /// Directions of the tangent that are determined: kDim when the covariance is finite.
  [[nodiscard]] int rank() const noexcept { return Solver(Y_).rank(); }

  /// Puts back a state and covariance. False, nothing changed, when `P` is not positive definite to rounding.
  bool restore(const State& x, const Square& P) noexcept {
    if (!detail::all_finite(P)) return false;
    const Solver solver(P);
    if (!solver.definite()) return false;
    Square Y = solver.solve(Square(Square::Identity()));
    detail::mirror_lower(Y);
    restore_information(x, Y);
    return true;
  }
  /// Puts back a state and information matrix that this filter (or another of its type) had, to the bit.
  void restore_information(const State& x, const Square& Y) noexcept {
    state_ = x;
    Y_ = Y;
  }

  /// As ExtendedKalmanFilter::predict. `cross` receives NaN unless all directions are determined.
  template <ProcessModelFor<State> Process>
  UpdateStatus predict(const Process& process, const InputOf<Process>& input, double dt_s, Square* cross = nullptr) {
    Transition<State, Process::kNoise> y(state_);
    const UpdateStatus status = detail::linearise(process, state_, input, dt_s, y);
    if (status != UpdateStatus::kAccepted) return status;
    Square Ft;
    for (int j = 0; j < kDim; ++j) {
      for (int i = 0; i < kDim; ++i) Ft.coeffRef(i, j) = y.F.coeff(j, i);
    }
    Eigen::Matrix<double, kDim, Process::kNoise> G;
    detail::copy_block(y.G, 0, 0, kDim, Process::kNoise, G, 0, 0);
    if (!detail::all_finite(y.state.x) || !detail::all_finite(Ft) || !detail::all_finite(G)) {
      return UpdateStatus::kNonFinite;
    }
    // M = F⁻ᵀ Y F⁻¹, the information without the noise.
    Square Y = Y_;
    for (int side = 0; side < 2; ++side) {
      Square spent = Ft;
      if (!detail::solve_square(spent.data(), kDim, Y.data(), kDim)) return UpdateStatus::kUndefined;
      Y.transposeInPlace();
    }
    detail::mirror_lower(Y);
    if (!add_noise(G, Y)) return UpdateStatus::kNonFinite;
    if (cross != nullptr) {
      const Solver solver(Y_);
      if (solver.definite()) {
        detail::product(covariance(solver), Ft, *cross);
      } else {
        cross->setConstant(std::numeric_limits<double>::quiet_NaN());
      }
    }
    raise_to_floor(Y);
    state_ = y.state;
    Y_ = Y;
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
  using Solver = detail::InformationSolver<kDim>;

  [[nodiscard]] static Square covariance(const Solver& solver) noexcept {
    Square P = solver.solve(Square(Square::Identity()));
    detail::mirror_lower(P);
    if (solver.definite()) return P;
    for (int i = 0; i < kDim; ++i) {
      if (solver.determines(Tangent::Unit(i))) continue;
      for (int k = 0; k < kDim; ++k) P(i, k) = P(k, i) = 0.0;
      P(i, i) = std::numeric_limits<double>::infinity();
    }
    return P;
  }

  // Y becomes (Y⁻¹ + G Gᵀ)⁻¹ by the inversion lemma, in a form that stays positive: (I - J Gᵀ) Y (I - J Gᵀ)ᵀ + J Jᵀ
  // with J = Y G (I + Gᵀ Y G)⁻¹. Y may be singular. False when a number overflows.
  template <int Noise>
  [[nodiscard]] static bool add_noise(const Eigen::Matrix<double, kDim, Noise>& G, Square& Y) noexcept {
    using Inner = Eigen::Matrix<double, Noise, Noise>;
    Eigen::Matrix<double, kDim, Noise> J;
    detail::product(Y, G, J);
    Inner inner = Inner::Identity();
    detail::accumulate_transposed_product<1>(G, J, inner);
    if (!detail::all_finite(inner) || !detail::cholesky_in_place(inner.data(), Noise)) return false;
    detail::solve_right_lower_transposed(inner.data(), Noise, J.data(), kDim);
    detail::solve_right_lower(inner.data(), Noise, J.data(), kDim);
    Square A = Square::Identity();
    detail::accumulate_product_transposed<-1>(J, G, A);
    Square AY;
    detail::product(A, Y, AY);
    detail::product_transposed(AY, A, Y);
    detail::accumulate_product_transposed<1>(J, J, Y);
    detail::mirror_lower(Y);
    return detail::all_finite(Y);
  }

  template <class Rows, class RMatrix, class Report>
  void apply(const Rows& rows, const RMatrix& R, const Gate& gate, Report& report) {
    constexpr int kM = Report::Square::ColsAtCompileTime;
    using Columns = detail::BoundedMatrix<kDim, kM, kDim, Rows::kMaxRows>;
    typename Rows::Jacobian H = rows.jacobian();
    if (!rows(state_, report.innovation, H)) {
      report.status = UpdateStatus::kUndefined;
      return;
    }
    if (!detail::all_finite(report.innovation) || !detail::all_finite(H)) {
      report.status = UpdateStatus::kNonFinite;
      return;
    }
    const detail::CholeskyFactor<typename Report::Square> noise(R);
    typename Report::Vector whitened = report.innovation;
    noise.whiten(whitened);
    const Columns Ht = H.transpose();
    Columns J = Ht;  // Hᵀ L⁻ᵀ
    detail::solve_right_lower_transposed(noise.L.data(), J.cols(), J.data(), kDim);
    Square Y = Y_;
    detail::accumulate_product_transposed<1>(J, J, Y);
    detail::mirror_lower(Y);
    Tangent shift;
    detail::product(J, whitened, shift);
    const Tangent step = Solver(Y).solve(shift);

    const Solver prior(Y_);
    const Columns PH = prior.solve(Ht);
    report.covariance = R;
    detail::accumulate_product<1>(H, PH, report.covariance);
    if (prior.definite()) {
      Columns K(kDim, report.innovation.size());
      if (!detail::innovate(report, PH, gate, K)) return;
    } else {
      // What the state does not determine is not tested: the least sum of squares that any state leaves.
      for (Eigen::Index i = 0; i < report.innovation.size(); ++i) {
        if (prior.determines(Tangent(Ht.col(i)))) continue;
        for (Eigen::Index k = 0; k < report.innovation.size(); ++k) {
          report.covariance(i, k) = report.covariance(k, i) = 0.0;
        }
        report.covariance(i, i) = std::numeric_limits<double>::infinity();
      }
      detail::accumulate_transposed_product<-1>(J, step, whitened);
      Tangent Ystep;
      detail::product(Y_, step, Ystep);
      report.nis = detail::squared_norm(whitened) + step.dot(Ystep);
      if (!detail::passes(gate, report)) {
        report.status = UpdateStatus::kGated;
        return;
      }
    }
    if (!detail::all_finite(step) || !detail::all_finite(Y)) {
      report.status = UpdateStatus::kNonFinite;
      return;
    }
    raise_to_floor(Y);
    state_ = state_.retract(step);
    Y_ = Y;
    report.status = UpdateStatus::kAccepted;
  }

  void raise_to_floor(Square& Y) noexcept {
    if (!floor_.active) return;
    Tangent sigma;
    CovarianceFloor<kDim> floor = floor_;
    if (!floor.missing(Tangent(covariance(Solver(Y)).diagonal()), sigma)) return;
    Square raised = Y;
    Square noise = Square::Zero();
    for (int i = 0; i < kDim; ++i) noise(i, i) = sigma[i];
    if (!add_noise<kDim>(noise, raised)) return;
    Y = raised;
    floor_ = floor;
  }

  State state_;
  Square Y_;
  CovarianceFloor<kDim> floor_;
};

}  // namespace soopnav
