#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>

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

template <class Derived>
[[nodiscard]] Eigen::Matrix<double, Derived::ColsAtCompileTime, 1> column_scale(
    const Eigen::MatrixBase<Derived>& root) {
  Eigen::Matrix<double, Derived::ColsAtCompileTime, 1> scale = root.colwise().norm().transpose();
  const double largest = scale.size() > 0 ? scale.maxCoeff() : 0.0;
  for (Eigen::Index i = 0; i < scale.size(); ++i) {
    if (!(scale[i] > kZeroColumn * largest)) scale[i] = largest > 0.0 ? largest : 1.0;
  }
  return scale;
}

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
  constexpr double kInf = std::numeric_limits<double>::infinity();
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  const Eigen::Index n = root.cols();
  Bound bound;
  bound.information = root.transpose() * root;
  bound.covariance = Bound::Square::Constant(n, n, kNan);
  bound.sigma = Bound::Vector::Constant(n, kNan);
  bound.singular_values = Bound::Vector::Constant(n, kNan);
  bound.unobservable.resize(n, 0);
  if (n == 0 || !root.allFinite()) return bound;

  const typename Bound::Vector scale = detail::column_scale(root);
  const typename Bound::Square scaled = root * scale.cwiseInverse().asDiagonal();
  const Eigen::JacobiSVD<typename Bound::Square> svd(scaled, Eigen::ComputeFullV);
  if (svd.info() != Eigen::Success) return bound;
  bound.singular_values = svd.singularValues();
  const auto& s = bound.singular_values;
  while (bound.rank < n && s[bound.rank] > tolerance * s[0]) ++bound.rank;
  const Eigen::Index rank = bound.rank;

  const auto& V = svd.matrixV();
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j <= i; ++j) {
      double sum = 0.0;
      for (Eigen::Index k = 0; k < rank; ++k) sum += V(i, k) / s[k] * (V(j, k) / s[k]);
      bound.covariance(i, j) = bound.covariance(j, i) = sum / scale[i] / scale[j];
    }
  }
  for (Eigen::Index i = 0; i < n; ++i) {
    double squares = 0.0;
    for (Eigen::Index k = rank; k < n; ++k) squares += V(i, k) * V(i, k);
    if (squares <= detail::kOutsideNull * detail::kOutsideNull) continue;
    bound.covariance.row(i).setConstant(kNan);
    bound.covariance.col(i).setConstant(kNan);
    bound.covariance(i, i) = kInf;
  }
  for (Eigen::Index i = 0; i < n; ++i) bound.sigma[i] = std::sqrt(bound.covariance(i, i));

  bound.unobservable.resize(n, n - rank);
  for (Eigen::Index k = rank; k < n; ++k) {
    // Back to unscaled components, then at right angles to those before: Gram-Schmidt, twice, which is enough.
    typename Bound::Vector v = V.col(k).cwiseQuotient(scale) * scale.minCoeff();
    v.normalize();
    for (int pass = 0; pass < 2; ++pass) {
      for (Eigen::Index j = 0; j < k - rank; ++j) {
        const double along = bound.unobservable.col(j).dot(v);
        v -= along * bound.unobservable.col(j);
      }
      v.normalize();
    }
    bound.unobservable.col(k - rank) = v;
  }
  return bound;
}

/// A square root of an information matrix: J = rootᵀ root. Nothing when `information` is not finite, not symmetric to
/// 1e-9 of its diagonal, or has an eigenvalue below -1e-9 of the largest once its diagonal is scaled to ones.
/// Allocates for a dynamic size only.
template <int N>
[[nodiscard]] std::optional<Eigen::Matrix<double, N, N>> information_root(
    const Eigen::Matrix<double, N, N>& information) {
  using Square = Eigen::Matrix<double, N, N>;
  if (information.rows() != information.cols() || !information.allFinite()) return std::nullopt;
  const Eigen::Index n = information.rows();
  Eigen::Matrix<double, N, 1> scale = information.diagonal();
  for (Eigen::Index i = 0; i < n; ++i) {
    if (scale[i] < 0.0) return std::nullopt;
    scale[i] = scale[i] > 0.0 ? std::sqrt(scale[i]) : 1.0;
  }
  Square scaled = scale.cwiseInverse().asDiagonal() * information * scale.cwiseInverse().asDiagonal();
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < i; ++j) {
      if (!(std::abs(scaled(i, j) - scaled(j, i)) <= 1e-9)) return std::nullopt;
      scaled(i, j) = scaled(j, i) = 0.5 * (scaled(i, j) + scaled(j, i));
    }
  }
  const Eigen::SelfAdjointEigenSolver<Square> eigen(scaled);
  if (eigen.info() != Eigen::Success) return std::nullopt;
  Eigen::Matrix<double, N, 1> root = eigen.eigenvalues();
  const double largest = n > 0 ? root.maxCoeff() : 0.0;
  for (Eigen::Index i = 0; i < n; ++i) {
    if (root[i] < -1e-9 * largest) return std::nullopt;
    root[i] = std::sqrt(std::max(root[i], 0.0));
  }
  return Square(root.asDiagonal() * eigen.eigenvectors().transpose() * scale.asDiagonal());
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
    wanted.col(i) = root.col(column);
    nuisance.col(column).setZero();
  }
  // What of the wanted columns lies at right angles to everything the nuisance parameters can explain.
  const Square scaled = nuisance * detail::column_scale(nuisance).cwiseInverse().asDiagonal();
  const Eigen::JacobiSVD<Square> svd(scaled, Eigen::ComputeFullU);
  Eigen::Matrix<double, K, K> information = Eigen::Matrix<double, K, K>::Zero(count, count);
  if (svd.info() != Eigen::Success) {
    information.setConstant(std::numeric_limits<double>::quiet_NaN());
    return information;
  }
  const auto& s = svd.singularValues();
  for (Eigen::Index k = 0; k < n; ++k) {
    if (s[k] > tolerance * s[0]) continue;
    const Eigen::Matrix<double, 1, K> row = svd.matrixU().col(k).transpose() * wanted;
    information.noalias() += row.transpose() * row;
  }
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
  [[nodiscard]] Matrix information() const noexcept { return root_.transpose() * root_; }
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
