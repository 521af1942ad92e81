#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <limits>
#include <ranges>
#include <span>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <utility>

#include "soopnav/estimation/detail/small_matrix.hpp"
#include "soopnav/estimation/dop.hpp"
#include "soopnav/estimation/observed.hpp"
#include "soopnav/estimation/prediction.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav {

/// How a least-squares solution ended.
enum class SolveStatus {
  kConverged,            ///< the state is the weighted least-squares solution
  kAmbiguous,            ///< so it is, and another state far from it fits as well (several starts only)
  kTooFewMeasurements,   ///< fewer rows than components of the state; the start is returned
  kTooManyMeasurements,  ///< more rows than the capacity; the start is returned
  kRankDeficient,        ///< the measurements leave directions of the state free: see `unobservable`
  kNotConverged,         ///< iterations exhausted; the state is the best one seen
  kUndefined,            ///< a model has no value or Jacobian at the start (a receiver on top of its source)
  kNonFinite,            ///< a measurement, a prediction or the start is NaN or infinite; the start is returned
  kNotPositiveDefinite,  ///< a measurement covariance is not positive definite; the start is returned
};

/// The name of a status in words, for a sentence.
[[nodiscard]] std::string_view to_string(SolveStatus status) noexcept;

/// When the iteration ends, and what counts as unobservable.
struct LeastSquaresOptions {
  int max_iterations = 50;  ///< linearisations, at least 1
  double step_tolerance =
      1e-6;  ///< converged when the next step is shorter, in standard deviations of the estimate, > 0
  double rank_tolerance = 1e-7;  ///< singular values of the column-scaled, whitened Jacobian below this fraction of the
                                 ///< largest count as zero, in (0, 1)
  double distinct_sigmas = 1.0;  ///< `solve_from`: solutions nearer to each other, in standard deviations, are one, > 0

  /// Throws std::invalid_argument naming the option that breaks its rule.
  void check() const;
};

namespace detail {

template <class T>
inline constexpr bool kIsObserved = false;
template <class M>
inline constexpr bool kIsObserved<Observed<M>> = true;
template <class T>
inline constexpr bool kIsCorrelated = false;
template <class M>
inline constexpr bool kIsCorrelated<Correlated<M>> = true;

template <class G>
concept ObservedRange = std::ranges::contiguous_range<const G> && std::ranges::sized_range<const G> &&
    kIsObserved<std::ranges::range_value_t<const G>>;

template <class G>
struct GroupModel {};
template <class G>
requires kIsObserved<G> || kIsCorrelated<G>
struct GroupModel<G> {
  using Model = typename G::Model;
};
template <ObservedRange G>
struct GroupModel<G> {
  using Model = typename std::ranges::range_value_t<const G>::Model;
};

}  // namespace detail

/// What `solve` takes for measurements at `State`: an `Observed`, a range of `Observed`, or a `Correlated`.
template <class G, class State>
concept MeasurementGroupFor = MeasurementModelFor<typename detail::GroupModel<G>::Model, State>;

/// A least-squares solution. Holds its arrays itself: no heap.
template <FixedStateType StateType, int MaxRows>
struct LeastSquaresResult {
  using State = StateType;
  static constexpr int kDim = State::kDim;
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, MaxRows, 1>;
  using Covariance = Eigen::Matrix<double, kDim, kDim>;

  SolveStatus status = SolveStatus::kTooFewMeasurements;
  State state{};
  /// Of the tangent components, from the stated measurement covariances; NaN unless the rank is full.
  Covariance covariance = Covariance::Constant(std::numeric_limits<double>::quiet_NaN());
  Rows residuals;  ///< z - model(state), in the units of z and in the order of the arguments
  /// Baarda's w: standard normal for each row when all is well; 0 for a row that no other row controls.
  Rows normalized_residuals;
  /// How much of an error of each row shows in its residual, 0 ... 1 (their sum is `degrees_of_freedom`).
  Rows redundancy;
  double chi_square = std::numeric_limits<double>::quiet_NaN();  ///< sum of the squared whitened residuals
  int degrees_of_freedom = 0;                                    ///< of `chi_square`: rows minus rank
  int rank = 0;                                                  ///< directions of the state the measurements determine
  /// Orthonormal columns: the directions they do not; `name_directions<State>` puts them in words.
  Eigen::Matrix<double, kDim, Eigen::Dynamic, 0, kDim, kDim> unobservable;
  Dop dop;             ///< from the geometry alone, all measurements equally good
  int iterations = 0;  ///< linearisations
};

