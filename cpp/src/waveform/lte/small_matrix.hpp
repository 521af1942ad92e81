#pragma once

#include <array>
#include <cmath>
#include <complex>
#include <cstddef>
#include <type_traits>

/// Linear algebra of a handful of unknowns, written out: no heap, and quick to compile.
namespace soopnav::lte {

inline double conjugate(double x) noexcept { return x; }
inline std::complex<double> conjugate(const std::complex<double>& x) noexcept { return std::conj(x); }
inline double real_part(double x) noexcept { return x; }
inline double real_part(const std::complex<double>& x) noexcept { return x.real(); }
/// a b without the NaN repair of operator*.
inline double product(double a, double b) noexcept { return a * b; }
inline std::complex<double> product(const std::complex<double>& a, const std::complex<double>& b) noexcept {
  return {a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real()};
}

/// A matrix of at most `N` x `N`, row after row.
template <class T, std::size_t N>
struct SmallMatrix {
  std::array<T, N * N> values{};
  [[nodiscard]] T& operator()(int i, int j) noexcept {
    return values[static_cast<std::size_t>(i) * N + static_cast<std::size_t>(j)];
  }
  [[nodiscard]] const T& operator()(int i, int j) const noexcept {
    return values[static_cast<std::size_t>(i) * N + static_cast<std::size_t>(j)];
  }
};

/// Hermitian positive definite equations by Cholesky's factors, A = L L^H.
template <class T, std::size_t N>
class SmallCholesky {
 public:
  /// False when a pivot falls to `least` or below.
  [[nodiscard]] bool factor(const SmallMatrix<T, N>& a, int n, double least) noexcept {
    n_ = n;
    for (int j = 0; j < n; ++j) {
      for (int i = j; i < n; ++i) {
        T sum = a(i, j);
        for (int k = 0; k < j; ++k) sum -= product(l_(i, k), conjugate(l_(j, k)));
        if (i == j) {
          const double pivot = real_part(sum);
          if (!(pivot > least)) return false;
          diagonal_ = std::sqrt(pivot);
          l_(j, j) = diagonal_;
        } else {
          l_(i, j) = sum / diagonal_;
        }
      }
    }
    return true;
  }
  /// x = A^-1 x, elements `stride` apart.
  void solve(T* x, std::size_t stride = 1) const noexcept {
    for (int i = 0; i < n_; ++i) {
      T sum = x[static_cast<std::size_t>(i) * stride];
      for (int k = 0; k < i; ++k) sum -= product(l_(i, k), x[static_cast<std::size_t>(k) * stride]);
      x[static_cast<std::size_t>(i) * stride] = sum / real_part(l_(i, i));
    }
    for (int i = n_ - 1; i >= 0; --i) {
      T sum = x[static_cast<std::size_t>(i) * stride];
      for (int k = i + 1; k < n_; ++k) sum -= product(conjugate(l_(k, i)), x[static_cast<std::size_t>(k) * stride]);
      x[static_cast<std::size_t>(i) * stride] = sum / real_part(l_(i, i));
    }
  }
  /// Logarithm of the determinant.
  [[nodiscard]] double log_determinant() const noexcept {
    double sum = 0.0;
    for (int i = 0; i < n_; ++i) sum += 2.0 * std::log(real_part(l_(i, i)));
    return sum;
  }

 private:
  int n_ = 0;
  double diagonal_ = 1.0;
  SmallMatrix<T, N> l_;
};

}  // namespace soopnav::lte
