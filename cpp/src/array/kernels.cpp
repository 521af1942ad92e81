#include "array/kernels.hpp"

#include <algorithm>
#include <cstring>

#include "core/target_clones.hpp"

namespace soopnav::array::kernels {
namespace {

#define SOOPNAV_INLINE inline __attribute__((always_inline))

// Sixteen floats: an AVX-512 register, two of AVX2 or four of SSE. Even lanes hold real parts in samples.
using Lanes = float __attribute__((vector_size(64)));
static_assert(sizeof(Lanes) == kLanes * sizeof(float));
constexpr std::size_t kBlockFloats = 512;  // of one channel, summed in single precision
constexpr std::size_t kChunkGroups = 8;

SOOPNAV_INLINE void load(Lanes& out, const float* from) { std::memcpy(&out, from, sizeof out); }

SOOPNAV_INLINE double total(const Lanes& sum) {
  float lane[kLanes];
  std::memcpy(lane, &sum, sizeof lane);
  double out = 0.0;
  for (const float value : lane) out += static_cast<double>(value);
  return out;
}

SOOPNAV_INLINE double alternating(const Lanes& sum) {
  float lane[kLanes];
  std::memcpy(lane, &sum, sizeof lane);
  double out = 0.0;
  for (std::size_t i = 0; i < kLanes; i += 2) out += static_cast<double>(lane[i + 1]) - static_cast<double>(lane[i]);
  return out;
}

SOOPNAV_TARGET_CLONES_WIDE void sums(const float* x, std::size_t channels, std::size_t stride, std::size_t count,
                                     double* power, double* re, double* im) {
  for (std::size_t first = 0; first < count; first += kBlockFloats) {
    const std::size_t length = std::min(kBlockFloats, count - first);
    const std::size_t whole = length / kLanes * kLanes;
    std::size_t pair = 0;
    for (std::size_t i = 0; i < channels; ++i) {
      const float* const a = x + i * stride + first;
      float rest_a[kLanes] = {}, rest_b[kLanes] = {};
      std::memcpy(rest_a, a + whole, (length - whole) * sizeof(float));
      Lanes u, v, p{};
      for (std::size_t n = 0; n < whole; n += kLanes) {
        load(u, a + n);
        p += u * u;
      }
      load(u, rest_a);
      p += u * u;
      power[i] += total(p);
      for (std::size_t j = 0; j < i; ++j, ++pair) {
        const float* const b = x + j * stride + first;
        Lanes same{}, swap{};  // Re Re and Im Im; Re_i Im_j and Im_i Re_j
        for (std::size_t n = 0; n < whole; n += kLanes) {
          load(u, a + n);
          load(v, b + n);
          same += u * v;
          swap += u * __builtin_shufflevector(v, v, 1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14);
        }
        std::memcpy(rest_b, b + whole, (length - whole) * sizeof(float));
        load(u, rest_a);
        load(v, rest_b);
        same += u * v;
        swap += u * __builtin_shufflevector(v, v, 1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14);
        re[pair] += total(same);
        im[pair] += alternating(swap);
      }
    }
  }
}

template <std::size_t kElements>
SOOPNAV_INLINE void group_power(const float* at, std::size_t elements, const float* vectors, std::size_t count,
                                Lanes& power) {
  const std::size_t size = kElements == 0 ? elements : kElements;
  power = Lanes{};
  for (std::size_t k = 0; k < count; ++k) {
    const float* const v = vectors + 2 * k * size;
    Lanes re{}, im{};
    for (std::size_t m = 0; m < size; ++m) {
      Lanes ar, ai;
      load(ar, at + 2 * m * kLanes);
      load(ai, at + (2 * m + 1) * kLanes);
      re += v[2 * m] * ar + v[2 * m + 1] * ai;
      im += v[2 * m] * ai - v[2 * m + 1] * ar;
    }
    power += re * re + im * im;
  }
}

template <std::size_t kElements>
SOOPNAV_INLINE std::size_t scan_all(const float* table, std::size_t groups, std::size_t elements, const float* vectors,
                                    std::size_t count, float* out) {
  const std::size_t size = kElements == 0 ? elements : kElements;
  float best = -1.0F;
  std::size_t best_chunk = 0;
  for (std::size_t chunk = 0; chunk < groups; chunk += kChunkGroups) {
    const std::size_t end = std::min(groups, chunk + kChunkGroups);
    Lanes most{};
    for (std::size_t g = chunk; g < end; ++g) {
      Lanes power;
      group_power<kElements>(table + g * 2 * size * kLanes, elements, vectors, count, power);
      std::memcpy(out + g * kLanes, &power, sizeof power);
      most = power > most ? power : most;
    }
    float lane[kLanes];
    std::memcpy(lane, &most, sizeof lane);
    const float top = *std::max_element(lane, lane + kLanes);
    if (top > best) {
      best = top;
      best_chunk = chunk;
    }
  }
  const float* const from = out + best_chunk * kLanes;
  const float* const to = out + std::min(groups, best_chunk + kChunkGroups) * kLanes;
  return static_cast<std::size_t>(std::max_element(from, to) - out);
}

SOOPNAV_TARGET_CLONES_WIDE std::size_t scan_four(const float* table, std::size_t groups, const float* vectors,
                                                 std::size_t count, float* out) {
  return scan_all<4>(table, groups, 4, vectors, count, out);
}

SOOPNAV_TARGET_CLONES_WIDE std::size_t scan_any(const float* table, std::size_t groups, std::size_t elements,
                                                const float* vectors, std::size_t count, float* out) {
  return scan_all<0>(table, groups, elements, vectors, count, out);
}

}  // namespace

void covariance_sums(const Cf32* iq, std::size_t channels, std::size_t stride, std::size_t count, double* power,
                     double* re, double* im) noexcept {
  sums(reinterpret_cast<const float*>(iq), channels, 2 * stride, 2 * count, power, re, im);
}

std::size_t scan(const float* table, std::size_t groups, std::size_t elements, const float* vectors, std::size_t count,
                 float* out) noexcept {
  return elements == 4 ? scan_four(table, groups, vectors, count, out)
                       : scan_any(table, groups, elements, vectors, count, out);
}

}  // namespace soopnav::array::kernels
