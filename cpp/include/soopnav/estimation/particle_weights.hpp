#pragma once

#include <cstddef>
#include <span>

namespace soopnav::detail {

/// Sums over one chunk of weights exp(l - largest): what the whole's ESS and likelihood are put together from.
struct WeightSums {
  double largest;  ///< log-weight; -infinity when no particle has any weight
  double sum;
  double squares;  ///< of the squared weights
};

/// Of `n` log-weights (a multiple of the packet's width, at most a chunk), none of them NaN or +infinity.
template <class T>
[[nodiscard]] WeightSums weigh_chunk(const T* log_weights, std::size_t n) noexcept;

/// exp(l - reference) of `n` log-weights into `weights`.
template <class T>
void relative_weights(const T* log_weights, double reference, std::size_t n, double* weights) noexcept;

/// The sums of all chunks, relative to the largest of all. `sum` is 0 when there is no weight at all.
[[nodiscard]] WeightSums join(std::span<const WeightSums> chunks) noexcept;

/// e^x, ln x and atan2(y, x) with the same bits everywhere (core/packet_math.hpp).
[[nodiscard]] double portable_exp(double x) noexcept;
[[nodiscard]] double portable_log(double x) noexcept;
[[nodiscard]] double portable_atan2(double y, double x) noexcept;

}  // namespace soopnav::detail
