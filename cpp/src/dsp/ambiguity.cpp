#include "soopnav/dsp/ambiguity.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "dsp/ambiguity_band.hpp"
#include "dsp/ambiguity_stage.hpp"
#include "dsp/kernels.hpp"

namespace soopnav::dsp {
namespace {

constexpr std::size_t kFewest = 64;    // samples left after decimation
constexpr double kOversampling = 1.7;  // of the occupied band, at least, after decimation
constexpr double kIdentical = 1e-9;    // power of the difference of two copies
constexpr std::size_t kLargestFactor = 4096;
constexpr double kLongestSearch = 1e10;  // operations, some 6 s: of a band that was not seen
constexpr int kRestages = 6;

[[noreturn]] void refuse(const char* name, double value, const char* rule) {
  std::ostringstream text;
  text << name << ": " << rule << " required, got " << value;
  throw std::invalid_argument(text.str());
}

void require(bool good, const char* name, double value, const char* rule) {
  if (!good) refuse(name, value, rule);
}

const AmbiguityOptions& checked(const AmbiguityOptions& o) {
  const auto finite = [](double x) { return std::isfinite(x); };
  require(finite(o.sample_rate_hz) && o.sample_rate_hz > 0.0, "sample_rate_hz", o.sample_rate_hz,
          "a finite number above 0");
  require(o.max_samples >= kFewest && o.max_samples <= (std::size_t{1} << 26), "max_samples",
          static_cast<double>(o.max_samples), "64 to 2^26 samples");
  const double duration = static_cast<double>(o.max_samples) / o.sample_rate_hz;
  require(finite(o.max_delay_s) && o.max_delay_s >= 0.0, "max_delay_s", o.max_delay_s, "a finite number of at least 0");
  require(finite(o.delay_center_s) && std::abs(o.delay_center_s) + o.max_delay_s < 0.9 * duration, "delay_center_s",
          o.delay_center_s, "with max_delay_s, less than 0.9 of the longest recording");
  require(finite(o.max_doppler_hz) && o.max_doppler_hz >= 0.0 && o.max_doppler_hz <= o.sample_rate_hz, "max_doppler_hz",
          o.max_doppler_hz, "0 to the sample rate");
  require(finite(o.doppler_center_hz) && std::abs(o.doppler_center_hz) <= o.sample_rate_hz, "doppler_center_hz",
          o.doppler_center_hz, "at most the sample rate");
  require(finite(o.bandwidth_hz) && o.bandwidth_hz >= 0.0 && o.bandwidth_hz <= o.sample_rate_hz, "bandwidth_hz",
          o.bandwidth_hz, "0 to the sample rate");
  for (const auto& [name, value] : {std::pair{"center_a_hz", o.center_a_hz}, std::pair{"center_b_hz", o.center_b_hz}}) {
    require(std::isnan(value) || std::abs(value) <= 0.5 * o.sample_rate_hz, name, value,
            "NaN or within half the sample rate");
  }
  require(finite(o.symbol_rate_hz) && o.symbol_rate_hz >= 0.0 && o.symbol_rate_hz <= o.sample_rate_hz, "symbol_rate_hz",
          o.symbol_rate_hz, "0 to the sample rate");
  require(o.rolloff >= 0.0 && o.rolloff <= 1.0, "rolloff", o.rolloff, "0 to 1");
  require(o.prefilter != AmbiguityPrefilter::kRootRaisedCosine || o.symbol_rate_hz > 0.0, "symbol_rate_hz",
          o.symbol_rate_hz, "for a root-raised-cosine prefilter a symbol rate above 0");
  require(o.false_alarm > 0.0 && o.false_alarm <= 0.5, "false_alarm", o.false_alarm, "above 0 up to 0.5");
  require(finite(o.carrier_hz) && o.carrier_hz >= 0.0, "carrier_hz", o.carrier_hz, "0 or a finite positive number");
  require(std::abs(o.tdoa_rate) <= 1e-2, "tdoa_rate", o.tdoa_rate, "a magnitude of at most 0.01");
  require(o.max_tdoa_rate >= 0.0 && o.max_tdoa_rate <= 1e-3, "max_tdoa_rate", o.max_tdoa_rate, "0 to 0.001");
  return o;
}

double occupied(const AmbiguityOptions& o) {
  if (o.bandwidth_hz > 0.0) return o.bandwidth_hz;
  return std::min(o.sample_rate_hz, (1.0 + o.rolloff) * o.symbol_rate_hz);
}

// The largest decimation that leaves the band its room and the recording its samples.
std::size_t factor_for(double rate_hz, double bandwidth_hz, std::size_t samples) {
  std::size_t best = 1;
  for (std::size_t factor = 2; factor <= kLargestFactor; factor += factor < 8 ? 1 : 4) {
    if (rate_hz / static_cast<double>(factor) >= kOversampling * bandwidth_hz && samples / factor >= 4 * kFewest) {
      best = factor;
    }
  }
  return best;
}

double slow_power(IqSpan x) noexcept {
  double sum = 0.0;
  for (const Cf32& s : x) sum += std::norm(std::complex<double>(s));
  return std::isfinite(sum) ? sum / static_cast<double>(x.size()) : -1.0;
}

// Mean power, negative when a sample is not finite. Sums stay short: a float loses small samples beside large ones.
double mean_power(IqSpan x) noexcept {
  constexpr std::size_t kChunk = 4096;
  double sum = 0.0;
  std::size_t i = 0;
  while (i + detail::kDotSamples <= x.size()) {
    const std::size_t n = std::min(kChunk, x.size() - i) / detail::kDotSamples * detail::kDotSamples;
    const Cf32 part = detail::dot(reinterpret_cast<const float*>(x.data() + i), x.data() + i, n);
    sum += static_cast<double>(part.real()) + static_cast<double>(part.imag());
    i += n;
  }
  for (; i < x.size(); ++i) sum += static_cast<double>(x[i].real() * x[i].real() + x[i].imag() * x[i].imag());
  const double mean = sum / static_cast<double>(x.size());
  // Squares near the ends of a float's range overflow or vanish.
  return mean > 1e-30 && mean < 1e30 ? mean : slow_power(x);
}

// Whether a = k b for one complex k.
bool same_samples(IqSpan a, IqSpan b) noexcept {
  std::complex<double> cross{};
  double power_a = 0.0, power_b = 0.0;
  std::size_t next = kFewest;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const std::complex<double> x(a[i]), y(b[i]);
    cross += std::complex<double>{x.real() * y.real() + x.imag() * y.imag(), x.imag() * y.real() - x.real() * y.imag()};
    power_a += std::norm(x);
    power_b += std::norm(y);
    if (i + 1 != next && i + 1 != a.size()) continue;
    if (power_a * power_b - std::norm(cross) > kIdentical * power_a * power_b) return false;
    next *= 8;
  }
  return power_a > 0.0 && power_b > 0.0;
}

}  // namespace

