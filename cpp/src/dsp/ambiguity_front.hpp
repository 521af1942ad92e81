#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/dsp/fft.hpp"

namespace soopnav::dsp::detail {

/// Mixes a band to zero and keeps every D-th sample of it; output m lies at input sample m D exactly.
class BandDecimator {
 public:
  /// @param passband  half width kept, as a fraction of the input rate
  BandDecimator(std::size_t factor, double passband, std::size_t max_samples);

  /// Writes in.size() / factor samples times `gain`; `frequency` in cycles per input sample. Allocates nothing.
  std::size_t apply(IqSpan in, double frequency, double gain, Cf32* out) noexcept;

  [[nodiscard]] std::size_t factor() const noexcept { return first_ * second_; }

 private:
  std::size_t first_ = 1, second_ = 1;
  std::vector<double> prototype_;
  std::vector<float> real_, imaginary_;  // the first filter about the band, every tap twice
  std::vector<float> taps_;              // the second filter, every tap twice
  std::vector<Cf32> middle_, edge_;
};

/// x(n + rate (n - pivot)) by windowed sinc, band-limited to 0.7 of half the sampling rate.
class Stretcher {
 public:
  explicit Stretcher(std::size_t max_samples);
  /// In place over n samples. Allocates nothing.
  void apply(Cf32* x, std::size_t n, double rate, double pivot) noexcept;

 private:
  std::vector<float> table_;
  std::vector<Cf32> padded_;
};

/// A steady line of a recording.
struct Line {
  double frequency;  ///< cycles per sample
  double amplitude;
};

/// Subtracts steady narrow lines from x[0, n): each is fitted in frequency, amplitude and phase. `spectrum` has
/// fft.size() elements and holds the spectrum of what is left on return. Returns how many, written to `lines`.
std::size_t subtract_lines(std::span<Cf32> x, const Fft& fft, double band, Cf32* work, Cf32* spectrum,
                           std::span<Line> lines) noexcept;

/// Zeroes bins around what is left of a line (one that is not quite steady): outwards while they stand out from
/// `level`, at most `limit` bins to either side. Returns how many.
std::size_t excise(std::span<Cf32> spectrum, double frequency, double level, std::size_t limit) noexcept;

/// The samples [first, last) that hold the burst, from the energies of blocks, noise power per sample being known
/// (0: unknown). All of them when nothing stands out.
struct BlockRange {
  std::size_t first, last;
};
BlockRange burst_blocks(std::span<const double> energy, double samples_per_block, double noise_power,
                        double independent) noexcept;

}  // namespace soopnav::dsp::detail
