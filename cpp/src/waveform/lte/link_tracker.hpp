#pragma once

#include <vector>

#include "waveform/lte/crs_tracker.hpp"

namespace soopnav::lte {

/// Delay of a set of elements with unknown phase per port.
///
/// Maximises J(tau) = sum_p |sum_j y_pj conj(t_pj) exp(+j 2 pi f_j tau / N)|^2, tau in samples of an N-point symbol,
/// about a start within the main lobe, by Newton's method. `reference` may be null (a single path: t = 1).
/// cpp/doc/lte_time_of_arrival.md eq. 2, 3 and 10.
struct DelayFit {
  double tau = 0.0;        ///< samples
  double power = 0.0;      ///< J at the maximum
  double curvature = 0.0;  ///< -J'' / (2 J) there: sum over ports of the effective squared bandwidth, (rad/sample)^2
  bool converged = false;
};
[[nodiscard]] DelayFit refine_delay(const Cf32* const* y, const Cf32* const* reference, int ports,
                                    const int* frequencies, int count, int fft_size, double start);

/// Where the largest peak of the power delay profile lies, samples, within +-half of `1 / 45 kHz`; a start for
/// refine_delay.
class CoarseDelay {
 public:
  CoarseDelay();
  [[nodiscard]] double estimate(const Cf32* const* y, int ports, int count, int fft_size);
  /// Power over delay of the last call; element i lies at i / size of 1 / 45 kHz, second half negative.
  [[nodiscard]] const std::vector<float>& profile() const noexcept { return profile_; }

 private:
  int size_ = 0;
  std::vector<dsp::Fft> plans_;
  std::vector<Cf32> padded_, response_;
  std::vector<float> profile_;
};

/// Follows one cell's reference signals through a capture.
class LinkTracker {
 public:
  /// What came out of `track`.
  struct FrameEstimate {
    int index = 0;
    double time = 0.0;   // samples
    double delay = 0.0;  // samples, relative to the state's line
    double delay_sigma = 0.0;
    double phase = 0.0;  // cycles, unwrapped from frame to frame
    double phase_sigma = 0.0;
  };

  /// Refines `state` on the frames that `tracker` can read: absolute delay of the strongest response, drift, frequency.
  /// The first iteration follows the frames one to the next, so that the drift may be off by much; the later ones hold
  /// each frame against the mean. The drift that `state` comes with counts as known to `drift_sigma`. False when no
  /// frame could be read.
  [[nodiscard]] bool track(CrsTracker& tracker, IqSpan iq, LinkState& state, int iterations, double drift_sigma);

  /// The state under which the tracker's frames were last read, before the last refinement: what the delays of their
  /// channels count from.
  [[nodiscard]] const LinkState& read_state() const noexcept { return read_state_; }

  [[nodiscard]] const std::vector<FrameEstimate>& frames() const noexcept { return estimates_; }
  [[nodiscard]] double drift_sigma() const noexcept { return drift_sigma_; }
  [[nodiscard]] double frequency_sigma() const noexcept { return frequency_sigma_; }
  [[nodiscard]] double delay_sigma() const noexcept { return delay_sigma_; }
  /// Mean signal power per element of a port over noise power per element, linear, not below 1e-6.
  [[nodiscard]] double snr() const noexcept { return snr_; }
  /// Mean signal power per element of a port, not below 1e-30.
  [[nodiscard]] double power() const noexcept { return power_; }
  /// Average of all frames, phases aligned: the channel of `port`.
  [[nodiscard]] const Cf32* mean_channel(int port) const noexcept;
  /// Noise variance of an element of mean_channel.
  [[nodiscard]] double mean_channel_noise() const noexcept { return mean_noise_; }
  [[nodiscard]] CoarseDelay& coarse() noexcept { return coarse_; }

  /// Measures phase and relative delay of each frame read against the mean channel of frames [first, last).
  void align(const CrsTracker& tracker, std::size_t first, std::size_t last);

  /// The same against the frame before.
  void chain(const CrsTracker& tracker);

 private:
  void measure(const CrsTracker& tracker, std::size_t frame, const Cf32* const* reference, double reference_noise,
               FrameEstimate& out);

  CoarseDelay coarse_;
  LinkState read_state_;
  std::vector<FrameEstimate> estimates_;
  std::vector<Cf32> mean_;
  int elements_ = 0, ports_ = 0;
  double drift_sigma_ = 0.0, frequency_sigma_ = 0.0, delay_sigma_ = 0.0, snr_ = 0.0, power_ = 0.0, mean_noise_ = 0.0;
};

}  // namespace soopnav::lte
