#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "soopnav/core/iq.hpp"

namespace soopnav::iridium {

/// What was found in the spectrum.
enum class SignalClass {
  kBurst,       ///< begins and ends, with a bandwidth like a burst's
  kTone,        ///< most of its power within 6 kHz: interference, no burst
  kContinuous,  ///< wider than a tone, and longer than max_burst_s: reported once when it gets too long
};

/// A signal found by BurstDetector. Times count from the stream's first sample.
struct DetectedBurst {
  SignalClass kind = SignalClass::kBurst;
  double start_s = 0.0;
  double duration_s = 0.0;
  double frequency_hz = 0.0;        ///< of the carrier in its middle, DetectorOptions::center_frequency_hz added
  double frequency_sigma_hz = 0.0;  ///< its standard deviation (doc/iridium.md, section 5)
  double bandwidth_hz = 0.0;        ///< holds the middle 90 % of the power; 23.8 kHz for a burst
  double snr_db = 0.0;              ///< power over the noise's in 25 kHz
  bool cut_start = false;           ///< it was there when the stream began
  bool cut_end = false;             ///< it was there when the stream ended, or when it got too long
  /// The carrier comes from the fourth power of the symbols (a few Hz); otherwise from the spectrum's centre of gravity
  /// (hundreds of Hz for a short burst).
  bool fine_frequency = false;
};

struct DetectorOptions {
  double sample_rate_hz = 2e6;       ///< 50e3 ... 100e6
  double center_frequency_hz = 0.0;  ///< radio frequency at 0 Hz of the samples
  double false_alarms_per_s = 1e-3;  ///< reports from noise alone, at most, 1e-9 ... 100
  double max_burst_s = 0.1;          ///< longer signals are continuous, 0.02 ... 1, at most 20e6 samples

  /// Throws std::invalid_argument naming the field that breaks its rule.
  void check() const;
};

/// Finds bursts in a wide band as the samples come (doc/iridium.md, sections 3 to 5).
///
/// Spectra of 1 ms every 0.5 ms (Hann); the noise of each kilohertz by a tracked median, smoothed over 50 kHz; a cell's
/// test is the mean of the power over noise in 25 kHz and 6 ms, above a threshold from the false-alarm rate (the mean's
/// distribution is a gamma one, its shape from the overlap of window and spectra). What lies above it together is one
/// candidate; its samples are mixed down, filtered by the burst's pulse, cut where the power's likelihood says that it
/// begins and ends (an 8.28 ms burst at 10 dB: to 0.1 ms), and the fourth power of what is left, a tone for QPSK, gives
/// the carrier (2 Hz).
///
/// Bursts of -2 dB (in 25 kHz) are found two times in three, of 0 dB always, whatever their length, as the test looks
/// at 6 ms. Bursts on neighbouring channels are told apart; in one channel gaps from 0.4 ms, so not the 0.1 ms between
/// slots. Tones that stay are reported once and then count as noise.
///
/// The constructor allocates (some 50 bytes for each sample of max_burst_s + 30 ms), `push` and `flush` do not. One
/// object serves one thread. 2 Msps take a thirtieth of a core, with a hundred bursts a second a twentieth.
class BurstDetector {
 public:
  /// @throws std::invalid_argument by DetectorOptions::check.
  explicit BurstDetector(const DetectorOptions& options);
  ~BurstDetector();
  BurstDetector(BurstDetector&&) noexcept;
  BurstDetector& operator=(BurstDetector&&) noexcept;
  BurstDetector(const BurstDetector&) = delete;
  BurstDetector& operator=(const BurstDetector&) = delete;

  /// Takes the next samples; returns the signals that ended in them, in the order of their ends, valid until the next
  /// call. A burst is reported 6 to 10 ms after its end; nothing during the first 64 ms, in which the noise is learnt
  /// (bursts in them are reported then). At most 1024 a call: what is more is dropped and counted.
  /// Samples that are not finite count as zero, and are counted.
  std::span<const DetectedBurst> push(IqSpan samples) noexcept;
  /// Ends the stream: returns the signals still open, and starts afresh. Fewer than 5 ms of samples hold nothing.
  std::span<const DetectedBurst> flush() noexcept;
  /// Forgets the stream so far, the noise too.
  void reset() noexcept;

  [[nodiscard]] const DetectorOptions& options() const noexcept;
  [[nodiscard]] std::uint64_t samples() const noexcept;           ///< of the stream so far
  [[nodiscard]] std::uint64_t rejected_samples() const noexcept;  ///< of them not finite
  [[nodiscard]] std::uint64_t dropped() const noexcept;           ///< signals that found no place in a report
  /// Threshold of the mean power over noise, in the absence of a signal 1 (once the noise is learnt; 0 before).
  [[nodiscard]] double threshold() const noexcept;
  [[nodiscard]] double bin_width_hz() const noexcept;  ///< of the spectra, about 1 kHz

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::iridium
