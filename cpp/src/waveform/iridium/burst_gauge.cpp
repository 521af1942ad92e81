#include "waveform/iridium/burst_gauge.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <utility>

#include "soopnav/core/constants.hpp"
#include "soopnav/waveform/iridium/burst.hpp"
#include "waveform/iridium/detector_kernels.hpp"

namespace soopnav::iridium {
namespace {

constexpr int kFftSize = 4096;            // 20 ms of a channel
constexpr double kChannelRateHz = 100e3;  // at least
constexpr double kPassHz = 21e3;          // kept as it is
constexpr double kPulseReach = 6.0;       // symbols of the matched filter
constexpr double kBandHz = 24e3;          // looked at for power and bandwidth, to either side
constexpr double kLineHz = 12e3;          // where four times the carrier may lie, to either side
constexpr double kLineRatio = 16.0;       // of the line over the spectrum around it
constexpr double kLineMostS = 20e-3;
constexpr double kPulseSigmaHz = 7.5e3;  // root-mean-square width of the pulse's spectrum
constexpr double kMostMiddle = 5.0;      // so that a weak burst after a strong one is seen
constexpr double kRiseNats = 12.0;       // of likelihood, that a signal is there
constexpr double kFallNats = 8.0;        // that it is over
constexpr std::size_t kRun = 256;        // samples between exact phases

// Kaiser's I0, by its series.
double bessel_i0(double x) {
  double sum = 1.0, term = 1.0;
  for (int k = 1; k < 60; ++k) {
    term *= 0.25 * x * x / (k * k);
    sum += term;
  }
  return sum;
}

// Taps h(-half ... half), twice each, to a multiple of four taps.
template <class Tap>
std::vector<float> doubled(std::size_t half, Tap tap) {
  const std::size_t padded = (2 * half + 4) / 4 * 4;
  std::vector<float> out(2 * padded, 0.0F);
  for (std::size_t i = 0; i <= 2 * half; ++i) {
    out[2 * i] = out[2 * i + 1] = static_cast<float>(tap(static_cast<double>(i) - static_cast<double>(half)));
  }
  return out;
}

}  // namespace

BurstGauge::BurstGauge(double sample_rate_hz, std::size_t most_samples)
    : rate_(sample_rate_hz),
      stride_(std::max<std::size_t>(1, static_cast<std::size_t>(sample_rate_hz / kChannelRateHz))),
      channel_rate_(sample_rate_hz / static_cast<double>(stride_)),
      most_samples_(most_samples),
      fft_(kFftSize, dsp::FftDirection::kForward) {
  if (stride_ > 1) {
    // Kaiser window for 60 dB: what folds onto the pass band lies beyond channel_rate - kPassHz.
    constexpr double kBeta = 5.65;
    const double width = (channel_rate_ - 2.0 * kPassHz) / rate_, cutoff = 0.5 * channel_rate_ / rate_;
    taps_ = static_cast<std::size_t>(std::ceil(0.5 * (60.0 - 8.0) / (2.285 * kTwoPi * width)));
    const double half = static_cast<double>(taps_);
    const auto tap = [&](double i) {
      const double u = i / (half + 1.0), x = kTwoPi * cutoff * i;
      const double sinc = i == 0.0 ? 1.0 : std::sin(x) / x;
      return 2.0 * cutoff * sinc * bessel_i0(kBeta * std::sqrt(1.0 - u * u)) / bessel_i0(kBeta);
    };
    double sum = 0.0;
    for (double i = -half; i <= half; i += 1.0) sum += tap(i);
    filter_ = doubled(taps_, [&](double i) { return tap(i) / sum; });
  }
  const double per_symbol = channel_rate_ / kSymbolRateHz;
  pulse_taps_ = static_cast<std::size_t>(kPulseReach * per_symbol);
  pulse_ = doubled(pulse_taps_, [&](double i) {
    const double fade = 0.5 + 0.5 * std::cos(kPi * i / (kPulseReach * per_symbol + 1.0));
    return pulse(i / per_symbol) * std::min(1.0, 4.0 * fade) / per_symbol;
  });
  const std::size_t outputs = most_samples_ / stride_ + 1;
  mixed_.assign(most_samples_ + 2 * taps_ + 4, Cf32{});
  channel_.assign(outputs + 2 * pulse_taps_ + 4, Cf32{});
  matched_.assign(outputs, Cf32{});
  work_.assign(kFftSize, Cf32{});
  transform_.assign(kFftSize, Cf32{});
  power_.assign(kFftSize, 0.0F);
}

void BurstGauge::mix(IqSpan samples, double frequency_hz, double scale) noexcept {
  const double cycles = -frequency_hz / rate_;
  const std::complex<double> step = std::polar(1.0, kTwoPi * cycles);
  Cf32* const out = mixed_.data() + taps_;
  for (std::size_t start = 0; start < samples.size(); start += kRun) {
    const double turns = cycles * static_cast<double>(start);
    std::complex<double> carrier = std::polar(scale, kTwoPi * (turns - std::floor(turns)));
    const std::size_t end = std::min(start + kRun, samples.size());
    for (std::size_t n = start; n < end; ++n) {
      const float c = static_cast<float>(carrier.real()), d = static_cast<float>(carrier.imag());
      const float x = samples[n].real(), y = samples[n].imag();
      out[n] = Cf32(x * c - y * d, x * d + y * c);
      carrier = {carrier.real() * step.real() - carrier.imag() * step.imag(),
                 carrier.real() * step.imag() + carrier.imag() * step.real()};
    }
  }
  std::fill(mixed_.begin() + static_cast<std::ptrdiff_t>(taps_ + samples.size()), mixed_.end(), Cf32{});
}

// power_[k]: squared spectrum of `n` <= kFftSize samples at (k - kFftSize / 2) channel_rate_ / kFftSize.
void BurstGauge::spectrum_of(const Cf32* from, std::size_t n) noexcept {
  for (std::size_t i = 0; i < n; ++i) work_[i] = i % 2 == 0 ? from[i] : -from[i];
  std::fill(work_.begin() + static_cast<std::ptrdiff_t>(n), work_.end(), Cf32{});
  fft_.execute(work_.data(), transform_.data());
  kernels::square(transform_.data(), kFftSize, power_.data());
}

// Power, bandwidth and centre of gravity of what rises above the noise (1 in 25 kHz) within kBandHz.
void BurstGauge::weigh_spectrum(std::size_t n, GaugedSignal& signal) const noexcept {
  const double bin = channel_rate_ / kFftSize, samples = static_cast<double>(n);
  const double noise = samples * channel_rate_ / kSymbolRateHz;
  const auto half = static_cast<std::size_t>(std::min(kBandHz, 0.48 * channel_rate_) / bin);
  const std::size_t first = kFftSize / 2 - half, last = kFftSize / 2 + half;
  double sum = 0.0, moment = 0.0;
  for (std::size_t k = first; k <= last; ++k) {
    const double excess = static_cast<double>(power_[k]) - noise;
    sum += excess;
    moment += excess * (static_cast<double>(k) - kFftSize / 2);
  }
  // A mean of |.|^2 over n samples is the sum of the squared spectrum over n and the transform's size.
  signal.snr = std::max(sum / (samples * kFftSize), 1e-3);
  if (!(sum > 0.0)) {
    signal.bandwidth_hz = 2.0 * kBandHz;
    signal.frequency_sigma_hz = kBandHz;
    return;
  }
  signal.frequency_hz = std::clamp(moment / sum * bin, -0.5 * kBandHz, 0.5 * kBandHz);
  const double symbols = std::max(samples / channel_rate_ * kSymbolRateHz, 1.0);
  signal.frequency_sigma_hz = kPulseSigmaHz / std::sqrt(symbols) * (1.0 + 1.5 / signal.snr);
  double low = 0.0, high = 0.0, below = 0.0;
  std::size_t k = first;
  for (; k <= last && below < 0.05 * sum; ++k) below += static_cast<double>(power_[k]) - noise;
  low = static_cast<double>(k);
  double above = 0.0;
  for (k = last; k > first && above < 0.05 * sum; --k) above += static_cast<double>(power_[k]) - noise;
  high = static_cast<double>(k);
  signal.bandwidth_hz = std::max(high - low + 1.0, 1.0) * bin;
}

// The carrier from the fourth power of the matched filter's output: QPSK gives a tone at four times it.
void BurstGauge::find_carrier(std::size_t from, std::size_t to, GaugedSignal& signal) noexcept {
  const std::size_t n = to - from;
  if (n < 64) return;
  for (std::size_t i = 0; i < n; ++i) {
    const Cf32 y = matched_[from + i];
    const float p = std::norm(y);
    const Cf32 y2(y.real() * y.real() - y.imag() * y.imag(), 2.0F * y.real() * y.imag());
    const Cf32 y4(y2.real() * y2.real() - y2.imag() * y2.imag(), 2.0F * y2.real() * y2.imag());
    // Divided by |y|^3: strong moments count, but no more than they must.
    const float weight = p > 1e-12F ? 1.0F / (p * std::sqrt(p)) : 0.0F;
    work_[i] = i % 2 == 0 ? weight * y4 : -weight * y4;
  }
  std::fill(work_.begin() + static_cast<std::ptrdiff_t>(n), work_.end(), Cf32{});
  fft_.execute(work_.data(), transform_.data());
  kernels::square(transform_.data(), kFftSize, power_.data());
  const double bin = channel_rate_ / kFftSize;
  const auto half = static_cast<std::size_t>(std::min(kLineHz, 0.45 * channel_rate_) / bin);
  const std::size_t first = kFftSize / 2 - half, last = kFftSize / 2 + half;
  std::size_t peak = first;
  double sum = 0.0;
  for (std::size_t k = first; k <= last; ++k) {
    sum += static_cast<double>(power_[k]);
    if (power_[k] > power_[peak]) peak = k;
  }
  // The line itself, as wide as the stretch is short, is left out of what surrounds it.
  const auto line = static_cast<std::size_t>(2.0 * kFftSize / static_cast<double>(n)) + 1;
  double own = 0.0, own_bins = 0.0;
  for (std::size_t k = peak - std::min(line, peak - first); k <= std::min(peak + line, last); ++k) {
    own += static_cast<double>(power_[k]);
    own_bins += 1.0;
  }
  const double around = (sum - own) / (static_cast<double>(last - first + 1) - own_bins);
  const double ratio = static_cast<double>(power_[peak]) / around;
  if (!(ratio > kLineRatio) || peak == first || peak == last) return;
  const double a = std::log(static_cast<double>(power_[peak - 1])), b = std::log(static_cast<double>(power_[peak])),
               c = std::log(static_cast<double>(power_[peak + 1]));
  const double bend = a - 2.0 * b + c;
  const double aside = bend < 0.0 ? std::clamp(0.5 * (a - c) / bend, -0.5, 0.5) : 0.0;
  signal.frequency_hz = 0.25 * bin * (static_cast<double>(peak) + aside - kFftSize / 2);
  signal.frequency_sigma_hz = 0.25 * std::sqrt(6.0 / ratio) / (kTwoPi * static_cast<double>(n) / channel_rate_);
  signal.fine_frequency = true;
}

// Takes up to `most` samples below a quarter of the mean power from either end: a strong signal's pulse begins before
// it.
void BurstGauge::trim(std::size_t& begin, std::size_t& end, std::size_t most) const noexcept {
  if (end - begin < 8 * most) return;
  double power = 0.0;
  for (std::size_t i = begin; i < end; ++i) power += static_cast<double>(std::norm(matched_[i]));
  const double quarter = 0.25 * power / static_cast<double>(end - begin);
  for (std::size_t k = 0; k < most && static_cast<double>(std::norm(matched_[begin])) < quarter; ++k) ++begin;
  for (std::size_t k = 0; k < most && static_cast<double>(std::norm(matched_[end - 1])) < quarter; ++k) --end;
}

std::size_t BurstGauge::measure(IqSpan samples, double frequency_hz, double noise_power, double level,
                                std::span<GaugedSignal> out) noexcept {
  samples = samples.first(std::min(samples.size(), most_samples_));
  if (samples.empty() || out.empty() || !(noise_power > 0.0)) return 0;
  mix(samples, frequency_hz, 1.0 / std::sqrt(noise_power * kSymbolRateHz / rate_));
  const std::size_t n = (samples.size() - 1) / stride_ + 1;
  Cf32* const channel = channel_.data() + pulse_taps_;
  if (stride_ > 1) {
    kernels::filter(mixed_.data(), stride_, filter_.data(), filter_.size() / 2, channel, n);
  } else {
    std::copy_n(mixed_.data(), n, channel);
  }
  std::fill(channel_.begin() + static_cast<std::ptrdiff_t>(pulse_taps_ + n), channel_.end(), Cf32{});
  kernels::filter(channel_.data(), 1, pulse_.data(), pulse_.size() / 2, matched_.data(), n);

  // Two states, noise of power 1 or a signal of power `level`: per sample the likelihood's ratio grows by what |y|^2 is
  // above `middle`. A signal begins where the ratio last was least when it has risen by `rise`, and ends where it was
  // highest when it has fallen by `fall` (doc/iridium.md eq. 9).
  level = std::max(level, 1.2);
  const double middle = std::min(std::max(std::log(level) / (1.0 - 1.0 / level), 0.25 * (level - 1.0)), kMostMiddle);
  const double millisecond = channel_rate_ * 1e-3;
  const double per_symbol = channel_rate_ / kSymbolRateHz / (1.0 - 1.0 / level);  // of the sum, to one nat
  const double rise = std::max(0.6 * (level - middle) * millisecond, kRiseNats * per_symbol);
  const double fall = std::max(0.3 * middle * millisecond, kFallNats * per_symbol);
  std::size_t count = 0, begin = 0, top_at = 0;
  bool inside = false;
  double sum = 0.0, top = 0.0;
  std::size_t best_begin = 0, best_end = 0;  // of what rose most without rising enough
  double best = 0.0;
  const auto symbol = static_cast<std::size_t>(channel_rate_ / kSymbolRateHz);
  const auto close = [&](std::size_t end) {
    trim(begin, end, 2 * symbol);
    GaugedSignal& signal = out[count];
    signal = {};
    signal.begin = static_cast<double>(begin * stride_);
    signal.end = static_cast<double>(end * stride_);
    std::size_t from = begin, to = end;
    if (to - from > 4 * symbol) {
      from += symbol;
      to -= symbol;
    }
    const auto most = static_cast<std::size_t>(kLineMostS * channel_rate_);
    const std::size_t length = std::min({to - from, most, static_cast<std::size_t>(kFftSize)});
    const std::size_t start = from + (to - from - length) / 2;
    spectrum_of(channel + start, length);
    weigh_spectrum(length, signal);
    find_carrier(start, start + length, signal);
    signal.frequency_hz += frequency_hz;
    ++count;
  };
  for (std::size_t i = 0; i < n && count < out.size(); ++i) {
    const double gain = static_cast<double>(std::norm(matched_[i])) - middle;
    sum += gain;
    if (!inside) {
      if (sum <= 0.0) {
        sum = 0.0;
        begin = i + 1;
      } else if (sum > rise) {
        inside = true;
        top = sum;
        top_at = i + 1;
      } else if (sum > best) {
        best = sum;
        best_begin = begin;
        best_end = i + 1;
      }
      continue;
    }
    if (sum > top) {
      top = sum;
      top_at = i + 1;
    } else if (top - sum > fall) {
      close(top_at);
      inside = false;
      sum = 0.0;
      i = top_at;  // what comes after the end is looked at again
      begin = i + 1;
    }
  }
  if (inside && count < out.size()) close(top_at);
  if (count == 0 && best_end > best_begin) {
    begin = best_begin;
    close(best_end);
  }
  return count;
}

}  // namespace soopnav::iridium
