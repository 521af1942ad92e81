#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "soopnav/core/observation.hpp"
#include "soopnav/core/static_vector.hpp"
#include "soopnav/waveform/lte/crs_loop.hpp"

namespace soopnav::lte {

inline constexpr int kMaxStreamCells = 16;

struct StreamOptions {
  double sample_rate_hz = 1.92e6;  ///< a multiple of 1.92e6, at most 100e6
  double carrier_hz = 0.0;         ///< aids the delays; 0: not
  double rate_hz = 10.0;           ///< epochs per second, 0.1 ... 100
  bool search = true;              ///< look for cells, at the start and every `search_interval_s`
  double search_interval_s = 2.0;  ///< 0.1 ... 3600
  double search_window_s = 80e-3;  ///< samples that a search takes, 10e-3 ... 0.2
  double max_cfo_hz = 20e3;        ///< of the search, 0 ... 250e3
  int max_cells = 8;               ///< followed at a time, 1 ... 16
  double drop_after_s = 2.0;       ///< of loss a cell is given up, 0.1 ... 3600
  bool resolve = true;             ///< paths of each cell at each epoch (SubframePathResolver)
  double pll_bandwidth_hz = 15.0;  ///< as CrsLoopOptions
  double dll_bandwidth_hz = 1.0;
};

/// One cell at one epoch. Every number is finite.
struct CellMeasurement {
  int cell_id = 0;
  LoopStatus status = LoopStatus::kPullIn;
  double toa_s = 0.0;    ///< frame start minus whole frames since the stream began, at the epoch: continuous
  double sigma_s = 0.0;  ///< thermal noise
  double carrier_phase_cycles = 0.0;  ///< at the epoch; grows with range, whole number free per arc
  double phase_sigma_cycles = 0.0;
  double cfo_hz = 0.0;
  double cn0_dbhz = 0.0;
  double first_path_s = 0.0;  ///< frame start by the first path that was told apart; toa_s where `paths` is 0
  double first_path_sigma_s = 0.0;
  double excess_s = 0.0;  ///< strongest path after the first one
  int paths = 0;          ///< told apart from the first one on; 0: not resolved
  int arc = 0;            ///< phases of one arc continue each other
  bool slip = false;      ///< the arc began since the epoch before
};

struct StreamEpoch {
  double time_s = 0.0;  ///< from the first sample, skipped ones counted
  StaticVector<CellMeasurement, kMaxStreamCells> cells;

  /// Times of arrival [s] of the cells that are tracked, with their deviations: first paths where they were resolved.
  /// Sources are cell identities; the epoch counts on the capture's clock.
  [[nodiscard]] Observation toa() const noexcept;
  /// Carrier phases [cycles] of the cells that are tracked.
  [[nodiscard]] Observation carrier_phase() const noexcept;
};

/// Measurements of several cells at a fixed rate from samples block by block.
///
/// Cells are given, or searched for at the start and now and then; each is followed by a CrsLoop, and its paths are
/// resolved at each epoch. Cells appear when a search finds them and vanish after `drop_after_s` of loss. Samples that
/// are not finite count as zero. Between searches and new cells nothing is allocated.
class MeasurementStream {
 public:
  /// `cells`: known ones, times from the first sample, as CrsLoop takes them.
  /// @throws std::invalid_argument naming the option or cell that is out of range.
  explicit MeasurementStream(const StreamOptions& options, std::span<const Detection> cells = {});
  ~MeasurementStream();
  MeasurementStream(MeasurementStream&&) noexcept;
  MeasurementStream& operator=(MeasurementStream&&) noexcept;

  /// Adds a block of any length; the epochs that it completed. Valid until the next call.
  std::span<const StreamEpoch> push(IqSpan block);

  /// `samples` were lost before the next block; epochs within them come with the next `push`, cells coasting.
  /// @throws std::invalid_argument for more than an hour of samples; the state is untouched.
  void skip(std::int64_t samples);

  [[nodiscard]] std::int64_t position() const noexcept;  ///< samples pushed and skipped
  [[nodiscard]] int cells() const noexcept;              ///< followed at present

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::lte
