#include "soopnav/waveform/ofdm/boundary.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "waveform/ofdm/kernels.hpp"
#include "waveform/ofdm/profile.hpp"
#include "waveform/ofdm/require.hpp"

namespace soopnav::ofdm {
namespace {

constexpr int kFractions = 64;
constexpr int kCoarseStep = 4;
constexpr int kCoarse = kFractions / kCoarseStep;
constexpr int kMaxPeriod = 256;
constexpr double kMinSnrDb = -60.0;
constexpr double kMaxSnrDb = 100.0;
constexpr double kLevelLowDb = -14.0;
constexpr double kLevelStepDb = 2.0;
constexpr int kLevels = 33;  // up to 50 dB, which also stands for no noise
constexpr double kMaxRho = 1.0 - 1e-5;
constexpr double kSmoothRho = 0.99;
constexpr double kMinRho = 0.02;
constexpr std::size_t kInflationFractions = 4;  // at 1/16, 3/16, 5/16, 7/16; symmetric about 1/2
constexpr double kWideBelowRho = 0.66;          // 3 dB

double share_of(double snr_db) noexcept {
  const double ratio = std::pow(10.0, 0.1 * snr_db);
  return ratio / (1.0 + ratio);
}

double snr_db_of(double rho) noexcept { return 10.0 * std::log10(rho / (1.0 - rho)); }

void require_snr(double snr_db) {
  require(snr_db >= kMinSnrDb && snr_db <= kMaxSnrDb, "snr_db", snr_db, "it must lie between -60 and 100");
}

double wrapped(double value, double period) noexcept {
  const double r = value - period * std::floor(value / period);
  return r < period ? r : 0.0;
}

// Variance of a top that is one of M / v unrelated windows when the right one does not stand out (doc/ofdm.md eq. 6).
double variance_of_wrong_tops(double rho, double pairs, double period, double window) noexcept {
  const double wrong = std::min(1.0, 2.0 * period / window * std::exp(-0.5 * rho * rho * pairs));
  return wrong * period * period / 12.0;
}

}  // namespace

// What the interpolated method keeps: the profiles by fraction, sigma's tables by noise level, and scratch.
struct BoundaryEstimator::Tables {
  std::size_t period = 0;
  std::size_t stride = 0;  // of a row, padded with gaps of 1: pairs without correlation
  std::size_t inner_begin = 0, inner_end = 0;
  double symbols = 0.0;
  std::vector<float> gap;                              // [fraction][stride], 1 - b
  std::array<double, kFractions> inner_correlation{};  // mean of b over the inner window
  std::array<double, kLevels> rho{};
  std::vector<double> information;  // [level][fraction], per symbol
  std::array<std::array<double, kInflationFractions>, kLevels> inflation{};
  std::vector<float> apart, cross;         // folded |difference|^2 and product, from a period before the top on
  std::vector<float> weight, twice;        // rows of the coarse fractions
  std::array<double, kCoarse> constant{};  // and their -K sum ln(1 - r^2)
  std::array<double, 7 * kCoarse> log_likelihood{};

