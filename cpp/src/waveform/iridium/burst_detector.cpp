#include "soopnav/waveform/iridium/burst_detector.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <sstream>
#include <stdexcept>
#include <string_view>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/waveform/iridium/channel_plan.hpp"
#include "waveform/iridium/burst_gauge.hpp"
#include "waveform/iridium/detector_kernels.hpp"
#include "waveform/iridium/gamma_tail.hpp"

namespace soopnav::iridium {
namespace {

constexpr double kWindowS = 1e-3;   // of a spectrum, about
constexpr double kBandHz = 25e3;    // of a test
constexpr double kSpanS = 6e-3;     // of a test
constexpr double kCentreHz = 22e3;  // of the centre of gravity, to either side
constexpr double kLearnS = 64e-3;   // before the first test
constexpr double kMarginS = 3e-3;   // of samples around a candidate
constexpr double kToneHz = 6e3;
constexpr double kEdgeS = 0.25e-3;           // nearer to the stream's ends a signal is cut
constexpr double kLn2 = 0.6931471805599453;  // median of an exponential distribution of mean one
constexpr double kMedianSlope = 0.34657359;  // density of its logarithm at the median
constexpr float kStep = 0.004F;              // of a median
constexpr float kSlowStep = 0.0004F;         // of one below a candidate
constexpr float kMost = 1e4F;                // of a normalised power
constexpr double kFloorHz = 50e3;            // the floor is smoothed over
constexpr double kWideHz = 200e3;            // and held to this band's median
constexpr double kFloorCap = 1.25;           // times it at most
constexpr std::size_t kRefresh = 128;        // spectra between floors
constexpr std::size_t kResults = 1024, kCandidates = 256, kRecent = 64, kSegments = 16;

void require(bool holds, std::string_view name, double value, std::string_view rule) {
  if (holds) return;
  std::ostringstream message;
  message << name << " = " << value << " " << rule;
  throw std::invalid_argument(message.str());
}

int even_fft_size(double least) {
  int size = dsp::fast_fft_size(static_cast<int>(std::ceil(least)));
  while (size % 2 != 0) size = dsp::fast_fft_size(size + 1);
  return size;
}

struct Candidate {
  std::size_t bin = 0;                // where its mean was highest
  double level = 0.0;                 // that mean
  std::uint64_t first = 0, last = 0;  // spectra above the threshold
  bool matched = false;
};

}  // namespace

void DetectorOptions::check() const {
  require(sample_rate_hz >= 50e3 && sample_rate_hz <= 100e6, "sample_rate_hz", sample_rate_hz,
          "must be in 50e3 ... 100e6");
  require(std::isfinite(center_frequency_hz), "center_frequency_hz", center_frequency_hz, "must be finite");
  require(false_alarms_per_s >= 1e-9 && false_alarms_per_s <= 100.0, "false_alarms_per_s", false_alarms_per_s,
          "must be in 1e-9 ... 100");
  require(max_burst_s >= 0.02 && max_burst_s <= 1.0, "max_burst_s", max_burst_s, "must be in 0.02 ... 1");
  require(max_burst_s * sample_rate_hz <= 20e6, "max_burst_s", max_burst_s,
          "must be at most 20e6 samples at this sample_rate_hz");
}

struct BurstDetector::Impl {
  explicit Impl(const DetectorOptions& given)
      : options(given),
        size(static_cast<std::size_t>(even_fft_size(given.sample_rate_hz * kWindowS))),
        hop(size / 2),
        bin_hz(given.sample_rate_hz / static_cast<double>(size)),
        half_band(static_cast<std::size_t>(std::max(0.5 * kBandHz / bin_hz, 1.0))),
        span(static_cast<std::size_t>(std::lround(kSpanS * given.sample_rate_hz / static_cast<double>(hop)))),
        learn(static_cast<std::size_t>(std::lround(kLearnS * given.sample_rate_hz / static_cast<double>(hop)))),
        longest(static_cast<std::size_t>(given.max_burst_s * given.sample_rate_hz / static_cast<double>(hop)) + span),
        rows(std::max(longest + 4 * span, learn) + 8),
        gauge(given.sample_rate_hz, rows * hop),
        fft(static_cast<int>(size), dsp::FftDirection::kForward) {
    window.resize(size);
    double power = 0.0;
    for (std::size_t n = 0; n < size; ++n) {
      const double w = 0.5 - 0.5 * std::cos(kTwoPi * static_cast<double>(n) / static_cast<double>(size));
      window[n] = static_cast<float>(n % 2 == 0 ? w : -w);  // the sign puts 0 Hz in the spectrum's middle
      power += w * w;
    }
    window_power = power;
    ring.assign(rows * hop, Cf32{});
    gathered.assign(rows * hop, Cf32{});
    history.assign(rows * size, 0.0F);
    weighed.assign(size, Cf32{});
    spectrum.assign(size, Cf32{});
    median.assign(size, 0.0F);
    inverse.assign(size, 0.0F);
    floor.assign(size, 0.0F);
    step.assign(size, kStep);
    absorbed.assign(size, 0);
    sum.assign(size, 0.0F);
    prefix.assign(size + 1, 0.0);
    mean.assign(size, 0.0F);
    scratch.assign(std::max({size, learn, rows}), 0.0F);
    candidates.reserve(kCandidates);
    results.reserve(kResults);
    find_overlap();
    reset();
  }

