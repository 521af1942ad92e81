#include "soopnav/waveform/iridium/burst.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstring>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string_view>

#include "core/target_clones.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::iridium {
namespace {

constexpr int kTaps = 2 * Burst::kReach;  // symbols that reach a given time
constexpr int kPhases = 256;              // rows of the table in a symbol
constexpr double kFade = 2.0;             // symbols at the end of the pulse
constexpr std::size_t kRun = 256;         // samples between exact phases of a carrier
constexpr std::size_t kBlock = 64;        // samples whose places are worked out together
constexpr std::size_t kPad = 2 * Burst::kReach;
constexpr std::size_t kMaxSymbols = 250'000;

#define SOOPNAV_INLINE inline __attribute__((always_inline))
using Lanes = float __attribute__((vector_size(32)));
constexpr int kLanes = 8;

template <class Value>
void require(bool holds, std::string_view name, const Value& value, std::string_view rule) {
  if (holds) return;
  std::ostringstream message;
  message << name << " = " << value << " " << rule;
  throw std::invalid_argument(message.str());
}

// weight[r][j] = g(kReach - 1 - j + r / kPhases): the symbol j places into the reach, at phase r of a symbol.
struct PulseTable {
  alignas(32) float weight[kPhases + 1][kTaps];
  PulseTable() {
    for (int r = 0; r <= kPhases; ++r) {
      for (int j = 0; j < kTaps; ++j) {
        weight[r][j] = static_cast<float>(pulse(Burst::kReach - 1 - j + static_cast<double>(r) / kPhases));
      }
    }
  }
};

const PulseTable& table() {
  static const PulseTable kMade;
  return kMade;
}

SOOPNAV_INLINE void load(Lanes& out, const float* from) { std::memcpy(&out, from, sizeof out); }

SOOPNAV_INLINE float total(const Lanes& sum) {
  float lane[kLanes];
  std::memcpy(lane, &sum, sizeof lane);
  return ((lane[0] + lane[4]) + (lane[2] + lane[6])) + ((lane[1] + lane[5]) + (lane[3] + lane[7]));
}

// out[i] = sum_j w_j(place) a[first + j]; place = first + row of the table + share of the way to the next row.
struct Place {
  int first;
  int row;
  float share;
};

SOOPNAV_TARGET_CLONES void sum_symbols(const float* re, const float* im, const float* weight, const Place* places,
                                       std::size_t n, Cf32* out) {
  for (std::size_t i = 0; i < n; ++i) {
    const Place& place = places[i];
    const float* const row = weight + static_cast<std::size_t>(place.row) * kTaps;
    Lanes x{}, y{};
    for (int j = 0; j < kTaps; j += kLanes) {
      Lanes w, next, a, b;
      load(w, row + j);
      load(next, row + kTaps + j);
      load(a, re + place.first + j);
      load(b, im + place.first + j);
      w += place.share * (next - w);
      x += w * a;
      y += w * b;
    }
    out[i] = Cf32(total(x), total(y));
  }
}

// out[i] = s(time_at(i)). Symbols lie kPad zeros into `re` and `im`; what is outside the burst gets the first of those.
template <class TimeAt>
void evaluate_all(std::size_t symbols, const float* re, const float* im, std::span<Cf32> out, TimeAt time_at) {
  const float* const weight = &table().weight[0][0];
  const double end = static_cast<double>(symbols) - 0.5 + Burst::kReach;  // symbols of 40 us
  Place places[kBlock];
  for (std::size_t start = 0; start < out.size(); start += kBlock) {
    const std::size_t count = std::min(kBlock, out.size() - start);
    bool any = false;
    for (std::size_t i = 0; i < count; ++i) {
      const double u = time_at(start + i) * kSymbolRateHz;
      if (!(u > 0.5 - Burst::kReach && u < end)) {
        places[i] = {0, 0, 0.0F};
        continue;
      }
      any = true;
      // The last symbol centre at or before u is k = floor(u - 1/2); the reach begins with symbol k - (kReach - 1).
      const double v = u - 0.5 + Burst::kReach;  // above 0: truncation is floor
      const int whole = static_cast<int>(v);
      const double phase = (v - whole) * kPhases;
      const int row = static_cast<int>(phase);
      places[i] = {whole + 1, row, static_cast<float>(phase - row)};
    }
    if (any) {
      sum_symbols(re, im, weight, places, count, out.data() + start);
    } else {
      std::fill_n(out.data() + start, count, Cf32{});
    }
  }
}

}  // namespace

