#include "soopnav/array/calibration.hpp"

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "array/require.hpp"
#include "core/target_clones.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::array {
namespace {

using Complex = std::complex<double>;
using Vector3c = Eigen::Matrix<Complex, 3, 1>;
using Matrix3c = Eigen::Matrix<Complex, 3, 3>;

constexpr std::size_t kLeastSamples = 64;
constexpr double kLeastTurns = 4.0;
constexpr double kDeadDb = 60.0;
constexpr double kLeastToneDb = 10.0;
constexpr double kLargestImage = 0.5;
constexpr int kIterations = 6;
constexpr std::size_t kBlock = 256;

struct Affine {
  float ii, iq, qi, qq, dc_i, dc_q;  // I = ii I' + iq Q', Q = qi I' + qq Q', offsets taken off first
};

SOOPNAV_TARGET_CLONES void undo(Affine m, std::size_t samples, float* x) {
  for (std::size_t n = 0; n < samples; ++n) {
    const float a = x[2 * n] - m.dc_i, b = x[2 * n + 1] - m.dc_q;
    x[2 * n] = m.ii * a + m.iq * b;
    x[2 * n + 1] = m.qi * a + m.qq * b;
  }
}

/// The tone e^{j w (n - c)}, c the middle, for `count` samples from `first` on.
void fill_tone(double turns, double middle, std::size_t first, std::size_t count, std::span<Complex> out) {
  const auto at = [&](double n) {
    const double product = turns * n;
    return std::polar(1.0, kTwoPi * (product - std::rint(product)));
  };
  const Complex step = at(1.0);
  Complex value = at(static_cast<double>(first) - middle);
  for (std::size_t i = 0; i < count; ++i) {
    out[i] = value;
    value = {value.real() * step.real() - value.imag() * step.imag(),
             value.real() * step.imag() + value.imag() * step.real()};
  }
}

/// What one channel's least squares need: sums over its samples.
struct Sums {
  double power = 0.0;
  Complex y, y_down, y_up;  // of y, y E^*, y E
  Complex ny_down, ny_up;   // of n' y E^*, n' y E; n' = (n - c) / N
};

/// And of the tone alone.
struct ToneSums {
  Complex e1, e2, n1, n2;  // of E, E^2, n' E, n' E^2
  Complex nn2;             // n'^2 E^2
  double nn = 0.0;         // n'^2
};

struct Fit {
  Complex a, b, d;
  double variance = 0.0;  // of what is left, per sample
};

class ToneFit {
 public:
  ToneFit(IqSpan iq, std::size_t channels)
      : iq_(iq), samples_(iq.size() / channels), sums_(channels), fits_(channels) {}

  /// Strongest spectral line within +- `tolerance` turns per sample of `turns`.
  [[nodiscard]] double search(double turns, double tolerance, std::span<const Complex> mean) const {
    const auto n = static_cast<double>(samples_);
    const auto pieces = static_cast<std::size_t>(std::clamp(std::ceil(8.0 * tolerance * n), 64.0, n));
    std::vector<Complex> folded(pieces * sums_.size());  // samples of a piece, turned back by the nominal tone
    std::vector<double> centre(pieces);
    std::vector<Complex> tone(samples_ / pieces + 1);
    for (std::size_t p = 0; p < pieces; ++p) {
      const std::size_t first = p * samples_ / pieces, last = (p + 1) * samples_ / pieces;
      centre[p] = 0.5 * static_cast<double>(first + last - 1);
      fill_tone(turns, 0.0, first, last - first, tone);
      for (std::size_t m = 0; m < sums_.size(); ++m) {
        Complex sum;
        for (std::size_t i = first; i < last; ++i) {
          sum += (Complex(iq_[m * samples_ + i]) - mean[m]) * std::conj(tone[i - first]);
        }
        folded[m * pieces + p] = sum;
      }
    }
    const double step = 0.25 / n;
    const auto steps = static_cast<int>(std::ceil(tolerance / step));
    double best = -1.0, found = turns;
    for (int k = -steps; k <= steps; ++k) {
      double height = 0.0;
      for (std::size_t m = 0; m < sums_.size(); ++m) {
        Complex sum;
        for (std::size_t p = 0; p < pieces; ++p) {
          sum += folded[m * pieces + p] * std::polar(1.0, -kTwoPi * k * step * centre[p]);
        }
        height += std::norm(sum) / weight_[m];
      }
      if (height > best) best = height, found = turns + k * step;
    }
    return found;
  }

  void set_weights(std::vector<double> power) { weight_ = std::move(power); }

