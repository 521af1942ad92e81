#include "dsp/ambiguity_band.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace soopnav::dsp::detail {
namespace {

constexpr double kEnough = 8.0;     // the same, once every sample has been used
constexpr double kClear = 25.0;     // scores above this need no more averaging: the centre is known well enough
constexpr double kSeen = 6.0;       // and below this there is no band to be seen
constexpr double kCentroid = 15.0;  // from here on the centroid is better than the window
constexpr std::size_t kReach = 4;   // bins: a feature that falls by kSteep within this is a line
constexpr double kSteep = 4.0;
constexpr double kTold = 1.5 * 2.0 * kReach;  // bins of a band that cannot be taken for a line
constexpr double kWidestBinHz = 2e3;          // of the transform that looks for an unknown band

std::size_t transform_size(double rate_hz, double bandwidth_hz, std::size_t max_samples) {
  const double bins = bandwidth_hz > 0.0 ? kTold * rate_hz / bandwidth_hz : std::max(1024.0, rate_hz / kWidestBinHz);
  std::size_t size = 16;
  while (static_cast<double>(size) < bins && size < 8192) size *= 2;
  while (size > 16 && 16 * size > max_samples) size /= 2;
  return size;
}

}  // namespace

BandFinder::BandFinder(double sample_rate_hz, double bandwidth_hz, std::size_t max_samples)
    : rate_(sample_rate_hz),
      size_(transform_size(sample_rate_hz, bandwidth_hz, max_samples)),
      lines_told_(bandwidth_hz <= 0.0 || bandwidth_hz / sample_rate_hz * static_cast<double>(size_) >= kTold),
      fft_(static_cast<int>(size_), FftDirection::kForward),
      window_(size_),
      scaled_(size_),
      input_(size_),
      output_(size_),
      sorted_(size_) {
  for (std::size_t n = 0; n < size_; ++n) {
    const double x = (static_cast<double>(n) + 0.5) / static_cast<double>(size_);
    window_[n] = static_cast<float>(0.5 - 0.5 * std::cos(2.0 * std::numbers::pi * x));
    window_power_ += static_cast<double>(window_[n] * window_[n]);
  }
  for (Side* side : {&a_, &b_}) {
    side->raw.resize(size_);
    side->clean.resize(size_);
    side->sums.resize(size_ + 1);
    side->line.resize(size_);
  }
}

double BandFinder::frequency(double bin) const noexcept {
  return (bin - static_cast<double>(size_ / 2)) * rate_ / static_cast<double>(size_);
}

void BandFinder::spectrum(IqSpan iq, double power, std::size_t step, std::size_t hop, Side& side) noexcept {
  // To unit power, so that no square leaves a float's range.
  const auto gain = static_cast<float>(std::clamp(1.0 / std::sqrt(power), 1e-37, 1e37));
  for (std::size_t n = 0; n < size_; ++n) scaled_[n] = gain * window_[n];
  std::fill(side.raw.begin(), side.raw.end(), 0.0);
  std::size_t count = 0;
  for (std::size_t at = 0; at + size_ <= iq.size(); at += hop * step, ++count) {
    for (std::size_t n = 0; n < size_; ++n) input_[n] = iq[at + n] * scaled_[n];
    fft_.execute(input_.data(), output_.data());
    for (std::size_t k = 0; k < size_; ++k) {
      const Cf32 x = output_[k < size_ / 2 ? k + size_ / 2 : k - size_ / 2];
      side.raw[k] += static_cast<double>(x.real() * x.real() + x.imag() * x.imag());
    }
  }
  const double scale = 1.0 / (static_cast<double>(std::max<std::size_t>(count, 1)) * window_power_ * rate_);
  for (double& p : side.raw) p *= scale;
  // Hann windows that overlap by half are correlated: 0.53 of them count.
  side.averages = std::max(1.0, static_cast<double>(count) * (hop < size_ && step == 1 ? 0.53 : 1.0));
  std::copy(side.raw.begin(), side.raw.end(), side.clean.begin());
  remove_lines(side);
}

// A line is at most a Hann window's main lobe wide: what stands out from both neighbours kReach bins away is bridged.
// A recording too short for bins that are narrow beside the band stated is left alone: its burst would look the same.
void BandFinder::remove_lines(Side& side) noexcept {
  std::fill(side.line.begin(), side.line.end(), char{0});
  if (!lines_told_) return;
  for (std::size_t k = kReach; k + kReach < size_; ++k) {
    const double left = side.raw[k - kReach], right = side.raw[k + kReach];
    if (side.raw[k] <= kSteep * std::max(left, right)) continue;
    side.line[k] = 1;
    for (std::size_t j = k - kReach + 1; j < k + kReach; ++j) {
      side.clean[j] = std::min(side.clean[j], 0.5 * (left + right));
    }
  }
}

