#pragma once

#include <complex>
#include <cstdint>

#include "soopnav/waveform/lte/search.hpp"
#include "waveform/lte_scene.hpp"

namespace soopnav::lte::test {

/// Counts over trials of a search.
struct SearchRates {
  int found = 0;        ///< the cell, its frame start within 1 us
  int decoded = 0;      ///< its MIB right: bandwidth, ports and SFN
  int misread = 0;      ///< a MIB that is not the cell's
  int false_cells = 0;  ///< any other cell
};

/// One cell of six resource blocks and two ports (the second turned by 0.7 rad), 60 ms of 1.92 Msps at `snr_db` per CRS
/// element of one port; identity, delay, SFN, phase and a carrier offset within +-3 kHz by lot.
inline SearchRates search_rates(int runs, double snr_db, SyncPorts sync_ports, std::uint64_t seed) {
  Searcher searcher({.max_cfo_hz = 3e3});
  RandomStream random(seed);
  SearchRates rates;
  for (int run = 0; run < runs; ++run) {
    CellParameters cell = random_cell(random);
    cell.cfo_hz = random.uniform(-3e3, 3e3);
    cell.port_gain = {1.0, std::polar(1.0, 0.7), 1.0, 1.0};
    cell.sync_ports = sync_ports;
    const auto iq = synthesize({&cell, 1}, kBaseRateHz, 115200, noise_variance_for_snr(snr_db), random.next_u64());
    static_cast<void>(searcher.search(iq));
    for (const Detection& d : searcher.detections()) {
      if (d.cell_id != cell.cell_id || !(std::abs(wrapped_s(d.frame_start_s - cell.delay_s)) < 1e-6)) {
        ++rates.false_cells;
        continue;
      }
      ++rates.found;
      if (!d.sfn) continue;
      ++(*d.sfn == cell.start_sfn && d.n_rb == 6 && d.n_ports == 2 ? rates.decoded : rates.misread);
    }
  }
  return rates;
}

/// Cells found in `trials` captures of white noise, 60 ms each.
inline int cells_in_noise(int trials, double max_cfo_hz, std::uint64_t seed) {
  Searcher searcher({.max_cfo_hz = max_cfo_hz});
  RandomStream random(seed);
  std::vector<Cf32> iq(115200);
  int found = 0;
  for (int i = 0; i < trials; ++i) {
    random.fill_complex_normal(iq);
    static_cast<void>(searcher.search(iq));
    found += static_cast<int>(searcher.detections().size());
  }
  return found;
}

}  // namespace soopnav::lte::test
