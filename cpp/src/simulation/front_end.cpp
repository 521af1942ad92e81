#include "soopnav/simulation/front_end.hpp"

#include <cmath>
#include <utility>

#include "core/target_clones.hpp"
#include "simulation/require.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/dsp/resample.hpp"
#include "soopnav/simulation/channel.hpp"
#include "soopnav/simulation/path_loss.hpp"

namespace soopnav::simulation {
namespace {

constexpr double kDefaultHeadroomDb = 40.0;
constexpr double kMostGain = 1e12;  // samples are of single precision

void require_finite(double value, const char* name) { require(std::isfinite(value), name, value, "it must be finite"); }

void require_not_negative(double value, const char* name) {
  require(std::isfinite(value) && value >= 0.0, name, value, "it must be finite and not negative");
}

// y = gain x on interleaved parts, in place.
SOOPNAV_TARGET_CLONES void scale(float re, float im, std::size_t samples, float* x) {
  for (std::size_t n = 0; n < samples; ++n) {
    const float a = x[2 * n], b = x[2 * n + 1];
    x[2 * n] = re * a - im * b;
    x[2 * n + 1] = re * b + im * a;
  }
}

struct Mixer {
  float q_of_i, q_of_q, dc_i, dc_q;
};

SOOPNAV_TARGET_CLONES void mix(Mixer mixer, std::size_t samples, float* x) {
  for (std::size_t n = 0; n < samples; ++n) {
    const float a = x[2 * n], b = x[2 * n + 1];
    x[2 * n] = a + mixer.dc_i;
    x[2 * n + 1] = mixer.q_of_i * a + mixer.q_of_q * b + mixer.dc_q;
  }
}

std::size_t convert(int bits, std::span<Cf32> samples) {
  const auto levels = static_cast<float>(std::ldexp(1.0, bits - 1));
  const float step = 1.0F / levels;
  std::size_t clipped = 0;
  const auto part = [&](float value) {
    const float level = std::nearbyint(value * levels);
    if (level >= -levels && level <= levels - 1.0F) return level * step;
    ++clipped;
    if (std::isnan(level)) return 0.0F;
    return level < 0.0F ? -1.0F : (levels - 1.0F) * step;
  };
  for (Cf32& x : samples) x = {part(x.real()), part(x.imag())};
  return clipped;
}

}  // namespace

FrontEnd::FrontEnd(std::vector<ChannelErrors> channels, const FrontEndOptions& options)
    : channels_(std::move(channels)), options_(options) {
  require(!channels_.empty(), "channels.size()", 0.0, "at least one is needed");
  require_not_negative(options.attenuation_db, "attenuation_db");
  require(std::isfinite(options.attenuator_step_db) && options.attenuator_step_db > 0.0, "attenuator_step_db",
          options.attenuator_step_db, "it must be finite and positive");
  require_not_negative(options.phase_step_rad, "phase_step_rad");
  require(options.adc_bits == 0 || (options.adc_bits >= 2 && options.adc_bits <= 24), "adc_bits", options.adc_bits,
          "it must be 0 for no converter, or 2 to 24");
  for (const ChannelErrors& channel : channels_) {
    require_finite(channel.gain.real(), "gain");
    require_finite(channel.gain.imag(), "gain");
    require(std::abs(channel.gain) <= kMostGain, "gain", std::abs(channel.gain), "its amplitude must be at most 1e12");
    require_finite(channel.phase_delay_rad, "phase_delay_rad");
    require_finite(channel.iq_gain_db, "iq_gain_db");
    require(std::abs(channel.iq_phase_rad) <= 1.0, "iq_phase_rad", channel.iq_phase_rad,
            "it must lie between -1 and 1");
    require_finite(channel.dc.real(), "dc");
    require_finite(channel.dc.imag(), "dc");
  }
  require(std::isfinite(options.sample_rate_hz) && options.sample_rate_hz > 0.0, "sample_rate_hz",
          options.sample_rate_hz, "it must be finite and positive");
  noise_floor_dbm_ = thermal_noise_dbm(options.sample_rate_hz, options.noise_figure_db);
  full_scale_dbm_ = options.full_scale_dbm.value_or(noise_floor_dbm_ + kDefaultHeadroomDb);
  require_finite(full_scale_dbm_, "full_scale_dbm");
  // A rounding error must not cost a whole step: 3 dB in steps of 0.1 dB is thirty of them.
  stepped_db_ = options.attenuator_step_db * std::floor(options.attenuation_db / options.attenuator_step_db + 1e-9);
}

double FrontEnd::phase_delay_rad(std::size_t channel) const {
  require(channel < channels_.size(), "channel", static_cast<double>(channel), "there is none of that number");
  const double wanted = channels_[channel].phase_delay_rad;
  if (options_.phase_step_rad == 0.0) return wanted;
  return options_.phase_step_rad * std::round(wanted / options_.phase_step_rad);
}

std::size_t FrontEnd::apply(std::span<Cf32> samples, const RandomStream& random) const {
  require(samples.size() % channels_.size() == 0, "samples.size()", static_cast<double>(samples.size()),
          "it must be a multiple of the number of channels");
  const std::size_t n = samples.size() / channels_.size();
  const double level = std::pow(10.0, -(stepped_db_ + full_scale_dbm_) / 20.0);
  const double noise = power_ratio(noise_floor_dbm_ + rest_attenuation_db() - full_scale_dbm_);
  std::size_t clipped = 0;
  for (std::size_t m = 0; m < channels_.size(); ++m) {
    const ChannelErrors& channel = channels_[m];
    const std::span<Cf32> row = samples.subspan(m * n, n);
    auto* parts = reinterpret_cast<float*>(row.data());
    const std::complex<double> gain = level * channel.gain * std::polar(1.0, -phase_delay_rad(m));
    scale(static_cast<float>(gain.real()), static_cast<float>(gain.imag()), n, parts);
    RandomStream stream = random.substream(m);
    stream.add_complex_normal(row, noise);
    const double q = std::pow(10.0, channel.iq_gain_db / 20.0);
    mix({static_cast<float>(q * std::sin(channel.iq_phase_rad)), static_cast<float>(q * std::cos(channel.iq_phase_rad)),
         static_cast<float>(channel.dc.real()), static_cast<float>(channel.dc.imag())},
        n, parts);
    if (options_.adc_bits > 0) clipped += convert(options_.adc_bits, row);
  }
  return clipped;
}

std::vector<Cf32> down_convert(std::span<const float> radio, double sample_rate_hz, double lo_hz, int decimation,
                               double lo_phase_rad) {
  require(std::isfinite(sample_rate_hz) && sample_rate_hz > 0.0, "sample_rate_hz", sample_rate_hz,
          "it must be finite and positive");
  require(std::abs(lo_hz) < 0.5 * sample_rate_hz, "lo_hz", lo_hz, "it must be below half the sampling rate");
  require(decimation >= 2 && decimation <= 1024, "decimation", decimation, "it must be 2 to 1024");
  std::vector<Cf32> mixed(radio.size());
  for (std::size_t n = 0; n < radio.size(); ++n) mixed[n] = {2.0F * radio[n], 0.0F};
  apply_cfo(mixed, -lo_hz, sample_rate_hz, -lo_phase_rad);
  auto resampler = dsp::Resampler::rational(1, decimation);
  std::vector<Cf32> out(resampler.output_size(mixed.size()));
  resampler.apply(mixed, 0, out);
  return out;
}

}  // namespace soopnav::simulation
