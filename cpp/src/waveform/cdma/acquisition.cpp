#include "soopnav/waveform/cdma/acquisition.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/dsp/detection.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/waveform/tracking/loop.hpp"
#include "waveform/tracking/correlator.hpp"

namespace soopnav::cdma {
namespace {

void require_search(bool holds, const char* name, double value, const char* rule) {
  if (!holds) throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " " + rule);
}

double modulo(double value, double period) noexcept { return value - period * std::floor(value / period); }

}  // namespace

std::size_t offset_candidates(double delay_s, double start_s, double start_error_s, double max_travel_s,
                              std::span<int> out) noexcept {
  std::size_t count = 0;
  for (int k = 0; k < kOffsets; ++k) {
    // Travel time if it were this one, as near to the allowed interval as whole periods bring it.
    double travel = modulo(delay_s + start_s - k * kOffsetS + start_error_s, kCodePeriodS) - start_error_s;
    if (!(travel <= max_travel_s + start_error_s)) continue;
    if (count < out.size()) out[count] = k;
    ++count;
  }
  return count;
}

struct PilotSearcher::Impl {
  AcquisitionOptions o;
  std::size_t block;         // samples
  double period;             // samples of a code
  std::size_t lags;          // delays searched
  int size;                  // of transforms
  std::size_t step;          // bins between Dopplers
  int reach;                 // Dopplers -reach ... reach
  bool keep_spectra = true;  // of all blocks, or the powers of all Dopplers: whichever are fewer
  std::size_t cell_count;
  double cell_probability, limit;
  dsp::Fft forward, inverse;
  tracking::CodeTable code;
  std::vector<Cf32> replica, spectra, work, product;
  std::vector<float> power, best;
  std::vector<int> best_doppler;
  std::vector<float> weights;
  std::vector<Acquisition> found;

  static int transform_size(double period, std::size_t block) {
    return dsp::fast_fft_size(static_cast<int>(std::ceil(period)) + static_cast<int>(block) + 1);
  }

  explicit Impl(const AcquisitionOptions& options)
      : o(options),
        block(static_cast<std::size_t>(std::llround(o.coherent_s * o.sample_rate_hz))),
        period(kCodePeriodS * o.sample_rate_hz),
        lags(static_cast<std::size_t>(std::ceil(period - 1e-6))),
        size(transform_size(period, block)),
        step(std::max<std::size_t>(1, static_cast<std::size_t>(0.5 * size / static_cast<double>(block)))),
        reach(
            static_cast<int>(std::ceil(o.max_doppler_hz * size / o.sample_rate_hz / static_cast<double>(step) - 1e-9))),
        forward(size, dsp::FftDirection::kForward),
        inverse(size, dsp::FftDirection::kInverse),
        code(pilot_code(0), 1.01 * kChipRateHz / o.sample_rate_hz) {
    const auto points = static_cast<std::size_t>(size);
    replica.assign(points, {});
    const std::vector<Cf32> chips = pilot_code(0);
    for (std::size_t m = 0; m < lags + block && m < points; ++m) {
      const auto chip =
          static_cast<std::size_t>(std::floor((static_cast<double>(m)) * kChipRateHz / o.sample_rate_hz + 1e-9));
      replica[m] = chips[chip % kCodeLength];
    }
    std::vector<Cf32> spectrum(points);
    forward.execute(replica.data(), spectrum.data());
    replica = std::move(spectrum);
    const auto rows = static_cast<std::size_t>(2 * reach + 1);
    keep_spectra = o.noncoherent <= rows;
    spectra.assign(points * (keep_spectra ? o.noncoherent : 1), {});
    work.assign(points, {});
    product.assign(points, {});
    power.assign(lags * (keep_spectra ? 1 : rows), 0.0F);
    best.assign(lags, 0.0F);
    best_doppler.assign(lags, 0);
    weights.assign(keep_spectra ? o.noncoherent : 0, 0.0F);
    found.reserve(o.max_pilots);
    cell_count = std::min(lags, 2 * kCodeLength) * static_cast<std::size_t>(2 * reach + 1);
    cell_probability = dsp::cell_false_alarm(o.false_alarm_probability, static_cast<double>(cell_count));
    limit = dsp::detection_threshold(static_cast<int>(o.noncoherent), cell_probability);
  }

