#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "soopnav/core/iq.hpp"

/// cdma2000 (spreading rate 1) and IS-95 forward link: pilot codes, signals, acquisition.
namespace soopnav::cdma {

inline constexpr std::size_t kCodeLength = 32768;    ///< chips of a short code
inline constexpr double kChipRateHz = 1.2288e6;      ///< chips a second
inline constexpr double kCodePeriodS = 80e-3 / 3.0;  ///< of a whole code; 75 in 2 s
inline constexpr int kOffsets = 512;                 ///< pilots told apart by their offsets
inline constexpr std::size_t kOffsetChips = 64;      ///< between neighbouring offsets
inline constexpr double kOffsetS = static_cast<double>(kOffsetChips) / kChipRateHz;  ///< 52.083 us
inline constexpr std::size_t kWalshLength = 64;                                      ///< chips of a Walsh code

/// Chips +1 (logical 0) and -1 (logical 1), in the order of transmission.
using ShortCode = std::array<std::int8_t, kCodeLength>;

/// The two short codes at offset 0.
struct ShortCodes {
  ShortCode i;
  ShortCode q;
};

/// Short PN codes (3GPP2 C.S0002 section 3.1.3.1.13, TIA-95 section 7.1.3.1.9): maximal sequences of
/// P_I(x) = x¹⁵ + x¹³ + x⁹ + x⁸ + x⁷ + x⁵ + 1 and P_Q(x) = x¹⁵ + x¹² + x¹¹ + x¹⁰ + x⁶ + x⁵ + x⁴ + x³ + 1, with a zero
/// put after their only run of fourteen, so that 2¹⁵ chips are balanced. Chip 0 is the logical one that follows the
/// fifteen zeros; it leaves the base station of offset 0 on every even second of system time. Made once, at the first
/// call (0.3 ms); no allocation.
[[nodiscard]] const ShortCodes& short_codes();

/// One period of the pilot of an offset: (i(n) - j q(n)) / sqrt(2), unit power, as the standard's s(t) = I cos wt +
/// Q sin wt has it at baseband. Offset k is offset 0 later by 64 k chips: chip n of it is chip (n - 64 k) mod 32768.
/// Throws std::invalid_argument unless `pn_offset` is in [0, 511]. Allocates the 32 768 chips.
[[nodiscard]] std::vector<Cf32> pilot_code(int pn_offset = 0);

/// Chip `chip` (mod 64) of Walsh code `index` (mod 64): +1 or -1, (-1)^(number of ones in index & chip) (C.S0002
/// section 3.1.3.1.12). Walsh code 0 is the pilot's.
[[nodiscard]] int walsh_chip(std::size_t index, std::size_t chip) noexcept;

}  // namespace soopnav::cdma
