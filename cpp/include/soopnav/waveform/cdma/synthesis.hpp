#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/cdma/pilot_code.hpp"

namespace soopnav::cdma {

/// Another code channel of a base station, which a receiver of its pilot takes for noise.
struct WalshChannel {
  std::size_t index = 1;   ///< 1 ... 63
  double power_db = -7.0;  ///< against the pilot
};

/// One base station's signal at an antenna.
struct PilotSignal {
  int pn_offset = 0;          ///< 0 ... 511
  double delay_s = 0.0;       ///< when chip 0 of offset 0 would begin, after the first sample; any sign
  double doppler_hz = 0.0;    ///< positive when approaching; the code runs faster by as much, |doppler| <= 1e6
  double phase_cycles = 0.0;  ///< of the carrier at the first sample
  double cn0_dbhz = 45.0;     ///< the pilot's carrier to noise density, noise of variance 1 a sample
  std::vector<WalshChannel> channels{};  ///< random QPSK symbols of 64 chips on each
};

/// How chips become a waveform.
enum class ChipShape : std::uint8_t {
  kRectangular,  ///< no filter
  kStandard,     ///< the base station's filter of 48 taps (C.S0002 table 3.1.3.1.11-1), 590 kHz pass, 740 kHz stop band
};

/// What all signals of a generator share.
struct SynthesisOptions {
  double sample_rate_hz = 2.4576e6;
  double intermediate_hz = 0.0;   ///< where the carrier without Doppler lies in the samples
  double carrier_hz = 1.93125e9;  ///< which Doppler moves the code by
  ChipShape shape = ChipShape::kRectangular;
  std::uint64_t data_seed = 1;  ///< of the other channels' symbols
};

/// Makes the sum of base stations' signals, block after block.
///
/// Model:  x(n) = sum A c(t') exp(j 2 pi (f_if + D) n / f_s + j 2 pi φ),  t' = (1 + D / f_c) n / f_s - delay, c the
/// pilot's chips (with other channels: their sum) at transmission time t'. A = sqrt(10^(C/N0 / 10) / f_s): beside
/// complex noise of variance 1 a sample, density 1 / f_s, the pilot has its C/N0. The standard's filter is scaled to
/// the same power, and its waveform between taps is their band-limited interpolation (cpp/doc/cdma_tracking.md).
class PilotGenerator {
 public:
  /// Throws std::invalid_argument naming the field: an offset or Walsh code that does not exist, rates that are not
  /// positive, |intermediate_hz| beyond half the rate, numbers that are not finite, |doppler_hz| above 1 MHz.
  /// Allocates.
  explicit PilotGenerator(std::vector<PilotSignal> signals, const SynthesisOptions& options = {});

  [[nodiscard]] const SynthesisOptions& options() const noexcept { return options_; }
  [[nodiscard]] std::span<const PilotSignal> signals() const noexcept { return signals_; }

  /// Samples `first` ... of the stream, overwriting `out`. Blocks join without a seam, as gps::SignalGenerator's. No
  /// allocation; about 11 ns a sample for each rectangular pilot, 67 ns for a filtered one, 18 ns more for each
  /// channel.
  void render(std::uint64_t first, std::span<Cf32> out) const noexcept;

  /// The same with noise of variance 1 a sample, of which sample `first` takes the draws from 2 * `first` on.
  void render(std::uint64_t first, std::span<Cf32> out, RandomStream noise) const noexcept;

 private:
  [[nodiscard]] Cf32 chip(const PilotSignal& signal, std::size_t number, std::int64_t chip) const noexcept;

  std::vector<PilotSignal> signals_;
  SynthesisOptions options_;
  std::vector<Cf32> code_;    // offset 0
  std::vector<float> pulse_;  // of the filter, kPulsePhases phases of each of its chips
};

/// Taps of the standard's filter, four a chip, symmetric, the largest two 1.
[[nodiscard]] std::span<const double, 48> baseband_filter() noexcept;

}  // namespace soopnav::cdma
