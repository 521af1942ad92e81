#include "waveform/ofdm/kernels.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/target_clones.hpp"

namespace soopnav::ofdm::kernels {
namespace {

#define SOOPNAV_INLINE inline __attribute__((always_inline))

// Eight floats: an AVX2 register or two of SSE.
using Lanes = float __attribute__((vector_size(32)));
constexpr std::size_t kLaneFloats = 8;
// Sixteen, eight samples: an AVX-512 register, two of AVX2 or four of SSE.
using WideLanes = float __attribute__((vector_size(64)));
constexpr std::size_t kWideFloats = 16;
constexpr std::size_t kStrip = 2;  // lanes whose sums stay in registers while the rows go by
constexpr std::size_t kStripFloats = kStrip * kWideFloats;
constexpr std::size_t kBlockSamples = 8192;  // of a block of rows, to stay in the nearest cache
constexpr std::size_t kMinRows = 8;
constexpr std::size_t kMaxRows = 64;

SOOPNAV_INLINE void load(Lanes& out, const float* from) { std::memcpy(&out, from, sizeof out); }

SOOPNAV_INLINE void load(WideLanes& out, const float* from) { std::memcpy(&out, from, sizeof out); }

SOOPNAV_INLINE void add_to(double* to, const WideLanes& sum) {
  float lane[kWideFloats];
  std::memcpy(lane, &sum, sizeof lane);
  for (std::size_t i = 0; i < kWideFloats; ++i) to[i] += static_cast<double>(lane[i]);
}

template <bool kPower>
SOOPNAV_INLINE void fold_strip(const float* y, std::size_t rows, std::size_t stride, std::size_t lag, double* same,
                               double* swap, double* power) {
  WideLanes s[kStrip] = {}, w[kStrip] = {}, p[kStrip] = {};
  for (std::size_t k = 0; k < rows; ++k, y += stride) {
    for (std::size_t u = 0; u < kStrip; ++u) {
      WideLanes a, b;
      load(a, y + u * kWideFloats);
      load(b, y + lag + u * kWideFloats);
      __builtin_prefetch(y + kMinRows * stride + u * kWideFloats);  // long rows: the next block's
      s[u] += a * b;
      w[u] += a * __builtin_shufflevector(b, b, 1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14);
      if constexpr (kPower) p[u] += a * a;
    }
  }
  for (std::size_t u = 0; u < kStrip; ++u) {
    add_to(same + u * kWideFloats, s[u]);
    add_to(swap + u * kWideFloats, w[u]);
    if constexpr (kPower) add_to(power + u * kWideFloats, p[u]);
  }
}

template <bool kPower>
SOOPNAV_INLINE void fold_all(const float* y, std::size_t rows, std::size_t columns, std::size_t lag, double* same,
                             double* swap, double* power) {
  const std::size_t stride = 2 * columns;
  const std::size_t most = std::clamp(kBlockSamples / columns, kMinRows, kMaxRows);
  for (std::size_t first = 0; first < rows; first += most) {
    const std::size_t block = std::min(most, rows - first);
    const float* const top = y + first * stride;
    std::size_t j = 0;
    for (; j + kStripFloats <= stride; j += kStripFloats) {
      fold_strip<kPower>(top + j, block, stride, lag, same + j, swap + j, kPower ? power + j : nullptr);
    }
    for (; j < stride; j += 2) {
      float s0 = 0.0F, s1 = 0.0F, w0 = 0.0F, w1 = 0.0F, p0 = 0.0F, p1 = 0.0F;
      for (std::size_t k = 0; k < block; ++k) {
        const float* const a = top + k * stride + j;
        const float* const b = a + lag;
        s0 += a[0] * b[0];
        s1 += a[1] * b[1];
        w0 += a[0] * b[1];
        w1 += a[1] * b[0];
        if constexpr (kPower) {
          p0 += a[0] * a[0];
          p1 += a[1] * a[1];
        }
      }
      same[j] += static_cast<double>(s0);
      same[j + 1] += static_cast<double>(s1);
      swap[j] += static_cast<double>(w0);
      swap[j + 1] += static_cast<double>(w1);
      if constexpr (kPower) {
        power[j] += static_cast<double>(p0);
        power[j + 1] += static_cast<double>(p1);
      }
    }
  }
}

SOOPNAV_TARGET_CLONES_WIDE void fold_cross(const float* y, std::size_t rows, std::size_t columns, std::size_t lag,
                                           double* same, double* swap) {
  fold_all<false>(y, rows, columns, lag, same, swap, nullptr);
}

SOOPNAV_TARGET_CLONES_WIDE void fold_power(const float* y, std::size_t rows, std::size_t columns, std::size_t lag,
                                           double* same, double* swap, double* power) {
  fold_all<true>(y, rows, columns, lag, same, swap, power);
}

SOOPNAV_INLINE float total(const Lanes& sum) {
  float lane[kLaneFloats];
  std::memcpy(lane, &sum, sizeof lane);
  return ((lane[0] + lane[4]) + (lane[2] + lane[6])) + ((lane[1] + lane[5]) + (lane[3] + lane[7]));
}

}  // namespace

void fold(const Cf32* y, std::size_t rows, std::size_t columns, std::size_t lag, double* same, double* swap,
          double* power) noexcept {
  const auto* const floats = reinterpret_cast<const float*>(y);
  if (power == nullptr) {
    fold_cross(floats, rows, columns, 2 * lag, same, swap);
  } else {
    fold_power(floats, rows, columns, 2 * lag, same, swap, power);
  }
}

SOOPNAV_TARGET_CLONES float dot2(const float* a, const float* x, const float* b, const float* y,
                                 std::size_t n) noexcept {
  Lanes s{}, t{};
  for (std::size_t i = 0; i < n; i += kLaneFloats) {
    Lanes u, v;
    load(u, a + i);
    load(v, x + i);
    s += u * v;
    load(u, b + i);
    load(v, y + i);
    t += u * v;
  }
  return total(s + t);
}

SOOPNAV_TARGET_CLONES double pair_weights(const float* gap, float floor, float rho, float* weight, float* twice,
                                          std::size_t n) noexcept {
  constexpr std::size_t kGroup = 4;  // at 1e-5 each, no product of a group leaves single precision
  double logs = 0.0, product = 1.0;
  for (std::size_t i = 0; i < n;) {
    Lanes group{};
    group += 1.0F;
    for (std::size_t u = 0; u < kGroup && i < n; ++u, i += kLaneFloats) {
      Lanes q;
      load(q, gap + i);
      q = q * rho + floor;
      const Lanes a = q * (2.0F - q);
      const Lanes w = 1.0F / a;
      const Lanes t = 2.0F * q * w;
      std::memcpy(weight + i, &w, sizeof w);
      std::memcpy(twice + i, &t, sizeof t);
      group *= a;
    }
    float lane[kLaneFloats];
    std::memcpy(lane, &group, sizeof lane);
    for (const float value : lane) product *= static_cast<double>(value);
    if (product < 1e-140) {
      logs += std::log(product);
      product = 1.0;
    }
  }
  return logs + std::log(product);
}

SOOPNAV_TARGET_CLONES double mixture_cost(const float* e, const float* a, const float* b, float floor, float share,
                                          std::size_t n) noexcept {
  constexpr std::size_t kGroup = 8;  // at 1e-4 each, no product of a group leaves single precision
  double logs = 0.0, product = 1.0;
  Lanes sum{};
  std::size_t i = 0;
  while (i + kLaneFloats <= n) {
    Lanes group{};
    group += 1.0F;
    for (std::size_t u = 0; u < kGroup && i + kLaneFloats <= n; ++u, i += kLaneFloats) {
      Lanes x, p, q;
      load(x, e + i);
      load(p, a + i);
      load(q, b + i);
      const Lanes g = p + share * (q - p) + floor;
      sum += x / g;
      group *= g;
    }
    float lane[kLaneFloats];
    std::memcpy(lane, &group, sizeof lane);
    for (const float value : lane) product *= static_cast<double>(value);
    logs += std::log(product);
    product = 1.0;
  }
  double rest = static_cast<double>(total(sum));
  for (; i < n; ++i) {
    const auto g = static_cast<double>(a[i] + share * (b[i] - a[i]) + floor);
    logs += std::log(g);
    rest += static_cast<double>(e[i]) / g;
  }
  return logs + rest;
}

}  // namespace soopnav::ofdm::kernels
