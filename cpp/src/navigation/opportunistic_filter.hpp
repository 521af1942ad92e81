#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <new>
#include <span>

#include "soopnav/navigation/opportunistic_navigator.hpp"

namespace soopnav::navigation::detail {

/// A row of H: the few components that an observable touches.
struct TouchedRow {
  static constexpr int kMax = 12;
  int count = 0;
  std::array<int, kMax> index{};
  std::array<double, kMax> value{};
  void add(int i, double v) noexcept {
    index[static_cast<std::size_t>(count)] = i;
    value[static_cast<std::size_t>(count++)] = v;
  }
  [[nodiscard]] double at(int i) const noexcept {
    for (int c = 0; c < count; ++c) {
      if (index[static_cast<std::size_t>(c)] == i) return value[static_cast<std::size_t>(c)];
    }
    return 0.0;
  }
  /// h x.
  [[nodiscard]] double dot(const double* x) const noexcept {
    double sum = 0.0;
    for (int c = 0; c < count; ++c) {
      sum += value[static_cast<std::size_t>(c)] * x[index[static_cast<std::size_t>(c)]];
    }
    return sum;
  }
};

/// Zeroed doubles on cache lines.
class AlignedDoubles {
 public:
  explicit AlignedDoubles(std::size_t count);
  [[nodiscard]] double* data() const noexcept { return memory_.get(); }
  [[nodiscard]] std::size_t size() const noexcept { return count_; }

 private:
  struct Free {
    void operator()(double* p) const noexcept { ::operator delete[](p, std::align_val_t{64}); }
  };
  std::unique_ptr<double[], Free> memory_;
  std::size_t count_;
};

/// Mean and covariance of a state whose size changes, in either form (doc/opportunistic_navigation.md section 4).
///
/// P, or its root S (P = S Sᵀ), is the lower triangle of a column-major matrix; columns are `stride` apart, padded with
/// zeros to whole cache lines. In every pair of a value and its rate the rate comes first: the transition is then unit
/// lower triangular, and the root stays triangular under it.
class OpportunisticFilter {
 public:
  OpportunisticFilter(OpportunisticForm form, int max_dim, int max_rows);

  [[nodiscard]] int dim() const noexcept { return n_; }
  [[nodiscard]] int stride() const noexcept { return stride_; }
  [[nodiscard]] OpportunisticForm form() const noexcept { return form_; }
  [[nodiscard]] double* x() noexcept { return x_.data(); }
  [[nodiscard]] const double* x() const noexcept { return x_.data(); }
  /// Lower triangle of P or of its root.
  [[nodiscard]] const double* matrix() const noexcept { return P_.data(); }
  /// P(i, j), O(1) or O(n).
  [[nodiscard]] double covariance(int i, int j) const noexcept;
  /// P, symmetric, column-major n x n.
  void covariance(double* out) const noexcept;

  /// Appends `count` components with their own covariance (column-major, positive definite), independent of the others.
  void append(int count, const double* mean, const double* P) noexcept;
  void erase(int first, int count) noexcept;

  /// x_to += dt x_from, and the covariance with it; `from` < `to`.
  void move(int to, int from, double dt) noexcept;
  /// Noise on one component.
  void add_noise(int i, double variance) noexcept;
  /// Noise on a rate and its value: [[rate, cross], [cross, value]], positive semi-definite.
  void add_noise(int rate_i, int value_i, double rate, double cross, double value) noexcept;

  /// H P Hᵀ + R of `rows`, lower triangle, column-major `out` with columns `out_stride` apart.
  void innovation_covariance(std::span<const TouchedRow> rows, std::span<const double> variance, double* out,
                             int out_stride) noexcept;
  /// Uses rows linearised at the present x: innovation z - h(x), variance of the noise. `used` comes back false where a
  /// row would have lost the covariance's sign, and that row is left out. The mean has moved on return.
  void update(std::span<const TouchedRow> rows, std::span<const double> innovation, std::span<const double> variance,
              std::span<unsigned char> used) noexcept;

  /// Keeps mean and covariance, and puts them back: one place, of a state that has not changed its size since.
  void save() noexcept;
  void restore() noexcept;

 private:
  void rank_one(int first) noexcept;  // adds w wᵀ to P = S Sᵀ
  void update_joseph(std::span<const TouchedRow> rows, std::span<const double> innovation,
                     std::span<const double> variance, std::span<unsigned char> used) noexcept;
  void update_root(std::span<const TouchedRow> rows, std::span<const double> innovation,
                   std::span<const double> variance, std::span<unsigned char> used) noexcept;
  [[nodiscard]] double* column(int j) const noexcept {
    return P_.data() + static_cast<std::size_t>(j) * static_cast<std::size_t>(stride_);
  }
  void project(const TouchedRow& row, double* out) const noexcept;  // P hᵀ, or Sᵀ hᵀ

  OpportunisticForm form_;
  int n_ = 0;
  int stride_;
  AlignedDoubles x_, P_, saved_x_, saved_P_;
  AlignedDoubles w_;     // a vector
  AlignedDoubles dx_;    // what an update moves the mean by
  AlignedDoubles wide_;  // rows' projections
};

/// L Lᵀ of the lower triangle of a column-major matrix, in place. A pivot not above `tolerance` times its diagonal
/// element: false when `strict`, else its column is zero (a component without variance).
bool factorize_lower(double* A, int n, int stride, double tolerance, bool strict) noexcept;
/// X <- L⁻¹ X for one column, from component `first` on (those before are zero).
void solve_lower(const double* L, int n, int stride, double* x, int first = 0) noexcept;
/// X <- L⁻ᵀ X for one column. Zero pivots of both leave their component zero.
void solve_upper(const double* L, int n, int stride, double* x) noexcept;

}  // namespace soopnav::navigation::detail
