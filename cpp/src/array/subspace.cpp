#include "soopnav/array/subspace.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>

#include "array/require.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::array {

namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();
constexpr int kMaxSweeps = 40;
constexpr int kMaxAberth = 500;

void require_sources(int n_sources, Eigen::Index elements) {
  require(n_sources >= 1 && n_sources < elements, "n_sources", n_sources,
          "1 to the number of elements less one expected");
}

void require_spacing(double spacing) {
  require(std::isfinite(spacing) && spacing > 0.0, "spacing_wavelengths", spacing, "a positive finite number expected");
}

double angle_of(double phase_rad, double spacing) {
  return std::asin(std::clamp(phase_rad / (kTwoPi * spacing), -1.0, 1.0));
}

/// Zeroes (p, q) of A by a unitary rotation from both sides, and turns V's columns along.
void rotate(ComplexMatrix& A, ComplexMatrix& V, Eigen::Index p, Eigen::Index q) {
  const Cf64 off = A(p, q);
  const double size = std::abs(off);
  const Cf64 turn = off / size;  // exp(j arg A_pq)
  const double tau = (A(q, q).real() - A(p, p).real()) / (2.0 * size);
  const double t = (tau >= 0.0 ? 1.0 : -1.0) / (std::abs(tau) + std::sqrt(1.0 + tau * tau));
  const double c = 1.0 / std::sqrt(1.0 + t * t), s = t * c;
  const Cf64 s_turn(s * turn.real(), s * turn.imag());
  const auto times = [](const Cf64& a, const Cf64& b) {  // without std::complex's check for infinities
    return Cf64(a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real());
  };
  const double shift = t * size;
  const double app = A(p, p).real() - shift, aqq = A(q, q).real() + shift;
  for (Eigen::Index i = 0; i < A.rows(); ++i) {
    const Cf64 vp = V(i, p), vq = V(i, q);
    V(i, p) = c * vp - times(std::conj(s_turn), vq);
    V(i, q) = times(s_turn, vp) + c * vq;
    if (i == p || i == q) continue;
    const Cf64 ap = A(i, p), aq = A(i, q);
    A(i, p) = c * ap - times(std::conj(s_turn), aq);
    A(i, q) = times(s_turn, ap) + c * aq;
    A(p, i) = std::conj(A(i, p));
    A(q, i) = std::conj(A(i, q));
  }
  A(p, p) = app;
  A(q, q) = aqq;
  A(p, q) = A(q, p) = 0.0;
}

}  // namespace

bool hermitian_eigen(const ComplexMatrix& R, HermitianEigen& out) noexcept {
  const Eigen::Index n = R.rows();
  if (n < 1 || R.cols() != n) return false;
  ComplexMatrix A(n, n), V(n, n);
  double scale = 0.0;
  for (Eigen::Index j = 0; j < n; ++j) {
    for (Eigen::Index i = j; i < n; ++i) {
      const Cf64 value = i == j ? Cf64(R(i, i).real(), 0.0) : R(i, j);
      if (!std::isfinite(value.real()) || !std::isfinite(value.imag())) return false;
      A(i, j) = value;
      A(j, i) = std::conj(value);
      V(i, j) = V(j, i) = i == j ? 1.0 : 0.0;
      scale = std::max({scale, std::abs(value.real()), std::abs(value.imag())});
    }
  }
  for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
    bool done = true;
    for (Eigen::Index q = 1; q < n; ++q) {
      for (Eigen::Index p = 0; p < q; ++p) {
        if (std::norm(A(p, q)) <= 0.01 * kEps * kEps * scale * scale) continue;
        rotate(A, V, p, q);
        done = false;
      }
    }
    if (done) break;
  }
  std::array<Eigen::Index, kMaxElements> order{};
  for (Eigen::Index i = 0; i < n; ++i) order[static_cast<std::size_t>(i)] = i;
  std::sort(order.begin(), order.begin() + n, [&A](Eigen::Index a, Eigen::Index b) {
    const double x = A(a, a).real(), y = A(b, b).real();
    return x > y || (x == y && a < b);
  });
  out.values.resize(n);
  out.vectors.resize(n, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Index from = order[static_cast<std::size_t>(i)];
    out.values[i] = A(from, from).real();
    out.vectors.col(i) = V.col(from);
  }
  return true;
}