const char* to_string(AmbiguityStatus status) noexcept {
  switch (status) {
    case AmbiguityStatus::kOk:
      return "ok";
    case AmbiguityStatus::kNotDetected:
      return "not detected";
    case AmbiguityStatus::kTone:
      return "a tone: its delay cannot be seen";
    case AmbiguityStatus::kIdentical:
      return "identical recordings";
    case AmbiguityStatus::kTooShort:
      return "too short";
    case AmbiguityStatus::kTooLong:
      return "too long";
    case AmbiguityStatus::kLengthMismatch:
      return "recordings of different length";
    case AmbiguityStatus::kNotFinite:
      return "a sample is not finite";
    case AmbiguityStatus::kNoPower:
      return "a recording holds only zeros";
  }
  return "unknown";
}

struct CrossAmbiguity::Impl {
  explicit Impl(const AmbiguityOptions& given)
      : options(checked(given)),
        bandwidth_hz(occupied(options)),
        finder(options.sample_rate_hz, bandwidth_hz, options.max_samples) {
    if (bandwidth_hz > 0.0) {
      stages.push_back(std::make_unique<detail::AmbiguityStage>(
          options, factor_for(options.sample_rate_hz, bandwidth_hz, options.max_samples), bandwidth_hz));
    } else {
      stages.push_back(std::make_unique<detail::AmbiguityStage>(options, 1, options.sample_rate_hz));
      for (std::size_t factor = 2; factor <= kLargestFactor && options.max_samples / factor >= 4 * kFewest;
           factor *= 2) {
        stages.push_back(std::make_unique<detail::AmbiguityStage>(
            options, factor, options.sample_rate_hz / static_cast<double>(factor) / kOversampling));
      }
    }
    shortest = std::max(finder.min_samples(), kFewest * stages.front()->factor());
  }

