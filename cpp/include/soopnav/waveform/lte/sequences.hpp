#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "soopnav/waveform/lte/types.hpp"

namespace soopnav::lte {

/// Length-31 Gold sequence c(n) of TS 36.211 section 7.2, N_C = 1600 already skipped. No allocation.
class GoldSequence {
 public:
  explicit GoldSequence(std::uint32_t c_init) noexcept;

  /// The next 32 elements: bit i of the word is c(n + i). Advances by 32.
  [[nodiscard]] std::uint32_t next_word() noexcept;

 private:
  std::uint32_t x1_, x2_;  // next 31 elements of each register, element n in bit 0
};

/// Primary synchronisation signal d_u(n), n = 0 ... 61, lowest subcarrier first (TS 36.211 6.11.1.1). `n_id_2`: 0
/// ... 2. Unit modulus; the table is made once.
[[nodiscard]] const std::array<Cf32, kSyncSubcarriers>& pss(int n_id_2) noexcept;

/// Secondary synchronisation signal d(n) of -1 and +1, lowest subcarrier first (TS 36.211 6.11.2.1).
/// `cell_id`: 0 ... 503; `subframe`: 0 or 5.
[[nodiscard]] std::array<float, kSyncSubcarriers> sss(int cell_id, int subframe) noexcept;

/// Whether `symbol` (of its slot) carries cell-specific reference signals of `port` (TS 36.211 6.10.1.2).
[[nodiscard]] bool has_crs(int symbol, int port, CyclicPrefix cp) noexcept;

/// Subcarrier of the first reference element: (v + v_shift) mod 6; the others follow every 6. `slot`: 0 ... 19.
[[nodiscard]] int crs_first_subcarrier(int cell_id, int slot, int symbol, int port) noexcept;

/// Reference values r_{l,ns}(m') of the 2 n_rb elements, lowest subcarrier first, for `slot` 0 ... 19 and `symbol` of
/// the slot. The same for every port. `out` holds 2 n_rb elements. No allocation.
void crs_values(int cell_id, int slot, int symbol, CyclicPrefix cp, int n_rb, std::span<Cf32> out) noexcept;

}  // namespace soopnav::lte
