#include "waveform/lte/path_subspace.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "waveform/lte/small_matrix.hpp"

namespace soopnav::lte {

namespace {
using Complex = std::complex<double>;
constexpr double kTwoPi = 2.0 * std::numbers::pi;
constexpr int kRows = PathSubspace::kRows;

template <class T>
using Square = SmallMatrix<T, static_cast<std::size_t>(kRows)>;
template <class T>
using Vectors = std::array<std::array<T, static_cast<std::size_t>(kRows)>, kMaxResolved>;

template <class T>
void multiply(const Square<T>& r, const std::array<T, static_cast<std::size_t>(kRows)>& x, int n,
              std::array<T, static_cast<std::size_t>(kRows)>& out) {
  for (int i = 0; i < n; ++i) out[static_cast<std::size_t>(i)] = T{};
  for (int j = 0; j < n; ++j) {  // columns (rows' conjugates): the inner loop runs along memory
    const T factor = x[static_cast<std::size_t>(j)];
    const T* row = &r(j, 0);
    for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) out[i] += product(conjugate(row[i]), factor);
  }
}

// Eigenvectors of the `keep` largest eigenvalues by orthogonal iteration on the square of r, started from unlike
// columns of it; eigenvalues from r itself, descending.
template <class T>
void leading_eigenvectors(const Square<T>& r, int n, int keep, std::array<double, kMaxResolved>& values,
                          Vectors<T>& vectors) {
  static constexpr int kIterations = 14;
  Vectors<T> image;
  for (int k = 0; k < keep; ++k) {
    for (int i = 0; i < n; ++i)
      vectors[static_cast<std::size_t>(k)][static_cast<std::size_t>(i)] = r(i, (k * n) / keep);
  }
  for (int iteration = 0; iteration <= kIterations; ++iteration) {
    for (std::size_t k = 0; k < static_cast<std::size_t>(keep); ++k) {
      if (iteration > 0) {
        multiply(r, vectors[k], n, image[k]);
        multiply(r, image[k], n, vectors[k]);
      }
    }
    // Gram and Schmidt, twice: the columns lean on the strongest one.
    for (std::size_t k = 0; k < static_cast<std::size_t>(keep); ++k) {
      for (int pass = 0; pass < 2; ++pass) {
        for (std::size_t m = 0; m < k; ++m) {
          T along{};
          for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
            along += product(conjugate(vectors[m][i]), vectors[k][i]);
          }
          for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) vectors[k][i] -= product(vectors[m][i], along);
        }
        double square = 0.0;
        for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) square += std::norm(vectors[k][i]);
        const double scale = square > 0.0 ? 1.0 / std::sqrt(square) : 0.0;
        for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) vectors[k][i] *= scale;
      }
    }
  }
  for (std::size_t k = 0; k < static_cast<std::size_t>(keep); ++k) {
    multiply(r, vectors[k], n, image[k]);
    double value = 0.0;
    for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
      value += real_part(product(conjugate(vectors[k][i]), image[k][i]));
    }
    values[k] = value;
  }
}

// Trace and logarithm of the determinant.
template <class T>
void summarise(Square<T>& r, int n, double& trace, double& log_determinant) {
  trace = 0.0;
  for (int i = 0; i < n; ++i) trace += real_part(r(i, i));
  SmallCholesky<T, static_cast<std::size_t>(kRows)> factors;
  Square<T> lifted = r;
  for (int i = 0; i < n; ++i) lifted(i, i) += 1e-12 * trace;
  log_determinant = factors.factor(lifted, n, 0.0) ? factors.log_determinant() : n * std::log(1e-12 * trace + 1e-300);
}

// Roots of a monic polynomial, coefficients from the constant one up, all at once (Durand and Kerner).
void roots(int degree, const std::array<Complex, kMaxResolved>& c, std::array<Complex, kMaxResolved>& z) {
  for (int i = 0; i < degree; ++i) z[static_cast<std::size_t>(i)] = std::polar(0.9, 0.4 + 2.3 * i);
  for (int iteration = 0; iteration < 200; ++iteration) {
    double moved = 0.0;
    for (int i = 0; i < degree; ++i) {
      const auto u = static_cast<std::size_t>(i);
      Complex value = 1.0, others = 1.0;
      for (int k = degree - 1; k >= 0; --k) value = product(value, z[u]) + c[static_cast<std::size_t>(k)];
      for (int k = 0; k < degree; ++k) {
        if (k != i) others = product(others, z[u] - z[static_cast<std::size_t>(k)]);
      }
      if (std::norm(others) < 1e-300) others = 1e-150;
      const Complex step = value / others;
      z[u] -= step;
      moved = std::max(moved, std::abs(step));
    }
    if (moved < 1e-13) break;
  }
}
}  // namespace

