#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <string_view>

#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/state_layout.hpp"

namespace soopnav {

namespace detail {

// Parts of a layout state that a model touched, packed one behind the other.
template <int MaxColumns>
class TouchedParts {
 public:
  // Where the part at `offset` lies among the touched ones; MaxColumns - dim when there is no room (`overflow`).
  [[nodiscard]] int column(int offset, int dim) noexcept {
    for (int k = 0; k < parts_; ++k) {
      const Part& part = part_[static_cast<std::size_t>(k)];
      if (part.offset == offset && part.dim == dim) return part.column;
    }
    if (columns_ + dim > MaxColumns) {
      overflow_ = true;
      return MaxColumns - dim;
    }
    part_[static_cast<std::size_t>(parts_++)] = {offset, dim, columns_};
    for (int i = 0; i < dim; ++i) component_[static_cast<std::size_t>(columns_ + i)] = offset + i;
    columns_ += dim;
    return columns_ - dim;
  }
  [[nodiscard]] int size() const noexcept { return columns_; }
  [[nodiscard]] bool overflow() const noexcept { return overflow_; }
  /// Component of the state behind packed column `c`.
  [[nodiscard]] int component(int c) const noexcept { return component_[static_cast<std::size_t>(c)]; }

 private:
  struct Part {
    int offset, dim, column;
  };
  std::array<Part, static_cast<std::size_t>(MaxColumns)> part_;
  std::array<int, static_cast<std::size_t>(MaxColumns)> component_;
  int parts_ = 0;
  int columns_ = 0;
  bool overflow_ = false;
};

// Columns one model may touch.
inline constexpr int kMaxTouched = 32;

template <class State, int Dim, class Tag>
[[nodiscard]] int part_offset(const State&, Role<Dim, Tag> role) noexcept {
  return State::at(role);
}
// A stale handle was seen by `state(block)` already, or is seen here; any place inside will do, nothing is kept.
template <class State, int Dim>
[[nodiscard]] int part_offset(const State& state, const Block<Dim>& block) noexcept {
  static_cast<void>(state(block));
  return state.layout().holds(block) ? state.layout().offset(block) : 0;
}

}  // namespace detail

/// What a measurement model writes at a `LayoutState`: values, and the Jacobian's columns it touches. No heap.
template <int M, class State>
struct LayoutPrediction {
  static constexpr bool kJacobian = true;
  const State& state;
  Eigen::Matrix<double, M, 1> z = Eigen::Matrix<double, M, 1>::Zero();
  Eigen::Matrix<double, M, detail::kMaxTouched> H = Eigen::Matrix<double, M, detail::kMaxTouched>::Zero();
  detail::TouchedParts<detail::kMaxTouched> touched;

  explicit LayoutPrediction(const State& x) noexcept : state(x) {}
  [[nodiscard]] double& value(int i) noexcept { return z[i]; }
  template <class Part>
  requires(RoleType<Part> || kIsBlock<Part>) [[nodiscard]] auto jacobian(const Part& part) noexcept {
    return H.template middleCols<Part::kDim>(touched.column(detail::part_offset(state, part), Part::kDim));
  }
  template <int Dim>
  [[nodiscard]] DiscardedJacobian jacobian(const Known<Dim>&) noexcept {
    return {};
  }
};

/// What a process model writes at a `LayoutState`: the next value, transition and noise of the parts it touches. A part
/// whose `next` was never asked for stays. No heap.
template <int Noise, class State>
struct LayoutTransition {
  static constexpr bool kJacobian = true;
  static constexpr int kMax = detail::kMaxTouched;
  const State& state;
  Eigen::Matrix<double, kMax, 1> values;
  Eigen::Matrix<double, kMax, kMax> F = Eigen::Matrix<double, kMax, kMax>::Identity();
  Eigen::Matrix<double, kMax, Noise> G = Eigen::Matrix<double, kMax, Noise>::Zero();
  detail::TouchedParts<kMax> touched;

