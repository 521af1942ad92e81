#include "soopnav/navigation/sop_fusion.hpp"

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <limits>

#include "soopnav/core/constants.hpp"

namespace soopnav::navigation {
namespace {

constexpr double kJitter = 1e-9;  // of the diagonal: room for a semi-definite covariance and for rounding
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

template <int N>
using SopMatrix = Eigen::Matrix<double, N, N>;

template <int N>
bool is_finite(const SopEstimate<N>& e) noexcept {
  return std::isfinite(e.t_s) && e.value.allFinite() && e.covariance.allFinite();
}

/// Cholesky of a covariance brought to unit diagonal: seconds squared and drifts squared differ by ten orders of
/// magnitude. By plain loops: for two and three numbers Eigen's take longer to compile than all the rest.
template <int N>
struct ScaledCholesky {
  Eigen::Matrix<double, N, 1> scale;
  SopMatrix<N> L;  ///< lower triangle
  bool ok = false;

  explicit ScaledCholesky(const SopMatrix<N>& P) noexcept {
    for (int i = 0; i < N; ++i) {
      scale[i] = std::sqrt(P(i, i));
      if (!(scale[i] > 0.0) || std::isinf(scale[i])) return;
    }
    for (int i = 0; i < N; ++i) {
      for (int j = 0; j <= i; ++j) {
        double rest = P(i, j) / scale[i] / scale[j];
        for (int k = 0; k < j; ++k) rest -= L(i, k) * L(j, k);
        if (i == j && !(rest > 0.0)) return;
        L(i, j) = i == j ? std::sqrt(rest) : rest / L(j, j);
        if (!std::isfinite(L(i, j))) return;
      }
    }
    ok = true;
  }
  /// x <- P^-1 x
  void solve(double* x) const noexcept {
    for (int i = 0; i < N; ++i) {
      x[i] /= scale[i];
      for (int k = 0; k < i; ++k) x[i] -= L(i, k) * x[k];
      x[i] /= L(i, i);
    }
    for (int i = N - 1; i >= 0; --i) {
      for (int k = i + 1; k < N; ++k) x[i] -= L(k, i) * x[k];
      x[i] /= L(i, i);
    }
    for (int i = 0; i < N; ++i) x[i] /= scale[i];
  }
  double log_det() const noexcept {
    double sum = 0.0;
    for (int i = 0; i < N; ++i) sum += std::log(scale[i]) + std::log(L(i, i));
    return 2.0 * sum;
  }
};

template <int N>
bool combine(const Eigen::Matrix<double, N, 1>& a, const SopMatrix<N>& A, const Eigen::Matrix<double, N, 1>& b,
             const SopMatrix<N>& B, SopEstimate<N>& out) noexcept {
  const ScaledCholesky<N> sum(A + B);
  if (!sum.ok || !a.allFinite() || !b.allFinite()) return false;
  SopMatrix<N> solved = A;
  for (int j = 0; j < N; ++j) sum.solve(solved.data() + j * N);
  const SopMatrix<N> K = solved.transpose();
  const SopMatrix<N> rest = SopMatrix<N>::Identity() - K;
  const SopMatrix<N> P = rest * A * rest.transpose() + K * B * K.transpose();
  const Eigen::Matrix<double, N, 1> x = a + K * (b - a);
  if (!P.allFinite() || !x.allFinite()) return false;
  out.value = x;
  out.covariance = 0.5 * (P + P.transpose());
  return true;
}

/// The weight of A in [0, 1] with the least determinant of their intersection.
template <int N>
double intersection_weight(const SopMatrix<N>& A, const SopMatrix<N>& B, double log_det_a, double log_det_b) noexcept {
  // ln det of the result at w; convex in w, so that a golden section finds its only minimum.
  const auto cost = [&](double w) noexcept {
    if (w <= 0.0) return log_det_b;
    if (w >= 1.0) return log_det_a;
    const ScaledCholesky<N> sum(SopMatrix<N>((1.0 - w) * A + w * B));  // w (1 - w) (A / w + B / (1 - w))
    return sum.ok ? log_det_a + log_det_b - sum.log_det() : std::numeric_limits<double>::infinity();
  };
  constexpr double kGolden = 0.6180339887498949;
  double low = 0.0, high = 1.0;
  double left = high - kGolden, right = low + kGolden;
  double at_left = cost(left), at_right = cost(right);
  for (int i = 0; i < 40; ++i) {
    if (at_left < at_right) {
      high = right;
      right = left;
      at_right = at_left;
      left = high - kGolden * (high - low);
      at_left = cost(left);
    } else {
      low = left;
      left = right;
      at_left = at_right;
      right = low + kGolden * (high - low);
      at_right = cost(right);
    }
  }
  double w = 0.5 * (low + high), best = cost(w);
  for (const double end : {0.0, 1.0}) {
    if (cost(end) <= best) best = cost(w = end);
  }
  return w;
}

template <int N>
SopEstimate<N> lifted(const SopEstimate<N>& e) noexcept {
  SopEstimate<N> out = e;
  out.covariance.diagonal() *= 1.0 + kJitter;
  return out;
}

/// How estimates go from one time to another.
struct Move {
  const clock::Oscillator* noise = nullptr;  ///< a clock's; otherwise a random walk
  double variance_per_s = 0.0;