namespace detail {

template <class State, int MaxRows>
struct Stack {
  static constexpr int kDim = State::kDim;
  // Rows beyond those read are left as they are.
  Eigen::Matrix<double, MaxRows, kDim, kDim == 1 ? Eigen::ColMajor : Eigen::RowMajor> H;
  Eigen::Matrix<double, MaxRows, 1> r;
  bool defined = true;
};

// Writes z - h(x) and H of one model; false when undefined.
template <class State, int MaxRows, class Model, class Z>
bool write_rows(const Model& model, const Z& z, const State& x, int row, Stack<State, MaxRows>& stack) {
  Prediction<Model::kDim, State> y;
  const bool defined = model.predict(x, y);
  for (int i = 0; i < Model::kDim; ++i) {
    stack.r[row + i] = residual(model, i, static_cast<double>(z[i]), y.z[i]);
    for (int j = 0; j < State::kDim; ++j) stack.H.coeffRef(row + i, j) = y.H.coeff(i, j);
  }
  return defined;
}

// Reads independent measurements into the stack, and whitens their rows.
template <class State, int MaxRows, class Item>
class ObservedReader {
  static constexpr int kM = Item::kDim;

 public:
  explicit ObservedReader(std::span<const Item> group) : group_(group) {}
  [[nodiscard]] std::size_t rows() const { return group_.size() * kM; }

  [[nodiscard]] SolveStatus prepare() {
    std::size_t i = 0;
    for (const Item& item : group_) {
      if (!all_finite(item.z) || !all_finite(item.R)) return SolveStatus::kNonFinite;
      if constexpr (kM == 1) {
        if (!(item.R(0, 0) > 0.0)) return SolveStatus::kNotPositiveDefinite;
        factor_[i](0, 0) = std::sqrt(item.R(0, 0));
      } else {
        factor_[i] = item.R;
        if (!cholesky_in_place(factor_[i].data(), kM)) return SolveStatus::kNotPositiveDefinite;
      }
      ++i;
    }
    return SolveStatus::kConverged;
  }

  void read(const State& x, int first, Stack<State, MaxRows>& stack) const {
    for (const Item& item : group_) {
      stack.defined = write_rows(item.model, item.z, x, first, stack) && stack.defined;
      first += kM;
    }
  }

  void whiten(int first, Stack<State, MaxRows>& stack) const {
    for (std::size_t i = 0; i < group_.size(); ++i) {
      if constexpr (kM == 1) {
        const double weight = 1.0 / factor_[i](0, 0);
        stack.r[first] *= weight;
        stack.H.row(first) *= weight;
      } else {
        const auto& L = factor_[i];
        for (int k = 0; k < kM; ++k) {
          const double weight = 1.0 / L.coeff(k, k);
          for (int m = 0; m < k; ++m) {
            stack.r.coeffRef(first + k) -= L.coeff(k, m) * stack.r.coeff(first + m);
            for (int j = 0; j < State::kDim; ++j) {
              stack.H.coeffRef(first + k, j) -= L.coeff(k, m) * stack.H.coeff(first + m, j);
            }
          }
          stack.r.coeffRef(first + k) *= weight;
          for (int j = 0; j < State::kDim; ++j) stack.H.coeffRef(first + k, j) *= weight;
        }
      }
      first += kM;
    }
  }

