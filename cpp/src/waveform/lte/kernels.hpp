#pragma once

#include <cstddef>

#include "soopnav/core/iq.hpp"

/// Inner loops of the LTE receiver. The widest vectors are chosen at run time and never change a result: the
/// element-wise loops have no reduction, and the sums keep a fixed number of lanes that are added in a fixed order.
namespace soopnav::lte::kernels {

/// (a.re b.re - a.im b.im, ...): a complex product without the NaN repair of operator*.
[[nodiscard]] inline Cf32 multiply(Cf32 a, Cf32 b) noexcept {
  return {a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real()};
}
/// a conj(b)
[[nodiscard]] inline Cf32 multiply_conj(Cf32 a, Cf32 b) noexcept {
  return {a.real() * b.real() + a.imag() * b.imag(), a.imag() * b.real() - a.real() * b.imag()};
}

/// sum_i a[i] b[i] of a few elements. Split sums: a complex accumulator is several times slower.
[[nodiscard]] inline Cf32 short_dot(const Cf32* a, const Cf32* b, std::size_t n) noexcept {
  float re = 0.0F, im = 0.0F;
  for (std::size_t i = 0; i < n; ++i) {
    const float ar = a[i].real(), ai = a[i].imag(), br = b[i].real(), bi = b[i].imag();
    re += ar * br - ai * bi;
    im += ar * bi + ai * br;
  }
  return {re, im};
}

/// out[i] = a[i] b[i]
void multiply(const Cf32* a, const Cf32* b, Cf32* out, std::size_t n) noexcept;

/// out[i] = scale a[i] b[i]
void multiply_scaled(const Cf32* a, const Cf32* b, Cf32 scale, Cf32* out, std::size_t n) noexcept;

/// sum[i] += |x[i]|^2
void accumulate_power(const Cf32* x, float* sum, std::size_t n) noexcept;

/// sum[i] += x[i]
void add(const float* x, float* sum, std::size_t n) noexcept;

/// x[i] *= factor[i]
void scale(const float* factor, float* x, std::size_t n) noexcept;

/// sum_i x[i]
[[nodiscard]] float sum(const float* x, std::size_t n) noexcept;

/// sum_i a[i] conj(b[i])
[[nodiscard]] Cf32 dot_conj(const Cf32* a, const Cf32* b, std::size_t n) noexcept;

/// sum_i a[i] b[i], real
[[nodiscard]] float dot(const float* a, const float* b, std::size_t n) noexcept;

/// sum_i |x[i]|^2
[[nodiscard]] double energy(const Cf32* x, std::size_t n) noexcept;

/// out[i] = |a[i] + b[i] turn[i]|^2
void power_of_sum(const Cf32* a, const Cf32* b, const Cf32* turn, float* out, std::size_t n) noexcept;

/// The largest element; n >= 1.
[[nodiscard]] float maximum(const float* x, std::size_t n) noexcept;

/// out[i] = exp(j 2 pi (start + i step)), phases in cycles. Exact to single precision for any n.
void phasors(double start_cycles, double step_cycles, Cf32* out, std::size_t n) noexcept;

}  // namespace soopnav::lte::kernels