  template <int N>
  bool operator()(SopEstimate<N>& e, double t_s) const noexcept {
    if constexpr (N == 2) {
      if (noise != nullptr) return move_clock(e, *noise, t_s);
    }
    return age(e, variance_per_s, t_s);
  }
};

/// Takes `next` into the filter `so_far`, which is empty at first.
template <int N>
bool take(bool& any, SopEstimate<N>& so_far, const SopEstimate<N>& next, const Move& move) noexcept {
  const SopEstimate<N> contribution = lifted(next);
  if (!any) {
    so_far = contribution;
    return any = ScaledCholesky<N>(contribution.covariance).ok && is_finite(contribution);
  }
  return move(so_far, contribution.t_s) && fuse_independent(so_far, contribution);
}

template <int N>
SopFusionStatus fuse_all(std::span<const SopEstimate<N>> all, double t_s, const Move& move,
                         SopEstimate<N>& out) noexcept {
  if (all.empty()) return SopFusionStatus::kEmpty;
  if (!std::isfinite(t_s)) return SopFusionStatus::kUndefined;
  std::size_t after = 0;  // the first later than t_s
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (!is_finite(all[i])) return SopFusionStatus::kUndefined;
    if (i > 0 && all[i].t_s < all[i - 1].t_s) return SopFusionStatus::kUnordered;
    if (all[i].t_s <= t_s) after = i + 1;
  }
  bool any = false, later = false;
  SopEstimate<N> result, backwards;
  for (std::size_t i = 0; i < after; ++i) {
    if (all[i].independent && !take(any, result, all[i], move)) return SopFusionStatus::kUndefined;
  }
  if (any && !move(result, t_s)) return SopFusionStatus::kUndefined;
  for (std::size_t i = all.size(); i > after; --i) {
    if (all[i - 1].independent && !take(later, backwards, all[i - 1], move)) return SopFusionStatus::kUndefined;
  }
  if (later) {
    if (!move(backwards, t_s)) return SopFusionStatus::kUndefined;
    if (!any) result = backwards;
    if (any && !fuse_independent(result, backwards)) return SopFusionStatus::kUndefined;
    any = true;
  }
  bool all_independent = true;
  for (const SopEstimate<N>& one : all) {
    if (one.independent) continue;
    all_independent = false;
    SopEstimate<N> moved = lifted(one);
    if (!move(moved, t_s)) return SopFusionStatus::kUndefined;
    if (!any) {
      if (!ScaledCholesky<N>(moved.covariance).ok) return SopFusionStatus::kUndefined;
      result = moved;
      any = true;
    } else if (std::isnan(intersect(result, moved))) {
      return SopFusionStatus::kUndefined;
    }
  }
  result.t_s = t_s;
  result.independent = all_independent;
  out = result;
  return SopFusionStatus::kOk;
}

}  // namespace

clock::Oscillator SopNoise::mean() const noexcept {
  return {std::exp(ln_h[0] + 0.5 * ln_covariance(0, 0)), std::exp(ln_h[1] + 0.5 * ln_covariance(1, 1))};
}

clock::Oscillator SopNoise::at_sigmas(double sigmas) const noexcept {
  return {std::exp(ln_h[0] + sigmas * std::sqrt(ln_covariance(0, 0))),
          std::exp(ln_h[1] + sigmas * std::sqrt(ln_covariance(1, 1)))};
}

bool move_clock(SopClock& clock, const clock::Oscillator& noise, double t_s) noexcept {
  const double dt = t_s - clock.t_s;
  const double span = std::abs(dt);
  const double s_f = 0.5 * noise.h0, s_g = 2.0 * kPi * kPi * noise.h_minus_2;  // [s²/s], [1/s]
  if (!(noise.h0 >= 0.0 && noise.h_minus_2 >= 0.0)) return false;
  SopClock next = clock;
  next.t_s = t_s;
  next.value[0] += dt * clock.value[1];
  const Eigen::Matrix2d& P = clock.covariance;
  const double cross = P(0, 1) + dt * P(1, 1) + 0.5 * s_g * dt * span;
  next.covariance << P(0, 0) + 2.0 * dt * P(0, 1) + dt * dt * P(1, 1) + s_f * span + s_g * span * span * span / 3.0,
      cross, cross, P(1, 1) + s_g * span;
  if (!is_finite(next)) return false;
  clock = next;
  return true;
}

