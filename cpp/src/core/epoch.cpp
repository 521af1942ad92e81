#include "soopnav/core/epoch.hpp"

#include <cmath>

namespace soopnav {

Epoch::Epoch(TimeScale scale, std::int64_t seconds, double fraction_s) noexcept : scale_(scale) {
  constexpr double kLimitS = 9.2e18;  // below 2^63
  if (!(std::abs(fraction_s) < kLimitS)) {
    *this = invalid(scale);
    return;
  }
  const double whole = std::floor(fraction_s);
  auto carry = static_cast<std::int64_t>(whole);
  double fraction = fraction_s - whole;  // exact, except that a tiny negative number rounds up to 1
  if (fraction >= 1.0) {
    fraction = 0.0;
    ++carry;
  }
  std::int64_t sum = 0;
  if (__builtin_add_overflow(seconds, carry, &sum)) {
    *this = invalid(scale);
    return;
  }
  seconds_ = sum;
  fraction_s_ = fraction;
}

Epoch Epoch::of_sample(std::int64_t index, double sample_rate_hz) noexcept {
  if (!(sample_rate_hz > 0.0) || !std::isfinite(sample_rate_hz)) return invalid(TimeScale::kCapture);
  // index = high + low, both exact doubles; each is divided with its remainder, so nothing is lost beyond 2^53.
  const auto part = [sample_rate_hz](double samples) {
    const double whole = std::floor(samples / sample_rate_hz);
    const double rest = std::fma(-whole, sample_rate_hz, samples);
    return Epoch(TimeScale::kCapture, 0, whole) + rest / sample_rate_hz;
  };
  constexpr std::int64_t kLow = std::int64_t{1} << 32;
  const std::int64_t low = index % kLow;
  const Epoch high_part = part(static_cast<double>(index - low));
  const Epoch low_part = part(static_cast<double>(low));
  const Epoch whole(TimeScale::kCapture, high_part.seconds_, static_cast<double>(low_part.seconds_));
  return whole + (high_part.fraction_s_ + low_part.fraction_s_);
}

Epoch Epoch::plus(double dt_s) const noexcept {
  if (!is_valid()) return *this;
  // Whole seconds first: then the fractions meet at equal magnitude and none of `dt_s` is rounded away.
  const double whole = std::floor(dt_s);
  const Epoch moved(scale_, seconds_, whole);
  return Epoch(scale_, moved.seconds_, moved.fraction_s_ + (fraction_s_ + (dt_s - whole)));
}

}  // namespace soopnav