  Tables(const Numerology& numerology, double symbol_count)
      : period(static_cast<std::size_t>(numerology.symbol_samples())),
        stride((period + 7) / 8 * 8),
        symbols(symbol_count),
        gap(kFractions * stride, 1.0F),
        information(kLevels * kFractions),
        apart(2 * period + stride),
        cross(2 * period + stride),
        weight(kCoarse * stride),
        twice(kCoarse * stride) {
    const auto prefix = static_cast<std::size_t>(numerology.prefix);
    const std::size_t margin = prefix >= 6 ? 2 : 0;
    inner_begin = margin;
    inner_end = prefix - margin;
    std::vector<double> b((kFractions + 1) * period);
    for (std::size_t f = 0; f <= kFractions; ++f) {
      for (std::size_t i = 0; i < period; ++i) {
        b[f * period + i] =
            prefix_correlation(numerology, static_cast<double>(i) - static_cast<double>(f) / kFractions);
      }
    }
    for (std::size_t f = 0; f < kFractions; ++f) {
      for (std::size_t i = 0; i < period; ++i) gap[f * stride + i] = static_cast<float>(1.0 - b[f * period + i]);
      double sum = 0.0;
      for (std::size_t i = inner_begin; i < inner_end; ++i) sum += b[f * period + i];
      inner_correlation[f] = sum / static_cast<double>(inner_end - inner_begin);
    }
    for (std::size_t level = 0; level < kLevels; ++level) {
      rho[level] = std::min(kMaxRho, share_of(kLevelLowDb + kLevelStepDb * static_cast<double>(level)));
      for (std::size_t f = 0; f < kFractions; ++f) {
        double sum = 0.0;
        for (std::size_t i = 0; i < period; ++i) {
          const double before = f > 0 ? b[(f - 1) * period + i] : b[(kFractions - 1) * period + (i + 1) % period];
          const double r = rho[level] * b[f * period + i];
          const double dr = rho[level] * (b[(f + 1) * period + i] - before) * (0.5 * kFractions);
          const double a = 1.0 - r * r;
          sum += 2.0 * dr * dr * (1.0 + r * r) / (a * a);
        }
        information[level * kFractions + f] = sum;
      }
    }
    std::array<double, kLevels> by_level{};
    for (std::size_t f = 0; f < kInflationFractions; ++f) {
      score_inflation(numerology, (static_cast<double>(f) + 0.5) / 8.0, rho.data(), kLevels, by_level.data());
      for (std::size_t level = 0; level < kLevels; ++level) inflation[level][f] = std::max(1.0, by_level[level]);
    }
  }

  [[nodiscard]] std::size_t level_of(double share) const noexcept {
    const auto above = std::lower_bound(rho.begin(), rho.end(), share);
    if (above == rho.end()) return rho.size() - 1;
    const auto i = static_cast<std::size_t>(above - rho.begin());
    return i > 0 && share - rho[i - 1] < rho[i] - share ? i - 1 : i;
  }

  /// Makes coarse row `row` that of a fraction at signal share `share`.
  void prepare(std::size_t row, std::size_t fraction, double share) noexcept {
    constant[row] = -symbols * kernels::pair_weights(&gap[fraction * stride], static_cast<float>(1.0 - share),
                                                     static_cast<float>(share), &weight[row * stride],
                                                     &twice[row * stride], stride);
  }

  /// Log-likelihood (eq. 10) of a boundary `offset` samples, from -4, after the top, with the fraction of `row`.
  [[nodiscard]] double likelihood(std::size_t row, int offset) const noexcept {
    const auto from = static_cast<std::size_t>(offset + static_cast<int>(period));
    return constant[row] - static_cast<double>(kernels::dot2(&weight[row * stride], &apart[from], &twice[row * stride],
                                                             &cross[from], stride));
  }