  [[nodiscard]] double bin_hz() const noexcept { return static_cast<double>(step) * o.sample_rate_hz / size; }

  // Adds block k's powers of all delays at one Doppler.
  void add_powers(int number, std::size_t k, const Cf32* x, float scale, float* to) noexcept {
    const auto points = static_cast<std::size_t>(size);
    const auto shift =
        static_cast<std::size_t>((static_cast<long>(number) * static_cast<long>(step) % size + size) % size);
    for (std::size_t f = 0; f < points; ++f) {
      const Cf32 a = x[f + shift < points ? f + shift : f + shift - points];
      const Cf32 b = replica[f];
      product[f] = {a.real() * b.real() + a.imag() * b.imag(), a.real() * b.imag() - a.imag() * b.real()};
    }
    inverse.execute(product.data(), work.data());
    // Delay i: the code's phase at the block's begin is k * block - i samples.
    const double begin = static_cast<double>(k * block);
    for (std::size_t i = 0; i < lags; ++i) {
      auto s = static_cast<std::size_t>(std::lround(modulo(begin - static_cast<double>(i), period)));
      if (s >= lags) s = 0;
      to[i] += std::norm(work[s]) * scale;
    }
  }

  // Spectrum of block k without its carrier, scaled to unit power: nullptr where it has none or is not finite.
  const Cf32* spectrum_of(IqSpan samples, std::size_t k, float& scale) noexcept {
    const auto points = static_cast<std::size_t>(size);
    std::fill(work.begin(), work.end(), Cf32{});
    double energy = 0.0;
    for (std::size_t n = 0; n < block; ++n) {
      const Cf32 x = samples[k * block + n];
      energy += static_cast<double>(x.real()) * static_cast<double>(x.real()) +
                static_cast<double>(x.imag()) * static_cast<double>(x.imag());
      work[n] = x;
    }
    if (!(energy > 0.0 && energy < 1e30)) return nullptr;
    if (o.intermediate_hz != 0.0) {
      for (std::size_t n = 0; n < block; ++n) {
        const double turn = modulo(o.intermediate_hz * static_cast<double>(n) / o.sample_rate_hz, 1.0);
        work[n] *= Cf32(std::polar(1.0, -kTwoPi * turn));
      }
    }
    Cf32* const to = spectra.data() + (keep_spectra ? k * points : 0);
    forward.execute(work.data(), to);
    scale = static_cast<float>(1.0 / (energy * static_cast<double>(points) * static_cast<double>(points)));
    return to;
  }

  void keep_best(int number, const float* from) noexcept {
    for (std::size_t i = 0; i < lags; ++i) {
      if (from[i] <= best[i]) continue;
      best[i] = from[i];
      best_doppler[i] = number;
    }
  }

