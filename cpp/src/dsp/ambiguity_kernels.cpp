#include "dsp/ambiguity_kernels.hpp"

#include <cstring>

#include "core/target_clones.hpp"

namespace soopnav::dsp::detail {
namespace {

const float* as_floats(const Cf32* x) { return reinterpret_cast<const float*>(x); }
float* as_floats(Cf32* x) { return reinterpret_cast<float*>(x); }

// As in kernels.cpp: eight floats, even lanes real and odd ones imaginary, summed in a fixed order on every target.
using Lanes = float __attribute__((vector_size(32)));
constexpr std::size_t kLaneFloats = 8;

#define SOOPNAV_INLINE inline __attribute__((always_inline))

SOOPNAV_INLINE void load(Lanes& v, const float* x) { std::memcpy(&v, x, sizeof v); }

SOOPNAV_INLINE void fold(const Lanes& sum, float& even, float& odd) {
  float lane[kLaneFloats];
  std::memcpy(lane, &sum, sizeof lane);
  even = (lane[0] + lane[4]) + (lane[2] + lane[6]);
  odd = (lane[1] + lane[5]) + (lane[3] + lane[7]);
}

SOOPNAV_TARGET_CLONES void decimate_complex(const float* re, const float* im, std::size_t n, const float* x,
                                            std::size_t stride, std::size_t n_out, float* out) {
  for (std::size_t m = 0; m < n_out; ++m) {
    const float* window = x + m * stride;
    Lanes r0{}, r1{}, i0{}, i1{};
    for (std::size_t k = 0; k < n; k += 2 * kLaneFloats) {
      Lanes u, v, t;
      load(u, window + k);
      load(v, window + k + kLaneFloats);
      load(t, re + k);
      r0 += t * u;
      load(t, im + k);
      i0 += t * u;
      load(t, re + k + kLaneFloats);
      r1 += t * v;
      load(t, im + k + kLaneFloats);
      i1 += t * v;
    }
    float rr, ri, ir, ii;
    fold(r0 + r1, rr, ri);
    fold(i0 + i1, ir, ii);
    out[2 * m] = rr - ii;
    out[2 * m + 1] = ri + ir;
  }
}

SOOPNAV_TARGET_CLONES void decimate_real(const float* taps, std::size_t n, const float* x, std::size_t stride,
                                         std::size_t n_out, float* out) {
  for (std::size_t m = 0; m < n_out; ++m) {
    const float* window = x + m * stride;
    Lanes s0{}, s1{};
    for (std::size_t k = 0; k < n; k += 2 * kLaneFloats) {
      Lanes u, t;
      load(u, window + k);
      load(t, taps + k);
      s0 += t * u;
      load(u, window + k + kLaneFloats);
      load(t, taps + k + kLaneFloats);
      s1 += t * u;
    }
    fold(s0 + s1, out[2 * m], out[2 * m + 1]);
  }
}

SOOPNAV_TARGET_CLONES void correlate_floats(const float* a, const float* b, const float* exchanged, std::size_t n,
                                            std::size_t lags, float* out) {
  for (std::size_t l = 0; l < lags; ++l) {
    const float* window = a + 2 * l;
    Lanes r0{}, r1{}, i0{}, i1{};
    for (std::size_t k = 0; k < n; k += 2 * kLaneFloats) {
      Lanes u, v, t;
      load(u, window + k);
      load(v, window + k + kLaneFloats);
      load(t, b + k);
      r0 += t * u;
      load(t, exchanged + k);
      i0 += t * u;
      load(t, b + k + kLaneFloats);
      r1 += t * v;
      load(t, exchanged + k + kLaneFloats);
      i1 += t * v;
    }
    float rr, ii, ri, ir;  // a_re b_re, a_im b_im, a_re b_im, a_im b_re
    fold(r0 + r1, rr, ii);
    fold(i0 + i1, ri, ir);
    out[2 * l] = rr + ii;
    out[2 * l + 1] = ir - ri;
  }
}

SOOPNAV_TARGET_CLONES void multiply_conjugate_floats(const float* a, const float* b, std::size_t n, float* out) {
  for (std::size_t i = 0; i < n; i += 2) {
    const float re = a[i] * b[i] + a[i + 1] * b[i + 1];
    const float im = a[i + 1] * b[i] - a[i] * b[i + 1];
    out[i] = re;
    out[i + 1] = im;
  }
}

SOOPNAV_TARGET_CLONES void weighted_power_floats(const float* x, const float* weight, std::size_t n, float* p) {
  for (std::size_t i = 0; i < n; ++i) p[i] = (x[2 * i] * x[2 * i] + x[2 * i + 1] * x[2 * i + 1]) * weight[i];
}

}  // namespace

void decimate(const float* re, const float* im, std::size_t n_taps, const Cf32* x, std::size_t stride,
              std::size_t n_out, Cf32* out) noexcept {
  decimate_complex(re, im, 2 * n_taps, as_floats(x), 2 * stride, n_out, as_floats(out));
}

void decimate(const float* taps, std::size_t n_taps, const Cf32* x, std::size_t stride, std::size_t n_out,
              Cf32* out) noexcept {
  decimate_real(taps, 2 * n_taps, as_floats(x), 2 * stride, n_out, as_floats(out));
}

void correlate_lags(const Cf32* a, const Cf32* b, const Cf32* exchanged, std::size_t n, std::size_t lags,
                    Cf32* out) noexcept {
  correlate_floats(as_floats(a), as_floats(b), as_floats(exchanged), 2 * n, lags, as_floats(out));
}

void multiply_conjugate(const Cf32* a, const Cf32* b, std::size_t n, Cf32* out) noexcept {
  multiply_conjugate_floats(as_floats(a), as_floats(b), 2 * n, as_floats(out));
}

void weighted_power(const Cf32* x, const float* weight, std::size_t n, float* p) noexcept {
  weighted_power_floats(as_floats(x), weight, n, p);
}

}  // namespace soopnav::dsp::detail