bool BandFinder::lines_pair(const BandRequest& request) const noexcept {
  const double bin_hz = rate_ / static_cast<double>(size_);
  const double low = (request.doppler_center_hz - request.max_doppler_hz) / bin_hz - 2.0;
  const double high = (request.doppler_center_hz + request.max_doppler_hz) / bin_hz + 2.0;
  const auto n = static_cast<std::ptrdiff_t>(size_);
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    if (b_.line[static_cast<std::size_t>(k)] == 0) continue;
    const auto first = std::max<std::ptrdiff_t>(0, k + static_cast<std::ptrdiff_t>(std::ceil(low)));
    const auto last = std::min<std::ptrdiff_t>(n - 1, k + static_cast<std::ptrdiff_t>(std::floor(high)));
    for (std::ptrdiff_t i = first; i <= last; ++i) {
      if (a_.line[static_cast<std::size_t>(i)] != 0) return true;
    }
  }
  return false;
}

// The floor is the median of the bins outside the band, or at first the lowest fifth of all.
void BandFinder::sum(Side& side, bool excluded, std::size_t first, std::size_t width) noexcept {
  std::size_t count = 0;
  const std::size_t guard = 1 + width / 4;
  for (std::size_t k = 0; k < size_; ++k) {
    if (excluded && k + guard >= first && k < first + width + guard) continue;
    sorted_[count++] = side.clean[k];
  }
  side.floor_known = excluded && count >= std::max<std::size_t>(6, size_ / 8);
  if (!excluded || side.floor_known) {
    const std::size_t rank = excluded ? count / 2 : count / 5;
    std::nth_element(sorted_.begin(), sorted_.begin() + static_cast<std::ptrdiff_t>(rank),
                     sorted_.begin() + static_cast<std::ptrdiff_t>(count));
    // Quantiles of a mean of `averages` exponentials, to first order of its skewness.
    const double k = side.averages;
    const double bias = excluded ? 1.0 - 1.0 / (3.0 * k) : std::max(0.25, 1.0 - 0.84 / std::sqrt(k));
    side.floor = sorted_[rank] / bias;
  }
  const double scale = side.floor > 0.0 ? 1.0 / side.floor : 0.0;
  side.sums[0] = 0.0;
  for (std::size_t k = 0; k < size_; ++k) side.sums[k + 1] = side.sums[k] + (side.clean[k] * scale - 1.0);
}

double BandFinder::excess(const Side& side, std::size_t first, std::size_t width) const noexcept {
  return (side.sums[first + width] - side.sums[first]) * std::sqrt(side.averages / (1.5 * static_cast<double>(width)));
}

BandFinder::Window BandFinder::best(const BandRequest& request, std::size_t width, double floor) const noexcept {
  const auto clamp_bin = [&](double center_hz) {
    const double bin = center_hz * static_cast<double>(size_) / rate_ + static_cast<double>(size_ / 2) -
                       0.5 * static_cast<double>(width - 1);
    return static_cast<std::size_t>(std::clamp(std::round(bin), 0.0, static_cast<double>(size_ - width)));
  };
  const auto range = [&](double center_hz, std::size_t& from, std::size_t& to) {
    from = 0;
    to = size_ - width;
    if (std::isfinite(center_hz)) from = to = clamp_bin(center_hz);
  };
  const auto largest = [&](const Side& side, std::size_t from, std::size_t to) {
    std::size_t at = from;
    double most = side.sums[from + width] - side.sums[from];
    for (std::size_t k = from + 1; k <= to; ++k) {
      const double sum = side.sums[k + width] - side.sums[k];
      if (sum > most) {
        most = sum;
        at = k;
      }
    }
    return at;
  };
  std::size_t from_a, to_a, from_b, to_b;
  range(request.center_a_hz, from_a, to_a);
  range(request.center_b_hz, from_b, to_b);
  Window w;
  w.width = width;
  w.first_a = largest(a_, from_a, to_a);
  w.first_b = largest(b_, from_b, to_b);
  // The two maxima are the best pair when the Doppler between them is allowed; otherwise all allowed pairs are tried.
  const double bin_hz = rate_ / static_cast<double>(size_);
  const auto low =
      static_cast<std::ptrdiff_t>(std::floor((request.doppler_center_hz - request.max_doppler_hz) / bin_hz - 0.5));
  const auto high =
      static_cast<std::ptrdiff_t>(std::ceil((request.doppler_center_hz + request.max_doppler_hz) / bin_hz + 0.5));
  const auto apart = static_cast<std::ptrdiff_t>(w.first_a) - static_cast<std::ptrdiff_t>(w.first_b);
  w.score = (excess(a_, w.first_a, width) + excess(b_, w.first_b, width)) / std::numbers::sqrt2;
  if ((apart >= low && apart <= high) || from_a == to_a || from_b == to_b || w.score < floor) return w;
  w.score = -1e300;
  for (std::size_t k = from_b; k <= to_b; ++k) {
    const auto first = std::max<std::ptrdiff_t>(static_cast<std::ptrdiff_t>(k) + low, 0);
    const auto last =
        std::min<std::ptrdiff_t>(static_cast<std::ptrdiff_t>(k) + high, static_cast<std::ptrdiff_t>(size_ - width));
    if (first > last) continue;
    const std::size_t at = largest(a_, static_cast<std::size_t>(first), static_cast<std::size_t>(last));
    const double score = (excess(a_, at, width) + excess(b_, k, width)) / std::numbers::sqrt2;
    if (score > w.score) w = {at, k, width, score};
  }
  return w;
}

