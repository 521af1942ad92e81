#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>

#include "soopnav/estimation/detail/small_matrix.hpp"
#include "soopnav/estimation/detail/symmetric_eigen.hpp"
#include "soopnav/estimation/least_squares.hpp"

namespace soopnav {

/// Singular values of a whitened Jacobian with columns of length one, below this fraction of the largest, count as
/// zero. It leaves room for an information matrix, whose square root is known to 1e-8 only.
inline constexpr double kRankTolerance = 1e-7;

/// The least covariance of an unbiased estimate of `N` parameters (`N` may be `Eigen::Dynamic`), and what no estimate
/// can know (doc/fisher_information.md eq. 2 to 5; Kay, Estimation Theory, 3.4; Stoica and Marzetta 2001 for the
/// singular case).
///
/// Below full rank the numbers of those parameters that the data do determine stay finite: the variance of a parameter
/// that has a part in an unobservable direction is infinite, and its covariances are NaN.
template <int N>
struct CramerRaoBound {
  using Square = Eigen::Matrix<double, N, N>;
  using Vector = Eigen::Matrix<double, N, 1>;

  int rank = 0;            ///< directions that are determined
  Square information;      ///< J itself
  Square covariance;       ///< the bound
  Vector sigma;            ///< standard deviations: roots of its diagonal
  Vector singular_values;  ///< of the whitened Jacobian with columns of length one, largest first
  /// Orthonormal columns: the directions that are not determined; `name_directions` puts them in words.
  Eigen::Matrix<double, N, Eigen::Dynamic, 0, N, N> unobservable;
};

namespace detail {

// Smaller than this part of the largest column is rounding; states in seconds beside states in metres are not.
inline constexpr double kZeroColumn = 1e-13;
// Part of a unit vector that may lie in the null space of the scaled Jacobian by rounding.
inline constexpr double kOutsideNull = 1e-6;

// Lengths of the columns of a rows x n array; of those that are rounding, the largest length.
void column_scale(const double* root, Eigen::Index rows, Eigen::Index n, double* scale) noexcept;

// What `bound_of_root` finds, of n x n arrays: the rank, or -1 where the decomposition fails and only the information
// is set. The columns of `unobservable` beyond n - rank are not set.
int bound_of_root(const double* root, int n, double tolerance, double* information, double* covariance, double* sigma,
                  double* singular_values, double* unobservable) noexcept;
// `information_root` of a finite n x n array. False when it has no root.
[[nodiscard]] bool information_root(const double* information, int n, double* root) noexcept;
// `marginal_information` once `nuisance` is the root without the wanted columns, which are n x count; NaN on failure.
void marginal_information(const double* nuisance, const double* wanted, int n, int count, double tolerance,
                          double* information) noexcept;

// Givens' rotations take the row `h` into the upper triangular `root`: rootᵀroot grows by hᵀh. `h` is used up.
template <int N>
void absorb_row(Eigen::Matrix<double, N, N>& root, Eigen::Matrix<double, 1, N>& h) {
  const Eigen::Index n = root.cols();
  for (Eigen::Index j = 0; j < n; ++j) {
    if (h[j] == 0.0) continue;
    const double length = std::hypot(root(j, j), h[j]);
    const double c = root(j, j) / length;
    const double s = h[j] / length;
    root(j, j) = length;
    for (Eigen::Index k = j + 1; k < n; ++k) {
      const double upper = root(j, k);
      root(j, k) = c * upper + s * h[k];
      h[k] = c * h[k] - s * upper;
    }
  }
}

}  // namespace detail

/// The bound of the information rootᵀ root (eq. 2 to 5). Everything is NaN and the rank zero when `root` is not finite.
/// `tolerance` in (0, 1): see `kRankTolerance`. Allocates for a dynamic size only.
template <int N>
[[nodiscard]] CramerRaoBound<N> bound_of_root(const Eigen::Matrix<double, N, N>& root,
                                              double tolerance = kRankTolerance) {
  using Bound = CramerRaoBound<N>;
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  const Eigen::Index n = root.cols();
  Bound bound;
  bound.information = Bound::Square::Constant(n, n, kNan);
  bound.covariance = bound.information;
  bound.sigma = Bound::Vector::Constant(n, kNan);
  bound.singular_values = bound.sigma;
  bound.unobservable.resize(n, 0);
  if (n == 0) return bound;
  typename Bound::Square directions(n, n);
  const int rank = detail::bound_of_root(root.data(), static_cast<int>(n), tolerance, bound.information.data(),
                                         bound.covariance.data(), bound.sigma.data(), bound.singular_values.data(),
                                         directions.data());
  if (rank < 0) return bound;
  bound.rank = rank;
  bound.unobservable = directions.leftCols(n - rank);
  return bound;
}

/// A square root of an information matrix: J = rootᵀ root. Nothing when `information` is not finite, not symmetric to
/// 1e-9 of its diagonal, or has an eigenvalue below -1e-9 of the largest once its diagonal is scaled to ones.
/// Allocates for a dynamic size only.
template <int N>
[[nodiscard]] std::optional<Eigen::Matrix<double, N, N>> information_root(
    const Eigen::Matrix<double, N, N>& information) {
  using Square = Eigen::Matrix<double, N, N>;
  if (information.rows() != information.cols() || !detail::all_finite(information)) return std::nullopt;
  Square root(information.rows(), information.cols());
  const int n = static_cast<int>(information.rows());
  if (!detail::information_root(information.data(), n, root.data())) return std::nullopt;
  return root;
}

/// Information about the parameters `kept` when the others are unknown as well: the Schur complement
/// J_kk - J_kn J_nn⁺ J_nk (eq. 6), computed from the root without forming it. It never gains by knowing less: its bound
/// is the block of the whole bound.
///
/// `kept`: indices in the order wanted, each once and inside 0 ... N-1 (std::invalid_argument otherwise; the caller's
/// constants, not data); NaN when `root` is not finite. `K`: their number, or `Eigen::Dynamic`. Allocates for dynamic
/// sizes only.
template <int K, int N>
[[nodiscard]] Eigen::Matrix<double, K, K> marginal_information(const Eigen::Matrix<double, N, N>& root,
                                                               std::span<const int> kept,
                                                               double tolerance = kRankTolerance) {
  using Square = Eigen::Matrix<double, N, N>;
  const Eigen::Index n = root.cols();
  const auto count = static_cast<Eigen::Index>(kept.size());
  if (K != Eigen::Dynamic && count != K) {
    throw std::invalid_argument("kept: " + std::to_string(count) + " indices; " + std::to_string(K) + " expected");
  }
  Eigen::Matrix<double, N, K> wanted(n, count);
  Square nuisance = root;
  for (Eigen::Index i = 0; i < count; ++i) {
    const int column = kept[static_cast<std::size_t>(i)];
    if (column < 0 || column >= n) {
      throw std::invalid_argument("kept: index " + std::to_string(column) + "; it must lie in 0 ... " +
                                  std::to_string(n - 1));
    }
    for (Eigen::Index j = 0; j < i; ++j) {
      if (kept[static_cast<std::size_t>(j)] == column) {
        throw std::invalid_argument("kept: index " + std::to_string(column) + " is there twice");
      }
    }
    for (Eigen::Index k = 0; k < n; ++k) {
      wanted.coeffRef(k, i) = root.coeff(k, column);
      nuisance.coeffRef(k, column) = 0.0;
    }
  }
  Eigen::Matrix<double, K, K> information(count, count);
  detail::marginal_information(nuisance.data(), wanted.data(), static_cast<int>(n), static_cast<int>(count), tolerance,
                               information.data());
  return information;
}

/// Fisher information gathered from independent measurements, at one state or along a track that shares its parameters.
///
/// Keeps an upper triangular root U with J = UᵀU (doc/fisher_information.md eq. 1), which sees directions that the
/// matrix J itself would lose in rounding. `fisher_information` of least_squares.hpp answers for one set of
/// measurements; this adds up any number of them, takes a prior, and leaves nuisance parameters out. No heap.
template <FixedStateType StateType>
class InformationSum {
 public:
  using State = StateType;
  static constexpr int kDim = State::kDim;
  using Matrix = Eigen::Matrix<double, kDim, kDim>;

