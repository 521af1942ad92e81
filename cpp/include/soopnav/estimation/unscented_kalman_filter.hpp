#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>

#include "soopnav/core/status.hpp"
#include "soopnav/estimation/covariance_check.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/observed.hpp"
#include "soopnav/estimation/prediction.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/estimation/transition.hpp"
#include "soopnav/estimation/update_report.hpp"

namespace soopnav {

/// Spread and weights of sigma points (Julier and Uhlmann 2004; Wan and van der Merwe 2000). The default is the
/// spherical cubature rule: points at sqrt(n) standard deviations, equal positive weights, none in the middle.
struct UnscentedOptions {
  double alpha = 1.0;  ///< spread, > 0
  double beta = 0.0;   ///< added to the middle's weight in covariances; 2 suits a small alpha
  double kappa = 0.0;  ///< second spread parameter; alpha² (n + kappa) > 0

  /// Throws std::invalid_argument naming the option that breaks its rule for `dim` components.
  void check(int dim) const;
};

/// Unscented Kalman filter on a state of fixed size (doc/kalman_filter.md).
///
/// Sigma points are drawn and averaged in the state's tangent, so headings and quaternions are treated as what they
/// are. Process noise is additive, G Gᵀ at the mean. The covariance update is Joseph's form of the statistically
/// linearised model. Everything else as for `ExtendedKalmanFilter`.
template <FixedStateType StateType>
class UnscentedKalmanFilter {
 public:
  using State = StateType;
  static constexpr int kDim = State::kDim;
  static constexpr int kPoints = 2 * kDim + 1;
  using Tangent = Eigen::Matrix<double, kDim, 1>;
  using Square = Eigen::Matrix<double, kDim, kDim>;

  /// Throws std::invalid_argument when `x0` is not finite, `P0` is no covariance, or an option breaks its rule.
  UnscentedKalmanFilter(const State& x0, const Square& P0, const UnscentedOptions& options = {}) : state_(x0), P_(P0) {
    detail::check_state(x0.x, "x0");
    check_covariance(P0, "P0");
    options.check(kDim);
    state_.normalize();
    const double spread = options.alpha * options.alpha * (kDim + options.kappa);
    scale_ = std::sqrt(spread);
    weight_ = 0.5 / spread;
    middle_mean_ = 1.0 - kDim / spread;
    middle_covariance_ = middle_mean_ + 1.0 - options.alpha * options.alpha + options.beta;
  }

  [[nodiscard]] const State& state() const noexcept { return state_; }
  [[nodiscard]] const Square& covariance() const noexcept { return P_; }
  void restore(const State& x, const Square& P) noexcept {
    state_ = x;
    P_ = P;
  }

  /// As ExtendedKalmanFilter::predict; `cross` receives Cov(x_k, x_k+1).
  template <ProcessModelFor<State> Process>
  UpdateStatus predict(const Process& process, const InputOf<Process>& input, double dt_s, Square* cross = nullptr) {
    if (!(dt_s > 0.0) || std::isinf(dt_s)) return UpdateStatus::kTimeNotAdvancing;
    Transition<State, Process::kNoise> y(state_);
    if (!detail::propagate(process, state_, input, dt_s, ZeroNoise{}, y)) return UpdateStatus::kUndefined;
    y.state.normalize();
    Square root;
    if (!square_root(root)) return UpdateStatus::kNotPositiveDefinite;
    // Differences to the image of the mean, in its tangent.
    Deviations moved;
    for (int i = 0; i < kPoints - 1; ++i) {
      const State point = state_.retract(offset(root, i));
      ValueTransition<State> image(point);
      if (!detail::propagate(process, point, input, dt_s, ZeroNoise{}, image)) return UpdateStatus::kUndefined;
      image.state.normalize();
      moved.col(i) = y.state.local(image.state);
    }
    Tangent mean = Tangent::Zero();
    for (int i = 0; i < kPoints - 1; ++i) {
      for (int r = 0; r < kDim; ++r) mean[r] += weight_ * moved.coeff(r, i);
    }
    const State next = y.state.retract(mean);
    for (int i = 0; i < kPoints - 1; ++i) {
      for (int r = 0; r < kDim; ++r) moved.coeffRef(r, i) -= mean[r];
    }
    // (-mean)(-mean)ᵀ of the middle point, the others, the noise.
    Square P;
    for (int j = 0; j < kDim; ++j) {
      for (int i = 0; i < kDim; ++i) P.coeffRef(i, j) = middle_covariance_ * mean[i] * mean[j];
    }
    Deviations weighted = moved;
    for (Eigen::Index i = 0; i < weighted.size(); ++i) weighted.data()[i] *= weight_;
    detail::accumulate_product_transposed<1>(weighted, moved, P);
    detail::accumulate_product_transposed<1>(y.G, y.G, P);
    if (!detail::all_finite(next.x) || !detail::all_finite(P)) return UpdateStatus::kNonFinite;
    if (!detail::is_sound(P)) return UpdateStatus::kNotPositiveDefinite;
    detail::mirror_lower(P);
    floor_.apply(P);
    if (cross != nullptr) {
      cross->setZero();
      for (int i = 0; i < kPoints - 1; ++i) {
        const Tangent start = offset(root, i);
        for (int j = 0; j < kDim; ++j) {
          for (int r = 0; r < kDim; ++r) cross->coeffRef(r, j) += start[r] * weighted.coeff(j, i);
        }
      }
    }
    state_ = next;
    P_ = P;
    return UpdateStatus::kAccepted;
  }
  template <ProcessModelFor<State> Process>
  requires(!detail::kDriven<Process>) UpdateStatus
      predict(const Process& process, double dt_s, Square* cross = nullptr) {
    return predict(process, detail::NoInput{}, dt_s, cross);
  }

