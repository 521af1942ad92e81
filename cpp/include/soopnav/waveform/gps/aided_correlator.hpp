#pragma once

#include <complex>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/waveform/gps/ca_code.hpp"

namespace soopnav::gps {

struct AidedOptions {
  double sample_rate_hz = 2.048e6;  ///< at least the chip rate
  double intermediate_hz = 0.0;     ///< where the carrier without Doppler lies in the samples
  double block_s = 0.1;             ///< of one sum, rounded to whole samples, at most 1
  std::size_t max_blocks = 1000;    ///< that fit, 1 ... 1e6
  int half_chips = 2;               ///< code delays searched: -half_chips ... half_chips, half a chip apart, 0 ... 64
  std::vector<std::int8_t> bits{};  ///< known data, +1 or -1, 20 ms each, repeated; empty: all +1
};

/// What is known of a signal at a block's first sample: from an ephemeris, and the receiver's own clock.
struct Prediction {
  double transmit_time_s = 0.0;  ///< at which it left, counted so that bit 0 leaves from 0 on; any sign
  double carrier_phase_cycles =
      0.0;                  ///< grows with range and with the receiver's clock (measurement/carrier_phase.hpp)
  double doppler_hz = 0.0;  ///< minus its rate, > -1e6
  double doppler_rate_hzps = 0.0;
};

/// Correlates a weak satellite with what is predicted of it, block after block: the first half of a long coherent
/// search (pesyna section V-D). The samples are looked at once; frequencies are searched in the sums afterwards.
///
/// Sum of block b at code delay o half chips later than predicted: sum_n x(n) d c(t(n) - o) exp(j 2 pi φ(n) - j 2 pi
/// f_if n / f_s), t and φ the predicted transmission time and phase (doc/gps_acquisition.md eq. 11). Bits change where
/// the predicted code does, also for o other than 0: a chip of 20 460 lost at most.
class AidedCorrelator {
 public:
  /// Throws std::invalid_argument naming the field; for a PRN as `ca_code`. Allocates everything.
  AidedCorrelator(int prn, const AidedOptions& options);

  [[nodiscard]] const AidedOptions& options() const noexcept { return options_; }
  [[nodiscard]] std::size_t block_samples() const noexcept { return block_samples_; }
  [[nodiscard]] double block_s() const noexcept;  ///< as rounded
  [[nodiscard]] std::size_t codes() const noexcept { return static_cast<std::size_t>(2 * options_.half_chips + 1); }
  [[nodiscard]] std::size_t blocks() const noexcept { return blocks_; }
  /// Code delay of column `code`, later than predicted [chips].
  [[nodiscard]] double delay_chips(std::size_t code) const noexcept;

  /// Takes the next block; blocks follow each other without a gap. False, and nothing taken, for another number of
  /// samples than `block_samples()`, one that is not finite, a prediction that is not finite or off its range, or when
  /// all blocks are there. No allocation; some 6 ns a sample for five delays.
  [[nodiscard]] bool push(IqSpan block, const Prediction& prediction) noexcept;

  /// Sums so far, block by block, `codes()` each. In noise of variance 1 a sample each has variance `block_samples()`.
  [[nodiscard]] std::span<const std::complex<double>> sums() const noexcept;

  void clear() noexcept { blocks_ = 0; }

 private:
  AidedOptions options_;
  std::size_t block_samples_;
  std::size_t blocks_ = 0;
  std::vector<float> chips_;  // by half chips, with both ends repeated
  std::vector<std::complex<double>> sums_;
  std::vector<float> mixed_;  // real and imaginary parts by turns
  std::vector<float> partial_;
};

/// Frequencies of a search, first + k step.
struct FrequencyGrid {
  double first_hz = 0.0;
  double step_hz = 0.0;
  std::size_t count = 1;
};

/// The second half: T(code, f) = sum over coherent sums of |sum_b y_b exp(-j 2 pi f t_b)|² / (variance · blocks of it),
/// t_b the middle of block b: of the gamma law of shape `coherent sums` in noise (doc/gps_acquisition.md eqs. 5, 12).
///
/// `sums`: blocks x codes; every `coherent_blocks` of them make a coherent sum, what is left over at the end is not
/// used. `out`: codes x frequencies. False, `out` untouched, when sizes do not agree, no coherent sum fits, or a number
/// is not finite or not positive where it has to be. No allocation; blocks x codes x frequencies of 2 ns.
[[nodiscard]] bool search_frequencies(std::span<const std::complex<double>> sums, std::size_t codes, double block_s,
                                      double variance, const FrequencyGrid& grid, std::size_t coherent_blocks,
                                      std::span<double> out) noexcept;

}  // namespace soopnav::gps
