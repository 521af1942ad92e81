#pragma once

#include <vector>

#include "soopnav/dsp/fft.hpp"
#include "soopnav/waveform/lte/types.hpp"

namespace soopnav::lte {

/// Turns one OFDM symbol of a capture into subcarriers, at any (fractional) time and carrier offset.
///
/// The transform is unitary. Its window begins `back` samples before the useful part, inside the cyclic prefix, so that
/// paths from a little before to a good deal after the nominal time stay orthogonal; the phase ramp of that advance,
/// and of the fraction of a sample, is taken out, so a path at `start` has a flat channel. Allocates nothing after
/// construction.
class Demodulator {
 public:
  explicit Demodulator(int fft_size);

  [[nodiscard]] int fft_size() const noexcept { return size_; }

  /// Carrier offset that `transform` removes, in cycles per sample, phase zero at sample 0 of the capture.
  void set_frequency(double cycles_per_sample);

  /// Transforms the symbol whose useful part begins at sample `start`; false when the window leaves the capture.
  [[nodiscard]] bool transform(IqSpan iq, double start, int back);

  /// Subcarriers -half ... -1, 1 ... half (15 kHz from the carrier) of the last transform, `2 half` of them.
  void subcarriers(int half, Cf32* out) const;

  /// Every sixth subcarrier from `first` (a 15 kHz index if negative, index minus one if not: the direct-current
  /// carrier is skipped), `count` of them, each times conj(reference).
  void pilots(int first, int count, const Cf32* reference_conj, Cf32* out) const;

 private:
  int size_;
  double frequency_ = 0.0;
  double advance_ = 0.0;  // start of the useful part minus start of the window, samples
  float scale_;
  dsp::Fft fft_;
  std::vector<Cf32> rotator_, window_, spectrum_;
  mutable std::vector<Cf32> ramp_;
};

}  // namespace soopnav::lte
