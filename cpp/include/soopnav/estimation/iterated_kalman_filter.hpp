#pragma once

#include <Eigen/Core>
#include <algorithm>

#include "soopnav/core/status.hpp"
#include "soopnav/estimation/covariance_check.hpp"
#include "soopnav/estimation/covariance_floor.hpp"
#include "soopnav/estimation/detail/extended_predict.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"
#include "soopnav/estimation/detail/linearised_updates.hpp"
#include "soopnav/estimation/detail/retract_jacobian.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/estimation/update_report.hpp"

namespace soopnav {

/// When an iterated update ends.
struct IterationOptions {
  int max_iterations = 10;  ///< steps of an update, >= 1; one makes it the extended filter's
  double tolerance = 1e-6;  ///< no component moves more than this many prior standard deviations, > 0

  /// Throws std::invalid_argument naming the option that breaks its rule.
  void check() const;
};

/// Iterated extended Kalman filter: the update is the maximum a posteriori estimate, by Gauss-Newton steps from the
/// predicted state (Bell and Cathey 1993; doc/kalman_filter.md eqs. 21 to 24).
///
/// Each step linearises the model anew and weighs the prior in the tangent there; one that would not lower the
/// posterior's cost is halved. The covariance is Joseph's at the last linearisation. Innovation, its covariance, NIS
/// and the gate are those of the first, so a report means the same as the extended filter's. Everything else as for
/// `ExtendedKalmanFilter`: surface, statuses, no heap. Costs an extended update and a model evaluation per iteration.
template <FixedStateType StateType>
class IteratedKalmanFilter : public detail::LinearisedUpdates<IteratedKalmanFilter<StateType>, StateType> {
  using Updates = detail::LinearisedUpdates<IteratedKalmanFilter<StateType>, StateType>;
  friend Updates;

 public:
  using State = StateType;
  static constexpr int kDim = State::kDim;
  using Tangent = Eigen::Matrix<double, kDim, 1>;
  using Square = Eigen::Matrix<double, kDim, kDim>;

  /// Throws std::invalid_argument when `x0` is not finite, `P0` is no covariance, or an option breaks its rule.
  IteratedKalmanFilter(const State& x0, const Square& P0, const IterationOptions& options = {})
      : state_(x0), P_(P0), options_(options) {
    detail::check_state(x0.x, "x0");
    check_covariance(P0, "P0");
    options.check();
    state_.normalize();
  }

  [[nodiscard]] const State& state() const noexcept { return state_; }
  [[nodiscard]] const Square& covariance() const noexcept { return P_; }
  void restore(const State& x, const Square& P) noexcept {
    state_ = x;
    P_ = P;
  }

  /// Steps of the last accepted update; 0 before the first.
  [[nodiscard]] int iterations() const noexcept { return iterations_; }
  /// Whether the last accepted update met the tolerance, rather than the most iterations or a step that no halving made
  /// descend.
  [[nodiscard]] bool converged() const noexcept { return converged_; }

  /// As ExtendedKalmanFilter::predict.
  template <ProcessModelFor<State> Process>
  UpdateStatus predict(const Process& process, const InputOf<Process>& input, double dt_s, Square* cross = nullptr) {
    return detail::extended_predict(process, input, dt_s, state_, P_, floor_, cross);
  }
  using Updates::predict;
  using Updates::update;

  /// As ExtendedKalmanFilter::set_covariance_floor.
  void set_covariance_floor(const Tangent& variance) {
    detail::check_floor(variance);
    floor_ = {variance, {}, true};
  }
  [[nodiscard]] const CovarianceFloor<kDim>& covariance_floor() const noexcept { return floor_; }