  AmbiguityPeak measure(IqSpan a, IqSpan b) noexcept {
    AmbiguityPeak result;
    measured = nullptr;
    if (a.size() != b.size()) {
      result.status = AmbiguityStatus::kLengthMismatch;
      return result;
    }
    if (a.size() < shortest) return result;
    if (a.size() > options.max_samples) {
      result.status = AmbiguityStatus::kTooLong;
      return result;
    }
    const double power_a = mean_power(a), power_b = mean_power(b);
    if (power_a < 0.0 || power_b < 0.0) {
      result.status = AmbiguityStatus::kNotFinite;
      return result;
    }
    if (power_a == 0.0 || power_b == 0.0) {
      result.status = AmbiguityStatus::kNoPower;
      return result;
    }
    if (same_samples(a, b)) {
      result.status = AmbiguityStatus::kIdentical;
      result.coherence = 1.0;
      result.duration_s = static_cast<double>(a.size()) / options.sample_rate_hz;
      result.epoch_s = 0.5 * result.duration_s;
      return result;
    }

    detail::Bands bands = finder.find(a, b,
                                      {options.center_a_hz, options.center_b_hz, bandwidth_hz, options.max_doppler_hz,
                                       options.doppler_center_hz, power_a, power_b});
    bands.power_a = power_a;
    bands.power_b = power_b;
    detail::AmbiguityStage* stage = stage_for(bands.bandwidth_hz, a.size());
    result.duration_s = static_cast<double>(a.size()) / options.sample_rate_hz;
    result.epoch_s = 0.5 * result.duration_s;
    if (!bands.seen && stage->search_cost() > kLongestSearch) {
      result.status = AmbiguityStatus::kNotDetected;
      return result;
    }
    // A Doppler known better than the spectra show ties the two centres together.
    if (options.max_doppler_hz <= stage->doppler_reach_hz()) {
      const double middle = 0.5 * (bands.center_a_hz - options.doppler_center_hz + bands.center_b_hz);
      if (std::isfinite(options.center_a_hz) && std::isnan(options.center_b_hz)) {
        bands.center_b_hz = bands.center_a_hz - options.doppler_center_hz;
      } else {
        if (std::isnan(options.center_b_hz)) bands.center_b_hz = middle;
        bands.center_a_hz = bands.center_b_hz + options.doppler_center_hz;
      }
    }
    search(*stage, a, b, bands, result);
    // A band far wider than its signal says little of the delay, and nothing of its error: once more, about the signal.
    for (int pass = 0; pass < kRestages && bandwidth_hz <= 0.0 && result.detected() && stage->narrow(); ++pass) {
      bands.center_a_hz = result.center_a_hz + stage->narrow_center_hz();
      bands.center_b_hz = bands.center_a_hz - result.fdoa_hz;
      bands.bandwidth_hz = stage->narrow_band_hz();
      bands.noise_a = bands.noise_b = 0.0;
      stage = stage_for(bands.bandwidth_hz, a.size());
      search(*stage, a, b, bands, result);
    }
    if (result.detected() && (stage->line_like() || stage->narrow())) {
      result.status = AmbiguityStatus::kTone;
      result.sigma_tdoa_s = result.sigma_fdoa_hz = result.sigma_tdoa_rate = std::numeric_limits<double>::infinity();
    }
    return result;
  }