  /// Knows nothing.
  InformationSum() = default;

  /// Starts from prior information: the inverse of a prior covariance, zero where nothing is known.
  /// Throws std::invalid_argument when it is not symmetric and positive semidefinite.
  explicit InformationSum(const Matrix& prior_information) {
    const auto root = information_root<kDim>(prior_information);
    if (!root) {
      throw std::invalid_argument("prior_information: it must be finite, symmetric and positive semidefinite");
    }
    absorb(*root);
  }

  /// Adds HᵀR⁻¹H of measurements at `state`. Groups as for `solve`; the measured values are not used, but must be
  /// finite. kConverged when added; otherwise the reason, and nothing was added. No allocation.
  template <int MaxRows = 32, MeasurementGroupFor<State>... Groups>
  [[nodiscard]] SolveStatus add(const State& state, const Groups&... groups) {
    static_assert(sizeof...(Groups) >= 1, "add needs measurements");
    detail::NormalEquations<State, MaxRows, Groups...> equations(groups...);
    const SolveStatus status = equations.prepare();
    if (status != SolveStatus::kConverged) return status;
    detail::Stack<State, MaxRows> stack;
    equations.read(state, stack);
    if (!stack.defined) return SolveStatus::kUndefined;
    equations.whiten(stack);
    for (int i = 0; i < equations.rows(); ++i) {
      if (!stack.H.row(i).allFinite()) return SolveStatus::kNonFinite;
    }
    for (int i = 0; i < equations.rows(); ++i) {
      Eigen::Matrix<double, 1, kDim> h = stack.H.row(i);
      detail::absorb_row<kDim>(root_, h);
    }
    return SolveStatus::kConverged;
  }