double pulse(double t_symbols) noexcept {
  const double t = std::abs(t_symbols), reach = Burst::kReach;
  if (!(t < reach)) return 0.0;
  constexpr double b = kRollOff;
  // The formula is 0/0 at t = 0 and at 4 b t = 1; near them it is smooth, and values a little aside serve.
  double g = 0.0;
  constexpr double kAside = 1e-5;
  const auto exact = [](double u) {
    const double x = 4.0 * b * u;
    return (std::sin(kPi * u * (1.0 - b)) + x * std::cos(kPi * u * (1.0 + b))) / (kPi * u * (1.0 - x * x));
  };
  if (t < kAside) {
    g = 1.0 - b + 4.0 * b / kPi;
  } else if (std::abs(4.0 * b * t - 1.0) < kAside) {
    g = 0.5 * (exact(t - 4.0 * kAside) + exact(t + 4.0 * kAside));
  } else {
    g = exact(t);
  }
  if (t > reach - kFade) g *= 0.5 * (1.0 + std::cos(kPi * (t - reach + kFade) / kFade));
  return g;
}

void Arrival::check() const {
  require(sample_rate_hz > 0.0 && std::isfinite(sample_rate_hz), "sample_rate_hz", sample_rate_hz,
          "must be positive and finite");
  require(std::isfinite(delay_s), "delay_s", delay_s, "must be finite");
  require(std::abs(delay_rate) < 0.1, "delay_rate", delay_rate, "must be within 0.1 s/s");
  require(std::isfinite(delay_acceleration), "delay_acceleration", delay_acceleration, "must be finite");
  require(std::isfinite(doppler_hz), "doppler_hz", doppler_hz, "must be finite");
  require(std::isfinite(doppler_rate_hz_per_s), "doppler_rate_hz_per_s", doppler_rate_hz_per_s, "must be finite");
  require(std::isfinite(phase_rad), "phase_rad", phase_rad, "must be finite");
  require(std::isfinite(amplitude), "amplitude", amplitude, "must be finite");
}

Burst Burst::make(BurstKind kind, RandomStream stream, double duration_s, BurstDirection direction) {
  struct Limits {
    std::size_t preamble, least, most, usual;
  };
  const auto limits_of = [kind]() -> Limits {
    switch (kind) {
      case BurstKind::kRingAlert:
      case BurstKind::kSimplex:
        return {64, 144, 508, 508};
      case BurstKind::kDuplex:
        return {16, 147, 207, 207};
      case BurstKind::kLong:
        break;
    }
    return {0, 1, kMaxSymbols, 2250};
  };
  const Limits limits = limits_of();
  const double asked = std::round(duration_s * kSymbolRateHz);
  std::size_t count = limits.usual;
  if (duration_s != 0.0) {
    std::ostringstream rule;
    rule << "must be 0 or within " << static_cast<double>(limits.least) / kSymbolRateHz << " ... "
         << static_cast<double>(limits.most) / kSymbolRateHz << " s for this kind of burst";
    require(asked >= static_cast<double>(limits.least) && asked <= static_cast<double>(limits.most), "duration_s",
            duration_s, rule.str());
    count = static_cast<std::size_t>(asked);
  }
  const bool down = direction == BurstDirection::kDownlink;
  std::vector<std::uint8_t> quadrants(count);
  std::size_t k = 0;
  // The downlink's preamble is bare carrier, the uplink's changes sign with every symbol.
  for (; k < limits.preamble; ++k) quadrants[k] = down || k % 2 == 1 ? 0 : 2;
  if (limits.preamble > 0) {
    for (const std::uint8_t q : down ? kDownlinkWord : kUplinkWord) quadrants[k++] = q;
  }
  const std::size_t payload = k;
  for (std::uint32_t before = k > 0 ? quadrants[k - 1] : 0; k < count; ++k) {
    before = (before + (stream.next_u32() >> 30)) & 3U;
    quadrants[k] = static_cast<std::uint8_t>(before);
  }
  constexpr float kHalf = 0.70710678F;
  std::vector<Cf32> symbols(count);
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint8_t q = quadrants[i];
    symbols[i] = Cf32(q == 0 || q == 3 ? kHalf : -kHalf, q < 2 ? kHalf : -kHalf);
  }
  Burst burst(symbols);
  burst.quadrants_ = std::move(quadrants);
  burst.payload_start_ = payload;
  return burst;
}

