#pragma once

#include <array>
#include <vector>

#include "soopnav/dsp/fft.hpp"
#include "soopnav/waveform/lte/types.hpp"

namespace soopnav::lte {

inline constexpr int kHalfFrameSamples = 9600;  ///< of 1.92 Msps
inline constexpr int kSearchFft = 128;          ///< transform of 1.92 Msps

/// A place where a primary synchronisation signal may be.
struct PssCandidate {
  int n_id_2 = 0;
  double tau = 0.0;  ///< start of its useful part in the first half-frame, samples of 1.92 Msps, 0 ... 9600
  double cfo_hz = 0.0;
  double drift = 0.0;  ///< samples gained per sample (minus the clock error)
  double score = 0.0;  ///< correlation power over its mean, 1 in noise
};

/// Correlates half-frames of 1.92 Msps with the three primary synchronisation signals at a bank of carrier offsets.
///
/// One forward transform serves every hypothesis: a carrier offset is a shift of its bins. The inverse transform may be
/// shorter, since the signal fills half of the band. Powers are summed over half-frames in groups, and the groups along
/// several drifts of the sampling clock (cpp/doc/lte_cell_search.md eq. 1 to 3).
class PssCorrelator {
 public:
  struct Options {
    double max_cfo_hz;
    double spacing_hz;
    int inverse_size;      // 5120, 6144, 7680 or 10240 of the 10240-point forward transform
    double max_drift_ppm;  // drifts tried: -max ... +max
    int max_half_frames;
    bool in_band;  // normalise by the energy inside the signal's band at zero offset, not by all of it
  };
  explicit PssCorrelator(const Options& options);

  void clear() noexcept;
  /// Adds the half-frame that begins at `first` of the capture (samples beyond its end count as zero).
  void add(IqSpan iq, std::size_t first);
  [[nodiscard]] int half_frames() const noexcept { return half_frames_; }

  /// The `limit` highest peaks, highest first. Ends the sum: `clear` comes before the next `add`.
  void peaks(int limit, std::vector<PssCandidate>& out);

  /// Lags of a half-frame.
  [[nodiscard]] int lags() const noexcept { return lags_; }

 private:
  static constexpr int kForward = 10240;
  static constexpr int kGroup = 4;  // half-frames whose drift is neglected: 20 ms

  void add_energy();
  void correlate_group();
  [[nodiscard]] float* surface(int group, int hypothesis, int root) noexcept;
  void offer(const PssCandidate& candidate, std::size_t limit, std::vector<PssCandidate>& out) const;

  Options options_;
  int lags_;
  double ratio_;  // input samples per lag
  int half_frames_ = 0;
  std::vector<int> shifts_;  // bins
  dsp::Fft forward_, inverse_;
  std::array<std::vector<Cf32>, 3> reference_;  // conj(PSS spectrum), bins -half_ ... half_-1
  int half_;
  std::vector<Cf32> input_, spectra_;
  Cf32* spectrum_;  // of the latest half-frame, in spectra_
  std::vector<Cf32> product_, correlation_;
  int pending_ = 0;  // half-frames transformed and not yet correlated
  std::vector<float> surfaces_, energy_, combined_, group_energy_;
  std::vector<double> prefix_;
};

}  // namespace soopnav::lte
