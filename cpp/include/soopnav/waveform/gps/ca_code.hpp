#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

/// GPS L1 C/A: codes, signals, what tracking loops make of them.
namespace soopnav::gps {

inline constexpr std::size_t kCodeLength = 1023;  ///< chips of a code
inline constexpr double kChipRateHz = 1.023e6;    ///< chips a second
inline constexpr double kCodePeriodS = 1e-3;      ///< of a whole code
inline constexpr double kBitPeriodS = 20e-3;      ///< of a data bit
inline constexpr double kCarrierHz = 1575.42e6;   ///< L1
inline constexpr int kMaxPrn = 37;                ///< codes 1 ... 37 (33 ... 37 serve other uses than satellites)

/// A code's chips as +1 (logical 0) and -1 (logical 1), in the order of their transmission.
using CaCode = std::array<std::int8_t, kCodeLength>;

/// The C/A code of satellite `prn` (IS-GPS-200N section 3.3.2.3): the sum of the maximal sequences G1 (1 + x³ + x¹⁰)
/// and G2 (1 + x² + x³ + x⁶ + x⁸ + x⁹ + x¹⁰), of which the taps of table 3-Ia are added; both start from all ones.
/// Throws std::invalid_argument unless `prn` is in [1, 37]. No allocation, 3 us.
[[nodiscard]] CaCode ca_code(int prn);

}  // namespace soopnav::gps