bool has_rank(const HermitianEigen& eigen, int rank) noexcept {
  const Eigen::Index n = eigen.values.size();
  return rank >= 1 && rank <= n && eigen.values[0] > 0.0 &&
         eigen.values[rank - 1] > static_cast<double>(n) * kEps * eigen.values[0];
}

double noise_variance(const HermitianEigen& eigen, int n_sources) noexcept {
  double sum = 0.0;
  const Eigen::Index n = eigen.values.size();
  for (Eigen::Index i = n_sources; i < n; ++i) sum += eigen.values[i];
  return std::max(0.0, sum / static_cast<double>(std::max<Eigen::Index>(1, n - n_sources)));
}

ArrayStatus spectrum(Spectrum kind, const HermitianEigen& eigen, std::span<const Cf64> steering, int n_sources,
                     double loading, std::span<double> out) {
  const auto elements = static_cast<std::size_t>(eigen.values.size());
  const std::size_t count = out.size();
  require(steering.size() == elements * count, "steering", steering.size(), "M x G values expected");
  require(std::isfinite(loading) && loading >= 0.0, "loading", loading, "a finite number >= 0 expected");
  std::array<double, kMaxElements> weight{};
  std::size_t first = 0;
  const double load = loading * eigen.values.mean();
  if (kind == Spectrum::kMusic) {
    require_sources(n_sources, eigen.values.size());
    if (!has_rank(eigen, n_sources)) return ArrayStatus::kSingular;
    first = static_cast<std::size_t>(n_sources);
  }
  if (kind == Spectrum::kCapon) {
    const double least = eigen.values[eigen.values.size() - 1] + load;
    if (!(least > static_cast<double>(elements) * kEps * (eigen.values[0] + load))) return ArrayStatus::kSingular;
  }
  for (std::size_t k = first; k < elements; ++k) {
    const double value = eigen.values[static_cast<Eigen::Index>(k)];
    weight[k] = kind == Spectrum::kBartlett ? value : kind == Spectrum::kCapon ? 1.0 / (value + load) : 1.0;
  }
  for (std::size_t g = 0; g < count; ++g) {
    double form = 0.0;
    for (std::size_t k = first; k < elements; ++k) {
      double re = 0.0, im = 0.0;
      for (std::size_t m = 0; m < elements; ++m) {
        const Cf64& v = eigen.vectors(static_cast<Eigen::Index>(m), static_cast<Eigen::Index>(k));
        const Cf64& a = steering[m * count + g];
        re += v.real() * a.real() + v.imag() * a.imag();
        im += v.real() * a.imag() - v.imag() * a.real();
      }
      form += weight[k] * (re * re + im * im);
    }
    out[g] = kind == Spectrum::kBartlett ? form : 1.0 / form;
  }
  return ArrayStatus::kOk;
}

