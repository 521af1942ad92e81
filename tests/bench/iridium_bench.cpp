// Bursts sampled, and found in a wide band: items are samples. `detector_*` beside `spectra_alone`, the transforms that
// any detector of this resolution needs.

#include <benchmark/benchmark.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/waveform/iridium/burst.hpp"
#include "soopnav/waveform/iridium/burst_detector.hpp"

namespace {

using soopnav::Cf32;
namespace iridium = soopnav::iridium;

constexpr std::size_t kSamples = 2'000'000;  // a second

std::vector<Cf32> sky(int bursts) {
  std::vector<Cf32> iq(kSamples);
  soopnav::RandomStream(1).fill_complex_normal(iq);
  for (int i = 0; i < bursts; ++i) {
    const auto burst = iridium::Burst::make(iridium::BurstKind::kDuplex,
                                            soopnav::RandomStream(2).substream(static_cast<std::uint64_t>(i)));
    burst.add_to({.sample_rate_hz = 2e6,
                  .delay_s = 0.9 / bursts * i,
                  .doppler_hz = -9e5 + 1.8e6 / bursts * i,
                  .amplitude = 0.35},
                 iq);
  }
  return iq;
}

void detector(benchmark::State& state) {
  const auto iq = sky(static_cast<int>(state.range(0)));
  iridium::BurstDetector found({});
  for (auto _ : state) benchmark::DoNotOptimize(found.push(iq));
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(iq.size()));
}

void spectra_alone(benchmark::State& state) {
  const auto iq = sky(1);
  const soopnav::dsp::Fft fft(2000, soopnav::dsp::FftDirection::kForward);
  std::vector<Cf32> out(2000);
  for (auto _ : state) {
    for (std::size_t n = 0; n + 2000 <= iq.size(); n += 1000) {
      fft.execute(iq.data() + n, out.data());
      benchmark::DoNotOptimize(out.data());
    }
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(iq.size()));
}

void burst_evaluate(benchmark::State& state) {
  const auto burst = iridium::Burst::make(iridium::BurstKind::kLong, soopnav::RandomStream(1));
  std::vector<Cf32> out(4500);
  for (auto _ : state) {
    burst.evaluate(0.0, 2e-5, 1e-14, out);
    benchmark::DoNotOptimize(out.data());
  }
  state.SetItemsProcessed(state.iterations() * 4500);
}

BENCHMARK(detector)->Arg(1)->Arg(100)->Unit(benchmark::kMillisecond);
BENCHMARK(spectra_alone)->Unit(benchmark::kMillisecond);
BENCHMARK(burst_evaluate)->Unit(benchmark::kMicrosecond);

}  // namespace
