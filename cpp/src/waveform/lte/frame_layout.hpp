#pragma once

#include "soopnav/waveform/lte/types.hpp"

/// Where the synchronisation signals lie, in samples of 1.92 Msps (TS 36.211 6.11.1.2 and 6.11.2.2).
namespace soopnav::lte {

/// Start of the useful part of the PSS after the start of its half-frame. FDD: last symbol of slots 0 and 10; TDD:
/// third symbol of slots 2 and 12.
[[nodiscard]] constexpr int pss_in_half_frame(Duplex duplex, CyclicPrefix cp) noexcept {
  const int slot = duplex == Duplex::kFdd ? 0 : 1920;
  const int symbol = duplex == Duplex::kFdd ? symbols_per_slot(cp) - 1 : 2;
  return slot + symbol_start_samples(cp, symbol, 128) + cyclic_prefix_samples(cp, symbol, 128);
}

/// How far before the PSS the useful part of the SSS begins. FDD: the symbol before; TDD: the last symbol of the
/// subframe before, three symbols earlier.
[[nodiscard]] constexpr int sss_before_pss(Duplex duplex, CyclicPrefix cp) noexcept {
  const int slot = duplex == Duplex::kFdd ? 0 : 960;
  const int symbol = symbols_per_slot(cp) - (duplex == Duplex::kFdd ? 2 : 1);
  const int sss = slot + symbol_start_samples(cp, symbol, 128) + cyclic_prefix_samples(cp, symbol, 128);
  return pss_in_half_frame(duplex, cp) - sss;
}

static_assert(pss_in_half_frame(Duplex::kFdd, CyclicPrefix::kNormal) == 832);
static_assert(sss_before_pss(Duplex::kFdd, CyclicPrefix::kNormal) == 137);
static_assert(sss_before_pss(Duplex::kTdd, CyclicPrefix::kNormal) == 412);
static_assert(sss_before_pss(Duplex::kTdd, CyclicPrefix::kExtended) == 480);

}  // namespace soopnav::lte