  // Variance of the mean of a cell, in units of the mean's square, and independent bins of the smoothed floor.
  void find_overlap() {
    const double wide = static_cast<double>(2 * half_band + 1), deep = static_cast<double>(span);
    double total = 0.0, across = 0.0;
    for (int l = -1; l <= 1; ++l) {
      for (int m = -6; m <= 6; ++m) {
        double re = 0.0, im = 0.0;
        for (std::size_t n = l == 0 ? 0 : hop; n < size; ++n) {
          const double w = std::abs(static_cast<double>(window[n])),
                       v = std::abs(static_cast<double>(window[l == 0 ? n : n - hop]));
          const double angle = kTwoPi * m * static_cast<double>(n) / static_cast<double>(size);
          re += w * v * std::cos(angle);
          im += w * v * std::sin(angle);
        }
        const double c2 = (re * re + im * im) / (window_power * window_power);
        if (std::abs(m) < wide && std::abs(l) < deep) total += (wide - std::abs(m)) * (deep - std::abs(l)) * c2;
        if (l == 0) across += c2;
      }
    }
    variance = total / (wide * wide * deep * deep);
    floor_bins = std::max(kFloorHz / bin_hz / across, 1.0);
  }

  void reset() {
    taken = rejected = dropped_count = frames = 0;
    learnt = false;
    threshold = 0.0;
    candidates.clear();
    recent_count = 0;
    std::fill(step.begin(), step.end(), kStep);
    std::fill(absorbed.begin(), absorbed.end(), std::uint8_t{0});
  }

  [[nodiscard]] float* row(std::uint64_t frame) { return history.data() + (frame % rows) * size; }

  void push(IqSpan samples) {
    const std::uint64_t capacity = ring.size();
    while (!samples.empty()) {
      // To the end of the hop: then there may be a spectrum.
      const std::size_t room = hop - static_cast<std::size_t>(taken % hop);
      const std::size_t count = std::min(room, samples.size());
      Cf32* const to = ring.data() + taken % capacity;  // hops do not straddle the ring's end
      rejected += kernels::copy_finite(samples.data(), count, to);
      taken += count;
      samples = samples.subspan(count);
      if (taken % hop == 0 && taken >= size) add_spectrum();
    }
  }

  void add_spectrum() {
    const std::uint64_t start = frames * hop;
    const Cf32* const early = ring.data() + start % ring.size();
    const Cf32* const late = ring.data() + (start + hop) % ring.size();
    kernels::weigh(early, window.data(), hop, weighed.data());
    kernels::weigh(late, window.data() + hop, hop, weighed.data() + hop);
    fft.execute(weighed.data(), spectrum.data());
    kernels::square(spectrum.data(), size, row(frames));
    ++frames;
    if (learnt) {
      test(frames - 1);
    } else if (frames == learn) {
      start_testing();
    }
  }

