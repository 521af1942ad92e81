#include "waveform/iridium/detector_kernels.hpp"

#include <cstring>

#include "core/target_clones.hpp"

namespace soopnav::iridium::kernels {
namespace {

using Lanes = float __attribute__((vector_size(32)));

}  // namespace

SOOPNAV_TARGET_CLONES void weigh(const Cf32* in, const float* window, std::size_t n, Cf32* out) noexcept {
  const auto* const x = reinterpret_cast<const float*>(in);
  auto* const y = reinterpret_cast<float*>(out);
  for (std::size_t i = 0; i < n; ++i) {
    y[2 * i] = window[i] * x[2 * i];
    y[2 * i + 1] = window[i] * x[2 * i + 1];
  }
}

SOOPNAV_TARGET_CLONES void square(const Cf32* in, std::size_t n, float* power) noexcept {
  const auto* const x = reinterpret_cast<const float*>(in);
  for (std::size_t i = 0; i < n; ++i) power[i] = x[2 * i] * x[2 * i] + x[2 * i + 1] * x[2 * i + 1];
}

SOOPNAV_TARGET_CLONES void normalise(float* row, const float* inverse, float most, float* median, const float* step,
                                     std::size_t n) noexcept {
  for (std::size_t i = 0; i < n; ++i) {
    const float raw = row[i];
    median[i] *= raw > median[i] ? 1.0F + step[i] : 1.0F - step[i];
    const float scaled = raw * inverse[i];
    row[i] = scaled < most ? scaled : most;
  }
}

SOOPNAV_TARGET_CLONES void slide(float* sum, const float* row, const float* old, std::size_t n) noexcept {
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
