#pragma once

#include <memory>
#include <span>
#include <vector>

#include "soopnav/waveform/lte/super_resolution.hpp"

namespace soopnav::lte {

struct RangerOptions {
  int subframes = 1;              ///< averaged, phases aligned, 1 ... 10; the samples must hold them
  int passes = 2;                 ///< over all cells, each with the others' reference signals taken out; 1 ... 4
  bool cancel = true;             ///< false: every cell in what was received, one pass
  double search_window_s = 2e-6;  ///< arrivals are believed so far from the guess, 1e-7 ... 1e-5
  ResolverOptions resolver{.max_paths = 3};
};

/// One cell of a snapshot.
struct SnapshotRange {
  ResolveStatus status = ResolveStatus::kLost;
  int cell_id = 0;
  double toa_s = 0.0;               ///< frame start by the first path, on the time line of the guess
  double sigma_s = 0.0;             ///< its deviation, the other paths unknown too
  double first_peak_s = 0.0;        ///< frame start by the first-peak rule (cpp/doc/lte_super_resolution.md eq. 1)
  double first_peak_sigma_s = 0.0;  ///< of a lone path
  double undetected_s = 0.0;        ///< deviation that a path too weak to be told apart could cause, where there is
                                    ///< multipath; not in sigma_s (eq. 12)
  double excess_s = 0.0;            ///< strongest path after the first one
  double first_db = 0.0;            ///< power of the first path over the strongest, <= 0
  int paths = 0;
  double snr_db = 0.0;           ///< per reference element: over noise, and what was not taken out of other cells
  double residual_cfo_hz = 0.0;  ///< carrier offset left beside the one given
};

/// Ranges to several known cells from a millisecond of samples that hold all of them, for receivers that look now and
/// then (100 ms epochs) and keep their own time line.
///
/// Strongest first, each cell's paths are resolved (PathResolver) and its reference signals taken out of the samples
/// before the next; a further pass puts each back alone and resolves it among the others' remains. Data of other cells
/// stays and is noise. Allocates nothing after the first call for a length. Six cells with two passes: about
/// 6 ms at 50 resource blocks, 13 ms at 100.
class SnapshotRanger {
 public:
  /// `cells` give identity, cyclic prefix, duplex mode, bandwidth and ports.
  /// @throws std::invalid_argument naming the parameter: no cells, a cell or rate as SubframeToaEstimator refuses them,
  ///         an option out of range.
  SnapshotRanger(double sample_rate_hz, std::span<const Detection> cells, const RangerOptions& options = {});
  ~SnapshotRanger();
  SnapshotRanger(SnapshotRanger&&) noexcept;
  SnapshotRanger& operator=(SnapshotRanger&&) noexcept;

  /// Each cell has a frame start near `frame_start_s[l]` (any number of 10 ms off, before the span's first sample too)
  /// and its carrier near `cfo_hz[l]`; an empty `cfo_hz` is zeros. The first `subframes` whole subframes with reference
  /// signals are read. Sizes that do not match give every cell kTooShort. Valid until the next call.
  std::span<const SnapshotRange> range(IqSpan iq, std::span<const double> frame_start_s,
                                       std::span<const double> cfo_hz = {});

  [[nodiscard]] int cells() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::lte
