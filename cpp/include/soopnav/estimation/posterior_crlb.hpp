#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/LU>
#include <stdexcept>

#include "soopnav/estimation/covariance_check.hpp"
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
    const Square transposed = F.transpose();
    const Eigen::FullPivLU<Square> lu(transposed);
    if (!lu.isInvertible()) {
      const CramerRaoBound<N> now = bound_of_root<N>(root_);
      if (now.rank < n) return false;
      Square covariance = F * now.covariance * F.transpose();
      covariance += G * G.transpose();
      return set_covariance(covariance);
    }
    const Square columns = root_.transpose();
    const Square back = lu.solve(columns).transpose();  // U F⁻¹
    const Eigen::Matrix<double, N, GDerived::ColsAtCompileTime> gain = G;
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
    const Eigen::LLT<Square> llt(Square(information() + d11));
    if (llt.info() != Eigen::Success) return false;
    Square next = d22;
    next.noalias() -= d12.transpose() * llt.solve(d12);
    return set_information(next);
  }

  /// Adds a measurement of Jacobian `H` (m x n) and covariance `R` (m x m) (eq. 10). False when a number is not finite,
  /// shapes do not fit or R is not positive definite.
  template <class HDerived, class RDerived>
  [[nodiscard]] bool update(const Eigen::MatrixBase<HDerived>& H, const Eigen::MatrixBase<RDerived>& R) {
    if (H.cols() != root_.cols() || R.rows() != H.rows() || R.cols() != H.rows()) return false;
    if (!H.allFinite() || !R.allFinite()) return false;
    const Eigen::LLT<typename RDerived::PlainObject> llt(R);
    if (llt.info() != Eigen::Success) return false;
    typename HDerived::PlainObject rows = H;
    llt.matrixL().solveInPlace(rows);
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

  [[nodiscard]] Square information() const { return root_.transpose() * root_; }
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
    const Eigen::LLT<Square> llt(covariance);
    if (llt.info() != Eigen::Success) return false;
    Square inverse_factor = Square::Identity(covariance.rows(), covariance.cols());
    llt.matrixL().solveInPlace(inverse_factor);
    set_root(inverse_factor);
    return true;
  }

  [[nodiscard]] bool set_information(const Square& information) {
    const Square symmetric = 0.5 * (information + information.transpose());
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
    all.diagonal().head(q).setOnes();
    const Eigen::Matrix<double, N, Q> noise = back * G;
    for (Eigen::Index i = 0; i < n; ++i) {
      Eigen::Matrix<double, 1, kAll> h(n + q);
      h.head(q) = -noise.row(i);
      h.tail(n) = back.row(i);
      detail::absorb_row<kAll>(all, h);
    }
    root_ = all.bottomRightCorner(n, n);
  }

  Square root_;
};

}  // namespace soopnav
