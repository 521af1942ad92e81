#include "soopnav/waveform/gps/acquisition.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/dsp/detection.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/dsp/peak.hpp"

namespace soopnav::gps {
namespace {

constexpr double kMostAmplitude = 1e15;  // of a sample, as trackers take them

void require(bool holds, const char* name, double value, const char* rule) {
  if (!holds) throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " " + rule);
}

AcquisitionOptions checked(AcquisitionOptions o) {
  const double per_ms = o.sample_rate_hz * 1e-3;
  require(o.sample_rate_hz >= kChipRateHz && o.sample_rate_hz <= 100e6 && std::abs(per_ms - std::round(per_ms)) < 1e-6,
          "sample_rate_hz", o.sample_rate_hz, "must be a whole number of kilohertz, from 1.023 to 100 MHz");
  require(std::abs(o.intermediate_hz) <= 0.5 * o.sample_rate_hz, "intermediate_hz", o.intermediate_hz,
          "must be within half the sampling rate");
  require(o.coherent_ms >= 1 && o.coherent_ms <= 20, "coherent_ms", o.coherent_ms, "must be in [1, 20]");
  require(o.noncoherent >= 1 && o.noncoherent <= 10'000, "noncoherent", o.noncoherent, "must be in [1, 10000]");
  require(std::abs(o.min_doppler_hz) <= 100e3, "min_doppler_hz", o.min_doppler_hz, "must be within 100 kHz");
  require(o.max_doppler_hz >= o.min_doppler_hz && o.max_doppler_hz <= 100e3, "max_doppler_hz", o.max_doppler_hz,
          "must be at least min_doppler_hz and within 100 kHz");
  require(o.doppler_step_hz >= 0.0 && std::isfinite(o.doppler_step_hz), "doppler_step_hz", o.doppler_step_hz,
          "must be positive, or 0 for half of the inverse of a coherent sum");
  require(o.false_alarm_probability > 0.0 && o.false_alarm_probability < 1.0, "false_alarm_probability",
          o.false_alarm_probability, "must be in (0, 1)");
  require(o.noise_variance >= 0.0 && std::isfinite(o.noise_variance), "noise_variance", o.noise_variance,
          "must be positive, or 0 for the samples' power");
  if (o.doppler_step_hz == 0.0) o.doppler_step_hz = 500.0 / o.coherent_ms;
  require((o.max_doppler_hz - o.min_doppler_hz) / o.doppler_step_hz < 1e5, "doppler_step_hz", o.doppler_step_hz,
          "must leave fewer than 100000 Dopplers");
  return o;
}

std::complex<double> turn(double cycles) noexcept { return std::polar(1.0, kTwoPi * (cycles - std::floor(cycles))); }

Cf32 narrow(std::complex<double> z) noexcept { return {static_cast<float>(z.real()), static_cast<float>(z.imag())}; }

// out[n] = exp(-j 2 pi cycles n) times `scale`, re-anchored often enough for single precision.
void fill_rotation(double cycles, double scale, std::span<Cf32> out) noexcept {
  constexpr std::size_t kRun = 256;
  const std::complex<double> step = turn(-cycles);
  for (std::size_t start = 0; start < out.size(); start += kRun) {
    std::complex<double> rotor = scale * turn(-cycles * static_cast<double>(start));
    const std::size_t end = std::min(out.size(), start + kRun);
    for (std::size_t n = start; n < end; ++n) {
      out[n] = narrow(rotor);
      rotor = {rotor.real() * step.real() - rotor.imag() * step.imag(),
               rotor.real() * step.imag() + rotor.imag() * step.real()};
    }
  }
}

// a[n] *= b[n], without std::complex's search for infinities.
void multiply(std::span<Cf32> a, std::span<const Cf32> b) noexcept {
  for (std::size_t n = 0; n < a.size(); ++n) {
    a[n] = {a[n].real() * b[n].real() - a[n].imag() * b[n].imag(),
            a[n].real() * b[n].imag() + a[n].imag() * b[n].real()};
  }
}

}  // namespace

struct Acquirer::Impl {
  AcquisitionOptions options;
  std::size_t delays;
  std::size_t dopplers;
  double threshold;
  double cell_false_alarm;
  int prn = 0;
  dsp::Fft forward;
  dsp::Fft inverse;
  std::vector<Cf32> code;      // conjugate spectrum of the PRN's code
  std::vector<Cf32> wipe;      // carrier of the Doppler at hand, conjugated
  std::vector<Cf32> folded;    // a coherent sum, one code long
  std::vector<Cf32> spectrum;  // of it
  std::vector<Cf32> ramp;      // the code's move since the first sample
  std::vector<float> surface;

