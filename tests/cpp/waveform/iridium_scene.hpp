#pragma once

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdint>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/iridium/burst.hpp"
#include "soopnav/waveform/iridium/burst_detector.hpp"

namespace soopnav::iridium::scene {

/// A recording of noise (power one a sample) to which signals are added, each with its SNR in 25 kHz.
struct Scene {
  Scene(double rate, double duration_s, std::uint64_t seed)
      : rate_hz(rate), iq(static_cast<std::size_t>(rate * duration_s)) {
    RandomStream(seed, 77).fill_complex_normal(iq);
  }
  void add(const Burst& burst, double start_s, double frequency_hz, double snr_db) {
    Arrival arrival{.sample_rate_hz = rate_hz, .delay_s = start_s, .doppler_hz = frequency_hz};
    arrival.amplitude = amplitude(snr_db);
    burst.add_to(arrival, iq);
  }
  void tone(double start_s, double duration_s, double frequency_hz, double snr_db) {
    const auto first = static_cast<std::size_t>(start_s * rate_hz);
    const auto last = std::min(iq.size(), first + static_cast<std::size_t>(duration_s * rate_hz));
    for (std::size_t n = first; n < last; ++n) {
      const double turns = frequency_hz / rate_hz * static_cast<double>(n);
      iq[n] += Cf32(std::polar(amplitude(snr_db), kTwoPi * (turns - std::floor(turns))));
    }
  }
  [[nodiscard]] double amplitude(double snr_db) const {
    return std::sqrt(std::pow(10.0, 0.1 * snr_db) * 25e3 / rate_hz);
  }

  double rate_hz;
  std::vector<Cf32> iq;
};

/// What is in a recording, by time, then by frequency.
inline std::vector<DetectedBurst> found_in(IqSpan iq, const DetectorOptions& options) {
  BurstDetector detector(options);
  const auto some = detector.push(iq);
  std::vector<DetectedBurst> found(some.begin(), some.end());
  const auto rest = detector.flush();
  found.insert(found.end(), rest.begin(), rest.end());
  std::sort(found.begin(), found.end(), [](const DetectedBurst& a, const DetectedBurst& b) {
    return std::abs(a.start_s - b.start_s) > 1e-3 ? a.start_s < b.start_s : a.frequency_hz < b.frequency_hz;
  });
  return found;
}

}  // namespace soopnav::iridium::scene
