#include "soopnav/simulation/channel_sounder.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "simulation/require.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::simulation {
namespace {

using Complex = std::complex<double>;
constexpr std::uint64_t kSessionStream = std::uint64_t{1} << 62U;  // above any slot
constexpr std::size_t kMostSamples = 1U << 20U;

double sinc(double x) noexcept { return std::abs(x) < 1e-12 ? 1.0 : std::sin(kPi * x) / (kPi * x); }

// Butterworth low pass of four poles, at `ratio` = frequency over corner.
Complex butterworth(double ratio) noexcept {
  Complex response = 1.0;
  for (int k = 0; k < 4; ++k) {
    const Complex pole = std::polar(1.0, kPi * (2.0 * k + 5.0) / 8.0);
    response *= -pole / (Complex(0.0, ratio) - pole);
  }
  return response;
}

void require_positive(std::string_view name, double value) {
  require(std::isfinite(value) && value > 0.0, name, value, "it must be finite and positive");
}
void require_not_negative(std::string_view name, double value) {
  require(std::isfinite(value) && value >= 0.0, name, value, "it must be finite and 0 or more");
}
void require_bits(int bits) { require(bits == 0 || (bits >= 2 && bits <= 24), "adc_bits", bits, "0 or 2 ... 24"); }

bool is_finite(Complex value) noexcept { return std::isfinite(value.real()) && std::isfinite(value.imag()); }

double quantise(double value, double step, double full_scale, std::size_t& clipped) noexcept {
  if (std::abs(value) > full_scale) {
    ++clipped;
    value = std::copysign(full_scale, value);
  }
  return step * std::nearbyint(value / step);
}

}  // namespace

ChannelSounder::ChannelSounder(const SounderOptions& options) : options_(options) {
  const auto& o = options_;
  require_positive("pulse_s", o.pulse_s);
  require_not_negative("rise_s", o.rise_s);
  require_positive("period_s", o.period_s);
  require_positive("sample_rate_hz", o.sample_rate_hz);
  require_positive("if_hz", o.if_hz);
  require_positive("filter_hz", o.filter_hz);
  require(o.pulse_s + o.rise_s < o.period_s, "pulse_s", o.pulse_s, "pulse and edge must be shorter than period_s");
  require(o.rise_s <= o.pulse_s, "rise_s", o.rise_s, "it must be at most pulse_s");
  const double samples = o.period_s * o.sample_rate_hz, cycles = o.period_s * o.if_hz;
  require(std::abs(samples - std::round(samples)) < 1e-6 && samples <= static_cast<double>(kMostSamples), "period_s",
          o.period_s, "a period must hold a whole number of samples, at most 2^20");
  require(std::abs(cycles - std::round(cycles)) < 1e-6 && cycles >= 2.0, "if_hz", o.if_hz,
          "a period must hold a whole number of its cycles, at least 2");
  require(4.0 * o.if_hz <= o.sample_rate_hz, "if_hz", o.if_hz, "it must be at most a quarter of sample_rate_hz");
  require(o.averages >= 1 && o.averages <= 10'000'000, "averages", o.averages, "1 ... 1e7");
  require(o.calibration_averages >= 1 && o.calibration_averages <= 10'000'000, "calibration_averages",
          o.calibration_averages, "1 ... 1e7");
  require(std::isfinite(o.snr_db) && std::abs(o.snr_db) <= 200.0, "snr_db", o.snr_db, "within 200 dB of 0");
  require_positive("reference_gain", o.reference_gain);
  require_bits(o.adc_bits);
  require_positive("headroom", o.headroom);
  require_not_negative("guard_s", o.guard_s);
  require_positive("switch_time_s", o.switch_time_s);
  require(o.isolation_db >= 0.0, "isolation_db", o.isolation_db, "it must be 0 or more");
  require_not_negative("phase_noise_rad", o.phase_noise_rad);
  require_not_negative("clock_rad_per_sqrt_s", o.clock_rad_per_sqrt_s);

  samples_ = static_cast<std::size_t>(std::llround(samples));
  if_bin_ = static_cast<std::size_t>(std::llround(cycles));
  const double duty = o.pulse_s / o.period_s;
  noise_sigma_ = duty * o.reference_gain * std::sqrt(0.25 * samples * std::pow(10.0, -0.1 * o.snr_db));
  full_scale_ = o.headroom * o.reference_gain;
  const int most = static_cast<int>(if_bin_) - 1;
  for (int m = -most; m <= most; ++m) {
    const double f = m / o.period_s;
    line_hz_.push_back(f);
    lines_.push_back(duty * sinc(f * o.pulse_s) * sinc(f * o.rise_s) * butterworth(2.0 * f / o.filter_hz));
  }
  sent_.resize(lines_.size());
  turns_.resize(samples_);
  for (std::size_t n = 0; n < samples_; ++n) turns_[n] = std::polar(1.0, 2.0 * kPi * static_cast<double>(n) / samples);
  analytic_.resize(samples_);
  sum_.resize(samples_);
  noise_.resize(samples_);
}

