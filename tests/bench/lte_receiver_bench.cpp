// The LTE receiver against real time. `real_time` is how many seconds of signal one second of work covers.
#include <benchmark/benchmark.h>

#include <array>
#include <cmath>
#include <complex>
#include <numbers>
#include <optional>
#include <span>
#include <vector>

#include "soopnav/waveform/lte/crs_loop.hpp"
#include "soopnav/waveform/lte/search.hpp"
#include "soopnav/waveform/lte/sequences.hpp"
#include "soopnav/waveform/lte/snapshot_ranger.hpp"
#include "soopnav/waveform/lte/synthesis.hpp"
#include "soopnav/waveform/lte/time_of_arrival.hpp"
#include "waveform/lte/cell_test.hpp"
#include "waveform/lte/pss_correlator.hpp"

namespace {

using namespace soopnav;

std::vector<Cf32> capture(double sample_rate_hz, double duration_s, int n_rb, double cfo_hz, double snr_db) {
  lte::CellParameters cell;
  cell.cell_id = 277;
  cell.n_rb = n_rb;
  cell.n_ports = 2;
  cell.delay_s = 1.234e-3;
  cell.cfo_hz = cfo_hz;
  cell.start_sfn = 74;
  return lte::synthesize(std::span(&cell, 1), sample_rate_hz, static_cast<std::size_t>(duration_s * sample_rate_hz),
                         lte::noise_variance_for_snr(snr_db), 1);
}

void set_real_time(benchmark::State& state, double signal_s) {
  state.counters["real_time"] =
      benchmark::Counter(signal_s * static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

/// One half-frame: three PSS at +-7.5 kHz, then fine timing and all 504 x 2 SSS in four modes at the best peak.
void BM_HalfFrameSync(benchmark::State& state) {
  const auto iq = capture(1.92e6, 5.2e-3, 6, 3e3, 10.0);
  lte::PssCorrelator correlator({.max_cfo_hz = 7.5e3,
                                 .spacing_hz = 5.0625e3,
                                 .inverse_size = 6144,
                                 .max_drift_ppm = 0.0,
                                 .max_half_frames = 4,
                                 .in_band = true});
  lte::CellTest test;
  std::vector<lte::PssCandidate> peaks;
  std::span<const lte::CellTest::Hypothesis> found;
  for (auto _ : state) {
    correlator.clear();
    correlator.add(iq, 0);
    correlator.peaks(1, peaks);
    benchmark::DoNotOptimize(found = test.synchronise(iq, peaks.front()));
  }
  if (found.front().cell_id != 277) state.SkipWithError("the cell was not found");
  set_real_time(state, 5e-3);
}
BENCHMARK(BM_HalfFrameSync)->Unit(benchmark::kMicrosecond);

/// The peer: the same PSS bank by direct sums over 128 samples, without SSS.
void BM_HalfFrameSyncDirect(benchmark::State& state) {
  const auto iq = capture(1.92e6, 5.2e-3, 6, 3e3, 10.0);
  constexpr std::array<double, 3> kOffsetsHz{-5062.5, 0.0, 5062.5};
  std::vector<std::vector<Cf32>> templates;
  for (int root = 0; root < 3; ++root) {
    for (const double hz : kOffsetsHz) {
      std::vector<Cf32> t(128);
      for (int n = 0; n < 128; ++n) {
        std::complex<double> sum = 0.0;
        for (int i = 0; i < 62; ++i) {
          const int k = i < 31 ? i - 31 : i - 30;
          sum += std::complex<double>(lte::pss(root)[static_cast<std::size_t>(i)]) *
                 std::polar(1.0, 2.0 * std::numbers::pi * (k * n / 128.0 + hz * n / 1.92e6));
        }
        t[static_cast<std::size_t>(n)] = Cf32(std::conj(sum));
      }
      templates.push_back(t);
    }
  }
  std::vector<float> power(9600);
  for (auto _ : state) {
    for (const auto& t : templates) {
      for (std::size_t lag = 0; lag < 9600; ++lag) {
        float re = 0.0F, im = 0.0F;
        for (std::size_t n = 0; n < 128; ++n) {
          const Cf32 a = iq[lag + n], b = t[n];
          re += a.real() * b.real() - a.imag() * b.imag();
          im += a.real() * b.imag() + a.imag() * b.real();
        }
        power[lag] = re * re + im * im;
      }
      benchmark::DoNotOptimize(power.data());
    }
  }
  set_real_time(state, 5e-3);
}
BENCHMARK(BM_HalfFrameSyncDirect)->Unit(benchmark::kMicrosecond);

/// 80 ms, carrier anywhere within +-150 kHz, MIB included. Argument: sample rate, Hz.
void BM_WideSearch(benchmark::State& state) {
  const auto rate = static_cast<double>(state.range(0));
  const auto iq = capture(rate, 80e-3, rate < 3e6 ? 6 : 50, 35.2e3, 10.0);
  lte::Searcher searcher({.sample_rate_hz = rate, .max_cfo_hz = 150e3});
  for (auto _ : state) benchmark::DoNotOptimize(searcher.search(iq));
  if (searcher.detections().size() != 1 || searcher.detections()[0].sfn != 74) state.SkipWithError("wrong cells");
  set_real_time(state, 80e-3);
}
BENCHMARK(BM_WideSearch)->Arg(1920000)->Arg(19200000)->Unit(benchmark::kMillisecond);

/// The same in noise alone, where every candidate has to be refused.
void BM_WideSearchNoise(benchmark::State& state) {
  const auto iq = lte::synthesize({}, 1.92e6, 153600, 1.0, 3);
  lte::Searcher searcher({.sample_rate_hz = 1.92e6, .max_cfo_hz = 150e3});
  for (auto _ : state) benchmark::DoNotOptimize(searcher.search(iq));
  if (!searcher.detections().empty()) state.SkipWithError("a cell in noise");
  set_real_time(state, 80e-3);
}
BENCHMARK(BM_WideSearchNoise)->Unit(benchmark::kMillisecond);

/// CRS estimate and delay of one 100-RB subframe, two ports. Argument: sample rate, Hz.
void BM_SubframeToa(benchmark::State& state) {
  const auto rate = static_cast<double>(state.range(0));
  lte::CellParameters cell;
  cell.cell_id = 277;
  cell.n_rb = 100;
  cell.n_ports = 2;
  cell.delay_s = 20.3e-6;
  const auto iq = lte::synthesize(std::span(&cell, 1), rate, static_cast<std::size_t>(1.1e-3 * rate),
                                  lte::noise_variance_for_snr(10.0), 1);
  lte::Detection detection;
  detection.cell_id = 277;
  detection.n_rb = 100;
  detection.n_ports = 2;
  lte::SubframeToaEstimator estimator(rate, detection);
  std::optional<lte::SubframeToa> toa;
  for (auto _ : state) benchmark::DoNotOptimize(toa = estimator.estimate(iq, 0, 20e-6, 0.0));
  if (!toa || std::abs(toa->toa_s - cell.delay_s) > 1e-9) state.SkipWithError("wrong delay");
  set_real_time(state, 1e-3);
}
BENCHMARK(BM_SubframeToa)->Arg(19200000)->Arg(23040000)->Arg(30720000)->Unit(benchmark::kMicrosecond);

/// All frames of an 80 ms capture of 100 RB with path model and tracking.
void BM_CaptureToa(benchmark::State& state) {
  const auto iq = capture(19.2e6, 80e-3, 100, 0.0, 10.0);
  lte::Searcher searcher({.sample_rate_hz = 19.2e6, .max_cfo_hz = 7.5e3});
  if (searcher.search(iq) != lte::SearchStatus::kOk || searcher.detections().empty()) {
    state.SkipWithError("the cell was not found");
    return;
  }
  const lte::Detection cell = searcher.detections()[0];
  lte::ToaEstimator estimator(19.2e6);
  lte::TimeOfArrival toa;
  for (auto _ : state) benchmark::DoNotOptimize(estimator.estimate(iq, cell, toa));
  set_real_time(state, 80e-3);
}
BENCHMARK(BM_CaptureToa)->Unit(benchmark::kMillisecond);

/// Two paths half a cell apart, 100 RB, two ports: one subframe from samples to delays with covariance.
void BM_ResolvePaths(benchmark::State& state) {
  lte::CellParameters cell;
  cell.cell_id = 277;
  cell.n_rb = 100;
  cell.n_ports = 2;
  cell.delay_s = 20.3e-6;
  cell.taps = {{0.0, 1.0}, {28e-9, {0.0, 0.8}}};
  const double rate = 30.72e6;
  const auto iq = lte::synthesize(std::span(&cell, 1), rate, static_cast<std::size_t>(1.1e-3 * rate),
                                  lte::noise_variance_for_snr(15.0), 1);
  lte::Detection detection;
  detection.cell_id = 277;
  detection.n_rb = 100;
  detection.n_ports = 2;
  lte::SubframePathResolver resolver(rate, detection);
  lte::ResolvedPaths paths;
  for (auto _ : state) benchmark::DoNotOptimize(resolver.resolve(iq, 0, 1, 20e-6, 0.0, paths));
  if (paths.paths.size() != 2) state.SkipWithError("not two paths");
  set_real_time(state, 1e-3);
}
BENCHMARK(BM_ResolvePaths)->Unit(benchmark::kMicrosecond);

/// Six cells in one millisecond, each with the others taken out. Argument: resource blocks.
void BM_SnapshotRanger(benchmark::State& state) {
  const int n_rb = static_cast<int>(state.range(0));
  const double rate = n_rb > 50 ? 30.72e6 : 15.36e6;
  std::vector<lte::CellParameters> cells;
  std::vector<lte::Detection> known;
  std::vector<double> guess;
  for (int l = 0; l < 6; ++l) {
    lte::CellParameters cell;
    cell.cell_id = 37 * l + 11;
    cell.n_rb = n_rb;
    cell.n_ports = 2;
    cell.delay_s = 100e-6 - 0.15e-6 * l;
    cell.power_db = -2.0 * l;
    cell.taps = {{0.0, 1.0}, {60e-9, {0.0, 0.6}}};
    cell.data_load = 0.0;
    cells.push_back(cell);
    lte::Detection detection;
    detection.cell_id = cell.cell_id;
    detection.n_rb = n_rb;
    detection.n_ports = 2;
    known.push_back(detection);
    guess.push_back(100e-6);
  }
  const auto iq =
      lte::synthesize(cells, rate, static_cast<std::size_t>(1.2e-3 * rate), lte::noise_variance_for_snr(20.0), 1);
  lte::SnapshotRanger ranger(rate, known);
  std::span<const lte::SnapshotRange> out;
  for (auto _ : state) benchmark::DoNotOptimize(out = ranger.range(iq, guess));
  for (const auto& r : out) {
    if (r.status != lte::ResolveStatus::kOk) state.SkipWithError("a cell was lost");
  }
}
BENCHMARK(BM_SnapshotRanger)->Arg(50)->Arg(100)->Unit(benchmark::kMillisecond);

/// Carrier and delay loop: 80 ms of 100 RB, 80 updates.
void BM_CrsLoop(benchmark::State& state) {
  const auto iq = capture(19.2e6, 80e-3, 100, 0.0, 10.0);
  lte::Detection detection;
  detection.cell_id = 277;
  detection.n_rb = 100;
  detection.n_ports = 2;
  detection.frame_start_s = 1.234e-3;
  for (auto _ : state) {
    lte::CrsLoop loop({.sample_rate_hz = 19.2e6}, detection);
    benchmark::DoNotOptimize(loop.push(iq).size());
    if (loop.last().status != lte::LoopStatus::kTracking) state.SkipWithError("not followed");
  }
  set_real_time(state, 80e-3);
}
BENCHMARK(BM_CrsLoop)->Unit(benchmark::kMillisecond);

}  // namespace