  // The noise from the spectra so far, which are then tested.
  void start_testing() {
    if (frames < 8) return;
    for (std::size_t k = 0; k < size; ++k) {
      for (std::uint64_t f = 0; f < frames; ++f) scratch[f] = row(f)[k];
      const auto middle = scratch.begin() + static_cast<std::ptrdiff_t>(frames / 2);
      std::nth_element(scratch.begin(), middle, scratch.begin() + static_cast<std::ptrdiff_t>(frames));
      median[k] = *middle;
    }
    // An uneven share of silence, as before a receiver starts, must not end in divisions by zero.
    const float loudest = *std::max_element(median.begin(), median.end());
    for (float& m : median) m = std::max(m, 1e-9F * loudest + 1e-30F);
    learnt = true;
    refresh_floor();
    const double floor_variance = 1.0 / (4.0 * kMedianSlope * kMedianSlope * static_cast<double>(frames) * floor_bins);
    const double tests = static_cast<double>(size) * options.sample_rate_hz / static_cast<double>(hop);
    threshold = gamma_tail_quantile(1.0 / (variance + floor_variance), options.false_alarms_per_s / tests);
    std::fill(sum.begin(), sum.end(), 0.0F);
    const std::uint64_t until = frames;
    for (frames = 0; frames < until;) {
      ++frames;
      test(frames - 1);
    }
  }

  // Medians, smoothed: a bin counts with no more than 1.25 times the median of the bins around it, unless it holds a
  // tone that stayed.
  void refresh_floor() {
    const auto wide = static_cast<std::size_t>(std::max(0.5 * kWideHz / bin_hz, 2.0));
    const auto near = static_cast<std::size_t>(std::max(0.5 * kFloorHz / bin_hz, 1.0));
    const std::size_t block = 2 * near;
    prefix[0] = 0.0;
    for (std::size_t first = 0; first < size; first += block) {
      const std::size_t from = first > wide ? first - wide : 0, to = std::min(size, first + block + wide);
      std::copy(median.begin() + static_cast<std::ptrdiff_t>(from), median.begin() + static_cast<std::ptrdiff_t>(to),
                scratch.begin());
      const auto middle = scratch.begin() + static_cast<std::ptrdiff_t>((to - from) / 2);
      std::nth_element(scratch.begin(), middle, scratch.begin() + static_cast<std::ptrdiff_t>(to - from));
      const float most = static_cast<float>(kFloorCap) * *middle;
      for (std::size_t k = first; k < std::min(size, first + block); ++k) {
        prefix[k + 1] = prefix[k] + static_cast<double>(std::min(median[k], most));
      }
    }
    for (std::size_t k = 0; k < size; ++k) {
      const std::size_t from = k > near ? k - near : 0, to = std::min(size, k + near + 1);
      double value = (prefix[to] - prefix[from]) / static_cast<double>(to - from);
      if (absorbed[k] != 0) {
        absorbed[k] = static_cast<double>(median[k]) > 1.5 * value ? 1 : 0;
        value = std::max(value, static_cast<double>(median[k]));
      }
      floor[k] = static_cast<float>(value / kLn2);
      inverse[k] = 1.0F / floor[k];
    }
  }

  void test(std::uint64_t frame) {
    float* const fresh = row(frame);
    kernels::normalise(fresh, inverse.data(), kMost, median.data(), step.data(), size);
    if (frame < span) {
      for (std::size_t k = 0; k < size; ++k) sum[k] += fresh[k];
    } else if (frame % kRefresh == 0) {  // anew, so that rounding does not pile up
      refresh_floor();
      std::copy_n(fresh, size, sum.begin());
      for (std::size_t l = 1; l < span; ++l) {
        const float* const old = row(frame - l);
        for (std::size_t k = 0; k < size; ++k) sum[k] += old[k];
      }
    } else {
      kernels::slide(sum.data(), fresh, row(frame - span), size);
    }
    if (frame + 1 < span) return;

    const std::size_t wide = 2 * half_band + 1;
    double running = 0.0;
    for (std::size_t k = 0; k < size; ++k) {
      running += static_cast<double>(sum[k]);
      prefix[k + 1] = running;
    }
    const double scale = 1.0 / static_cast<double>(wide * span), limit = threshold / scale;
    bool any = false;
    for (std::size_t k = half_band; k + half_band < size; ++k) {
      const double box = prefix[k + half_band + 1] - prefix[k - half_band];
      any |= box > limit;
      mean[k] = static_cast<float>(box);
    }
    if (any || !candidates.empty()) follow(frame, limit, scale);
  }