double ChannelSounder::line_noise_variance(int averages) const noexcept {
  const double step = options_.adc_bits > 0 ? 2.0 * full_scale_ / std::pow(2.0, options_.adc_bits) : 0.0;
  return 4.0 * (noise_sigma_ * noise_sigma_ + step * step / 12.0) / static_cast<double>(samples_) / averages;
}

SoundingReport ChannelSounder::record(std::span<const std::vector<Tap>> ports, std::size_t active, std::uint64_t slot,
                                      std::span<Complex> lines) {
  require(active < ports.size(), "active", static_cast<double>(active), "it must be one of the ports");
  require(lines.size() == line_hz_.size(), "lines", static_cast<double>(lines.size()), "one for each of line_hz");
  require(slot < kSessionStream, "slot", static_cast<double>(slot), "it must be below 2^62");
  const auto& o = options_;
  const std::size_t before = (active + ports.size() - 1) % ports.size();
  const double leak = std::pow(10.0, -0.05 * o.isolation_db);
  // The port before fades while periods are averaged: its mean over them.
  const double per_period = o.period_s / o.switch_time_s;
  const double fading = std::exp(-o.guard_s / o.switch_time_s) * -std::expm1(-o.averages * per_period) /
                        -std::expm1(-per_period) / o.averages;
  std::ranges::fill(sent_, Complex{});
  SoundingReport report;
  for (std::size_t p = 0; p < ports.size(); ++p) {
    double share = p == active ? 1.0 : leak;
    if (p == before && p != active) share += (1.0 - leak) * fading;
    if (p == active && ports.size() > 1) share -= (1.0 - leak) * fading;  // it rises as the other fades
    for (const Tap& tap : ports[p]) {
      if (!std::isfinite(tap.delay_s) || !is_finite(tap.gain)) {
        if (p != active) continue;  // another port's trouble is not this one's
        report.finite = false;
        std::ranges::fill(lines, Complex{});
        return report;
      }
      const double step = -2.0 * kPi * tap.delay_s / o.period_s;
      for (std::size_t m = 0; m < sent_.size(); ++m) {
        const double turn = step * (static_cast<double>(m) - static_cast<double>(if_bin_) + 1.0);
        sent_[m] += share * tap.gain * std::polar(1.0, turn);
      }
    }
  }
  for (std::size_t m = 0; m < sent_.size(); ++m) sent_[m] *= lines_[m];
  report = receive(o.averages, RandomStream(o.seed, 0x50d).substream(slot), lines);
  report.time_s = static_cast<double>(slot) * slot_s() + o.guard_s;
  return report;
}

SoundingReport ChannelSounder::calibrate(std::span<Complex> lines) {
  require(lines.size() == line_hz_.size(), "lines", static_cast<double>(lines.size()), "one for each of line_hz");
  for (std::size_t m = 0; m < sent_.size(); ++m) sent_[m] = options_.reference_gain * lines_[m];
  const auto report =
      receive(options_.calibration_averages, RandomStream(options_.seed, 0x50d).substream(kSessionStream + 1), lines);
  for (Complex& line : lines) line /= options_.reference_gain;
  return report;
}