  // Delay, Doppler and C/N0 from correlations of half blocks, early, prompt and late.
  Acquisition refine(IqSpan samples, std::size_t lag, int number, double statistic) const noexcept {
    Acquisition a;
    a.statistic = statistic;
    double doppler = number * bin_hz();
    double delay = static_cast<double>(lag) / o.sample_rate_hz;
    const double interval = static_cast<double>(block) / o.sample_rate_hz;
    const double half_chip = std::min(0.25, 0.5 * kChipRateHz / o.sample_rate_hz + 0.1);
    double ratio_sum = 0.0;
    for (int pass = 0; pass < 4; ++pass) {
      std::complex<double> turn{};
      double code_error = 0.0, energy = 0.0;
      ratio_sum = 0.0;
      for (std::size_t k = 0; k < o.noncoherent; ++k) {
        std::array<tracking::Sums, 2> sums{};
        for (std::size_t half = 0; half < 2; ++half) {
          const std::size_t from = k * block + half * (block / 2),
                            to = half == 0 ? k * block + block / 2 : (k + 1) * block;
          for (std::size_t n = from; n < to; n += tracking::kRun) {
            const std::size_t count = std::min(tracking::kRun, to - n);
            const double t = static_cast<double>(n) / o.sample_rate_hz;
            const double rate = kChipRateHz * (1.0 + doppler / o.carrier_hz);
            std::uint32_t bad = 0;
            sums[half] += tracking::correlate(samples.data() + n, count, code, (o.intermediate_hz + doppler) * t,
                                              (o.intermediate_hz + doppler) / o.sample_rate_hz,
                                              rate * t - kChipRateHz * delay, rate / o.sample_rate_hz, half_chip, bad);
          }
        }
        turn += sums[1].prompt * std::conj(sums[0].prompt);
        tracking::Sums all = sums[0];
        all += sums[1];
        code_error += ((all.early - all.late) * std::conj(all.prompt)).real();
        energy += std::norm(all.prompt);
        const auto n = static_cast<double>(block);
        const double ratio = std::norm(all.prompt) / all.power;
        ratio_sum += (ratio - 1.0) / std::max(1.0 - ratio / n, 0.01);
      }
      if (pass == 3) break;
      doppler += std::arg(turn) / (kPi * interval);
      delay -= std::clamp(0.5 * code_error / energy, -0.5, 0.5) / kChipRateHz;
    }
    const auto blocks = static_cast<double>(o.noncoherent);
    const double snr = std::max(ratio_sum / blocks, 1e-3);
    const double cn0 = snr / interval;
    a.delay_s = modulo(delay, kCodePeriodS);
    a.doppler_hz = doppler;
    a.cn0_dbhz = 10.0 * std::log10(cn0);
    a.sigma_cn0_db = 10.0 / std::log(10.0) * std::sqrt((1.0 + 2.0 * snr) / blocks) / snr;
    a.sigma_doppler_hz = std::sqrt(2.0 / (snr * blocks) * (1.0 + 1.0 / snr)) / (kPi * interval);
    // Rectangular edges are seen on the grid of samples; at a whole number of them a chip nothing averages that.
    const double grid = 0.3 / o.sample_rate_hz;
    a.sigma_delay_s =
        std::sqrt(tracking::code_variance(cn0, interval * blocks, interval, 2.0 * half_chip)) / kChipRateHz + grid;
    a.pn_offset = static_cast<int>(std::floor(a.delay_s / kOffsetS)) % kOffsets;
    a.excess_s = a.delay_s - a.pn_offset * kOffsetS;
    return a;
  }

  std::span<const Acquisition> search(IqSpan samples) noexcept {
    found.clear();
    if (samples.size() < block * o.noncoherent) return {};
    samples = samples.first(block * o.noncoherent);
    std::fill(best.begin(), best.end(), 0.0F);
    std::fill(power.begin(), power.end(), 0.0F);
    if (keep_spectra) {
      const auto points = static_cast<std::size_t>(size);
      for (std::size_t k = 0; k < o.noncoherent; ++k) {
        if (spectrum_of(samples, k, weights[k]) == nullptr) return {};
      }
      for (int number = -reach; number <= reach; ++number) {
        std::fill(power.begin(), power.end(), 0.0F);
        for (std::size_t k = 0; k < o.noncoherent; ++k) {
          add_powers(number, k, spectra.data() + k * points, weights[k], power.data());
        }
        keep_best(number, power.data());
      }
    } else {
      const auto row = [&](int number) { return power.data() + static_cast<std::size_t>(number + reach) * lags; };
      for (std::size_t k = 0; k < o.noncoherent; ++k) {
        float weight = 0.0F;
        const Cf32* const spectrum = spectrum_of(samples, k, weight);
        if (spectrum == nullptr) return {};
        for (int number = -reach; number <= reach; ++number) add_powers(number, k, spectrum, weight, row(number));
      }
      for (int number = -reach; number <= reach; ++number) keep_best(number, row(number));
    }
    const auto guard = static_cast<std::size_t>(std::ceil(1.5 * o.sample_rate_hz / kChipRateHz));
    while (found.size() < o.max_pilots) {
      const auto top = std::max_element(best.begin(), best.end());
      if (!(static_cast<double>(*top) > limit)) break;
      const auto lag = static_cast<std::size_t>(top - best.begin());
      found.push_back(refine(samples, lag, best_doppler[lag], static_cast<double>(*top)));
      for (std::size_t i = 0; i <= 2 * guard; ++i) best[(lag + lags + i - guard) % lags] = 0.0F;
    }
    return found;
  }
};

