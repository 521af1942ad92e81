#include "soopnav/waveform/gps/aided_correlator.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "soopnav/core/constants.hpp"

namespace soopnav::gps {
namespace {

constexpr std::size_t kAidedRun = 512;  // samples between exact phases
constexpr double kHalfChips = 2.0 * static_cast<double>(kCodeLength);

void require_aided(bool holds, const char* name, double value, const char* rule) {
  if (!holds) throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " " + rule);
}

std::complex<double> aided_turn(double cycles) noexcept {
  return std::polar(1.0, kTwoPi * (cycles - std::floor(cycles)));
}

}  // namespace

AidedCorrelator::AidedCorrelator(int prn, const AidedOptions& options) : options_(options) {
  const CaCode code = ca_code(prn);
  require_aided(options.sample_rate_hz >= kChipRateHz && options.sample_rate_hz <= 1e9, "sample_rate_hz",
                options.sample_rate_hz, "must be from the chip rate to 1 GHz");
  require_aided(std::abs(options.intermediate_hz) <= 0.5 * options.sample_rate_hz, "intermediate_hz",
                options.intermediate_hz, "must be within half the sampling rate");
  require_aided(options.block_s > 0.0 && options.block_s <= 1.0 && options.block_s * options.sample_rate_hz >= 1.0,
                "block_s", options.block_s, "must be at least a sample and at most 1");
  require_aided(options.max_blocks >= 1 && options.max_blocks <= 1'000'000, "max_blocks",
                static_cast<double>(options.max_blocks), "must be in [1, 1000000]");
  require_aided(options.half_chips >= 0 && options.half_chips <= 64, "half_chips", options.half_chips,
                "must be in [0, 64]");
  for (const std::int8_t bit : options.bits) require_aided(bit == 1 || bit == -1, "bits", bit, "must be +1 or -1");
  block_samples_ = static_cast<std::size_t>(std::llround(options.block_s * options.sample_rate_hz));
  const auto ends = static_cast<std::size_t>(options.half_chips);
  const std::size_t length = 2 * kCodeLength;
  chips_.resize(length + 2 * ends);
  for (std::size_t i = 0; i < chips_.size(); ++i) chips_[i] = code[((i + length - ends) % length) / 2];
  sums_.resize(options.max_blocks * codes());
  mixed_.resize(2 * kAidedRun);
  partial_.resize(2 * codes());
}

double AidedCorrelator::block_s() const noexcept {
  return static_cast<double>(block_samples_) / options_.sample_rate_hz;
}

double AidedCorrelator::delay_chips(std::size_t code) const noexcept {
  return 0.5 * (static_cast<double>(code) - options_.half_chips);
}

std::span<const std::complex<double>> AidedCorrelator::sums() const noexcept {
  return std::span(sums_).first(blocks_ * codes());
}