  /// Adds rows of a Jacobian that are whitened already (each divided by its standard deviation); false, and nothing
  /// added, when one is not finite. No allocation.
  template <class Derived>
  [[nodiscard]] bool add_whitened(const Eigen::MatrixBase<Derived>& rows) {
    static_assert(Derived::ColsAtCompileTime == kDim);
    if (!rows.allFinite()) return false;
    absorb(rows);
    return true;
  }

  /// Adds what another set of independent measurements knows.
  InformationSum& operator+=(const InformationSum& other) {
    absorb(other.root_);
    return *this;
  }

  /// U, upper triangular.
  [[nodiscard]] const Matrix& root() const noexcept { return root_; }
  /// J = UᵀU.
  [[nodiscard]] Matrix information() const noexcept {
    Matrix J = Matrix::Zero();
    detail::accumulate_transposed_product<1>(root_, root_, J);
    return J;
  }
  /// See `CramerRaoBound`. With R = 1 throughout, `dilution_of_precision<State>` of its covariance is the DOP.
  [[nodiscard]] CramerRaoBound<kDim> bound(double tolerance = kRankTolerance) const {
    return bound_of_root<kDim>(root_, tolerance);
  }

  /// Information about these roles when all others are unknown (eq. 6), in the order given. No allocation.
  template <RoleType... Roles>
  requires(HoldsRole<State, Roles>&&...) [[nodiscard]] auto marginal(Roles... roles) const {
    constexpr int kKept = (Roles::kDim + ...);
    std::array<int, static_cast<std::size_t>(kKept)> kept{};
    std::size_t next = 0;
    const auto take = [&](int first, int count) {
      for (int i = 0; i < count; ++i) kept[next++] = first + i;
    };
    (take(State::at(roles), Roles::kDim), ...);
    return marginal_information<kKept, kDim>(root_, kept);
  }

 private:
  template <class Rows>
  void absorb(const Rows& rows) {
    for (Eigen::Index i = 0; i < rows.rows(); ++i) {
      Eigen::Matrix<double, 1, kDim> h = rows.row(i);
      detail::absorb_row<kDim>(root_, h);
    }
  }

  Matrix root_ = Matrix::Zero();
};

// ---- sizes known at run time: for arrays of any origin. These allocate.

/// Upper triangular root of the information of `H` (m, n) under noise of covariance `R`: (m, m); (b, b) with m a
/// multiple of b, a block for each b rows; or (m, 1), variances of independent rows. m may be zero. Throws
/// std::invalid_argument naming the argument when shapes do not fit, a number is not finite, or R is not symmetric
/// (1e-9) and positive definite.
[[nodiscard]] Eigen::MatrixXd root_of_rows(const Eigen::Ref<const Eigen::MatrixXd>& H,
                                           const Eigen::Ref<const Eigen::MatrixXd>& R);

/// Cramér-Rao bound of z = h(x) + noise from the Jacobian `H` and `R` (see `root_of_rows`), with prior information
/// (n, n) added when it is not empty. Throws as there; also for a prior that is not symmetric and positive
/// semidefinite, and a tolerance outside (0, 1).
[[nodiscard]] CramerRaoBound<Eigen::Dynamic> cramer_rao_bound(
    const Eigen::Ref<const Eigen::MatrixXd>& H, const Eigen::Ref<const Eigen::MatrixXd>& R,
    const Eigen::Ref<const Eigen::MatrixXd>& prior_information = Eigen::MatrixXd(), double tolerance = kRankTolerance);

}  // namespace soopnav
