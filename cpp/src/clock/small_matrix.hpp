#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace soopnav::clock::detail {

/// A square matrix of a size that unrolls: what the recursions of characterisation are made of. No allocation.
template <std::size_t N>
struct Square {
  std::array<double, N * N> a{};

  [[nodiscard]] double& operator()(std::size_t i, std::size_t j) noexcept { return a[i * N + j]; }
  [[nodiscard]] double operator()(std::size_t i, std::size_t j) const noexcept { return a[i * N + j]; }

  Square& add(const Square& other, double factor = 1.0) noexcept {
    for (std::size_t i = 0; i < N * N; ++i) a[i] += factor * other.a[i];
    return *this;
  }
  [[nodiscard]] Square scaled(double factor) const noexcept {
    Square out;
    for (std::size_t i = 0; i < N * N; ++i) out.a[i] = factor * a[i];
    return out;
  }
  [[nodiscard]] Square transposed() const noexcept {
    Square out;
    for (std::size_t i = 0; i < N; ++i) {
      for (std::size_t j = 0; j < N; ++j) out(j, i) = (*this)(i, j);
    }
    return out;
  }
  /// (A + Aᵀ) / 2.
  [[nodiscard]] Square symmetric() const noexcept {
    Square out;
    for (std::size_t i = 0; i < N; ++i) {
      for (std::size_t j = 0; j < N; ++j) out(i, j) = 0.5 * ((*this)(i, j) + (*this)(j, i));
    }
    return out;
  }
  [[nodiscard]] friend Square operator*(const Square& x, const Square& y) noexcept {
    Square out;
    for (std::size_t i = 0; i < N; ++i) {
      for (std::size_t k = 0; k < N; ++k) {
        const double f = x(i, k);
        for (std::size_t j = 0; j < N; ++j) out(i, j) += f * y(k, j);
      }
    }
    return out;
  }
  [[nodiscard]] std::array<double, N> of(const std::array<double, N>& x) const noexcept {
    std::array<double, N> out{};
    for (std::size_t i = 0; i < N; ++i) {
      for (std::size_t j = 0; j < N; ++j) out[i] += (*this)(i, j) * x[j];
    }
    return out;
  }
};

template <std::size_t N>
[[nodiscard]] double dot(const std::array<double, N>& x, const std::array<double, N>& y) noexcept {
  double sum = 0.0;
  for (std::size_t i = 0; i < N; ++i) sum += x[i] * y[i];
  return sum;
}

/// Cholesky factor of a symmetric positive definite matrix, and what is solved with it.
template <std::size_t N>
struct Factor {
  Square<N> l;
  bool positive = true;
  double determinant = 1.0;

  explicit Factor(const Square<N>& s) noexcept {
    for (std::size_t j = 0; j < N; ++j) {
      double d = s(j, j);
      for (std::size_t k = 0; k < j; ++k) d -= l(j, k) * l(j, k);
      if (!(d > 0.0)) {
        positive = false;
        d = 1.0;
      }
      determinant *= d;
      l(j, j) = std::sqrt(d);
      for (std::size_t i = j + 1; i < N; ++i) {
        double sum = s(i, j);
        for (std::size_t k = 0; k < j; ++k) sum -= l(i, k) * l(j, k);
        l(i, j) = sum / l(j, j);
      }
    }
  }
  /// S⁻¹ x.
  [[nodiscard]] std::array<double, N> solve(std::array<double, N> x) const noexcept {
    for (std::size_t i = 0; i < N; ++i) {
      for (std::size_t k = 0; k < i; ++k) x[i] -= l(i, k) * x[k];
      x[i] /= l(i, i);
    }
    for (std::size_t i = N; i-- > 0;) {
      for (std::size_t k = i + 1; k < N; ++k) x[i] -= l(k, i) * x[k];
      x[i] /= l(i, i);
    }
    return x;
  }
  /// A S⁻¹, row by row.
  [[nodiscard]] Square<N> right_solve(const Square<N>& rows) const noexcept {
    Square<N> out;
    for (std::size_t i = 0; i < N; ++i) {
      std::array<double, N> row{};
      for (std::size_t j = 0; j < N; ++j) row[j] = rows(i, j);
      row = solve(row);
      for (std::size_t j = 0; j < N; ++j) out(i, j) = row[j];
    }
    return out;
  }
};

/// trace(A B).
template <std::size_t N>
[[nodiscard]] double trace_of_product(const Square<N>& x, const Square<N>& y) noexcept {
  double sum = 0.0;
  for (std::size_t i = 0; i < N; ++i) {
    for (std::size_t j = 0; j < N; ++j) sum += x(i, j) * y(j, i);
  }
  return sum;
}

}  // namespace soopnav::clock::detail
