#include "waveform/lte/kernels.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/target_clones.hpp"

namespace soopnav::lte::kernels {

namespace {
constexpr std::size_t kLanes = 16;

// std::complex<float> is an array of two floats by definition ([complex.numbers.general]).
const float* floats(const Cf32* x) noexcept { return reinterpret_cast<const float*>(x); }
float* floats(Cf32* x) noexcept { return reinterpret_cast<float*>(x); }
}  // namespace

SOOPNAV_TARGET_CLONES
void multiply(const Cf32* a, const Cf32* b, Cf32* out, std::size_t n) noexcept {
  const float* p = floats(a);
  const float* q = floats(b);
  float* o = floats(out);
  for (std::size_t i = 0; i < n; ++i) {
    const float ar = p[2 * i], ai = p[2 * i + 1], br = q[2 * i], bi = q[2 * i + 1];
    o[2 * i] = ar * br - ai * bi;
    o[2 * i + 1] = ar * bi + ai * br;
  }
}

SOOPNAV_TARGET_CLONES
void multiply_scaled(const Cf32* a, const Cf32* b, Cf32 scale, Cf32* out, std::size_t n) noexcept {
  const float* p = floats(a);
  const float* q = floats(b);
  float* o = floats(out);
  const float sr = scale.real(), si = scale.imag();
  for (std::size_t i = 0; i < n; ++i) {
    const float ar = p[2 * i], ai = p[2 * i + 1], br = q[2 * i], bi = q[2 * i + 1];
    const float cr = ar * br - ai * bi, ci = ar * bi + ai * br;
    o[2 * i] = cr * sr - ci * si;
    o[2 * i + 1] = cr * si + ci * sr;
  }
}

SOOPNAV_TARGET_CLONES
void accumulate_power(const Cf32* x, float* sum, std::size_t n) noexcept {
  const float* p = floats(x);
  for (std::size_t i = 0; i < n; ++i) sum[i] += p[2 * i] * p[2 * i] + p[2 * i + 1] * p[2 * i + 1];
}

SOOPNAV_TARGET_CLONES
void add(const float* x, float* sum, std::size_t n) noexcept {
  for (std::size_t i = 0; i < n; ++i) sum[i] += x[i];
}

SOOPNAV_TARGET_CLONES
void scale(const float* factor, float* x, std::size_t n) noexcept {
  for (std::size_t i = 0; i < n; ++i) x[i] *= factor[i];
}

SOOPNAV_TARGET_CLONES
float sum(const float* x, std::size_t n) noexcept {
  std::array<float, kLanes> lane{};
  std::size_t i = 0;
  for (; i + kLanes <= n; i += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) lane[j] += x[i + j];
  }
  for (std::size_t j = 0; i < n; ++i, ++j) lane[j] += x[i];
  for (std::size_t half = kLanes / 2; half > 0; half /= 2) {
    for (std::size_t j = 0; j < half; ++j) lane[j] += lane[j + half];
  }
  return lane[0];
}

SOOPNAV_TARGET_CLONES
Cf32 dot_conj(const Cf32* a, const Cf32* b, std::size_t n) noexcept {
  const float* p = floats(a);
  const float* q = floats(b);
  std::array<float, kLanes> re{}, im{};
  std::size_t i = 0;
  for (; i + kLanes <= n; i += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) {
      const std::size_t k = 2 * (i + j);
      re[j] += p[k] * q[k] + p[k + 1] * q[k + 1];
      im[j] += p[k + 1] * q[k] - p[k] * q[k + 1];
    }
  }
  for (std::size_t j = 0; i < n; ++i, ++j) {
    const std::size_t k = 2 * i;
    re[j] += p[k] * q[k] + p[k + 1] * q[k + 1];
    im[j] += p[k + 1] * q[k] - p[k] * q[k + 1];
  }
  for (std::size_t half = kLanes / 2; half > 0; half /= 2) {
    for (std::size_t j = 0; j < half; ++j) {
      re[j] += re[j + half];
      im[j] += im[j + half];
    }
  }
  return {re[0], im[0]};
}

