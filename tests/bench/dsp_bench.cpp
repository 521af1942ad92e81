// Transforms, correlation, delays and resampling against the obvious way to do each, in one run. Items are samples:
// of the input where a rate is lowered, else of the output.

#include <benchmark/benchmark.h>

#include <Eigen/Core>
#include <complex>
#include <cstdint>
#include <span>
#include <unsupported/Eigen/FFT>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/dsp/correlate.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/dsp/fractional_delay.hpp"
#include "soopnav/dsp/peak.hpp"
#include "soopnav/dsp/resample.hpp"

namespace {

using soopnav::Cf32;
namespace dsp = soopnav::dsp;

std::vector<Cf32> noise(std::size_t size) {
  soopnav::RandomStream random(1);
  std::vector<Cf32> out(size);
  random.fill_normal(std::span<float>(reinterpret_cast<float*>(out.data()), 2 * size));
  return out;
}

void count_samples(benchmark::State& state, std::size_t per_iteration) {
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(per_iteration));
}

void use(const std::vector<Cf32>& y) {
  benchmark::DoNotOptimize(y.data());
  benchmark::ClobberMemory();
}

// y[i] = sum_k taps[k] x[i step + k], written out, on plain floats: std::complex sums compile to far slower code.
void direct_filter(const std::vector<Cf32>& x, const std::vector<float>& taps, std::size_t step, std::vector<Cf32>& y) {
  const auto* samples = reinterpret_cast<const float*>(x.data());
  for (std::size_t i = 0; i < y.size(); ++i) {
    const float* window = samples + 2 * i * step;
    float re = 0.0F, im = 0.0F;
    for (std::size_t k = 0; k < taps.size(); ++k) {
      re += taps[k] * window[2 * k];
      im += taps[k] * window[2 * k + 1];
    }
    y[i] = {re, im};
  }
}

void fft_soopnav(benchmark::State& state) {
  const auto size = static_cast<std::size_t>(state.range(0));
  const dsp::Fft fft(static_cast<int>(size), dsp::FftDirection::kForward);
  const auto x = noise(size);
  std::vector<Cf32> y(size);
  for (auto _ : state) {
    fft.execute(x.data(), y.data());
    use(y);
  }
  count_samples(state, size);
  state.SetLabel(dsp::fft_library());
}

void fft_kiss(benchmark::State& state) {
  const auto size = static_cast<std::size_t>(state.range(0));
  Eigen::FFT<float> fft;
  const auto x = noise(size);
  std::vector<Cf32> y(size);
  for (auto _ : state) {
    fft.fwd(y.data(), x.data(), static_cast<Eigen::Index>(size));
    use(y);
  }
  count_samples(state, size);
}

// A 5 ms half-frame of 1.92 Msps against a template of range(0) samples (128: a PSS).
constexpr std::size_t kHalfFrame = 9600;

void correlate_soopnav(benchmark::State& state) {
  const auto kernel = noise(static_cast<std::size_t>(state.range(0)));
  const auto x = noise(kHalfFrame + kernel.size());
  dsp::OverlapSave correlator(kernel, dsp::FilterKind::kCorrelation);
  std::vector<Cf32> y(kHalfFrame);
  for (auto _ : state) {
    correlator.apply(x, 0, y);
    use(y);
  }
  count_samples(state, y.size());
}

// The direct sum by Eigen's vectorised inner product.
void correlate_direct(benchmark::State& state) {
  const auto kernel = noise(static_cast<std::size_t>(state.range(0)));
  const auto x = noise(kHalfFrame + kernel.size());
  const auto size = static_cast<Eigen::Index>(kernel.size());
  const Eigen::Map<const Eigen::VectorXcf> h(kernel.data(), size);
  std::vector<Cf32> y(kHalfFrame);
  for (auto _ : state) {
    for (std::size_t i = 0; i < y.size(); ++i) y[i] = h.dot(Eigen::Map<const Eigen::VectorXcf>(x.data() + i, size));
    use(y);
  }
  count_samples(state, y.size());
}

