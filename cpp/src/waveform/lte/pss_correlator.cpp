#include "waveform/lte/pss_correlator.hpp"

#include <algorithm>
#include <cmath>

#include "soopnav/waveform/lte/sequences.hpp"
#include "waveform/lte/kernels.hpp"

namespace soopnav::lte {

PssCorrelator::PssCorrelator(const Options& options)
    : options_(options),
      lags_(kHalfFrameSamples * options.inverse_size / kForward),
      ratio_(static_cast<double>(kForward) / options.inverse_size),
      forward_(kForward, dsp::FftDirection::kForward),
      inverse_(options.inverse_size, dsp::FftDirection::kInverse),
      half_(kForward / 4),  // +-480 kHz holds the 62 subcarriers and the first side lobes of their edges
      input_(kForward),
      spectra_(static_cast<std::size_t>(kGroup) * kForward),
      spectrum_(spectra_.data()),
      product_(static_cast<std::size_t>(options.inverse_size)),
      correlation_(static_cast<std::size_t>(options.inverse_size)) {
  const double bin_hz = kBaseRateHz / kForward;
  const int side = static_cast<int>(
      std::ceil(std::max(0.0, options.max_cfo_hz - options.spacing_hz / 2) / options.spacing_hz - 1e-9));
  for (int i = -side; i <= side; ++i) shifts_.push_back(static_cast<int>(std::lround(i * options.spacing_hz / bin_hz)));

  dsp::Fft symbol(kSearchFft, dsp::FftDirection::kInverse);
  for (int root = 0; root < 3; ++root) {
    std::array<Cf32, kSearchFft> bins{};
    const auto& sequence = pss(root);
    for (int n = 0; n < kSyncSubcarriers; ++n) {
      bins[static_cast<std::size_t>(n < 31 ? kSearchFft - 31 + n : n - 30)] = sequence[static_cast<std::size_t>(n)];
    }
    std::fill(input_.begin(), input_.end(), Cf32{});
    symbol.execute(bins.data(), input_.data());
    const float norm = 1.0F / std::sqrt(62.0F * kSearchFft);  // unit energy
    for (int n = 0; n < kSearchFft; ++n) input_[static_cast<std::size_t>(n)] *= norm;
    forward_.execute(input_.data(), spectrum_);
    auto& reference = reference_[static_cast<std::size_t>(root)];
    reference.resize(static_cast<std::size_t>(2 * half_));
    for (int k = -half_; k < half_; ++k) {
      const auto bin = static_cast<std::size_t>((k + kForward) % kForward);
      reference[static_cast<std::size_t>(k + half_)] = std::conj(spectrum_[bin]) / static_cast<float>(kForward);
    }
  }
  const auto lags = static_cast<std::size_t>(lags_);
  energy_.resize(lags);
  combined_.resize(lags);
  group_energy_.resize(lags);
  prefix_.resize(kForward + 1);
}

float* PssCorrelator::surface(int group, int hypothesis, int root) noexcept {
  const auto index = (static_cast<std::size_t>(group) * shifts_.size() + static_cast<std::size_t>(hypothesis)) * 3 +
                     static_cast<std::size_t>(root);
  return surfaces_.data() + index * static_cast<std::size_t>(lags_);
}

void PssCorrelator::clear() noexcept {
  half_frames_ = 0;
  pending_ = 0;
  std::fill(energy_.begin(), energy_.end(), 0.0F);
}

void PssCorrelator::add(IqSpan iq, std::size_t first) {
  if (half_frames_ >= options_.max_half_frames || first >= iq.size()) return;
  const std::size_t available = std::min<std::size_t>(kForward, iq.size() - first);
  std::copy_n(iq.data() + first, available, input_.data());
  std::fill(input_.begin() + static_cast<std::ptrdiff_t>(available), input_.end(), Cf32{});
  spectrum_ = spectra_.data() + static_cast<std::size_t>(half_frames_ % kGroup) * kForward;
  forward_.execute(input_.data(), spectrum_);
  add_energy();
  ++half_frames_;
  ++pending_;
  if (pending_ == kGroup) correlate_group();
}

// Correlates the half-frames of a group that have been transformed, all of them for one hypothesis before the next: the
// sum then stays in the nearest cache.
void PssCorrelator::correlate_group() {
  if (pending_ == 0) return;
  const int group = (half_frames_ - 1) / kGroup;
  const auto lags = static_cast<std::size_t>(lags_);
  const auto negative = static_cast<std::size_t>(half_);
  const std::size_t needed = static_cast<std::size_t>(group + 1) * shifts_.size() * 3 * lags;
  if (surfaces_.size() < needed) surfaces_.resize(needed);  // grows with the longest capture, once
  for (std::size_t h = 0; h < shifts_.size(); ++h) {
    // Bins shift - half ... shift + half of the spectrum, which may wrap around its end.
    const int low = ((shifts_[h] - half_) % kForward + kForward) % kForward;
    for (int root = 0; root < 3; ++root) {
      const Cf32* reference = reference_[static_cast<std::size_t>(root)].data();
      float* sum = surface(group, static_cast<int>(h), root);
      std::fill(sum, sum + lags, 0.0F);
      for (int n = 0; n < pending_; ++n) {
        const Cf32* spectrum = spectra_.data() + static_cast<std::size_t>(n) * kForward;
        // Bins -half ... -1 go to the end of the inverse transform's input, 0 ... half-1 to its start.
        const auto place = [&](std::size_t from, std::size_t count, Cf32* to) {
          const std::size_t bin = (static_cast<std::size_t>(low) + from) % kForward;
          const std::size_t head = std::min<std::size_t>(count, kForward - bin);
          kernels::multiply(spectrum + bin, reference + from, to, head);
          if (head < count) kernels::multiply(spectrum, reference + from + head, to + head, count - head);
        };
        place(0, negative, product_.data() + (product_.size() - negative));
        place(negative, negative, product_.data());
        std::fill(product_.begin() + half_, product_.end() - half_, Cf32{});
        inverse_.execute(product_.data(), correlation_.data());
        kernels::accumulate_power(correlation_.data(), sum, lags);
      }
    }
  }
  pending_ = 0;
}

// Energy under the template at every lag. Once strong cells are cancelled, their synchronisation symbols are quiet
// inside the band while data goes on outside it and around; only the energy in the band shows that.
void PssCorrelator::add_energy() {
  std::size_t count = kForward;
  double per_lag = ratio_;  // elements of the running sum per lag
  if (options_.in_band) {
    // The 62 subcarriers, +-465 kHz, at the rate of the lags.
    const std::size_t edge = static_cast<std::size_t>(half_) * 31 / 32;
    const auto wrap = static_cast<std::ptrdiff_t>(edge);
    std::fill(product_.begin(), product_.end(), Cf32{});
    std::copy_n(spectrum_, edge, product_.begin());
    std::copy_n(spectrum_ + kForward - wrap, edge, product_.end() - wrap);
    inverse_.execute(product_.data(), correlation_.data());
    count = correlation_.size();
    per_lag = 1.0;
  }
  const Cf32* x = options_.in_band ? correlation_.data() : input_.data();
  prefix_[0] = 0.0;
  for (std::size_t n = 0; n < count; ++n) prefix_[n + 1] = prefix_[n] + static_cast<double>(std::norm(x[n]));
  const auto window = static_cast<std::size_t>(std::lround(kSearchFft * per_lag / ratio_));
  for (int m = 0; m < lags_; ++m) {
    const auto n = static_cast<std::size_t>(m * per_lag);
    energy_[static_cast<std::size_t>(m)] += static_cast<float>(prefix_[n + window] - prefix_[n]);
  }
}

void PssCorrelator::offer(const PssCandidate& candidate, std::size_t limit, std::vector<PssCandidate>& out) const {
  const double near_hz = 1.5 * options_.spacing_hz;
  for (auto it = out.begin(); it != out.end(); ++it) {
    if (it->n_id_2 != candidate.n_id_2 || std::abs(it->cfo_hz - candidate.cfo_hz) > near_hz) continue;
    const double gap = std::abs(std::remainder(it->tau - candidate.tau, static_cast<double>(kHalfFrameSamples)));
    if (gap > 2.0 + ratio_) continue;
    if (it->score >= candidate.score) return;
    out.erase(it);
    break;
  }
  const auto place = std::upper_bound(out.begin(), out.end(), candidate,
                                      [](const PssCandidate& a, const PssCandidate& b) { return a.score > b.score; });
  out.insert(place, candidate);
  if (out.size() > limit) out.pop_back();
}

void PssCorrelator::peaks(int limit, std::vector<PssCandidate>& out) {
  out.clear();
  if (half_frames_ == 0 || limit < 1) return;
  correlate_group();
  out.reserve(static_cast<std::size_t>(limit) + 2);
  const int groups = (half_frames_ + kGroup - 1) / kGroup;
  const auto lags = static_cast<std::size_t>(lags_);
  const double span_samples = static_cast<double>(groups - 1) * kGroup * kHalfFrameSamples;
  const double max_slip = options_.max_drift_ppm * 1e-6 * span_samples / ratio_;  // lags from first to last group
  const int slips = groups > 1 ? static_cast<int>(std::ceil(max_slip / 2.0)) : 0;

  // The local energy makes the statistic blind to level; a floor keeps silent stretches from dividing by nothing.
  double mean_energy = 0.0;
  for (const float e : energy_) mean_energy += static_cast<double>(e);
  mean_energy /= lags_;
  if (!(mean_energy > 0.0)) return;
  const auto floor = static_cast<float>((options_.in_band ? 2e-3 : 0.1) * mean_energy);
  for (std::size_t m = 0; m < lags; ++m) group_energy_[m] = 1.0F / std::max(energy_[m], floor);

  constexpr std::size_t kChunk = 64;
  float threshold = 0.0F;
  for (std::size_t h = 0; h < shifts_.size(); ++h) {
    for (int root = 0; root < 3; ++root) {
      for (int slip = -slips; slip <= slips; ++slip) {
        std::copy_n(surface(0, static_cast<int>(h), root), lags, combined_.begin());
        for (int g = 1; g < groups; ++g) {
          const double share = static_cast<double>(g) / (groups - 1);
          const auto shift = static_cast<std::size_t>(((std::lround(2.0 * slip * share)) % lags_ + lags_) % lags_);
          const float* s = surface(g, static_cast<int>(h), root);
          kernels::add(s + shift, combined_.data(), lags - shift);
          kernels::add(s, combined_.data() + (lags - shift), shift);
        }
        kernels::scale(group_energy_.data(), combined_.data(), lags);
        const double mean = static_cast<double>(kernels::sum(combined_.data(), lags)) / lags_;
        if (!(mean > 0.0)) continue;
        const auto scale = static_cast<float>(1.0 / mean);
        for (std::size_t c = 0; c < lags; c += kChunk) {
          const std::size_t count = std::min(kChunk, lags - c);
          if (kernels::maximum(combined_.data() + c, count) * scale <= threshold) continue;
          for (std::size_t m = c; m < c + count; ++m) {
            const float v = combined_[m];
            if (v * scale <= threshold || v < combined_[(m + 1) % lags] || v < combined_[(m + lags - 1) % lags])
              continue;
            PssCandidate candidate;
            candidate.n_id_2 = root;
            candidate.tau = static_cast<double>(m) * ratio_;
            candidate.cfo_hz = shifts_[h] * kBaseRateHz / kForward;
            candidate.drift = groups > 1 ? 2.0 * slip * ratio_ / span_samples : 0.0;
            candidate.score = static_cast<double>(v * scale);
            offer(candidate, static_cast<std::size_t>(limit), out);
            if (out.size() >= static_cast<std::size_t>(limit)) threshold = static_cast<float>(out.back().score);
          }
        }
      }
    }
  }
}

}  // namespace soopnav::lte
