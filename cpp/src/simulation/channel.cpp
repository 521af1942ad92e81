#include "soopnav/simulation/channel.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "simulation/require.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::simulation {
namespace {

constexpr double kInt8Peak = 127.0;

void require_rate(double sample_rate_hz) {
  require(std::isfinite(sample_rate_hz) && sample_rate_hz > 0.0, "sample_rate_hz", sample_rate_hz,
          "it must be finite and positive");
}

void require_full_scale(double full_scale) {
  require(std::isfinite(full_scale) && full_scale > 0.0, "full_scale", full_scale, "it must be finite and positive");
}

struct Phasor {
  double re;
  double im;
};

// exp(j 2 pi n step), the product reduced to a turn before it is rounded.
Phasor phasor(double n, double step, double phase_turns) {
  const double product = n * step;
  const double lost = std::fma(n, step, -product);
  const double turns = (product - std::rint(product)) + lost + phase_turns;
  return {std::cos(kTwoPi * turns), std::sin(kTwoPi * turns)};
}

Phasor multiply(Phasor a, Phasor b) { return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re}; }

}  // namespace

double power_ratio(double decibels) noexcept { return std::pow(10.0, decibels / 10.0); }

double decibels(double ratio) noexcept { return 10.0 * std::log10(ratio); }

double mean_power(IqSpan samples) noexcept {
  if (samples.empty()) return 0.0;
  double sum = 0.0;
  for (const Cf32 x : samples) {
    const auto re = static_cast<double>(x.real());
    const auto im = static_cast<double>(x.imag());
    sum += re * re + im * im;
  }
  return sum / static_cast<double>(samples.size());
}

double noise_variance_for_snr(double signal_power, double snr_db) {
  require(std::isfinite(signal_power) && signal_power >= 0.0, "signal_power", signal_power,
          "it must be finite and not negative");
  require(std::isfinite(snr_db), "snr_db", snr_db, "it must be finite");
  return signal_power / power_ratio(snr_db);
}

double noise_variance_for_element_snr(double snr_db, double element_power, double transform_gain) {
  require(std::isfinite(element_power) && element_power >= 0.0, "element_power", element_power,
          "it must be finite and not negative");
  require(std::isfinite(transform_gain) && transform_gain > 0.0, "transform_gain", transform_gain,
          "it must be finite and positive");
  return noise_variance_for_snr(element_power, snr_db) / transform_gain;
}

void add_awgn(std::span<Cf32> samples, double variance, RandomStream& random) {
  require(std::isfinite(variance) && variance >= 0.0, "variance", variance, "it must be finite and not negative");
  random.add_complex_normal(samples, variance);
}

void apply_cfo(std::span<Cf32> samples, double cfo_hz, double sample_rate_hz, double phase_rad,
               std::int64_t first_sample) {
  require(std::isfinite(cfo_hz), "cfo_hz", cfo_hz, "it must be finite");
  require_rate(sample_rate_hz);
  require(std::isfinite(phase_rad), "phase_rad", phase_rad, "it must be finite");
  // exp(j w (n0 + k)) = exp(j w n0) exp(j w k): one pair of trigonometric calls per block, no error that grows.
  constexpr std::size_t kBlock = 128;
  const double step = cfo_hz / sample_rate_hz;
  const double phase_turns = std::remainder(phase_rad, kTwoPi) / kTwoPi;
  std::array<Phasor, kBlock> within;
  for (std::size_t k = 0; k < kBlock; ++k) within[k] = phasor(static_cast<double>(k), step, 0.0);
  for (std::size_t begin = 0; begin < samples.size(); begin += kBlock) {
    const auto n = static_cast<double>(first_sample + static_cast<std::int64_t>(begin));
    const Phasor at_begin = phasor(n, step, phase_turns);
    const std::size_t count = std::min(kBlock, samples.size() - begin);
    for (std::size_t k = 0; k < count; ++k) {
      Cf32& x = samples[begin + k];
      const Phasor turned =
          multiply(multiply(at_begin, within[k]), {static_cast<double>(x.real()), static_cast<double>(x.imag())});
      x = {static_cast<float>(turned.re), static_cast<float>(turned.im)};
    }
  }
}