  void follow(std::uint64_t frame, double limit, double scale) {
    const std::size_t first = half_band, last = size - half_band;  // tested: first <= k < last
    for (Candidate& c : candidates) c.matched = static_cast<double>(mean[c.bin]) > limit;
    for (std::size_t k = first; k < last; ++k) {
      if (!(static_cast<double>(mean[k]) > limit)) continue;
      const std::size_t from = std::max(first, k > half_band ? k - half_band : 0),
                        to = std::min(last, k + half_band + 1);
      bool highest = true;
      for (std::size_t j = from; j < to && highest; ++j) highest = mean[j] < mean[k] || (mean[j] == mean[k] && j >= k);
      if (!highest) continue;
      const double level = static_cast<double>(mean[k]) * scale;
      Candidate* own = nullptr;
      for (Candidate& c : candidates) {
        const std::size_t apart = c.bin > k ? c.bin - k : k - c.bin;
        if (apart > 2 * half_band) continue;  // a tone's mean is as high anywhere in 25 kHz
        if (own == nullptr || apart < (own->bin > k ? own->bin - k : k - own->bin)) own = &c;
      }
      if (own == nullptr) {
        if (candidates.size() == kCandidates) {
          ++dropped_count;
          continue;
        }
        own = &candidates.emplace_back(Candidate{k, level, frame, frame, true});
      }
      own->matched = true;
      if (level > own->level) {
        own->level = level;
        own->bin = k;
      }
    }
    std::fill(step.begin(), step.end(), kStep);
    for (std::size_t i = 0; i < candidates.size();) {
      Candidate& c = candidates[i];
      if (c.matched) c.last = frame;
      if (c.matched && frame - c.first < longest) {
        const std::size_t from = c.bin > 2 * half_band ? c.bin - 2 * half_band : 0;
        const std::size_t to = std::min(size, c.bin + 2 * half_band);
        std::fill(step.begin() + static_cast<std::ptrdiff_t>(from), step.begin() + static_cast<std::ptrdiff_t>(to),
                  kSlowStep);
        ++i;
        continue;
      }
      const Candidate closed = c;
      candidates.erase(candidates.begin() +
                       static_cast<std::ptrdiff_t>(i));  // in order: the earliest is measured first
      measure(closed, closed.matched);
      if (closed.matched) absorb(closed, frame);
    }
  }

  // A signal that stays becomes noise where it stands out: the medians take its power, and so do the spectra kept.
  void absorb(const Candidate& c, std::uint64_t frame) {
    const std::size_t from = c.bin > 2 * half_band ? c.bin - 2 * half_band : 0;
    const std::size_t to = std::min(size, c.bin + 2 * half_band + 1);
    const std::uint64_t count = std::min<std::uint64_t>(frame + 1, rows);
    for (std::size_t k = from; k < to; ++k) {
      double power = 0.0;
      for (std::size_t l = 0; l < span; ++l)
        power += static_cast<double>(row(frame - l)[k]) / static_cast<double>(span);
      if (power < 2.0) continue;
      const auto change = static_cast<float>(1.0 / power);
      absorbed[k] = 1;
      median[k] = static_cast<float>(static_cast<double>(floor[k]) * power * kLn2);
      floor[k] /= change;
      inverse[k] *= change;
      sum[k] *= change;
      for (std::uint64_t l = 0; l < count; ++l) row(frame - l)[k] *= change;
    }
  }

