#pragma once

#include <compare>
#include <cstdint>
#include <limits>
#include <optional>
#include <string_view>

namespace soopnav {

/// Time scales of an `Epoch`, each with its origin. Epochs of different scales do not mix.
enum class TimeScale : std::uint8_t {
  kCapture,  ///< a recording's own clock: seconds of its sampling clock since its first sample
  kGps,      ///< GPS time: SI seconds since 1980-01-06 00:00 (IS-GPS-200 section 20.3.3.5.2.4)
  kUtc,      ///< UTC as POSIX counts it: since 1970-01-01 00:00, 86 400 s a day, leap seconds left out
  kTai,      ///< international atomic time: SI seconds since 1970-01-01 00:00 TAI
};

/// "capture", "GPS", "UTC" or "TAI"; "unknown" for a value that is no enumerator.
[[nodiscard]] constexpr std::string_view to_string(TimeScale scale) noexcept {
  switch (scale) {
    case TimeScale::kCapture:
      return "capture";
    case TimeScale::kGps:
      return "GPS";
    case TimeScale::kUtc:
      return "UTC";
    case TimeScale::kTai:
      return "TAI";
  }
  return "unknown";
}

/// A point in time: whole seconds, a fraction in [0, 1) and the time scale they count in.
///
/// A double that counts seconds since 1970 steps by 0.24 us, 71 m of light; an epoch steps by 1.1e-16 s, and the
/// difference of two is a double number of seconds, right to its own rounding (below 1e-12 s for up to an hour).
///
/// Data never throws: what cannot be an epoch (not a number, beyond 64-bit seconds) is the invalid epoch, which
/// stays invalid under addition, is unordered with every epoch and equal to none, and has no difference. Epochs of
/// different scales are unordered, unequal, and have no difference either. Across a leap second a difference of UTC
/// epochs is a second short, as POSIX time is; use GPS or TAI for intervals that can contain one.
class Epoch {
 public:
  /// The origin of the capture scale.
  constexpr Epoch() noexcept = default;

  /// `seconds` + `fraction_s` after the origin of `scale`. The fraction may be any number; it is brought into [0, 1).
  Epoch(TimeScale scale, std::int64_t seconds, double fraction_s) noexcept;

  /// `since_origin_s` after the origin of `scale`, with the resolution a double has there.
  [[nodiscard]] static Epoch from_seconds(TimeScale scale, double since_origin_s) noexcept {
    return {scale, 0, since_origin_s};
  }

  /// When sample `index` of a capture was taken, `index / sample_rate_hz` after its first sample, in the capture scale.
  /// Split exactly before dividing, so the 1e12-th sample is as sharp as the first. Invalid unless the rate is
  /// positive.
  [[nodiscard]] static Epoch of_sample(std::int64_t index, double sample_rate_hz) noexcept;

  [[nodiscard]] static constexpr Epoch invalid(TimeScale scale) noexcept {
    Epoch epoch;
    epoch.scale_ = scale;
    epoch.fraction_s_ = std::numeric_limits<double>::quiet_NaN();
    return epoch;
  }

  [[nodiscard]] constexpr TimeScale scale() const noexcept { return scale_; }
  [[nodiscard]] constexpr std::int64_t seconds() const noexcept { return seconds_; }  ///< whole seconds, rounded down
  [[nodiscard]] constexpr double fraction_s() const noexcept { return fraction_s_; }  ///< in [0, 1); NaN when invalid
  [[nodiscard]] constexpr bool is_valid() const noexcept { return fraction_s_ == fraction_s_; }

  /// Seconds since the origin as one double (rounded); NaN when invalid. For plots and logs, not for differences.
  [[nodiscard]] constexpr double seconds_since_origin() const noexcept {
    return static_cast<double>(seconds_) + fraction_s_;
  }

  /// The epoch `dt_s` later, in the same scale.
  Epoch& operator+=(double dt_s) noexcept { return *this = *this + dt_s; }
  Epoch& operator-=(double dt_s) noexcept { return *this = *this - dt_s; }
  [[nodiscard]] friend Epoch operator+(const Epoch& epoch, double dt_s) noexcept { return epoch.plus(dt_s); }
  [[nodiscard]] friend Epoch operator-(const Epoch& epoch, double dt_s) noexcept { return epoch.plus(-dt_s); }

  /// `later` minus `earlier` [s], positive when `later` is later; none when the scales differ or one is invalid.
  [[nodiscard]] friend constexpr std::optional<double> operator-(const Epoch& later, const Epoch& earlier) noexcept {
    if (later.scale_ != earlier.scale_ || !later.is_valid() || !earlier.is_valid()) return std::nullopt;
    const double fraction = later.fraction_s_ - earlier.fraction_s_;
    const std::int64_t a = later.seconds_;
    const std::int64_t b = earlier.seconds_;
    const bool overflows =
        b < 0 ? a > std::numeric_limits<std::int64_t>::max() + b : a < std::numeric_limits<std::int64_t>::min() + b;
    if (overflows) return static_cast<double>(a) - static_cast<double>(b) + fraction;
    return static_cast<double>(a - b) + fraction;
  }

  [[nodiscard]] friend constexpr bool operator==(const Epoch& a, const Epoch& b) noexcept {
    return (a <=> b) == std::partial_ordering::equivalent;
  }

  /// Earlier, later or the same; unordered when the scales differ or one is invalid.
  [[nodiscard]] friend constexpr std::partial_ordering operator<=>(const Epoch& a, const Epoch& b) noexcept {
    if (a.scale_ != b.scale_ || !a.is_valid() || !b.is_valid()) return std::partial_ordering::unordered;
    if (a.seconds_ != b.seconds_) return a.seconds_ <=> b.seconds_;
    return a.fraction_s_ <=> b.fraction_s_;
  }

 private:
  [[nodiscard]] Epoch plus(double dt_s) const noexcept;

  std::int64_t seconds_ = 0;
  double fraction_s_ = 0.0;
  TimeScale scale_ = TimeScale::kCapture;
};

}  // namespace soopnav
