// Cross-ambiguity of a 90 ms burst, against the obvious way in one run: products at the full rate, an FFT for each lag.
// Items are pairs. Bars: 1 ms at 250 ksps, 2 ms at 2 Msps.

#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstddef>
#include <numbers>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/dsp/ambiguity.hpp"
#include "soopnav/dsp/fft.hpp"

namespace {

using soopnav::Cf32;
namespace dsp = soopnav::dsp;

struct Pair {
  std::vector<Cf32> a, b;
};

// A strip of noise 25 kHz wide for the signal, `snr_db` in that band, a 7.3 us later and 1234.5 Hz higher.
Pair recorded(double rate_hz, double snr_db) {
  const int n = static_cast<int>(std::lround(0.09 * rate_hz));
  const auto size = static_cast<std::size_t>(n);
  const dsp::Fft inverse(n, dsp::FftDirection::kInverse);
  std::vector<Cf32> line(size), early(size), late(size);
  soopnav::RandomStream random(1);
  const double step = rate_hz / n;
  for (int k = -n / 2; k < n / 2; ++k) {
    if (std::abs(k * step) > 12.5e3) continue;
    const Cf32 x(random.normal_float(), random.normal_float());
    const auto at = static_cast<std::size_t>(k < 0 ? k + n : k);
    early[at] = x;
    late[at] = x * Cf32(std::polar(1.0, -2.0 * std::numbers::pi * k * step * 7.3e-6));
  }
  const double power = 2.0 * 25e3 / step;  // of either, per sample
  const double noise = power * rate_hz / 25e3 * std::pow(10.0, -0.1 * snr_db);
  Pair pair{std::vector<Cf32>(size), std::vector<Cf32>(size)};
  inverse.execute(late.data(), pair.a.data());
  inverse.execute(early.data(), pair.b.data());
  for (std::size_t i = 0; i < size; ++i) {
    pair.a[i] *= Cf32(std::polar(1.0, 2.0 * std::numbers::pi * 1234.5 * static_cast<double>(i) / rate_hz));
  }
  random.substream(1).add_complex_normal(pair.a, noise);
  random.substream(2).add_complex_normal(pair.b, noise);
  return pair;
}

void BM_CrossAmbiguity(benchmark::State& state) {
  const auto rate_hz = static_cast<double>(state.range(0));
  const Pair pair = recorded(rate_hz, static_cast<double>(state.range(1)));
  dsp::AmbiguityOptions options;
  options.sample_rate_hz = rate_hz;
  options.max_samples = pair.a.size();
  options.bandwidth_hz = 35e3;
  dsp::CrossAmbiguity caf(options);
  for (auto _ : state) {
    const dsp::AmbiguityPeak peak = caf.measure(pair.a, pair.b);
    if (!peak.detected() || std::abs(peak.fdoa_hz - 1234.5) > 1.0) state.SkipWithError("the burst was missed");
    benchmark::DoNotOptimize(peak);
  }
  state.SetItemsProcessed(state.iterations());
}
BENCHMARK(BM_CrossAmbiguity)
    ->Args({250000, 10})
    ->Args({250000, 0})
    ->Args({2000000, 10})
    ->Args({2000000, 0})
    ->Unit(benchmark::kMicrosecond);

void BM_CrossAmbiguityPlain(benchmark::State& state) {
  const auto rate_hz = static_cast<double>(state.range(0));
  const Pair pair = recorded(rate_hz, 10.0);
  const auto n = static_cast<std::ptrdiff_t>(pair.a.size());
  const auto reach = static_cast<std::ptrdiff_t>(std::ceil(20e-6 * rate_hz));
  const dsp::Fft forward(dsp::fast_fft_size(static_cast<int>(n)), dsp::FftDirection::kForward);
  std::vector<Cf32> products(static_cast<std::size_t>(forward.size())), cells(products.size());
  for (auto _ : state) {
    float best = 0.0F;
    for (std::ptrdiff_t lag = -reach; lag <= reach; ++lag) {
      for (std::ptrdiff_t i = 0; i < n; ++i) {
        const std::ptrdiff_t j = i + lag;
        const Cf32 x = j >= 0 && j < n ? pair.a[static_cast<std::size_t>(j)] : Cf32{};
        const Cf32 y = pair.b[static_cast<std::size_t>(i)];
        products[static_cast<std::size_t>(i)] = {x.real() * y.real() + x.imag() * y.imag(),
                                                 x.imag() * y.real() - x.real() * y.imag()};
      }
      forward.execute(products.data(), cells.data());
      for (const Cf32& cell : cells) best = std::max(best, std::norm(cell));
    }
    benchmark::DoNotOptimize(best);
  }
  state.SetItemsProcessed(state.iterations());
}
BENCHMARK(BM_CrossAmbiguityPlain)->Arg(250000)->Arg(2000000)->Unit(benchmark::kMicrosecond);

}  // namespace