 private:
  template <class Rows, class RMatrix, class Report>
  void apply(const Rows& rows, const RMatrix& R, const Gate& gate, Report& report) {
    using Gain =
        detail::BoundedMatrix<kDim, Report::Square::ColsAtCompileTime, kDim, Report::Square::MaxColsAtCompileTime>;
    typename Rows::Jacobian H = rows.jacobian();
    if (!rows(state_, report.innovation, H)) {
      report.status = UpdateStatus::kUndefined;
      return;
    }
    // `step` is taken in the tangent at `x`, where `P`, `H` and `K` belong.
    Square P = P_;
    Gain PH(kDim, report.innovation.size());
    detail::project(H, P, R, PH, report.covariance);
    Gain K(kDim, report.innovation.size());
    if (!detail::innovate(report, PH, gate, K)) return;
    Tangent step;
    detail::correct(K, report.innovation, step);
    State x = state_;
    int iterations = 1;
    bool converged = options_.max_iterations == 1;
    if (!converged) {
      Square root;
      if (!detail::semidefinite_root(P_, root)) {
        report.status = UpdateStatus::kNotPositiveDefinite;
        return;
      }
      const detail::CholeskyFactor<typename Report::Square> noise(R);
      Report at_x = report;
      double cost = this->cost(root, x, noise, at_x.innovation);
      for (;; ++iterations) {
        if (!detail::all_finite(step)) break;
        converged = true;
        for (int i = 0; i < kDim; ++i) converged &= std::abs(step[i]) <= options_.tolerance * std::sqrt(P_.coeff(i, i));
        if (converged) break;
        if (!descend(rows, root, noise, x, step, cost, at_x.innovation, H)) {
          step.setZero();
          break;
        }
        if constexpr (!detail::kFlatTangent<State>) {
          const Square J = detail::retract_jacobian(state_, state_.local(x));
          Square JP;
          detail::product(J, P_, JP);
          detail::product_transposed(JP, J, P);
        }
        detail::project(H, P, R, PH, at_x.covariance);
        if (!detail::innovate(at_x, PH, Gate{}, K)) {
          report.status = at_x.status;
          return;
        }
        if (iterations == options_.max_iterations) {
          step.setZero();
          break;
        }
        const Tangent prior = x.local(state_);
        typename Report::Vector shifted = at_x.innovation;
        detail::accumulate_product<-1>(H, prior, shifted);
        step = prior;
        detail::accumulate_product<1>(K, shifted, step);
      }
    }
    detail::joseph_update(P, H, R, PH, K);
    const bool finite = detail::all_finite(step);
    if (!finite || !detail::is_sound(P)) {
      report.status = finite ? UpdateStatus::kNotPositiveDefinite : UpdateStatus::kNonFinite;
      return;
    }
    floor_.apply(P);
    state_ = x.retract(step);
    P_ = P;
    iterations_ = iterations;
    converged_ = converged;
    report.status = UpdateStatus::kAccepted;
  }

  // Moves x by the first of step, step / 2, step / 4, ... that lowers the cost; innovation and H are then those at x.
  template <class Rows, class Noise, class Vector>
  [[nodiscard]] bool descend(const Rows& rows, const Square& root, const Noise& noise, State& x, const Tangent& step,
                             double& cost, Vector& innovation, typename Rows::Jacobian& H) const {
    constexpr int kHalvings = 10;
    constexpr double kRounding = 1e-12;  // of a cost: near the end steps no longer show in it
    Vector trial_innovation = innovation;
    typename Rows::Jacobian trial_H = H;
    double fraction = 1.0;
    for (int k = 0; k <= kHalvings; ++k, fraction *= 0.5) {
      const State trial = x.retract(fraction * step);
      if (!rows(trial, trial_innovation, trial_H)) continue;
      const double trial_cost = this->cost(root, trial, noise, trial_innovation);
      if (!(trial_cost < cost + kRounding * std::max(1.0, cost))) continue;
      x = trial;
      cost = trial_cost;
      innovation = trial_innovation;
      H = trial_H;
      return true;
    }
    return false;
  }

  // Minus twice the logarithm of the posterior's density, but for a constant.
  template <class Noise, class Vector>
  [[nodiscard]] double cost(const Square& root, const State& x, const Noise& noise, const Vector& innovation) const {
    Tangent u = state_.local(x);
    for (int i = 0; i < kDim; ++i) {
      double rest = u[i];
      for (int k = 0; k < i; ++k) rest -= root.coeff(i, k) * u[k];
      u[i] = root(i, i) > 0.0 ? rest / root(i, i) : 0.0;
    }
    Vector whitened = innovation;
    noise.whiten(whitened);
    return u.squaredNorm() + whitened.squaredNorm();
  }

  State state_;
  Square P_;
  IterationOptions options_;
  CovarianceFloor<kDim> floor_;
  int iterations_ = 0;
  bool converged_ = false;
};

}  // namespace soopnav