  explicit LayoutTransition(const State& x) noexcept : state(x) {}
  template <class Part>
  [[nodiscard]] auto next(const Part& part) noexcept {
    return values.template segment<Part::kDim>(column(part));
  }
  template <class To, class From>
  [[nodiscard]] auto transition(const To& to, const From& from) noexcept {
    return F.template block<To::kDim, From::kDim>(column(to), column(from));
  }
  template <int First = 0, int Count = Noise, class Part>
  [[nodiscard]] auto noise(const Part& part) noexcept {
    return G.template block<Part::kDim, Count>(column(part), First);
  }
  template <int First = 0, int Count = Noise>
  void scale_noise(double factor) noexcept {
    G.template middleCols<Count>(First) *= factor;
  }

 private:
  template <class Part>
  [[nodiscard]] int column(const Part& part) noexcept {
    const int before = touched.size();
    const int c = touched.column(detail::part_offset(state, part), Part::kDim);
    if (touched.size() > before) {
      const auto now = state(part);
      for (int i = 0; i < Part::kDim; ++i) values[c + i] = now[i];
    }
    return c;
  }
};

/// A measurement model that can be asked at a `LayoutState` (its handles are checked when it is).
template <class Model, class State>
concept LayoutMeasurementFor = FrameCompatible<Model, State> &&
    requires(const Model& m, const State& x, LayoutPrediction<Model::kDim, State>& y) {
  { m.predict(x, y) } -> std::same_as<bool>;
};
/// A process model that can move parts of a `LayoutState`.
template <class Process, class State>
concept LayoutProcessFor = FrameCompatible<Process, State> &&
    requires(const Process& m, const State& x, const InputOf<Process>& u, LayoutTransition<Process::kNoise, State>& y) {
  { detail::propagate(m, x, u, 1.0, ZeroNoise{}, y) } -> std::same_as<bool>;
};

/// Extended Kalman filter on a state of fixed roles and named blocks that join and are marginalised away.
///
/// The same models, reports and rules as for fixed states. A model costs what it touches: an update of m rows over a
/// state of n components is O(n² m), a prediction that touches r components O(n r²), so 50 source clocks are predicted
/// one by one. Everything is allocated in the constructor. An update or prediction with a stale handle is refused.
template <class FrameTag, RoleType... Roles>
class ExtendedKalmanFilter<LayoutState<FrameTag, Roles...>> {
 public:
  using State = LayoutState<FrameTag, Roles...>;
  using Fixed = typename State::Fixed;
  static constexpr int kFixed = State::kFixed;
  static constexpr int kMaxRows = 16;  ///< of one measurement

  /// Room for `max_dim` components in all and `max_blocks` blocks; `P0` is the covariance of the fixed components.
  /// Throws std::invalid_argument for a state that is not finite, a `P0` that is no covariance, or too little room.
  ExtendedKalmanFilter(const Fixed& x0, const Eigen::Matrix<double, kFixed, kFixed>& P0, int max_dim, int max_blocks)
      : state_(x0, max_dim, max_blocks),
        P_(Eigen::MatrixXd::Zero(max_dim, max_dim)),
        scratch_(Eigen::MatrixXd::Zero(max_dim, 3 * detail::kMaxTouched)) {
    detail::check_state(x0.x, "x0");
    check_covariance(P0, "P0");
    for (int i = 0; i < kFixed; ++i) state_.set(i, x0.x[i]);
    P_.topLeftCorner<kFixed, kFixed>() = P0;
  }

  [[nodiscard]] const State& state() const noexcept { return state_; }
  [[nodiscard]] int dim() const noexcept { return state_.dim(); }
  /// Covariance of all components present.
  [[nodiscard]] auto covariance() const noexcept { return P_.topLeftCorner(dim(), dim()); }

  /// Lets a block join, independent of what is there: mean and covariance of its components. A handle that names
  /// nothing (`state().layout().holds` says so) when there is no room, a number is not finite, or `P` is not positive
  /// definite.
  template <int Dim>
  [[nodiscard]] Block<Dim> join(const Eigen::Matrix<double, Dim, 1>& mean, const Eigen::Matrix<double, Dim, Dim>& P,
                                std::string_view name, BlockKind kind = BlockKind::kVector) noexcept {
    if (!mean.allFinite() || detail::check_noise(P) != UpdateStatus::kAccepted) return {};
    const int first = dim();
    const Block<Dim> block = state_.template add<Dim>(mean, name, kind);
    if (!state_.layout().holds(block)) return block;
    P_.block(0, first, first, Dim).setZero();
    P_.block(first, 0, Dim, first).setZero();
    P_.template block<Dim, Dim>(first, first) = P;
    return block;
  }
  [[nodiscard]] Block<1> join(double mean, double variance, std::string_view name,
                              BlockKind kind = BlockKind::kVector) noexcept {
    return join<1>(Eigen::Matrix<double, 1, 1>(mean), Eigen::Matrix<double, 1, 1>(variance), name, kind);
  }

