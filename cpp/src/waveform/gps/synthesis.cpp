#include "soopnav/waveform/gps/synthesis.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <stdexcept>
#include <string>
#include <utility>

#include "soopnav/core/constants.hpp"

namespace soopnav::gps {
namespace {

void require(bool holds, const std::string& name, double value, const char* rule) {
  if (!holds) throw std::invalid_argument(name + " = " + std::to_string(value) + " " + rule);
}

constexpr std::size_t kRun = 512;  // samples between exact phases

}  // namespace

SignalGenerator::SignalGenerator(std::vector<SatelliteSignal> signals, double sample_rate_hz, double intermediate_hz)
    : signals_(std::move(signals)), sample_rate_hz_(sample_rate_hz), intermediate_hz_(intermediate_hz) {
  require(sample_rate_hz > 0.0 && std::isfinite(sample_rate_hz), "sample_rate_hz", sample_rate_hz,
          "must be positive and finite");
  require(std::abs(intermediate_hz) <= 0.5 * sample_rate_hz, "intermediate_hz", intermediate_hz,
          "must be within half the sampling rate");
  for (std::size_t i = 0; i < signals_.size(); ++i) {
    const SatelliteSignal& s = signals_[i];
    const std::string name = "signals[" + std::to_string(i) + "].";
    codes_.push_back(ca_code(s.prn));
    require(std::abs(s.delay_s) < 1e6, name + "delay_s", s.delay_s, "must be finite, below 1e6");
    require(std::abs(s.doppler_hz) <= 1e6, name + "doppler_hz", s.doppler_hz, "must be within 1e6");
    require(std::isfinite(s.phase_cycles), name + "phase_cycles", s.phase_cycles, "must be finite");
    require(std::abs(s.cn0_dbhz) < 200.0, name + "cn0_dbhz", s.cn0_dbhz, "must be within 200");
    for (const std::int8_t bit : s.bits) require(bit == 1 || bit == -1, name + "bits", bit, "must be +1 or -1");
  }
}

void SignalGenerator::render(std::uint64_t first, std::span<Cf32> out) const noexcept {
  std::fill(out.begin(), out.end(), Cf32{});
  for (std::size_t k = 0; k < signals_.size(); ++k) {
    const SatelliteSignal& s = signals_[k];
    const CaCode& code = codes_[k];
    const double amplitude = std::sqrt(std::pow(10.0, s.cn0_dbhz / 10.0) / sample_rate_hz_);
    const double carrier = (intermediate_hz_ + s.doppler_hz) / sample_rate_hz_;  // cycles a sample
    const double chips = kChipRateHz * (1.0 + s.doppler_hz / kCarrierHz) / sample_rate_hz_;
    const std::complex<double> step = std::polar(1.0, kTwoPi * carrier);
    constexpr double kChipsPerBit = kChipRateHz * kBitPeriodS;
    for (std::size_t start = 0; start < out.size(); start += kRun) {
      const double n0 = static_cast<double>(first + start);
      double turn = carrier * n0;
      turn += s.phase_cycles - std::floor(turn);
      std::complex<double> rotor = std::polar(amplitude, kTwoPi * (turn - std::floor(turn)));
      const double chip0 = chips * n0 - kChipRateHz * s.delay_s;
      const std::size_t end = std::min(start + kRun, out.size());
      for (std::size_t n = start; n < end; ++n) {
        const double chip = std::floor(chip0 + chips * static_cast<double>(n - start));
        const double period = std::floor(chip / static_cast<double>(kCodeLength));
        const std::int8_t chip_sign = code[static_cast<std::size_t>(chip - period * static_cast<double>(kCodeLength))];
        int sign = chip_sign < 0 ? -1 : 1;
        if (!s.bits.empty()) {
          const auto count = static_cast<double>(s.bits.size());
          const double bit = std::floor(chip / kChipsPerBit);
          sign *= s.bits[static_cast<std::size_t>(bit - count * std::floor(bit / count))];
        }
        out[n] += Cf32(static_cast<float>(sign * rotor.real()), static_cast<float>(sign * rotor.imag()));
        // Written out: std::complex multiplication looks for infinities.
        rotor = {rotor.real() * step.real() - rotor.imag() * step.imag(),
                 rotor.real() * step.imag() + rotor.imag() * step.real()};
      }
    }
  }
}

void SignalGenerator::render(std::uint64_t first, std::span<Cf32> out, RandomStream noise) const noexcept {
  render(first, out);
  noise.seek(2 * first);
  noise.add_complex_normal(out, 1.0);
}

}  // namespace soopnav::gps