  // Column `row` of the inverse Cholesky factor of the group's covariance, into c (zero on entry) from `first` on.
  template <class Column>
  void inverse_factor_column(int row, int first, Column& c) const {
    const int block = row / kM;
    Eigen::Matrix<double, kM, 1> e = Eigen::Matrix<double, kM, 1>::Unit(row % kM);
    solve_lower(factor_[static_cast<std::size_t>(block)].data(), kM, e.data());
    for (int i = 0; i < kM; ++i) c[static_cast<std::size_t>(first + block * kM + i)] = e[i];
  }

 private:
  std::span<const Item> group_;
  std::array<Eigen::Matrix<double, kM, kM>, static_cast<std::size_t>(MaxRows / kM)> factor_;
};

// The same for measurements with a common covariance.
template <class State, int MaxRows, class Model>
class CorrelatedReader {
  static constexpr int kM = Model::kDim;

 public:
  explicit CorrelatedReader(const Correlated<Model>& group) : group_(group) {}
  [[nodiscard]] std::size_t rows() const { return group_.models.size() * kM; }

  [[nodiscard]] SolveStatus prepare() {
    const auto n = static_cast<Eigen::Index>(rows());
    if (group_.z.size() != n || group_.R.rows() != n || group_.R.cols() != n) return SolveStatus::kNotPositiveDefinite;
    if (!group_.z.allFinite() || !group_.R.allFinite()) return SolveStatus::kNonFinite;
    // Cholesky by rows; the sizes are small and the storage fixed.
    for (Eigen::Index i = 0; i < n; ++i) {
      for (Eigen::Index j = 0; j <= i; ++j) {
        double s = group_.R(i, j);
        for (Eigen::Index k = 0; k < j; ++k) s -= factor_.coeff(i, k) * factor_.coeff(j, k);
        if (i == j) {
          if (!(s > 0.0)) return SolveStatus::kNotPositiveDefinite;
          factor_(i, i) = std::sqrt(s);
        } else {
          factor_(i, j) = s / factor_(j, j);
        }
      }
    }
    return SolveStatus::kConverged;
  }

  void read(const State& x, int first, Stack<State, MaxRows>& stack) const {
    Eigen::Index i = 0;
    for (const Model& model : group_.models) {
      stack.defined = write_rows(model, group_.z.template segment<kM>(i), x, first, stack) && stack.defined;
      first += kM;
      i += kM;
    }
  }

  void whiten(int first, Stack<State, MaxRows>& stack) const {
    const int n = static_cast<int>(rows());
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < i; ++j) {
        stack.r[first + i] -= factor_(i, j) * stack.r[first + j];
        for (int k = 0; k < State::kDim; ++k) {
          stack.H.coeffRef(first + i, k) -= factor_.coeff(i, j) * stack.H.coeff(first + j, k);
        }
      }
      stack.r[first + i] /= factor_(i, i);
      for (int k = 0; k < State::kDim; ++k) stack.H.coeffRef(first + i, k) /= factor_.coeff(i, i);
    }
  }

  template <class Column>
  void inverse_factor_column(int row, int first, Column& c) const {
    const int n = static_cast<int>(rows());
    for (int i = row; i < n; ++i) {
      double s = i == row ? 1.0 : 0.0;
      for (int j = row; j < i; ++j) s -= factor_(i, j) * c[static_cast<std::size_t>(first + j)];
      c[static_cast<std::size_t>(first + i)] = s / factor_(i, i);
    }
  }

 private:
  const Correlated<Model>& group_;
  Eigen::Matrix<double, MaxRows, MaxRows> factor_;
};

template <class State, int MaxRows, class G>
[[nodiscard]] auto make_reader(const G& group) {
  if constexpr (kIsCorrelated<G>) {
    return CorrelatedReader<State, MaxRows, typename G::Model>(group);
  } else if constexpr (kIsObserved<G>) {
    return ObservedReader<State, MaxRows, G>(std::span<const G>(&group, 1));
  } else {
    return ObservedReader<State, MaxRows, std::ranges::range_value_t<const G>>(group);
  }
}

