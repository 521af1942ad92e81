#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/dsp/fft.hpp"

namespace soopnav::iridium {

/// A stretch of a channel that holds a signal.
struct GaugedSignal {
  double begin = 0.0, end = 0.0;  ///< samples after the first one given
  double frequency_hz = 0.0;      ///< in the samples given
  double frequency_sigma_hz = 0.0;
  double bandwidth_hz = 0.0;  ///< of the middle 90 % of the power
  double snr = 0.0;           ///< power over the noise's in 25 kHz
  bool fine_frequency = false;
};

/// Takes one channel out of a wide band and finds when a signal is in it, at which carrier, how wide and how strong
/// (doc/iridium.md, sections 4 and 5). The constructor allocates, `measure` does not.
class BurstGauge {
 public:
  BurstGauge(double sample_rate_hz, std::size_t most_samples);

  /// @param samples     at most `most_samples`, what is more is left out.
  /// @param frequency_hz of the channel, right to 2 kHz.
  /// @param noise_power of a sample of the wide band, > 0.
  /// @param level       power of signal and noise over the noise's in 25 kHz, > 1, roughly.
  /// @returns how many signals were written to `out`, in the order of time. When none is sure, the likeliest stretch.
  std::size_t measure(IqSpan samples, double frequency_hz, double noise_power, double level,
                      std::span<GaugedSignal> out) noexcept;

 private:
  void mix(IqSpan samples, double frequency_hz, double scale) noexcept;
  void spectrum_of(const Cf32* from, std::size_t n) noexcept;
  void weigh_spectrum(std::size_t n, GaugedSignal& signal) const noexcept;
  void trim(std::size_t& begin, std::size_t& end, std::size_t most) const noexcept;
  void find_carrier(std::size_t from, std::size_t to, GaugedSignal& signal) noexcept;

  double rate_;          // of the wide band [Hz]
  std::size_t stride_;   // samples of it to one of the channel
  double channel_rate_;  // [Hz]
  std::size_t most_samples_;
  std::size_t taps_ = 0, pulse_taps_ = 0;  // middle taps are taps_ and pulse_taps_
  std::vector<float> filter_, pulse_;      // each tap twice, as kernels::filter has it
  std::vector<Cf32> mixed_;                // taps_ zeros, the samples, taps_ zeros
  std::vector<Cf32> channel_;              // pulse_taps_ zeros, decimated, pulse_taps_ zeros
  std::vector<Cf32> matched_;
  std::vector<Cf32> work_, transform_;
  std::vector<float> power_;
  dsp::Fft fft_;
};

}  // namespace soopnav::iridium
