#include "soopnav/clock/coherence.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <string>

#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/chi_square.hpp"

namespace soopnav::clock {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kEnsemble = 8.0;  // records from which on their scatter says more than each one's inside

void require(bool holds, const char* name, double value, const char* rule) {
  if (!holds) throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " " + rule);
}

std::complex<double> turned(double cycles) noexcept {
  const double angle = kTwoPi * (cycles - std::nearbyint(cycles));
  return {std::cos(angle), std::sin(angle)};
}

void require_no_infinity(std::span<const double> phase_cycles) {
  for (std::size_t i = 0; i < phase_cycles.size(); ++i) {
    if (std::isinf(phase_cycles[i])) {
      throw std::invalid_argument("phase_cycles[" + std::to_string(i) + "] must not be infinite");
    }
  }
}

// Sums of exp(j 2 pi φ) and counts of gaps before each phase, so that a window costs a difference.
struct Running {
  std::vector<std::complex<double>> sum;
  std::vector<std::size_t> gaps;

  explicit Running(std::span<const double> phase_cycles) : sum(1), gaps(1) {
    sum.reserve(phase_cycles.size() + 1);
    gaps.reserve(phase_cycles.size() + 1);
    for (const double phase : phase_cycles) {
      const bool gap = std::isnan(phase);
      sum.push_back(gap ? sum.back() : sum.back() + turned(phase));
      gaps.push_back(gaps.back() + (gap ? 1 : 0));
    }
  }

  // C² of `samples` phases from `first` on; NaN with a gap.
  [[nodiscard]] double squared(std::size_t first, std::size_t samples) const noexcept {
    if (gaps[first + samples] != gaps[first]) return kNan;
    const double scale = 1.0 / static_cast<double>(samples);
    return std::min(1.0, std::norm((sum[first + samples] - sum[first]) * scale));
  }
};

// Variance of the mean of one record's series of C²: its variance times the sum of its autocorrelation up to where that
// first falls to zero (doc/coherence.md eq. 4). Thinned to a few hundred points, which overlapping windows can spare.
double variance_of_mean(std::span<const double> series) {
  constexpr std::size_t kPoints = 400;
  const std::size_t step = std::max<std::size_t>(1, series.size() / kPoints);
  std::vector<double> x;
  double mean = 0.0;
  for (std::size_t i = 0; i < series.size(); i += step) {
    x.push_back(series[i]);
    mean += series[i];
  }
  const auto count = static_cast<double>(x.size());
  mean /= count;
  for (double& value : x) value -= mean;
  double sum = 0.0;
  for (std::size_t lag = 0; lag < x.size(); ++lag) {
    double product = 0.0;
    for (std::size_t i = 0; i + lag < x.size(); ++i) product += x[i] * x[i + lag];
    if (lag > 0 && product <= 0.0) break;
    sum += lag == 0 ? product : 2.0 * product;
  }
  return sum / (count * count);
}

// The band of an expectation by chi-square scatter with the variance `spread` of its estimate (doc/coherence.md eqs. 5,
// 6).
void set_band(Coherence& point, double spread, double confidence) {
  const double tail = 0.5 * (1.0 - confidence);
  const bool coherent = point.mean_squared > 0.5;
  const double small = coherent ? 1.0 - point.mean_squared : point.mean_squared;
  const double dof = spread > 0.0 ? std::min(point.effective, 2.0 * small * small / spread) : point.effective;
  point.effective = dof;
  const double low = small * dof / chi_square_upper_quantile(tail, dof);
  const double most = chi_square_quantile(tail, dof);
  const double high = std::min(1.0, small * dof > most ? 1.0 : small * dof / most);
  point.lower = std::clamp(coherent ? 1.0 - high : low, 0.0, 1.0);
  point.upper = std::clamp(coherent ? 1.0 - low : high, 0.0, 1.0);
}

// (1 - exp(-z)) / z
double mean_decay(double z) noexcept { return z < 1e-12 ? 1.0 - 0.5 * z : -std::expm1(-z) / z; }

// Gauss and Legendre's nodes and weights of eight points on [-1, 1] (Abramowitz and Stegun table 25.4), one half.
constexpr std::array<std::array<double, 2>, 4> kGauss{{{0.1834346424956498, 0.3626837833783620},
                                                       {0.5255324099163290, 0.3137066458778873},
                                                       {0.7966664774136267, 0.2223810344533745},
                                                       {0.9602898564975363, 0.1012285362903763}}};

void check_sensitivity(double tau_s, double mean_squared, double level, const char* level_name) {
  require(tau_s > 0.0 && std::isfinite(tau_s), "tau_s", tau_s, "must be positive and finite");
  require(mean_squared > 0.0 && mean_squared <= 1.0, "mean_squared", mean_squared, "must be in (0, 1]");
  require(std::isfinite(level), level_name, level, "must be finite");
}

}  // namespace

