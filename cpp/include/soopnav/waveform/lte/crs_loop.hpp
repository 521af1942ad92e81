#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "soopnav/waveform/lte/types.hpp"

/// Following one cell over time by its reference signals (cpp/doc/lte_tracking.md).
namespace soopnav::lte {

struct CrsLoopOptions {
  double sample_rate_hz = 1.92e6;  ///< a multiple of 1.92e6, at most 100e6
  double carrier_hz = 0.0;         ///< aids the delay by the carrier; 0: not aided
  double pll_bandwidth_hz = 15.0;  ///< noise bandwidth, 0.5 ... 100
  int pll_order = 3;               ///< 2 or 3
  double dll_bandwidth_hz = 1.0;   ///< noise bandwidth, 0.05 ... 50
  double lost_after_s = 0.05;      ///< of bad updates, 5e-3 ... 10
};

enum class LoopStatus : std::uint8_t {
  kPullIn,    ///< just (re)started: the phase may still settle
  kTracking,  ///< phase and delay are followed
  kCoasting,  ///< this subframe told nothing; values are predictions
  kLost,      ///< nothing heard for `lost_after_s`; looks for the cell in each subframe
};

/// One subframe with reference signals.
struct LoopUpdate {
  LoopStatus status = LoopStatus::kPullIn;
  double time_s = 0.0;                ///< middle of its reference symbols, from the first sample ever pushed
  double toa_s = 0.0;                 ///< start of the frame, minus whole frames since the loop began: continuous
  double toa_sigma_s = 0.0;           ///< thermal noise of the loop
  double carrier_phase_cycles = 0.0;  ///< at `time_s`; grows with range: minus the phase received. Whole number free
  double phase_sigma_cycles = 0.0;    ///< thermal noise of the loop
  double cfo_hz = 0.0;                ///< carrier offset: the phase received grows by so many cycles a second
  double cfo_rate_hz_per_s = 0.0;
  double cn0_dbhz = 0.0;  ///< of the reference elements of a subframe together: their SNR times 1 kHz, smoothed
  double phase_error_cycles = 0.0;  ///< discriminator, measured minus predicted
  double delay_error_s = 0.0;       ///< discriminator
  double lock = 0.0;                ///< mean cosine of the phase error, -1 ... 1
  int subframe = 0;                 ///< 0 ... 9
  int arc = 0;        ///< counts up where the phase does not continue: only phases of one arc may be subtracted
  bool slip = false;  ///< the arc began here
};

/// Carrier phase by a PLL and delay by a DLL that it aids, updated once a subframe.
///
/// Discriminators are the maximum-likelihood phase and delay of all ports' reference elements. The loops start with the
/// gains of a growing memory and end with those of their bandwidths. Slips are found by phase errors beyond 0.3 cycles
/// and by the offset between a subframe's slots, which an alias of the update rate cannot hide from. Non-finite or
/// missing samples give coasting; the state stays finite. Nothing is allocated after a block of the length was pushed.
class CrsLoop {
 public:
  /// `cell` says where the cell is in the samples that follow: `frame_start_s` from the first of them (any number of
  /// frames before or after, within 2 us), `cfo_hz` within 400 Hz.
  /// @throws std::invalid_argument naming the parameter, its value and the rule.
  CrsLoop(const CrsLoopOptions& options, const Detection& cell);
  ~CrsLoop();
  CrsLoop(CrsLoop&&) noexcept;
  CrsLoop& operator=(CrsLoop&&) noexcept;

  /// Adds samples; one update for each subframe with reference signals that they complete. Valid until the next call.
  std::span<const LoopUpdate> push(IqSpan block);

  /// `samples` were lost before the next block. The state is carried over them; beyond 20 ms a new arc begins.
  /// @throws std::invalid_argument when `position` would exceed 2^53; the state is untouched.
  void skip(std::int64_t samples);

  /// Samples pushed and skipped.
  [[nodiscard]] std::int64_t position() const noexcept;
  /// The last update; made from `cell` before the first.
  [[nodiscard]] const LoopUpdate& last() const noexcept;
  [[nodiscard]] const Detection& cell() const noexcept;
  /// Subframes that are read, bit s for subframe s: all in FDD; in TDD 0 and 5 and those found to be downlink.
  [[nodiscard]] unsigned subframes() const noexcept;
  /// Prediction of phase [cycles] and frame start [s] at `time_s`, by the last update.
  [[nodiscard]] double phase_at(double time_s) const noexcept;
  [[nodiscard]] double toa_at(double time_s) const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::lte