  explicit Impl(const AcquisitionOptions& given)
      : options(checked(given)),
        delays(static_cast<std::size_t>(std::lround(options.sample_rate_hz * 1e-3))),
        dopplers(static_cast<std::size_t>((options.max_doppler_hz - options.min_doppler_hz) / options.doppler_step_hz +
                                          1e-9) +
                 1),
        threshold(0.0),
        cell_false_alarm(
            dsp::cell_false_alarm(options.false_alarm_probability, static_cast<double>(delays * dopplers))),
        forward(static_cast<int>(delays), dsp::FftDirection::kForward),
        inverse(static_cast<int>(delays), dsp::FftDirection::kInverse),
        code(delays),
        wipe(delays),
        folded(delays),
        spectrum(delays),
        ramp(delays),
        surface(delays * dopplers) {
    threshold = dsp::detection_threshold(options.noncoherent, cell_false_alarm);
  }

  [[nodiscard]] double doppler(std::size_t bin) const noexcept {
    return options.min_doppler_hz + static_cast<double>(bin) * options.doppler_step_hz;
  }

  void take_code(int wanted) {
    if (prn == wanted) return;
    const CaCode chips = ca_code(wanted);
    for (std::size_t n = 0; n < delays; ++n) {
      folded[n] = static_cast<float>(chips[n * kCodeLength / delays]);
    }
    forward.execute(folded.data(), code.data());
    for (Cf32& c : code) c = std::conj(c);
    prn = wanted;
  }

  // One coherent sum, all codes of it added up into one and mixed to zero: doc/gps_acquisition.md eq. 2.
  void fold(IqSpan samples, double cycles_per_code) noexcept {
    for (int k = 0; k < options.coherent_ms; ++k) {
      const Cf32 weight = narrow(turn(-cycles_per_code * k));
      const float re = weight.real(), im = weight.imag();
      const Cf32* const x = samples.data() + static_cast<std::size_t>(k) * delays;
      for (std::size_t n = 0; n < delays; ++n) {
        const Cf32 product{x[n].real() * re - x[n].imag() * im, x[n].real() * im + x[n].imag() * re};
        folded[n] = k == 0 ? product : folded[n] + product;
      }
    }
    multiply(folded, wipe);
  }

  // Turns the spectrum so that the correlation comes later by `shift` samples: eq. 4.
  void delay_spectrum(double shift) noexcept {
    if (std::abs(shift) < 1e-3) return;
    const std::size_t positive = (delays + 1) / 2;
    const double cycles = shift / static_cast<double>(delays);
    fill_rotation(cycles, 1.0, std::span(ramp).first(positive));
    multiply(std::span(spectrum).first(positive), std::span<const Cf32>(ramp).first(positive));
    const std::size_t negative = delays - positive;
    // From -negative to -1, written from the far end: conj(ramp[k]) belongs to -k.
    fill_rotation(-cycles, 1.0, std::span(ramp).first(negative + 1));
    for (std::size_t k = 1; k <= negative; ++k) {
      Cf32& s = spectrum[delays - k];
      const Cf32 r = ramp[k];
      s = {s.real() * r.real() - s.imag() * r.imag(), s.real() * r.imag() + s.imag() * r.real()};
    }
  }

