// The cyclic-prefix correlator over 250 symbols against the double sum of crosby (2.5) as printed, and what boundaries
// between samples cost beside it. Items are samples.

#include <benchmark/benchmark.h>

#include <complex>
#include <cstdint>
#include <optional>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/waveform/ofdm/boundary.hpp"
#include "soopnav/waveform/ofdm/correlator.hpp"
#include "soopnav/waveform/ofdm/synthesis.hpp"

namespace {

using soopnav::Cf32;
namespace ofdm = soopnav::ofdm;

constexpr int kSymbols = 250;

std::vector<Cf32> capture(int oversampling) {
  std::vector<Cf32> iq(static_cast<std::size_t>(80 * oversampling * (kSymbols + 1)));
  soopnav::RandomStream random(1);
  if (oversampling == 1) {
    ofdm::Synthesizer(ofdm::Numerology{}).fill(iq, random);
  } else {
    random.fill_complex_normal(iq);
  }
  return iq;
}

void correlator_folded(benchmark::State& state) {
  const auto oversampling = static_cast<int>(state.range(0));
  const auto iq = capture(oversampling);
  ofdm::CyclicPrefixCorrelator correlator({}, kSymbols, oversampling);
  for (auto _ : state) {
    benchmark::DoNotOptimize(correlator.fold(iq, state.range(1) != 0));
    benchmark::ClobberMemory();
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(iq.size()));
}

void correlator_double_sum(benchmark::State& state) {
  const auto factor = static_cast<std::size_t>(state.range(0));
  const auto iq = capture(static_cast<int>(factor));
  const std::size_t period = 80 * factor, lag = 64 * factor, window = 16 * factor;
  std::vector<std::complex<float>> gamma(period);
  for (auto _ : state) {
    for (std::size_t m = 0; m < period; ++m) {
      float re = 0.0F, im = 0.0F;
      for (std::size_t k = 0; k < kSymbols; ++k) {
        for (std::size_t i = m; i < m + window; ++i) {
          const Cf32 a = iq[period * k + i], b = iq[period * k + i + lag];
          re += a.real() * b.real() + a.imag() * b.imag();
          im += a.imag() * b.real() - a.real() * b.imag();
        }
      }
      gamma[m] = {re, im};
    }
    benchmark::DoNotOptimize(gamma.data());
    benchmark::ClobberMemory();
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(iq.size()));
}

void boundary(benchmark::State& state) {
  const auto iq = capture(1);
  ofdm::BoundaryEstimator estimator({}, kSymbols, 1, {static_cast<ofdm::BoundaryMethod>(state.range(0)), std::nullopt});
  for (auto _ : state) benchmark::DoNotOptimize(estimator.estimate(iq));
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(iq.size()));
}

BENCHMARK(correlator_folded)
    ->ArgNames({"oversampling", "energy"})
    ->Args({1, 0})
    ->Args({1, 1})
    ->Args({15, 0})
    ->Args({15, 1});
BENCHMARK(correlator_double_sum)->ArgName("oversampling")->Arg(1)->Arg(15)->Unit(benchmark::kMicrosecond);

BENCHMARK(boundary)->ArgName("method")->Arg(0)->Arg(1)->Arg(2);

}  // namespace
