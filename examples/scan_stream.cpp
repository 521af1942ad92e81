// Finds the cells of a stream of samples, block by block as a radio delivers them, and times one of them.
//
// The samples are synthesised, so that the program can hold what it finds against what was sent.
#include <array>
#include <cmath>
#include <cstdio>
#include <vector>

#include "soopnav/waveform/lte/search.hpp"
#include "soopnav/waveform/lte/synthesis.hpp"
#include "soopnav/waveform/lte/time_of_arrival.hpp"

using soopnav::Cf32;
namespace lte = soopnav::lte;

namespace {

constexpr double kRateHz = 1.92e6;
constexpr double kWindowS = 80e-3;

/// Two cells of one carrier: 301 in front, 182 at 4 dB less with a later reflection.
std::array<lte::CellParameters, 2> sent_cells() {
  lte::CellParameters front{.cell_id = 301, .n_rb = 6, .n_ports = 2};
  front.start_sfn = 12;
  front.delay_s = 4.043217e-3;
  front.cfo_hz = 14.28e3;
  lte::CellParameters behind{.cell_id = 182, .n_rb = 6, .n_ports = 1};
  behind.delay_s = 7.5e-3;
  behind.cfo_hz = 14.28e3;
  behind.power_db = -4.0;
  behind.taps = {{.delay_s = 0.0, .gain = 1.0}, {.delay_s = 1.1e-6, .gain = {0.0, 0.4}}};
  return {front, behind};
}

}  // namespace

int main() {
  const auto sent = sent_cells();
  lte::Synthesizer radio(sent, kRateHz, lte::noise_variance_for_snr(12.0));
  lte::Searcher searcher({.sample_rate_hz = kRateHz, .max_cfo_hz = 20e3, .window_s = kWindowS});
  lte::ToaEstimator estimator(kRateHz);

  std::vector<Cf32> block(4096), window;
  lte::TimeOfArrival toa;
  bool found = false;
  while (static_cast<double>(window.size()) < kWindowS * kRateHz) {
    radio.generate(block);
    window.insert(window.end(), block.begin(), block.end());
    for (const lte::Detection& cell : searcher.push(block)) {
      std::printf("cell %3d  %s  CFO %+.2f kHz  SNR %.1f dB\n", cell.cell_id,
                  cell.duplex == lte::Duplex::kFdd ? "FDD" : "TDD", cell.cfo_hz * 1e-3, cell.snr_db);
      if (estimator.estimate(window, cell, toa) != lte::ToaStatus::kOk) continue;
      std::printf("          first frame at %.4f us, +- %.4f us\n", toa.toa_s[0] * 1e6, toa.sigma_s[0] * 1e6);
      if (cell.cell_id != sent[0].cell_id) continue;
      found = cell.sfn == sent[0].start_sfn && std::abs(toa.cfo_hz - sent[0].cfo_hz) < 5.0 &&
              std::abs(toa.toa_s[0] - sent[0].delay_s) < 5.0 * toa.sigma_s[0] + 1e-9;
    }
  }
  return found && searcher.detections().size() == sent.size() ? 0 : 1;
}