void PathSubspace::compute(const ChannelView& channel, double centre, SubspaceMethod method, bool ignore_gap) {
  const int half = static_cast<int>(channel.frequencies.size()) / 2;
  const int together = (half + kHalf - 1) / kHalf;  // neighbours that are averaged
  const int n = half / together;
  const int step = channel.frequencies[1] - channel.frequencies[0];
  centre_ = centre;
  ignore_gap_ = ignore_gap;
  window_ = std::clamp((3 * n) / 5, 2, kWindow);
  rows_ = 2 * window_;
  period_ = 1.0 / (step * together);

  // Averages of neighbours, the channel turned so that the strongest path lies at zero.
  std::array<std::array<Complex, 2 * kHalf>, kMaxPorts> y;
  std::array<double, 2 * kHalf> f{};
  for (int side = 0; side < 2; ++side) {
    for (int i = 0; i < n; ++i) {
      const int at = side * half + i * together;
      double sum_f = 0.0;
      for (int d = 0; d < together; ++d) sum_f += channel.frequencies[static_cast<std::size_t>(at + d)];
      const auto to = static_cast<std::size_t>(side * n + i);
      f[to] = sum_f / together;
      for (int p = 0; p < channel.ports; ++p) y[static_cast<std::size_t>(p)][to] = 0.0;
      for (int d = 0; d < together; ++d) {
        const Complex turn = std::polar(1.0, kTwoPi * centre * channel.frequencies[static_cast<std::size_t>(at + d)]);
        for (int p = 0; p < channel.ports; ++p) {
          const auto u = static_cast<std::size_t>(p);
          y[u][to] += Complex(channel.port[u][at + d]) * turn;
        }
      }
    }
  }
  // A snapshot: rows 0 ... window-1 of the lower half, then as many of the upper one; or, the gap ignored, of the
  // whole.
  const int places = ignore_gap ? 2 * n - rows_ + 1 : n - window_ + 1;
  const auto element = [&](int place, int row) {
    if (ignore_gap) return static_cast<std::size_t>(place + row);
    return static_cast<std::size_t>(row < window_ ? place + row : n + place + row - window_);
  };
  for (int row = 0; row < rows_; ++row) {
    position_[static_cast<std::size_t>(row)] = ignore_gap ? f[0] + row * step * together : f[element(0, row)];
  }
  snapshots_ = places * channel.ports;

  const bool both = method == SubspaceMethod::kEsprit;
  limit_ = std::min({kMaxResolved, rows_ - 2, (both ? 2 : 1) * snapshots_ - 1});
  filled_ = std::min(rows_, both ? 2 * snapshots_ : snapshots_);
  const double half_root = std::numbers::sqrt2 * 0.5;
  if (both) {
    // Forward-backward averaging makes the covariance real under a fixed unitary transform (eq. 4).
    Square<double> t;
    std::array<double, kRows> re, im;
    const int m = rows_ / 2;
    for (int p = 0; p < channel.ports; ++p) {
      const auto& x = y[static_cast<std::size_t>(p)];
      for (int place = 0; place < places; ++place) {
        for (int i = 0; i < m; ++i) {
          const Complex a = x[element(place, i)], b = x[element(place, rows_ - 1 - i)];
          const Complex sum = (a + b) * half_root, difference = (a - b) * half_root;
          const auto upper = static_cast<std::size_t>(i), lower = static_cast<std::size_t>(m + i);
          re[upper] = sum.real();
          im[upper] = sum.imag();
          re[lower] = difference.imag();  // -j (a - b)
          im[lower] = -difference.real();
        }
        for (int i = 0; i < rows_; ++i) {
          const double u = re[static_cast<std::size_t>(i)], v = im[static_cast<std::size_t>(i)];
          double* row = &t(i, 0);
          for (std::size_t j = 0; j < static_cast<std::size_t>(rows_); ++j) row[j] += u * re[j] + v * im[j];
        }
      }
    }
    Vectors<double> vectors;
    leading_eigenvectors(t, rows_, limit_, eigenvalues_, vectors);
    summarise(t, rows_, trace_, log_determinant_);
    for (std::size_t k = 0; k < static_cast<std::size_t>(limit_); ++k) {
      for (std::size_t i = 0; i < static_cast<std::size_t>(m); ++i) {
        const Complex e(vectors[k][i] * half_root, vectors[k][static_cast<std::size_t>(m) + i] * half_root);
        signal_[k][i] = e;
        signal_[k][static_cast<std::size_t>(rows_ - 1) - i] = std::conj(e);
      }
    }
  } else {
    Square<Complex> r;
    std::array<Complex, kRows> x;
    for (int p = 0; p < channel.ports; ++p) {
      for (int place = 0; place < places; ++place) {
        for (int row = 0; row < rows_; ++row) {
          x[static_cast<std::size_t>(row)] = y[static_cast<std::size_t>(p)][element(place, row)];
        }
        for (int i = 0; i < rows_; ++i) {
          for (int j = 0; j < rows_; ++j) {
            r(i, j) += product(x[static_cast<std::size_t>(i)], std::conj(x[static_cast<std::size_t>(j)]));
          }
        }
      }
    }
    leading_eigenvectors(r, rows_, limit_, eigenvalues_, signal_);
    summarise(r, rows_, trace_, log_determinant_);
  }
}

