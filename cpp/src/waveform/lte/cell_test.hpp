#pragma once

#include <array>
#include <span>
#include <vector>

#include "soopnav/waveform/lte/types.hpp"
#include "waveform/lte/demodulator.hpp"
#include "waveform/lte/pss_correlator.hpp"

namespace soopnav::lte {

/// A cell that its reference signals have confirmed, times in samples of 1.92 Msps.
struct ConfirmedCell {
  int cell_id = 0;
  CyclicPrefix cp = CyclicPrefix::kNormal;
  Duplex duplex = Duplex::kFdd;
  double frame_start = 0.0;  ///< of some frame, within a frame of the capture's first sample
  double cfo_hz = 0.0;
  double drift = 0.0;
  double evidence = 0.0;  ///< CRS statistic, 1 in noise
};

/// From a PSS candidate to confirmed cells: fine timing and frequency, SSS with cyclic prefix and duplex mode jointly,
/// and the test on the cell-specific reference signals of the central six resource blocks (cpp/doc/lte_cell_search.md
/// eq. 4 to 9).
class CellTest {
 public:
  CellTest();

  /// What the secondary synchronisation signal says of a candidate.
  struct Hypothesis {
    int mode = 0;  ///< FDD normal, FDD extended, TDD normal, TDD extended prefix
    int cell_id = 0;
    int parity = 0;  ///< 1: the candidate's half-frame is the second of its frame
    float z = 0.0F;  ///< standard deviations of noise; 0: no hypothesis
  };

  /// Fine timing and frequency of `candidate`, then its best explanations by SSS, best first.
  std::span<const Hypothesis> synchronise(IqSpan iq, const PssCandidate& candidate) {
    refine(iq, candidate);
    rank(iq);
    return hypotheses_;
  }

  /// Tests `candidate`; cells that pass are appended to `out`, unless `known(cell_id)` says they were found before.
  /// Several cells may share a PSS position. `drift_known`: the candidate's drift is that of a cell found before.
  template <class Known>
  void examine(IqSpan iq, const PssCandidate& candidate, bool drift_known, const Known& known,
               std::vector<ConfirmedCell>& out) {
    for (const Hypothesis& h : synchronise(iq, candidate)) {
      if (h.z <= 0.0F || known(h.cell_id)) continue;
      ConfirmedCell cell;
      if (confirm(iq, h, drift_known, cell)) out.push_back(cell);
    }
  }

  /// Evidence below which a cell is not believed. Noise alone exceeds it about once in 1e6 tests.
  static constexpr double kEvidence = 27.0;

 private:
  static constexpr int kMaxHalfFrames = 40;
  static constexpr int kModes = 4;           // FDD normal, FDD extended, TDD normal, TDD extended
  static constexpr int kSegmentSlots = 128;  // 64 ms of coherent sum
  static constexpr int kTaps = 9;            // delays -4 ... 4 samples
  static constexpr int kTransform = 256;

  void refine(IqSpan iq, const PssCandidate& candidate);
  void rank(IqSpan iq);
  void offer(const Hypothesis& h);
  [[nodiscard]] bool confirm(IqSpan iq, const Hypothesis& h, bool drift_known, ConfirmedCell& out);
  void read_grid(IqSpan iq, int mode);

  Demodulator demodulator_;
  std::vector<dsp::Fft> segment_fft_;      // 32, 64, 128 and 256 points
  std::array<std::vector<float>, 3> sss_;  // [n_id_2][n_id_1][subframe 0 or 5][62]
  std::array<std::vector<Cf32>, 3> pss_time_conj_;

  std::vector<Cf32> offset_turn_;  // [offset][piece]: takes an offset out of the pieces of the PSS
  std::vector<Cf32> undo_;         // [tap][subcarrier]: exp(+j 2 pi f d / 128) undoes a delay of d samples
  std::array<std::array<std::vector<Cf32>, 4>, 2>
      gap_turn_;  // [prefix][plan][alias, bin]: phase between a slot's reference symbols

  // The candidate under test.
  int n_id_2_ = 0;
  double tau_ = 0.0, cfo_hz_ = 0.0, drift_ = 0.0;
  int half_frames_ = 0;
  std::vector<float> power_, bin_power_;
  std::array<Hypothesis, 6> hypotheses_{};

  // Central 72 subcarriers of the two reference symbols of each slot, for one mode at a time.
  int grid_mode_ = -1, grid_slots_ = 0, grid_first_slot_ = 0;
  std::vector<Cf32> grid_;
  std::vector<std::uint8_t> grid_valid_;
  std::vector<Cf32> taps_;    // [which][tap][slot]
  std::vector<Cf32> pilots_;  // [which][slot][12]
  std::vector<Cf32> series_, spectrum_a_, spectrum_b_;
  std::vector<Cf32> sync_;  // [half-frame][62] PSS, then SSS of each mode
};

}  // namespace soopnav::lte