  /// As ExtendedKalmanFilter::update. Where the model has no value at a sigma point the observation is refused.
  template <MeasurementModelFor<State> Model>
  UpdateReport<Model::kDim> update(const Model& model, const Eigen::Matrix<double, Model::kDim, 1>& z,
                                   const Eigen::Matrix<double, Model::kDim, Model::kDim>& R, const Gate& gate = {}) {
    UpdateReport<Model::kDim> report;
    report.status = detail::all_finite(z) ? detail::check_noise(R) : UpdateStatus::kNonFinite;
    if (report.accepted()) apply(std::span<const Model, 1>(&model, 1), z, R, gate, report);
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
    const typename Report::Vector z = group.z;
    const typename Report::Square R = group.R;
    report.status = detail::all_finite(z) ? detail::check_noise(R) : UpdateStatus::kNonFinite;
    if (report.accepted()) apply(group.models, z, R, gate, report);
    return report;
  }

  /// The sigma points in the order in which `predict` and `update` ask a model: the mean, then the points on either
  /// side of it, x+ of each column of the root and x- of each. For models that are evaluated at all of them at once.
  /// False when the covariance has no root.
  [[nodiscard]] bool sigma_points(std::array<State, static_cast<std::size_t>(kPoints)>& points) const noexcept {
    Square root;
    if (!square_root(root)) return false;
    points[0] = state_;
    for (int i = 0; i < kPoints - 1; ++i) points[static_cast<std::size_t>(i + 1)] = state_.retract(offset(root, i));
    return true;
  }

  /// As ExtendedKalmanFilter::set_covariance_floor.
  void set_covariance_floor(const Tangent& variance) {
    detail::check_floor(variance);
    floor_ = {variance, {}, true};
  }
  [[nodiscard]] const CovarianceFloor<kDim>& covariance_floor() const noexcept { return floor_; }

 private:
  using Deviations = Eigen::Matrix<double, kDim, kPoints - 1>;

  // The rows of all models at `x`; false where one has no value.
  template <std::size_t N, class Model, class Vector>
  [[nodiscard]] static bool values(std::span<const Model, N> models, const State& x, Vector& h) {
    Eigen::Index row = 0;
    for (const Model& model : models) {
      ValuePrediction<double, Model::kDim> y;
      if (!model.predict(x, y)) return false;
      for (int m = 0; m < Model::kDim; ++m) h[row++] = y.value(m);
    }
    return true;
  }
  // a - b, rows the short way round.
  template <std::size_t N, class Model, class Vector>
  static void subtract(std::span<const Model, N> models, const Vector& a, const Vector& b, Vector& difference) {
    Eigen::Index row = 0;
    for (const Model& model : models) {
      for (int m = 0; m < Model::kDim; ++m, ++row) {
        difference[row] = detail::residual(model, m, static_cast<double>(a[row]), static_cast<double>(b[row]));
      }
    }
  }

