#pragma once

#include <vector>

#include "soopnav/waveform/lte/pbch.hpp"
#include "soopnav/waveform/lte/synthesis.hpp"
#include "waveform/lte/cell_test.hpp"
#include "waveform/lte/crs_tracker.hpp"
#include "waveform/lte/delay_subspace.hpp"
#include "waveform/lte/link_tracker.hpp"

namespace soopnav::lte {

/// Takes a found cell's known signals out of a capture of 1.92 Msps, so that weaker cells below them can be searched:
/// PSS, SSS, reference signals of the central six resource blocks and, once decoded, the PBCH.
///
/// The synchronisation signals' channel is estimated in each half-frame anew, since their antenna port may change.
/// See cpp/doc/lte_cell_search.md section 6.
class Canceller {
 public:
  Canceller();

  /// `tracker` has just read the cell out of `iq` under `state`.
  void subtract(const LinkState& state, const CrsTracker& tracker, std::span<Cf32> iq);

  /// The broadcast channel as well; `mib.sfn` is that of frame 0 of `state`.
  void subtract_pbch(const LinkState& state, const CrsTracker& tracker, const MasterInformationBlock& mib,
                     std::span<Cf32> iq);

 private:
  static constexpr int kCentral = 72;

  void subtract_symbol(double useful_start, int prefix, double frequency, std::span<Cf32> iq);

  Demodulator demodulator_;
  dsp::Fft inverse_;
  DelaySubspace sync_;
  std::vector<DelaySubspace> comb_;  // by the comb's lower shift 0 ... 2
  std::vector<Cf32> bins_, symbol_, rotator_, grid_;
  CellParameters sent_;  // kept, for it owns memory
};

/// Frequencies -31 ... -1, 1 ... 31 of the synchronisation signals.
[[nodiscard]] Eigen::VectorXd sync_frequencies();

}  // namespace soopnav::lte