SoundingReport ChannelSounder::receive(int averages, RandomStream random, std::span<Complex> lines) {
  const auto& o = options_;
  const std::size_t n = samples_;
  for (std::size_t i = 0; i < n; ++i) {
    Complex sum;
    std::size_t at = i % n;  // (bin * i) mod n, bin = 1 first
    for (const Complex& line : sent_) {
      sum += line * turns_[at];
      at += i;
      if (at >= n) at -= n;
    }
    analytic_[i] = sum;
  }
  // Pulse and carrier keep their phase within a session; without a shared reference each slot begins anywhere.
  RandomStream session = RandomStream(o.seed, 0x50d).substream(kSessionStream);
  double drift = 2.0 * kPi * (o.shared_reference ? session.uniform() : random.uniform());
  const double walk = o.shared_reference ? 0.0 : o.clock_rad_per_sqrt_s * std::sqrt(o.period_s);
  const double step = o.adc_bits > 0 ? 2.0 * full_scale_ / std::pow(2.0, o.adc_bits) : 0.0;
  RandomStream phases = random.substream(1), noise = random.substream(2);
  std::ranges::fill(sum_, 0.0);
  SoundingReport report;
  for (int p = 0; p < averages; ++p) {
    const double phase = drift + o.phase_noise_rad * phases.normal();
    drift += walk * phases.normal();
    const double c = std::cos(phase), s = std::sin(phase);
    noise.fill_normal(std::span<double>(noise_));
    if (step > 0.0) {
      for (std::size_t i = 0; i < n; ++i) {
        const double value = c * analytic_[i].real() - s * analytic_[i].imag() + noise_sigma_ * noise_[i];
        sum_[i] += quantise(value, step, full_scale_, report.clipped);
      }
    } else {
      for (std::size_t i = 0; i < n; ++i) {
        sum_[i] += c * analytic_[i].real() - s * analytic_[i].imag() + noise_sigma_ * noise_[i];
      }
    }
  }
  const double scale = 2.0 / (static_cast<double>(n) * averages);
  for (std::size_t m = 0; m < lines.size(); ++m) {
    Complex sum;
    std::size_t at = 0;
    for (std::size_t i = 0; i < n; ++i) {
      sum += sum_[i] * std::conj(turns_[at]);
      at += m + 1;
      if (at >= n) at -= n;
    }
    lines[m] = scale * sum;
  }
  return report;
}

void step_sweep(std::span<const Complex> channel, std::size_t tones, const SweepOptions& options, std::uint64_t seed,
                std::span<Complex> gain) {
  const auto& o = options;
  require(tones > 0 && channel.size() % tones == 0, "tones", static_cast<double>(tones),
          "it must be positive and divide the channel");
  require(gain.size() == channel.size(), "gain", static_cast<double>(gain.size()), "it must be as long as channel");
  require(o.averages >= 1 && o.averages <= 1'000'000, "averages", o.averages, "1 ... 1e6");
  require(std::isfinite(o.snr_db) && std::abs(o.snr_db) <= 200.0, "snr_db", o.snr_db, "within 200 dB of 0");
  require_positive("reference_gain", o.reference_gain);
  require_bits(o.adc_bits);
  require_positive("headroom", o.headroom);
  const double sigma = o.reference_gain * std::pow(10.0, -0.05 * o.snr_db) / std::sqrt(2.0);
  const double full_scale = o.headroom * o.reference_gain;
  const double step = o.adc_bits > 0 ? 2.0 * full_scale / std::pow(2.0, o.adc_bits) : 0.0;
  std::size_t clipped = 0;
  const std::size_t places = channel.size() / tones;
  for (std::size_t f = 0; f < tones; ++f) {
    RandomStream random = RandomStream(seed, 0x57e9).substream(f);
    const Complex lock = std::polar(1.0, 2.0 * kPi * random.uniform());
    const auto measured = [&](Complex true_gain) {
      const Complex z = true_gain * lock;
      Complex sum;
      for (int i = 0; i < o.averages; ++i) {
        double re = z.real() + sigma * random.normal();
        double im = z.imag() + sigma * random.normal();
        if (step > 0.0) {
          re = quantise(re, step, full_scale, clipped);
          im = quantise(im, step, full_scale, clipped);
        }
        sum += Complex(re, im);
      }
      return sum / static_cast<double>(o.averages);
    };
    // The cable is measured at the reference gain, where the receiver is at its best.
    const Complex cable = o.reference_channel ? measured(o.reference_gain) / o.reference_gain : Complex(1.0);
    for (std::size_t p = 0; p < places; ++p) {
      const Complex h = channel[p * tones + f];
      gain[p * tones + f] = is_finite(h) ? measured(h) / cable : Complex{};
    }
  }
}

