#include "waveform/tracking/correlator.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstring>

#include "core/target_clones.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::tracking {
namespace {

constexpr std::size_t kLanes = 8;
using Lanes = float __attribute__((vector_size(32)));
#define SOOPNAV_INLINE inline __attribute__((always_inline))

SOOPNAV_INLINE void load(Lanes& out, const float* from) { std::memcpy(&out, from, sizeof out); }

SOOPNAV_INLINE void store(float* to, const Lanes& value) { std::memcpy(to, &value, sizeof value); }

SOOPNAV_INLINE double total(const Lanes& sum) {
  float lane[kLanes];
  std::memcpy(lane, &sum, sizeof lane);
  double out = 0.0;
  for (const float value : lane) out += static_cast<double>(value);
  return out;
}

// Room of a run: mixed samples, and three replicas.
struct Room {
  alignas(32) float re[kRun];
  alignas(32) float im[kRun];
  alignas(32) float code_re[3][kRun];
  alignas(32) float code_im[3][kRun];
};

// Splits samples, mixes them by rotors that start at `turn` and step by `leap` every eight, returns sum |x|².
SOOPNAV_TARGET_CLONES float mix(const float* x, std::size_t n, const float* turn_re, const float* turn_im,
                                float leap_re, float leap_im, float* re, float* im) noexcept {
  Lanes r, i, power{};
  load(r, turn_re);
  load(i, turn_im);
  for (std::size_t k = 0; k < n; k += kLanes) {
    float a[kLanes], b[kLanes];
    for (std::size_t u = 0; u < kLanes; ++u) {
      a[u] = x[2 * (k + u)];
      b[u] = x[2 * (k + u) + 1];
    }
    Lanes xr, xi;
    load(xr, a);
    load(xi, b);
    power += xr * xr + xi * xi;
    store(re + k, xr * r + xi * i);
    store(im + k, xi * r - xr * i);
    const Lanes next = r * leap_re - i * leap_im;
    i = r * leap_im + i * leap_re;
    r = next;
  }
  return static_cast<float>(total(power));
}

SOOPNAV_TARGET_CLONES void dot_real(const float* re, const float* im, const float* code, std::size_t n,
                                    double* out) noexcept {
  Lanes a{}, b{};
  for (std::size_t k = 0; k < n; k += kLanes) {
    Lanes c, x, y;
    load(c, code + k);
    load(x, re + k);
    load(y, im + k);
    a += x * c;
    b += y * c;
  }
  out[0] = total(a);
  out[1] = total(b);
}

SOOPNAV_TARGET_CLONES void dot_complex(const float* re, const float* im, const float* code_re, const float* code_im,
                                       std::size_t n, double* out) noexcept {
  Lanes a{}, b{};
  for (std::size_t k = 0; k < n; k += kLanes) {
    Lanes c, s, x, y;
    load(c, code_re + k);
    load(s, code_im + k);
    load(x, re + k);
    load(y, im + k);
    a += x * c + y * s;
    b += y * c - x * s;
  }
  out[0] = total(a);
  out[1] = total(b);
}

bool usable(const Cf32& x) noexcept {
  return std::abs(x.real()) <= 1e15F && std::abs(x.imag()) <= 1e15F;  // false for NaN
}

}  // namespace

CodeTable::CodeTable(const std::vector<Cf32>& chips, double most_chips_per_sample)
    : length_(static_cast<double>(chips.size())),
      real_(std::all_of(chips.begin(), chips.end(), [](const Cf32& c) { return c.imag() == 0.0F; })) {
  // A replica begins within the period after its first, early and late reach one chip beyond.
  const std::size_t more = static_cast<std::size_t>(std::ceil(most_chips_per_sample * static_cast<double>(kRun))) + 4;
  for (std::size_t i = 0; i < chips.size() + more; ++i) {
    const Cf32 chip = chips[i % chips.size()];
    if (real_) {
      real_chips_.push_back(chip.real());
    } else {
      chips_.push_back(chip);
    }
  }
}

Sums correlate(const Cf32* x, std::size_t n, const CodeTable& code, double phase, double step, double chip, double rate,
               double half, std::uint32_t& bad) noexcept {
  Room room;
  alignas(32) std::array<float, 2 * kRun> padded;
  const std::size_t whole = (n + kLanes - 1) / kLanes * kLanes;
  const float* from = reinterpret_cast<const float*>(x);
  if (whole != n) {
    std::fill(padded.begin() + static_cast<std::ptrdiff_t>(2 * n),
              padded.begin() + static_cast<std::ptrdiff_t>(2 * whole), 0.0F);
    std::memcpy(padded.data(), x, n * sizeof(Cf32));
    from = padded.data();
  }
  // Rotors of the first eight samples, and of a leap of eight.
  alignas(32) float turn_re[kLanes], turn_im[kLanes];
  const double start = kTwoPi * (phase - std::floor(phase));
  const std::complex<double> one = std::polar(1.0, kTwoPi * step);
  std::complex<double> rotor = std::polar(1.0, start), leap{1.0, 0.0};
  for (std::size_t u = 0; u < kLanes; ++u) {
    turn_re[u] = static_cast<float>(rotor.real());
    turn_im[u] = static_cast<float>(rotor.imag());
    rotor = {rotor.real() * one.real() - rotor.imag() * one.imag(),
             rotor.real() * one.imag() + rotor.imag() * one.real()};
    leap = {leap.real() * one.real() - leap.imag() * one.imag(), leap.real() * one.imag() + leap.imag() * one.real()};
  }
  const auto leap_re = static_cast<float>(leap.real()), leap_im = static_cast<float>(leap.imag());
  Sums sums;
  float power = mix(from, whole, turn_re, turn_im, leap_re, leap_im, room.re, room.im);
  if (!(power < 1e30F)) {
    if (from != padded.data()) std::memcpy(padded.data(), x, n * sizeof(Cf32));
    for (std::size_t k = 0; k < n; ++k) {
      if (usable(x[k])) continue;
      padded[2 * k] = padded[2 * k + 1] = 0.0F;
      ++bad;
    }
    power = mix(padded.data(), whole, turn_re, turn_im, leap_re, leap_im, room.re, room.im);
  }
  sums.power = static_cast<double>(power);

  const auto fraction = static_cast<std::uint64_t>(std::llround(rate * 4294967296.0));
  std::array<std::complex<double>*, 3> out{&sums.early, &sums.prompt, &sums.late};
  for (std::size_t arm = 0; arm < 3; ++arm) {
    double at = chip + half * (1.0 - static_cast<double>(arm));
    at -= code.length() * std::floor(at / code.length());
    auto where = static_cast<std::uint64_t>(at * 4294967296.0);
    double value[2];
    if (code.is_real()) {
      float* const to = room.code_re[arm];
      const float* const chips = code.real();
      for (std::size_t k = 0; k < whole; ++k, where += fraction) to[k] = chips[where >> 32U];
      dot_real(room.re, room.im, to, whole, value);
    } else {
      float* const to = room.code_re[arm];
      float* const to_im = room.code_im[arm];
      const Cf32* const chips = code.chips();
      for (std::size_t k = 0; k < whole; ++k, where += fraction) {
        const Cf32 c = chips[where >> 32U];
        to[k] = c.real();
        to_im[k] = c.imag();
      }
      dot_complex(room.re, room.im, to, to_im, whole, value);
    }
    *out[arm] = {value[0], value[1]};
  }
  return sums;
}

}  // namespace soopnav::tracking
