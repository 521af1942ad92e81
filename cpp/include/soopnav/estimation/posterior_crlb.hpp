#pragma once

#include <Eigen/Core>
#include <stdexcept>

#include "soopnav/estimation/covariance_check.hpp"
#include "soopnav/estimation/detail/small_matrix.hpp"
#include "soopnav/estimation/fisher_information.hpp"
#include "soopnav/estimation/transition.hpp"

namespace soopnav {

/// Posterior Cramér-Rao bound of a filter: the least covariance with which any filter can know the state of
/// x⁺ = f(x) + G w, z = h(x) + v after each step (Tichavský, Muravchik and Nehorai 1998; doc/fisher_information.md
/// eq. 7 to 10).
///
/// For a linear system it is the Kalman filter's covariance. For a nonlinear one give F and H at the *true* states
/// (`predict`, `update`: the bound along that trajectory), or their averages over trajectories (`predict_expected`,
/// `update_expected`: the bound itself). `N` tangent components, or `Eigen::Dynamic`. Keeps a root of the information,
/// so it may start from nothing known. No step throws; a refused one changes nothing. Fixed sizes need no heap.
template <int N>
class PosteriorCrlb {
 public:
  using Square = Eigen::Matrix<double, N, N>;

  /// Starts from the covariance of the state before the first step. Throws std::invalid_argument unless it is finite,
  /// symmetric and positive definite (`check_covariance`).
  explicit PosteriorCrlb(const Square& covariance) {
    check_covariance(covariance, "P0", true);
    if (!set_covariance(covariance)) throw std::invalid_argument("P0: not positive definite");
  }

  /// Starts from information instead: zero where nothing is known. Throws std::invalid_argument unless it is finite,
  /// symmetric and positive semidefinite.
  [[nodiscard]] static PosteriorCrlb from_information(const Square& information) {
    const auto root = information_root<N>(information);
    if (!root || information.rows() == 0) {
      throw std::invalid_argument("information: it must be finite, symmetric and positive semidefinite");
    }
    PosteriorCrlb bound;
    bound.set_root(*root);
    return bound;
  }

  /// One step of x⁺ = F x + G w, w of unit covariance (eq. 8): Q = G Gᵀ may be singular. False when a number is not
  /// finite, shapes do not fit, or F is singular while the information is too, or while Q leaves P⁺ singular.
  template <class FDerived, class GDerived>
  [[nodiscard]] bool predict(const Eigen::MatrixBase<FDerived>& F, const Eigen::MatrixBase<GDerived>& G) {
    const Eigen::Index n = root_.rows();
    if (F.rows() != n || F.cols() != n || G.rows() != n || !F.allFinite() || !G.allFinite()) return false;
    const Square transition = F;
    const Eigen::Matrix<double, N, GDerived::ColsAtCompileTime> gain = G;
    // U F⁻¹, from Fᵀ (U F⁻¹)ᵀ = Uᵀ.
    Square spent = transition.transpose();
    Square back = root_.transpose();
    if (!detail::solve_square(spent.data(), static_cast<int>(n), back.data(), static_cast<int>(n))) {
      const CramerRaoBound<N> now = bound_of_root<N>(root_);
      if (now.rank < n) return false;
      Square moved(n, n);
      detail::product(transition, now.covariance, moved);
      Square covariance(n, n);
      detail::product_transposed(moved, transition, covariance);
      detail::accumulate_product_transposed<1>(gain, gain, covariance);
      return set_covariance(covariance);
    }
    back.transposeInPlace();
    eliminate_noise<GDerived::ColsAtCompileTime>(back, gain);
    return true;
  }

  /// One step of a process model from the true state `x`, with its input `u` when it takes one. False where the
  /// model is undefined, and as above.
  template <FixedStateType State, ProcessModelFor<State> Process>
  requires(State::kDim == N) [[nodiscard]] bool predict_at(const State& x, const Process& process, double dt_s,
                                                           const InputOf<Process>& u = {}) {
    Transition<State, Process::kNoise> y(x);
    if (!detail::propagate(process, x, u, dt_s, ZeroNoise{}, y)) return false;
    return predict(Square(y.F.template topLeftCorner<N, N>()),
                   Eigen::Matrix<double, N, Process::kNoise>(y.G.template topRows<N>()));
  }

  /// One step from the averages over trajectories D11 = E[Fᵀ Q⁻¹ F], D12 = -E[Fᵀ] Q⁻¹ and D22 = Q⁻¹ (eq. 9). False
  /// when a number is not finite, shapes do not fit, or J + D11 is not positive definite.
  [[nodiscard]] bool predict_expected(const Square& d11, const Square& d12, const Square& d22) {
    const Eigen::Index n = root_.rows();
    for (const Square* d : {&d11, &d12, &d22}) {
      if (d->rows() != n || d->cols() != n) return false;
    }
    if (!d11.allFinite() || !d12.allFinite() || !d22.allFinite()) return false;
    Square sum = information();
    for (Eigen::Index i = 0; i < sum.size(); ++i) sum.data()[i] += d11.data()[i];
    const detail::CholeskyFactor<Square> factor(sum);
    if (!factor.definite) return false;
    // D12ᵀ (J + D11)⁻¹ D12 = Wᵀ W with W = L⁻¹ D12.
    Square W = d12;
    detail::solve_lower(factor.L.data(), n, W.data(), n);
    Square next = d22;
    detail::accumulate_transposed_product<-1>(W, W, next);
    return set_information(next);
  }