bool AidedCorrelator::push(IqSpan block, const Prediction& p) noexcept {
  if (block.size() != block_samples_ || blocks_ == options_.max_blocks) return false;
  if (!(std::abs(p.transmit_time_s) < 1e9 && std::abs(p.carrier_phase_cycles) < 1e15 && std::abs(p.doppler_hz) < 1e6 &&
        std::abs(p.doppler_rate_hzps) < 1e6)) {
    return false;
  }
  const std::size_t width = codes();
  const auto row = std::span(sums_).subspan(blocks_ * width, width);
  std::fill(row.begin(), row.end(), std::complex<double>{});
  const double rate = options_.sample_rate_hz;
  const auto periods = static_cast<double>(options_.bits.size());
  for (std::size_t start = 0; start < block.size(); start += kAidedRun) {
    const std::size_t count = std::min(kAidedRun, block.size() - start);
    const double t = static_cast<double>(start) / rate;
    // Replica: exp(j 2 pi (f_if t - φ + D t + D' t² / 2)); here its conjugate.
    const double frequency = options_.intermediate_hz + p.doppler_hz + p.doppler_rate_hzps * t;
    double cycles = p.carrier_phase_cycles - std::floor(p.carrier_phase_cycles);
    cycles -= options_.intermediate_hz / rate * static_cast<double>(blocks_ * block_samples_);
    cycles -= (options_.intermediate_hz + p.doppler_hz + 0.5 * p.doppler_rate_hzps * t) * t;
    std::complex<double> rotor = aided_turn(cycles);
    const std::complex<double> step = aided_turn(-frequency / rate);
    for (std::size_t n = 0; n < count; ++n) {
      const Cf32 x = block[start + n];
      const auto re = static_cast<float>(rotor.real()), im = static_cast<float>(rotor.imag());
      mixed_[2 * n] = x.real() * re - x.imag() * im;
      mixed_[2 * n + 1] = x.real() * im + x.imag() * re;
      rotor = {rotor.real() * step.real() - rotor.imag() * step.imag(),
               rotor.real() * step.imag() + rotor.imag() * step.real()};
    }
    const double pace = 1.0 + (p.doppler_hz + p.doppler_rate_hzps * t) / kCarrierHz;
    const double sent = p.transmit_time_s + t + (p.doppler_hz + 0.5 * p.doppler_rate_hzps * t) / kCarrierHz * t;
    double half = 2.0 * kChipRateHz * sent;  // half chips since bit 0
    double code = std::floor(half / kHalfChips);
    half -= code * kHalfChips;
    const double half_step = 2.0 * kChipRateHz * pace / rate;
    const auto sign_of = [&](double codes_sent) {
      if (options_.bits.empty()) return 1.0F;
      const double bit = std::floor(codes_sent / 20.0);
      return static_cast<float>(options_.bits[static_cast<std::size_t>(bit - periods * std::floor(bit / periods))]);
    };
    float sign = sign_of(code);
    std::fill(partial_.begin(), partial_.end(), 0.0F);
    std::size_t first = 0;
    while (first < count) {
      // To the end of the run or of the code.
      const double left = std::ceil((kHalfChips - half) / half_step);
      const std::size_t here = std::min(count - first, static_cast<std::size_t>(std::max(1.0, left)));
      for (std::size_t i = 0; i < here; ++i) {
        const auto at =
            std::min(static_cast<std::size_t>(half + half_step * static_cast<double>(i)), 2 * kCodeLength - 1);
        // Column o holds the code o half chips later: the chip of o half chips before.
        const float* const chip = chips_.data() + at;
        const float re = sign * mixed_[2 * (first + i)], im = sign * mixed_[2 * (first + i) + 1];
        for (std::size_t k = 0; k < width; ++k) {
          const float c = chip[width - 1 - k];
          partial_[2 * k] += c * re;
          partial_[2 * k + 1] += c * im;
        }
      }
      half += half_step * static_cast<double>(here);
      first += here;
      if (half >= kHalfChips) {
        half -= kHalfChips;
        code += 1.0;
        sign = sign_of(code);
      }
    }
    for (std::size_t k = 0; k < width; ++k) {
      row[k] += std::complex<double>(static_cast<double>(partial_[2 * k]), static_cast<double>(partial_[2 * k + 1]));
    }
  }
  for (const std::complex<double>& sum : row) {
    if (!std::isfinite(sum.real()) || !std::isfinite(sum.imag())) return false;
  }
  ++blocks_;
  return true;
}

bool search_frequencies(std::span<const std::complex<double>> sums, std::size_t codes, double block_s, double variance,
                        const FrequencyGrid& grid, std::size_t coherent_blocks, std::span<double> out) noexcept {
  if (codes == 0 || grid.count == 0 || coherent_blocks == 0 || sums.size() % codes != 0 ||
      out.size() != codes * grid.count) {
    return false;
  }
  const std::size_t rows = sums.size() / codes;
  const std::size_t many = rows / coherent_blocks;
  if (many == 0 || !(block_s > 0.0 && std::isfinite(block_s) && variance > 0.0 && std::isfinite(variance)))
    return false;
  if (!std::isfinite(grid.first_hz) || !std::isfinite(grid.step_hz)) return false;
  for (const std::complex<double>& y : sums) {
    if (!std::isfinite(y.real()) || !std::isfinite(y.imag())) return false;
  }
  const double scale = 1.0 / (variance * static_cast<double>(coherent_blocks));
  for (std::size_t f = 0; f < grid.count; ++f) {
    const double frequency = grid.first_hz + static_cast<double>(f) * grid.step_hz;
    const std::complex<double> step = aided_turn(-frequency * block_s);
    for (std::size_t c = 0; c < codes; ++c) {
      double total = 0.0;
      std::complex<double> rotor = aided_turn(-0.5 * frequency * block_s);
      for (std::size_t m = 0; m < many; ++m) {
        double re = 0.0, im = 0.0;
        for (std::size_t b = 0; b < coherent_blocks; ++b) {
          const std::size_t row = m * coherent_blocks + b;
          if (row % kAidedRun == 0) rotor = aided_turn(-frequency * block_s * (static_cast<double>(row) + 0.5));
          const std::complex<double>& y = sums[row * codes + c];
          re += y.real() * rotor.real() - y.imag() * rotor.imag();
          im += y.real() * rotor.imag() + y.imag() * rotor.real();
          rotor = {rotor.real() * step.real() - rotor.imag() * step.imag(),
                   rotor.real() * step.imag() + rotor.imag() * step.real()};
        }
        total += re * re + im * im;
      }
      out[c * grid.count + f] = total * scale;
    }
  }
  return true;
}

}  // namespace soopnav::gps