double coherence(std::span<const double> phase_cycles) noexcept {
  std::complex<double> sum{};
  for (const double phase : phase_cycles) sum += std::isfinite(phase) ? turned(phase) : std::complex<double>(kNan, 0.0);
  return phase_cycles.empty() ? kNan : std::abs(sum) / static_cast<double>(phase_cycles.size());
}

std::vector<double> coherences(std::span<const double> phase_cycles, std::size_t samples) {
  require(samples >= 1, "samples", static_cast<double>(samples), "must be at least 1");
  require_no_infinity(phase_cycles);
  std::vector<double> out;
  if (samples > phase_cycles.size()) return out;
  const Running running(phase_cycles);
  out.reserve(phase_cycles.size() - samples + 1);
  for (std::size_t i = 0; i + samples <= phase_cycles.size(); ++i)
    out.push_back(std::sqrt(running.squared(i, samples)));
  return out;
}

void remove_trend(std::span<double> phase_cycles) {
  require_no_infinity(phase_cycles);
  double count = 0.0, mean_i = 0.0, mean = 0.0;
  for (std::size_t i = 0; i < phase_cycles.size(); ++i) {
    if (std::isnan(phase_cycles[i])) continue;
    count += 1.0;
    mean_i += (static_cast<double>(i) - mean_i) / count;
    mean += (phase_cycles[i] - mean) / count;
  }
  double cross = 0.0, spread = 0.0;
  for (std::size_t i = 0; i < phase_cycles.size(); ++i) {
    if (std::isnan(phase_cycles[i])) continue;
    const double x = static_cast<double>(i) - mean_i;
    cross += x * (phase_cycles[i] - mean);
    spread += x * x;
  }
  const double slope = spread > 0.0 ? cross / spread : 0.0;
  for (std::size_t i = 0; i < phase_cycles.size(); ++i) {
    phase_cycles[i] -= mean + slope * (static_cast<double>(i) - mean_i);
  }
}

std::vector<Coherence> mean_squared_coherence(std::span<const double> phase_cycles, std::size_t runs, double dt_s,
                                              std::span<const std::size_t> samples, const CoherenceOptions& options) {
  require(dt_s > 0.0 && std::isfinite(dt_s), "dt_s", dt_s, "must be positive and finite");
  require(runs >= 1 && phase_cycles.size() % runs == 0, "runs", static_cast<double>(runs),
          "must be at least 1 and divide the number of phases");
  require(options.confidence > 0.0 && options.confidence < 1.0, "confidence", options.confidence, "must be in (0, 1)");
  for (const std::size_t n : samples) require(n >= 1, "samples", static_cast<double>(n), "must be at least 1");
  require_no_infinity(phase_cycles);
  struct Sums {
    double mean = 0.0;
    double effective = 0.0;
    double least = 1.0;
    std::size_t count = 0;
    double within = 0.0;   // of the variances of the records' means
    double means = 0.0;    // of the records' means ...
    double squares = 0.0;  // ... and of their squares
    double records = 0.0;
  };
  std::vector<Sums> sums(samples.size());
  const std::size_t length = phase_cycles.size() / runs;
  std::vector<double> record(length);
  std::vector<double> series;
  for (std::size_t run = 0; run < runs; ++run) {
    const auto from = phase_cycles.subspan(run * length, length);
    std::copy(from.begin(), from.end(), record.begin());
    if (options.detrend) remove_trend(record);
    const Running running(record);
    for (std::size_t k = 0; k < samples.size(); ++k) {
      const std::size_t n = samples[k];
      if (n > length) continue;
      const std::size_t windows = length - n + 1;
      series.clear();
      Sums& s = sums[k];
      for (std::size_t i = 0; i < windows; ++i) {
        const double c2 = running.squared(i, n);
        if (std::isnan(c2)) continue;
        series.push_back(c2);
        s.mean += c2;
        s.least = std::min(s.least, c2);
      }
      if (series.empty()) continue;
      const auto here = static_cast<double>(series.size());
      const double mean = std::accumulate(series.begin(), series.end(), 0.0) / here;
      s.count += series.size();
      // Gaps cost windows as a shorter record would.
      s.effective += static_cast<double>(length) / static_cast<double>(n) * here / static_cast<double>(windows);
      s.within += variance_of_mean(series);
      s.means += mean;
      s.squares += mean * mean;
      s.records += 1.0;
    }
  }
  std::vector<Coherence> out;
  for (std::size_t k = 0; k < samples.size(); ++k) {
    const Sums& s = sums[k];
    if (s.count == 0) continue;
    Coherence point{.tau_s = static_cast<double>(samples[k]) * dt_s,
                    .mean_squared = s.mean / static_cast<double>(s.count),
                    .least = s.least,
                    .effective = s.effective,
                    .count = s.count};
    // Of many records their own scatter; of few what shows within them.
    const double between = (s.squares - s.means * s.means / s.records) / (s.records - 1.0) / s.records;
    set_band(point, s.records >= kEnsemble ? between : s.within / (s.records * s.records), options.confidence);
    out.push_back(point);
  }
  return out;
}