int PathSubspace::order(int limit) const {
  // Wax and Kailath's criterion on the eigenvalues (eq. 5); without as many snapshots as rows it says nothing.
  if (filled_ < rows_) return 1;
  double best = 0.0, sum = trace_, log_sum = log_determinant_;
  int at = 1;
  for (int k = 1; k <= std::min({limit, limit_, rows_ - 1}); ++k) {
    const double value = eigenvalues_[static_cast<std::size_t>(k - 1)];
    sum -= value;
    log_sum -= std::log(std::max(value, 1e-300));
    const int rest = rows_ - k;
    const double likelihood = snapshots_ * (rest * std::log(std::max(sum, 1e-300) / rest) - log_sum);
    const double cost = likelihood + 0.5 * k * (2 * rows_ - k) * std::log(static_cast<double>(snapshots_));
    if (k == 1 || cost < best) {
      best = cost;
      at = k;
    }
  }
  return at;
}

bool PathSubspace::delays(int k, std::array<double, kMaxResolved>& out) const {
  if (k < 1 || k > limit_) return false;
  SmallMatrix<Complex, kMaxResolved> g, psi;
  for (int a = 0; a < k; ++a) {
    for (int b = 0; b < k; ++b) {
      for (int row = 0; row + 1 < rows_; ++row) {
        if (!ignore_gap_ && row == window_ - 1) continue;  // the next row is on the other side of the carrier
        const auto i = static_cast<std::size_t>(row);
        const Complex left = std::conj(signal_[static_cast<std::size_t>(a)][i]);
        g(a, b) += product(left, signal_[static_cast<std::size_t>(b)][i]);
        psi(a, b) += product(left, signal_[static_cast<std::size_t>(b)][i + 1]);
      }
    }
  }
  SmallCholesky<Complex, kMaxResolved> solver;
  if (!solver.factor(g, k, 1e-9)) return false;
  for (int b = 0; b < k; ++b) solver.solve(&psi(0, b), kMaxResolved);
  // Characteristic polynomial (Faddeev and Le Verrier): M = psi M + c I, c = -trace(psi M) / step.
  std::array<Complex, kMaxResolved> coefficient{}, z{};
  SmallMatrix<Complex, kMaxResolved> m, image;
  for (int i = 0; i < k; ++i) m(i, i) = 1.0;
  for (int step = 1; step <= k; ++step) {
    Complex trace = 0.0;
    for (int i = 0; i < k; ++i) {
      for (int j = 0; j < k; ++j) {
        Complex sum = 0.0;
        for (int l = 0; l < k; ++l) sum += product(psi(i, l), m(l, j));
        image(i, j) = sum;
      }
      trace += image(i, i);
    }
    const Complex c = -trace / static_cast<double>(step);
    coefficient[static_cast<std::size_t>(k - step)] = c;
    m = image;
    for (int i = 0; i < k; ++i) m(i, i) += c;
  }
  roots(k, coefficient, z);
  for (std::size_t l = 0; l < static_cast<std::size_t>(k); ++l) {
    out[l] = centre_ - std::arg(z[l]) / kTwoPi * period_;
    if (!std::isfinite(out[l])) return false;
    for (std::size_t i = l; i > 0 && out[i] < out[i - 1]; --i) std::swap(out[i], out[i - 1]);
  }
  return true;
}

double PathSubspace::music(double theta, int k) const {
  double inside = 0.0;
  for (int c = 0; c < std::min(k, limit_); ++c) {
    Complex sum = 0.0;
    for (int row = 0; row < rows_; ++row) {
      sum += std::conj(signal_[static_cast<std::size_t>(c)][static_cast<std::size_t>(row)]) *
             std::polar(1.0, -kTwoPi * position_[static_cast<std::size_t>(row)] * (theta - centre_));
    }
    inside += std::norm(sum);
  }
  return 1.0 / std::max(1.0 - inside / rows_, 1e-12);
}

}  // namespace soopnav::lte
