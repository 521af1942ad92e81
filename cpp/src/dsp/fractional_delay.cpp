#include "soopnav/dsp/fractional_delay.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>

#include "dsp/kaiser.hpp"
#include "dsp/kernels.hpp"

namespace soopnav::dsp {
namespace {

constexpr double kMaxDelay = 0x1p50;
constexpr int kMaxLagrangeOrder = 9;

void check(const SincDesign& design) {
  if (!(design.passband > 0.0 && design.passband <= 0.99)) {
    throw std::invalid_argument("passband: in (0, 0.99] of half the sampling rate required, got " +
                                std::to_string(design.passband));
  }
  if (!(design.attenuation_db >= 20.0 && design.attenuation_db <= 110.0)) {
    throw std::invalid_argument("attenuation_db: 20 to 110 required, got " + std::to_string(design.attenuation_db));
  }
}

void checked_sinc_taps(double fraction, const SincDesign& design, std::span<double> taps) noexcept {
  const auto size = static_cast<double>(taps.size());
  const detail::KaiserSinc kernel(1.0, size, design.attenuation_db + detail::kMarginDb);
  for (std::size_t k = 0; k < taps.size(); ++k) {
    taps[k] = kernel(static_cast<double>(k) - (0.5 * size - 1.0) - fraction);
  }
}

void checked_lagrange_taps(double delay, std::span<double> taps) noexcept {
  for (std::size_t k = 0; k < taps.size(); ++k) {
    double tap = 1.0;
    for (std::size_t m = 0; m < taps.size(); ++m) {
      if (m == k) continue;
      tap *= (delay - static_cast<double>(m)) / (static_cast<double>(k) - static_cast<double>(m));
    }
    taps[k] = tap;
  }
}

void refuse_delay(double delay_samples) {
  throw std::invalid_argument("delay_samples: finite and at most 2^50 in magnitude required, got " +
                              std::to_string(delay_samples));
}

}  // namespace

int sinc_tap_count(const SincDesign& design) {
  check(design);
  // The transition runs from the passband's edge to that of the first image.
  const double width_rad = 2.0 * std::numbers::pi * (1.0 - design.passband);
  const double span = detail::kaiser_span(design.attenuation_db + detail::kMarginDb, width_rad);
  return 2 * static_cast<int>(std::ceil(0.5 * (span + 1.0)));
}

void sinc_delay_taps(double fraction, const SincDesign& design, std::span<double> taps) {
  if (const int count = sinc_tap_count(design); taps.size() != static_cast<std::size_t>(count)) {
    throw std::invalid_argument("taps: " + std::to_string(count) + " elements required for this design, got " +
                                std::to_string(taps.size()));
  }
  if (!(fraction >= 0.0 && fraction < 1.0)) {
    throw std::invalid_argument("fraction: in [0, 1) required, got " + std::to_string(fraction));
  }
  checked_sinc_taps(fraction, design, taps);
}

void lagrange_delay_taps(double delay_samples, std::span<double> taps) {
  if (taps.size() < 2 || taps.size() > kMaxLagrangeOrder + 1) {
    throw std::invalid_argument("taps: 2 to 10 elements (order 1 to 9) required, got " + std::to_string(taps.size()));
  }
  if (!std::isfinite(delay_samples)) {
    throw std::invalid_argument("delay_samples: finite value required, got " + std::to_string(delay_samples));
  }
  checked_lagrange_taps(delay_samples, taps);
}

FractionalDelay::FractionalDelay(std::size_t taps, bool lagrange, const SincDesign& design)
    : design_(design), lagrange_(lagrange), taps_(taps), reversed_(taps) {}

FractionalDelay FractionalDelay::windowed_sinc(double delay_samples, const SincDesign& design) {
  FractionalDelay filter(static_cast<std::size_t>(sinc_tap_count(design)), false, design);
  if (!filter.set_delay(delay_samples)) refuse_delay(delay_samples);
  return filter;
}

FractionalDelay FractionalDelay::lagrange(double delay_samples, int order) {
  if (order < 1 || order > kMaxLagrangeOrder) {
    throw std::invalid_argument("order: 1 to 9 required, got " + std::to_string(order));
  }
  FractionalDelay filter(static_cast<std::size_t>(order) + 1, true, {});
  if (!filter.set_delay(delay_samples)) refuse_delay(delay_samples);
  return filter;
}

bool FractionalDelay::set_delay(double delay_samples) noexcept {
  if (!(std::abs(delay_samples) <= kMaxDelay)) return false;
  const auto size = static_cast<double>(taps_.size());
  if (lagrange_) {
    // The delay from the first tap stays within half a sample of the middle one.
    const double first = std::nearbyint(delay_samples - 0.5 * (size - 1.0));
    checked_lagrange_taps(delay_samples - first, taps_);
    first_tap_ = static_cast<std::int64_t>(first);
  } else {
    const double whole = std::floor(delay_samples);
    checked_sinc_taps(delay_samples - whole, design_, taps_);
    first_tap_ = static_cast<std::int64_t>(whole) - static_cast<std::int64_t>(taps_.size() / 2) + 1;
  }
  for (std::size_t k = 0; k < taps_.size(); ++k) reversed_[taps_.size() - 1 - k] = static_cast<float>(taps_[k]);
  delay_ = delay_samples;
  return true;
}

void FractionalDelay::apply(IqSpan in, std::int64_t first, std::span<Cf32> out) const noexcept {
  const auto n_in = static_cast<std::int64_t>(in.size());
  const auto n_taps = static_cast<std::int64_t>(reversed_.size());
  const auto n_out = static_cast<std::int64_t>(out.size());
  // The first input that output i meets is begin + i.
  const std::int64_t begin = first - first_tap_ - (n_taps - 1);
  const std::int64_t inside_low = std::clamp<std::int64_t>(-begin, 0, n_out);
  const std::int64_t inside_high = std::clamp<std::int64_t>(n_in - n_taps + 1 - begin, inside_low, n_out);
  const auto edge = [&](std::int64_t low, std::int64_t high) {
    for (std::int64_t i = low; i < high; ++i) {
      const std::int64_t window = begin + i;
      const std::int64_t k_end = std::min(n_taps, n_in - window);
      Cf32 sum{};
      for (std::int64_t k = std::max<std::int64_t>(0, -window); k < k_end; ++k) {
        sum += reversed_[static_cast<std::size_t>(k)] * in[static_cast<std::size_t>(window + k)];
      }
      out[static_cast<std::size_t>(i)] = sum;
    }
  };
  edge(0, inside_low);
  if (inside_high > inside_low) {
    detail::fir(reversed_.data(), reversed_.size(), in.data() + (begin + inside_low),
                static_cast<std::size_t>(inside_high - inside_low), out.data() + inside_low);
  }
  edge(inside_high, n_out);
}

std::vector<Cf32> delayed(IqSpan in, double delay_samples, const SincDesign& design) {
  std::vector<Cf32> out(in.size());
  FractionalDelay::windowed_sinc(delay_samples, design).apply(in, 0, out);
  return out;
}

}  // namespace soopnav::dsp
