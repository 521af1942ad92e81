#include "soopnav/simulation/array_link.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/target_clones.hpp"
#include "simulation/require.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/simulation/path_loss.hpp"

namespace soopnav::simulation {
namespace {

constexpr std::size_t kMaxElements = 1024;
constexpr std::size_t kMaxSamples = std::size_t{1} << 24;

using Complex = std::complex<double>;

float* floats(Cf32* x) { return reinterpret_cast<float*>(x); }

// y += gain x on interleaved parts.
SOOPNAV_TARGET_CLONES void add_scaled(float re, float im, const float* x, std::size_t samples, float* y) {
  for (std::size_t n = 0; n < samples; ++n) {
    const float a = x[2 * n], b = x[2 * n + 1];
    y[2 * n] += re * a - im * b;
    y[2 * n + 1] += re * b + im * a;
  }
}

std::size_t checked_elements(std::size_t elements) {
  require(elements >= 1 && elements <= kMaxElements, "elements", static_cast<double>(elements), "it must be 1 to 1024");
  return elements;
}

std::size_t checked_samples(std::size_t samples) {
  require(samples >= 1 && samples <= kMaxSamples, "samples", static_cast<double>(samples), "it must be 1 to 16777216");
  return samples;
}

void require_loss(double value, const char* name) {
  require(std::isfinite(value) && value >= 0.0, name, value, "it must be finite and not negative");
}

void require_positive(double value, const char* name) {
  require(std::isfinite(value) && value > 0.0, name, value, "it must be finite and positive");
}

// Frequency bin of tone i, counted 0, 1, -1, 2, -2 ... so that any number of them lies about 0 Hz.
std::int64_t bin_of(std::size_t i) {
  const auto half = static_cast<std::int64_t>((i + 1) / 2);
  return i % 2 == 1 ? half : -half;
}

}  // namespace

void LinkBudget::check() const {
  require_positive(frequency_hz, "frequency_hz");
  require_positive(sample_rate_hz, "sample_rate_hz");
  require_loss(noise_figure_db, "noise_figure_db");
  require_loss(splitter_loss_db, "splitter_loss_db");
  require_loss(delay_system_loss_db, "delay_system_loss_db");
  require_loss(excess_loss_db, "excess_loss_db");
  require(std::isfinite(transmit_power_dbm), "transmit_power_dbm", transmit_power_dbm, "it must be finite");
  require(std::isfinite(transmit_gain_dbi), "transmit_gain_dbi", transmit_gain_dbi, "it must be finite");
  require(std::isfinite(receive_gain_dbi), "receive_gain_dbi", receive_gain_dbi, "it must be finite");
}

double LinkBudget::received_power_dbm(double distance_m) const {
  return friis_received_power_dbm(transmit_power_dbm, transmit_gain_dbi, receive_gain_dbi, distance_m, frequency_hz) -
         splitter_loss_db - delay_system_loss_db - excess_loss_db;
}

double LinkBudget::noise_floor_dbm() const { return thermal_noise_dbm(sample_rate_hz, noise_figure_db); }

double LinkBudget::snr_db(double distance_m) const { return received_power_dbm(distance_m) - noise_floor_dbm(); }

double far_field_limit_m(double aperture_m, double frequency_hz) {
  require_loss(aperture_m, "aperture_m");
  require_positive(frequency_hz, "frequency_hz");
  const double wavelength = kSpeedOfLightMps / frequency_hz;
  return std::max({1.6 * wavelength, 2.0 * aperture_m * aperture_m / wavelength, 5.0 * aperture_m});
}

// ---- Samples

ArrayRenderer::ArrayRenderer(std::size_t elements, std::size_t samples, double sample_rate_hz, Waveform waveform,
                             double bandwidth_ratio, double tone_hz)
    : elements_(checked_elements(elements)),
      samples_(checked_samples(samples)),
      sample_rate_hz_(sample_rate_hz),
      waveform_(waveform),
      tone_hz_(tone_hz),
      bins_(samples),
      inverse_(static_cast<int>(samples), dsp::FftDirection::kInverse),
      spectrum_(samples),
      delayed_(samples),
      wave_(samples) {
  require_positive(sample_rate_hz, "sample_rate_hz");
  require(bandwidth_ratio > 0.0 && bandwidth_ratio <= 1.0, "bandwidth_ratio", bandwidth_ratio,
          "it must be above 0 and at most 1");
  require(std::isfinite(tone_hz), "tone_hz", tone_hz, "it must be finite");
  require(waveform == Waveform::kNoise || waveform == Waveform::kTone, "waveform", static_cast<double>(waveform),
          "it must be one of Waveform");
  bins_ = std::clamp<std::size_t>(static_cast<std::size_t>(std::lround(bandwidth_ratio * static_cast<double>(samples))),
                                  1, samples);
}

// Fills wave_, and spectrum_ unless the wave is a tone or as wide as the band.
void ArrayRenderer::draw_wave(RandomStream random) {
  if (waveform_ == Waveform::kTone) {
    const double step = tone_hz_ / sample_rate_hz_;
    const double start = random.uniform();
    for (std::size_t n = 0; n < samples_; ++n) {
      const double product = static_cast<double>(n) * step;
      const double turns = product - std::rint(product) + start;
      wave_[n] = {static_cast<float>(std::cos(kTwoPi * turns)), static_cast<float>(std::sin(kTwoPi * turns))};
    }
    return;
  }
  if (bins_ == samples_) {
    random.fill_complex_normal(wave_);
    return;
  }
  const std::span<Cf32> drawn = std::span(delayed_).first(bins_);
  random.fill_complex_normal(drawn, 1.0 / static_cast<double>(bins_));
  std::ranges::fill(spectrum_, Cf32{});
  for (std::size_t i = 0; i < bins_; ++i) {
    const std::int64_t bin = bin_of(i);
    spectrum_[static_cast<std::size_t>(bin < 0 ? bin + static_cast<std::int64_t>(samples_) : bin)] = drawn[i];
  }
  inverse_.execute(spectrum_.data(), wave_.data());
}

// wave_ from spectrum_, later by delay_s.
void ArrayRenderer::delay_wave(double delay_s) {
  for (std::size_t i = 0; i < samples_; ++i) {
    const std::int64_t bin = bin_of(i);
    const auto at = static_cast<std::size_t>(bin < 0 ? bin + static_cast<std::int64_t>(samples_) : bin);
    const double turns = -static_cast<double>(bin) * delay_s * sample_rate_hz_ / static_cast<double>(samples_);
    const Complex turned = Complex(spectrum_[at]) * std::polar(1.0, kTwoPi * turns);
    delayed_[at] = {static_cast<float>(turned.real()), static_cast<float>(turned.imag())};
  }
  inverse_.execute(delayed_.data(), wave_.data());
}

void ArrayRenderer::render(std::span<const ArrivingWave> waves, double noise_variance, const RandomStream& random,
                           std::span<Cf32> out) {
  require(out.size() == elements_ * samples_, "out.size()", static_cast<double>(out.size()),
          "it must be elements * samples");
  require(std::isfinite(noise_variance) && noise_variance >= 0.0, "noise_variance", noise_variance,
          "it must be finite and not negative");
  for (const ArrivingWave& wave : waves) {
    require(wave.steering.size() == elements_, "steering.size()", static_cast<double>(wave.steering.size()),
            "it must be the number of elements");
    require(wave.delay_s.empty() || wave.delay_s.size() == elements_, "delay_s.size()",
            static_cast<double>(wave.delay_s.size()), "it must be none or the number of elements");
  }
  if (noise_variance > 0.0) {
    RandomStream noise = random.substream(0);
    noise.fill_complex_normal(out, noise_variance);
  } else {
    std::ranges::fill(out, Cf32{});
  }
  for (std::size_t k = 0; k < waves.size(); ++k) {
    const ArrivingWave& wave = waves[k];
    draw_wave(random.substream(k + 1));
    const bool delays_of_noise = !wave.delay_s.empty() && waveform_ == Waveform::kNoise;
    if (delays_of_noise && bins_ == samples_) {
      // What was drawn sample by sample serves as a spectrum as well: white either way.
      const auto scale = static_cast<float>(1.0 / std::sqrt(static_cast<double>(samples_)));
      for (std::size_t n = 0; n < samples_; ++n) spectrum_[n] = scale * wave_[n];
    }
    for (std::size_t m = 0; m < elements_; ++m) {
      Complex gain = wave.amplitude * wave.steering[m];
      if (delays_of_noise) {
        delay_wave(wave.delay_s[m]);
      } else if (!wave.delay_s.empty()) {
        gain *= std::polar(1.0, -kTwoPi * std::remainder(tone_hz_ * wave.delay_s[m], 1.0));
      }
      add_scaled(static_cast<float>(gain.real()), static_cast<float>(gain.imag()), floats(wave_.data()), samples_,
                 floats(out.data() + m * samples_));
    }
  }
}

// ---- Covariances

double gamma_variate(double shape, RandomStream& random) noexcept {
  const double d = shape - 1.0 / 3.0;
  const double c = 1.0 / std::sqrt(9.0 * d);
  for (;;) {
    const double x = random.normal();
    const double u = 1.0 - random.uniform();  // in (0, 1]
    const double root = 1.0 + c * x;
    if (root <= 0.0) continue;
    const double v = root * root * root;
    if (std::log(u) < 0.5 * x * x + d - d * v + d * std::log(v)) return d * v;
  }
}

CovarianceSampler::CovarianceSampler(std::size_t elements, std::size_t snapshots)
    : elements_(checked_elements(elements)),
      snapshots_(snapshots),
      factor_(elements * elements),
      product_(elements),
      column_(elements),
      truth_(elements * elements) {
  require(snapshots >= 1, "snapshots", static_cast<double>(snapshots), "it must be at least 1");
}

bool CovarianceSampler::draw(std::span<const Complex> covariance, RandomStream random, std::span<Complex> out) {
  const std::size_t m = elements_;
  require(covariance.size() == m * m, "covariance.size()", static_cast<double>(covariance.size()),
          "it must be elements * elements");
  require(out.size() == m * m, "out.size()", static_cast<double>(out.size()), "it must be elements * elements");
  for (std::size_t i = 0; i < m; ++i) {  // Cholesky, row by row, of the lower triangle
    for (std::size_t j = 0; j <= i; ++j) {
      Complex sum = covariance[i * m + j];
      for (std::size_t k = 0; k < j; ++k) sum -= factor_[i * m + k] * std::conj(factor_[j * m + k]);
      if (i == j) {
        if (!(sum.real() > 0.0) || !std::isfinite(sum.real())) return false;
        factor_[i * m + i] = std::sqrt(sum.real());
      } else {
        factor_[i * m + j] = sum / factor_[j * m + j].real();
      }
    }
  }
  const double scale = 1.0 / static_cast<double>(snapshots_);
  std::ranges::fill(out, Complex{});
  const auto standard = [&random] {
    const double re = random.normal();
    return std::sqrt(0.5) * Complex(re, random.normal());
  };
  const auto add_outer = [&](std::size_t first) {  // out += v v^H, v zero before `first`
    for (std::size_t i = first; i < m; ++i) {
      for (std::size_t j = first; j <= i; ++j) out[i * m + j] += scale * column_[i] * std::conj(column_[j]);
    }
  };
  if (snapshots_ < m) {
    for (std::size_t n = 0; n < snapshots_; ++n) {
      for (std::size_t i = 0; i < m; ++i) product_[i] = standard();
      for (std::size_t i = 0; i < m; ++i) {
        column_[i] = {};
        for (std::size_t k = 0; k <= i; ++k) column_[i] += factor_[i * m + k] * product_[k];
      }
      add_outer(0);
    }
  } else {
    for (std::size_t j = 0; j < m; ++j) {  // column j of A, then of L A
      product_[j] = std::sqrt(gamma_variate(static_cast<double>(snapshots_ - j), random));
      for (std::size_t i = j + 1; i < m; ++i) product_[i] = standard();
      for (std::size_t i = j; i < m; ++i) {
        column_[i] = {};
        for (std::size_t k = j; k <= i; ++k) column_[i] += factor_[i * m + k] * product_[k];
      }
      add_outer(j);
    }
  }
  for (std::size_t i = 0; i < m; ++i) {
    out[i * m + i] = out[i * m + i].real();
    for (std::size_t j = i + 1; j < m; ++j) out[i * m + j] = std::conj(out[j * m + i]);
  }
  return true;
}

bool CovarianceSampler::draw(std::span<const ArrivingWave> waves, RandomStream random, std::span<Complex> out) {
  const std::size_t m = elements_;
  std::ranges::fill(truth_, Complex{});
  for (std::size_t i = 0; i < m; ++i) truth_[i * m + i] = 1.0;
  for (const ArrivingWave& wave : waves) {
    require(wave.steering.size() == m, "steering.size()", static_cast<double>(wave.steering.size()),
            "it must be the number of elements");
    const double power = wave.amplitude * wave.amplitude;
    for (std::size_t i = 0; i < m; ++i) {
      for (std::size_t j = 0; j < m; ++j) truth_[i * m + j] += power * wave.steering[i] * std::conj(wave.steering[j]);
    }
  }
  return draw(truth_, random, out);
}

}  // namespace soopnav::simulation