  /// Least squares of all channels at a frequency; returns the Gauss-Newton step of the frequency [turns per sample].
  double solve(double turns) {
    gather(turns);
    const auto n = static_cast<double>(samples_);
    Matrix3c gram;
    gram << n, std::conj(tone_.e2), std::conj(tone_.e1), tone_.e2, n, tone_.e1, tone_.e1, std::conj(tone_.e1), n;
    const Matrix3c inverse = gram.inverse();
    const Complex j(0.0, 1.0);
    double slope = 0.0, curvature = 0.0;
    for (std::size_t m = 0; m < sums_.size(); ++m) {
      const Sums& s = sums_[m];
      const Vector3c right(s.y_down, s.y_up, s.y);
      const Vector3c x = inverse * right;
      const Complex a = x[0], b = x[1];
      const double left = std::max(s.power - x.dot(right).real(), 0.0);
      fits_[m] = {a, b, x[2], left / (n - 3.0)};
      // D = j n' (a E - b E^*): how the model moves with the frequency.
      const Vector3c on(-j * b * std::conj(tone_.n2), j * a * tone_.n2, j * (a * tone_.n1 - b * std::conj(tone_.n1)));
      const Complex with_y = -j * (std::conj(a) * s.ny_down - std::conj(b) * s.ny_up);
      const double with_residual = (with_y - on.dot(x)).real();
      const double square = (std::norm(a) + std::norm(b)) * tone_.nn - 2.0 * (a * std::conj(b) * tone_.nn2).real();
      const double own = square - on.dot(inverse * on).real();
      const double variance = std::max(fits_[m].variance, 1e-13 * s.power / n);
      slope += with_residual / variance;
      curvature += own / variance;
    }
    if (!(curvature > 0.0)) return 0.0;
    turns_sigma_ = std::sqrt(0.5 / curvature) / (kTwoPi * n);
    return slope / curvature / (kTwoPi * n);
  }

  [[nodiscard]] const std::vector<Fit>& fits() const noexcept { return fits_; }
  [[nodiscard]] double turns_sigma() const noexcept { return turns_sigma_; }

 private:
  void gather(double turns) {
    std::ranges::fill(sums_, Sums{});
    tone_ = {};
    const auto n = static_cast<double>(samples_);
    const double middle = 0.5 * (n - 1.0);
    std::array<Complex, kBlock> tone;
    for (std::size_t first = 0; first < samples_; first += kBlock) {
      const std::size_t count = std::min(kBlock, samples_ - first);
      fill_tone(turns, middle, first, count, tone);
      for (std::size_t i = 0; i < count; ++i) {
        const double at = (static_cast<double>(first + i) - middle) / n;
        const Complex e = tone[i], squared = e * e;
        tone_.e1 += e;
        tone_.e2 += squared;
        tone_.n1 += at * e;
        tone_.n2 += at * squared;
        tone_.nn += at * at;
        tone_.nn2 += at * at * squared;
      }
      for (std::size_t m = 0; m < sums_.size(); ++m) {
        Sums& s = sums_[m];
        const Cf32* y = iq_.data() + m * samples_ + first;
        double power = 0.0, re = 0.0, im = 0.0, down_re = 0.0, down_im = 0.0, up_re = 0.0, up_im = 0.0;
        double ndown_re = 0.0, ndown_im = 0.0, nup_re = 0.0, nup_im = 0.0;
        for (std::size_t i = 0; i < count; ++i) {
          const double u = static_cast<double>(y[i].real()), v = static_cast<double>(y[i].imag());
          const double c = tone[i].real(), d = tone[i].imag();
          const double at = (static_cast<double>(first + i) - middle) / n;
          const double uc = u * c, vd = v * d, vc = v * c, ud = u * d;
          power += u * u + v * v;
          re += u, im += v;
          down_re += uc + vd, down_im += vc - ud;
          up_re += uc - vd, up_im += vc + ud;
          ndown_re += at * (uc + vd), ndown_im += at * (vc - ud);
          nup_re += at * (uc - vd), nup_im += at * (vc + ud);
        }
        s.power += power;
        s.y += Complex(re, im);
        s.y_down += Complex(down_re, down_im);
        s.y_up += Complex(up_re, up_im);
        s.ny_down += Complex(ndown_re, ndown_im);
        s.ny_up += Complex(nup_re, nup_im);
      }
    }
  }

