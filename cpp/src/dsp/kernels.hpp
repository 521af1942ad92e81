#pragma once

#include <cstddef>

#include "soopnav/core/iq.hpp"

namespace soopnav::dsp::detail {

/// Window lengths of the dot products below are multiples of this.
inline constexpr std::size_t kDotSamples = 16;

/// sum_k taps[k] x[k] over `n` samples, `n` a multiple of kDotSamples. `taps` holds every real tap twice (2 n floats),
/// so that it lines up with interleaved samples. Accumulates in 32 float lanes, summed in a fixed order.
Cf32 dot(const float* taps, const Cf32* x, std::size_t n) noexcept;

/// (1 - mu) dot(low, x) + mu dot(high, x) in one pass.
Cf32 dot_between(const float* low, const float* high, float mu, const Cf32* x, std::size_t n) noexcept;

/// out[i] = sum_k taps[k] x[i + k] for i in [0, n_out), k in [0, n_taps), summed with k ascending.
void fir(const float* taps, std::size_t n_taps, const Cf32* x, std::size_t n_out, Cf32* out) noexcept;

/// a[i] *= b[i].
void multiply(Cf32* a, const Cf32* b, std::size_t n) noexcept;

}  // namespace soopnav::dsp::detail