  /// Between the neighbouring fractions' inflations, symmetric about 1/2.
  [[nodiscard]] double inflation_at(std::size_t level, std::size_t fraction) const noexcept {
    const double folded = std::abs(static_cast<double>(fraction) / kFractions - 0.5);  // 0 at 1/2
    const double at = std::clamp((0.5 - folded) * 8.0 - 0.5, 0.0, static_cast<double>(kInflationFractions - 1));
    const auto low = std::min(static_cast<std::size_t>(at), kInflationFractions - 2);
    const double part = at - static_cast<double>(low);
    return (1.0 - part) * inflation[level][low] + part * inflation[level][low + 1];
  }
};

BoundaryEstimator::BoundaryEstimator(const Numerology& numerology, int symbols, int oversampling,
                                     const BoundaryOptions& options)
    : options_(options), correlator_(numerology, symbols, oversampling), offset_(0.5 * (1 - oversampling)) {
  require(options.method == BoundaryMethod::kNearestSample || options.method == BoundaryMethod::kMagnitude ||
              options.method == BoundaryMethod::kMaximumLikelihood || options.method == BoundaryMethod::kInterpolated,
          "method", static_cast<int>(options.method), "it must be one of BoundaryMethod");
  if (options.snr_db) {
    require_snr(*options.snr_db);
    known_rho_ = share_of(*options.snr_db);
  }
  if (options.method == BoundaryMethod::kInterpolated) {
    require(oversampling == 1, "oversampling", oversampling, "it must be 1 for interpolated boundaries");
    require(numerology.symbol_samples() <= kMaxPeriod, "subcarriers + prefix", numerology.symbol_samples(),
            "it must be at most 256 for interpolated boundaries");
    tables_ = std::make_unique<Tables>(numerology, static_cast<double>(symbols));
  }
}

BoundaryEstimator::~BoundaryEstimator() = default;
BoundaryEstimator::BoundaryEstimator(BoundaryEstimator&&) noexcept = default;
BoundaryEstimator& BoundaryEstimator::operator=(BoundaryEstimator&&) noexcept = default;

Boundary BoundaryEstimator::estimate(IqSpan iq) noexcept {
  Boundary out;
  out.status = correlator_.fold(iq, true);
  if (out.status != BoundaryStatus::kOk) return out;
  const auto gamma = correlator_.gamma();
  const auto energies = correlator_.energies();
  std::size_t top = 0;
  const bool magnitude = options_.method != BoundaryMethod::kNearestSample;
  double best = -std::numeric_limits<double>::infinity();
  for (std::size_t m = 0; m < gamma.size(); ++m) {
    const double value = magnitude ? std::norm(gamma[m]) : gamma[m].real();
    if (value > best) {
      best = value;
      top = m;
    }
  }
  const auto energy_of = [&](std::size_t m) {  // 2 Phi(m)
    double sum = 0.0;
    for (std::size_t i = m; i < m + correlator_.window(); ++i) sum += energies[i];
    return sum;
  };
  if (magnitude && options_.method != BoundaryMethod::kMagnitude) {
    const double rho = known_rho_ > 0.0 ? known_rho_ : 2.0 * std::abs(gamma[top]) / energy_of(top);
    best = -std::numeric_limits<double>::infinity();
    double energy = energy_of(0);
    for (std::size_t m = 0; m < gamma.size(); ++m) {
      const double value = std::abs(gamma[m]) - 0.5 * rho * energy;
      if (value > best) {
        best = value;
        top = m;
      }
      if (m + 1 < gamma.size()) energy += energies[m + correlator_.window()] - energies[m];
    }
  }
  const double energy = energy_of(top);
  phase_ = std::arg(gamma[top]);
  out = whole(top, phase_, energy > 0.0 ? 2.0 * std::abs(gamma[top]) / energy : 0.0);
  if (tables_) interpolate(top, phase_, out);
  const double sample_m = kSpeedOfLightMps / correlator_.sample_rate_hz();
  out.boundary_m = wrapped((out.boundary_samples - offset_) * sample_m, correlator_.numerology().ambiguity_m());
  out.sigma_m = out.sigma_samples * sample_m;
  return out;
}

Boundary BoundaryEstimator::whole(std::size_t top, double phase, double metric) const noexcept {
  Boundary out;
  out.status = BoundaryStatus::kOk;
  out.boundary_samples = static_cast<double>(top);
  out.cfo_hz = -phase * correlator_.sample_rate_hz() / (kTwoPi * static_cast<double>(correlator_.lag()));
  out.metric = std::min(metric, 1.0);
  const double rho = known_rho_ > 0.0 ? known_rho_ : std::clamp(out.metric, 1e-6, 1.0 - 1e-10);
  out.snr_db = snr_db_of(rho);
  const auto symbols = static_cast<double>(correlator_.symbols());
  const auto period = static_cast<double>(correlator_.period());
  const auto window = static_cast<double>(correlator_.window());
  // Quantisation, then noise: at critical sampling the top of a random walk beside two slopes (doc/ofdm.md eq. 5);
  // between the samples of an oversampled signal the top is round (Chernoff's law), and the signal's own shape moves it
  // as much again as quantisation does (measured).
  double variance = 1.0 / 12.0;
  if (correlator_.oversampling() == 1) {
    const double walk = (1.0 + 0.5 * rho * rho) / (rho * rho * symbols);
    variance += 1.625 * walk * walk;
  } else {
    const double bend = 0.5 * kPi * rho * symbols / correlator_.oversampling();
    variance += 1.0 / 12.0 + 0.263 * std::pow(symbols * (1.0 - rho * rho) / (bend * bend), 2.0 / 3.0);
  }
  variance += variance_of_wrong_tops(rho, symbols * window, period, window);
  out.sigma_samples = std::sqrt(std::min(variance, period * period / 12.0));
  return out;
}

void BoundaryEstimator::interpolate(std::size_t top, double phase, Boundary& out) noexcept {
  Tables& t = *tables_;
  const std::size_t period = t.period;
  const auto products = correlator_.products();
  const auto energies = correlator_.energies();
  const double scale = 1.0 / correlator_.mean_power();
  const double cos_phase = std::cos(phase) * scale, sin_phase = std::sin(phase) * scale;
  // From a period before the top to one after, so that a window may start on either side of it.
  for (std::size_t i = 0, from = top; i < period; ++i, from = from + 1 < period ? from + 1 : 0) {
    const double f = products[from].real() * cos_phase + products[from].imag() * sin_phase;
    t.apart[i] = static_cast<float>(energies[from] * scale - 2.0 * f);
    t.cross[i] = static_cast<float>(f);
  }
  for (std::size_t i = period; i < t.apart.size(); ++i) {
    t.apart[i] = t.apart[i - period];
    t.cross[i] = t.cross[i - period];
  }
  double product = 0.0, difference = 0.0;
  for (std::size_t i = t.inner_begin; i < t.inner_end; ++i) {
    product += static_cast<double>(t.cross[i]);
    difference += static_cast<double>(t.apart[i]);
  }
  const double share = 2.0 * product / (difference + 2.0 * product);  // rho b, over the inner window
  const auto rho_at = [&](std::size_t fraction) {
    return known_rho_ > 0.0 ? std::clamp(known_rho_, kMinRho, kMaxRho)
                            : std::clamp(share / t.inner_correlation[fraction], kMinRho, kMaxRho);
  };
  // Coarse, with the noise not below 20 dB so that no peak hides between two fractions.
  const int reach = share < kWideBelowRho ? 3 : 1;
  for (std::size_t c = 0; c < kCoarse; ++c) {
    t.prepare(c, c * kCoarseStep, std::min(rho_at(c * kCoarseStep), kSmoothRho));
  }
  const int first = -reach * kFractions;
  const int count = (2 * reach + 1) * kCoarse;
  double coarse_best = -std::numeric_limits<double>::infinity();
  int best_at = 0;
  for (int n = 0; n < count; ++n) {
    const double value = t.likelihood(static_cast<std::size_t>(n % kCoarse), n / kCoarse - reach);
    t.log_likelihood[static_cast<std::size_t>(n)] = value;
    if (value > coarse_best) {
      coarse_best = value;
      best_at = first + n * kCoarseStep;
    }
  }
  // Finer about the best, at the noise as it is.
  const auto at_fraction = [&](int at) {
    const int shifted = at + 4 * kFractions;
    const auto fraction = static_cast<std::size_t>(shifted % kFractions);
    t.prepare(0, fraction, rho_at(fraction));
    return t.likelihood(0, shifted / kFractions - 4);
  };
  constexpr int kHalf = 3;
  std::array<double, 2 * kHalf + 1> around{}, about_coarse{};
  const int coarse_at = best_at;
  std::size_t peak = 0;
  const bool clean = rho_at(static_cast<std::size_t>((best_at + 4 * kFractions) % kFractions)) > kSmoothRho;
  for (const int step : {kCoarseStep, 1}) {
    if (step > 1 && !clean) continue;  // the coarse round saw the noise as it is
    about_coarse = around;             // what the last round leaves here is the first one's
    peak = 0;
    for (std::size_t i = 0; i < around.size(); ++i) {
      around[i] = at_fraction(best_at + step * (static_cast<int>(i) - kHalf));
      if (around[i] > around[peak]) peak = i;
    }
    best_at += step * (static_cast<int>(peak) - kHalf);
  }
  double at = best_at;
  if (peak > 0 && peak + 1 < around.size()) {
    const double left = around[peak - 1], mid = around[peak], right = around[peak + 1];
    const double bend = 2.0 * mid - left - right;
    if (bend > 0.0) at += 0.5 * (right - left) / bend;
  }
  const auto nearest = static_cast<std::size_t>((static_cast<int>(std::lround(at)) + 4 * kFractions) % kFractions);
  const double rho = rho_at(nearest);
  const std::size_t level = t.level_of(rho);
  const double inflation = t.inflation_at(level, nearest);
  // The likelihood's spread over its coarse grid, or, where that one was smoothed, over the one about its top.
  double weight_sum = 0.0, square_sum = 0.0;
  const auto add_weight = [&](double below, double away) {
    if (below > 20.0 * inflation) return;
    const double weight = std::exp(-below / inflation);
    weight_sum += weight;
    square_sum += weight * away * away;
  };
  if (clean) {
    const double most = *std::max_element(about_coarse.begin(), about_coarse.end());
    for (std::size_t i = 0; i < about_coarse.size(); ++i) {
      add_weight(most - about_coarse[i], coarse_at + kCoarseStep * (static_cast<double>(i) - kHalf) - at);
    }
  } else {
    for (int n = 0; n < count; ++n) {
      add_weight(coarse_best - t.log_likelihood[static_cast<std::size_t>(n)], first + n * kCoarseStep - at);
    }
  }
  const double spread = square_sum / weight_sum / (kFractions * kFractions);
  const double local = inflation / (t.symbols * t.information[level * kFractions + nearest]);
  const double grid = static_cast<double>(kCoarseStep) / kFractions;
  const auto window = static_cast<double>(correlator_.window());
  const auto length = static_cast<double>(period);
  // The spread where the grid resolves it, the curvature where it does not.
  const double variance =
      std::max(spread, std::min(local, grid * grid)) + variance_of_wrong_tops(rho, t.symbols * window, length, window);
  out.boundary_samples = wrapped(static_cast<double>(top) + at / kFractions, length);
  out.sigma_samples = std::sqrt(std::min(variance, length * length / 12.0));
  out.snr_db = snr_db_of(rho);
}

void BoundaryEstimator::folded_differences(std::span<double> out) const {
  require(out.size() == correlator_.period(), "out.size()", out.size(), "it must be the symbol's length in samples");
  const auto products = correlator_.products();
  const auto energies = correlator_.energies();
  const double power = correlator_.mean_power();
  const double scale = power > 0.0 ? 1.0 / power : 0.0;
  const double cos_phase = std::cos(phase_), sin_phase = std::sin(phase_);
  for (std::size_t i = 0; i < out.size(); ++i) {
    out[i] = (energies[i] - 2.0 * (products[i].real() * cos_phase + products[i].imag() * sin_phase)) * scale;
  }
}

double delay_crlb_samples(double snr_db, int symbols, const Numerology& numerology, std::optional<double> fraction) {
  check(numerology);
  require_snr(snr_db);
  require(symbols >= 1, "symbols", symbols, "it must be at least 1");
  if (fraction) require(std::isfinite(*fraction), "fraction", *fraction, "it must be finite");
  const double rho = share_of(snr_db);
  double information = 0.0;
  if (fraction) {
    information = pair_information(numerology, *fraction - std::floor(*fraction), rho);
  } else {
    constexpr int kMean = 64;
    for (int f = 0; f < kMean; ++f) information += pair_information(numerology, (f + 0.5) / kMean, rho) / kMean;
  }
  return 1.0 / std::sqrt(symbols * information);
}

double delay_crlb_m(double snr_db, int symbols, const Numerology& numerology, std::optional<double> fraction) {
  return delay_crlb_samples(snr_db, symbols, numerology, fraction) * numerology.sample_m();
}

}  // namespace soopnav::ofdm