std::vector<Cf32> apply_clock_error(IqSpan samples, double clock_error_ppm, const dsp::ResampleDesign& design,
                                    double start_samples) {
  require(std::abs(clock_error_ppm) <= 1000.0, "clock_error_ppm", clock_error_ppm,
          "it must lie between -1000 and 1000");
  dsp::Resampler resampler = dsp::Resampler::arbitrary(1.0 + 1e-6 * clock_error_ppm, design, start_samples);
  std::vector<Cf32> out(resampler.output_size(samples.size()));
  resampler.apply(samples, 0, out);
  return out;
}

std::vector<Cf32> apply_taps(IqSpan samples, double sample_rate_hz, std::span<const Tap> taps,
                             const dsp::SincDesign& design) {
  require_rate(sample_rate_hz);
  for (const Tap& tap : taps) {
    require(std::isfinite(tap.delay_s), "delay_s", tap.delay_s, "it must be finite");
    require(std::isfinite(tap.gain.real()) && std::isfinite(tap.gain.imag()), "gain", std::abs(tap.gain),
            "it must be finite");
  }
  std::vector<Cf32> sum(samples.size());
  std::vector<Cf32> path(samples.size());
  for (const Tap& tap : taps) {
    dsp::FractionalDelay::windowed_sinc(tap.delay_s * sample_rate_hz, design).apply(samples, 0, path);
    const auto gain_re = static_cast<float>(tap.gain.real());
    const auto gain_im = static_cast<float>(tap.gain.imag());
    for (std::size_t n = 0; n < sum.size(); ++n) {
      const float re = path[n].real();
      const float im = path[n].imag();
      sum[n] += Cf32(gain_re * re - gain_im * im, gain_re * im + gain_im * re);
    }
  }
  return sum;
}

double scale_to_rms(std::span<Cf32> samples, double rms) {
  require(std::isfinite(rms) && rms > 0.0, "rms", rms, "it must be finite and positive");
  const double power = mean_power(samples);
  if (!(power > 0.0)) return 1.0;
  const double factor = rms / std::sqrt(power);
  for (Cf32& x : samples) x *= static_cast<float>(factor);
  return factor;
}

std::size_t quantize_ci8(IqSpan samples, double full_scale, std::span<std::int8_t> out) {
  require_full_scale(full_scale);
  require(out.size() == 2 * samples.size(), "out.size()", static_cast<double>(out.size()),
          "it must be twice the number of samples");
  const double scale = kInt8Peak / full_scale;
  std::size_t clipped = 0;
  const auto convert = [scale, &clipped](float part) {
    const double scaled = std::nearbyint(static_cast<double>(part) * scale);
    if (std::abs(scaled) <= kInt8Peak) return static_cast<std::int8_t>(scaled);
    ++clipped;
    if (std::isnan(scaled)) return std::int8_t{0};
    return static_cast<std::int8_t>(std::copysign(kInt8Peak, scaled));
  };
  for (std::size_t n = 0; n < samples.size(); ++n) {
    out[2 * n] = convert(samples[n].real());
    out[2 * n + 1] = convert(samples[n].imag());
  }
  return clipped;
}

std::vector<Cf32> dequantize_ci8(std::span<const std::int8_t> pairs, double full_scale) {
  require_full_scale(full_scale);
  require(pairs.size() % 2 == 0, "pairs.size()", static_cast<double>(pairs.size()), "it must be even");
  const double scale = full_scale / kInt8Peak;
  std::vector<Cf32> samples(pairs.size() / 2);
  for (std::size_t n = 0; n < samples.size(); ++n) {
    samples[n] = {static_cast<float>(scale * pairs[2 * n]), static_cast<float>(scale * pairs[2 * n + 1])};
  }
  return samples;
}

}  // namespace soopnav::simulation
