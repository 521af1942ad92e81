// LTE sequences, broadcast channel and synthesis, each beside a plain way of doing the same in the same run.

#include <benchmark/benchmark.h>

#include <array>
#include <cmath>
#include <complex>
#include <cstdint>
#include <numbers>
#include <random>
#include <vector>

#include "soopnav/waveform/lte/pbch.hpp"
#include "soopnav/waveform/lte/sequences.hpp"
#include "soopnav/waveform/lte/synthesis.hpp"

namespace {

using namespace soopnav;
using namespace soopnav::lte;

/// The peer of `crs_values`: TS 36.211 section 7.2 one bit at a time.
void crs_bit_serial(int cell_id, int slot, int symbol, int n_rb, std::span<Cf32> out) {
  std::uint32_t x1 = 1;
  auto x2 = static_cast<std::uint32_t>(1024 * (7 * (slot + 1) + symbol + 1) * (2 * cell_id + 1) + 2 * cell_id + 1);
  const auto step = [&] {
    const std::uint32_t bit = (x1 ^ x2) & 1U;
    x1 = (x1 >> 1) | ((((x1 >> 3) ^ x1) & 1U) << 30);
    x2 = (x2 >> 1) | ((((x2 >> 3) ^ (x2 >> 2) ^ (x2 >> 1) ^ x2) & 1U) << 30);
    return bit;
  };
  for (int i = 0; i < 1600 + 2 * (kMaxRb - n_rb); ++i) benchmark::DoNotOptimize(step());
  constexpr float kHalfRoot = static_cast<float>(std::numbers::sqrt2 / 2.0);
  for (Cf32& value : out) {
    const float re = step() != 0U ? -kHalfRoot : kHalfRoot;
    value = {re, step() != 0U ? -kHalfRoot : kHalfRoot};
  }
}

void crs_100_rb(benchmark::State& state) {
  std::array<Cf32, 200> values;
  int cell = 0;
  for (auto _ : state) {
    crs_values(cell, 3, 4, CyclicPrefix::kNormal, 100, values);
    benchmark::DoNotOptimize(values.data());
    cell = (cell + 1) % 504;
  }
}
BENCHMARK(crs_100_rb);

void crs_100_rb_bit_serial(benchmark::State& state) {
  std::array<Cf32, 200> values;
  int cell = 0;
  for (auto _ : state) {
    crs_bit_serial(cell, 3, 4, 100, values);
    benchmark::DoNotOptimize(values.data());
    cell = (cell + 1) % 504;
  }
}
BENCHMARK(crs_100_rb_bit_serial);

void sss_all_cells(benchmark::State& state) {
  for (auto _ : state) {
    for (int cell = 0; cell < 504; ++cell) benchmark::DoNotOptimize(sss(cell, 0));
  }
}
BENCHMARK(sss_all_cells);

/// Six frames of soft bits, one port: `snr_db` below -50 is noise alone.
std::vector<PbchSoftBits> soft_bits(double snr_db) {
  std::mt19937_64 random(1);
  std::normal_distribution<float> normal;
  std::vector<std::uint8_t> bits(1920);
  const double snr = snr_db < -50.0 ? 0.0 : std::pow(10.0, snr_db / 10.0);
  const auto mean = static_cast<float>(2.0 * snr), sigma = static_cast<float>(2.0 * std::sqrt(snr > 0.0 ? snr : 1.0));
  std::vector<PbchSoftBits> frames(6);
  for (int f = 0; f < 6; ++f) {
    const int sfn = 101 + f;
    encode_pbch({100, sfn, false, 2, 0}, 301, 1, CyclicPrefix::kNormal, bits);
    for (std::size_t i = 0; i < 480; ++i) {
      const float sign = bits[static_cast<std::size_t>(sfn % 4) * 480 + i] != 0 ? -1.0F : 1.0F;
      frames[static_cast<std::size_t>(f)][i] = sign * mean + sigma * normal(random);
    }
  }
  return frames;
}

void pbch_decode(benchmark::State& state) {
  const auto frames = soft_bits(static_cast<double>(state.range(0)));
  PbchDecoder decoder;
  for (auto _ : state) benchmark::DoNotOptimize(decoder.decode(frames, 301, CyclicPrefix::kNormal, 1));
}
BENCHMARK(pbch_decode)->ArgName("snr_db")->Arg(10)->Arg(-10)->Arg(-14)->Arg(-100)->Unit(benchmark::kMicrosecond);

/// One subframe of a cell; the items are samples, so items per second over the rate is the ratio to real time.
void synthesis(benchmark::State& state, int n_rb, double rate_hz, double clock_error_ppm, double noise_variance) {
  CellParameters cell;
  cell.n_rb = n_rb;
  cell.n_ports = 2;
  cell.delay_s = 1.2345e-6;
  cell.cfo_hz = 123.0;
  cell.clock_error_ppm = clock_error_ppm;
  const std::vector<CellParameters> cells{cell};
  Synthesizer synthesizer(cells, rate_hz, noise_variance, 1);
  std::vector<Cf32> out(static_cast<std::size_t>(rate_hz * 1e-3));
  for (auto _ : state) {
    synthesizer.generate(out);
    benchmark::DoNotOptimize(out.data());
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(out.size()));
}
BENCHMARK_CAPTURE(synthesis, 6_rb_1_92_msps, 6, 1.92e6, 0.0, 0.0);
BENCHMARK_CAPTURE(synthesis, 100_rb_30_72_msps, 100, 30.72e6, 0.0, 0.0);
BENCHMARK_CAPTURE(synthesis, 100_rb_30_72_msps_noise, 100, 30.72e6, 0.0, 1.0);
BENCHMARK_CAPTURE(synthesis, 100_rb_30_72_msps_clock_error, 100, 30.72e6, 1.0, 0.0);
BENCHMARK_CAPTURE(synthesis, 100_rb_19_2_msps, 100, 19.2e6, 0.0, 0.0);

/// The peer of `synthesis`: every sample of one symbol as a sum of its subcarriers, per sample of the subframe.
void synthesis_by_sums(benchmark::State& state) {
  CellParameters cell;
  cell.n_rb = 6;
  cell.n_ports = 2;
  const ResourceGrid grid = resource_grid(cell, 0, 1);
  std::vector<Cf32> out(137);
  for (auto _ : state) {
    for (std::size_t n = 0; n < out.size(); ++n) {
      std::complex<double> sum = 0.0;
      for (int k = 0; k < 72; ++k) {
        const double turns = subcarrier_index(k, 6) * (static_cast<double>(n) - 9.0) / 128.0;
        const std::complex<double> amplitude(grid.at(0, 3, k) + grid.at(1, 3, k));
        sum += amplitude * std::polar(1.0, 2.0 * std::numbers::pi * turns);
      }
      out[n] = Cf32(sum);
    }
    benchmark::DoNotOptimize(out.data());
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(out.size()));
}
BENCHMARK(synthesis_by_sums);

}  // namespace