  // The middle of the power above the noise around a bin, in bins.
  double centre_of(const Candidate& c, std::uint64_t from, std::uint64_t to) {
    const auto reach = static_cast<std::size_t>(kCentreHz / bin_hz);
    std::size_t middle = c.bin;
    double centre = static_cast<double>(c.bin);
    for (int round = 0; round < 3; ++round) {
      const std::size_t first = middle > reach ? middle - reach : 0, last = std::min(size - 1, middle + reach);
      std::fill(scratch.begin() + static_cast<std::ptrdiff_t>(first),
                scratch.begin() + static_cast<std::ptrdiff_t>(last) + 1, 0.0F);
      for (std::uint64_t f = from; f <= to; ++f) {
        const float* const power = row(f);
        for (std::size_t k = first; k <= last; ++k) scratch[k] += power[k];
      }
      const double noise = static_cast<double>(to - from + 1);
      double total = 0.0, moment = 0.0;
      for (std::size_t k = first; k <= last; ++k) {
        const double excess = std::max(static_cast<double>(scratch[k]) - noise, 0.0);
        total += excess;
        moment += excess * static_cast<double>(k);
      }
      if (!(total > 0.0)) break;
      // No further than the test's own width: beyond lies another signal.
      const double reach_bins = 1.25 * static_cast<double>(half_band), from_bin = static_cast<double>(c.bin);
      centre = std::clamp(moment / total, std::max(from_bin - reach_bins, 0.0),
                          std::min(from_bin + reach_bins, static_cast<double>(size - 1)));
      const auto next = static_cast<std::size_t>(std::lround(centre));
      if (next == middle) break;
      middle = next;
    }
    return centre;
  }

  void measure(const Candidate& c, bool goes_on) {
    const std::uint64_t oldest = frames > rows ? frames - rows : 0;
    const std::uint64_t from = std::max<std::uint64_t>(c.first + 1 > span ? c.first + 1 - span : 0, oldest);
    const std::uint64_t to = std::min<std::uint64_t>(c.last, frames - 1);
    // A mean of `span` spectra first rises above the threshold when so many of them hold the signal, and falls below it
    // when as few are left: the carrier is sought in the spectra that do, as others may hold a neighbour.
    const double share = std::clamp((threshold - 1.0) / std::max(c.level - 1.0, 1e-3), 0.0, 1.0);
    const auto needed = static_cast<std::uint64_t>(std::ceil(share * static_cast<double>(span)));
    const bool early = c.first < span, late = goes_on || c.last + 1 >= frames;
    const std::uint64_t held_from = early ? from : std::max(from, c.first + 1 - std::max<std::uint64_t>(needed, 1));
    const std::uint64_t held_to = late ? to : std::min(to, std::max(held_from, c.last + needed - span));
    const double centre = centre_of(c, held_from, held_to);
    const double baseband = (centre - static_cast<double>(size / 2)) * bin_hz;
    const auto bin = std::min(size - 1, static_cast<std::size_t>(centre));

    const auto margin = static_cast<std::uint64_t>(kMarginS * options.sample_rate_hz);
    const std::uint64_t kept = taken > ring.size() - hop ? taken - (ring.size() - hop) : 0;
    const std::uint64_t begin = std::max(kept, from * hop > margin ? from * hop - margin : 0);
    const std::uint64_t end = std::min(taken, to * hop + size + margin);
    if (end <= begin) return;
    const auto count = static_cast<std::size_t>(end - begin);
    const auto at = static_cast<std::size_t>(begin % ring.size());
    const std::size_t head = std::min(count, ring.size() - at);
    std::copy_n(ring.data() + at, head, gathered.data());
    std::copy_n(ring.data(), count - head, gathered.data() + head);

    const double noise_power = static_cast<double>(floor[bin]) / window_power;
    std::array<GaugedSignal, kSegments> found;
    const std::size_t n = gauge.measure({gathered.data(), count}, baseband, noise_power, c.level, found);
    const double rate = options.sample_rate_hz;
    for (std::size_t i = 0; i < n; ++i) {
      const GaugedSignal& g = found[i];
      DetectedBurst burst;
      burst.start_s = (static_cast<double>(begin) + g.begin) / rate;
      const double end_s = (static_cast<double>(begin) + g.end) / rate;
      burst.duration_s = end_s - burst.start_s;
      burst.frequency_hz = options.center_frequency_hz + g.frequency_hz;
      burst.frequency_sigma_hz = g.frequency_sigma_hz;
      burst.bandwidth_hz = g.bandwidth_hz;
      burst.snr_db = 10.0 * std::log10(g.snr);
      burst.fine_frequency = g.fine_frequency;
      burst.cut_start = burst.start_s < kEdgeS;
      // A signal that goes on ends with the newest samples.
      burst.cut_end =
          (goes_on || ended) && static_cast<double>(taken) / rate - end_s < kEdgeS + (goes_on ? 2.0 * kWindowS : 0.0);
      burst.kind = burst.bandwidth_hz < kToneHz             ? SignalClass::kTone
                   : burst.duration_s > options.max_burst_s ? SignalClass::kContinuous
                                                            : SignalClass::kBurst;
      report(burst, g.frequency_hz);
    }
  }

