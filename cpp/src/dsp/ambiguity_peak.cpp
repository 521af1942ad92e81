#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "dsp/ambiguity_kernels.hpp"
#include "dsp/ambiguity_stage.hpp"

namespace soopnav::dsp::detail {
namespace {

using Cf64 = std::complex<double>;

constexpr double kPi = std::numbers::pi;
constexpr double kTwoPi = 2.0 * std::numbers::pi;
constexpr double kUsed = 0.575;
constexpr double kStencil = 0.05;  // samples between the points a derivative is made of
constexpr int kClimbs = 12;
// What a post-correlation SNR must reach for the data's own shape of the burst to count as much as the plain one.
constexpr double kShapeSnr = 20.0;
// The same, per band, for the spectrum's own shape against a raised cosine.
constexpr double kBandSnr = 30.0;
// Growth of the variances over eq. 8 near the threshold, per post-correlation SNR (doc/ambiguity.md eq. 10).
constexpr double kDelayGrowth = 12.0;       // the signal's spectrum fitted,
constexpr double kDelayGrowthStated = 3.0;  // or stated
constexpr double kDopplerGrowth = 7.0;
constexpr double kConcentrated = 0.85;  // of the cross-spectrum's power in a few cells or two bands
constexpr double kLineCells = 4.0;      // 1 / duration to either side of a line
constexpr double kNarrow = 0.2;         // of the band: two of the spectrum's bands below this resolve it

Cf64 product(Cf64 a, Cf64 b) {
  return {a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real()};
}
double real_product(Cf64 a, Cf64 b) { return a.real() * b.real() + a.imag() * b.imag(); }  // Re(conj(a) b)

double wrapped(double phase) { return std::remainder(phase, kTwoPi); }

double decibels(double ratio) { return 10.0 * std::log10(std::max(ratio, 1e-30)); }

// Solves H x = -g by LDL^T over the first n unknowns; false when H is not negative definite.
bool uphill(const std::array<std::array<double, 3>, 3>& h, const std::array<double, 3>& g, std::size_t n,
            std::array<double, 3>& x) {
  std::array<std::array<double, 3>, 3> l{};
  std::array<double, 3> d{};
  for (std::size_t j = 0; j < n; ++j) {
    d[j] = -h[j][j];
    for (std::size_t k = 0; k < j; ++k) d[j] -= l[j][k] * l[j][k] * d[k];
    if (!(d[j] > -1e-9 * h[j][j]) || !(d[j] > 0.0)) return false;
    for (std::size_t i = j + 1; i < n; ++i) {
      double sum = -h[i][j];
      for (std::size_t k = 0; k < j; ++k) sum -= l[i][k] * l[j][k] * d[k];
      l[i][j] = sum / d[j];
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    x[i] = g[i];
    for (std::size_t k = 0; k < i; ++k) x[i] -= l[i][k] * x[k];
  }
  for (std::size_t i = n; i-- > 0;) {
    x[i] /= d[i];
    for (std::size_t k = i + 1; k < n; ++k) x[i] -= l[k][i] * x[k];
  }
  return true;
}

}  // namespace

double AmbiguityStage::raised_cosine(double f, const Shape& shape) noexcept {
  const double beyond = std::abs(f) - 0.5 * (1.0 - shape.rolloff) * shape.width;
  if (beyond <= 0.0) return 1.0;
  const double x = beyond / (shape.rolloff * shape.width);
  return x < 1.0 ? 0.5 * (1.0 + std::cos(kPi * x)) : 0.0;
}

// Spectra that the cross-spectrum is compared with: the stated one, or raised cosines within the occupied band.
void AmbiguityStage::make_templates() noexcept {
  std::size_t n = 0;
  if (options_.symbol_rate_hz > 0.0) {
    shapes_[n++] = {options_.symbol_rate_hz / rate_hz_, options_.rolloff};
  } else {
    for (const double width : {0.5, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.0}) {
      for (const double rolloff : {0.0, 0.25, 0.5}) shapes_[n++] = {width * bandwidth_hz_ / rate_hz_, rolloff};
    }
  }
  for (std::size_t t = 0; t < n; ++t) {
    for (std::size_t j = 0; j < kBands; ++j) {
      templates_[t * kBands + j] = raised_cosine((static_cast<double>(j) + 0.5) / kBands - 0.5, shapes_[t]);
    }
  }
}

// r_l[m] = sum over block m of a[n + l] conj(b[n] exp(j 2 pi f n)).
void AmbiguityStage::tabulate(std::ptrdiff_t lag, double doppler_hz) noexcept {
  table_lag_ = lag;
  table_doppler_hz_ = doppler_hz;
  const std::size_t total = blocks_ * block_;
  const double cycles = doppler_hz / inner_hz_;
  const Cf64 step = std::polar(1.0, kTwoPi * cycles);
  Cf64 turn{1.0, 0.0};
  // b turned, and the same with real and imaginary parts exchanged: two real products make a complex one.
  Cf32* turned = product_.data();
  for (std::size_t i = 0; i < total; ++i) {
    if (doppler_hz == 0.0) {
      turned[i] = b_[i];
      swapped_[i] = {b_[i].imag(), b_[i].real()};
      continue;
    }
    if (i % 64 == 0) turn = std::polar(1.0, kTwoPi * std::remainder(cycles * static_cast<double>(i), 1.0));
    const Cf64 x = product({static_cast<double>(b_[i].real()), static_cast<double>(b_[i].imag())}, turn);
    turned[i] = {static_cast<float>(x.real()), static_cast<float>(x.imag())};
    swapped_[i] = {static_cast<float>(x.imag()), static_cast<float>(x.real())};
    turn = product(turn, step);
  }
  const Cf32* a = a_.data() + static_cast<std::ptrdiff_t>(margin_) + lag - kReach;
  for (std::size_t m = 0; m < blocks_; ++m) {
    std::array<Cf32, kLags> row;
    correlate_lags(a + m * block_, turned + m * block_, swapped_.data() + m * block_, block_, kLags, row.data());
    for (std::size_t l = 0; l < kLags; ++l) {
      table_[m * kLags + l] = {static_cast<double>(row[l].real()), static_cast<double>(row[l].imag())};
    }
  }
  double weight = 0.0, mean = 0.0;
  const auto shift = static_cast<std::ptrdiff_t>(std::lround(static_cast<double>(lag) / static_cast<double>(block_)));
  for (std::size_t m = 0; m < blocks_; ++m) {
    const auto j = static_cast<std::ptrdiff_t>(m) + shift;
    if (j < 0 || j >= static_cast<std::ptrdiff_t>(blocks_)) continue;
    const double e = std::sqrt(energy_a_[static_cast<std::size_t>(j)] * energy_b_[m]);
    weight += e;
    mean += e * (static_cast<double>(m) + 0.5) * static_cast<double>(block_);
  }
  epoch_ = (weight > 0.0 ? mean / weight : 0.5 * static_cast<double>(total)) - 0.5;
}

// Newton's method on |C(lag, doppler, rate)|^2, C interpolated between the lags of the table.
void AmbiguityStage::climb(StagePeak& peak, bool with_rate) noexcept {
  const double start_lag = peak.lag, start_doppler = peak.doppler_hz;
  const double length = std::max(1.0, static_cast<double>(n_ * up_));  // unit of rate: samples per snippet
  const double unit_hz = inner_hz_ / length;                           // and of Doppler
  const std::size_t unknowns = with_rate ? 3 : 2;
  tabulate(std::lround(peak.lag), peak.doppler_hz);

  struct Local {
    Cf64 value;
    std::array<Cf64, 3> first;                  // lag, doppler, rate
    std::array<std::array<Cf64, 3>, 3> second;  // upper triangle
  };
  const auto evaluate = [&](const StagePeak& at) {
    std::array<std::array<double, kLags>, 4> taps{};
    for (std::size_t l = 0; l < kLags; ++l) {
      const double t = at.lag - static_cast<double>(table_lag_ + static_cast<std::ptrdiff_t>(l) - kReach);
      const double y0 = kernel_(t - 2.0 * kStencil), y1 = kernel_(t - kStencil), y2 = kernel_(t),
                   y3 = kernel_(t + kStencil), y4 = kernel_(t + 2.0 * kStencil);
      taps[0][l] = y2;
      taps[1][l] = (y0 - 8.0 * y1 + 8.0 * y3 - y4) / (12.0 * kStencil);
      taps[2][l] = (-y0 + 16.0 * y1 - 30.0 * y2 + 16.0 * y3 - y4) / (12.0 * kStencil * kStencil);
      taps[3][l] = (-y0 + 2.0 * y1 - 2.0 * y3 + y4) / (2.0 * kStencil * kStencil * kStencil);
    }
    Local local{};
    for (std::size_t m = 0; m < blocks_; ++m) {
      std::array<Cf64, 4> p{};
      for (std::size_t l = 0; l < kLags; ++l) {
        const Cf64 r = table_[m * kLags + l];
        for (std::size_t d = 0; d < 4; ++d) p[d] += r * taps[d][l];
      }
      const double t = (static_cast<double>(m) + 0.5) * static_cast<double>(block_) - 0.5 - epoch_;  // samples
      const double shift = at.rate * t;
      if (shift != 0.0) {
        p[0] += shift * (p[1] + 0.5 * shift * (p[2] + shift / 3.0 * p[3]));
        p[1] += shift * (p[2] + 0.5 * shift * p[3]);
        p[2] += shift * p[3];
      }
      const double seconds = t / inner_hz_;
      const Cf64 turn = std::polar(1.0, -kTwoPi * (at.doppler_hz - table_doppler_hz_) * seconds);
      for (std::size_t d = 0; d < 3; ++d) p[d] = product(p[d], turn);
      const Cf64 by_doppler{0.0, -kTwoPi * seconds * unit_hz};
      const double by_rate = t / length;
      local.value += p[0];
      local.first[0] += p[1];
      local.first[1] += product(by_doppler, p[0]);
      local.first[2] += by_rate * p[1];
      local.second[0][0] += p[2];
      local.second[0][1] += product(by_doppler, p[1]);
      local.second[1][1] += product(product(by_doppler, by_doppler), p[0]);
      local.second[0][2] += by_rate * p[2];
      local.second[1][2] += product(by_doppler, by_rate * p[1]);
      local.second[2][2] += by_rate * by_rate * p[2];
    }
    return local;
  };

  StagePeak at = peak;
  std::array<std::array<double, 3>, 3> hessian{};
  for (int pass = 0; pass < kClimbs; ++pass) {
    const Local local = evaluate(at);
    at.value = local.value;
    std::array<double, 3> gradient{};
    for (std::size_t i = 0; i < 3; ++i) {
      gradient[i] = 2.0 * real_product(local.value, local.first[i]);
      for (std::size_t j = i; j < 3; ++j) {
        hessian[i][j] = hessian[j][i] =
            2.0 * (real_product(local.first[i], local.first[j]) + real_product(local.value, local.second[i][j]));
      }
    }
    std::array<double, 3> step{};
    if (!uphill(hessian, gradient, unknowns, step)) {
      for (std::size_t i = 0; i < unknowns; ++i) {
        const double size = std::abs(hessian[i][i]);
        step[i] = size > 0.0 ? gradient[i] / size : 0.0;
      }
    }
    for (double& s : step) s = std::isfinite(s) ? std::clamp(s, -0.3, 0.3) : 0.0;
    if (std::abs(step[0]) + std::abs(step[1]) + std::abs(step[2]) < 3e-6) break;
    at.lag += step[0];
    at.doppler_hz += step[1] * unit_hz;
    if (with_rate) at.rate += step[2] / length;
    if (std::abs(at.lag - start_lag) > 2.0 || std::abs(at.doppler_hz - start_doppler) > 2.0 * unit_hz) {
      at = peak;  // ran off: the cell itself is all there is
      at.value = evaluate(at).value;
      break;
    }
    if (std::abs(at.lag - static_cast<double>(table_lag_)) > 1.0) tabulate(std::lround(at.lag), table_doppler_hz_);
  }
  const double power = std::max(std::norm(at.value), 1e-300);
  at.lag_curvature = -hessian[0][0] / power;
  at.doppler_curvature = -hessian[1][1] / power / (unit_hz * unit_hz);
  at.mixed_curvature = -hessian[0][1] / power / unit_hz;
  at.noise = peak.noise;
  peak = at;
}

// Whether the aligned cross-spectrum, in work_ with the phase of `sum`, is a line's: 97 % of a rectangular pulse's
// power lie within four cells of 1 / duration, but a fraction of that of anything modulated. And whether two bands hold
// it all.
void AmbiguityStage::concentration(Cf64 sum, double duration) noexcept {
  line_like_ = narrow_ = false;
  const double total = std::abs(sum);
  if (!(total > 0.0)) return;
  const std::size_t nf = bins_a_.size(), negative = (nf + 1) / 2;
  const auto width = static_cast<std::size_t>(std::ceil(2.0 * kLineCells * static_cast<double>(nf) / duration)) + 1;
  const Cf64 back = std::conj(sum) / total;
  const auto at = [&](std::size_t k) {  // in order of frequency
    const Cf32 x = work_[k < nf - negative ? k + negative : k - (nf - negative)];
    return static_cast<double>(x.real()) * back.real() - static_cast<double>(x.imag()) * back.imag();
  };
  double window = 0.0, most = 0.0;
  for (std::size_t k = 0; k < nf; ++k) {
    window += at(k);
    if (k >= width) window -= at(k - width);
    most = std::max(most, window);
  }
  line_like_ = most > kConcentrated * total;
  if (2.0 * rate_hz_ / kBands > kNarrow * bandwidth_hz_) return;
  for (std::size_t j = 0; j + 1 < kBands; ++j) {
    const double pair = cross_[j] + cross_[j + 1];
    if (pair <= kConcentrated * total) continue;
    narrow_ = true;
    narrow_center_hz_ = ((static_cast<double>(j) + 0.5 + cross_[j + 1] / pair) / kBands - 0.5) * rate_hz_;
    return;
  }
}

// Cross- and auto-spectra of the aligned recordings, by band, and the prefilter that they call for.
void AmbiguityStage::likelihood_weights(const StagePeak& peak, AmbiguityPeak& result) noexcept {
  const std::size_t nf = bins_a_.size();
  const double lag = peak.lag / static_cast<double>(up_);
  const double used = bandwidth_hz_ > 0.9 * rate_hz_ ? 0.5 : std::min(0.5, kUsed * bandwidth_hz_ / rate_hz_);
  std::array<Cf64, kBands> cross{};
  std::fill(auto_a_.begin(), auto_a_.end(), 0.0);
  std::fill(auto_b_.begin(), auto_b_.end(), 0.0);
  std::array<double, kBands> count{};
  const Cf64 step = std::polar(1.0, kTwoPi * lag / static_cast<double>(nf));
  Cf64 turn{1.0, 0.0};
  for (std::size_t k = 0; k < nf; ++k) {
    const double f = bin_frequency(k);
    if (k % 64 == 0 || 2 * k == nf || 2 * k == nf + 1) {
      turn = std::polar(1.0, kTwoPi * std::remainder(lag * f, 1.0));
    }
    if (std::abs(f) <= used) {
      const auto j = std::min(kBands - 1, static_cast<std::size_t>((f + 0.5) * kBands));
      const Cf64 a{static_cast<double>(bins_a_[k].real()), static_cast<double>(bins_a_[k].imag())};
      const Cf64 b{static_cast<double>(bins_b_[k].real()), static_cast<double>(bins_b_[k].imag())};
      const Cf64 value = product(product(a, turn), std::conj(b));
      work_[k] = {static_cast<float>(value.real()), static_cast<float>(value.imag())};
      cross[j] += value;
      auto_a_[j] += std::norm(a);
      auto_b_[j] += std::norm(b);
      count[j] += 1.0;
    } else {
      work_[k] = {};
    }
    turn = product(turn, step);
  }
  Cf64 sum{};
  double sum_a = 0.0, sum_b = 0.0, bins = 0.0;
  for (std::size_t j = 0; j < kBands; ++j) {
    sum += cross[j];
    sum_a += auto_a_[j];
    sum_b += auto_b_[j];
    bins += count[j];
  }
  const Cf64 back = std::polar(1.0, -std::arg(sum));
  for (std::size_t j = 0; j < kBands; ++j) cross_[j] = product(cross[j], back).real();
  const std::size_t overlap = std::min(last_a_, last_b_) > std::max(first_a_, first_b_)
                                  ? std::min(last_a_, last_b_) - std::max(first_a_, first_b_)
                                  : n_;
  concentration(sum, static_cast<double>(overlap));
  for (std::size_t j = 0; j < kBands; ++j) {
    const double scale = count[j] > 0.0 ? 1.0 / count[j] : 0.0;
    cross_[j] *= scale;
    auto_a_[j] *= scale;
    auto_b_[j] *= scale;
  }

  // The signal's spectrum is first taken for a raised cosine: the one that fits the cross-spectrum best, or the stated
  // one, wherever it lies. Few numbers, so that it holds at the threshold as well.
  const double share = static_cast<double>(overlap) / static_cast<double>(nf);
  double fit = -1e300, height = 0.0, middle = 0.0;
  Shape shape = shapes_.front();
  const auto reach = static_cast<std::ptrdiff_t>(std::ceil(0.15 * bandwidth_hz_ / rate_hz_ * kBands));
  for (std::size_t t = 0; t < shapes_.size(); ++t) {
    for (std::ptrdiff_t s = -reach; s <= reach; ++s) {
      double matched = 0.0, square = 0.0;
      for (std::size_t j = 0; j < kBands; ++j) {
        const auto i = static_cast<std::ptrdiff_t>(j) - s;
        if (i < 0 || i >= static_cast<std::ptrdiff_t>(kBands)) continue;
        const double value = templates_[t * kBands + static_cast<std::size_t>(i)] * count[j];
        matched += value * cross_[j];
        square += value * templates_[t * kBands + static_cast<std::size_t>(i)];
      }
      const double score = square > 0.0 ? matched / std::sqrt(square) : -1e300;
      if (score > fit) {
        fit = score;
        shape = shapes_[t];
        middle = static_cast<double>(s) / kBands;
        height = matched / square;
      }
    }
  }
  const auto model = [&](double f) { return raised_cosine(f - middle, shape); };
  const double band = std::min(shape.width * static_cast<double>(nf), bins);  // its integral, in bins
  const double amplitude = std::max(height, 0.0);                             // peak of the cross-spectrum, per bin
  const double coherent = amplitude * band;

  // Signal powers from the noise floors where they are known, else from the coherence alone.
  const auto noise_in = [&](double density, std::size_t from, std::size_t to) {
    return density * rate_hz_ * static_cast<double>(to > from ? to - from : n_);  // per bin
  };
  const double noise_a = noise_in(bands_.noise_a, first_a_, last_a_);
  const double noise_b = noise_in(bands_.noise_b, first_b_, last_b_);
  const double signal_a = sum_a - noise_a * bins, signal_b = sum_b - noise_b * bins;
  double snr_a = noise_a > 0.0 && signal_a > 0.0 ? signal_a / (noise_a * band) : 0.0;
  double snr_b = noise_b > 0.0 && signal_b > 0.0 ? signal_b / (noise_b * band) : 0.0;
  const auto other = [&](double total, double signal) {  // the side whose floor is not known
    const double shared = coherent * coherent / std::max(signal, 1e-300);
    return shared / std::max((total - shared) * band / bins, 1e-6 * total);
  };
  if (snr_a > 0.0 && snr_b <= 0.0) {
    snr_b = other(sum_b, signal_a);
  } else if (snr_b > 0.0 && snr_a <= 0.0) {
    snr_a = other(sum_a, signal_b);
  } else if (snr_a <= 0.0) {
    const double c = std::clamp(coherent / std::sqrt(std::max(sum_a * sum_b, 1e-300)), 0.0, 1.0 - 1e-6);
    snr_a = snr_b = c / (1.0 - c) * bins / band;
  }
  result.snr_a_db = decibels(snr_a);
  result.snr_b_db = decibels(snr_b);

  // The weight sqrt(g1 g2) S / (1 + (g1 + g2) S) = G / (G_aa G_bb - G^2) of the product (eq. 7): of the model, and
  // straight from the spectra of the data, which count by their own SNR per band.
  const std::array<double, 5> smoothing{1.0, 2.0, 3.0, 2.0, 1.0};
  double modelled = 0.0, seen = 0.0, powers = 0.0, level = 0.0;
  for (std::size_t j = 0; j < kBands; ++j) {
    double g = 0.0, a = 0.0, b = 0.0, total = 0.0;
    for (std::size_t s = 0; s < smoothing.size(); ++s) {
      const auto i = static_cast<std::ptrdiff_t>(j + s) - 2;
      if (i < 0 || i >= static_cast<std::ptrdiff_t>(kBands) || count[static_cast<std::size_t>(i)] == 0.0) continue;
      const auto at = static_cast<std::size_t>(i);
      g += smoothing[s] * cross_[at];
      a += smoothing[s] * auto_a_[at];
      b += smoothing[s] * auto_b_[at];
      total += smoothing[s];
    }
    g = std::max(0.0, g);
    const double squared = a * b;
    band_weight_[j] = total > 0.0 && squared > 0.0 ? total * g / std::max(squared - g * g, 1e-4 * squared) : 0.0;
    const double s = model((static_cast<double>(j) + 0.5) / kBands - 0.5);
    modelled += s / (1.0 + (snr_a + snr_b) * s);
    seen += band_weight_[j];
    powers += s * auto_a_[j] * auto_b_[j];
    level += s;
  }
  const bool stated = options_.symbol_rate_hz > 0.0;
  const double mean_bins = static_cast<double>(nf) / kBands;
  const double band_snr = powers > 0.0 ? 2.0 * amplitude * amplitude * mean_bins * share * level / powers : 0.0;
  const double trust = stated || !(seen > 0.0) ? 0.0 : band_snr / (band_snr + kBandSnr);
  const double scale = seen > 0.0 && modelled > 0.0 ? trust * modelled / seen : 0.0;
  const double half_box = bandwidth_hz_ > 0.9 * rate_hz_ ? 0.5 : 0.5 * bandwidth_hz_ / rate_hz_;
  const auto weight_of = [&](double f) {
    const double s = model(f);
    switch (options_.prefilter) {
      case AmbiguityPrefilter::kNone:
        return 1.0;
      case AmbiguityPrefilter::kBox:
        return std::abs(f - middle) <= half_box ? 1.0 : 0.0;
      case AmbiguityPrefilter::kRootRaisedCosine:
        return s;
      case AmbiguityPrefilter::kMaximumLikelihood:
        break;
    }
    const double by_model = (1.0 - trust) * s / (1.0 + (snr_a + snr_b) * s);
    if (scale == 0.0) return by_model;
    const double at = std::clamp((f + 0.5) * kBands - 0.5, 0.0, kBands - 1.0 - 1e-9);
    const auto j = static_cast<std::size_t>(at);
    const double mu = at - static_cast<double>(j);
    return by_model + scale * ((1.0 - mu) * band_weight_[j] + mu * band_weight_[j + 1]);
  };
  double largest = 0.0;
  for (std::size_t j = 0; j < kBands; ++j)
    largest = std::max(largest, weight_of((static_cast<double>(j) + 0.5) / kBands - 0.5));
  largest = std::max(largest, 1e-300);
  for (std::size_t k = 0; k < nf; ++k) {
    const double f = bin_frequency(k);
    const double w = std::abs(f) <= used ? std::min(1.0, weight_of(f) / largest) : 0.0;
    weight_[k] = static_cast<float>(std::sqrt(w) / static_cast<double>(nf));
  }
  std::array<double, kBands> weights;
  for (std::size_t j = 0; j < kBands; ++j) {
    weights[j] = count[j] > 0.0 ? weight_of((static_cast<double>(j) + 0.5) / kBands - 0.5) / largest : 0.0;
  }
  std::copy(weights.begin(), weights.end(), band_weight_.begin());
  // Number of bins, as the covariance's unit of frequency.
  for (std::size_t j = 0; j < kBands; ++j) {
    cross_[j] *= count[j];
    auto_a_[j] *= count[j];
    auto_b_[j] *= count[j];
  }
}

// Variance of the generalised cross-correlation with this weight (Knapp & Carter 1976; doc/ambiguity.md eq. 8).
void AmbiguityStage::covariance(const StagePeak& peak, AmbiguityPeak& result) const noexcept {
  double total = 0.0, mean = 0.0;
  for (std::size_t j = 0; j < kBands; ++j) {
    const double g = band_weight_[j] * cross_[j];
    total += g;
    mean += g * static_cast<double>(j);
  }
  if (!(total > 0.0)) return;
  mean /= total;
  const double per_band = static_cast<double>(bins_a_.size()) / kBands;
  const double width_rad = kTwoPi * rate_hz_ / kBands;
  double signal0 = 0.0, signal2 = 0.0, noise0 = 0.0, noise2 = 0.0;
  for (std::size_t j = 0; j < kBands; ++j) {
    const double w = band_weight_[j], d = static_cast<double>(j) - mean;
    const double bent = d * d + 1.0 / 12.0;
    const double g = w * cross_[j] / per_band;
    // The least of noise that is believed is 1e-6 of the powers: rounding and interpolation.
    const double powers = auto_a_[j] * auto_b_[j] / (per_band * per_band);
    const double v = w * w * std::max(powers - cross_[j] * cross_[j] / (per_band * per_band), 1e-6 * powers);
    signal0 += g;
    signal2 += g * bent;
    noise0 += v;
    noise2 += v * bent;
  }
  if (!(signal2 > 0.0)) return;
  const double duration = std::max(result.duration_s, 1.0 / inner_hz_);
  const double band_hz = rate_hz_ / kBands;
  const double cycles = 2.0 * duration * band_hz;
  double lag_variance = noise2 / (cycles * signal2 * signal2 * width_rad * width_rad);
  // Duration: the plain one at low SNR, the data's own where the SNR shows it.
  const double snr = std::norm(peak.value) / std::max(peak.noise, 1e-300);
  const double trust = snr / (snr + kShapeSnr);
  const double plain = kPi * kPi * duration * duration / 3.0;
  const double seen = std::max(0.5 * peak.doppler_curvature, 0.01 * plain);
  const double spread = (1.0 - trust) * plain + trust * seen;
  double doppler_variance = noise0 / (cycles * signal0 * signal0 * spread);
  const double curvature = peak.lag_curvature * peak.doppler_curvature;
  double correlation = 0.0;
  if (curvature > 0.0) correlation = std::clamp(-trust * peak.mixed_curvature / std::sqrt(curvature), -0.99, 0.99);
  const double inflation = 1.0 / (1.0 - correlation * correlation);
  const bool fitted = options_.prefilter == AmbiguityPrefilter::kMaximumLikelihood && options_.symbol_rate_hz <= 0.0;
  lag_variance *= inflation * (1.0 + (fitted ? kDelayGrowth : kDelayGrowthStated) / std::max(snr, 1.0));
  doppler_variance *= inflation * (1.0 + kDopplerGrowth / std::max(snr, 1.0));
  result.sigma_tdoa_s = std::sqrt(lag_variance);
  result.sigma_fdoa_hz = std::sqrt(doppler_variance);
  result.sigma_tdoa_rate = result.sigma_tdoa_s * kTwoPi / std::sqrt(spread);
  result.correlation = correlation;
}

void AmbiguityStage::refine(const StagePeak& coarse, double carrier_hz, AmbiguityPeak& result) noexcept {
  StagePeak peak = coarse;
  const double pivot = 0.5 * static_cast<double>(n_);
  const int passes = options_.estimate_rate ? 3 : 1;
  double shift_hz = 0.0;
  for (int pass = 0; pass < passes; ++pass) {
    double rate = stretched_ + peak.rate;
    if (carrier_hz > 0.0 && pass == 0) {
      rate = options_.tdoa_rate - (peak.doppler_hz + mix_a_hz_ - mix_b_hz_) / carrier_hz;
    }
    if (std::abs(rate - stretched_) * pivot > 0.005) {
      // The delay of the peak is at the epoch, the stretch about the middle of the recording.
      peak.lag -= (rate - stretched_) * (epoch_ - pivot * static_cast<double>(up_));
      std::copy_n(xa_.begin(), n_, stretch_.begin());
      stretcher_.apply(stretch_.data(), n_, rate, pivot);
      transform(stretch_, bins_a_, 0.0);
      stretched_ = rate;
    }
    peak.rate = 0.0;
    shift_hz += peak.doppler_hz;
    transform(xb_, bins_b_, shift_hz / rate_hz_);  // b brought to a's frequency
    likelihood_weights(peak, result);
    filter(bins_a_, a_);
    filter(bins_b_, b_);
    measure_energy();
    peak.doppler_hz = 0.0;
    climb(peak, options_.estimate_rate);
  }
  const double doppler = shift_hz + peak.doppler_hz;
  const double epoch = epoch_ / inner_hz_;
  const double lag = peak.lag / inner_hz_;
  result.tdoa_rate = stretched_ + peak.rate;
  result.tdoa_s = lag + stretched_ * (epoch + lag - pivot / rate_hz_);
  // A stretch shifts every frequency by its own amount: what was measured is the shift of a's centre, what is reported
  // that of b's.
  const double shift = doppler + mix_a_hz_ - mix_b_hz_;
  result.fdoa_hz = shift - stretched_ * (mix_b_hz_ - (mix_a_hz_ - shift));
  result.phase_rad = wrapped(std::arg(peak.value) + kTwoPi * (shift_hz + table_doppler_hz_) * epoch +
                             kTwoPi * (mix_a_hz_ * (epoch + result.tdoa_s) - mix_b_hz_ * epoch));
  result.epoch_s = epoch;
  const auto delay = static_cast<std::ptrdiff_t>(std::lround(peak.lag / static_cast<double>(up_)));
  const auto first = std::max(static_cast<std::ptrdiff_t>(first_b_), static_cast<std::ptrdiff_t>(first_a_) - delay);
  const auto last = std::min(static_cast<std::ptrdiff_t>(last_b_), static_cast<std::ptrdiff_t>(last_a_) - delay);
  result.start_s = static_cast<double>(std::max<std::ptrdiff_t>(first, 0)) / rate_hz_;
  result.duration_s = static_cast<double>(std::max<std::ptrdiff_t>(last - first, 1)) / rate_hz_;
  result.center_a_hz = mix_a_hz_;
  result.center_b_hz = mix_b_hz_;
  result.bandwidth_hz = bandwidth_hz_;
  double energy_a = 0.0, energy_b = 0.0;
  for (std::size_t i = 0; i < blocks_; ++i) {
    energy_a += energy_a_[i];
    energy_b += energy_b_[i];
  }
  result.coherence = std::min(1.0, std::abs(peak.value) / std::sqrt(std::max(energy_a * energy_b, 1e-300)));
  result.tones = tones_a_ + tones_b_;
  peak.noise = coarse.noise * std::norm(peak.value) / std::max(std::norm(coarse.value), 1e-300);
  covariance(peak, result);
}

bool AmbiguityStage::surface(std::span<const double> delays_s, std::span<const double> doppler_hz,
                             std::span<double> out) noexcept {
  if (out.size() != delays_s.size() * doppler_hz.size() || n_ == 0) return false;
  transform(xb_, bins_b_, 0.0);
  coarse_weights();
  filter(bins_a_, a_);
  filter(bins_b_, b_);
  measure_energy();
  double energy_a = 0.0, energy_b = 0.0;
  for (std::size_t i = 0; i < blocks_; ++i) {
    energy_a += energy_a_[i];
    energy_b += energy_b_[i];
  }
  const double scale = 1.0 / std::max(energy_a * energy_b, 1e-300);
  const auto limit = static_cast<double>(margin_) - static_cast<double>(kReach) - 2.0;
  for (std::size_t k = 0; k < doppler_hz.size(); ++k) {
    bool turned = false;
    for (std::size_t i = 0; i < delays_s.size(); ++i) {
      const double lag = delays_s[i] * inner_hz_;
      if (!(std::abs(lag) <= limit)) {
        out[i * doppler_hz.size() + k] = 0.0;
        continue;
      }
      if (!turned || std::abs(lag - static_cast<double>(table_lag_)) > 1.0) {
        tabulate(std::lround(lag), doppler_hz[k] - (mix_a_hz_ - mix_b_hz_));
        turned = true;
      }
      Cf64 sum{};
      for (std::size_t l = 0; l < kLags; ++l) {
        const double tap = kernel_(lag - static_cast<double>(table_lag_ + static_cast<std::ptrdiff_t>(l) - kReach));
        if (tap == 0.0) continue;
        for (std::size_t m = 0; m < blocks_; ++m) sum += tap * table_[m * kLags + l];
      }
      out[i * doppler_hz.size() + k] = std::norm(sum) * scale;
    }
  }
  return true;
}

}  // namespace soopnav::dsp::detail