Burst::Burst(std::span<const Cf32> symbols) : symbols_(symbols.size()) {
  require(!symbols.empty() && symbols.size() <= kMaxSymbols, "symbols.size()", symbols.size(),
          "must be in 1 ... 250000");
  const auto padded = symbols.size() + 2 * kPad;
  re_.assign(padded, 0.0F);
  im_.assign(padded, 0.0F);
  for (std::size_t k = 0; k < symbols.size(); ++k) {
    const Cf32 a = symbols[k];
    if (!std::isfinite(a.real()) || !std::isfinite(a.imag())) {
      throw std::invalid_argument("symbols[" + std::to_string(k) + "] must be finite");
    }
    re_[k + kPad] = a.real();
    im_[k + kPad] = a.imag();
  }
  static_cast<void>(table());  // made here, so that evaluate() does not
}

void Burst::evaluate(double t0_s, double dt_s, double quadratic_s, std::span<Cf32> out) const noexcept {
  evaluate_all(symbols_, re_.data(), im_.data(), out, [=](std::size_t i) {
    const double n = static_cast<double>(i);
    return t0_s + (dt_s + quadratic_s * n) * n;
  });
}

void Burst::evaluate(std::span<const double> t_s, std::span<Cf32> out) const noexcept {
  evaluate_all(symbols_, re_.data(), im_.data(), out.first(std::min(t_s.size(), out.size())),
               [t_s](std::size_t i) { return t_s[i]; });
}

