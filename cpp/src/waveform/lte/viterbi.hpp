#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

namespace soopnav::lte::detail {

/// Result of a tail-biting search.
struct ViterbiResult {
  std::uint64_t bits = 0;    ///< 40 bits, the first in bit 0
  bool tail_biting = false;  ///< the path starts and ends in the same state
};

/// Wrap-around Viterbi decoder of the rate-1/3, K = 7 code of TS 36.212 5.1.3.1 over 40 bits.
///
/// Soft values: log P(0)/P(1), three for each time. Scratch is owned; no call allocates.
class TailBitingViterbi {
 public:
  /// First pass, from every state. Returns the largest correlation of any path, tail-biting or not: no word of the code
  /// correlates better with the soft values.
  float start(std::span<const float, 120> soft) noexcept;

  /// Further passes, each from the metrics the last one ended with, until the best path closes (four at most).
  ViterbiResult finish(std::span<const float, 120> soft) noexcept;

 private:
  void pass(std::span<const float, 120> soft) noexcept;

  alignas(64) std::array<float, 64> metric_{};
  alignas(
      64) std::array<std::array<float, 64>, 40> lead_{};  // of the even over the odd predecessor, per time and state
};

}  // namespace soopnav::lte::detail