// A stack of all groups, whitened, with its normal equations.
template <class State, int MaxRows, class... Groups>
class NormalEquations {
 public:
  static constexpr int kDim = State::kDim;
  using Vector = Eigen::Matrix<double, kDim, 1>;
  using Square = Eigen::Matrix<double, kDim, kDim>;

  explicit NormalEquations(const Groups&... groups) : readers_(make_reader<State, MaxRows>(groups)...) {}

  [[nodiscard]] SolveStatus prepare() {
    std::size_t total = 0;
    std::apply([&](const auto&... reader) { ((total += reader.rows()), ...); }, readers_);
    if (total > static_cast<std::size_t>(MaxRows)) return SolveStatus::kTooManyMeasurements;
    rows_ = static_cast<int>(total);
    SolveStatus status = SolveStatus::kConverged;
    const auto one = [&](auto& reader) {
      if (status == SolveStatus::kConverged) status = reader.prepare();
    };
    std::apply([&](auto&... reader) { (one(reader), ...); }, readers_);
    return status;
  }

  [[nodiscard]] int rows() const { return rows_; }

  void read(const State& x, Stack<State, MaxRows>& stack) const {
    stack.defined = true;
    int first = 0;
    const auto one = [&](const auto& reader) {
      reader.read(x, first, stack);
      first += static_cast<int>(reader.rows());
    };
    std::apply([&](const auto&... reader) { (one(reader), ...); }, readers_);
  }

  void whiten(Stack<State, MaxRows>& stack) const {
    int first = 0;
    const auto one = [&](const auto& reader) {
      reader.whiten(first, stack);
      first += static_cast<int>(reader.rows());
    };
    std::apply([&](const auto&... reader) { (one(reader), ...); }, readers_);
  }

  // A = HᵀH, g = Hᵀr, cost = rᵀr of the whitened stack.
  void accumulate(const Stack<State, MaxRows>& stack, Square& A, Vector& g, double& cost) const {
    A.setZero();
    g.setZero();
    cost = 0.0;
    for (int i = 0; i < rows_; ++i) {
      for (int j = 0; j < kDim; ++j) {
        const double h = stack.H.coeff(i, j);
        for (int k = 0; k < kDim; ++k) A.coeffRef(k, j) += stack.H.coeff(i, k) * h;
        g.coeffRef(j) += h * stack.r[i];
      }
      cost += stack.r[i] * stack.r[i];
    }
  }

  template <class Column>
  void inverse_factor_column(int row, Column& c) const {
    int first = 0;
    const auto one = [&](const auto& reader) {
      const int n = static_cast<int>(reader.rows());
      if (row >= first && row < first + n) reader.inverse_factor_column(row - first, first, c);
      first += n;
    };
    std::apply([&](const auto&... reader) { (one(reader), ...); }, readers_);
  }

 private:
  std::tuple<decltype(make_reader<State, MaxRows>(std::declval<const Groups&>()))...> readers_;
  int rows_ = 0;
};

template <class State, int MaxRows>
[[nodiscard]] Eigen::Matrix<double, State::kDim, State::kDim> triangular_root(const Stack<State, MaxRows>& stack,
                                                                              int rows) {
  constexpr int kDim = State::kDim;
  // Householder's reflections, column by column: R of J = QR, which keeps the digits that JᵀJ would lose. Plain loops
  // over fixed storage; rows of zeros make up for missing measurements.
  constexpr int kMaxPadded = MaxRows > kDim ? MaxRows : kDim;
  const int count = std::max(rows, kDim);
  Eigen::Matrix<double, kMaxPadded, kDim> J;
  for (int i = 0; i < count; ++i) {
    for (int j = 0; j < kDim; ++j) J(i, j) = i < rows ? stack.H(i, j) : 0.0;
  }
  std::array<double, static_cast<std::size_t>(kMaxPadded)> v{};
  const auto at = [&v](int i) -> double& { return v[static_cast<std::size_t>(i)]; };
  for (int k = 0; k < kDim; ++k) {
    double squares = 0.0;
    for (int i = k; i < count; ++i) squares += J(i, k) * J(i, k);
    if (!(squares > 0.0)) continue;
    const double alpha = J(k, k) > 0.0 ? -std::sqrt(squares) : std::sqrt(squares);
    double length = 0.0;
    for (int i = k; i < count; ++i) {
      at(i) = i == k ? J(i, k) - alpha : J(i, k);
      length += at(i) * at(i);
    }
    for (int j = k; j < kDim; ++j) {
      double projection = 0.0;
      for (int i = k; i < count; ++i) projection += at(i) * J(i, j);
      projection *= 2.0 / length;
      for (int i = k; i < count; ++i) J(i, j) -= projection * at(i);
    }
  }
  Eigen::Matrix<double, kDim, kDim> root;
  for (int j = 0; j < kDim; ++j) {
    for (int i = 0; i < kDim; ++i) root(i, j) = i <= j ? J(i, j) : 0.0;
  }
  return root;
}