  /// Marginalises a block away: what it taught the others stays. False for a stale handle.
  template <int Dim>
  bool marginalise(const Block<Dim>& block) noexcept {
    if (!state_.layout().holds(block)) return false;
    const int first = state_.layout().offset(block);
    const int n = dim();
    for (int j = first; j + Dim < n; ++j) P_.col(j).head(n) = P_.col(j + Dim).head(n);
    for (int j = 0; j < n - Dim; ++j) {
      for (int i = first; i + Dim < n; ++i) P_(i, j) = P_(i + Dim, j);
    }
    return state_.remove(block);
  }

  /// Moves the parts that `process` touches by `dt_s` > 0 [s]; the others stay. Refused, nothing changed:
  /// kTimeNotAdvancing, kUndefined (by the model), kStaleHandle, kNonFinite, kTooManyRows (more than 32 components).
  template <LayoutProcessFor<State> Process>
  UpdateStatus predict(const Process& process, const InputOf<Process>& input, double dt_s) {
    if (!(dt_s > 0.0) || std::isinf(dt_s)) return UpdateStatus::kTimeNotAdvancing;
    static_cast<void>(state_.take_stale());
    LayoutTransition<Process::kNoise, State> y(state_);
    const bool defined = detail::propagate(process, state_, input, dt_s, ZeroNoise{}, y);
    if (state_.take_stale()) return UpdateStatus::kStaleHandle;
    if (!defined) return UpdateStatus::kUndefined;
    if (y.touched.overflow()) return UpdateStatus::kTooManyRows;
    const int r = y.touched.size();
    const int n = dim();
    // V = P(:, touched) Fᵀ, the new columns; then the square of the touched ones.
    auto old = scratch_.block(0, 0, n, r);
    auto V = scratch_.block(0, detail::kMaxTouched, n, r);
    for (int c = 0; c < r; ++c) old.col(c) = P_.col(y.touched.component(c)).head(n);
    const auto F = y.F.topLeftCorner(r, r);
    V = old.lazyProduct(F.transpose());
    Corner rows(r, r);
    for (int c = 0; c < r; ++c) rows.row(c) = V.row(y.touched.component(c));
    Corner corner(r, r);
    corner = F.lazyProduct(rows);
    const auto G = y.G.topRows(r);
    corner += G.lazyProduct(G.transpose());
    if (!y.values.head(r).allFinite() || !V.allFinite() || !corner.allFinite()) return UpdateStatus::kNonFinite;
    for (int c = 0; c < r; ++c) {
      const int g = y.touched.component(c);
      P_.col(g).head(n) = V.col(c);
      P_.row(g).head(n) = V.col(c).transpose();
    }
    for (int a = 0; a < r; ++a) {
      for (int b = 0; b <= a; ++b) {
        const int i = y.touched.component(a);
        const int j = y.touched.component(b);
        P_(i, j) = P_(j, i) = corner(a, b);
      }
      state_.set(y.touched.component(a), y.values[a]);
    }
    return UpdateStatus::kAccepted;
  }
  template <LayoutProcessFor<State> Process>
  requires(!detail::kDriven<Process>) UpdateStatus predict(const Process& process, double dt_s) {
    return predict(process, detail::NoInput{}, dt_s);
  }