namespace {

AcquisitionOptions checked(const AcquisitionOptions& o) {
  require_search(o.sample_rate_hz >= kChipRateHz && o.sample_rate_hz <= 1e8, "sample_rate_hz", o.sample_rate_hz,
                 "must be in [1.2288e6, 1e8]");
  require_search(std::abs(o.intermediate_hz) <= 0.5 * o.sample_rate_hz, "intermediate_hz", o.intermediate_hz,
                 "must be within half the sampling rate");
  // Lower, what the refinement adds to a Doppler could move the code by more than its table has room for.
  require_search(o.carrier_hz >= 1e8 && std::isfinite(o.carrier_hz), "carrier_hz", o.carrier_hz,
                 "must be finite, at least 1e8");
  require_search(o.coherent_s * kChipRateHz >= 64.0 && o.coherent_s <= kCodePeriodS * (1.0 + 1e-9), "coherent_s",
                 o.coherent_s, "must be at least 64 chips and at most a code period");
  require_search(o.noncoherent >= 1 && o.noncoherent <= 10'000, "noncoherent", static_cast<double>(o.noncoherent),
                 "must be in [1, 10000]");
  require_search(o.false_alarm_probability > 0.0 && o.false_alarm_probability <= 0.1, "false_alarm_probability",
                 o.false_alarm_probability, "must be in (0, 0.1]");
  require_search(o.max_pilots >= 1 && o.max_pilots <= 10'000, "max_pilots", static_cast<double>(o.max_pilots),
                 "must be in [1, 10000]");
  const double drift =
      o.max_doppler_hz / o.carrier_hz * kChipRateHz * o.coherent_s * static_cast<double>(o.noncoherent);
  require_search(o.max_doppler_hz >= 0.0 && o.max_doppler_hz <= 0.25 * o.sample_rate_hz && drift <= 0.5,
                 "max_doppler_hz", o.max_doppler_hz,
                 "must be at most a quarter of the rate, and move the code by at most half a chip in a search");
  return o;
}

}  // namespace

PilotSearcher::PilotSearcher(const AcquisitionOptions& options) : impl_(std::make_unique<Impl>(checked(options))) {}
PilotSearcher::~PilotSearcher() = default;
PilotSearcher::PilotSearcher(PilotSearcher&&) noexcept = default;
PilotSearcher& PilotSearcher::operator=(PilotSearcher&&) noexcept = default;

const AcquisitionOptions& PilotSearcher::options() const noexcept { return impl_->o; }
std::size_t PilotSearcher::samples() const noexcept { return impl_->block * impl_->o.noncoherent; }
std::size_t PilotSearcher::cells() const noexcept { return impl_->cell_count; }
double PilotSearcher::threshold() const noexcept { return impl_->limit; }
double PilotSearcher::cell_false_alarm() const noexcept { return impl_->cell_probability; }
std::span<const Acquisition> PilotSearcher::search(IqSpan samples) noexcept { return impl_->search(samples); }

}  // namespace soopnav::cdma
