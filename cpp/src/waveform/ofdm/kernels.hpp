#pragma once

#include <cstddef>

#include "soopnav/core/iq.hpp"

namespace soopnav::ofdm::kernels {

/// Adds, for columns j = 0 .. columns-1 of `rows` rows a_k(j) = y[k columns + j], b_k(j) = y[k columns + j + lag]:
///   same[2j], same[2j+1]  += sum_k Re a Re b, sum_k Im a Im b
///   swap[2j], swap[2j+1]  += sum_k Re a Im b, sum_k Im a Re b
///   power[2j], power[2j+1] += sum_k (Re a)^2, sum_k (Im a)^2      (left alone when it is null)
/// At most 64 rows are summed in single precision, in order, before they go into the double sums: the same bits on
/// every target.
void fold(const Cf32* y, std::size_t rows, std::size_t columns, std::size_t lag, double* same, double* swap,
          double* power) noexcept;

/// Weights of a folded pair's likelihood, for correlations r = 1 - q, q = floor + rho gap[i]: weight[i] = 1 / (1 -
/// r^2), and twice[i] = 2 q weight[i] = 2 / (1 + r). `n` is a multiple of 8; returns sum_i ln(1 - r^2). Where gap is 1
/// and rho + floor is 1, as in padding, it adds nothing.
double pair_weights(const float* gap, float floor, float rho, float* weight, float* twice, std::size_t n) noexcept;

/// sum_i a[i] x[i] + b[i] y[i] over `n`, a multiple of 8: eight single-precision lanes, summed in a fixed order.
float dot2(const float* a, const float* x, const float* b, const float* y, std::size_t n) noexcept;

/// sum_i ln g + e[i] / g, g = floor + a[i] + share (b[i] - a[i]), over `n`; every g from 1e-4 to 10.
double mixture_cost(const float* e, const float* a, const float* b, float floor, float share, std::size_t n) noexcept;

}  // namespace soopnav::ofdm::kernels