bool polynomial_roots(std::span<const Cf64> coefficients, std::span<Cf64> roots) noexcept {
  const std::size_t degree = coefficients.empty() ? 0 : coefficients.size() - 1;
  if (degree < 1 || degree > 2 * kMaxElements || roots.size() != degree) return false;
  double largest = 0.0;
  for (const Cf64& c : coefficients) {
    if (!std::isfinite(c.real()) || !std::isfinite(c.imag())) return false;
    largest = std::max(largest, std::abs(c));
  }
  if (!(std::abs(coefficients.front()) > 0.0)) return false;
  for (std::size_t i = 0; i < degree; ++i) {  // spread off the unit circle, without a symmetry
    const double radius = 0.9 + 0.2 * static_cast<double>(i % 3) / 3.0;
    roots[i] = std::polar(radius, kTwoPi * (static_cast<double>(i) + 0.27) / static_cast<double>(degree));
  }
  for (int iteration = 0; iteration < kMaxAberth; ++iteration) {
    double moved = 0.0;
    for (std::size_t i = 0; i < degree; ++i) {
      const Cf64 z = roots[i];
      Cf64 value = coefficients[0], slope = 0.0;
      double bound = std::abs(coefficients[0]);
      for (std::size_t k = 1; k <= degree; ++k) {
        slope = slope * z + value;
        value = value * z + coefficients[k];
        bound = bound * std::abs(z) + std::abs(coefficients[k]);
      }
      if (std::abs(value) <= 4.0 * kEps * bound) continue;  // nothing but rounding is left
      const Cf64 newton = value / slope;
      Cf64 repulsion = 0.0;
      for (std::size_t j = 0; j < degree; ++j) {
        if (j != i) repulsion += 1.0 / (z - roots[j]);
      }
      const Cf64 step = newton / (1.0 - newton * repulsion);
      if (!std::isfinite(step.real()) || !std::isfinite(step.imag())) {
        roots[i] = z * Cf64(1.0, 1e-3) + Cf64(1e-3, 0.0);
        moved = 1.0;
        continue;
      }
      roots[i] = z - step;
      moved = std::max(moved, std::abs(step) / std::max(1e-3, std::abs(roots[i])));
    }
    if (moved < 4.0 * kEps) return true;
  }
  return std::all_of(roots.begin(), roots.end(),
                     [](const Cf64& z) { return std::isfinite(z.real()) && std::isfinite(z.imag()); });
}

ArrayStatus root_music(const HermitianEigen& eigen, double spacing_wavelengths, std::span<double> out) {
  const Eigen::Index n = eigen.values.size();
  require_sources(static_cast<int>(out.size()), n);
  require_spacing(spacing_wavelengths);
  const auto sources = static_cast<Eigen::Index>(out.size());
  if (!has_rank(eigen, static_cast<int>(sources))) return ArrayStatus::kSingular;
  // D(z) = sum_l c_l z^l, c_l the sum of the l-th diagonal of En En^H = I - Es Es^H (doc/array.md eq. 8).
  std::array<Cf64, 2 * kMaxElements> coefficients{}, roots{};
  const auto degree = static_cast<std::size_t>(2 * (n - 1));
  for (Eigen::Index lag = 0; lag < n; ++lag) {
    Cf64 sum = lag == 0 ? Cf64(static_cast<double>(n), 0.0) : Cf64(0.0, 0.0);
    for (Eigen::Index k = 0; k < sources; ++k) {
      for (Eigen::Index m = 0; m + lag < n; ++m) {
        sum -= eigen.vectors(m, k) * std::conj(eigen.vectors(m + lag, k));
      }
    }
    const auto middle = static_cast<std::size_t>(n - 1), off = static_cast<std::size_t>(lag);
    coefficients[middle - off] = sum;  // of z^(n-1+lag)
    coefficients[middle + off] = std::conj(sum);
  }
  std::size_t first = 0;  // leading zeros, and as many trailing ones: an ESPRIT-like degenerate subspace
  while (first < degree / 2 && std::abs(coefficients[first]) < 1e-14) ++first;
  const std::size_t found = degree - 2 * first;
  if (!polynomial_roots(std::span(coefficients).subspan(first, found + 1), std::span(roots).first(found))) {
    return ArrayStatus::kUnresolved;
  }
  // Roots come in pairs z, 1 / conj(z); of each pair the inner one. Double roots on the circle may both lie a little
  // off: sorted by |ln|z||, every other one counts.
  const auto end = roots.begin() + static_cast<std::ptrdiff_t>(found);
  const auto distance = [](const Cf64& z) { return std::abs(std::log(std::abs(z))); };
  std::sort(roots.begin(), end, [&](const Cf64& a, const Cf64& b) {
    const double x = distance(a), y = distance(b);
    return x < y || (x == y && std::arg(a) < std::arg(b));
  });
  std::array<bool, 2 * kMaxElements> used{};
  std::size_t count = 0;
  for (std::size_t i = 0; i < found && count < out.size(); ++i) {
    if (used[i]) continue;
    std::size_t partner = found;
    double nearest = std::numeric_limits<double>::infinity();
    for (std::size_t j = i + 1; j < found; ++j) {
      const double apart = used[j] ? nearest : std::abs(roots[j] - 1.0 / std::conj(roots[i]));
      if (apart < nearest) {
        nearest = apart;
        partner = j;
      }
    }
    Cf64 z = roots[i];
    if (partner < found) {
      used[partner] = true;
      if (distance(z) < 1e-6) z += roots[partner];  // the mean of a double root is good to all digits
    }
    out[count++] = angle_of(std::arg(z), spacing_wavelengths);
  }
  if (count < out.size()) return ArrayStatus::kUnresolved;
  std::sort(out.begin(), out.end());
  return ArrayStatus::kOk;
}