  IqSpan iq_;
  std::size_t samples_;
  std::vector<Sums> sums_;
  std::vector<Fit> fits_;
  std::vector<double> weight_;
  ToneSums tone_;
  double turns_sigma_ = 0.0;
};

/// Whether one rail of a tone is cut off: the fitted amplitude is beyond half the range of its values by more than a
/// converter's rounding explains, and many of them lie at the ends. Returns their share, 0 when it is not.
double cut_off(IqSpan row, bool quadrature, double amplitude) {
  const auto part = [quadrature](Cf32 x) { return quadrature ? x.imag() : x.real(); };
  float low = part(row[0]), high = low;
  for (const Cf32 x : row) low = std::min(low, part(x)), high = std::max(high, part(x));
  float below = low;
  std::size_t at_ends = 0;
  for (const Cf32 x : row) {
    const float value = part(x);
    if (value == high || value == low) ++at_ends;
    if (value < high) below = std::max(below, value);
  }
  const double half = 0.5 * (static_cast<double>(high) - static_cast<double>(low));
  const double step = static_cast<double>(high) - static_cast<double>(below);
  const double share = static_cast<double>(at_ends) / static_cast<double>(row.size());
  return amplitude > 1.01 * half && amplitude > half + 0.75 * step && share > 0.05 ? share : 0.0;
}

double decibels(double ratio) { return 10.0 * std::log10(ratio); }

}  // namespace

std::complex<double> ChannelCorrection::image() const noexcept {
  const Complex imbalance = std::polar(iq_gain, -iq_phase_rad);
  return (1.0 - imbalance) / (1.0 + imbalance);
}

bool ChannelCorrection::valid() const noexcept {
  return std::isfinite(iq_gain) && iq_gain > 0.0 && std::abs(iq_phase_rad) < 1.4 && std::isfinite(dc.real()) &&
         std::isfinite(dc.imag()) && std::isfinite(gain.real()) && std::isfinite(gain.imag()) && std::norm(gain) > 0.0;
}

void apply_correction(const ChannelCorrection& correction, std::span<Cf32> samples) noexcept {
  const Complex turn = 1.0 / correction.gain;
  // I = I', Q = (Q' / g - I' sin phi) / cos phi; then times 1 / gain.
  const double of_i = -std::tan(correction.iq_phase_rad);
  const double of_q = 1.0 / (correction.iq_gain * std::cos(correction.iq_phase_rad));
  const Affine m{static_cast<float>(turn.real() - turn.imag() * of_i),
                 static_cast<float>(-turn.imag() * of_q),
                 static_cast<float>(turn.imag() + turn.real() * of_i),
                 static_cast<float>(turn.real() * of_q),
                 static_cast<float>(correction.dc.real()),
                 static_cast<float>(correction.dc.imag())};
  undo(m, samples.size(), reinterpret_cast<float*>(samples.data()));
}

std::string_view to_string(CalibrationStatus status) noexcept {
  switch (status) {
    case CalibrationStatus::kOk:
      return "ok";
    case CalibrationStatus::kTooFewSamples:
      return "too few samples";
    case CalibrationStatus::kNonFinite:
      return "not finite";
    case CalibrationStatus::kDeadChannel:
      return "dead channel";
    case CalibrationStatus::kWeakTone:
      return "tone too weak";
    case CalibrationStatus::kSaturated:
      return "saturated";
    case CalibrationStatus::kNoQuadrature:
      return "image as strong as the tone";
  }
  return "unknown";
}

