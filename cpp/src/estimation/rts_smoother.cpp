#include "soopnav/estimation/rts_smoother.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "estimation/row_kernels.hpp"
#include "estimation/series_check.hpp"

namespace soopnav {

namespace {

using detail::padded;

constexpr double kAsymmetry = 1e-9;  // of the geometric mean of two variances

// What the next step reads and writes, asked for in portions: hardware does not foresee a walk backwards through an
// array, and all at once would stall.
class Ahead {
 public:
  Ahead(const double* read, const double* also_read, const double* written, std::size_t count) noexcept
      : arrays_{read, also_read, written}, count_(count) {}
  // To be called kPortions times in a step.
  void fetch() noexcept {
    const std::size_t half = (count_ + 1) / 2;
    const std::size_t from = calls_ % 2 == 0 ? 0 : half;
    detail::prefetch(arrays_[calls_ / 2] + from, calls_ % 2 == 0 ? half : count_ - half);
    ++calls_;
  }

 private:
  static constexpr std::size_t kPortions = 6;
  const double* arrays_[kPortions / 2];
  std::size_t count_;
  std::size_t calls_ = 0;
};

class Smoother {
 public:
  explicit Smoother(int n)
      : n_(n),
        stride_(padded(n)),
        F_(n, n),
        arena_(8 * static_cast<std::size_t>(n) * static_cast<std::size_t>(stride_) +
               5 * static_cast<std::size_t>(stride_)) {
    for (double** square : {&P_, &P_pred_, &factor_, &U_, &X_, &difference_, &G_, &P_smooth_}) {
      *square = arena_.take(n_, stride_);
    }
    for (double** row : {&x_, &x_smooth_, &correction_, &d_, &inverse_d_}) *row = arena_.take(1, stride_);
  }

  void set_transition(const double* F) noexcept { F_.assign(F, n_, n_); }

  // The last step: as filtered. False when it is not finite or not symmetric.
  [[nodiscard]] bool start(const double* x, const double* P) noexcept {
    std::memcpy(x_smooth_, x, static_cast<std::size_t>(n_) * sizeof(double));
    detail::load_rows(P, n_, n_, stride_, P_smooth_);
    const bool symmetric = detail::is_symmetric(P_smooth_, n_, stride_, kAsymmetry);
    detail::mirror(P_smooth_, n_, stride_);
    return symmetric && detail::all_finite(P_smooth_, n_, stride_) && detail::all_finite(x_smooth_, 1, stride_);
  }

  // One step back, given the filtered step and the prediction from it. `next` of each array is asked for meanwhile.
  // False as for `start`: what is not finite in the input is not finite in the output.
  [[nodiscard]] bool step(const double* x, const double* P, const double* x_pred, const double* P_pred, Ahead ahead) {
    std::memcpy(x_, x, static_cast<std::size_t>(n_) * sizeof(double));
    detail::load_rows(P, n_, n_, stride_, P_);
    detail::load_rows(P_pred, n_, n_, stride_, P_pred_);
    ahead.fetch();
    if (!detail::is_symmetric(P_, n_, stride_, kAsymmetry) || !detail::is_symmetric(P_pred_, n_, stride_, kAsymmetry)) {
      return false;
    }
    ahead.fetch();
    detail::multiply(F_, P_, n_, stride_, false, X_);
    detail::subtract(P_smooth_, P_pred_, n_ * stride_, difference_);
    ahead.fetch();
    if (!gain()) return false;
    ahead.fetch();
    for (int i = 0; i < n_; ++i) correction_[i] = x_smooth_[i] - x_pred[i];
    detail::combine_rows(x_, correction_, X_, n_, stride_, x_smooth_);
    detail::multiply(difference_, X_, n_, stride_, G_);
    ahead.fetch();
    detail::add_product(P_, X_, G_, n_, n_, stride_, true, P_smooth_);
    ahead.fetch();
    detail::mirror(P_smooth_, n_, stride_);
    return detail::all_finite(x_smooth_, 1, stride_) && detail::all_finite(P_smooth_, n_, stride_);
  }

  void store(double* x, double* P) const noexcept {
    std::memcpy(x, x_smooth_, static_cast<std::size_t>(n_) * sizeof(double));
    detail::store_rows(P_smooth_, n_, n_, stride_, P);
  }

  int singular_steps() const noexcept { return singular_steps_; }