BandFinder::Window BandFinder::search(const BandRequest& request) noexcept {
  const double bin_hz = rate_ / static_cast<double>(size_);
  if (request.bandwidth_hz > 0.0) {
    const double width = std::round(0.8 * request.bandwidth_hz / bin_hz);
    return best(request, static_cast<std::size_t>(std::clamp(width, 1.0, static_cast<double>(size_))), -1e300);
  }
  Window w;
  w.score = -1e300;
  for (std::size_t width = 3; width <= size_; width += std::max<std::size_t>(1, width / 6)) {
    const Window candidate = best(request, width, w.score);
    if (candidate.score > w.score) w = candidate;
  }
  return w;
}

BandFinder::Window BandFinder::search_twice(const BandRequest& request) noexcept {
  sum(a_, false, 0, 0);
  sum(b_, false, 0, 0);
  const Window first = search(request);
  sum(a_, true, first.first_a, first.width);
  sum(b_, true, first.first_b, first.width);
  return search(request);
}

double BandFinder::centroid(const Side& side, std::size_t first, std::size_t width) const noexcept {
  const std::size_t margin = width / 4 + 1;
  const std::size_t from = first > margin ? first - margin : 0;
  const std::size_t to = std::min(size_, first + width + margin);
  const double threshold = side.floor * (1.0 + 2.0 / std::sqrt(side.averages));
  double sum = 0.0, moment = 0.0;
  for (std::size_t k = from; k < to; ++k) {
    const double p = std::max(0.0, side.clean[k] - threshold);
    sum += p;
    moment += p * static_cast<double>(k);
  }
  return sum > 0.0 ? moment / sum : static_cast<double>(first) + 0.5 * static_cast<double>(width - 1);
}

Bands BandFinder::find(IqSpan a, IqSpan b, const BandRequest& request) noexcept {
  // A few segments show a strong signal; a weak one needs them all, and overlapped.
  Window w;
  for (int pass = 0; pass < 4; ++pass) {
    const std::size_t segments = a.size() / size_;
    const std::size_t step = pass < 2 ? std::max<std::size_t>(1, segments / (pass == 0 ? 16 : 64)) : 1;
    const std::size_t hop = pass == 3 ? size_ / 2 : size_;
    spectrum(a, request.power_a, step, hop, a_);
    spectrum(b, request.power_b, step, hop, b_);
    w = search_twice(request);
    if (w.score > (pass == 2 ? kEnough : kClear)) break;
  }
  Bands bands;
  bands.line_pair = lines_pair(request);
  if (request.bandwidth_hz <= 0.0 && w.score <= kSeen && bands.line_pair) {
    // Nothing but what looks like lines at this resolution: a narrow signal, unless the peak shows a tone.
    for (Side* side : {&a_, &b_}) std::copy(side->raw.begin(), side->raw.end(), side->clean.begin());
    w = search_twice(request);
  }
  bands.seen = request.bandwidth_hz > 0.0 || w.score > kSeen;
  const double bin_hz = rate_ / static_cast<double>(size_);
  if (request.bandwidth_hz > 0.0) {
    bands.bandwidth_hz = request.bandwidth_hz;
  } else if (w.score > kSeen) {
    // The best window ends where the spectrum has fallen to half; soft edges reach a third farther.
    bands.bandwidth_hz = std::min(rate_, 1.35 * static_cast<double>(w.width) * bin_hz + 2.0 * bin_hz);
  } else {
    bands.bandwidth_hz = rate_;
  }
  const auto center = [&](const Side& side, std::size_t first, double given) {
    if (std::isfinite(given)) return given;
    if (bands.bandwidth_hz > 0.8 * rate_) return 0.0;
    if (w.score > kCentroid) return frequency(centroid(side, first, w.width));
    return frequency(static_cast<double>(first) + 0.5 * static_cast<double>(w.width - 1));
  };
  bands.center_a_hz = center(a_, w.first_a, request.center_a_hz);
  bands.center_b_hz = center(b_, w.first_b, request.center_b_hz);
  bands.noise_a = a_.floor_known ? a_.floor : 0.0;
  bands.noise_b = b_.floor_known ? b_.floor : 0.0;
  return bands;
}

}  // namespace soopnav::dsp::detail
