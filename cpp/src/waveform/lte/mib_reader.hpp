#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "soopnav/waveform/lte/pbch.hpp"
#include "waveform/lte/crs_tracker.hpp"
#include "waveform/lte/delay_subspace.hpp"
#include "waveform/lte/link_tracker.hpp"

namespace soopnav::lte {

/// Broadcast channel of a tracked cell: equalises every frame's PBCH and decodes over them.
class MibReader {
 public:
  MibReader();

  struct Result {
    MasterInformationBlock mib;  // sfn of the frame with index `frame`
    int n_ports = 1;
    int frame = 0;
  };

  /// `tracker` has just read four ports of the cell at 1.92 Msps under `state`, and `link` is aligned on them.
  [[nodiscard]] std::optional<Result> read(IqSpan iq, const LinkState& state, CrsTracker& tracker,
                                           const LinkTracker& link);

 private:
  void equalise(IqSpan iq, const LinkState& state, CrsTracker& tracker, const LinkTracker& link, int reach);

  std::vector<DelaySubspace> comb_;
  PbchDecoder decoder_;
  std::unique_ptr<PbchObservation> observation_;
  std::vector<PbchSoftBits> soft_[3];  // for 1, 2 and 4 ports
  std::vector<int> indices_;
  std::vector<Cf32> average_;
};

}  // namespace soopnav::lte
