#include "soopnav/estimation/particle_weights.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <limits>

#include "core/target_clones.hpp"
#include "soopnav/core/packet_math.hpp"
#include "soopnav/estimation/particle_loop.hpp"
#include "soopnav/estimation/resampling.hpp"

namespace soopnav::detail {
namespace {

// e^x for x <= 0, element by element so that the widest vectors serve: `exp` of core/packet_math.hpp without what such
// arguments do not need. 0 where e^x is no normal number, and for -infinity.
template <class T>
SOOPNAV_INLINE T weight_exp(T x) noexcept {
  using C = PacketConstants<T>;
  using Bits = typename PacketMask<T>::Bits;
  constexpr T kLowest = sizeof(T) == 8 ? static_cast<T>(-708.0) : static_cast<T>(-87.0);
  const T inside = x > kLowest ? x : kLowest;
  const T shifted = inside * static_cast<T>(1.4426950408889634) + C::kMagic;
  const T n = shifted - C::kMagic;
  const T r = (inside - n * C::kLn2High) - n * C::kLn2Low;
  T sum = static_cast<T>(C::kExp[0]);
  for (std::size_t k = 1; k < C::kExp.size(); ++k) sum = sum * r + static_cast<T>(C::kExp[k]);
  const T e = T{1} + (r + r * r * sum);
  const Bits exponent = (std::bit_cast<Bits>(shifted) << C::kMantissa) + (C::kBias << C::kMantissa);
  const T value = e * std::bit_cast<T>(exponent);
  return x > kLowest ? value : T{0};
}

SOOPNAV_TARGET_CLONES_WIDE
void exp_chunk(const double* __restrict l, double reference, std::size_t n, double* __restrict w) noexcept {
  for (std::size_t i = 0; i < n; ++i) w[i] = weight_exp(l[i] - reference);
}
SOOPNAV_TARGET_CLONES_WIDE
void exp_chunk(const float* __restrict l, float reference, std::size_t n, float* __restrict w) noexcept {
  for (std::size_t i = 0; i < n; ++i) w[i] = weight_exp(l[i] - reference);
}
SOOPNAV_TARGET_CLONES_WIDE
void widen(const float* __restrict from, std::size_t n, double* __restrict to) noexcept {
  for (std::size_t i = 0; i < n; ++i) to[i] = static_cast<double>(from[i]);
}

template <class T>
SOOPNAV_INLINE T largest_of(const T* l, std::size_t n) noexcept {
  using P = Packet<T>;
  P most(-std::numeric_limits<T>::infinity());
  for (std::size_t i = 0; i < n; i += P::kWidth) most = max(most, P::load(l + i));
  return largest(most);
}
template <class T>
SOOPNAV_INLINE WeightSums sums_of(const T* w, std::size_t n, T top) noexcept {
  using P = Packet<T>;
  P total(T{0});
  P squares(T{0});
  for (std::size_t i = 0; i < n; i += P::kWidth) {
    const P x = P::load(w + i);
    total += x;
    squares += x * x;
  }
  return {static_cast<double>(top), static_cast<double>(sum(total)), static_cast<double>(sum(squares))};
}

// Compiled twice by hand: what target_clones copies has its packets taken apart for the baseline already.
template <class T>
T largest_portable(const T* l, std::size_t n) noexcept {
  return largest_of(l, n);
}
template <class T>
WeightSums sums_portable(const T* w, std::size_t n, T top) noexcept {
  return sums_of(w, n, top);
}
#if SOOPNAV_WIDE_LOOPS
template <class T>
[[gnu::flatten, gnu::target("avx2")]] T largest_wide(const T* l, std::size_t n) noexcept {
  return largest_of(l, n);
}
template <class T>
[[gnu::flatten, gnu::target("avx2")]] WeightSums sums_wide(const T* w, std::size_t n, T top) noexcept {
  return sums_of(w, n, top);
}
#endif

template <class T>
T largest_any(const T* l, std::size_t n) noexcept {
#if SOOPNAV_WIDE_LOOPS
  if (has_wide_loops()) return largest_wide(l, n);
#endif
  return largest_portable(l, n);
}
template <class T>
WeightSums sums_any(const T* w, std::size_t n, T top) noexcept {
#if SOOPNAV_WIDE_LOOPS
  if (has_wide_loops()) return sums_wide(w, n, top);
#endif
  return sums_portable(w, n, top);
}

template <class T>
WeightSums weigh(const T* l, std::size_t n) noexcept {
  const T top = largest_any(l, n);
  if (top == -std::numeric_limits<T>::infinity()) return {static_cast<double>(top), 0.0, 0.0};
  std::array<T, kParticleChunk> w;
  exp_chunk(l, top, n, w.data());
  return sums_any(w.data(), n, top);
}

}  // namespace

template <>
WeightSums weigh_chunk<double>(const double* log_weights, std::size_t n) noexcept {
  return weigh(log_weights, n);
}
template <>
WeightSums weigh_chunk<float>(const float* log_weights, std::size_t n) noexcept {
  return weigh(log_weights, n);
}
template <>
void relative_weights<double>(const double* log_weights, double reference, std::size_t n, double* weights) noexcept {
  exp_chunk(log_weights, reference, n, weights);
}
template <>
void relative_weights<float>(const float* log_weights, double reference, std::size_t n, double* weights) noexcept {
  std::array<float, kParticleChunk> w;
  exp_chunk(log_weights, static_cast<float>(reference), n, w.data());
  widen(w.data(), n, weights);
}

WeightSums join(std::span<const WeightSums> chunks) noexcept {
  WeightSums all{-std::numeric_limits<double>::infinity(), 0.0, 0.0};
  for (const WeightSums& c : chunks) all.largest = std::max(all.largest, c.largest);
  for (const WeightSums& c : chunks) {
    if (!(c.sum > 0.0)) continue;
    const double scale = portable_exp(c.largest - all.largest);
    all.sum += scale * c.sum;
    all.squares += scale * scale * c.squares;
  }
  return all;
}

double portable_exp(double x) noexcept { return exp(Packet<double>(x))[0]; }
double portable_log(double x) noexcept { return log(Packet<double>(x))[0]; }
double portable_atan2(double y, double x) noexcept { return atan2(Packet<double>(y), Packet<double>(x))[0]; }

}  // namespace soopnav::detail
