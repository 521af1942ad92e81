#include "dsp/kernels.hpp"

#include <cstring>

#include "core/target_clones.hpp"

namespace soopnav::dsp::detail {
namespace {

constexpr std::size_t kFirFloats = 64;

const float* as_floats(const Cf32* x) { return reinterpret_cast<const float*>(x); }
float* as_floats(Cf32* x) { return reinterpret_cast<float*>(x); }

// Eight floats, an AVX2 register or two of SSE; GCC and Clang lower it to what the target has. Four of them are the 32
// lanes of a sum, so the order of additions is the same on every target. Even lanes hold real parts, odd lanes
// imaginary ones.
using Lanes = float __attribute__((vector_size(32)));
constexpr std::size_t kLaneFloats = 8;
static_assert(2 * kDotSamples == 4 * kLaneFloats);

#define SOOPNAV_INLINE inline __attribute__((always_inline))

SOOPNAV_INLINE void accumulate(Lanes& sum, const float* a, const float* b) {
  Lanes u, v;
  std::memcpy(&u, a, sizeof u);
  std::memcpy(&v, b, sizeof v);
  sum += u * v;
}

SOOPNAV_INLINE void fold(const Lanes& sum, float* out) {
  float lane[kLaneFloats];
  std::memcpy(lane, &sum, sizeof lane);
  out[0] = (lane[0] + lane[4]) + (lane[2] + lane[6]);
  out[1] = (lane[1] + lane[5]) + (lane[3] + lane[7]);
}

SOOPNAV_TARGET_CLONES void dot_floats(const float* taps, const float* x, std::size_t n, float* out) {
  Lanes s0{}, s1{}, s2{}, s3{};
  for (std::size_t i = 0; i < n; i += 4 * kLaneFloats) {
    accumulate(s0, taps + i, x + i);
    accumulate(s1, taps + i + kLaneFloats, x + i + kLaneFloats);
    accumulate(s2, taps + i + 2 * kLaneFloats, x + i + 2 * kLaneFloats);
    accumulate(s3, taps + i + 3 * kLaneFloats, x + i + 3 * kLaneFloats);
  }
  fold((s0 + s2) + (s1 + s3), out);
}

SOOPNAV_TARGET_CLONES void dot_floats_between(const float* low, const float* high, float mu, const float* x,
                                              std::size_t n, float* out) {
  Lanes a0{}, a1{}, a2{}, a3{}, b0{}, b1{}, b2{}, b3{};
  for (std::size_t i = 0; i < n; i += 4 * kLaneFloats) {
    accumulate(a0, low + i, x + i);
    accumulate(b0, high + i, x + i);
    accumulate(a1, low + i + kLaneFloats, x + i + kLaneFloats);
    accumulate(b1, high + i + kLaneFloats, x + i + kLaneFloats);
    accumulate(a2, low + i + 2 * kLaneFloats, x + i + 2 * kLaneFloats);
    accumulate(b2, high + i + 2 * kLaneFloats, x + i + 2 * kLaneFloats);
    accumulate(a3, low + i + 3 * kLaneFloats, x + i + 3 * kLaneFloats);
    accumulate(b3, high + i + 3 * kLaneFloats, x + i + 3 * kLaneFloats);
  }
  float below[2], above[2];
  fold((a0 + a2) + (a1 + a3), below);
  fold((b0 + b2) + (b1 + b3), above);
  out[0] = below[0] + mu * (above[0] - below[0]);
  out[1] = below[1] + mu * (above[1] - below[1]);
}

// Blocks of outputs whose sums stay in registers while the taps go by.
SOOPNAV_TARGET_CLONES void fir_floats(const float* taps, std::size_t n_taps, const float* x, std::size_t n,
                                      float* out) {
  std::size_t i = 0;
  for (; i + kFirFloats <= n; i += kFirFloats) {
    float sum[kFirFloats] = {};
    for (std::size_t k = 0; k < n_taps; ++k) {
      const float tap = taps[k];
      const float* window = x + i + 2 * k;
      for (std::size_t j = 0; j < kFirFloats; ++j) sum[j] += tap * window[j];
    }
    for (std::size_t j = 0; j < kFirFloats; ++j) out[i + j] = sum[j];
  }
  for (; i < n; ++i) {
    float sum = 0.0F;
    for (std::size_t k = 0; k < n_taps; ++k) sum += taps[k] * x[i + 2 * k];
    out[i] = sum;
  }
}

SOOPNAV_TARGET_CLONES void multiply_floats(float* a, const float* b, std::size_t n) {
  for (std::size_t i = 0; i < n; i += 2) {
    const float re = a[i] * b[i] - a[i + 1] * b[i + 1];
    const float im = a[i] * b[i + 1] + a[i + 1] * b[i];
    a[i] = re;
    a[i + 1] = im;
  }
}

}  // namespace

Cf32 dot(const float* taps, const Cf32* x, std::size_t n) noexcept {
  float sum[2];
  dot_floats(taps, as_floats(x), 2 * n, sum);
  return {sum[0], sum[1]};
}

Cf32 dot_between(const float* low, const float* high, float mu, const Cf32* x, std::size_t n) noexcept {
  float sum[2];
  dot_floats_between(low, high, mu, as_floats(x), 2 * n, sum);
  return {sum[0], sum[1]};
}

void fir(const float* taps, std::size_t n_taps, const Cf32* x, std::size_t n_out, Cf32* out) noexcept {
  fir_floats(taps, n_taps, as_floats(x), 2 * n_out, as_floats(out));
}

void multiply(Cf32* a, const Cf32* b, std::size_t n) noexcept { multiply_floats(as_floats(a), as_floats(b), 2 * n); }

}  // namespace soopnav::dsp::detail