  /// Adds a measurement of Jacobian `H` (m x n) and covariance `R` (m x m) (eq. 10). False when a number is not finite,
  /// shapes do not fit or R is not positive definite.
  template <class HDerived, class RDerived>
  [[nodiscard]] bool update(const Eigen::MatrixBase<HDerived>& H, const Eigen::MatrixBase<RDerived>& R) {
    if (H.cols() != root_.cols() || R.rows() != H.rows() || R.cols() != H.rows()) return false;
    if (!H.allFinite() || !R.allFinite()) return false;
    const detail::CholeskyFactor<typename RDerived::PlainObject> factor(R);
    if (!factor.definite) return false;
    typename HDerived::PlainObject rows = H;
    for (Eigen::Index i = 0; i < rows.rows(); ++i) {
      for (Eigen::Index j = 0; j < rows.cols(); ++j) {
        double rest = rows.coeff(i, j);
        for (Eigen::Index k = 0; k < i; ++k) rest -= factor.L.coeff(i, k) * rows.coeff(k, j);
        rows.coeffRef(i, j) = rest / factor.L.coeff(i, i);
      }
    }
    absorb(rows);
    return true;
  }

  /// Adds measurements at the true state `x`. Groups as for `solve`; kConverged, or the reason and nothing added.
  template <int MaxRows = 32, FixedStateType State, MeasurementGroupFor<State>... Groups>
  requires(State::kDim == N) [[nodiscard]] SolveStatus update_at(const State& x, const Groups&... groups) {
    InformationSum<State> measured;
    const SolveStatus status = measured.template add<MaxRows>(x, groups...);
    if (status == SolveStatus::kConverged) absorb(measured.root());
    return status;
  }

  /// Adds a measurement by its information, averaged over trajectories: E[Hᵀ R⁻¹ H]. False when it is not finite,
  /// symmetric and positive semidefinite.
  [[nodiscard]] bool update_expected(const Square& measured) {
    if (measured.rows() != root_.rows()) return false;
    const auto rows = information_root<N>(measured);
    if (!rows) return false;
    absorb(*rows);
    return true;
  }

  [[nodiscard]] Square information() const {
    Square J = Square::Zero(root_.rows(), root_.cols());
    detail::accumulate_transposed_product<1>(root_, root_, J);
    return J;
  }
  [[nodiscard]] const Square& root() const noexcept { return root_; }
  /// The bound now, and what is not determined yet.
  [[nodiscard]] CramerRaoBound<N> bound(double tolerance = kRankTolerance) const {
    return bound_of_root<N>(root_, tolerance);
  }

 private:
  PosteriorCrlb() = default;

  void set_root(const Square& rows) {
    root_ = Square::Zero(rows.rows(), rows.cols());
    absorb(rows);
  }

  template <class Rows>
  void absorb(const Rows& rows) {
    for (Eigen::Index i = 0; i < rows.rows(); ++i) {
      Eigen::Matrix<double, 1, N> h = rows.row(i);
      detail::absorb_row<N>(root_, h);
    }
  }

  [[nodiscard]] bool set_covariance(const Square& covariance) {
    const detail::CholeskyFactor<Square> factor(covariance);
    if (!factor.definite) return false;
    const Eigen::Index n = covariance.rows();
    Square inverse_factor = Square::Identity(n, n);
    detail::solve_lower(factor.L.data(), n, inverse_factor.data(), n);
    set_root(inverse_factor);
    return true;
  }

  [[nodiscard]] bool set_information(const Square& information) {
    Square symmetric = information;
    for (Eigen::Index j = 0; j < symmetric.cols(); ++j) {
      for (Eigen::Index i = 0; i < j; ++i) {
        symmetric.coeffRef(i, j) = symmetric.coeffRef(j, i) = 0.5 * (symmetric.coeff(i, j) + symmetric.coeff(j, i));
      }
    }
    const auto rows = information_root<N>(symmetric);
    if (!rows) return false;
    set_root(*rows);
    return true;
  }

  // The rows over [w; x⁺]: w is standard normal, and U x = U F⁻¹ (x⁺ - G w). Triangular with w first, the lower right
  // block is the root of what is known of x⁺ alone.
  template <int Q>
  void eliminate_noise(const Square& back, const Eigen::Matrix<double, N, Q>& G) {
    constexpr int kAll = N == Eigen::Dynamic || Q == Eigen::Dynamic ? Eigen::Dynamic : N + Q;
    const Eigen::Index n = root_.rows();
    const Eigen::Index q = G.cols();
    Eigen::Matrix<double, kAll, kAll> all = Eigen::Matrix<double, kAll, kAll>::Zero(n + q, n + q);
    for (Eigen::Index i = 0; i < q; ++i) all.coeffRef(i, i) = 1.0;
    Eigen::Matrix<double, N, Q> noise(n, q);
    detail::product(back, G, noise);
    for (Eigen::Index i = 0; i < n; ++i) {
      Eigen::Matrix<double, 1, kAll> h(n + q);
      for (Eigen::Index k = 0; k < q; ++k) h.coeffRef(k) = -noise.coeff(i, k);
      for (Eigen::Index k = 0; k < n; ++k) h.coeffRef(q + k) = back.coeff(i, k);
      detail::absorb_row<kAll>(all, h);
    }
    detail::copy_block(all, q, q, n, n, root_, 0, 0);
  }

  Square root_;
};

}  // namespace soopnav
