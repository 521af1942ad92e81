#include "soopnav/dsp/peak.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "dsp/kaiser.hpp"

namespace soopnav::dsp {
namespace {

double power(Cf32 sample) {
  const auto re = static_cast<double>(sample.real());
  const auto im = static_cast<double>(sample.imag());
  return re * re + im * im;
}

// Wraps or zero-fills an index that may lie outside.
Cf32 sample_at(IqSpan samples, std::int64_t index, PeakBoundary boundary) {
  const auto size = static_cast<std::int64_t>(samples.size());
  if (boundary == PeakBoundary::kCircular) {
    index %= size;
    if (index < 0) index += size;
  } else if (index < 0 || index >= size) {
    return {};
  }
  return samples[static_cast<std::size_t>(index)];
}

// Steps of the successive parabolas of PeakRefiner::refine: a parabola's bias falls with the square of its step, so
// the last leaves less than rounding does.
constexpr std::array<double, 3> kSteps = {0.25, 0.05, 0.01};

}  // namespace

std::optional<Peak> parabolic_peak(double left, double centre, double right, PeakScale scale) noexcept {
  const double largest = std::max({left, centre, right});
  if (!(left >= 0.0 && centre >= 0.0 && right >= 0.0 && std::isfinite(largest) && centre >= left && centre >= right)) {
    return std::nullopt;
  }
  if (!(centre > 0.0)) return std::nullopt;
  // Relative to the centre: a common factor must not matter, and its square must not overflow.
  double l = left / centre, c = 1.0, r = right / centre;
  switch (scale) {
    case PeakScale::kMagnitude:
      break;
    case PeakScale::kPower:
      l *= l;
      r *= r;
      break;
    case PeakScale::kLog:
      if (!(l > 0.0 && r > 0.0)) return std::nullopt;
      l = std::log(l);
      c = 0.0;
      r = std::log(r);
      break;
  }
  const double bend = (c - l) + (c - r);
  if (!(bend > 0.0)) return std::nullopt;
  const double offset = 0.5 * (r - l) / bend;
  double value = c + 0.25 * (r - l) * offset;
  if (scale == PeakScale::kPower) value = std::sqrt(value);
  if (scale == PeakScale::kLog) value = std::exp(value);
  return Peak{offset, value * centre};
}

std::optional<Peak> parabolic_peak(IqSpan correlation, std::size_t index, PeakScale scale,
                                   PeakBoundary boundary) noexcept {
  if (index >= correlation.size()) return std::nullopt;
  const auto at = static_cast<std::int64_t>(index);
  return parabolic_peak(std::sqrt(power(sample_at(correlation, at - 1, boundary))),
                        std::sqrt(power(correlation[index])),
                        std::sqrt(power(sample_at(correlation, at + 1, boundary))), scale);
}

PeakRefiner::PeakRefiner(const SincDesign& design)
    : taps_(static_cast<std::size_t>(sinc_tap_count(design))), attenuation_db_(design.attenuation_db) {}

std::optional<Peak> PeakRefiner::refine(IqSpan correlation, std::size_t index, PeakBoundary boundary) const noexcept {
  const auto start = parabolic_peak(correlation, index, PeakScale::kPower, boundary);
  if (!start) return std::nullopt;
  const auto reach = static_cast<std::int64_t>(taps_ / 2);
  const auto at = static_cast<std::int64_t>(index);
  const detail::KaiserSinc kernel(1.0, static_cast<double>(taps_), attenuation_db_ + detail::kMarginDb);
  const auto power_at = [&](double offset) {
    const auto whole = static_cast<std::int64_t>(std::floor(offset));
    double re = 0.0, im = 0.0;
    for (std::int64_t k = whole - reach + 1; k <= whole + reach; ++k) {
      const double tap = kernel(offset - static_cast<double>(k));
      const Cf32 sample = sample_at(correlation, at + k, boundary);
      re += tap * static_cast<double>(sample.real());
      im += tap * static_cast<double>(sample.imag());
    }
    return re * re + im * im;
  };
  double offset = start->offset_samples;
  double peak = 0.0;
  for (const double step : kSteps) {
    const double left = power_at(offset - step);
    const double centre = power_at(offset);
    const double right = power_at(offset + step);
    const double bend = (centre - left) + (centre - right);
    if (!(bend > 0.0)) return std::nullopt;
    // The vertex, no further than the parabola is known.
    const double move = std::clamp(0.5 * (right - left) / bend, -2.0, 2.0);
    peak = centre + 0.25 * (right - left) * move;
    offset += step * move;
    if (!(std::abs(offset) <= 1.0)) return std::nullopt;
  }
  return Peak{offset, std::sqrt(std::max(peak, 0.0))};
}

std::optional<std::size_t> largest_sample(IqSpan samples) noexcept {
  std::optional<std::size_t> best;
  double largest = 0.0;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const double value = power(samples[i]);
    if (!std::isfinite(value)) continue;
    if (!best || value > largest) {
      best = i;
      largest = value;
    }
  }
  return best;
}

}  // namespace soopnav::dsp