  // Fills `report` from checked z and R, and changes the filter only to accept.
  template <std::size_t N, class Model, class Rows, class RMatrix, class Report>
  void apply(std::span<const Model, N> models, const Rows& z, const RMatrix& R, const Gate& gate, Report& report) {
    constexpr int kM = Report::Square::ColsAtCompileTime;
    constexpr int kMaxM = Report::Square::MaxColsAtCompileTime;
    const Eigen::Index rows = z.size();
    Square root;
    if (!square_root(root)) {
      report.status = UpdateStatus::kNotPositiveDefinite;
      return;
    }
    // Differences to the prediction at the mean, rows the short way round.
    Rows middle(rows);
    Rows at_point(rows);
    Rows difference(rows);
    bool defined = values(models, state_, middle);
    detail::BoundedMatrix<kM, kPoints - 1, kMaxM, kPoints - 1> h(rows, kPoints - 1);
    for (int i = 0; defined && i < kPoints - 1; ++i) {
      defined = values(models, state_.retract(offset(root, i)), at_point);
      subtract(models, at_point, middle, difference);
      for (Eigen::Index r = 0; r < rows; ++r) h.coeffRef(r, i) = difference.coeff(r);
    }
    if (!defined) {
      report.status = UpdateStatus::kUndefined;
      return;
    }
    Rows mean(rows);
    Rows predicted(rows);
    for (Eigen::Index r = 0; r < rows; ++r) {
      double sum = 0.0;
      for (int i = 0; i < kPoints - 1; ++i) sum += h.coeff(r, i);
      mean.coeffRef(r) = weight_ * sum;
      predicted.coeffRef(r) = middle.coeff(r) + mean.coeff(r);
    }
    subtract(models, z, predicted, report.innovation);
    for (int i = 0; i < kPoints - 1; ++i) {
      for (Eigen::Index r = 0; r < rows; ++r) h.coeffRef(r, i) -= mean.coeff(r);
    }
    for (Eigen::Index j = 0; j < rows; ++j) {
      for (Eigen::Index i = 0; i < rows; ++i) {
        double sum = 0.0;
        for (int k = 0; k < kPoints - 1; ++k) sum += h.coeff(i, k) * h.coeff(j, k);
        report.covariance.coeffRef(i, j) =
            R.coeff(i, j) + middle_covariance_ * mean.coeff(i) * mean.coeff(j) + weight_ * sum;
      }
    }
    // Pxz = L W with W = scale weight (h+ - h-)ᵀ, so the linearised model is H = Wᵀ L⁻¹ and H P Hᵀ = Wᵀ W.
    using Gain = detail::BoundedMatrix<kDim, kM, kDim, kMaxM>;
    Gain W(kDim, rows);
    for (Eigen::Index r = 0; r < rows; ++r) {
      for (int i = 0; i < kDim; ++i) W.coeffRef(i, r) = scale_ * weight_ * (h.coeff(r, i) - h.coeff(r, i + kDim));
    }
    Gain PH(kDim, rows);
    detail::product(root, W, PH);
    Gain K(kDim, rows);
    if (!detail::innovate(report, PH, gate, K)) return;
    // Joseph's form in the whitened tangent: P = (L - K Wᵀ)(L - K Wᵀ)ᵀ + K (S - Wᵀ W) Kᵀ.
    Square A = root;
    detail::accumulate_product_transposed<-1>(K, W, A);
    typename Report::Square rest = report.covariance;
    detail::accumulate_transposed_product<-1>(W, W, rest);
    Tangent step;
    detail::product(K, report.innovation, step);
    Gain Krest(kDim, rows);
    detail::product(K, rest, Krest);
    Square P;
    detail::product_transposed(A, A, P);
    detail::accumulate_product_transposed<1>(Krest, K, P);
    const bool finite = detail::all_finite(step);
    if (!finite || !detail::is_sound(P)) {
      report.status = finite ? UpdateStatus::kNotPositiveDefinite : UpdateStatus::kNonFinite;
      return;
    }
    detail::mirror_lower(P);
    floor_.apply(P);
    state_ = state_.retract(step);
    P_ = P;
    report.status = UpdateStatus::kAccepted;
  }

  // Lower L with L Lᵀ = P; a component that is known exactly (zero variance) gets a column of zeros.
  [[nodiscard]] bool square_root(Square& L) const noexcept { return detail::semidefinite_root(P_, L); }
  [[nodiscard]] Tangent offset(const Square& root, int i) const noexcept {
    const int column = i < kDim ? i : i - kDim;
    const double scale = i < kDim ? scale_ : -scale_;
    Tangent offset;
    for (int r = 0; r < kDim; ++r) offset[r] = scale * root.coeff(r, column);
    return offset;
  }

  State state_;
  Square P_;
  double scale_, weight_, middle_mean_, middle_covariance_;
  CovarianceFloor<kDim> floor_;
};

}  // namespace soopnav
