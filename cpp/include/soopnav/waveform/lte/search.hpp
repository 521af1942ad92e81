#pragma once

#include <memory>
#include <span>
#include <vector>

#include "soopnav/waveform/lte/types.hpp"

namespace soopnav::lte {

/// Parameters of the cell search.
struct SearchOptions {
  double sample_rate_hz = kBaseRateHz;  ///< 1.4e6 ... 100e6; resampled to 1.92 Msps inside unless it is that
  double max_cfo_hz = 150e3;            ///< carrier offsets searched: -max ... +max, 0 ... 250e3
  double window_s = 80e-3;              ///< `Searcher::push` searches each time this much has come in, 10e-3 ... 2
  int max_cells = 16;                   ///< the search ends when so many are found, 1 ... 64
  bool decode_mib = true;
};

/// Why a search gave no answer.
enum class SearchStatus {
  kOk,         ///< searched; an empty list means that no cell is there
  kTooShort,   ///< less than a half-frame and a symbol (5.2 ms)
  kNonFinite,  ///< a sample is NaN or infinite
};

/// Cell search over a capture or a stream (nielsen 2.3.1; TS 36.211 6.11; cpp/doc/lte_cell_search.md).
///
/// PSS by correlation at carrier-offset hypotheses on one forward transform, summed over half-frames without phase and
/// along drifts of the sampling clock; SSS coherently against the PSS; cyclic prefix and duplex mode decided jointly;
/// a cell is reported only after its reference signals confirm it; confirmed cells are cancelled and the rest searched
/// again. Plans and buffers are made by the constructor and the first search of a length; later ones allocate nothing.
class Searcher {
 public:
  /// @throws std::invalid_argument naming the option that is out of range.
  explicit Searcher(const SearchOptions& options);
  ~Searcher();
  Searcher(Searcher&&) noexcept;
  Searcher& operator=(Searcher&&) noexcept;

  /// Searches a whole capture. Detections come strongest first and stay valid until the next call.
  SearchStatus search(IqSpan iq);

  /// Adds a block of a stream; each time `window_s` is full it is searched. Returns the detections of the last window
  /// that this block completed, times from the window's first sample; empty when it completed none. Blocks longer than
  /// a window hide those before. Non-finite samples count as zero.
  std::span<const Detection> push(IqSpan block);

  [[nodiscard]] std::span<const Detection> detections() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::lte
