#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "soopnav/core/iq.hpp"

/// LTE downlink: synthesis, cell search and time of arrival (3GPP TS 36.211 and 36.212, release 8 physical layer).
namespace soopnav::lte {

inline constexpr double kSubcarrierSpacingHz = 15e3;
inline constexpr double kBaseRateHz = 1.92e6;  ///< 128-point transform, six resource blocks
inline constexpr double kFrameS = 10e-3;       ///< radio frame
inline constexpr int kCells = 504;             ///< physical-layer cell identities
inline constexpr int kSyncSubcarriers = 62;    ///< PSS and SSS length
inline constexpr int kMaxRb = 110;             ///< N_RB^max,DL of TS 36.211 6.10.1.1
inline constexpr int kMaxPorts = 4;
inline constexpr std::array<int, 6> kBandwidthsRb{6, 15, 25, 50, 75, 100};

/// Cyclic prefix of the downlink (TS 36.211 table 6.12-1), at 15 kHz subcarrier spacing.
enum class CyclicPrefix : std::uint8_t { kNormal, kExtended };

/// Frame structure: type 1 (FDD) or type 2 (TDD), TS 36.211 section 4.
enum class Duplex : std::uint8_t { kFdd, kTdd };

/// Symbols of a slot: 7 with the normal cyclic prefix, 6 with the extended one.
[[nodiscard]] constexpr int symbols_per_slot(CyclicPrefix cp) noexcept { return cp == CyclicPrefix::kNormal ? 7 : 6; }

/// Length of the cyclic prefix of `symbol` (of its slot) in samples of a `fft_size`-point transform at 15 kHz spacing.
/// Whole for multiples of 128: 10 or 9 per 128 points (normal), 32 (extended).
[[nodiscard]] constexpr int cyclic_prefix_samples(CyclicPrefix cp, int symbol, int fft_size) noexcept {
  const int per_128 = cp == CyclicPrefix::kExtended ? 32 : (symbol == 0 ? 10 : 9);
  return per_128 * (fft_size / 128);
}

/// First sample of the cyclic prefix of `symbol`, counted from the start of its slot.
[[nodiscard]] constexpr int symbol_start_samples(CyclicPrefix cp, int symbol, int fft_size) noexcept {
  const int unit = fft_size / 128;
  if (cp == CyclicPrefix::kExtended) return symbol * 160 * unit;
  return symbol == 0 ? 0 : (138 + (symbol - 1) * 137) * unit;
}

/// Transform bin (0 ... fft_size-1) of the 0-based `subcarrier` of an `n_rb` grid; the bin of zero frequency is
/// skipped.
[[nodiscard]] constexpr int subcarrier_bin(int subcarrier, int n_rb, int fft_size) noexcept {
  const int centred = subcarrier - 6 * n_rb;
  return centred < 0 ? centred + fft_size : centred + 1;
}

/// Frequency of the 0-based `subcarrier` in units of 15 kHz from the carrier (never 0).
[[nodiscard]] constexpr int subcarrier_index(int subcarrier, int n_rb) noexcept {
  const int centred = subcarrier - 6 * n_rb;
  return centred < 0 ? centred : centred + 1;
}

/// A cell found in a capture.
///
/// Times run from the capture's first sample. Signs: `cfo_hz` is where the carrier lies in the baseband spectrum;
/// `clock_error_ppm` is how much faster the cell's clock runs than the receiver's sampling clock (frames of a
/// positive error are short in samples), so a receiver whose mixer and converter share one crystal sees
/// cfo_hz = 1e-6 * clock_error_ppm * carrier_hz.
struct Detection {
  int cell_id = 0;             ///< 0 ... 503
  std::optional<int> n_rb;     ///< downlink bandwidth in resource blocks, when the MIB was decoded
  std::optional<int> n_ports;  ///< antenna ports 1, 2 or 4, when the MIB was decoded
  std::optional<int> sfn;      ///< system frame number of the frame at `frame_start_s`, when decoded
  CyclicPrefix cp = CyclicPrefix::kNormal;
  Duplex duplex = Duplex::kFdd;
  double frame_start_s = 0.0;  ///< start (cyclic prefix included) of the first radio frame, 0 <= ... < 10 ms
  double cfo_hz = 0.0;
  double cfo_sigma_hz = 0.0;
  double clock_error_ppm = 0.0;
  double clock_error_sigma_ppm = 0.0;
  double snr_db = 0.0;         ///< per CRS resource element, mean over ports, central six resource blocks
  double power_db = 0.0;       ///< of a CRS resource element, mean over ports; 0 dB: magnitude 1 in a unitary transform
  double crs_statistic = 0.0;  ///< evidence of the confirming CRS test, in units of its noise mean
};

}  // namespace soopnav::lte
