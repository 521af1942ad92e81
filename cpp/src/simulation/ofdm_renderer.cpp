#include "simulation/ofdm_renderer.hpp"

#include <algorithm>
#include <cmath>

#include "core/target_clones.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/simulation/channel.hpp"

namespace soopnav::simulation {
namespace {

// Modified Bessel function I0, by its series; arguments here are small.
double bessel_i0(double x) noexcept {
  double term = 1.0, sum = 1.0;
  for (int k = 1; k < 30; ++k) {
    term *= 0.25 * x * x / (k * k);
    sum += term;
  }
  return sum;
}

// out[i] = sum_k taps[k] x[i + 2 k]: eight taps on interleaved samples.
SOOPNAV_TARGET_CLONES void fir8(const float* taps, const float* x, std::size_t floats, float* out) {
  const float t0 = taps[0], t1 = taps[1], t2 = taps[2], t3 = taps[3];
  const float t4 = taps[4], t5 = taps[5], t6 = taps[6], t7 = taps[7];
  for (std::size_t i = 0; i < floats; ++i) {
    const float low = (t0 * x[i] + t1 * x[i + 2]) + (t2 * x[i + 4] + t3 * x[i + 6]);
    const float high = (t4 * x[i + 8] + t5 * x[i + 10]) + (t6 * x[i + 12] + t7 * x[i + 14]);
    out[i] = low + high;
  }
}

const float* floats(const Cf32* x) { return reinterpret_cast<const float*>(x); }
float* floats(Cf32* x) { return reinterpret_cast<float*>(x); }

std::size_t modulo(long long value, std::size_t period) noexcept {
  const auto p = static_cast<long long>(period);
  return static_cast<std::size_t>(((value % p) + p) % p);
}

Cf32 product(Cf32 x, float re, float im) noexcept {
  return {x.real() * re - x.imag() * im, x.real() * im + x.imag() * re};
}

// The fewest symbols from `minimum` on whose string has a transform that is fast and needs no memory.
int circle_symbols(int minimum, int symbol_samples) noexcept {
  for (int symbols = minimum;; ++symbols) {
    int rest = symbols;
    for (const int factor : {2, 3, 5, 7}) {
      while (rest % factor == 0) rest /= factor;
    }
    if (rest == 1 || symbols > minimum + 4096 / symbol_samples + 64) return symbols;
  }
}

}  // namespace

OfdmLink::Renderer::Renderer(const ofdm::Numerology& numerology, int symbols, const OfdmLinkOptions& options)
    : numerology_(numerology), options_(options), synthesizer_(numerology, options.constellation) {
  const auto period = static_cast<std::size_t>(numerology.symbol_samples());
  kept_ = period * static_cast<std::size_t>(symbols + 1);
  length_ = kept_;
  if (options.movement == Movement::kFractionalDelay) {
    length_ = period * static_cast<std::size_t>(circle_symbols(symbols + 1, numerology.symbol_samples()));
    forward_.emplace(static_cast<int>(length_), dsp::FftDirection::kForward);
    inverse_.emplace(static_cast<int>(length_), dsp::FftDirection::kInverse);
    spectrum_.resize(length_);
    turned_.resize(length_);
    phase_.resize(length_);
    ramp_.resize(length_ / 2 + 1);
  } else {
    // Windowed sinc, whole samples exact: phase p lies p / 15 after the sample before it.
    constexpr double kBeta = 4.0;
    for (int p = 0; p < kFine; ++p) {
      for (int k = 0; k < kTaps; ++k) {
        const double t = k - kBefore - p / static_cast<double>(kFine);
        const double edge = t / (0.5 * kTaps);
        const double sinc = std::abs(t) < 1e-12 ? 1.0 : std::sin(kPi * t) / (kPi * t);
        const double whole = p == 0 ? (k == kBefore ? 1.0 : 0.0) : sinc;
        const double window = bessel_i0(kBeta * std::sqrt(std::max(0.0, 1.0 - edge * edge))) / bessel_i0(kBeta);
        taps_[static_cast<std::size_t>(p)][static_cast<std::size_t>(k)] = static_cast<float>(whole * window);
      }
    }
    block_.resize(kFine * kBlock);
  }
  string_.resize(length_ + kTaps);
  if (options.band_limited_noise && options.oversampling > 1) noise_.resize(length_ + kTaps);
}

// Makes string[kBefore + i] = x[i] out of x, and goes round at both ends.
void OfdmLink::Renderer::extend(std::vector<Cf32>& string) {
  std::copy_backward(string.begin(), string.begin() + static_cast<std::ptrdiff_t>(length_),
                     string.begin() + static_cast<std::ptrdiff_t>(length_ + kBefore));
  std::copy_n(string.begin() + static_cast<std::ptrdiff_t>(length_), kBefore, string.begin());
  std::copy_n(string.begin() + kBefore, kTaps - kBefore,
              string.begin() + static_cast<std::ptrdiff_t>(length_ + kBefore));
}

// out[n] (+)= gain * fine((step n - shift) mod 15 L), fine being the interpolated string and step the fine samples
// between two of the receiver.
void OfdmLink::Renderer::shift_in(const std::vector<Cf32>& string, long long fine_shift, std::complex<double> gain,
                                  bool add, std::span<Cf32> out) {
  const auto re = static_cast<float>(gain.real()), im = static_cast<float>(gain.imag());
  const auto put = [&](Cf32& to, Cf32 value) {
    if (add) {
      to += product(value, re, im);
    } else {
      to = value;
    }
  };
  if (options_.oversampling == 1) {
    const auto phase = modulo(-fine_shift, kFine);
    const long long whole = (-fine_shift - static_cast<long long>(phase)) / kFine;
    std::size_t from = modulo(whole, length_);
    for (std::size_t n = 0; n < out.size();) {
      const std::size_t count = std::min({out.size() - n, length_ - from, block_.size()});
      fir8(taps_[phase].data(), floats(&string[from]), 2 * count, floats(block_.data()));
      for (std::size_t i = 0; i < count; ++i) put(out[n + i], block_[i]);
      n += count;
      from = (from + count) % length_;
    }
    return;
  }
  std::size_t at = modulo(fine_shift, out.size());  // where fine sample 0 goes
  for (std::size_t from = 0; from < length_;) {
    const std::size_t count = std::min(kBlock, length_ - from);
    for (std::size_t p = 0; p < kFine; ++p) {
      fir8(taps_[p].data(), floats(&string[from]), 2 * count, floats(&block_[p * kBlock]));
    }
    for (std::size_t i = 0; i < count; ++i) {
      if (at + kFine <= out.size()) {
        for (std::size_t p = 0; p < kFine; ++p) put(out[at + p], block_[p * kBlock + i]);
        at += kFine;
        if (at == out.size()) at = 0;
      } else {
        for (std::size_t p = 0; p < kFine; ++p) {
          put(out[at], block_[p * kBlock + i]);
          if (++at == out.size()) at = 0;
        }
      }
    }
    from += count;
  }
}

// ramp_[k] = exp(j 2 pi k turns_per_bin), k < bins: products of two tables, no error that grows.
void OfdmLink::Renderer::ramp(std::size_t bins, double turns_per_bin) {
  constexpr std::size_t kStep = 128;
  const auto turn = [turns_per_bin](std::size_t k) {
    const double turns = static_cast<double>(k) * turns_per_bin;
    const double angle = kTwoPi * (turns - std::rint(turns));
    return std::complex<double>(std::cos(angle), std::sin(angle));
  };
  std::array<std::complex<double>, kStep> within;
  for (std::size_t k = 0; k < kStep; ++k) within[k] = turn(k);
  for (std::size_t begin = 0; begin < bins; begin += kStep) {
    const auto base = turn(begin);
    const double br = base.real(), bi = base.imag();
    for (std::size_t k = begin; k < std::min(bins, begin + kStep); ++k) {
      const double wr = within[k - begin].real(), wi = within[k - begin].imag();
      ramp_[k] = {br * wr - bi * wi, br * wi + bi * wr};
    }
  }
}

void OfdmLink::Renderer::delay_in(double delay_samples, const std::optional<Reflection>& reflection,
                                  double extra_samples, bool noisy, std::span<Cf32> out) {
  const std::size_t half = length_ / 2;  // bins 0 .. half are positive frequencies; half is both when length is even
  const auto length = static_cast<double>(length_);
  const double scale = 1.0 / length;
  forward_->execute(string_.data(), spectrum_.data());
  const auto add_ray = [&](double delay, std::complex<double> gain, bool first) {
    const double periodic = delay - length * std::floor(delay / length);
    ramp(half + 1, -periodic / length);
    const auto put = [&](std::size_t bin, std::complex<double> factor) {
      const Cf32 moved = product(spectrum_[bin], static_cast<float>(factor.real()), static_cast<float>(factor.imag()));
      turned_[bin] = first ? moved : turned_[bin] + moved;
    };
    const double gr = gain.real() * scale, gi = gain.imag() * scale;
    for (std::size_t k = 0; k <= half; ++k) {
      const double r = ramp_[k].real(), i = ramp_[k].imag();
      if (2 * k == length_) {
        put(k, {gr * r, gi * r});  // the ramp's mean over both signs
        continue;
      }
      put(k, {gr * r - gi * i, gr * i + gi * r});
      if (k > 0) put(length_ - k, {gr * r + gi * i, gi * r - gr * i});
    }
  };
  add_ray(delay_samples, {1.0, 0.0}, true);
  if (reflection) add_ray(delay_samples + extra_samples, reflection->gain, false);
  if (noisy) {
    forward_->execute(noise_.data(), spectrum_.data());
    for (std::size_t k = 0; k < length_; ++k) turned_[k] += spectrum_[k] * static_cast<float>(scale);
  }
  if (options_.oversampling == 1) {
    inverse_->execute(turned_.data(), phase_.data());
    std::copy_n(phase_.begin(), out.size(), out.begin());
    return;
  }
  for (std::size_t p = 0; p < kFine; ++p) {
    ramp(half + 1, static_cast<double>(p) / kFine / length);
    for (std::size_t k = 0; k <= half; ++k) {
      const auto re = static_cast<float>(ramp_[k].real()), im = static_cast<float>(ramp_[k].imag());
      if (2 * k == length_) {
        spectrum_[k] = turned_[k] * re;
        continue;
      }
      spectrum_[k] = product(turned_[k], re, im);
      if (k > 0) spectrum_[length_ - k] = product(turned_[length_ - k], re, -im);
    }
    inverse_->execute(spectrum_.data(), phase_.data());
    for (std::size_t n = 0; n < kept_; ++n) out[n * kFine + p] = phase_[n];
  }
}

void OfdmLink::Renderer::render(double delay_m, const RandomStream& random, std::span<Cf32> out,
                                std::optional<double> snr_db, const std::optional<Reflection>& reflection) {
  RandomStream data = random.substream(0);
  synthesizer_.fill(std::span(string_).first(length_), data);
  const double variance = snr_db ? power_ratio(-*snr_db) : 0.0;
  const bool band_limited = snr_db.has_value() && !noise_.empty();
  RandomStream noise = random.substream(1);
  if (band_limited) noise.fill_complex_normal(std::span(noise_).first(length_), variance);
  const double sample_m = numerology_.sample_m();
  if (options_.movement == Movement::kInterpolateAndShift) {
    const double fine_m = sample_m / kFine;
    const auto shift = [fine_m](double length_m) { return static_cast<long long>(std::floor(length_m / fine_m)); };
    extend(string_);
    shift_in(string_, shift(delay_m), 1.0, false, out);
    if (reflection) shift_in(string_, shift(delay_m + reflection->extra_m), reflection->gain, true, out);
    if (band_limited) {
      extend(noise_);
      shift_in(noise_, 0, 1.0, true, out);
    }
  } else {
    delay_in(delay_m / sample_m, reflection, reflection ? reflection->extra_m / sample_m : 0.0, band_limited, out);
  }
  if (snr_db && !band_limited) noise.add_complex_normal(out, variance);
  if (options_.cfo_hz != 0.0) {
    apply_cfo(out, options_.cfo_hz, numerology_.sample_rate_hz * options_.oversampling);
  }
}

}  // namespace soopnav::simulation
