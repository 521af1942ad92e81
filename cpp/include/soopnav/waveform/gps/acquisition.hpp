#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "soopnav/core/iq.hpp"
#include "soopnav/waveform/gps/ca_code.hpp"

namespace soopnav::gps {

struct AcquisitionOptions {
  double sample_rate_hz = 2.048e6;  ///< a whole number of kilohertz, at least the chip rate and at most 100 MHz
  double intermediate_hz = 0.0;     ///< where the carrier without Doppler lies in the samples
  int coherent_ms = 1;              ///< of one coherent sum, 1 ... 20: whole codes; beyond 1 data bits may cut into it
  int noncoherent = 1;              ///< coherent sums whose powers are added, 1 ... 10 000
  double min_doppler_hz = -5000.0;
  double max_doppler_hz = 5000.0;
  double doppler_step_hz = 0.0;           ///< 0: half of the inverse of a coherent sum, at most 1 dB off in between
  double false_alarm_probability = 1e-3;  ///< of a whole search in noise, at most
  double noise_variance = 0.0;            ///< of a sample, E|w|²; 0: the mean power of the samples
};

/// How a search ended.
enum class AcquisitionStatus : std::uint8_t {
  kFound,          ///< the statistic passes the threshold
  kNotFound,       ///< it does not: the rest is that of the highest cell all the same
  kTooFewSamples,  ///< nothing was searched
  kNotFinite,      ///< a sample is not finite or beyond 1e15, all are zero, or the statistic overflows: nothing known
};

/// The highest cell of a search.
struct Acquisition {
  int prn = 0;
  AcquisitionStatus status = AcquisitionStatus::kTooFewSamples;
  double delay_s = 0.0;     ///< when a code begins, after the first sample, in [0, 1 ms); between cells by a parabola
  double doppler_hz = 0.0;  ///< positive when approaching; between cells by a parabola
  double cn0_dbhz = 0.0;    ///< of the highest cell, its losses between cells not given back; at least 0
  double statistic = 0.0;   ///< sum of the coherent sums' powers over the noise's; mean `noncoherent` in noise
  std::size_t bin = 0;      ///< of the Dopplers
  std::size_t sample = 0;   ///< of the delays
};

/// Searches samples for a satellite's code: all delays by FFT, Doppler by Doppler (Kaplan and Hegarty section 5.1).
///
/// Coherent sums are folded to one code, mixed to zero and correlated on a circle; where the Doppler moves the code
/// during long searches the sums are moved back by it before powers are added (doc/gps_acquisition.md eqs. 1 to 4). In
/// white noise of known variance a cell's statistic is of the gamma law of shape `noncoherent`, exactly; the threshold
/// is that of `cells()` cells by `dsp::cell_false_alarm`: exact for independent ones, and since oversampled delays and
/// half-spaced Dopplers are correlated, the search's false alarm is at most what was asked. With the samples' own power
/// for the noise's the law is a scaled beta's, whose tail is shorter, and the signal itself counts as noise.
class Acquirer {
 public:
  /// Throws std::invalid_argument naming the field. Allocates 4 bytes for each cell and plans transforms.
  explicit Acquirer(const AcquisitionOptions& options);
  ~Acquirer();
  Acquirer(Acquirer&&) noexcept;
  Acquirer& operator=(Acquirer&&) noexcept;

  [[nodiscard]] const AcquisitionOptions& options() const noexcept;  ///< doppler_step_hz as it is used
  [[nodiscard]] std::size_t samples() const noexcept;                ///< that a search takes
  [[nodiscard]] std::size_t delays() const noexcept;                 ///< samples of a code
  [[nodiscard]] std::size_t dopplers() const noexcept;
  [[nodiscard]] std::size_t cells() const noexcept { return delays() * dopplers(); }
  [[nodiscard]] double doppler_hz(std::size_t bin) const noexcept;
  [[nodiscard]] double cell_false_alarm() const noexcept;
  [[nodiscard]] double threshold() const noexcept;  ///< of the statistic

  /// Searches the first `samples()` samples. For a PRN without code: std::invalid_argument; otherwise nothing throws.
  /// No allocation, but for the FFT library's with prime factors above 13 in a code's samples (dsp/fft.hpp; 2.048
  /// and 4.096 MHz have none, 2.046 and 4.092 do). For each Doppler two transforms a coherent sum and one pass over the
  /// samples.
  [[nodiscard]] Acquisition search(IqSpan samples, int prn);

  /// Statistics of the last search, Doppler by Doppler, `delays()` each; zeros before the first.
  [[nodiscard]] std::span<const float> surface() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Share of a signal's power that a cell keeps which is off by a delay and a Doppler: (1 - |chips|)² of rectangular
/// chips, sinc²(Hz T) (doc/gps_acquisition.md eq. 10). No allocation.
[[nodiscard]] double cell_loss(double delay_error_chips, double doppler_error_hz, double coherent_s) noexcept;

}  // namespace soopnav::gps
