#include "waveform/iridium/detector_kernels.hpp"

#include <cmath>
#include <cstring>

#include "core/target_clones.hpp"

namespace soopnav::iridium::kernels {
namespace {

using Lanes = float __attribute__((vector_size(32)));

}  // namespace

SOOPNAV_TARGET_CLONES std::size_t copy_finite(const Cf32* in, std::size_t n, Cf32* out) noexcept {
  const auto* const x = reinterpret_cast<const float*>(in);
  auto* const y = reinterpret_cast<float*>(out);
  float check = 0.0F;  // stays zero while all are finite
  Lanes checks{};
  std::size_t i = 0;
  for (; i + 8 <= 2 * n; i += 8) {
    Lanes v;
    std::memcpy(&v, x + i, sizeof v);
    std::memcpy(y + i, &v, sizeof v);
    checks += v * 0.0F;
  }
  for (; i < 2 * n; ++i) {
    y[i] = x[i];
    check += x[i] * 0.0F;
  }
  for (int k = 0; k < 8; ++k) check += checks[k];
  if (check == 0.0F) return 0;
  std::size_t rejected = 0;
  for (i = 0; i < n; ++i) {
    if (std::isfinite(out[i].real()) && std::isfinite(out[i].imag())) continue;
    out[i] = Cf32{};
    ++rejected;
  }
  return rejected;
}

SOOPNAV_TARGET_CLONES void weigh(const Cf32* in, const float* __restrict window, std::size_t n, Cf32* out) noexcept {
  const auto* __restrict const x = reinterpret_cast<const float*>(in);
  auto* __restrict const y = reinterpret_cast<float*>(out);
  for (std::size_t i = 0; i < n; ++i) {
    y[2 * i] = window[i] * x[2 * i];
    y[2 * i + 1] = window[i] * x[2 * i + 1];
  }
}

SOOPNAV_TARGET_CLONES void square(const Cf32* in, std::size_t n, float* __restrict power) noexcept {
  const auto* __restrict const x = reinterpret_cast<const float*>(in);
  for (std::size_t i = 0; i < n; ++i) power[i] = x[2 * i] * x[2 * i] + x[2 * i + 1] * x[2 * i + 1];
}

SOOPNAV_TARGET_CLONES void normalise(float* row, const float* inverse, float most, float* median, const float* step,
                                     std::size_t n) noexcept {
  const auto one = [&](std::size_t i) {
    const float raw = row[i], scaled = raw * inverse[i];
    median[i] *= raw > median[i] ? 1.0F + step[i] : 1.0F - step[i];
    row[i] = scaled < most ? scaled : most;
  };
  std::size_t i = 0;
  const Lanes cap = Lanes{} + most;
  for (; i + 8 <= n; i += 8) {
    Lanes raw, gain, middle, change;
    std::memcpy(&raw, row + i, sizeof raw);
    std::memcpy(&gain, inverse + i, sizeof gain);
    std::memcpy(&middle, median + i, sizeof middle);
    std::memcpy(&change, step + i, sizeof change);
    gain *= raw;
    middle *= raw > middle ? 1.0F + change : 1.0F - change;
    gain = gain < cap ? gain : cap;
    std::memcpy(row + i, &gain, sizeof gain);
    std::memcpy(median + i, &middle, sizeof middle);
  }
  for (; i < n; ++i) one(i);
}

SOOPNAV_TARGET_CLONES void slide(float* __restrict sum, const float* __restrict row, const float* __restrict old,
                                 std::size_t n) noexcept {
  for (std::size_t i = 0; i < n; ++i) sum[i] += row[i] - old[i];
}

SOOPNAV_TARGET_CLONES void filter(const Cf32* x, std::size_t stride, const float* taps, std::size_t n, Cf32* out,
                                  std::size_t outputs) noexcept {
  for (std::size_t m = 0; m < outputs; ++m) {
    const auto* const from = reinterpret_cast<const float*>(x + m * stride);
    Lanes sum{};
    for (std::size_t k = 0; k < 2 * n; k += 8) {
      Lanes a, b;
      std::memcpy(&a, from + k, sizeof a);
      std::memcpy(&b, taps + k, sizeof b);
      sum += a * b;
    }
    float lane[8];
    std::memcpy(lane, &sum, sizeof lane);
    out[m] = Cf32((lane[0] + lane[4]) + (lane[2] + lane[6]), (lane[1] + lane[5]) + (lane[3] + lane[7]));
  }
}

}  // namespace soopnav::iridium::kernels