// The inverse of an n x n information matrix that is plainly well-conditioned: scaled to a unit diagonal it has no
// small pivot. False, `covariance` spent, when it is not.
[[nodiscard]] bool invert_well_conditioned(const double* information, int n, double* covariance) noexcept;
// The rank, the covariance (NaN below full rank) and the null directions of the information rootᵀ root, n x n. The
// columns of `unobservable` beyond n - rank are not set.
[[nodiscard]] int condition_root(const double* root, int n, double tolerance, double* covariance,
                                 double* unobservable) noexcept;

// Singular values of a whitened, column-scaled Jacobian: rank, covariance, null directions. Eq. 7 and 8 of
// doc/position_fix.md.
template <int N>
struct Conditioning {
  using Square = Eigen::Matrix<double, N, N>;
  int rank = 0;
  Square covariance = Square::Constant(std::numeric_limits<double>::quiet_NaN());
  Eigen::Matrix<double, N, Eigen::Dynamic, 0, N, N> unobservable;

  // Of the rows of `stack`, whose normal matrix is `information`.
  template <class State, int MaxRows>
  void compute(const Stack<State, MaxRows>& stack, int rows, const Square& information, double tolerance) {
    // Well-conditioned, as nearly always.
    if (rows >= N && tolerance < 1e-5 && invert_well_conditioned(information.data(), N, covariance.data())) {
      rank = N;
      unobservable.resize(N, 0);
      return;
    }
    from_root(triangular_root(stack, rows), tolerance);
  }

  // `r`: any N x N square root of the information matrix, information = rᵀr.
  void from_root(const Square& r, double tolerance) {
    Square directions;
    rank = condition_root(r.data(), N, tolerance, covariance.data(), directions.data());
    unobservable = directions.leftCols(N - rank);
  }
};

}  // namespace detail

