#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <array>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <limits>
#include <tuple>
#include <type_traits>
#include <utility>

#include "soopnav/core/status.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/observed.hpp"
#include "soopnav/estimation/prediction.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/estimation/transition.hpp"
#include "soopnav/estimation/update_report.hpp"

namespace soopnav {

namespace detail {

/// Throws std::invalid_argument naming the element unless `transition` has rows of probabilities that sum to one.
void check_mode_transition(const Eigen::Ref<const Eigen::MatrixXd>& transition);
/// Throws std::invalid_argument naming the element unless `probabilities` are such and sum to one.
void check_mode_probabilities(const Eigen::Ref<const Eigen::VectorXd>& probabilities);

/// The one input that processes are driven with, NoInput when none is.
template <class... Processes>
struct CommonInput {
  using Type = NoInput;
};
template <class First, class... Rest>
struct CommonInput<First, Rest...> {
  using Type = std::conditional_t<kDriven<First>, InputOf<First>, typename CommonInput<Rest...>::Type>;
};

}  // namespace detail

/// Interacting multiple model estimator: an extended Kalman filter per process model, among which a Markov chain
/// switches (Blom and Bar-Shalom 1988; doc/multiple_model.md).
///
/// Each prediction first mixes the modes' estimates by the chain, then moves each by its own process; each update
/// weighs the modes by the likelihood of their innovation. Estimates are mixed in the tangent space about their mean,
/// so headings wrap and quaternions stay unit. The chain makes one step per prediction: `transition` belongs to the
/// time between two predictions. All processes move the same `State`; those that are driven take the same input.
///
/// Reports describe the mixture as predicted: mean and covariance of the innovation over all modes, which is what the
/// gate sees. An observation or step that any mode refuses is refused; any status but `kAccepted` left everything as it
/// was. No heap in `predict` and `update`.
template <FixedStateType StateType, class... Processes>
requires(sizeof...(Processes) >= 1 && (ProcessModelFor<Processes, StateType> && ...)) class InteractingMultipleModel {
 public:
  using State = StateType;
  static constexpr int kDim = State::kDim;
  static constexpr int kModes = static_cast<int>(sizeof...(Processes));
  using Tangent = Eigen::Matrix<double, kDim, 1>;
  using Square = Eigen::Matrix<double, kDim, kDim>;
  using Filter = ExtendedKalmanFilter<State>;
  using Modes = std::array<Filter, sizeof...(Processes)>;
  using Transitions = Eigen::Matrix<double, kModes, kModes>;
  using Probabilities = Eigen::Matrix<double, kModes, 1>;
  using Input = typename detail::CommonInput<Processes...>::Type;
  static_assert(((!detail::kDriven<Processes> || std::same_as<InputOf<Processes>, Input>)&&...),
                "driven processes take the same input");

  /// All modes start at `x0`, `P0`. `transition(i, j)`: probability that mode i is followed by mode j, rows sum to one.
  /// `probabilities`: of the modes at the start. std::invalid_argument names what is none of that.
  InteractingMultipleModel(const State& x0, const Square& P0, const Transitions& transition,
                           const Probabilities& probabilities, const Processes&... processes)
      : processes_(processes...),
        transition_(transition),
        modes_{(static_cast<void>(processes), Filter(x0, P0))...},
        probabilities_(probabilities),
        state_(modes_[0].state()),
        P_(P0) {
    detail::check_mode_transition(transition);
    detail::check_mode_probabilities(probabilities);
  }

  /// Mean of the mixture, in the tangent about itself.
  [[nodiscard]] const State& state() const noexcept { return state_; }
  /// Covariance of the mixture, in the tangent at `state()`: the modes' own and their spread.
  [[nodiscard]] const Square& covariance() const noexcept { return P_; }
  /// Probability of each mode, in the order of the processes; they sum to one.
  [[nodiscard]] const Probabilities& probabilities() const noexcept { return probabilities_; }
  /// The filters of the modes.
  [[nodiscard]] const Modes& modes() const noexcept { return modes_; }
  /// Logarithm of the density of the last accepted observation under the mixture; NaN before the first.
  [[nodiscard]] double log_likelihood() const noexcept { return log_likelihood_; }

  /// The chain's step in predictions from now on, where the time between them varies: rows of probabilities that sum to
  /// one, as the constructor checks.
  void set_transition(const Transitions& transition) noexcept { transition_ = transition; }

  /// Puts back modes and probabilities that this estimator (or another of its type) had.
  void restore(const Modes& modes, const Probabilities& probabilities) noexcept {
    modes_ = modes;
    probabilities_ = probabilities;
    combine();
  }

  /// Mixes, then moves each mode by `dt_s` > 0 [s]. Refused as by ExtendedKalmanFilter::predict.
  UpdateStatus predict(const Input& input, double dt_s) {
    const Probabilities next = transition_.transpose() * probabilities_;
    Modes moved = modes_;
    for (int j = 0; j < kModes; ++j) {
      // Weights of where mode j came from; of a mode nothing leads to, what it was.
      Probabilities weights = transition_.col(j).cwiseProduct(probabilities_);
      if (next[j] > 0.0) {
        weights /= next[j];
      } else {
        weights = Probabilities::Unit(j);
      }
      Square P;
      const State mean = mix(weights, P);
      moved[at(j)].restore(mean, P);
    }
    UpdateStatus status = UpdateStatus::kAccepted;
    [&]<std::size_t... J>(std::index_sequence<J...>) {
      ((status =
            status == UpdateStatus::kAccepted ? move_mode(moved[J], std::get<J>(processes_), input, dt_s) : status),
       ...);
    }
    (std::index_sequence_for<Processes...>{});
    if (status != UpdateStatus::kAccepted) return status;
    modes_ = moved;
    probabilities_ = next / next.sum();
    combine();
    return status;
  }
  UpdateStatus predict(double dt_s) requires std::same_as<Input, detail::NoInput> {
    return predict(detail::NoInput{}, dt_s);
  }

  /// Takes `z = h(x) + noise` of covariance `R` in. Refused as by ExtendedKalmanFilter::update, by any of the modes;
  /// kGated by the innovation of the mixture.
  template <MeasurementModelFor<State> Model>
  UpdateReport<Model::kDim> update(const Model& model, const Eigen::Matrix<double, Model::kDim, 1>& z,
                                   const Eigen::Matrix<double, Model::kDim, Model::kDim>& R, const Gate& gate = {}) {
    return weigh<UpdateReport<Model::kDim>>(
        [&](Filter& mode) { return mode.update(model, z, R); },
        [&](int row, double a, double b) { return detail::residual(model, row, a, b); }, gate);
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

  /// Takes observations with a common covariance in at once, at most `MaxRows` rows. Refused as by
  /// ExtendedKalmanFilter::update of a group, by any of the modes; kGated by the innovation of the mixture.
  template <int MaxRows = 16, class Model>
  UpdateReport<Eigen::Dynamic, MaxRows> update(const Correlated<Model>& group, const Gate& gate = {}) {
    return weigh<UpdateReport<Eigen::Dynamic, MaxRows>>(
        [&](Filter& mode) { return mode.template update<MaxRows>(group); },
        [&](int row, double a, double b) {
          return detail::residual(group.models[at(row / Model::kDim)], row % Model::kDim, a, b);
        },
        gate);
  }

  /// Least variances of every mode, as ExtendedKalmanFilter::set_covariance_floor; each mode counts its own.
  void set_covariance_floor(const Tangent& variance) {
    for (Filter& mode : modes_) mode.set_covariance_floor(variance);
  }

 private:
  [[nodiscard]] static constexpr std::size_t at(int mode) noexcept { return static_cast<std::size_t>(mode); }

  // Updates each mode by `update_mode` and weighs it by the likelihood of its innovation; `residual(row, a, b)` is a -
  // b of a row of z.
  template <class Report, class UpdateMode, class Residual>
  Report weigh(const UpdateMode& update_mode, const Residual& residual, const Gate& gate) {
    using Vector = typename Report::Vector;
    Modes updated = modes_;
    std::array<Report, sizeof...(Processes)> reports;
    for (int j = 0; j < kModes; ++j) {
      reports[at(j)] = update_mode(updated[at(j)]);
      if (!reports[at(j)].accepted()) return reports[at(j)];
    }
    // Innovations are averaged about that of the most probable mode, rows the short way round.
    int likely = 0;
    probabilities_.maxCoeff(&likely);
    Report report = reports[at(likely)];
    const auto rows = static_cast<int>(report.innovation.size());
    std::array<Vector, sizeof...(Processes)> apart;
    Vector mean = Vector::Zero(rows);
    for (int j = 0; j < kModes; ++j) {
      apart[at(j)] = Vector::Zero(rows);
      for (int i = 0; i < rows; ++i) {
        apart[at(j)][i] = residual(i, static_cast<double>(reports[at(j)].innovation[i]),
                                   static_cast<double>(reports[at(likely)].innovation[i]));
      }
      mean += probabilities_[j] * apart[at(j)];
    }
    report.innovation += mean;
    report.covariance.setZero();
    for (int j = 0; j < kModes; ++j) {
      const Vector difference = apart[at(j)] - mean;
      report.covariance += probabilities_[j] * (reports[at(j)].covariance + difference * difference.transpose());
    }
    using Row = detail::BoundedMatrix<1, Vector::RowsAtCompileTime, 1, Vector::MaxRowsAtCompileTime>;
    const Row nothing = Row::Zero(1, rows);
    Row gain = nothing;
    if (!detail::innovate(report, nothing, gate, gain)) return report;

    Probabilities logs;
    for (int j = 0; j < kModes; ++j) {
      logs[j] = probabilities_[j] > 0.0 ? std::log(probabilities_[j]) + reports[at(j)].log_likelihood()
                                        : -std::numeric_limits<double>::infinity();
    }
    const double top = logs.maxCoeff();
    if (!std::isfinite(top)) {
      report.status = UpdateStatus::kNonFinite;
      return report;
    }
    const Probabilities weights = (logs.array() - top).exp();
    modes_ = updated;
    probabilities_ = weights / weights.sum();
    log_likelihood_ = top + std::log(weights.sum());
    combine();
    report.status = UpdateStatus::kAccepted;
    return report;
  }

  template <class Process>
  static UpdateStatus move_mode(Filter& mode, const Process& process, const Input& input, double dt_s) {
    if constexpr (detail::kDriven<Process>) {
      return mode.predict(process, input, dt_s);
    } else {
      return mode.predict(process, dt_s);
    }
  }

  // Mean and covariance of the modes' estimates under `weights`. The mean is where the tangents to them average to
  // zero; on vectors the first step reaches it. Covariances of the tangents at the modes and at the mean are taken for
  // the same, as the extended filter does.
  [[nodiscard]] State mix(const Probabilities& weights, Square& P) const noexcept {
    constexpr int kSteps = 5;
    int heaviest = 0;
    weights.maxCoeff(&heaviest);
    State mean = modes_[at(heaviest)].state();
    for (int k = 0; k < kSteps; ++k) {
      Tangent move = Tangent::Zero();
      for (int i = 0; i < kModes; ++i) {
        if (i != heaviest || k > 0) move += weights[i] * mean.local(modes_[at(i)].state());
      }
      if (move.isZero(0.0)) break;
      mean = mean.retract(move);
    }
    P.setZero();
    for (int i = 0; i < kModes; ++i) {
      const Tangent apart = mean.local(modes_[at(i)].state());
      P += weights[i] * (modes_[at(i)].covariance() + apart * apart.transpose());
    }
    return mean;
  }
  void combine() noexcept { state_ = mix(probabilities_, P_); }

  std::tuple<Processes...> processes_;
  Transitions transition_;
  Modes modes_;
  Probabilities probabilities_;
  State state_;
  Square P_;
  double log_likelihood_ = std::numeric_limits<double>::quiet_NaN();
};

}  // namespace soopnav