struct ChannelEmulator::Solver {
  std::vector<double> delays_s, nulls_hz;
  std::vector<std::size_t> lines;  // used
  std::size_t size = 0;            // of a record
  bool covered = false;
  double prior = 0.0;           // variance of a tap for a channel of mean gain 1
  Eigen::MatrixXcd gains;       // taps x used lines
  Eigen::MatrixXcd covariance;  // of the taps
};

ChannelEmulator::ChannelEmulator(std::span<const double> line_hz, std::span<const Complex> reference,
                                 const EmulatorOptions& options)
    : solver_(std::make_unique<Solver>()) {
  const auto& o = options;
  require(line_hz.size() == reference.size(), "reference", static_cast<double>(reference.size()),
          "one for each of line_hz");
  require(line_hz.size() >= 3, "line_hz", static_cast<double>(line_hz.size()), "at least three lines are needed");
  require(o.bandwidth_hz >= 1e5 && o.bandwidth_hz <= 1e9, "bandwidth_hz", o.bandwidth_hz, "0.1 MHz ... 1 GHz");
  require(std::isfinite(o.delay_low_s), "delay_low_s", o.delay_low_s, "it must be finite");
  require(std::isfinite(o.delay_high_s) && o.delay_high_s > o.delay_low_s, "delay_high_s", o.delay_high_s,
          "it must be above delay_low_s");
  require(o.null_db < 0.0 && o.null_db >= -200.0, "null_db", o.null_db, "-200 ... 0");
  require(o.noise_to_signal > 0.0 && o.noise_to_signal <= 1e3, "noise_to_signal", o.noise_to_signal, "above 0, to 1e3");
  double strongest = 0.0;
  for (std::size_t m = 0; m < line_hz.size(); ++m) {
    require(std::isfinite(line_hz[m]) && is_finite(reference[m]), "line_hz, reference", static_cast<double>(m),
            "this line is not finite");
    require(m == 0 || line_hz[m] > line_hz[m - 1], "line_hz", line_hz[m], "they must rise");
    strongest = std::max(strongest, std::abs(reference[m]));
  }
  require(strongest > 0.0, "reference", strongest, "no line has any power");
  const double spacing = (line_hz.back() - line_hz.front()) / static_cast<double>(line_hz.size() - 1);
  require(o.delay_high_s - o.delay_low_s <= 0.5 / spacing, "delay_high_s", o.delay_high_s,
          "the delays must span at most half a period of the lines");

  Solver& s = *solver_;
  s.size = line_hz.size();
  const double half = 0.5 * o.bandwidth_hz;
  const double reach = half + std::max(3e6, 0.1 * o.bandwidth_hz);
  const double least = strongest * std::pow(10.0, 0.05 * o.null_db);
  double low = line_hz.front() - spacing, high = line_hz.back() + spacing;  // nulls that end the usable band
  for (std::size_t m = 0; m < s.size; ++m) {
    if (std::abs(reference[m]) >= least) {
      if (std::abs(line_hz[m]) <= reach) s.lines.push_back(m);
      continue;
    }
    s.nulls_hz.push_back(line_hz[m]);
    if (line_hz[m] < 0.0) low = std::max(low, line_hz[m]);
    if (line_hz[m] >= 0.0) high = std::min(high, line_hz[m]);
  }
  s.covered = low < -half && high > half;
  require(s.lines.size() >= 3, "null_db", o.null_db, "fewer than three lines of the band are left");

  const double step = 1.0 / (1.25 * 2.0 * reach);
  // Two taps beyond either end carry what the band's own width smears over the edge.
  const auto taps = static_cast<Eigen::Index>(std::ceil((o.delay_high_s - o.delay_low_s) / step)) + 5;
  require(taps <= 2000, "delay_high_s", o.delay_high_s, "more than 2000 taps would be needed");
  for (Eigen::Index d = 0; d < taps; ++d) s.delays_s.push_back(o.delay_low_s + static_cast<double>(d - 2) * step);
  const auto used = static_cast<Eigen::Index>(s.lines.size());
  Eigen::MatrixXcd a(used, taps);
  for (Eigen::Index m = 0; m < used; ++m) {
    const std::size_t line = s.lines[static_cast<std::size_t>(m)];
    for (Eigen::Index d = 0; d < taps; ++d) {
      a(m, d) = reference[line] / strongest *
                std::polar(1.0, -2.0 * kPi * line_hz[line] * s.delays_s[static_cast<std::size_t>(d)]);
    }
  }
  s.prior = 1.0 / static_cast<double>(taps);
  Eigen::MatrixXcd normal = a.adjoint() * a;
  normal.diagonal().array() += o.noise_to_signal / s.prior;
  const Eigen::LLT<Eigen::MatrixXcd> factor(normal);
  s.gains = factor.solve(a.adjoint()) / strongest;
  s.covariance = factor.solve(Eigen::MatrixXcd::Identity(taps, taps)) * o.noise_to_signal;
}

