#include "dsp/ambiguity_stage.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "dsp/ambiguity_kernels.hpp"
#include "dsp/kernels.hpp"

namespace soopnav::dsp::detail {
namespace {

constexpr double kTwoPi = 2.0 * std::numbers::pi;
constexpr double kUsed = 0.575;         // half of the band kept for the refinement, in occupied bandwidths
constexpr double kBox = 0.45;           // half of the coarse prefilter's box
constexpr double kResidual = 0.35;      // Doppler left between two centres found, in occupied bandwidths
constexpr double kDopplerPad = 1.5;     // zero padding of the transform over Doppler
constexpr std::size_t kMaxLines = 8;    // per recording
constexpr std::size_t kCutBlocks = 64;  // of the search for the burst's edges

double power(const Cf32& x) { return static_cast<double>(x.real() * x.real() + x.imag() * x.imag()); }

double reach_of(const AmbiguityOptions& options, std::size_t factor, double bandwidth_hz, double inner_hz) {
  if (factor == 1) return std::min(options.max_doppler_hz, 0.45 * inner_hz);
  return std::min(options.max_doppler_hz, kResidual * bandwidth_hz);
}

}  // namespace

AmbiguityStage::AmbiguityStage(const AmbiguityOptions& options, std::size_t factor, double bandwidth_hz)
    : options_(options),
      widest_hz_(bandwidth_hz),
      bandwidth_hz_(bandwidth_hz),
      decimator_(factor, std::min(0.45 / static_cast<double>(factor), 0.6 * bandwidth_hz / options.sample_rate_hz),
                 options.max_samples),
      rate_hz_(options.sample_rate_hz / static_cast<double>(factor)),
      up_(factor == 1 && bandwidth_hz > 0.65 * options.sample_rate_hz ? 2 : 1),
      inner_hz_(rate_hz_ * static_cast<double>(up_)),
      reach_hz_(reach_of(options, factor, bandwidth_hz, inner_hz_)),
      max_samples_(options.max_samples / factor),
      lag_first_(static_cast<std::ptrdiff_t>(std::floor((options.delay_center_s - options.max_delay_s) * inner_hz_))),
      lag_last_(static_cast<std::ptrdiff_t>(std::ceil((options.delay_center_s + options.max_delay_s) * inner_hz_))),
      margin_(static_cast<std::size_t>(std::max(std::abs(lag_first_), std::abs(lag_last_)) + 2 * kReach + 16)),
      sum_(static_cast<std::size_t>(std::max(1.0, std::floor(inner_hz_ / (2.5 * std::max(reach_hz_, 1e-9)))))),
      stretcher_(max_samples_),
      kernel_(1.0, 2.0 * (static_cast<double>(kReach) - 1.0), 70.0),
      forward_(fast_fft_size(static_cast<int>(max_samples_ + 64)), FftDirection::kForward),
      inverse_(forward_.size() * static_cast<int>(up_), FftDirection::kInverse) {
  const std::size_t inner = max_samples_ * up_;
  sum_ = std::min(sum_, std::max<std::size_t>(1, inner / 32));
  const auto lags = static_cast<std::size_t>(lag_last_ - lag_first_ + 1);
  const auto transform_cost = [](double n) { return n * (4.0 + 1.5 * std::log2(n)); };
  const auto narrow = static_cast<double>(fast_fft_size(
      std::max(16, static_cast<int>(std::ceil(kDopplerPad * static_cast<double>(inner) / static_cast<double>(sum_))))));
  const auto wide = static_cast<double>(fast_fft_size(static_cast<int>(
      std::max(kDopplerPad * static_cast<double>(inner), static_cast<double>(inner + margin_) + 64.0))));
  const double lag_cost = static_cast<double>(lags) * (2.0 * static_cast<double>(inner) + transform_cost(narrow));
  const double doppler_cost = (2.0 * reach_hz_ * wide / inner_hz_ + 3.0) * (2.0 * wide + transform_cost(wide));
  search_cost_ = std::min(lag_cost, doppler_cost);
  const auto nf = static_cast<std::size_t>(forward_.size());
  if (lag_cost <= doppler_cost) {
    doppler_.emplace(static_cast<int>(narrow), FftDirection::kForward);
    product_.resize(std::max(inner + 16 * kMaxBlocks, static_cast<std::size_t>(narrow)));
    spectrum_.resize(static_cast<std::size_t>(narrow));
  } else {
    wide_forward_.emplace(static_cast<int>(wide), FftDirection::kForward);
    wide_inverse_.emplace(static_cast<int>(wide), FftDirection::kInverse);
    const auto size = static_cast<std::size_t>(wide);
    wide_a_.resize(size);
    wide_b_.resize(size);
    product_.resize(std::max(inner + 16 * kMaxBlocks, size));
    spectrum_.resize(size);
  }
  inverse_noise_.resize(2 * spectrum_.size());
  best_power_.resize(lags);
  best_doppler_.resize(lags);
  xa_.resize(max_samples_);
  xb_.resize(max_samples_);
  stretch_.resize(max_samples_);
  work_.resize(nf * up_);
  bins_a_.resize(nf);
  bins_b_.resize(nf);
  weight_.resize(nf);
  const std::size_t padding = kMaxBlocks * 16;
  a_.assign(2 * margin_ + nf * up_ + padding, {});
  b_.assign(nf * up_ + padding, {});
  swapped_.assign(nf * up_ + padding, {});
  noise_factor_.resize(2 * kBands + 1);
  energy_a_.resize(kMaxBlocks);
  energy_b_.resize(kMaxBlocks);
  table_.resize(kMaxBlocks * kLags);
  shapes_.resize(options.symbol_rate_hz > 0.0 ? 1 : 30);
  templates_.resize(shapes_.size() * kBands);
  cross_.resize(kBands);
  auto_a_.resize(kBands);
  auto_b_.resize(kBands);
  band_weight_.resize(kBands);
}

double AmbiguityStage::bin_frequency(std::size_t k) const noexcept {
  const std::size_t n = bins_a_.size();
  const double at = static_cast<double>(k);
  return (k < (n + 1) / 2 ? at : at - static_cast<double>(n)) / static_cast<double>(n);
}

void AmbiguityStage::transform(const std::vector<Cf32>& x, Bins& out, double shift) noexcept {
  const std::size_t nf = out.size();
  if (shift == 0.0) {
    std::copy_n(x.begin(), n_, work_.begin());
  } else {
    const Cf64 step = std::polar(1.0, kTwoPi * shift);
    Cf64 turn{1.0, 0.0};
    for (std::size_t i = 0; i < n_; ++i) {
      if (i % 64 == 0) turn = std::polar(1.0, kTwoPi * std::remainder(shift * static_cast<double>(i), 1.0));
      const double re = static_cast<double>(x[i].real()), im = static_cast<double>(x[i].imag());
      work_[i] = {static_cast<float>(re * turn.real() - im * turn.imag()),
                  static_cast<float>(re * turn.imag() + im * turn.real())};
      turn = {turn.real() * step.real() - turn.imag() * step.imag(),
              turn.real() * step.imag() + turn.imag() * step.real()};
    }
  }
  std::fill(work_.begin() + static_cast<std::ptrdiff_t>(n_), work_.begin() + static_cast<std::ptrdiff_t>(nf), Cf32{});
  forward_.execute(work_.data(), out.data());
}

void AmbiguityStage::cut(std::vector<Cf32>& x, double noise_density, std::size_t& first, std::size_t& last) noexcept {
  first = 0;
  last = n_;
  const std::size_t block = std::max<std::size_t>(1, n_ / kCutBlocks);
  const std::size_t blocks = std::min(n_ / block, kCutBlocks);
  std::array<double, kCutBlocks> energy{};
  for (std::size_t i = 0; i < blocks; ++i) {
    double sum = 0.0;
    const std::size_t end = i + 1 == blocks ? n_ : (i + 1) * block;
    for (std::size_t n = i * block; n < end; ++n) sum += power(x[n]);
    energy[i] = sum * static_cast<double>(block) / static_cast<double>(end - i * block);
  }
  const auto length = static_cast<double>(block);
  const BlockRange range = burst_blocks({energy.data(), blocks}, length, noise_density * rate_hz_, length);
  first = range.first * block;
  if (range.last < blocks) last = range.last * block;
  std::fill(x.begin(), x.begin() + static_cast<std::ptrdiff_t>(first), Cf32{});
  std::fill(x.begin() + static_cast<std::ptrdiff_t>(last), x.begin() + static_cast<std::ptrdiff_t>(n_), Cf32{});
}

void AmbiguityStage::load(IqSpan a, IqSpan b, const Bands& bands, double low_hz, double high_hz) noexcept {
  bands_ = bands;
  bandwidth_hz_ = std::min(bands.bandwidth_hz, widest_hz_);
  if (templates_hz_ != bandwidth_hz_) make_templates();
  templates_hz_ = bandwidth_hz_;
  mix_a_hz_ = bands.center_a_hz;
  mix_b_hz_ = bands.center_b_hz;
  const double apart = mix_a_hz_ - mix_b_hz_;
  low_hz_ = std::max(low_hz - apart, -reach_hz_);
  high_hz_ = std::min(high_hz - apart, reach_hz_);
  if (!(high_hz_ >= low_hz_)) low_hz_ = high_hz_ = std::clamp(0.5 * (low_hz_ + high_hz_), -reach_hz_, reach_hz_);
  stretched_ = 0.0;
  tones_a_ = tones_b_ = 0;
  // To unit power, so that products of four samples stay inside a float's range.
  const double gain_a = 1.0 / std::sqrt(bands.power_a), gain_b = 1.0 / std::sqrt(bands.power_b);
  n_ = decimator_.apply(a, mix_a_hz_ / options_.sample_rate_hz, gain_a, xa_.data());
  decimator_.apply(b, mix_b_hz_ / options_.sample_rate_hz, gain_b, xb_.data());

  std::array<Line, kMaxLines> lines_a, lines_b;
  const auto prepare = [&](std::vector<Cf32>& x, Bins& bins, double density, std::size_t& first, std::size_t& last,
                           std::array<Line, kMaxLines>& lines) {
    std::size_t count = 0;
    if (options_.reject_tones) {
      const double band = std::min(0.5, kUsed * bandwidth_hz_ / rate_hz_);
      count = subtract_lines({x.data(), n_}, forward_, band, work_.data(), bins.data(), lines);
    }
    cut(x, density, first, last);
    if (!options_.reject_tones || last - first < n_) transform(x, bins, 0.0);
    if (count == 0) return count;
    double sum = 0.0;
    for (const Cf32& bin : bins) sum += power(bin);
    const double level = 2.0 * sum / static_cast<double>(bins.size());
    std::size_t zeroed = 0;
    for (std::size_t i = 0; i < count; ++i) zeroed += excise(bins, lines[i].frequency, level, bins.size() / 16);
    if (zeroed == 0) return count;
    // Back in time, where the Doppler shift is taken out; every up_-th sample of the finer grid is one of x.
    std::fill(weight_.begin(), weight_.end(), 1.0F / static_cast<float>(bins.size()));
    filter(bins, b_);
    for (std::size_t n = 0; n < n_; ++n) x[n] = b_[n * up_];
    return count;
  };
  tones_a_ = prepare(xa_, bins_a_, bands_.noise_a, first_a_, last_a_, lines_a);
  tones_b_ = prepare(xb_, bins_b_, bands_.noise_b, first_b_, last_b_, lines_b);
  tone_pair_ = false;
  const double cell_hz = 2.0 * rate_hz_ / static_cast<double>(std::max<std::size_t>(n_, 1));
  for (std::size_t i = 0; i < tones_a_; ++i) {
    for (std::size_t j = 0; j < tones_b_; ++j) {
      const double doppler = (lines_a[i].frequency - lines_b[j].frequency) * rate_hz_;
      tone_pair_ = tone_pair_ || (doppler >= low_hz_ - cell_hz && doppler <= high_hz_ + cell_hz);
    }
  }
}

void AmbiguityStage::coarse_weights() noexcept {
  const double symbols = options_.symbol_rate_hz / rate_hz_;
  const bool shaped = symbols > 0.0;
  const bool open = options_.prefilter == AmbiguityPrefilter::kNone || bandwidth_hz_ > 0.9 * rate_hz_;
  const double half = (open ? kUsed : kBox) * bandwidth_hz_ / rate_hz_;
  const double edge = 0.5 * (1.0 - options_.rolloff) * symbols;
  const auto scale = 1.0F / static_cast<float>(bins_a_.size());
  for (std::size_t k = 0; k < weight_.size(); ++k) {
    const double f = std::abs(bin_frequency(k));
    if (shaped && !open) {
      const double x = options_.rolloff > 0.0 ? (f - edge) / (options_.rolloff * symbols) : (f > edge ? 1.0 : 0.0);
      weight_[k] = x <= 0.0 ? scale : x >= 1.0 ? 0.0F : scale * static_cast<float>(std::cos(0.25 * kTwoPi * x));
    } else {
      weight_[k] = f <= half ? scale : 0.0F;
    }
  }
}

void AmbiguityStage::filter(const Bins& spectrum, std::vector<Cf32>& out) noexcept {
  const std::size_t nf = spectrum.size();
  const std::size_t positive = (nf + 1) / 2;
  std::fill(work_.begin(), work_.end(), Cf32{});
  for (std::size_t k = 0; k < positive; ++k) work_[k] = spectrum[k] * weight_[k];
  const std::size_t offset = work_.size() - nf;
  for (std::size_t k = positive; k < nf; ++k) work_[k + offset] = spectrum[k] * weight_[k];
  const std::size_t at = &out == &a_ ? margin_ : 0;
  inverse_.execute(work_.data(), out.data() + at);
}

// Noise beside the peak: E|C(l, f)|^2 = sum_n |a[n + l]|^2 |b[n]|^2 kappa(f), doc/ambiguity.md eq. 4.
void AmbiguityStage::measure_noise() noexcept {
  std::fill(auto_a_.begin(), auto_a_.end(), 0.0);
  std::fill(auto_b_.begin(), auto_b_.end(), 0.0);
  double sum_a = 0.0, sum_b = 0.0;
  for (std::size_t k = 0; k < weight_.size(); ++k) {
    const double w = static_cast<double>(weight_[k]) * static_cast<double>(weight_[k]);
    if (w == 0.0) continue;
    const auto j = std::min(kBands - 1, static_cast<std::size_t>((bin_frequency(k) + 0.5) * kBands));
    auto_a_[j] += w * power(bins_a_[k]);
    auto_b_[j] += w * power(bins_b_[k]);
  }
  for (std::size_t j = 0; j < kBands; ++j) {
    sum_a += auto_a_[j];
    sum_b += auto_b_[j];
  }
  const double scale = static_cast<double>(kBands * up_) / std::max(sum_a * sum_b, 1e-300);
  double zeroth = 0.0, first = 0.0, second = 0.0;
  for (std::size_t j = 0; j < kBands; ++j) {
    const double p = auto_a_[j] * auto_b_[j], f = static_cast<double>(j);
    zeroth += p;
    first += p * f;
    second += p * f * f;
  }
  zeroth = std::max(zeroth, 1e-300);
  const double variance = second / zeroth - (first / zeroth) * (first / zeroth) + 1.0 / 12.0;
  noise_width_rad_ = kTwoPi * std::sqrt(std::max(variance, 1.0 / 12.0)) * rate_hz_ / kBands;
  for (std::size_t s = 0; s < noise_factor_.size(); ++s) {
    const auto shift = static_cast<std::ptrdiff_t>(s) - static_cast<std::ptrdiff_t>(kBands);
    double sum = 0.0;
    for (std::ptrdiff_t j = std::max<std::ptrdiff_t>(0, -shift);
         j < static_cast<std::ptrdiff_t>(kBands) - std::max<std::ptrdiff_t>(0, shift); ++j) {
      sum += auto_a_[static_cast<std::size_t>(j + shift)] * auto_b_[static_cast<std::size_t>(j)];
    }
    noise_factor_[s] = sum * scale;
  }
  const double floor = 0.2 * noise_factor_[kBands];
  for (double& factor : noise_factor_) factor = std::max(factor, floor);
  measure_energy();
  double weight = 0.0, mean = 0.0, square = 0.0;
  for (std::size_t i = 0; i < blocks_; ++i) {
    const double p = energy_a_[i] * energy_b_[i], t = static_cast<double>(i);
    weight += p;
    mean += p * t;
    square += p * t * t;
  }
  weight = std::max(weight, 1e-300);
  const double spread = std::max(square / weight - (mean / weight) * (mean / weight) + 1.0 / 12.0, 1.0 / 12.0);
  noise_duration_rad_ = kTwoPi * std::sqrt(spread) * static_cast<double>(block_) / inner_hz_;
}

void AmbiguityStage::measure_energy() noexcept {
  const std::size_t inner = n_ * up_;
  block_ =
      std::max<std::size_t>(16, ((inner + 63) / 64 + 15) / 16 * 16);  // 64 blocks at most, 1023 samples beyond inner
  blocks_ = std::min(kMaxBlocks, (inner + block_ - 1) / block_);
  const auto energy = [&](const Cf32* x) {
    const Cf32 e = dot(reinterpret_cast<const float*>(x), x, block_);
    return static_cast<double>(e.real()) + static_cast<double>(e.imag());
  };
  for (std::size_t i = 0; i < blocks_; ++i) {
    energy_a_[i] = energy(a_.data() + margin_ + i * block_);
    energy_b_[i] = energy(b_.data() + i * block_);
  }
}

double AmbiguityStage::noise_factor(double doppler_hz) const noexcept {
  const double at = std::clamp(doppler_hz / rate_hz_ * kBands + kBands, 0.0, 2.0 * kBands - 1e-9);
  const auto i = static_cast<std::size_t>(at);
  const double mu = at - static_cast<double>(i);
  return (1.0 - mu) * noise_factor_[i] + mu * noise_factor_[i + 1];
}

double AmbiguityStage::noise_at(std::ptrdiff_t lag, double doppler_hz) const noexcept {
  const auto shift = static_cast<std::ptrdiff_t>(std::lround(static_cast<double>(lag) / static_cast<double>(block_)));
  double sum = 0.0;
  for (std::ptrdiff_t i = 0; i < static_cast<std::ptrdiff_t>(blocks_); ++i) {
    const std::ptrdiff_t j = i + shift;
    if (j < 0 || j >= static_cast<std::ptrdiff_t>(blocks_)) continue;
    sum += energy_a_[static_cast<std::size_t>(j)] * energy_b_[static_cast<std::size_t>(i)];
  }
  return std::max(sum / static_cast<double>(block_) * noise_factor(doppler_hz), 1e-300);
}

void AmbiguityStage::search_lags() noexcept {
  const auto size = static_cast<std::size_t>(doppler_->size());
  const std::size_t inner = n_ * up_;
  const double step = inner_hz_ / static_cast<double>(sum_) / static_cast<double>(size);
  const auto limit = static_cast<std::ptrdiff_t>(size / 2) - 1;
  const auto first = std::max(-limit, static_cast<std::ptrdiff_t>(std::floor(low_hz_ / step)));
  const auto last = std::min(limit, static_cast<std::ptrdiff_t>(std::ceil(high_hz_ / step)));
  const auto count = static_cast<std::size_t>(last - first + 1);
  for (std::size_t k = 0; k < count; ++k) {
    inverse_noise_[k] =
        static_cast<float>(1.0 / noise_factor(static_cast<double>(first + static_cast<std::ptrdiff_t>(k)) * step));
  }
  float* powers = inverse_noise_.data() + count;
  const bool fits = 2 * count <= inverse_noise_.size();
  for (std::ptrdiff_t lag = lag_first_; lag <= lag_last_; ++lag) {
    multiply_conjugate(a_.data() + static_cast<std::ptrdiff_t>(margin_) + lag, b_.data(), inner, product_.data());
    std::size_t length = inner;
    if (sum_ > 1) {
      length = inner / sum_;
      for (std::size_t i = 0; i < length; ++i) {
        Cf32 sum{};
        for (std::size_t k = 0; k < sum_; ++k) sum += product_[i * sum_ + k];
        product_[i] = sum;
      }
    }
    std::fill(product_.begin() + static_cast<std::ptrdiff_t>(length),
              product_.begin() + static_cast<std::ptrdiff_t>(std::max(length, size)), Cf32{});
    doppler_->execute(product_.data(), spectrum_.data());
    // Bins from `first` on, negative ones being at the end of the spectrum.
    float best = -1.0F;
    std::ptrdiff_t at = first;
    const auto scan = [&](std::ptrdiff_t from, std::ptrdiff_t to) {  // [from, to), same sign
      if (to <= from || !fits) return;
      const Cf32* x = spectrum_.data() + (from < 0 ? from + static_cast<std::ptrdiff_t>(size) : from);
      const auto n = static_cast<std::size_t>(to - from);
      weighted_power(x, inverse_noise_.data() + (from - first), n, powers);
      for (std::size_t i = 0; i < n; ++i) {
        if (powers[i] > best) {
          best = powers[i];
          at = from + static_cast<std::ptrdiff_t>(i);
        }
      }
    };
    scan(first, std::min<std::ptrdiff_t>(0, last + 1));
    scan(std::max<std::ptrdiff_t>(0, first), last + 1);
    const auto i = static_cast<std::size_t>(lag - lag_first_);
    best_power_[i] = best;
    best_doppler_[i] = static_cast<float>(static_cast<double>(at) * step);
  }
}

void AmbiguityStage::search_doppler() noexcept {
  const auto size = static_cast<std::size_t>(wide_forward_->size());
  const std::size_t inner = n_ * up_;
  const auto load = [&](const Cf32* x, std::vector<Cf32>& out) {
    std::copy_n(x, inner, product_.begin());
    std::fill(product_.begin() + static_cast<std::ptrdiff_t>(inner),
              product_.begin() + static_cast<std::ptrdiff_t>(size), Cf32{});
    wide_forward_->execute(product_.data(), out.data());
  };
  load(a_.data() + margin_, wide_a_);
  load(b_.data(), wide_b_);
  std::fill(best_power_.begin(), best_power_.end(), -1.0F);
  const double step = inner_hz_ / static_cast<double>(size);
  const auto first = static_cast<std::ptrdiff_t>(std::floor(low_hz_ / step));
  const auto last = static_cast<std::ptrdiff_t>(std::ceil(high_hz_ / step));
  const auto n = static_cast<std::ptrdiff_t>(size);
  for (std::ptrdiff_t k = first; k <= last; ++k) {
    const auto shift = static_cast<std::size_t>((k % n + n) % n);
    multiply_conjugate(wide_a_.data() + shift, wide_b_.data(), size - shift, product_.data());
    multiply_conjugate(wide_a_.data(), wide_b_.data() + (size - shift), shift, product_.data() + (size - shift));
    wide_inverse_->execute(product_.data(), spectrum_.data());
    const double doppler = static_cast<double>(k) * step;
    const auto scale =
        static_cast<float>(1.0 / (noise_factor(doppler) * static_cast<double>(size) * static_cast<double>(size)));
    for (std::ptrdiff_t lag = lag_first_; lag <= lag_last_; ++lag) {
      const Cf32 x = spectrum_[static_cast<std::size_t>(lag < 0 ? lag + n : lag)];
      const float p = (x.real() * x.real() + x.imag() * x.imag()) * scale;
      const auto i = static_cast<std::size_t>(lag - lag_first_);
      if (p > best_power_[i]) {
        best_power_[i] = p;
        best_doppler_[i] = static_cast<float>(doppler);
      }
    }
  }
}

StagePeak AmbiguityStage::search(double rate) noexcept {
  if (rate != stretched_) {
    std::copy_n(xa_.begin(), n_, stretch_.begin());
    if (rate != 0.0) stretcher_.apply(stretch_.data(), n_, rate, 0.5 * static_cast<double>(n_));
    transform(stretch_, bins_a_, 0.0);
    stretched_ = rate;
  }
  coarse_weights();
  filter(bins_a_, a_);
  filter(bins_b_, b_);
  measure_noise();
  if (doppler_) {
    search_lags();
  } else {
    search_doppler();
  }
  // The two best cells that are not neighbours; which of them is higher only the climb can tell.
  StagePeak best;
  double best_ratio = -1.0;
  std::ptrdiff_t taken = 0;
  for (int candidate = 0; candidate < 2; ++candidate) {
    float power_here = -1.0F;
    std::size_t at = 0;
    for (std::size_t i = 0; i < best_power_.size(); ++i) {
      const bool near =
          candidate > 0 && std::abs(static_cast<std::ptrdiff_t>(i) - taken) <= 2 &&
          std::abs(static_cast<double>(best_doppler_[i]) - best.doppler_hz) * static_cast<double>(n_) < 2.0 * rate_hz_;
      if (!near && best_power_[i] > power_here) {
        power_here = best_power_[i];
        at = i;
      }
    }
    if (power_here < 0.0F) break;
    if (candidate > 0 &&
        static_cast<double>(power_here) < 0.4 * static_cast<double>(best_power_[static_cast<std::size_t>(taken)]))
      break;
    StagePeak peak;
    const std::ptrdiff_t lag = static_cast<std::ptrdiff_t>(at) + lag_first_;
    peak.lag = static_cast<double>(lag);
    peak.doppler_hz = static_cast<double>(best_doppler_[at]);
    climb(peak, false);
    peak.noise = noise_at(std::lround(peak.lag), peak.doppler_hz);
    const double ratio = std::norm(peak.value) / peak.noise;
    if (candidate == 0) taken = static_cast<std::ptrdiff_t>(at);
    if (ratio > best_ratio) {
      best_ratio = ratio;
      best = peak;
    }
  }
  return best;
}

// P(max > u) of |noise|^2 over the rectangle searched, by the expected Euler characteristic of a chi-square field with
// two degrees of freedom (Worsley 1994; doc/ambiguity.md eq. 5).
double AmbiguityStage::threshold() const noexcept {
  const double delay = 2.0 * options_.max_delay_s + 1.0 / inner_hz_;
  const double doppler = high_hz_ - low_hz_ + inner_hz_ / static_cast<double>(std::max<std::size_t>(n_ * up_, 1));
  double width = delay * noise_width_rad_, height = doppler * noise_duration_rad_;
  if (options_.estimate_rate) height *= 1.0 + options_.max_tdoa_rate * noise_duration_rad_ * noise_width_rad_;
  const auto exceeds = [&](double u) {
    return std::exp(-u) *
           (width * height * (2.0 * u - 1.0) / kTwoPi + (width + height) * std::sqrt(2.0 * u / kTwoPi) + 1.0);
  };
  double low = 1.0, high = 100.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (exceeds(middle) > options_.false_alarm ? low : high) = middle;
  }
  return high;
}

}  // namespace soopnav::dsp::detail
