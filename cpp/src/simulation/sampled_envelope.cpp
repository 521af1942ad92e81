#include <algorithm>
#include <array>
#include <cmath>

#include "simulation/require.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/simulation/pair_link.hpp"

namespace soopnav::simulation {
namespace {

constexpr std::int64_t kHalf = 16;
constexpr std::size_t kTaps = 2 * kHalf;
constexpr std::size_t kPhases = 512;

/// Modified Bessel function of the first kind, order 0, by its series.
double bessel_i0(double x) {
  double term = 1.0, sum = 1.0;
  for (int k = 1; term > 1e-17 * sum; ++k) {
    term *= (x / (2.0 * k)) * (x / (2.0 * k));
    sum += term;
  }
  return sum;
}

using Row = std::array<float, kTaps>;

/// Row p: weights of the 32 samples about an instant p / 512 of a sample after the 16th of them.
const std::array<Row, kPhases + 1>& weights() {
  static const auto kTable = [] {
    constexpr double kBeta = 9.0;
    std::array<Row, kPhases + 1> out{};
    for (std::size_t p = 0; p <= kPhases; ++p) {
      for (std::size_t i = 0; i < kTaps; ++i) {
        const double t = static_cast<double>(kHalf) - 1.0 - static_cast<double>(i) +
                         static_cast<double>(p) / static_cast<double>(kPhases);
        const double edge = t / static_cast<double>(kHalf);
        if (std::abs(edge) >= 1.0) continue;
        const double sinc = t == 0.0 ? 1.0 : std::sin(kPi * t) / (kPi * t);
        out[p][i] = static_cast<float>(sinc * bessel_i0(kBeta * std::sqrt(1.0 - edge * edge)) / bessel_i0(kBeta));
      }
    }
    return out;
  }();
  return kTable;
}

}  // namespace

SampledEnvelope::SampledEnvelope(IqSpan samples, double sample_rate_hz)
    : samples_(samples.size() + 2 * kTaps), rate_hz_(sample_rate_hz) {
  require(!samples.empty(), "samples.size()", 0.0, "at least one is needed");
  require(std::isfinite(sample_rate_hz) && sample_rate_hz > 0.0, "sample_rate_hz", sample_rate_hz,
          "it must be finite and positive");
  for (const Cf32 x : samples) {
    require(std::isfinite(x.real()) && std::isfinite(x.imag()), "samples", static_cast<double>(std::abs(x)),
            "each must be finite");
  }
  std::ranges::copy(samples, samples_.begin() + kTaps);
  static_cast<void>(weights());
}

double SampledEnvelope::begin_s() const noexcept { return -static_cast<double>(kHalf) / rate_hz_; }

double SampledEnvelope::end_s() const noexcept {
  return (static_cast<double>(samples_.size() - 2 * kTaps) - 1.0 + static_cast<double>(kHalf)) / rate_hz_;
}

void SampledEnvelope::evaluate(double t0_s, double dt_s, double quadratic, std::span<Cf32> out) const noexcept {
  const auto& table = weights();
  const auto size = static_cast<double>(samples_.size() - 2 * kTaps);
  constexpr auto kReach = static_cast<double>(kHalf);
  for (std::size_t n = 0; n < out.size(); ++n) {
    const auto k = static_cast<double>(n);
    const double at = (t0_s + k * (dt_s + quadratic * k)) * rate_hz_;
    const double whole = std::floor(at);
    out[n] = {};
    if (!(whole >= -kReach && whole < size + kReach)) continue;
    const double phase = (at - whole) * static_cast<double>(kPhases);
    const auto p = std::min(static_cast<std::size_t>(phase), kPhases - 1);
    const auto part = static_cast<float>(phase - static_cast<double>(p));
    const Row& lower = table[p];
    const Row& upper = table[p + 1];
    // Samples whole - 15 ... whole + 16, behind 32 zeros.
    const Cf32* x = samples_.data() + (static_cast<std::int64_t>(whole) + kHalf + 1);
    float re = 0.0F, im = 0.0F;
    for (std::size_t i = 0; i < kTaps; ++i) {
      const float weight = lower[i] + part * (upper[i] - lower[i]);
      re += weight * x[i].real();
      im += weight * x[i].imag();
    }
    out[n] = {re, im};
  }
}

}  // namespace soopnav::simulation
