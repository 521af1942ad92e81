#pragma once

#include <memory>
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
  std::vector<double> toa_s;      ///< first path: start of frame i minus i * 10 ms, from the capture's first sample
  std::vector<double> sigma_s;    ///< standard deviation of each
  double cfo_hz = 0.0;            ///< carrier offset, refined over the capture
  double clock_error_ppm = 0.0;   ///< from the slope of the frames' delays, sign as in Detection
  double snr_db = 0.0;            ///< per CRS resource element of port 0
  double noise_variance = 0.0;    ///< of one resource element, in squared sample units of a unitary transform
  std::vector<Path> paths;        ///< first path first
  std::vector<float> impulse_response;  ///< magnitude over delay, all ports; spacing and origin below
  double impulse_response_step_s = 0.0;
  double impulse_response_start_s = 0.0;  ///< delay of element 0 after the first path (negative: before)
};

enum class ToaStatus {
  kOk,
  kTooShort,      ///< not one whole subframe with reference signals
  kNonFinite,
  kNoBandwidth,   ///< never with six resource blocks assumed; reserved for callers that demand n_rb
  kLost,          ///< the cell's reference signals are not in these samples
};

/// Channel and time of arrival from the cell-specific reference signals of one cell.
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

}  // namespace soopnav::lte
