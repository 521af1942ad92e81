#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/waveform/ofdm/numerology.hpp"

namespace soopnav::ofdm {

/// What each subcarrier carries; every point is as likely as any other, and the mean of |X|^2 is 1.
enum class Constellation : std::uint8_t {
  kQpsk,   ///< 2 bits
  kQam16,  ///< 4 bits
  kQam64,  ///< 6 bits
};

/// Makes strings of OFDM symbols with data drawn at random.
///
/// Model:  x(v + n) = N^-1/2 sum_k X_k exp(+j 2 pi k n / N), n = 0 .. N-1, and x(n) = x(N + n) before it
///         (crosby 2.2, 2.3; unitary, so that E|x|^2 = 1).
/// The points X_k of one symbol come from ceil(N / (32 / bits)) draws of `next_u32`, each cut into whole groups of
/// bits, lowest first; a group's lower half is the real part.
class Synthesizer {
 public:
  /// @throws std::invalid_argument for a bad numerology.
  explicit Synthesizer(const Numerology& numerology, Constellation constellation = Constellation::kQpsk);

  /// Fills `out` with out.size() / M whole symbols, the first one's prefix first. The rest of `out`, less than a
  /// symbol, is zero. Allocates nothing. One object serves one thread at a time.
  void fill(std::span<Cf32> out, RandomStream& random) noexcept;

  [[nodiscard]] const Numerology& numerology() const noexcept { return numerology_; }
  [[nodiscard]] Constellation constellation() const noexcept { return constellation_; }
  /// Draws of `next_u32` that one symbol takes.
  [[nodiscard]] std::size_t draws_per_symbol() const noexcept { return words_.size(); }

 private:
  Numerology numerology_;
  Constellation constellation_;
  unsigned bits_;
  dsp::Fft fft_;
  std::vector<Cf32> points_;  // by group of bits, scaled by N^-1/2
  std::vector<std::uint32_t> words_;
  std::vector<Cf32> spectrum_;
};

}  // namespace soopnav::ofdm