  /// As for fixed states; kStaleHandle for a handle whose block has left, kTooManyRows for more than 32 components.
  template <LayoutMeasurementFor<State> Model>
  UpdateReport<Model::kDim> update(const Model& model, const Eigen::Matrix<double, Model::kDim, 1>& z,
                                   const Eigen::Matrix<double, Model::kDim, Model::kDim>& R, const Gate& gate = {}) {
    constexpr int kM = Model::kDim;
    static_assert(kM <= kMaxRows, "more rows than the filter has room for");
    UpdateReport<kM> report;
    if (!z.allFinite()) {
      report.status = UpdateStatus::kNonFinite;
      return report;
    }
    report.status = detail::check_noise(R);
    if (!report.accepted()) return report;
    static_cast<void>(state_.take_stale());
    LayoutPrediction<kM, State> y(state_);
    const bool defined = model.predict(state_, y);
    if (state_.take_stale()) {
      report.status = UpdateStatus::kStaleHandle;
    } else if (!defined) {
      report.status = UpdateStatus::kUndefined;
    } else if (y.touched.overflow()) {
      report.status = UpdateStatus::kTooManyRows;
    } else {
      for (int i = 0; i < kM; ++i) report.innovation[i] = detail::residual(model, i, z[i], y.z[i]);
      apply(y, R, gate, report);
    }
    return report;
  }
  template <LayoutMeasurementFor<State> Model>
  requires(Model::kDim == 1) UpdateReport<1> update(const Model& model, double z, double variance,
                                                    const Gate& gate = {}) {
    return update(model, Eigen::Matrix<double, 1, 1>(z), Eigen::Matrix<double, 1, 1>(variance), gate);
  }

 private:
  using Corner = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, detail::kMaxTouched, detail::kMaxTouched>;

  template <int M>
  void apply(const LayoutPrediction<M, State>& y, const Eigen::Matrix<double, M, M>& R, const Gate& gate,
             UpdateReport<M>& report) {
    using Columns = Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, M>, 0, Eigen::OuterStride<>>;
    const int n = dim();
    // Column behind column without gaps, as the triangular solves for the gain take them.
    const Eigen::OuterStride<> stride(n);
    Columns PH(scratch_.data(), n, M, stride);
    Columns K(scratch_.data() + n * M, n, M, stride);
    Columns B(scratch_.data() + 2 * n * M, n, M, stride);
    PH.setZero();
    for (int c = 0; c < y.touched.size(); ++c) {
      const auto column = P_.col(y.touched.component(c)).head(n);
      for (int m = 0; m < M; ++m) PH.col(m) += column * y.H(m, c);
    }
    report.covariance = R;
    for (int c = 0; c < y.touched.size(); ++c) {
      report.covariance.noalias() += y.H.col(c) * PH.row(y.touched.component(c));
    }
    if (!detail::innovate(report, PH, gate, K)) return;
    // Joseph's form as in detail::joseph_update, over the touched columns of P' only.
    B = PH;
    for (int c = 0; c < y.touched.size(); ++c) {
      const int g = y.touched.component(c);
      for (int m = 0; m < M; ++m) {
        for (int k = 0; k < M; ++k) B.col(m) -= K.col(k) * (PH(g, k) * y.H(m, c));
      }
    }
    for (int m = 0; m < M; ++m) {
      for (int k = 0; k < M; ++k) B.col(m) -= K.col(k) * R(k, m);
    }
    B = 0.5 * (B + PH);
    bool sound = true;
    for (int i = 0; i < n; ++i) {
      double variance = P_(i, i);
      double step = 0.0;
      for (int m = 0; m < M; ++m) {
        variance -= 2.0 * K(i, m) * B(i, m);
        step += K(i, m) * report.innovation[m];
      }
      sound = sound && variance >= 0.0 && std::isfinite(variance) && std::isfinite(step);
    }
    if (!sound) {
      report.status = UpdateStatus::kNotPositiveDefinite;
      return;
    }
    for (int j = 0; j < n; ++j) {
      auto column = P_.col(j).head(n);
      for (int m = 0; m < M; ++m) column -= K.col(m) * B(j, m) + B.col(m) * K(j, m);
    }
    for (int i = 0; i < n; ++i) {
      double step = 0.0;
      for (int m = 0; m < M; ++m) step += K(i, m) * report.innovation[m];
      state_.set(i, state_.x()[i] + step);
    }
    report.status = UpdateStatus::kAccepted;
  }

  State state_;
  Eigen::MatrixXd P_;        // max_dim x max_dim; the corner of the components present is used
  Eigen::MatrixXd scratch_;  // max_dim x 3 kMaxTouched
};

}  // namespace soopnav