/// Weighted nonlinear least squares from one start: minimises the sum of (z - h(x))ᵀ R⁻¹ (z - h(x)).
///
/// Levenberg and Marquardt's method: Gauss-Newton steps while they reduce the sum, damped along the diagonal when they
/// do not (doc/position_fix.md eq. 3 to 6; Nocedal and Wright, Numerical Optimization, 10.3). It finds the minimum of
/// the start's valley: give a start on the right side of every symmetry, or use `solve_from`.
///
/// `groups`: see `MeasurementGroupFor`; rows keep the order of the arguments. `MaxRows` is the capacity.
/// Data never throws: see `SolveStatus`. Throws std::invalid_argument for `options` only. No allocation.
template <int MaxRows = 32, FixedStateType State, MeasurementGroupFor<State>... Groups>
[[nodiscard]] LeastSquaresResult<State, MaxRows> solve(const State& start, const LeastSquaresOptions& options,
                                                       const Groups&... groups) {
  static_assert(MaxRows >= 1);
  static_assert(sizeof...(Groups) >= 1, "solve needs measurements");
  constexpr int kDim = State::kDim;
  using Vector = Eigen::Matrix<double, kDim, 1>;
  using Square = Eigen::Matrix<double, kDim, kDim>;
  options.check();

  LeastSquaresResult<State, MaxRows> result;
  result.state = start;
  detail::NormalEquations<State, MaxRows, Groups...> equations(groups...);
  result.status = equations.prepare();
  if (result.status != SolveStatus::kConverged) return result;
  const int rows = equations.rows();

  struct Linearization {
    detail::Stack<State, MaxRows> stack;
    Square A;
    Vector g;
    double cost;
  };
  std::array<Linearization, 2> store;
  Linearization* here = &store[0];
  Linearization* next = &store[1];
  const auto linearize = [&](const State& x, Linearization& at) {
    equations.read(x, at.stack);
    equations.whiten(at.stack);
    equations.accumulate(at.stack, at.A, at.g, at.cost);
    ++result.iterations;
  };
  linearize(start, *here);
  if (!std::isfinite(here->cost)) {
    result.status = SolveStatus::kNonFinite;
    return result;
  }
  if (!here->stack.defined) {
    result.status = SolveStatus::kUndefined;
    return result;
  }
  if (!detail::all_finite(here->A)) {
    result.status = SolveStatus::kNonFinite;
    return result;
  }

  constexpr double kFirstDamping = 1e-4;
  constexpr double kLargestDamping = 1e12;
  double damping = 0.0;
  bool converged = false;
  const double enough = options.step_tolerance * options.step_tolerance;
  while (!converged && result.iterations < options.max_iterations && damping <= kLargestDamping && rows >= kDim) {
    double floor = 0.0;
    for (int i = 0; i < kDim; ++i) floor = std::max(floor, 1e-6 * here->A.coeff(i, i));
    Square damped = here->A;
    for (int i = 0; i < kDim; ++i) {
      damped.coeffRef(i, i) += damping * std::max(here->A.coeff(i, i), floor > 0.0 ? floor : 1.0);
    }
    const detail::CholeskyFactor<Square> factor(damped);
    double least = factor.definite ? factor.L.coeff(0, 0) : 0.0;
    double largest = least;
    for (int i = 1; i < kDim && factor.definite; ++i) {
      least = std::min(least, factor.L.coeff(i, i));
      largest = std::max(largest, factor.L.coeff(i, i));
    }
    // The pivots are the squares.
    if (!(least * least > 1e-13 * (largest * largest))) {
      damping = std::max(10.0 * damping, 1e-8);
      continue;
    }
    Vector step = here->g;
    detail::solve_lower(factor.L.data(), kDim, step.data());
    detail::solve_lower_transposed(factor.L.data(), kDim, step.data());
    const double decrement = step.dot(here->g);  // squared length of the step in standard deviations
    const State trial = result.state.retract(step);
    linearize(trial, *next);
    const double rounding = 16.0 * std::numeric_limits<double>::epsilon() * result.state.x.cwiseAbs().maxCoeff();
    const bool last = (damping <= 1e-3 && decrement <= enough) || step.cwiseAbs().maxCoeff() <= rounding;
    if (next->stack.defined && next->cost <= here->cost && detail::all_finite(next->A)) {
      result.state = trial;
      std::swap(here, next);
      damping = damping > 1e-7 ? 0.1 * damping : 0.0;
    } else {
      damping = std::max(10.0 * damping, kFirstDamping);
    }
    converged = last;
  }
  const detail::Stack<State, MaxRows>& stack = here->stack;

  result.chi_square = here->cost;
  detail::Conditioning<kDim> conditioning;
  conditioning.compute(stack, rows, here->A, options.rank_tolerance);
  result.rank = conditioning.rank;
  result.unobservable = conditioning.unobservable;
  result.degrees_of_freedom = rows - result.rank;
  if (rows < kDim) {
    result.status = SolveStatus::kTooFewMeasurements;
  } else if (!converged) {
    result.status = SolveStatus::kNotConverged;
  } else {
    result.status = result.rank < kDim ? SolveStatus::kRankDeficient : SolveStatus::kConverged;
  }
  result.covariance = conditioning.covariance;

  detail::Stack<State, MaxRows> plain;
  equations.read(result.state, plain);
  result.residuals.resize(rows);
  result.normalized_residuals.resize(rows);
  result.redundancy.resize(rows);
  for (int i = 0; i < rows; ++i) {
    result.residuals[i] = plain.r[i];
    result.normalized_residuals[i] = 0.0;
    result.redundancy[i] = 0.0;
  }
  if (result.rank == kDim) {
    for (int i = 0; i < rows; ++i) {
      // Eq. 9: row i of R⁻¹ residual, over its standard deviation. `c` is column i of the inverse Cholesky factor of R.
      std::array<double, static_cast<std::size_t>(MaxRows)> c{};
      equations.inverse_factor_column(i, c);
      Vector projected = Vector::Zero();
      double whole = 0.0;
      double value = 0.0;
      for (int j = 0; j < rows; ++j) {
        const double weight = c[static_cast<std::size_t>(j)];
        if (weight == 0.0) continue;
        for (int k = 0; k < kDim; ++k) projected.coeffRef(k) += weight * stack.H.coeff(j, k);
        whole += weight * weight;
        value += weight * stack.r[j];
      }
      const double variance = whole - detail::quadratic_form(result.covariance, projected);
      const Vector h = stack.H.row(i).transpose();
      result.redundancy[i] = std::clamp(1.0 - detail::quadratic_form(result.covariance, h), 0.0, 1.0);
      if (variance > 1e-9 * whole) result.normalized_residuals[i] = value / std::sqrt(variance);
    }
    detail::Conditioning<kDim> geometry;
    Square cofactor_inverse;
    Vector unused_gradient;
    double unused_sum = 0.0;
    equations.accumulate(plain, cofactor_inverse, unused_gradient, unused_sum);
    geometry.compute(plain, rows, cofactor_inverse, options.rank_tolerance);
    if (geometry.rank == kDim) result.dop = dilution_of_precision<State>(geometry.covariance);
  }
  return result;
}