  // Unless it was reported already: candidates that drift apart end in the same signal.
  void report(const DetectedBurst& burst, double) {
    const double end_s = burst.start_s + burst.duration_s;
    for (std::size_t i = 0; i < std::min(recent_count, kRecent); ++i) {
      const DetectedBurst& r = recent[i];
      const double overlap = std::min(end_s, r.start_s + r.duration_s) - std::max(burst.start_s, r.start_s);
      if (overlap > 0.5 * std::min(burst.duration_s, r.duration_s) &&
          std::abs(burst.frequency_hz - r.frequency_hz) < 0.5 * kBandHz) {
        return;
      }
    }
    recent[recent_count++ % kRecent] = burst;
    if (results.size() == kResults) {
      ++dropped_count;
      return;
    }
    results.push_back(burst);
  }

  void flush() {
    if (!learnt) start_testing();
    ended = true;
    for (const Candidate& c : candidates) measure(c, false);
    ended = false;
    const std::uint64_t kept_dropped = dropped_count, kept_rejected = rejected;
    const double kept_threshold = threshold;
    reset();
    dropped_count = kept_dropped;
    rejected = kept_rejected;
    threshold = kept_threshold;
  }

  DetectorOptions options;
  std::size_t size, hop;
  double bin_hz;
  std::size_t half_band, span, learn, longest, rows;
  BurstGauge gauge;
  dsp::Fft fft;
  double window_power = 0.0, variance = 0.0, floor_bins = 1.0, threshold = 0.0;
  std::vector<float> window, history, median, inverse, floor, step, sum, mean, scratch;
  std::vector<std::uint8_t> absorbed;
  std::vector<double> prefix;
  std::vector<Cf32> ring, gathered, weighed, spectrum;
  std::vector<Candidate> candidates;
  std::vector<DetectedBurst> results;
  std::array<DetectedBurst, kRecent> recent{};
  std::size_t recent_count = 0;
  std::uint64_t taken = 0, rejected = 0, dropped_count = 0, frames = 0;
  bool learnt = false, ended = false;
};

BurstDetector::BurstDetector(const DetectorOptions& options) {
  options.check();
  impl_ = std::make_unique<Impl>(options);
}
BurstDetector::~BurstDetector() = default;
BurstDetector::BurstDetector(BurstDetector&&) noexcept = default;
BurstDetector& BurstDetector::operator=(BurstDetector&&) noexcept = default;

std::span<const DetectedBurst> BurstDetector::push(IqSpan samples) noexcept {
  impl_->results.clear();
  impl_->push(samples);
  return impl_->results;
}

std::span<const DetectedBurst> BurstDetector::flush() noexcept {
  impl_->results.clear();
  impl_->flush();
  return impl_->results;
}

void BurstDetector::reset() noexcept {
  impl_->results.clear();
  impl_->reset();
}

const DetectorOptions& BurstDetector::options() const noexcept { return impl_->options; }
std::uint64_t BurstDetector::samples() const noexcept { return impl_->taken; }
std::uint64_t BurstDetector::rejected_samples() const noexcept { return impl_->rejected; }
std::uint64_t BurstDetector::dropped() const noexcept { return impl_->dropped_count; }
double BurstDetector::threshold() const noexcept { return impl_->threshold; }
double BurstDetector::bin_width_hz() const noexcept { return impl_->bin_hz; }

}  // namespace soopnav::iridium