std::vector<std::size_t> coherence_samples(std::size_t phases, std::size_t per_decade) {
  require(per_decade >= 1 && per_decade <= 1000, "per_decade", static_cast<double>(per_decade), "must be in [1, 1000]");
  std::vector<std::size_t> out;
  for (int step = 0;; ++step) {
    const double n = std::round(std::pow(10.0, static_cast<double>(step) / static_cast<double>(per_decade)));
    if (!(n <= static_cast<double>(phases))) break;
    if (out.empty() || out.back() != static_cast<std::size_t>(n)) out.push_back(static_cast<std::size_t>(n));
  }
  return out;
}

CoherenceTime coherence_time(std::span<const double> tau_s, std::span<const double> mean_squared, double level) {
  require(level > 0.0 && level < 1.0, "level", level, "must be in (0, 1)");
  if (tau_s.empty() || tau_s.size() != mean_squared.size()) {
    throw std::invalid_argument("mean_squared: one number for each of at least one time expected, got " +
                                std::to_string(mean_squared.size()) + " for " + std::to_string(tau_s.size()));
  }
  for (std::size_t i = 0; i < tau_s.size(); ++i) {
    if (!std::isfinite(mean_squared[i])) {
      throw std::invalid_argument("mean_squared[" + std::to_string(i) + "] must be finite");
    }
    if (!std::isfinite(tau_s[i]) || (i > 0 && !(tau_s[i] > tau_s[i - 1]))) {
      throw std::invalid_argument("tau_s[" + std::to_string(i) + "] = " + std::to_string(tau_s[i]) +
                                  " must be finite and above the one before it");
    }
  }
  if (mean_squared[0] < level) return {tau_s[0], false};
  for (std::size_t i = 1; i < tau_s.size(); ++i) {
    if (mean_squared[i] < level) {
      const double share = (mean_squared[i - 1] - level) / (mean_squared[i - 1] - mean_squared[i]);
      return {tau_s[i - 1] + share * (tau_s[i] - tau_s[i - 1]), false};
    }
  }
  return {tau_s.back(), true};
}

double expected_coherence(const ClockNoise& noise, double carrier_hz, double tau_s, double drift_sigma) {
  const double s_f = noise.white_frequency_m2ps;
  const double s_g = noise.frequency_walk_m2ps3;
  require(s_f >= 0.0 && std::isfinite(s_f), "white_frequency_m2ps", s_f, "must be finite and >= 0");
  require(s_g >= 0.0 && std::isfinite(s_g), "frequency_walk_m2ps3", s_g, "must be finite and >= 0");
  require(drift_sigma >= 0.0 && std::isfinite(drift_sigma), "drift_sigma", drift_sigma, "must be finite and >= 0");
  require(carrier_hz > 0.0 && std::isfinite(carrier_hz), "carrier_hz", carrier_hz, "must be positive and finite");
  require(tau_s > 0.0 && std::isfinite(tau_s), "tau_s", tau_s, "must be positive and finite");
  const double k = 0.5 * std::pow(kTwoPi * carrier_hz / kSpeedOfLightMps, 2);  // of a variance in m²
  const double drift = kSpeedOfLightMps * drift_sigma;
  const double a = k * s_f * tau_s;
  if (s_g == 0.0 && drift == 0.0) {
    if (a < 1e-4) return 1.0 - a / 3.0 + a * a / 12.0;
    return 2.0 * (a + std::expm1(-a)) / (a * a);
  }
  // doc/coherence.md eq. 9 over panels that halve towards s = 0, where a wild clock has all of its integral.
  double sum = 0.0;
  double right = tau_s;
  for (int panel = 0; panel < 160; ++panel) {
    const double left = panel == 159 ? 0.0 : right * 0.75;
    const double half = 0.5 * (right - left);
    for (const auto& [node, weight] : kGauss) {
      for (const double at : {-node, node}) {
        const double s = left + half * (1.0 + at);
        const double rest = tau_s - s;
        const double loss = k * (s_f * s + s_g * s * s * s / 3.0 + drift * drift * s * s);
        sum += half * weight * std::exp(-loss) * rest * mean_decay(k * s_g * s * s * rest);
      }
    }
    right = left;
  }
  return 2.0 * sum / (tau_s * tau_s);
}

double predetection_snr_db(double cn0_dbhz, double tau_s, double mean_squared) {
  check_sensitivity(tau_s, mean_squared, cn0_dbhz, "cn0_dbhz");
  return cn0_dbhz + 10.0 * std::log10(tau_s * mean_squared);
}

double required_cn0_dbhz(double tau_s, double mean_squared, double snr_db) {
  check_sensitivity(tau_s, mean_squared, snr_db, "snr_db");
  return snr_db - 10.0 * std::log10(tau_s * mean_squared);
}

}  // namespace soopnav::clock