/// The solution from several starts, and the states that explain the measurements as well.
template <FixedStateType StateType, int MaxRows>
struct MultiStartResult {
  static constexpr int kMaxAlternatives = 4;
  LeastSquaresResult<StateType, MaxRows> best;  ///< the smallest sum of squares; kAmbiguous when there are alternatives
  std::array<LeastSquaresResult<StateType, MaxRows>, kMaxAlternatives> alternatives;
  int alternative_count = 0;
};

/// Weighted least squares from several starts.
///
/// An alternative is another converged solution, more than `options.distinct_sigmas` and 1 mm away, whose sum of
/// squares is at most `ambiguity_gate` above the best one: a likelihood ratio, to be read against a chi-square quantile
/// of one degree of freedom. At most four are kept. A start that ends unconverged is passed over while another one ends
/// in a solution. Empty `starts` give kUndefined. No allocation.
template <int MaxRows = 32, FixedStateType State, MeasurementGroupFor<State>... Groups>
[[nodiscard]] MultiStartResult<State, MaxRows> solve_from(std::span<const State> starts,
                                                          const LeastSquaresOptions& options, double ambiguity_gate,
                                                          const Groups&... groups) {
  using Result = LeastSquaresResult<State, MaxRows>;
  MultiStartResult<State, MaxRows> out;
  out.best.status = SolveStatus::kUndefined;
  // Solutions first, by their sum of squares; of two equally good ones the determined one.
  const auto is_solution = [](const Result& r) {
    return r.status == SolveStatus::kConverged || r.status == SolveStatus::kRankDeficient;
  };
  const auto better_than = [&](const Result& a, const Result& b) {
    if (is_solution(a) != is_solution(b)) return is_solution(a);
    if (!std::isfinite(a.chi_square) || !std::isfinite(b.chi_square)) return std::isfinite(a.chi_square);
    constexpr double kTie = 1e-9;
    if (std::abs(a.chi_square - b.chi_square) < kTie && a.rank != b.rank) return a.rank > b.rank;
    return a.chi_square < b.chi_square;
  };
  const double apart = options.distinct_sigmas * options.distinct_sigmas;
  const auto same = [apart](const Result& a, const Result& b) {
    const typename State::Tangent d = a.state.local(b.state);
    if (d.norm() < 1e-3) return true;
    const detail::CholeskyFactor<typename Result::Covariance> root(a.covariance);
    if (!root.definite) return false;
    typename State::Tangent whitened = d;
    root.whiten(whitened);
    return detail::squared_norm(whitened) < apart;
  };
  std::array<Result, MultiStartResult<State, MaxRows>::kMaxAlternatives> others;
  std::size_t other_count = 0;
  bool first = true;
  for (const State& start : starts) {
    Result r = solve<MaxRows>(start, options, groups...);
    if (first) {
      out.best = r;
      first = false;
      continue;
    }
    const bool better = better_than(r, out.best);
    if (r.status == SolveStatus::kConverged && out.best.status == SolveStatus::kConverged && !same(out.best, r)) {
      Result& loser = better ? out.best : r;
      const auto known = [&](const Result& o) { return same(o, loser); };
      if (std::none_of(others.begin(), others.begin() + static_cast<std::ptrdiff_t>(other_count), known) &&
          other_count < others.size()) {
        others[other_count++] = loser;
      }
    }
    if (better) out.best = r;
  }
  for (std::size_t i = 0; i < other_count; ++i) {
    if (!(others[i].chi_square - out.best.chi_square <= ambiguity_gate) || same(out.best, others[i])) continue;
    out.alternatives[static_cast<std::size_t>(out.alternative_count++)] = others[i];
  }
  if (out.alternative_count > 0 && out.best.status == SolveStatus::kConverged)
    out.best.status = SolveStatus::kAmbiguous;
  return out;
}

