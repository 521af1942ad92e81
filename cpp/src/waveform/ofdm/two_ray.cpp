#include "soopnav/waveform/ofdm/two_ray.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "soopnav/core/constants.hpp"
#include "waveform/ofdm/kernels.hpp"
#include "waveform/ofdm/profile.hpp"
#include "waveform/ofdm/require.hpp"

namespace soopnav::ofdm {
namespace {

constexpr int kSteps = 16;  // positions per sample
constexpr int kMaxPeriod = 256;
constexpr int kMaxSymbols = 1 << 20;
constexpr double kMaxReach = 8.0;
// A^2 / (1 + A^2) for A^2 = 1/8 .. 6.
constexpr std::array kShares{0.111, 0.25, 0.4, 0.5, 0.6, 0.7, 0.857};
// What the spread of the likelihood is too narrow by: pairs are dependent, and the template leaves the rays' cross-term
// out (doc/ofdm.md, after eq. 17; measured over reflections of strength 1 to 1.5 and of any phase).
constexpr double kFlattening = 2.0;
constexpr double kWantedRatio = 50.0;

}  // namespace

TwoRayTiming::TwoRayTiming(const Numerology& numerology, int symbols, const TwoRayOptions& options)
    : numerology_(numerology), symbols_(symbols), options_(options) {
  check(numerology);
  require(symbols >= 1 && symbols <= kMaxSymbols, "symbols", symbols, "it must be 1 to 1048576");
  require(numerology.symbol_samples() <= kMaxPeriod, "subcarriers + prefix", numerology.symbol_samples(),
          "it must be at most 256 for two-ray timing");
  require(options.reach_samples >= 0.25 && options.reach_samples <= kMaxReach, "reach_samples", options.reach_samples,
          "it must lie between 0.25 and 8");
  require(options.snr_db >= 0.0 && options.snr_db <= 40.0, "snr_db", options.snr_db, "it must lie between 0 and 40");
  require(std::isfinite(options.sigma_floor_m) && options.sigma_floor_m >= 0.0, "sigma_floor_m", options.sigma_floor_m,
          "it must be finite and not negative");
  period_ = static_cast<std::size_t>(numerology.symbol_samples());
  const double ratio = std::pow(10.0, 0.1 * options.snr_db);
  const double rho = ratio / (1.0 + ratio);
  floor_ = static_cast<float>(2.0 * (1.0 - rho));
  gap_.resize(kSteps * 2 * period_);
  for (std::size_t f = 0; f < kSteps; ++f) {
    for (std::size_t i = 0; i < period_; ++i) {
      const double b = prefix_correlation(numerology, static_cast<double>(i) - static_cast<double>(f) / kSteps);
      const auto gap = static_cast<float>(2.0 * rho * (1.0 - b));
      gap_[f * 2 * period_ + i] = gap;
      gap_[f * 2 * period_ + period_ + i] = gap;
    }
  }
  e_.resize(period_);
  window_.resize(period_);
  cross_.resize(period_);
  mixed_.resize(period_);
  const std::size_t points = 2 * period_ * kSteps;
  sine_.resize(points);
  cotangent_.resize(points);
  const auto length = static_cast<double>(period_);
  for (std::size_t t = 0; t < points; ++t) {
    const double at = static_cast<double>(t) / kSteps;
    sine_[t] = t % kSteps == 0 ? 0.0 : std::sin(kPi * at);
    if (t % (period_ * kSteps) == 0) {
      cotangent_[t] = length * std::cos(kPi * at);  // the limit
    } else {
      cotangent_[t] = sine_[t] / std::tan(kPi * at / length);
    }
  }
}

const float* TwoRayTiming::row(int sixteenths) const noexcept {
  const auto length = static_cast<int>(period_) * kSteps;
  const int at = ((sixteenths % length) + length) % length;
  return &gap_[static_cast<std::size_t>(at % kSteps) * 2 * period_ + period_ - static_cast<std::size_t>(at / kSteps)];
}

double TwoRayTiming::cost(int delta, int tau, double share) const noexcept {
  return symbols_ * kernels::mixture_cost(e_.data(), row(delta), row(tau), floor_, static_cast<float>(share), period_);
}

// The rays' cross-term (eq. 16): x(i) = sum over the prefix of sum_k sinc(u - k M) sinc(u' - k M), u = i - p - delta
// and u' = i - p - tau, the sum over k in closed form and the one over p a running sum.
void TwoRayTiming::set_cross(int delta, int tau) noexcept {
  if (delta == cross_delta_ && tau == cross_tau_) return;
  cross_delta_ = delta;
  cross_tau_ = tau;
  const auto period = static_cast<int>(period_);
  const int points = 2 * period * kSteps;
  const auto prefix = numerology_.prefix;
  const double apart = static_cast<double>(delta - tau) / kSteps;  // u' - u
  rays_sinc_ = delta == tau ? 1.0 : std::sin(kPi * apart) / (kPi * apart);
  const double scale = delta == tau ? 0.0 : 1.0 / (kPi * period * apart);
  const auto start = [points](int ray) { return (((-ray) % points) + points) % points; };
  const int from_delta = start(delta), from_tau = start(tau);
  const auto pair = [&](int n) {  // n in -M .. M
    const auto u = static_cast<std::size_t>((from_delta + n * kSteps + points) % points);
    const auto v = static_cast<std::size_t>((from_tau + n * kSteps + points) % points);
    return (sine_[v] * cotangent_[u] - sine_[u] * cotangent_[v]) * scale;
  };
  double sum = 0.0;
  for (int p = 0; p < prefix; ++p) sum += pair(-p);
  for (int i = 0; i < period; ++i) {
    cross_[static_cast<std::size_t>(i)] = rays_sinc_ - sum;
    sum += pair(i + 1) - pair(i + 1 - prefix);
  }
}

double TwoRayTiming::cost(int delta, int tau, double share, double cos_phase) noexcept {
  if (delta == tau) return cost(delta, tau, share);
  set_cross(delta, tau);
  const double q = 2.0 * std::sqrt(share * (1.0 - share)) * cos_phase;
  const double scale = 1.0 / (1.0 + q * rays_sinc_);
  const double gap_scale = 2.0 - static_cast<double>(floor_);  // 2 rho
  const float* const a = row(delta);
  const float* const b = row(tau);
  for (std::size_t i = 0; i < period_; ++i) {
    const auto own = static_cast<double>(a[i]), other = static_cast<double>(b[i]);
    const double gap = (own + share * (other - own) + gap_scale * q * cross_[i]) * scale;
    mixed_[i] = static_cast<float>(std::max(0.0, gap));
  }
  return symbols_ * kernels::mixture_cost(e_.data(), mixed_.data(), mixed_.data(), floor_, 0.0F, period_);
}

TwoRayBoundary TwoRayTiming::estimate(std::span<const double> folded, double predicted_m, double sigma_m) noexcept {
  TwoRayBoundary out;
  if (folded.size() != period_) {
    out.status = BoundaryStatus::kTooShort;
    return out;
  }
  double total = 0.0;
  bool fit = std::isfinite(predicted_m) && std::abs(predicted_m) < 1e9 && sigma_m >= 0.0;
  for (std::size_t i = 0; i < period_; ++i) {
    fit = fit && folded[i] >= -1e-6 * symbols_ && folded[i] < 1e3 * symbols_;
    e_[i] = static_cast<float>(std::max(0.0, folded[i]) / symbols_);
    total += folded[i];
  }
  if (!fit) {
    out.status = BoundaryStatus::kNonFinite;
    return out;
  }
  if (!(total > 0.0)) {
    out.status = BoundaryStatus::kNoSignal;
    return out;
  }
  const auto period = static_cast<int>(period_);
  const int length = period * kSteps;
  const int prefix = numerology_.prefix;
  const double sample_m = numerology_.sample_m();
  const auto predicted = static_cast<int>(std::lround(std::remainder(predicted_m / sample_m, period) * kSteps));
  const int reach = static_cast<int>(
      std::ceil(kSteps * std::min(kMaxReach, std::max(options_.reach_samples, 3.0 * sigma_m / sample_m))));
  const auto away = [length](int a, int b) {  // shortest way round
    const int d = (((a - b) % length) + length) % length;
    return d <= length / 2 ? d : d - length;
  };

  // Where the second ray may be: the correlator's top, and its top once a ray there, or one as predicted, is taken out.
  const auto at = [period](int i) { return static_cast<std::size_t>(((i % period) + period) % period); };
  for (int m = 0; m < period; ++m) {
    double sum = 0.0;
    for (int i = m; i < m + prefix; ++i) sum += 1.0 - 0.5 * static_cast<double>(e_[at(i)]);
    window_[static_cast<std::size_t>(m)] = sum;
  }
  const auto top_beside = [&](int ray, double height) {
    int best = 0;
    double value = -std::numeric_limits<double>::infinity();
    for (int m = 0; m < period; ++m) {
      const double distance = std::abs(away(m * kSteps, ray)) / static_cast<double>(kSteps * prefix);
      const double left = window_[static_cast<std::size_t>(m)] - height * std::max(0.0, 1.0 - distance);
      if (left > value) {
        value = left;
        best = m;
      }
    }
    return best * kSteps;
  };
  const int top = top_beside(0, 0.0);
  const auto height_at = [&](int ray) { return window_[at(static_cast<int>(std::lround(ray / double(kSteps))))]; };
  const std::array candidates{top, top_beside(top, height_at(top)), top_beside(predicted, height_at(predicted))};

  // One ray: near the prediction, and anywhere.
  double single = std::numeric_limits<double>::infinity();
  int single_at = predicted;
  const auto try_single = [&](int delta) {
    const double c = cost(delta, delta, 0.0);
    if (c < single) {
      single = c;
      single_at = delta;
    }
  };
  for (int d = -reach; d <= reach; ++d) try_single(predicted + d);
  for (int d = -kSteps; d <= kSteps; ++d) try_single(top + d);

  // Two rays: coarse over all three, then each in turn.
  double best = std::numeric_limits<double>::infinity();
  int delta = predicted, tau = top;
  double share = 0.0;
  const auto try_two = [&](int d, int t, double w) {
    const double c = cost(d, t, w);
    if (c < best) {
      best = c;
      delta = d;
      tau = t;
      share = w;
    }
  };
  for (std::size_t n = 0; n < candidates.size(); ++n) {
    if (n > 0 && std::find(candidates.begin(), candidates.begin() + static_cast<std::ptrdiff_t>(n), candidates[n]) !=
                     candidates.begin() + static_cast<std::ptrdiff_t>(n)) {
      continue;
    }
    for (int d = -reach; d <= reach; d += kSteps / 4) {
      for (int t = -2 * kSteps; t <= 2 * kSteps; t += kSteps / 2) {
        for (const double w : kShares) try_two(predicted + d, candidates[n] + t, w);
      }
    }
  }
  double cos_phase = 0.0;
  const auto refine = [&](int d, int t, double w, double c) {
    const double value = cost(d, t, w, c);
    if (value >= best) return;
    best = value;
    delta = d;
    tau = t;
    share = w;
    cos_phase = c;
  };
  for (int round = 0; round < 4; ++round) {
    const int span = round < 2 ? kSteps / 2 : kSteps / 8;
    for (const double c : {-0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9}) refine(delta, tau, share, c);
    const int d0 = delta;
    for (int d = -span; d <= span; d += round < 2 ? 2 : 1) {
      if (std::abs(d0 + d - predicted) <= reach) refine(d0 + d, tau, share, cos_phase);
    }
    const int t0 = tau;
    for (int t = -span; t <= span; t += round < 2 ? 2 : 1) refine(delta, t0 + t, share, cos_phase);
    const double w0 = share;
    for (int w = -4; w <= 4; ++w) refine(delta, tau, std::clamp(w0 + 0.02 * w, 0.02, 0.98), cos_phase);
  }

  out.likelihood_ratio = (single - best) / kFlattening;
  out.two_rays = out.likelihood_ratio > kWantedRatio;
  const bool near_prediction = std::abs(away(single_at, predicted)) <= reach;
  if (!out.two_rays && !near_prediction) return out;

  // The spread over delta, the others profiled.
  const double least = out.two_rays ? best : single;
  double weights = 0.0, first = 0.0, second = 0.0;
  for (int d = -reach; d <= reach; ++d) {
    double c = std::numeric_limits<double>::infinity();
    if (out.two_rays) {
      if ((d + reach) % 2 != 0) continue;
      int t = tau;
      double w = share, phase = cos_phase;
      const auto settle = [&](int t1, double w1, double phase1) {
        const double value = cost(predicted + d, t1, w1, phase1);
        if (value >= c) return;
        c = value;
        t = t1;
        w = w1;
        phase = phase1;
      };
      for (const double p : {-0.9, -0.45, 0.0, 0.45, 0.9}) settle(t, w, p);
      for (const int step : {-2, 0, 2}) settle(tau + step, w, phase);
      for (const double step : {-0.06, -0.03, 0.03, 0.06}) settle(t, std::clamp(share + step, 0.02, 0.98), phase);
      for (const double step : {-0.2, 0.2}) settle(t, w, std::clamp(phase + step, -1.0, 1.0));
    } else {
      c = cost(predicted + d, predicted + d, 0.0);
    }
    const double weight = std::exp(std::max(-700.0, (least - c) / kFlattening));
    weights += weight;
    first += weight * d;
    second += weight * d * d;
  }
  const double mean = first / weights;
  const double variance = std::max(0.0, second / weights - mean * mean) / (kSteps * kSteps);
  const double grid = 1.0 / (12.0 * kSteps * kSteps);
  out.status = BoundaryStatus::kOk;
  const double middle = std::round((predicted_m / sample_m - predicted / double(kSteps)) / period) * period;
  out.range_m = (middle + (predicted + mean) / kSteps) * sample_m;
  out.sigma_m = std::sqrt(variance + grid) * sample_m;
  if (out.two_rays) {
    out.sigma_m = std::hypot(out.sigma_m, options_.sigma_floor_m);
    // With both rays inside the reach, either may be the line of sight.
    const double rays_m = away(tau, predicted + static_cast<int>(std::lround(mean))) * sample_m / kSteps;
    if (std::abs(away(tau, predicted)) <= reach) out.sigma_m = std::hypot(out.sigma_m, rays_m);
    const double extra = (tau - (predicted + mean)) / kSteps * sample_m;
    const double ambiguity = numerology_.ambiguity_m();
    out.extra_m = extra - ambiguity * std::floor(extra / ambiguity);
    out.strength = std::sqrt(share / (1.0 - share));
  }
  return out;
}

}  // namespace soopnav::ofdm
