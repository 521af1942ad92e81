#pragma once

#include <cstddef>

namespace soopnav::ofdm {

/// The grid of an OFDM signal: all `subcarriers` carry data, and the last `prefix` samples of each symbol are sent
/// before it as well. Defaults are crosby's (IEEE 802.11a-like): 64 subcarriers, 16 samples of prefix, 20 MHz.
struct Numerology {
  int subcarriers = 64;          ///< N, at least 2
  int prefix = 16;               ///< v, at least 1 and below N
  double sample_rate_hz = 20e6;  ///< critical: N subcarriers fill it

  [[nodiscard]] constexpr int symbol_samples() const noexcept { return subcarriers + prefix; }  ///< M = N + v
  [[nodiscard]] double symbol_s() const noexcept { return symbol_samples() / sample_rate_hz; }  ///< M / f_s
  /// c M / f_s: a boundary is known modulo this length [m]; 1199.17 m by default.
  [[nodiscard]] double ambiguity_m() const noexcept;
  /// c / f_s [m]; 14.99 m by default.
  [[nodiscard]] double sample_m() const noexcept;

  friend bool operator==(const Numerology&, const Numerology&) = default;
};

/// Refuses grids that cannot be.
/// @throws std::invalid_argument unless 2 <= subcarriers <= 65536, 1 <= prefix < subcarriers and the rate is finite and
///         positive; the message names the parameter, its value and the rule.
void check(const Numerology& numerology);

}  // namespace soopnav::ofdm