  // The coarsest stage that holds a band.
  [[nodiscard]] detail::AmbiguityStage* stage_for(double band_hz, std::size_t samples) const noexcept {
    detail::AmbiguityStage* stage = stages.front().get();
    for (const auto& candidate : stages) {
      const auto factor = static_cast<double>(candidate->factor());
      if (options.sample_rate_hz / factor >= kOversampling * band_hz && samples / candidate->factor() >= kFewest) {
        stage = candidate.get();
      }
    }
    return stage;
  }

  // The peak of one stage, with its status.
  void search(detail::AmbiguityStage& stage, IqSpan a, IqSpan b, const detail::Bands& bands,
              AmbiguityPeak& result) noexcept {
    stage.load(a, b, bands, options.doppler_center_hz - options.max_doppler_hz,
               options.doppler_center_hz + options.max_doppler_hz);

    const double duration = static_cast<double>(a.size()) / options.sample_rate_hz;
    detail::StagePeak best;
    double best_rate = options.tdoa_rate, best_ratio = -1.0;
    int trials = 0;
    if (options.estimate_rate) {
      // Half a resolution cell of stretch between trials.
      const double step = 0.7 / (std::min(bands.bandwidth_hz, options.sample_rate_hz) * duration);
      trials = static_cast<int>(std::min(200.0, std::ceil(options.max_tdoa_rate / step - 0.5)));
      for (int k = -trials; k <= trials; ++k) {
        const double rate = options.tdoa_rate + k * options.max_tdoa_rate / std::max(trials, 1);
        const detail::StagePeak peak = stage.search(rate);
        const double ratio = std::norm(peak.value) / peak.noise;
        if (ratio > best_ratio) {
          best_ratio = ratio;
          best_rate = rate;
        }
      }
    }
    best = stage.search(best_rate);
    const double ratio = std::norm(best.value) / best.noise;
    const double threshold = stage.threshold();
    measured = &stage;
    stage.refine(best, options.carrier_hz, result);
    result.snr_db = 10.0 * std::log10(std::max(ratio, 1e-30));
    result.threshold_db = 10.0 * std::log10(threshold);
    if (ratio > threshold && std::isfinite(result.sigma_tdoa_s) && std::isfinite(result.sigma_fdoa_hz)) {
      result.status = AmbiguityStatus::kOk;
    } else {
      result.status = stage.tone_pair() || bands.line_pair ? AmbiguityStatus::kTone : AmbiguityStatus::kNotDetected;
      result.sigma_tdoa_s = result.sigma_fdoa_hz = std::numeric_limits<double>::infinity();
    }
    if (result.status != AmbiguityStatus::kOk || !options.estimate_rate) {
      result.sigma_tdoa_rate = std::numeric_limits<double>::infinity();
    }
  }

  AmbiguityOptions options;
  double bandwidth_hz;
  detail::BandFinder finder;
  std::vector<std::unique_ptr<detail::AmbiguityStage>> stages;
  detail::AmbiguityStage* measured = nullptr;
  std::size_t shortest = kFewest;
};

CrossAmbiguity::CrossAmbiguity(const AmbiguityOptions& options) : impl_(std::make_unique<Impl>(options)) {}
CrossAmbiguity::~CrossAmbiguity() = default;
CrossAmbiguity::CrossAmbiguity(CrossAmbiguity&&) noexcept = default;
CrossAmbiguity& CrossAmbiguity::operator=(CrossAmbiguity&&) noexcept = default;

AmbiguityPeak CrossAmbiguity::measure(IqSpan a, IqSpan b) noexcept { return impl_->measure(a, b); }

bool CrossAmbiguity::surface(std::span<const double> delays_s, std::span<const double> doppler_hz,
                             std::span<double> out) noexcept {
  return impl_->measured != nullptr && impl_->measured->surface(delays_s, doppler_hz, out);
}

const AmbiguityOptions& CrossAmbiguity::options() const noexcept { return impl_->options; }
std::size_t CrossAmbiguity::min_samples() const noexcept { return impl_->shortest; }

}  // namespace soopnav::dsp
