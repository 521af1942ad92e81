#pragma once

#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "soopnav/waveform/lte/types.hpp"

namespace soopnav::lte {

/// One resolved propagation path.
struct Path {
  double delay_s = 0.0;   ///< after the first path
  double power_db = 0.0;  ///< relative to the strongest path
};

/// Times of arrival of one cell, a value per radio frame.
struct TimeOfArrival {
  std::vector<double> toa_s;    ///< first path: start of frame i minus i * 10 ms, from the capture's first sample;
                                ///< the first is in 0 <= ... < 10 ms, the others follow without a jump
  std::vector<double> sigma_s;  ///< standard deviation of each; what the frames share (the first path's place) included
  std::vector<int> frame_index;         ///< frames after the one that starts at Detection::frame_start_s
  double cfo_hz = 0.0;                  ///< carrier offset, refined over the capture
  double clock_error_ppm = 0.0;         ///< from the slope of the frames' delays, sign as in Detection
  double snr_db = 0.0;                  ///< per CRS resource element, mean over ports
  double noise_variance = 0.0;          ///< of one resource element, unitary transform of the capture's samples
  std::vector<Path> paths;              ///< first path first
  std::vector<float> impulse_response;  ///< magnitude over delay, all ports; spacing and origin below
  double impulse_response_step_s = 0.0;
  double impulse_response_start_s = 0.0;  ///< delay of element 0 after the first path (negative: before)
};

enum class ToaStatus {
  kOk,
  kTooShort,  ///< not one whole subframe with reference signals
  kNonFinite,
  kBadCell,  ///< no such cell: identity, bandwidth or ports out of range, times not finite
  kLost,     ///< the cell's reference signals are not in these samples
};

/// Channel and time of arrival from the cell-specific reference signals of one cell: ports without common phase,
/// discrete paths, and the first of them (TS 36.211 6.10.1; cpp/doc/lte_time_of_arrival.md).
class ToaEstimator {
 public:
  /// @throws std::invalid_argument naming the parameter: `sample_rate_hz` 1.4e6 ... 100e6.
  explicit ToaEstimator(double sample_rate_hz);
  ~ToaEstimator();
  ToaEstimator(ToaEstimator&&) noexcept;
  ToaEstimator& operator=(ToaEstimator&&) noexcept;

  /// Times of arrival over the whole capture. Uses as much of the cell's bandwidth as the sample rate holds.
  [[nodiscard]] ToaStatus estimate(IqSpan iq, const Detection& cell, TimeOfArrival& out);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Delay of one subframe.
struct SubframeToa {
  double toa_s = 0.0;            ///< start of the subframe (cyclic prefix included), from the span's first sample
  double sigma_s = 0.0;          ///< from the noise seen between the subframe's two slots
  double snr_db = 0.0;           ///< per CRS resource element, mean over ports
  double noise_variance = 0.0;   ///< of one resource element
  double residual_cfo_hz = 0.0;  ///< carrier offset left beside the one given, within +-1 kHz
};

/// Channel and maximum-likelihood delay from one subframe at a time, for receivers that run along with the samples.
///
/// All ports and both shifts of the comb (elements every 45 kHz: unambiguous over 22.2 us), phase free per port, one
/// path (cpp/doc/lte_time_of_arrival.md eq. 2 to 5). `estimate` allocates nothing after its first call.
class SubframeToaEstimator {
 public:
  /// `cell` gives identity, cyclic prefix, duplex mode, bandwidth and ports (six blocks and one port when unknown).
  /// @throws std::invalid_argument when `sample_rate_hz` is not a multiple of 1.92e6 in 1.92e6 ... 100e6, or for a cell
  ///         that cannot be: identity 0 ... 503, bandwidth 6, 15, 25, 50, 75 or 100 blocks, 1, 2 or 4 ports.
  SubframeToaEstimator(double sample_rate_hz, const Detection& cell);
  ~SubframeToaEstimator();
  SubframeToaEstimator(SubframeToaEstimator&&) noexcept;
  SubframeToaEstimator& operator=(SubframeToaEstimator&&) noexcept;

  /// `iq` holds the subframe; it begins near `start_s` (within +-2 us) after the span's first sample. nullopt when the
  /// span is too short, not finite or silent, or the subframe has not all reference signals of both slots (TDD: only
  /// subframes 0 and 5 are read). A cell's clock error is not taken out (cpp/doc/lte_time_of_arrival.md eq. 6).
  [[nodiscard]] std::optional<SubframeToa> estimate(IqSpan iq, int subframe, double start_s, double cfo_hz);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::lte