template <int N>
bool age(SopEstimate<N>& estimate, double variance_per_s, double t_s) noexcept {
  SopEstimate<N> next = estimate;
  next.t_s = t_s;
  next.covariance.diagonal().array() += variance_per_s * std::abs(t_s - estimate.t_s);
  if (!(variance_per_s >= 0.0) || !is_finite(next)) return false;
  estimate = next;
  return true;
}

template <int N>
double disagreement(const SopEstimate<N>& a, const SopEstimate<N>& b) noexcept {
  const double times = a.independent && b.independent ? 1.0 : 2.0;
  const SopMatrix<N> P = times * (a.covariance + b.covariance);
  const ScaledCholesky<N> llt(P);
  const Eigen::Matrix<double, N, 1> d = a.value - b.value;
  if (!llt.ok || !d.allFinite()) return std::numeric_limits<double>::infinity();
  Eigen::Matrix<double, N, 1> solved = d;
  llt.solve(solved.data());
  return d.dot(solved);
}

template <int N>
bool fuse_independent(SopEstimate<N>& a, const SopEstimate<N>& b) noexcept {
  return combine<N>(a.value, a.covariance, b.value, b.covariance, a);
}

template <int N>
double intersect(SopEstimate<N>& a, const SopEstimate<N>& b) noexcept {
  const SopMatrix<N> A = a.covariance, B = b.covariance;
  const ScaledCholesky<N> of_a(A), of_b(B);
  if (!of_a.ok || !of_b.ok || !is_finite(a) || !is_finite(b)) return kNan;
  const double w = intersection_weight(A, B, of_a.log_det(), of_b.log_det());
  if (w == 0.0) {
    a.value = b.value;
    a.covariance = B;
  } else if (w < 1.0 && !combine<N>(a.value, A / w, b.value, B / (1.0 - w), a)) {
    return kNan;
  }
  a.independent = false;
  return w;
}

SopFusionStatus fuse_clocks(std::span<const SopClock> clocks, const clock::Oscillator& noise, double t_s,
                            SopClock& out) noexcept {
  return fuse_all<2>(clocks, t_s, {&noise, 0.0}, out);
}

template <int N>
SopFusionStatus fuse_constants(std::span<const SopEstimate<N>> estimates, double variance_per_s, double t_s,
                               SopEstimate<N>& out) noexcept {
  return fuse_all<N>(estimates, t_s, {nullptr, variance_per_s}, out);
}

double least_drift_variance(const clock::Oscillator& noise, double duration_s) noexcept {
  if (!(noise.h0 > 0.0 && noise.h_minus_2 > 0.0 && duration_s > 0.0)) return kNan;
  const double s_f = 0.5 * noise.h0, s_g = 2.0 * kPi * kPi * noise.h_minus_2;
  return std::sqrt(s_f) * std::sqrt(s_g) / std::tanh(duration_s * std::sqrt(s_g / s_f));
}

double least_ln_walk_variance(const clock::Oscillator& noise, double duration_s) noexcept {
  if (!(noise.h0 > 0.0 && noise.h_minus_2 > 0.0 && duration_s > 0.0)) return kNan;
  return 4.0 / (kPi * duration_s * std::sqrt(noise.h_minus_2 / noise.h0));
}

template bool age<2>(SopEstimate<2>&, double, double) noexcept;
template bool age<3>(SopEstimate<3>&, double, double) noexcept;
template double disagreement<2>(const SopEstimate<2>&, const SopEstimate<2>&) noexcept;
template double disagreement<3>(const SopEstimate<3>&, const SopEstimate<3>&) noexcept;
template bool fuse_independent<2>(SopEstimate<2>&, const SopEstimate<2>&) noexcept;
template bool fuse_independent<3>(SopEstimate<3>&, const SopEstimate<3>&) noexcept;
template double intersect<2>(SopEstimate<2>&, const SopEstimate<2>&) noexcept;
template double intersect<3>(SopEstimate<3>&, const SopEstimate<3>&) noexcept;
template SopFusionStatus fuse_constants<2>(std::span<const SopEstimate<2>>, double, double, SopEstimate<2>&) noexcept;
template SopFusionStatus fuse_constants<3>(std::span<const SopEstimate<3>>, double, double, SopEstimate<3>&) noexcept;

}  // namespace soopnav::navigation