CalibrationReport calibrate(IqSpan iq, std::size_t channels, double sample_rate_hz, double tone_hz,
                            const CalibrationOptions& options) {
  require(channels >= 1 && iq.size() % channels == 0, "channels", static_cast<double>(channels),
          "it must divide the number of samples");
  require(options.reference < channels, "reference", static_cast<double>(options.reference),
          "there is no channel of that number");
  require(std::isfinite(sample_rate_hz) && sample_rate_hz > 0.0, "sample_rate_hz", sample_rate_hz,
          "it must be finite and positive");
  require(std::isfinite(tone_hz) && tone_hz != 0.0 && std::abs(tone_hz) < 0.5 * sample_rate_hz, "tone_hz", tone_hz,
          "it must be off 0 Hz, where it is a point and no ellipse, and below half the sampling rate");
  require(std::isfinite(options.tolerance_hz) && options.tolerance_hz >= 0.0, "tolerance_hz", options.tolerance_hz,
          "it must be finite and not negative");
  CalibrationReport report;
  const auto fail = [&report](CalibrationStatus status, int channel, double value) {
    report.status = status;
    report.channel = channel;
    report.value = value;
    return report;
  };
  const std::size_t samples = iq.size() / channels;
  const auto n = static_cast<double>(samples);
  if (samples < kLeastSamples) return fail(CalibrationStatus::kTooFewSamples, -1, n);
  const double nominal = tone_hz / sample_rate_hz;
  const double turns_to_tell = std::min(std::abs(nominal), 0.5 - std::abs(nominal)) * n;
  if (turns_to_tell < kLeastTurns) return fail(CalibrationStatus::kTooFewSamples, -1, n);

  const auto row = [&](std::size_t m) { return iq.subspan(m * samples, samples); };
  std::vector<Complex> mean(channels);
  std::vector<double> power(channels);
  for (std::size_t m = 0; m < channels; ++m) {
    double square = 0.0;
    for (const Cf32 x : row(m)) {
      mean[m] += Complex(x);
      square += static_cast<double>(x.real()) * static_cast<double>(x.real()) +
                static_cast<double>(x.imag()) * static_cast<double>(x.imag());
    }
    if (!std::isfinite(square)) {
      const auto bad =
          std::ranges::find_if(row(m), [](Cf32 x) { return !std::isfinite(x.real()) || !std::isfinite(x.imag()); });
      return fail(CalibrationStatus::kNonFinite, static_cast<int>(m), static_cast<double>(bad - row(m).begin()));
    }
    mean[m] /= n;
    for (const Cf32 x : row(m)) power[m] += std::norm(Complex(x) - mean[m]) / n;
  }
  const double strongest = *std::ranges::max_element(power);
  for (std::size_t m = 0; m < channels; ++m) {
    if (!(power[m] > 0.0) || decibels(power[m] / strongest) < -kDeadDb) {
      const double below = power[m] > 0.0 ? -decibels(power[m] / strongest) : std::numeric_limits<double>::infinity();
      return fail(CalibrationStatus::kDeadChannel, static_cast<int>(m), below);
    }
  }

  ToneFit fit(iq, channels);
  fit.set_weights(power);
  // Four turns at most by default, and never as far as 0 Hz or half the rate, beyond which the tone is its own image.
  const double wanted = options.tolerance_hz > 0.0 ? options.tolerance_hz / sample_rate_hz : kLeastTurns / n;
  const double tolerance = std::min(wanted, (turns_to_tell - 1.0) / n);
  double turns = fit.search(nominal, tolerance, mean);
  for (int k = 0; k < kIterations; ++k) turns += std::clamp(fit.solve(turns), -0.25 / n, 0.25 / n);

  report.tone_hz = turns * sample_rate_hz;
  report.tone_sigma_hz = fit.turns_sigma() * sample_rate_hz;
  for (std::size_t m = 0; m < channels; ++m) {
    const Fit& f = fit.fits()[m];
    const double tone = std::norm(f.a) + std::norm(f.b);
    const double snr_db = decibels(tone / std::max(f.variance, std::numeric_limits<double>::min()));
    if (!(snr_db >= kLeastToneDb)) return fail(CalibrationStatus::kWeakTone, static_cast<int>(m), snr_db);
    const Complex image = f.b / std::conj(f.a);
    if (!(std::abs(image) < kLargestImage)) {
      return fail(CalibrationStatus::kNoQuadrature, static_cast<int>(m), 2.0 * decibels(std::abs(image)));
    }
    for (const bool quadrature : {false, true}) {
      const double amplitude = std::abs(quadrature ? f.a - std::conj(f.b) : f.a + std::conj(f.b));
      const double share = cut_off(row(m), quadrature, amplitude);
      if (share > 0.0) return fail(CalibrationStatus::kSaturated, static_cast<int>(m), share);
    }
  }
  const auto tone_of = [&fit](std::size_t m) { return fit.fits()[m].a + std::conj(fit.fits()[m].b); };
  const auto relative_sigma = [&](std::size_t m) {
    return std::sqrt(fit.fits()[m].variance / n) / std::abs(tone_of(m));
  };
  for (std::size_t m = 0; m < channels; ++m) {
    const Fit& f = fit.fits()[m];
    const Complex image = f.b / std::conj(f.a);
    const Complex imbalance = (1.0 - image) / (1.0 + image);
    ChannelReport channel;
    channel.correction.iq_gain = std::abs(imbalance);
    channel.correction.iq_phase_rad = -std::arg(imbalance);
    channel.correction.dc = f.d;
    channel.correction.gain = m == options.reference ? Complex(1.0) : tone_of(m) / tone_of(options.reference);
    channel.tone_amplitude = std::abs(tone_of(m));
    channel.tone_snr_db =
        decibels((std::norm(f.a) + std::norm(f.b)) / std::max(f.variance, std::numeric_limits<double>::min()));
    channel.residual_rms = std::sqrt(f.variance);
    channel.image_sigma = std::sqrt(f.variance / n * (1.0 + std::norm(image))) / std::abs(f.a);
    if (m != options.reference) {
      channel.phase_sigma_rad = std::hypot(relative_sigma(m), relative_sigma(options.reference));
    }
    report.channels.push_back(channel);
  }
  report.status = CalibrationStatus::kOk;
  return report;
}

}  // namespace soopnav::array
