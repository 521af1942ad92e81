#pragma once

#include <cstddef>

#include "soopnav/core/iq.hpp"

/// Inner loops of the burst detector: element by element or in a fixed number of lanes, the same bits everywhere.
namespace soopnav::iridium::kernels {

/// Copies samples, zero for those that are not finite; returns how many were not.
std::size_t copy_finite(const Cf32* in, std::size_t n, Cf32* out) noexcept;

/// out[n] = window[n] in[n].
void weigh(const Cf32* in, const float* window, std::size_t n, Cf32* out) noexcept;

/// power[k] = |x[k]|^2.
void square(const Cf32* x, std::size_t n, float* power) noexcept;

/// Normalises a row in place, row[k] = min(row[k] inverse[k], most), and moves its median: median[k] grows by the share
/// step[k] where the row was above it and shrinks by as much where it was not.
void normalise(float* row, const float* inverse, float most, float* median, const float* step, std::size_t n) noexcept;

/// sum[k] += row[k] - old[k].
void slide(float* sum, const float* row, const float* old, std::size_t n) noexcept;

/// out[m] = sum_k taps[k] x[m stride + k], k < n, for real taps given twice each (taps[2k] = taps[2k+1]), n a multiple
/// of 4.
void filter(const Cf32* x, std::size_t stride, const float* taps, std::size_t n, Cf32* out,
            std::size_t outputs) noexcept;

}  // namespace soopnav::iridium::kernels