/// Fisher information of a state under Gaussian noise of the stated covariances: the sum of Hᵀ R⁻¹ H at `state`
/// (Kay, Estimation Theory, 3.9). The measured values are not used. `status` is kConverged when it could be computed.
template <FixedStateType State>
struct FisherInformation {
  using Matrix = Eigen::Matrix<double, State::kDim, State::kDim>;
  SolveStatus status = SolveStatus::kUndefined;
  Matrix information = Matrix::Constant(std::numeric_limits<double>::quiet_NaN());
  int rank = 0;
  Matrix bound = Matrix::Constant(std::numeric_limits<double>::quiet_NaN());  ///< Cramér-Rao bound; NaN below full rank
  Eigen::Matrix<double, State::kDim, Eigen::Dynamic, 0, State::kDim, State::kDim>
      unobservable;  ///< orthonormal columns
};

/// Fisher information and Cramér-Rao bound at `state`. Groups as for `solve`. No allocation.
template <int MaxRows = 32, FixedStateType State, MeasurementGroupFor<State>... Groups>
[[nodiscard]] FisherInformation<State> fisher_information(const State& state, const Groups&... groups) {
  FisherInformation<State> out;
  detail::NormalEquations<State, MaxRows, Groups...> equations(groups...);
  out.status = equations.prepare();
  if (out.status != SolveStatus::kConverged) return out;
  detail::Stack<State, MaxRows> stack;
  equations.read(state, stack);
  if (!stack.defined) {
    out.status = SolveStatus::kUndefined;
    return out;
  }
  equations.whiten(stack);
  Eigen::Matrix<double, State::kDim, 1> g;
  double cost = 0.0;
  equations.accumulate(stack, out.information, g, cost);
  if (!detail::all_finite(out.information)) {
    out.status = SolveStatus::kNonFinite;
    return out;
  }
  detail::Conditioning<State::kDim> conditioning;
  conditioning.compute(stack, equations.rows(), out.information, LeastSquaresOptions{}.rank_tolerance);
  out.rank = conditioning.rank;
  out.bound = conditioning.covariance;
  out.unobservable = conditioning.unobservable;
  if (out.rank < State::kDim) out.status = SolveStatus::kRankDeficient;
  return out;
}

}  // namespace soopnav