void delay_soopnav(benchmark::State& state) {
  const auto x = noise(kHalfFrame);
  const auto filter = dsp::FractionalDelay::windowed_sinc(0.3);
  std::vector<Cf32> y(x.size());
  for (auto _ : state) {
    filter.apply(x, 0, y);
    use(y);
  }
  count_samples(state, y.size());
}

void delay_direct(benchmark::State& state) {
  const auto filter = dsp::FractionalDelay::windowed_sinc(0.3);
  const std::vector<float> taps(filter.taps().begin(), filter.taps().end());
  const auto x = noise(kHalfFrame + taps.size());
  std::vector<Cf32> y(kHalfFrame);
  for (auto _ : state) {
    direct_filter(x, taps, 1, y);
    use(y);
  }
  count_samples(state, y.size());
}

// 80 ms at range(0) samples per second down to 1.92 Msps; real-time factor: 0.08 s over the time shown.
constexpr double kLowRateHz = 1.92e6;

void resample_soopnav(benchmark::State& state) {
  const auto rate_hz = static_cast<double>(state.range(0));
  const auto x = noise(static_cast<std::size_t>(0.08 * rate_hz));
  auto resampler = dsp::Resampler::between(rate_hz, kLowRateHz);
  std::vector<Cf32> y(resampler.output_size(x.size()));
  for (auto _ : state) {
    resampler.apply(x, 0, y);
    use(y);
  }
  count_samples(state, x.size());
  state.SetLabel(resampler.is_rational() ? "rational" : "arbitrary");
}

// As many taps at every output, without the time bookkeeping: the least a plain loop can do.
void resample_direct(benchmark::State& state) {
  const auto rate_hz = static_cast<double>(state.range(0));
  const auto step = static_cast<std::size_t>(rate_hz / kLowRateHz);
  const auto resampler = dsp::Resampler::between(rate_hz, kLowRateHz);
  const std::vector<float> taps(resampler.tap_count(), 0.01F);
  const auto x = noise(static_cast<std::size_t>(0.08 * rate_hz) + taps.size());
  std::vector<Cf32> y(resampler.output_size(x.size() - taps.size()));
  for (auto _ : state) {
    direct_filter(x, taps, step, y);
    use(y);
  }
  count_samples(state, x.size());
}

void resample_clock_error(benchmark::State& state) {
  const auto x = noise(static_cast<std::size_t>(0.08 * kLowRateHz));
  auto resampler = dsp::Resampler::arbitrary(1.0 + 7.86e-6);
  std::vector<Cf32> y(x.size());
  for (auto _ : state) {
    resampler.apply(x, 0, y);
    use(y);
  }
  count_samples(state, x.size());
}

void peak_refine(benchmark::State& state) {
  auto r = noise(200);
  r[100] = {30.0F, 0.0F};
  r[99] = r[101] = {20.0F, 0.0F};
  const dsp::PeakRefiner refiner;
  for (auto _ : state) benchmark::DoNotOptimize(refiner.refine(r, 100));
}

}  // namespace

BENCHMARK(fft_soopnav)->Arg(128)->Arg(1536)->Arg(2048)->Arg(9600)->Arg(32768)->Arg(153600);
BENCHMARK(fft_kiss)->Arg(128)->Arg(1536)->Arg(2048)->Arg(9600)->Arg(32768)->Arg(153600);
BENCHMARK(correlate_soopnav)->Arg(128)->Arg(1024);
BENCHMARK(correlate_direct)->Arg(128)->Arg(1024);
BENCHMARK(delay_soopnav);
BENCHMARK(delay_direct);
BENCHMARK(resample_soopnav)
    ->Arg(19'200'000)
    ->Arg(30'720'000)
    ->Arg(1'400'000)
    ->Arg(61'440'123)
    ->Unit(benchmark::kMillisecond);
BENCHMARK(resample_direct)->Arg(19'200'000)->Arg(30'720'000)->Unit(benchmark::kMillisecond);
BENCHMARK(resample_clock_error)->Unit(benchmark::kMillisecond);
BENCHMARK(peak_refine);
