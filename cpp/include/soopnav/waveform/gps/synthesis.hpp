#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/gps/ca_code.hpp"

namespace soopnav::gps {

/// One satellite's L1 C/A signal at an antenna.
struct SatelliteSignal {
  int prn = 1;
  double delay_s = 0.0;             ///< when the code of data bit 0 begins, after the first sample; any sign
  double doppler_hz = 0.0;          ///< positive when approaching; the code runs faster by as much, |doppler| <= 1e6
  double phase_cycles = 0.0;        ///< of the carrier at the first sample
  double cn0_dbhz = 45.0;           ///< carrier to noise density against noise of variance 1 a sample
  std::vector<std::int8_t> bits{};  ///< +1 or -1, 20 ms each, repeated; empty: all +1
};

/// Makes the sum of satellites' signals, block after block.
///
/// Model:  x(n) = sum A d(t') c(t') exp(j 2 pi (f_if + D) n / f_s + j 2 pi φ),  t' = (1 + D / f_L1) n / f_s - delay,
/// c the code and d the data at transmission time t' (carter section 2.2). A = sqrt(10^(C/N0 / 10) / f_s): beside
/// complex noise of variance 1 a sample, density 1 / f_s, the satellite has its C/N0. Chips are rectangular: no filter.
class SignalGenerator {
 public:
  /// `intermediate_hz`: where the carrier without Doppler lies in the samples.
  /// Throws std::invalid_argument for a PRN without code, a rate that is not positive, |intermediate_hz| beyond half of
  /// it, numbers that are not finite, |doppler_hz| above 1 MHz and bits other than +1 and -1. Allocates.
  SignalGenerator(std::vector<SatelliteSignal> signals, double sample_rate_hz, double intermediate_hz = 0.0);

  [[nodiscard]] double sample_rate_hz() const noexcept { return sample_rate_hz_; }
  [[nodiscard]] std::span<const SatelliteSignal> signals() const noexcept { return signals_; }

  /// Samples `first` ... of the stream of samples, overwriting `out`. Blocks join without a seam: phases are computed
  /// from the sample's number, and follow a rotation within 512 samples, right to 1e-4 rad. No allocation, one pass of
  /// about 5 ns a sample for each satellite.
  void render(std::uint64_t first, std::span<Cf32> out) const noexcept;

  /// The same with noise of variance 1 a sample, of which sample `first` takes the draws from 2 * `first` on.
  void render(std::uint64_t first, std::span<Cf32> out, RandomStream noise) const noexcept;

 private:
  std::vector<SatelliteSignal> signals_;
  std::vector<CaCode> codes_;
  double sample_rate_hz_;
  double intermediate_hz_;
};

}  // namespace soopnav::gps
