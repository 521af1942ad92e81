#pragma once

#include <cstddef>

#include "soopnav/core/iq.hpp"

namespace soopnav::dsp::detail {

/// out[m] = sum_k (re[k] + j im[k]) x[m stride + k], k in [0, n_taps), n_taps a multiple of 16. Every tap stands twice
/// in `re` and `im`, as in `dot`.
void decimate(const float* re, const float* im, std::size_t n_taps, const Cf32* x, std::size_t stride,
              std::size_t n_out, Cf32* out) noexcept;

/// The same with real taps.
void decimate(const float* taps, std::size_t n_taps, const Cf32* x, std::size_t stride, std::size_t n_out,
              Cf32* out) noexcept;

/// out[l] = sum_n a[n + l] conj(b[n]) for l in [0, lags), over `n` samples, a multiple of 16. `exchanged` is b with
/// real and imaginary parts exchanged.
void correlate_lags(const Cf32* a, const Cf32* b, const Cf32* exchanged, std::size_t n, std::size_t lags,
                    Cf32* out) noexcept;

/// out[i] = a[i] conj(b[i]).
void multiply_conjugate(const Cf32* a, const Cf32* b, std::size_t n, Cf32* out) noexcept;

/// p[i] = |x[i]|^2 weight[i].
void weighted_power(const Cf32* x, const float* weight, std::size_t n, float* p) noexcept;

}  // namespace soopnav::dsp::detail
