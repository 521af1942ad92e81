#pragma once

#include <cstddef>
#include <memory>
#include <span>

#include "soopnav/core/iq.hpp"
#include "soopnav/waveform/cdma/pilot_code.hpp"

namespace soopnav::cdma {

struct AcquisitionOptions {
  double sample_rate_hz = 2.4576e6;
  double intermediate_hz = 0.0;           ///< where the carrier without Doppler lies in the samples
  double carrier_hz = 1.93125e9;          ///< which Doppler moves the code by, at least 100 MHz
  double max_doppler_hz = 2000.0;         ///< Dopplers within +- this are searched
  double coherent_s = 5e-3;               ///< of one correlation, up to one code period
  std::size_t noncoherent = 4;            ///< correlations whose powers are added
  double false_alarm_probability = 1e-3;  ///< of a whole search in noise, at most (cells taken as independent)
  std::size_t max_pilots = 8;             ///< largest number reported
};

/// A pilot that was found.
struct Acquisition {
  double delay_s = 0.0;        ///< of chip 0 of offset 0 after the first sample, in [0, 26.67 ms)
  double sigma_delay_s = 0.0;  ///< 1 σ, thermal and 0.3 samples: edges are seen on the grid of samples
  double doppler_hz = 0.0;     ///< positive when approaching
  double sigma_doppler_hz = 0.0;
  double cn0_dbhz = 0.0;  ///< of the pilot against all else in the band
  double sigma_cn0_db = 0.0;
  double statistic = 0.0;  ///< sum of |correlation|² over noise, of mean `noncoherent` in noise
  /// Offset whose first chip is nearest before: 64 * pn_offset chips lie within the delay, the rest is excess_s. Only a
  /// receiver whose first sample lies on a multiple of 26.67 ms of system time may take it for the base station's name
  /// (`offset_candidates`).
  int pn_offset = 0;
  double excess_s = 0.0;  ///< in [0, 52.08 us)
};

/// Offsets k in [0, 511] that explain a delay, when the first sample lies `start_s` after a multiple of the code period
/// of system time, known to +-`start_error_s`, and the signal travelled between 0 and `max_travel_s`. Written to `out`,
/// smallest first; returns how many there are, which may be more than `out` takes. No allocation.
[[nodiscard]] std::size_t offset_candidates(double delay_s, double start_s, double start_error_s, double max_travel_s,
                                            std::span<int> out) noexcept;

/// Searches samples for pilots of all offsets at once: one code, all its 32 768 chips' delays, by transforms.
///
/// The samples are cut into `noncoherent` blocks of `coherent_s`. Each, padded to one code period and a block, is
/// correlated with the code by FFT; a Doppler is a shift of its spectrum. Under noise the sum of K normalised powers is
/// Gamma(K, 1), exactly, so that a cell passes with P_cell = Q(K, threshold) and a search of C cells, half a chip
/// each, with 1 - (1 - P_cell)^C at most (cpp/doc/cdma_tracking.md, eq. 1 ... 3). Noise is all power received.
class PilotSearcher {
 public:
  /// Throws std::invalid_argument naming the field: a rate below 1.2288 MHz, a carrier below 100 MHz, a block beyond a
  /// code period or under 64 chips, no block, a probability outside (0, 0.1], negative Dopplers or such that the code
  /// moves by more than half a chip over the search. Allocates and plans.
  explicit PilotSearcher(const AcquisitionOptions& options);
  ~PilotSearcher();
  PilotSearcher(PilotSearcher&&) noexcept;
  PilotSearcher& operator=(PilotSearcher&&) noexcept;

  [[nodiscard]] const AcquisitionOptions& options() const noexcept;
  [[nodiscard]] std::size_t samples() const noexcept;      ///< that a search takes
  [[nodiscard]] std::size_t cells() const noexcept;        ///< delays times Dopplers
  [[nodiscard]] double threshold() const noexcept;         ///< of the statistic
  [[nodiscard]] double cell_false_alarm() const noexcept;  ///< probability that noise passes it in one cell

  /// Pilots in the first `samples()` samples, strongest first, in memory of this object (valid until the next call).
  /// Empty when there are too few samples or any is not finite. No allocation beyond that of the FFT library
  /// (dsp/fft.hpp); about 1.3 ms for each Doppler and block at 2.4576 MHz.
  [[nodiscard]] std::span<const Acquisition> search(IqSpan samples) noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::cdma