SOOPNAV_TARGET_CLONES
float dot(const float* a, const float* b, std::size_t n) noexcept {
  std::array<float, kLanes> sum{};
  std::size_t i = 0;
  for (; i + kLanes <= n; i += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) sum[j] += a[i + j] * b[i + j];
  }
  for (std::size_t j = 0; i < n; ++i, ++j) sum[j] += a[i] * b[i];
  for (std::size_t half = kLanes / 2; half > 0; half /= 2) {
    for (std::size_t j = 0; j < half; ++j) sum[j] += sum[j + half];
  }
  return sum[0];
}

double energy(const Cf32* x, std::size_t n) noexcept {
  double total = 0.0;
  constexpr std::size_t kBlock = 1024;  // single precision inside a block keeps seven digits
  for (std::size_t i = 0; i < n; i += kBlock) {
    const std::size_t m = std::min(kBlock, n - i);
    total += static_cast<double>(dot(floats(x + i), floats(x + i), 2 * m));
  }
  return total;
}

SOOPNAV_TARGET_CLONES
void power_of_sum(const Cf32* a, const Cf32* b, const Cf32* turn, float* out, std::size_t n) noexcept {
  const float* p = floats(a);
  const float* q = floats(b);
  const float* t = floats(turn);
  for (std::size_t i = 0; i < n; ++i) {
    const float br = q[2 * i], bi = q[2 * i + 1], tr = t[2 * i], ti = t[2 * i + 1];
    const float re = p[2 * i] + (br * tr - bi * ti), im = p[2 * i + 1] + (br * ti + bi * tr);
    out[i] = re * re + im * im;
  }
}

SOOPNAV_TARGET_CLONES
float maximum(const float* x, std::size_t n) noexcept {
  std::array<float, kLanes> top;
  top.fill(x[0]);
  std::size_t i = 0;
  for (; i + kLanes <= n; i += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) top[j] = x[i + j] > top[j] ? x[i + j] : top[j];
  }
  for (; i < n; ++i) top[0] = x[i] > top[0] ? x[i] : top[0];
  return *std::max_element(top.begin(), top.end());
}

void phasors(double start_cycles, double step_cycles, Cf32* out, std::size_t n) noexcept {
  // Lanes advance together by kWidth steps; they are set afresh often enough to stay exact.
  constexpr std::size_t kWidth = 16, kRefresh = 256;
  const auto cis = [](double cycles) {
    const double phase = 2.0 * std::numbers::pi * (cycles - std::floor(cycles));
    return std::array<double, 2>{std::cos(phase), std::sin(phase)};
  };
  const auto product = [](const std::array<double, 2>& a, const std::array<double, 2>& b) {
    return std::array<double, 2>{a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]};
  };
  std::array<std::array<double, 2>, kWidth + 1> power;  // of one step
  power[0] = {1.0, 0.0};
  power[1] = cis(step_cycles);
  for (std::size_t j = 2; j <= kWidth; ++j) power[j] = product(power[j / 2], power[j - j / 2]);
  const auto step_re = static_cast<float>(power[kWidth][0]), step_im = static_cast<float>(power[kWidth][1]);
  std::array<float, kWidth> re{}, im{};
  for (std::size_t i = 0; i < n; i += kWidth) {
    if (i % kRefresh == 0) {
      const auto base = cis(start_cycles + step_cycles * static_cast<double>(i));
      for (std::size_t j = 0; j < kWidth; ++j) {
        const auto x = product(base, power[j]);
        re[j] = static_cast<float>(x[0]);
        im[j] = static_cast<float>(x[1]);
      }
    }
    const std::size_t m = std::min(kWidth, n - i);
    for (std::size_t j = 0; j < m; ++j) out[i + j] = {re[j], im[j]};
    for (std::size_t j = 0; j < kWidth; ++j) {
      const float r = re[j] * step_re - im[j] * step_im;
      im[j] = re[j] * step_im + im[j] * step_re;
      re[j] = r;
    }
  }
}

}  // namespace soopnav::lte::kernels
