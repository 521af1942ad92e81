#pragma once

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstddef>
#include <span>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/lte/sequences.hpp"
#include "soopnav/waveform/lte/synthesis.hpp"

/// What the tests of the LTE receiver share: cells, their truth, and bounds computed apart from the receiver's own
/// code.
namespace soopnav::lte::test {

/// Seconds between times that count modulo a radio frame, -5 ms ... 5 ms.
inline double wrapped_s(double time_s) { return std::remainder(time_s, kFrameS); }

inline int whole(RandomStream& random, int count) { return static_cast<int>(random.uniform() * count); }

/// A cell with everything that the channel decides drawn at random, delay 0 ... 10 ms.
inline CellParameters random_cell(RandomStream& random, int n_rb = 6, int n_ports = 2) {
  CellParameters cell;
  cell.cell_id = whole(random, kCells);
  cell.n_rb = n_rb;
  cell.n_ports = n_ports;
  cell.start_sfn = whole(random, 1024);
  cell.delay_s = random.uniform(0.0, kFrameS);
  cell.carrier_phase_rad = random.uniform(0.0, kTwoPi);
  for (auto& gain : cell.port_gain) gain = std::polar(1.0, random.uniform(0.0, kTwoPi));
  return cell;
}

/// What a search without errors reports of `cell`, whose delay is within a frame.
inline Detection truth(const CellParameters& cell) {
  Detection d;
  d.cell_id = cell.cell_id;
  d.n_rb = cell.n_rb;
  d.n_ports = cell.n_ports;
  d.sfn = cell.start_sfn;
  d.cp = cell.cp;
  d.duplex = cell.duplex;
  d.frame_start_s = cell.delay_s;
  d.cfo_hz = cell.cfo_hz;
  d.clock_error_ppm = cell.clock_error_ppm;
  d.clock_error_sigma_ppm = 0.1;
  return d;
}

inline const Detection* find(std::span<const Detection> cells, int cell_id) {
  const auto it = std::find_if(cells.begin(), cells.end(), [&](const Detection& d) { return d.cell_id == cell_id; });
  return it == cells.end() ? nullptr : &*it;
}

/// `clean` plus white noise of the given variance per sample.
inline void with_noise(std::span<const Cf32> clean, double variance, RandomStream& random, std::vector<Cf32>& out) {
  out.assign(clean.begin(), clean.end());
  random.add_complex_normal(out, variance);
}

inline std::vector<Cf32> noise(std::size_t n, double variance, std::uint64_t seed) {
  std::vector<Cf32> out(n);
  RandomStream(seed, 77).fill_complex_normal(out, variance);
  return out;
}

/// Cramer-Rao bound of the delay [s] from the reference signals of `subframes` (of 0 ... 9, all in one capture), one
/// path, white noise, |X| = 1: delay, phase of each port and, if asked, carrier offset unknown. Amplitudes decouple.
/// Built element by element from TS 36.211 6.10.1.2, v + v_shift of every symbol, and inverted whole.
inline double delay_crlb_s(const CellParameters& cell, double snr_db, std::span<const int> subframes,
                           bool offset_unknown = true) {
  const double snr = std::pow(10.0, snr_db / 10.0);
  const auto n = static_cast<std::size_t>(cell.n_ports + 2);
  std::vector<double> fisher(n * n, 0.0);
  const auto at = [&](std::size_t i, std::size_t j) -> double& { return fisher[i * n + j]; };
  for (const int subframe : subframes) {
    for (int half = 0; half < 2; ++half) {
      const int slot = 2 * subframe + half;
      for (int symbol = 0; symbol < symbols_per_slot(cell.cp); ++symbol) {
        for (int port = 0; port < cell.n_ports; ++port) {
          if (!has_crs(symbol, port, cell.cp)) continue;
          const double time_s = slot * 0.5e-3 + symbol_start_samples(cell.cp, symbol, 128) / kBaseRateHz;
          for (int k = crs_first_subcarrier(cell.cell_id, slot, symbol, port); k < 12 * cell.n_rb; k += 6) {
            // Phase of the element over delay, carrier offset and the port's own phase.
            const double by_delay = -kTwoPi * kSubcarrierSpacingHz * subcarrier_index(k, cell.n_rb);
            const double by_offset = kTwoPi * time_s;
            const auto own = static_cast<std::size_t>(2 + port);
            at(0, 0) += by_delay * by_delay;
            at(0, 1) += by_delay * by_offset;
            at(1, 1) += by_offset * by_offset;
            at(0, own) += by_delay;
            at(1, own) += by_offset;
            at(own, own) += 1.0;
          }
        }
      }
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j < i; ++j) at(i, j) = at(j, i);
  }
  // Schur complement of the delay: eliminate the last unknown first.
  for (std::size_t last = n - 1; last >= 1; --last) {
    if (last == 1 && !offset_unknown) break;
    for (std::size_t i = 0; i < last; ++i) {
      for (std::size_t j = 0; j < last; ++j) at(i, j) -= at(i, last) * at(last, j) / at(last, last);
    }
  }
  return 1.0 / std::sqrt(2.0 * snr * at(0, 0));
}

}  // namespace soopnav::lte::test