ArrayStatus esprit(const HermitianEigen& eigen, double spacing_wavelengths, bool total_least_squares,
                   std::span<double> out) {
  const Eigen::Index n = eigen.values.size();
  require_sources(static_cast<int>(out.size()), n);
  require_spacing(spacing_wavelengths);
  const auto k = static_cast<Eigen::Index>(out.size());
  if (!has_rank(eigen, static_cast<int>(k))) return ArrayStatus::kSingular;
  ComplexMatrix upper = eigen.vectors.block(0, 0, n - 1, k), lower = eigen.vectors.block(1, 0, n - 1, k);
  for (Eigen::Index m = 0; m < n - 1; ++m) {
    const double weight = std::sqrt(static_cast<double>(std::min(m + 1, n - 1 - m)));
    upper.row(m) *= weight;
    lower.row(m) *= weight;
  }
  ComplexMatrix left(k, k), right(k, k);  // left Psi = right
  if (total_least_squares) {
    // Eigenvectors of [U1 U2]^H [U1 U2], the smaller half V12, V22: Psi = -V12 V22^-1. Its Gram matrix is 2k x 2k.
    if (2 * k > kMaxElements) return ArrayStatus::kUnresolved;
    ComplexMatrix gram(2 * k, 2 * k);
    gram.topLeftCorner(k, k) = upper.adjoint().lazyProduct(upper);
    gram.topRightCorner(k, k) = upper.adjoint().lazyProduct(lower);
    gram.bottomLeftCorner(k, k) = lower.adjoint().lazyProduct(upper);
    gram.bottomRightCorner(k, k) = lower.adjoint().lazyProduct(lower);
    HermitianEigen parts;
    if (!hermitian_eigen(gram, parts)) return ArrayStatus::kNonFinite;
    // Psi V22 = -V12, so V22^T Psi^T = -V12^T: the transpose has the same eigenvalues.
    left = parts.vectors.block(k, k, k, k).transpose();
    right = -parts.vectors.block(0, k, k, k).transpose();
  } else {
    left = upper.adjoint().lazyProduct(upper);
    right = upper.adjoint().lazyProduct(lower);
  }
  // Gaussian elimination with pivots.
  for (Eigen::Index i = 0; i < k; ++i) {
    Eigen::Index pivot = i;
    for (Eigen::Index r = i + 1; r < k; ++r) {
      if (std::norm(left(r, i)) > std::norm(left(pivot, i))) pivot = r;
    }
    if (!(std::norm(left(pivot, i)) > 1e-28)) return ArrayStatus::kSingular;
    left.row(i).swap(left.row(pivot));
    right.row(i).swap(right.row(pivot));
    for (Eigen::Index r = 0; r < k; ++r) {
      if (r == i) continue;
      const Cf64 factor = left(r, i) / left(i, i);
      for (Eigen::Index c = i; c < k; ++c) left(r, c) -= factor * left(i, c);
      for (Eigen::Index c = 0; c < k; ++c) right(r, c) -= factor * right(i, c);
    }
  }
  for (Eigen::Index i = 0; i < k; ++i) right.row(i) /= left(i, i);
  // Characteristic polynomial by Faddeev and LeVerrier: the eigenvalues lie on the unit circle, so it is well scaled.
  std::array<Cf64, kMaxElements + 1> coefficients{};
  std::array<Cf64, kMaxElements> roots{};
  coefficients[0] = 1.0;
  ComplexMatrix power = ComplexMatrix::Identity(k, k);
  for (Eigen::Index i = 1; i <= k; ++i) {
    const ComplexMatrix product = right.lazyProduct(power);
    coefficients[static_cast<std::size_t>(i)] = -product.trace() / static_cast<double>(i);
    power = product;
    for (Eigen::Index d = 0; d < k; ++d) power(d, d) += coefficients[static_cast<std::size_t>(i)];
  }
  if (!polynomial_roots(std::span(coefficients).first(out.size() + 1), std::span(roots).first(out.size()))) {
    return ArrayStatus::kUnresolved;
  }
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = angle_of(std::arg(roots[i]), spacing_wavelengths);
  std::sort(out.begin(), out.end());
  return ArrayStatus::kOk;
}

