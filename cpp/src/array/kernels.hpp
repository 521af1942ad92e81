#pragma once

#include <cstddef>

#include "soopnav/core/iq.hpp"

namespace soopnav::array::kernels {

inline constexpr std::size_t kLanes = 16;  ///< directions of a table lie in groups of so many

/// Sums over snapshots n = 0 .. count-1 of channels m = 0 .. channels-1, sample n of channel m at iq[m stride + n]:
///   power[m]      += |x_m|^2
///   re[p], im[p]  += Re, Im of x_i conj(x_j), for the pairs p of i > j in the order (1,0), (2,0), (2,1), (3,0) ...
/// 256 snapshots are summed in 16 lanes of single precision before they go into the double sums: the same bits on every
/// target.
void covariance_sums(const Cf32* iq, std::size_t channels, std::size_t stride, std::size_t count, double* power,
                     double* re, double* im) noexcept;

/// For groups g = 0 .. groups-1 of kLanes directions: out[i] = sum_k |sum_m conj(v_km) a_m(i)|^2, where the table has,
/// for each group, element 0's kLanes real parts, its imaginary parts, element 1's ... and v_km = (vectors[2 (k
/// elements
/// + m)], ... + 1). Returns the first index of the largest.
std::size_t scan(const float* table, std::size_t groups, std::size_t elements, const float* vectors, std::size_t count,
                 float* out) noexcept;

}  // namespace soopnav::array::kernels
