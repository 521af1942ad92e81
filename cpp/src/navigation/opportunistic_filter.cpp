#include "navigation/opportunistic_filter.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/target_clones.hpp"

namespace soopnav::navigation::detail {

namespace {

constexpr int kLine = 8;   // doubles in a cache line
constexpr int kGroup = 4;  // rows whose changes of P are applied together

constexpr int padded(int n) noexcept { return (n + kLine - 1) / kLine * kLine; }
constexpr std::size_t as_size(int n) noexcept { return static_cast<std::size_t>(n); }

// P(i, j) -= sum_q K(i, q) B(j, q) + B(i, q) K(j, q) on and below the diagonal, from whole cache lines.
SOOPNAV_TARGET_CLONES_WIDE
void subtract_pairs(double* P, std::size_t stride, int n, const double* K, const double* B) noexcept {
  const double *k0 = K, *k1 = K + stride, *k2 = K + 2 * stride, *k3 = K + 3 * stride;
  const double *b0 = B, *b1 = B + stride, *b2 = B + 2 * stride, *b3 = B + 3 * stride;
  const int end = padded(n);
  for (int j = 0; j < n; ++j) {
    double* column = P + static_cast<std::size_t>(j) * stride;
    const double p0 = k0[j], p1 = k1[j], p2 = k2[j], p3 = k3[j];
    const double q0 = b0[j], q1 = b1[j], q2 = b2[j], q3 = b3[j];
    for (int i = j / kLine * kLine; i < end; ++i) {
      column[i] -= ((k0[i] * q0 + b0[i] * p0) + (k1[i] * q1 + b1[i] * p1)) +
                   ((k2[i] * q2 + b2[i] * p2) + (k3[i] * q3 + b3[i] * p3));
    }
  }
}

// Carlson's update of the lower triangular root by one observable: S <- S A with A Aᵀ = I - f fᵀ / (r + fᵀ f). `v`
// comes as zeros and leaves as S f = P hᵀ.
SOOPNAV_TARGET_CLONES_WIDE
void carlson(double* S, std::size_t stride, int n, const double* f, double r, double* v) noexcept {
  const int end = padded(n);
  double alpha = r;
  for (int j = n - 1; j >= 0; --j) {
    const double fj = f[j];
    if (fj == 0.0) continue;
    double* column = S + static_cast<std::size_t>(j) * stride;
    const double next = alpha + fj * fj;
    const double scale = std::sqrt(alpha / next);
    const double share = fj / std::sqrt(alpha * next);
    for (int i = j / kLine * kLine; i < end; ++i) {
      const double s = column[i];
      column[i] = s * scale - v[i] * share;
      v[i] += s * fj;
    }
    // Above the diagonal everything stays zero: v has nothing there yet, nor has the column.
    alpha = next;
  }
}

SOOPNAV_TARGET_CLONES_WIDE
void rotate_in(double* column, double* w, int from, int end, double c, double s) noexcept {
  for (int i = from; i < end; ++i) {
    const double old = column[i];
    column[i] = c * old + s * w[i];
    w[i] = c * w[i] - s * old;
  }
}

// out(i, j) += sum over four rows k of F(k, i) F(k, j), i >= j.
SOOPNAV_TARGET_CLONES_WIDE
void add_outer(double* out, std::size_t out_stride, int m, const double* F, std::size_t f_stride) noexcept {
  const double *f0 = F, *f1 = F + f_stride, *f2 = F + 2 * f_stride, *f3 = F + 3 * f_stride;
  for (int j = 0; j < m; ++j) {
    double* column = out + static_cast<std::size_t>(j) * out_stride;
    const double a = f0[j], b = f1[j], c = f2[j], d = f3[j];
    for (int i = j; i < m; ++i) column[i] += (f0[i] * a + f1[i] * b) + (f2[i] * c + f3[i] * d);
  }
}

SOOPNAV_TARGET_CLONES_WIDE
void subtract_multiple(double* y, const double* x, double factor, int from, int end) noexcept {
  for (int i = from; i < end; ++i) y[i] -= factor * x[i];
}

}  // namespace

AlignedDoubles::AlignedDoubles(std::size_t count)
    : memory_(static_cast<double*>(
          ::operator new[](std::max<std::size_t>(count, 1) * sizeof(double), std::align_val_t{64}))),
      count_(count) {
  std::fill_n(memory_.get(), count, 0.0);
}

OpportunisticFilter::OpportunisticFilter(OpportunisticForm form, int max_dim, int max_rows)
    : form_(form),
      stride_(padded(max_dim)),
      x_(as_size(stride_)),
      P_(as_size(stride_) * as_size(stride_)),
      saved_x_(x_.size()),
      saved_P_(P_.size()),
      w_(as_size(stride_)),
      dx_(as_size(stride_)),
      wide_(std::max(as_size(stride_) * as_size(std::max(padded(max_rows), 2 * kGroup)),
                     as_size(stride_) * as_size(kLine))) {}

double OpportunisticFilter::covariance(int i, int j) const noexcept {
  if (i < j) std::swap(i, j);
  if (form_ == OpportunisticForm::kJoseph) return column(j)[i];
  double sum = 0.0;
  for (int k = 0; k <= j; ++k) sum += column(k)[i] * column(k)[j];
  return sum;
}

void OpportunisticFilter::covariance(double* out) const noexcept {
  const auto n = as_size(n_);
  if (form_ == OpportunisticForm::kJoseph) {
    for (int j = 0; j < n_; ++j) {
      for (int i = j; i < n_; ++i) out[as_size(j) * n + as_size(i)] = column(j)[i];
    }
  } else {
    std::fill_n(out, n * n, 0.0);
    for (int k = 0; k < n_; ++k) {
      const double* s = column(k);
      for (int j = k; j < n_; ++j) {
        double* to = out + as_size(j) * n;
        for (int i = j; i < n_; ++i) to[i] += s[i] * s[j];
      }
    }
  }
  for (int j = 0; j < n_; ++j) {
    for (int i = 0; i < j; ++i) out[as_size(j) * n + as_size(i)] = out[as_size(i) * n + as_size(j)];
  }
}

void OpportunisticFilter::append(int count, const double* mean, const double* P) noexcept {
  const int first = n_;
  n_ += count;
  for (int i = 0; i < count; ++i) x_.data()[first + i] = mean[i];
  for (int j = 0; j < first; ++j) std::fill_n(column(j) + first, count, 0.0);
  for (int j = 0; j < count; ++j) {
    std::fill_n(column(first + j), stride_, 0.0);
    for (int i = j; i < count; ++i) column(first + j)[first + i] = P[j * count + i];
  }
  if (form_ == OpportunisticForm::kSquareRoot) {
    factorize_lower(column(first) + first, count, stride_, 0.0, false);
  }
}

void OpportunisticFilter::erase(int first, int count) noexcept {
  const int kept = n_ - count;
  for (int i = first; i < kept; ++i) x_.data()[i] = x_.data()[i + count];
  x_.data()[kept] = 0.0;
  // Columns of the root that lose their diagonal: what they say of the components behind.
  double* lost = wide_.data();
  if (form_ == OpportunisticForm::kSquareRoot) {
    for (int c = 0; c < count; ++c) {
      double* w = lost + as_size(c) * as_size(stride_);
      std::fill_n(w, stride_, 0.0);
      for (int i = first; i < kept; ++i) w[i] = column(first + c)[i + count];
    }
  }
  for (int j = 0; j < kept; ++j) {
    double* to = column(j);
    const double* from = column(j < first ? j : j + count);
    for (int i = j < first ? first : j; i < kept; ++i) to[i] = from[i + count];
    std::fill(to + kept, to + stride_, 0.0);
  }
  for (int j = kept; j < n_; ++j) std::fill_n(column(j), stride_, 0.0);
  for (int j = 0; j < kept; ++j) std::fill_n(column(j), j, 0.0);
  n_ = kept;
  if (form_ == OpportunisticForm::kSquareRoot) {
    for (int c = 0; c < count; ++c) {
      std::copy_n(lost + as_size(c) * as_size(stride_), stride_, w_.data());
      rank_one(first);
    }
  }
}

void OpportunisticFilter::move(int to, int from, double dt) noexcept {
  x_.data()[to] += dt * x_.data()[from];
  if (form_ == OpportunisticForm::kSquareRoot) {
    for (int j = 0; j <= from; ++j) column(j)[to] += dt * column(j)[from];
    return;
  }
  const double cross = column(from)[to];
  for (int j = 0; j < to; ++j) column(j)[to] += dt * (j <= from ? column(j)[from] : column(from)[j]);
  for (int i = to + 1; i < n_; ++i) column(to)[i] += dt * column(from)[i];
  column(to)[to] += dt * (cross + column(from)[to]);
}

void OpportunisticFilter::add_noise(int i, double variance) noexcept {
  if (form_ == OpportunisticForm::kJoseph) {
    column(i)[i] += variance;
    return;
  }
  std::fill_n(w_.data(), stride_, 0.0);
  w_.data()[i] = std::sqrt(variance);
  rank_one(i);
}

void OpportunisticFilter::add_noise(int rate_i, int value_i, double rate, double cross, double value) noexcept {
  if (form_ == OpportunisticForm::kJoseph) {
    column(rate_i)[rate_i] += rate;
    column(rate_i)[value_i] += cross;
    column(value_i)[value_i] += value;
    return;
  }
  double rest = value;
  if (rate > 0.0) {
    std::fill_n(w_.data(), stride_, 0.0);
    const double root = std::sqrt(rate);
    w_.data()[rate_i] = root;
    w_.data()[value_i] = cross / root;
    rest -= cross / rate * cross;
    rank_one(rate_i);
  }
  if (rest > 0.0) add_noise(value_i, rest);
}

void OpportunisticFilter::rank_one(int first) noexcept {
  double* w = w_.data();
  const int end = padded(n_);
  for (int j = first; j < n_; ++j) {
    if (w[j] == 0.0) continue;
    double* s = column(j);
    const double length = std::hypot(s[j], w[j]);
    rotate_in(s, w, j / kLine * kLine, end, s[j] / length, w[j] / length);
    w[j] = 0.0;
  }
}

void OpportunisticFilter::project(const TouchedRow& row, double* out) const noexcept {
  std::fill_n(out, padded(n_), 0.0);
  for (int c = 0; c < row.count; ++c) {
    const int g = row.index[as_size(c)];
    const double h = row.value[as_size(c)];
    const double* P = P_.data() + g;
    if (form_ == OpportunisticForm::kSquareRoot) {
      for (int j = 0; j <= g; ++j) out[j] += h * P[as_size(j) * as_size(stride_)];
    } else {
      for (int j = 0; j < g; ++j) out[j] += h * P[as_size(j) * as_size(stride_)];
      const double* s = column(g);
      for (int i = g; i < n_; ++i) out[i] += h * s[i];
    }
  }
}

void OpportunisticFilter::innovation_covariance(std::span<const TouchedRow> rows, std::span<const double> variance,
                                                double* out, int out_stride) noexcept {
  const int m = static_cast<int>(rows.size());
  for (int j = 0; j < m; ++j) std::fill_n(out + as_size(j) * as_size(out_stride), m, 0.0);
  if (form_ == OpportunisticForm::kJoseph) {
    for (int j = 0; j < m; ++j) {
      project(rows[as_size(j)], w_.data());
      double* column_out = out + as_size(j) * as_size(out_stride);
      for (int i = j; i < m; ++i) column_out[i] = rows[as_size(i)].dot(w_.data());
    }
  } else {
    // Component by component, four at a time: their parts of all rows lie one behind the other.
    const auto stride = as_size(padded(m));
    double* F = wide_.data();
    const int whole = (n_ + 3) / 4 * 4;
    std::fill_n(F, as_size(whole) * stride, 0.0);
    for (int i = 0; i < m; ++i) {
      const TouchedRow& row = rows[as_size(i)];
      for (int c = 0; c < row.count; ++c) {
        const int g = row.index[as_size(c)];
        const double h = row.value[as_size(c)];
        for (int k = 0; k <= g; ++k) F[as_size(k) * stride + as_size(i)] += h * column(k)[g];
      }
    }
    for (int k = 0; k < whole; k += 4) add_outer(out, as_size(out_stride), m, F + as_size(k) * stride, stride);
  }
  for (int j = 0; j < m; ++j) out[as_size(j) * as_size(out_stride) + as_size(j)] += variance[as_size(j)];
}

void OpportunisticFilter::save() noexcept {
  std::copy_n(x_.data(), n_, saved_x_.data());
  std::copy_n(P_.data(), as_size(n_) * as_size(stride_), saved_P_.data());
}

void OpportunisticFilter::restore() noexcept {
  std::copy_n(saved_x_.data(), n_, x_.data());
  std::copy_n(saved_P_.data(), as_size(n_) * as_size(stride_), P_.data());
}

void OpportunisticFilter::update(std::span<const TouchedRow> rows, std::span<const double> innovation,
                                 std::span<const double> variance, std::span<unsigned char> used) noexcept {
  std::fill_n(dx_.data(), stride_, 0.0);
  if (form_ == OpportunisticForm::kJoseph) {
    update_joseph(rows, innovation, variance, used);
  } else {
    update_root(rows, innovation, variance, used);
  }
  for (int i = 0; i < n_; ++i) x_.data()[i] += dx_.data()[i];
}

void OpportunisticFilter::update_joseph(std::span<const TouchedRow> rows, std::span<const double> innovation,
                                        std::span<const double> variance, std::span<unsigned char> used) noexcept {
  const auto stride = as_size(stride_);
  double* K = wide_.data();
  double* B = wide_.data() + kGroup * stride;
  double* diagonal = w_.data();
  for (std::size_t first = 0; first < rows.size(); first += kGroup) {
    const std::size_t count = std::min<std::size_t>(kGroup, rows.size() - first);
    std::fill_n(K, 2 * kGroup * stride, 0.0);
    for (int i = 0; i < n_; ++i) diagonal[i] = column(i)[i];
    for (std::size_t q = 0; q < count; ++q) {
      const TouchedRow& row = rows[first + q];
      double* b = B + q * stride;  // P hᵀ, with what the rows before it in the group changed
      double* k = K + q * stride;
      project(row, b);
      for (std::size_t e = 0; e < q; ++e) {
        const double by_k = row.dot(B + e * stride);
        const double by_b = row.dot(K + e * stride);
        for (int i = 0; i < n_; ++i) b[i] -= K[e * stride + as_size(i)] * by_k + B[e * stride + as_size(i)] * by_b;
      }
      const double r = variance[first + q];
      const double prior = row.dot(b);
      const double s = prior + r;
      const double step = (innovation[first + q] - row.dot(dx_.data())) / s;
      bool sound = s > 0.0 && std::isfinite(step);
      // Joseph's form of one row: P - K Bᵀ - B Kᵀ, B = (P hᵀ + (I - K h) P hᵀ - K r) / 2, for any K.
      for (int i = 0; i < n_ && sound; ++i) {
        k[i] = b[i] / s;
        b[i] = 0.5 * (b[i] + (b[i] - k[i] * prior - k[i] * r));
        const double left = diagonal[i] - 2.0 * k[i] * b[i];
        sound = left >= 0.0 && std::isfinite(left);
      }
      used[first + q] = sound;
      if (!sound) {
        std::fill_n(k, stride, 0.0);
        std::fill_n(b, stride, 0.0);
        continue;
      }
      for (int i = 0; i < n_; ++i) {
        diagonal[i] -= 2.0 * k[i] * b[i];
        dx_.data()[i] += k[i] * s * step;
      }
    }
    subtract_pairs(P_.data(), stride, n_, K, B);
  }
}

void OpportunisticFilter::update_root(std::span<const TouchedRow> rows, std::span<const double> innovation,
                                      std::span<const double> variance, std::span<unsigned char> used) noexcept {
  double* f = wide_.data();
  double* v = w_.data();
  for (std::size_t q = 0; q < rows.size(); ++q) {
    project(rows[q], f);
    double s = variance[q];
    for (int i = 0; i < n_; ++i) s += f[i] * f[i];
    const double step = (innovation[q] - rows[q].dot(dx_.data())) / s;
    used[q] = s > 0.0 && std::isfinite(s) && std::isfinite(step);
    if (used[q] == 0) continue;
    std::fill_n(v, padded(n_), 0.0);
    carlson(P_.data(), as_size(stride_), n_, f, variance[q], v);
    for (int i = 0; i < n_; ++i) dx_.data()[i] += v[i] * step;
  }
}

bool factorize_lower(double* A, int n, int stride, double tolerance, bool strict) noexcept {
  for (int j = 0; j < n; ++j) {
    double* column = A + as_size(j) * as_size(stride);
    // Right-looking: what is left of the column is final when its turn comes; its first value is not kept, so the
    // smallest pivot that counts is judged against what the earlier columns took away.
    double taken = 0.0;
    for (int k = 0; k < j; ++k) {
      const double l = A[as_size(k) * as_size(stride) + as_size(j)];
      taken += l * l;
    }
    const double pivot = column[j];
    if (!(pivot > tolerance * (pivot + taken)) || !std::isfinite(pivot)) {
      if (strict) return false;
      std::fill(column + j, column + n, 0.0);
      continue;
    }
    const double root = std::sqrt(pivot);
    column[j] = root;
    for (int i = j + 1; i < n; ++i) column[i] /= root;
    for (int k = j + 1; k < n; ++k) {
      subtract_multiple(A + as_size(k) * as_size(stride), column, column[k], k, n);
    }
  }
  return true;
}

void solve_lower(const double* L, int n, int stride, double* x, int first) noexcept {
  for (int j = first; j < n; ++j) {
    const double* column = L + as_size(j) * as_size(stride);
    x[j] = column[j] > 0.0 ? x[j] / column[j] : 0.0;
    if (x[j] != 0.0) subtract_multiple(x, column, x[j], j + 1, n);
  }
}

void solve_upper(const double* L, int n, int stride, double* x) noexcept {
  for (int j = n - 1; j >= 0; --j) {
    const double* column = L + as_size(j) * as_size(stride);
    double sum = x[j];
    for (int i = j + 1; i < n; ++i) sum -= column[i] * x[i];
    x[j] = column[j] > 0.0 ? sum / column[j] : 0.0;
  }
}

}  // namespace soopnav::navigation::detail