  void search_doppler(IqSpan samples, std::size_t bin, double scale) noexcept {
    const double doppler_hz = doppler(bin);
    const double f = options.intermediate_hz + doppler_hz;
    fill_rotation(f / options.sample_rate_hz, 1.0, wipe);
    const std::size_t length = delays * static_cast<std::size_t>(options.coherent_ms);
    float* const row = surface.data() + bin * delays;
    std::fill(row, row + delays, 0.0F);
    const auto factor = static_cast<float>(std::sqrt(scale));  // before squaring, which could overflow
    for (int m = 0; m < options.noncoherent; ++m) {
      fold(samples.subspan(static_cast<std::size_t>(m) * length, length), f * kCodePeriodS);
      forward.execute(folded.data(), spectrum.data());
      multiply(spectrum, code);
      const double middle = (static_cast<double>(m) + 0.5) * static_cast<double>(length);  // samples
      delay_spectrum(doppler_hz / kCarrierHz * middle);
      inverse.execute(spectrum.data(), folded.data());
      for (std::size_t n = 0; n < delays; ++n) {
        const float re = factor * folded[n].real(), im = factor * folded[n].imag();
        row[n] += re * re + im * im;
      }
    }
  }
};

Acquirer::Acquirer(const AcquisitionOptions& options) : impl_(std::make_unique<Impl>(options)) {}
Acquirer::~Acquirer() = default;
Acquirer::Acquirer(Acquirer&&) noexcept = default;
Acquirer& Acquirer::operator=(Acquirer&&) noexcept = default;

const AcquisitionOptions& Acquirer::options() const noexcept { return impl_->options; }
std::size_t Acquirer::samples() const noexcept {
  return impl_->delays * static_cast<std::size_t>(impl_->options.coherent_ms) *
         static_cast<std::size_t>(impl_->options.noncoherent);
}
std::size_t Acquirer::delays() const noexcept { return impl_->delays; }
std::size_t Acquirer::dopplers() const noexcept { return impl_->dopplers; }
double Acquirer::doppler_hz(std::size_t bin) const noexcept { return impl_->doppler(bin); }
double Acquirer::cell_false_alarm() const noexcept { return impl_->cell_false_alarm; }
double Acquirer::threshold() const noexcept { return impl_->threshold; }
std::span<const float> Acquirer::surface() const noexcept { return impl_->surface; }

Acquisition Acquirer::search(IqSpan iq, int prn) {
  Impl& impl = *impl_;
  impl.take_code(prn);
  Acquisition found{.prn = prn};
  if (iq.size() < samples()) return found;
  const IqSpan used = iq.first(samples());
  double energy = 0.0;
  bool usable = true;
  for (const Cf32 x : used) {
    const auto re = static_cast<double>(x.real()), im = static_cast<double>(x.imag());
    usable = usable && std::abs(re) <= kMostAmplitude && std::abs(im) <= kMostAmplitude;  // false for NaN
    energy += re * re + im * im;
  }
  if (!usable || !(energy > 0.0)) {
    found.status = AcquisitionStatus::kNotFinite;
    return found;
  }
  const AcquisitionOptions& o = impl.options;
  const double variance = o.noise_variance > 0.0 ? o.noise_variance : energy / static_cast<double>(used.size());
  const auto n = static_cast<double>(impl.delays);
  // The inverse transform multiplies by n; noise adds up over n samples of each code.
  const double scale = 1.0 / (n * n * n * o.coherent_ms * variance);
  for (std::size_t bin = 0; bin < impl.dopplers; ++bin) impl.search_doppler(used, bin, scale);
  const auto highest = std::max_element(impl.surface.begin(), impl.surface.end());
  const auto cell = static_cast<std::size_t>(highest - impl.surface.begin());
  found.bin = cell / impl.delays;
  found.sample = cell % impl.delays;
  found.statistic = static_cast<double>(*highest);
  if (!std::isfinite(found.statistic)) {
    found.statistic = 0.0;
    found.status = AcquisitionStatus::kNotFinite;
    return found;
  }
  found.status = found.statistic > impl.threshold ? AcquisitionStatus::kFound : AcquisitionStatus::kNotFound;
  const auto magnitude = [&](std::size_t bin, std::size_t sample) {
    return std::sqrt(static_cast<double>(impl.surface[bin * impl.delays + sample]));
  };
  double delay = static_cast<double>(found.sample);
  const std::size_t before = (found.sample + impl.delays - 1) % impl.delays;
  const std::size_t after = (found.sample + 1) % impl.delays;
  if (const auto peak = dsp::parabolic_peak(magnitude(found.bin, before), magnitude(found.bin, found.sample),
                                            magnitude(found.bin, after))) {
    delay += peak->offset_samples;
  }
  if (delay < 0.0) delay += n;
  if (delay >= n) delay -= n;
  found.delay_s = delay / o.sample_rate_hz;
  found.doppler_hz = impl.doppler(found.bin);
  if (found.bin > 0 && found.bin + 1 < impl.dopplers) {
    if (const auto peak =
            dsp::parabolic_peak(magnitude(found.bin - 1, found.sample), magnitude(found.bin, found.sample),
                                magnitude(found.bin + 1, found.sample))) {
      found.doppler_hz += peak->offset_samples * o.doppler_step_hz;
    }
  }
  const double snr = found.statistic / o.noncoherent - 1.0;
  found.cn0_dbhz = std::max(0.0, 10.0 * std::log10(std::max(snr, 1e-12) / (o.coherent_ms * kCodePeriodS)));
  return found;
}

double cell_loss(double delay_error_chips, double doppler_error_hz, double coherent_s) noexcept {
  const double code = std::max(0.0, 1.0 - std::abs(delay_error_chips));
  const double x = kPi * doppler_error_hz * coherent_s;
  const double carrier = std::abs(x) < 1e-8 ? 1.0 : std::sin(x) / x;
  return code * code * carrier * carrier;
}

}  // namespace soopnav::gps