int source_count(SourceCount kind, std::span<const double> eigenvalues, double n_snapshots) {
  const std::size_t n = eigenvalues.size();
  require(n >= (kind == SourceCount::kSorte ? 4U : 2U) && n <= static_cast<std::size_t>(kMaxElements), "eigenvalues", n,
          "2 (SORTE: 4) to 32 values expected");
  require(n_snapshots >= 1.0 && std::isfinite(n_snapshots), "n_snapshots", n_snapshots, "at least 1 expected");
  std::array<double, kMaxElements> sorted{};
  std::copy(eigenvalues.begin(), eigenvalues.end(), sorted.begin());
  if (!std::all_of(sorted.begin(), sorted.end(), [](double v) { return std::isfinite(v); })) return -1;
  std::sort(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(n), std::greater<>());
  if (!(sorted[0] > 0.0)) return -1;
  for (std::size_t i = 0; i < n; ++i) sorted[i] = std::max(sorted[i], kEps * sorted[0]);
  double best = std::numeric_limits<double>::infinity();
  int found = 0;
  if (kind == SourceCount::kSorte) {
    std::array<double, kMaxElements> gap{};
    for (std::size_t i = 0; i + 1 < n; ++i) gap[i] = sorted[i] - sorted[i + 1];
    const auto variance = [&](std::size_t first) {  // of the gaps from `first` on
      const auto count = static_cast<double>(n - 1 - first);
      double mean = 0.0, sum = 0.0;
      for (std::size_t i = first; i + 1 < n; ++i) mean += gap[i] / count;
      for (std::size_t i = first; i + 1 < n; ++i) sum += (gap[i] - mean) * (gap[i] - mean) / count;
      return sum;
    };
    for (std::size_t k = 1; k + 2 < n; ++k) {
      const double below = variance(k - 1);
      const double ratio = below > 0.0 ? variance(k) / below : std::numeric_limits<double>::infinity();
      if (ratio < best) {
        best = ratio;
        found = static_cast<int>(k);
      }
    }
    return found == 0 ? 1 : found;
  }
  for (std::size_t k = 0; k < n; ++k) {
    const auto rest = static_cast<double>(n - k);
    double mean = 0.0, logs = 0.0;
    for (std::size_t i = k; i < n; ++i) {
      mean += sorted[i] / rest;
      logs += std::log(sorted[i]) / rest;
    }
    const double free = static_cast<double>(k * (2 * n - k));
    const double fit = n_snapshots * rest * (std::log(mean) - logs);
    const double cost = kind == SourceCount::kMdl ? fit + 0.5 * free * std::log(n_snapshots) : fit + free;
    if (cost < best) {
      best = cost;
      found = static_cast<int>(k);
    }
  }
  return found;
}

}  // namespace soopnav::array