 private:
  // X <- P_pred⁺ X, the transpose of the gain (eq. 3). False when P_pred is not finite.
  [[nodiscard]] bool gain() {
    if (detail::factorize(P_pred_, n_, stride_, kSmootherRankTolerance * n_, factor_, U_, d_, inverse_d_, X_,
                          stride_)) {
      detail::solve_upper(U_, inverse_d_, n_, stride_, X_, stride_);
      return true;
    }
    if (!detail::all_finite(P_pred_, n_, stride_)) return false;
    detail::multiply(F_, P_, n_, stride_, false, X_);  // again: the factorisation began to solve
    ++singular_steps_;
    using Strided = Eigen::Map<RowMajorMatrix, 0, Eigen::OuterStride<>>;
    const Eigen::MatrixXd P_pred = Strided(P_pred_, n_, n_, Eigen::OuterStride<>(stride_));
    const Eigen::MatrixXd B = Strided(X_, n_, n_, Eigen::OuterStride<>(stride_));
    Eigen::MatrixXd X;
    static_cast<void>(detail::solve_covariance(P_pred, B, X));
    Strided(X_, n_, n_, Eigen::OuterStride<>(stride_)) = X;
    return true;
  }

  int n_, stride_;
  int singular_steps_ = 0;
  detail::SparseRows F_;
  detail::RowArena arena_;
  double *P_, *P_pred_, *factor_, *U_, *X_, *difference_, *G_, *P_smooth_, *x_, *x_smooth_, *correction_, *d_,
      *inverse_d_;
};

// Says which of the inputs of a step made `Smoother` refuse it.
[[noreturn]] void refuse(int k, std::span<const double> x_pred, std::span<const double> P_pred,
                         std::span<const double> x, std::span<const double> P, int n) {
  const auto look = [n](std::span<const double> values, int step, std::size_t size, const char* name) {
    const auto one = values.subspan(static_cast<std::size_t>(step) * size, size);
    for (const double v : one) {
      if (!std::isfinite(v)) {
        throw std::invalid_argument(std::string(name) + ": step " + std::to_string(step) + " is not finite");
      }
    }
    if (size == static_cast<std::size_t>(n)) return;
    const Eigen::Map<const RowMajorMatrix> M(one.data(), n, n);
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < i; ++j) {
        if (!(std::abs(M(i, j) - M(j, i)) <= 1e-9 * std::sqrt(std::abs(M(i, i) * M(j, j))))) {
          throw std::invalid_argument(std::string(name) + ": step " + std::to_string(step) + " is not symmetric");
        }
      }
    }
  };
  const auto size = static_cast<std::size_t>(n);
  const int steps = static_cast<int>(x.size() / size);
  look(x, k, size, "x");
  look(P, k, size * size, "P");
  if (k + 1 < steps) {
    look(x_pred, k + 1, size, "x_pred");
    look(P_pred, k + 1, size * size, "P_pred");
  }
  throw std::invalid_argument("P: step " + std::to_string(k) + " overflows when it is smoothed");
}

}  // namespace

int rts_smooth(const MatrixSeries& F, std::span<const double> x_pred, std::span<const double> P_pred,
               std::span<const double> x, std::span<const double> P, std::span<double> x_smooth,
               std::span<double> P_smooth) {
  const int n = F.rows;
  if (n < 1) throw std::invalid_argument("F: empty");
  const auto size = static_cast<std::size_t>(n);
  if (x.size() % size != 0) {
    throw std::invalid_argument("x: " + std::to_string(x.size()) + " numbers, no whole steps of " + std::to_string(n));
  }
  const int steps = static_cast<int>(x.size() / size);
  detail::check_series(F, "F", n, n, steps);
  detail::check_size(x_pred.size(), "x_pred", steps, size);
  detail::check_size(P_pred.size(), "P_pred", steps, size * size);
  detail::check_size(P.size(), "P", steps, size * size);
  detail::check_size(x_smooth.size(), "x_smooth", steps, size);
  detail::check_size(P_smooth.size(), "P_smooth", steps, size * size);
  if (steps == 0) return 0;

  Smoother smoother(n);
  const auto vector = [size](auto series, int k) { return series.data() + static_cast<std::size_t>(k) * size; };
  const auto square = [size](auto series, int k) { return series.data() + static_cast<std::size_t>(k) * size * size; };
  if (!smoother.start(vector(x, steps - 1), square(P, steps - 1))) refuse(steps - 1, x_pred, P_pred, x, P, n);
  smoother.store(vector(x_smooth, steps - 1), square(P_smooth, steps - 1));
  for (int k = steps - 2; k >= 0; --k) {
    if (k == steps - 2 || F.count > 1) smoother.set_transition(F.at(k + 1));
    const int before = k > 0 ? k - 1 : k;
    const Ahead ahead(square(P, before), square(P_pred, before + 1), square(P_smooth, before), size * size);
    if (!smoother.step(vector(x, k), square(P, k), vector(x_pred, k + 1), square(P_pred, k + 1), ahead)) {
      refuse(k, x_pred, P_pred, x, P, n);
    }
    smoother.store(vector(x_smooth, k), square(P_smooth, k));
  }
  return smoother.singular_steps();
}

}  // namespace soopnav