template <bool kAdd>
void Burst::render_all(const Arrival& a, std::span<Cf32> out) const noexcept {
  const double dt = 1.0 / a.sample_rate_hz;
  std::size_t first = 0, last = out.size();
  if (a.delay_acceleration == 0.0) {  // then the burst's samples are easily told, and the rest is not gone through
    const double stretch = a.sample_rate_hz / (1.0 - a.delay_rate), reach = kReach / kSymbolRateHz;
    const double size = static_cast<double>(out.size());
    first = static_cast<std::size_t>(std::clamp((a.delay_s - reach) * stretch, 0.0, size));
    last = static_cast<std::size_t>(std::clamp((a.delay_s + duration_s() + reach) * stretch + 1.0, 0.0, size));
  }
  if constexpr (!kAdd) {
    std::fill_n(out.begin(), first, Cf32{});
    std::fill(out.begin() + static_cast<std::ptrdiff_t>(last), out.end(), Cf32{});
  }
  Cf32 envelope[kRun];
  for (std::size_t start = first; start < last; start += kRun) {
    const std::size_t count = std::min(kRun, last - start);
    const double t0 = static_cast<double>(start) * dt;
    const double rate = 1.0 - a.delay_rate - a.delay_acceleration * t0;
    evaluate(t0 * (1.0 - a.delay_rate - 0.5 * a.delay_acceleration * t0) - a.delay_s, rate * dt,
             -0.5 * a.delay_acceleration * dt * dt, {envelope, count});
    // Phase of sample i of the run: exact at its start, then a rotation that itself rotates.
    double turns = (a.doppler_hz + 0.5 * a.doppler_rate_hz_per_s * t0) * t0;
    turns -= std::floor(turns);
    std::complex<double> carrier = std::polar(a.amplitude, kTwoPi * turns + a.phase_rad);
    const double cycles = (a.doppler_hz + a.doppler_rate_hz_per_s * t0) * dt, bend = a.doppler_rate_hz_per_s * dt * dt;
    std::complex<double> step = std::polar(1.0, kTwoPi * (cycles - std::floor(cycles) + 0.5 * bend));
    const std::complex<double> turn = std::polar(1.0, kTwoPi * bend);
    for (std::size_t i = 0; i < count; ++i) {
      const Cf32 s = envelope[i];
      const double x = s.real(), y = s.imag(), c = carrier.real(), d = carrier.imag();
      const Cf32 z(static_cast<float>(x * c - y * d), static_cast<float>(x * d + y * c));
      if constexpr (kAdd) {
        out[start + i] += z;
      } else {
        out[start + i] = z;
      }
      // Written out: std::complex multiplication looks for infinities.
      carrier = {c * step.real() - d * step.imag(), c * step.imag() + d * step.real()};
      step = {step.real() * turn.real() - step.imag() * turn.imag(),
              step.real() * turn.imag() + step.imag() * turn.real()};
    }
  }
}

void Burst::render(const Arrival& arrival, std::span<Cf32> out) const {
  arrival.check();
  render_all<false>(arrival, out);
}

void Burst::add_to(const Arrival& arrival, std::span<Cf32> out) const {
  arrival.check();
  render_all<true>(arrival, out);
}

void matched_filter(IqSpan samples, double sample_rate_hz, double start_s, double frequency_hz, std::span<Cf32> out) {
  require(sample_rate_hz >= 35e3 && std::isfinite(sample_rate_hz), "sample_rate_hz", sample_rate_hz,
          "must be at least 35e3, the band of a burst");
  require(std::isfinite(start_s), "start_s", start_s, "must be finite");
  require(std::isfinite(frequency_hz), "frequency_hz", frequency_hz, "must be finite");
  const double per_symbol = sample_rate_hz / kSymbolRateHz, size = static_cast<double>(samples.size());
  const double cycles = frequency_hz / sample_rate_hz;
  const std::complex<double> step = std::polar(1.0, -kTwoPi * cycles);
  for (std::size_t k = 0; k < out.size(); ++k) {
    const double centre = start_s * sample_rate_hz + (static_cast<double>(k) + 0.5) * per_symbol;
    const double from = std::clamp(std::ceil(centre - Burst::kReach * per_symbol), 0.0, size);
    const double to = std::clamp(std::floor(centre + Burst::kReach * per_symbol) + 1.0, from, size);
    const double turns = cycles * from;
    std::complex<double> carrier = std::polar(1.0, -kTwoPi * (turns - std::floor(turns)));
    double re = 0.0, im = 0.0;
    for (auto n = static_cast<std::size_t>(from); n < static_cast<std::size_t>(to); ++n) {
      const double g = pulse((static_cast<double>(n) - centre) / per_symbol);
      const double x = static_cast<double>(samples[n].real()), y = static_cast<double>(samples[n].imag());
      const double c = carrier.real(), d = carrier.imag();
      re += g * (x * c - y * d);
      im += g * (x * d + y * c);
      carrier = {c * step.real() - d * step.imag(), c * step.imag() + d * step.real()};
    }
    out[k] = Cf32(static_cast<float>(re / per_symbol), static_cast<float>(im / per_symbol));
  }
}

}  // namespace soopnav::iridium
