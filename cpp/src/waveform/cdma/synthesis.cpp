#include "soopnav/waveform/cdma/synthesis.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <stdexcept>
#include <string>
#include <utility>

#include "soopnav/core/constants.hpp"

namespace soopnav::cdma {
namespace {

constexpr std::size_t kRun = 512;          // samples between exact phases
constexpr std::size_t kSpan = 16;          // chips that a filtered one reaches over
constexpr std::size_t kPulsePhases = 128;  // of a chip
constexpr std::int64_t kSymbolZero = std::int64_t{1} << 40;

// Taps of C.S0002 table 3.1.3.1.11-1, of which k and 47 - k are equal.
constexpr std::array<double, 48> kTaps = [] {
  constexpr std::array<double, 24> half{
      -0.025288315, -0.034167931, -0.035752323, -0.016733702, 0.021602514, 0.064938487, 0.091002137, 0.081894974,
      0.037071157,  -0.021998074, -0.060716277, -0.051178658, 0.007874526, 0.084368728, 0.126869306, 0.094528345,
      -0.012839661, -0.143477028, -0.211829088, -0.140513128, 0.094601918, 0.441387140, 0.785875640, 1.0};
  std::array<double, 48> all{};
  for (std::size_t k = 0; k < 24; ++k) all[k] = all[47 - k] = half[k];
  return all;
}();

void require_pilot(bool holds, const std::string& name, double value, const char* rule) {
  if (!holds) throw std::invalid_argument(name + " = " + std::to_string(value) + " " + rule);
}

// The filter's pulse over kSpan chips at kPulsePhases a chip, of unit energy a chip: band-limited between taps.
std::vector<float> make_pulse() {
  std::vector<double> pulse(kSpan * kPulsePhases + 1);
  double energy = 0.0;
  for (std::size_t i = 0; i < pulse.size(); ++i) {
    const double chips = static_cast<double>(i) / kPulsePhases - 0.5 * kSpan;
    for (std::size_t k = 0; k < kTaps.size(); ++k) {
      const double u = 4.0 * chips - (static_cast<double>(k) - 23.5);
      if (std::abs(u) >= 8.0) continue;
      const double sinc = u == 0.0 ? 1.0 : std::sin(kPi * u) / (kPi * u);
      pulse[i] += kTaps[k] * sinc * (0.5 + 0.5 * std::cos(kPi * u / 8.0));
    }
    energy += pulse[i] * pulse[i] / kPulsePhases;
  }
  std::vector<float> out;
  for (const double value : pulse) out.push_back(static_cast<float>(value / std::sqrt(energy)));
  return out;
}

}  // namespace

std::span<const double, 48> baseband_filter() noexcept { return kTaps; }

PilotGenerator::PilotGenerator(std::vector<PilotSignal> signals, const SynthesisOptions& options)
    : signals_(std::move(signals)), options_(options), code_(pilot_code(0)) {
  const SynthesisOptions& o = options_;
  require_pilot(o.sample_rate_hz > 0.0 && std::isfinite(o.sample_rate_hz), "sample_rate_hz", o.sample_rate_hz,
                "must be positive and finite");
  require_pilot(std::abs(o.intermediate_hz) <= 0.5 * o.sample_rate_hz, "intermediate_hz", o.intermediate_hz,
                "must be within half the sampling rate");
  require_pilot(o.carrier_hz > 1e6 && std::isfinite(o.carrier_hz), "carrier_hz", o.carrier_hz,
                "must be finite, above 1e6");
  for (std::size_t i = 0; i < signals_.size(); ++i) {
    const PilotSignal& s = signals_[i];
    const std::string name = "signals[" + std::to_string(i) + "].";
    require_pilot(s.pn_offset >= 0 && s.pn_offset < kOffsets, name + "pn_offset", s.pn_offset, "must be in [0, 511]");
    require_pilot(std::abs(s.delay_s) < 1e6, name + "delay_s", s.delay_s, "must be finite, below 1e6");
    require_pilot(std::abs(s.doppler_hz) <= 1e6, name + "doppler_hz", s.doppler_hz, "must be within 1e6");
    require_pilot(std::isfinite(s.phase_cycles), name + "phase_cycles", s.phase_cycles, "must be finite");
    require_pilot(std::abs(s.cn0_dbhz) < 200.0, name + "cn0_dbhz", s.cn0_dbhz, "must be within 200");
    for (const WalshChannel& c : s.channels) {
      require_pilot(c.index >= 1 && c.index < kWalshLength, name + "channels.index", static_cast<double>(c.index),
                    "must be in [1, 63]");
      require_pilot(std::abs(c.power_db) < 200.0, name + "channels.power_db", c.power_db, "must be within 200");
    }
  }
  if (o.shape == ChipShape::kStandard) pulse_ = make_pulse();
}

// One chip of everything a base station sends.
Cf32 PilotGenerator::chip(const PilotSignal& signal, std::size_t number, std::int64_t chip) const noexcept {
  const std::int64_t late = chip - static_cast<std::int64_t>(kOffsetChips) * signal.pn_offset;
  const Cf32 spread = code_[static_cast<std::size_t>(late & static_cast<std::int64_t>(kCodeLength - 1))];
  if (signal.channels.empty()) return spread;
  float re = 1.0F, im = 0.0F;
  const std::int64_t symbol = late >> 6;
  for (const WalshChannel& c : signal.channels) {
    RandomStream data(options_.data_seed, 64 * number + c.index);
    data.seek(static_cast<std::uint64_t>(symbol + kSymbolZero));
    const std::uint32_t bits = data.next_u32();
    const double size = std::sqrt(0.5) * std::pow(10.0, c.power_db / 20.0) *
                        walsh_chip(c.index, static_cast<std::size_t>(late & std::int64_t{63}));
    re += static_cast<float>((bits & 1U) != 0U ? -size : size);
    im += static_cast<float>((bits & 2U) != 0U ? -size : size);
  }
  return {re * spread.real() - im * spread.imag(), re * spread.imag() + im * spread.real()};
}

void PilotGenerator::render(std::uint64_t first, std::span<Cf32> out) const noexcept {
  std::fill(out.begin(), out.end(), Cf32{});
  for (std::size_t k = 0; k < signals_.size(); ++k) {
    const PilotSignal& s = signals_[k];
    const double amplitude = std::sqrt(std::pow(10.0, s.cn0_dbhz / 10.0) / options_.sample_rate_hz);
    const double carrier = (options_.intermediate_hz + s.doppler_hz) / options_.sample_rate_hz;  // cycles a sample
    const double chips = kChipRateHz * (1.0 + s.doppler_hz / options_.carrier_hz) / options_.sample_rate_hz;
    const std::complex<double> step = std::polar(1.0, kTwoPi * carrier);
    std::array<Cf32, kSpan> ring{};  // chips before and after, for the filter; [0]: the present one without it
    std::int64_t ring_at = INT64_MIN;
    for (std::size_t start = 0; start < out.size(); start += kRun) {
      const double n0 = static_cast<double>(first + start);
      double turn = carrier * n0;
      turn += s.phase_cycles - std::floor(turn);
      std::complex<double> rotor = std::polar(amplitude, kTwoPi * (turn - std::floor(turn)));
      const double chip0 = chips * n0 - kChipRateHz * s.delay_s;
      const std::size_t end = std::min(start + kRun, out.size());
      for (std::size_t n = start; n < end; ++n) {
        const double u = chip0 + chips * static_cast<double>(n - start);
        const double whole = std::floor(u);
        const auto at = static_cast<std::int64_t>(whole);
        Cf32 value;
        if (pulse_.empty()) {
          if (at != ring_at) ring[0] = chip(s, k, at);
          ring_at = at;
          value = ring[0];
        } else {
          // Chips at - 8 + m, m = 0 ... 15, have their middles at u - (at - 8 + m + 1/2) before.
          if (at != ring_at) {
            for (std::size_t m = 0; m < kSpan; ++m) {
              ring[m] = at == ring_at + 1 && m + 1 < kSpan
                            ? ring[m + 1]
                            : chip(s, k, at - static_cast<std::int64_t>(kSpan / 2) + static_cast<std::int64_t>(m));
            }
            ring_at = at;
          }
          float re = 0.0F, im = 0.0F;
          for (std::size_t m = 0; m < kSpan; ++m) {
            const double where = (u - whole + kSpan - 0.5 - static_cast<double>(m)) * kPulsePhases;
            if (where < 0.0 || where >= static_cast<double>(pulse_.size() - 1)) continue;
            const auto left = static_cast<std::size_t>(where);
            const auto part = static_cast<float>(where - static_cast<double>(left));
            const float weight = pulse_[left] + part * (pulse_[left + 1] - pulse_[left]);
            re += weight * ring[m].real();
            im += weight * ring[m].imag();
          }
          value = {re, im};
        }
        const auto c = static_cast<float>(rotor.real());
        const auto j = static_cast<float>(rotor.imag());
        out[n] += Cf32(value.real() * c - value.imag() * j, value.real() * j + value.imag() * c);
        // Written out: std::complex multiplication looks for infinities.
        rotor = {rotor.real() * step.real() - rotor.imag() * step.imag(),
                 rotor.real() * step.imag() + rotor.imag() * step.real()};
      }
    }
  }
}

void PilotGenerator::render(std::uint64_t first, std::span<Cf32> out, RandomStream noise) const noexcept {
  render(first, out);
  noise.seek(2 * first);
  noise.add_complex_normal(out, 1.0);
}

}  // namespace soopnav::cdma