ChannelEmulator::~ChannelEmulator() = default;
ChannelEmulator::ChannelEmulator(ChannelEmulator&&) noexcept = default;
ChannelEmulator& ChannelEmulator::operator=(ChannelEmulator&&) noexcept = default;

std::span<const double> ChannelEmulator::delays_s() const noexcept { return solver_->delays_s; }
std::span<const double> ChannelEmulator::nulls_hz() const noexcept { return solver_->nulls_hz; }
std::size_t ChannelEmulator::lines_used() const noexcept { return solver_->lines.size(); }
bool ChannelEmulator::covered() const noexcept { return solver_->covered; }

double ChannelEmulator::sigma(double frequency_hz) const noexcept {
  const Solver& s = *solver_;
  double variance = 0.0;
  const double first = s.delays_s.front(), step = s.delays_s[1] - first;
  const auto n = static_cast<Eigen::Index>(s.delays_s.size());
  for (Eigen::Index i = 0; i < n; ++i) {
    variance += s.covariance(i, i).real();
    for (Eigen::Index j = 0; j < i; ++j) {
      const Complex turn = std::polar(1.0, -2.0 * kPi * frequency_hz * step * static_cast<double>(i - j));
      variance += 2.0 * (turn * s.covariance(i, j)).real();
    }
  }
  return std::sqrt(std::max(0.0, variance));
}

bool ChannelEmulator::taps(std::span<const Complex> lines, std::span<Complex> gain) const {
  const Solver& s = *solver_;
  require(lines.size() == s.size, "lines", static_cast<double>(lines.size()), "as many as the reference has");
  require(gain.size() == s.delays_s.size(), "gain", static_cast<double>(gain.size()), "one for each of delays_s");
  std::ranges::fill(gain, Complex{});
  for (const std::size_t line : s.lines) {
    if (!is_finite(lines[line])) return false;
  }
  for (std::size_t m = 0; m < s.lines.size(); ++m) {
    const Complex y = lines[s.lines[m]];
    const auto column = s.gains.col(static_cast<Eigen::Index>(m));
    for (std::size_t d = 0; d < gain.size(); ++d) gain[d] += y * column(static_cast<Eigen::Index>(d));
  }
  return true;
}

}  // namespace soopnav::simulation
