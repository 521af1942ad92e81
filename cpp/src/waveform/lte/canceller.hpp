#pragma once

#include <vector>

#include "waveform/lte/cell_test.hpp"
#include "waveform/lte/crs_tracker.hpp"
#include "waveform/lte/delay_subspace.hpp"
#include "waveform/lte/link_tracker.hpp"

namespace soopnav::lte {

/// Takes a found cell's known signals (PSS, SSS and reference signals of the central six resource blocks) out of a
/// capture of 1.92 Msps, so that weaker cells below them can be searched.
///
/// The synchronisation signals' channel is estimated in each half-frame anew, since their antenna port may change.
class Canceller {
 public:
  Canceller();

  /// `tracker` has just read the cell out of `iq` under `state`.
  void subtract(const LinkState& state, const CrsTracker& tracker, std::span<Cf32> iq);

 private:
  void subtract_symbol(double useful_start, int prefix, double frequency, std::span<Cf32> iq);

  Demodulator demodulator_;
  dsp::Fft inverse_;
  DelaySubspace sync_;
  std::vector<DelaySubspace> comb_;  // by the comb's lower shift 0 ... 2
  std::vector<Cf32> bins_, symbol_, rotator_;
};

/// Frequencies -31 ... -1, 1 ... 31 of the synchronisation signals.
[[nodiscard]] Eigen::VectorXd sync_frequencies();

}  // namespace soopnav::lte
