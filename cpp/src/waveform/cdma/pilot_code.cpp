#include "soopnav/waveform/cdma/pilot_code.hpp"

#include <bit>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <stdexcept>
#include <string>

namespace soopnav::cdma {
namespace {

constexpr unsigned kStages = 15;

// One code: the recurrence c(n) = sum of c(n - lag), whose only run of fourteen zeros gets a fifteenth.
ShortCode make_code(std::initializer_list<unsigned> lags) noexcept {
  std::uint32_t taps = 0;
  for (const unsigned lag : lags) taps |= 1U << (lag - 1);
  std::uint32_t past = 1U << (kStages - 1);  // bit m - 1: chip n - m. After the zeros comes what was before them, a one
  ShortCode code{};
  for (std::size_t n = 0; n + 1 < kCodeLength; ++n) {
    const std::uint32_t next = static_cast<std::uint32_t>(std::popcount(past & taps)) & 1U;
    code[n] = next != 0U ? std::int8_t{-1} : std::int8_t{1};
    past = ((past << 1U) | next) & ((1U << kStages) - 1U);
  }
  code[kCodeLength - 1] = 1;  // the zero put in: the run of fourteen ends the period
  return code;
}

}  // namespace

const ShortCodes& short_codes() {
  static const ShortCodes codes{make_code({15, 10, 8, 7, 6, 2}), make_code({15, 12, 11, 10, 9, 5, 4, 3})};
  return codes;
}

std::vector<Cf32> pilot_code(int pn_offset) {
  if (pn_offset < 0 || pn_offset >= kOffsets) {
    throw std::invalid_argument("pn_offset = " + std::to_string(pn_offset) + " must be in [0, 511]");
  }
  const ShortCodes& codes = short_codes();
  const float scale = std::sqrt(0.5F);
  std::vector<Cf32> out(kCodeLength);
  const std::size_t shift = kCodeLength - kOffsetChips * static_cast<std::size_t>(pn_offset);
  for (std::size_t n = 0; n < kCodeLength; ++n) {
    const std::size_t k = (n + shift) % kCodeLength;
    out[n] = {scale * static_cast<float>(codes.i[k]), -scale * static_cast<float>(codes.q[k])};
  }
  return out;
}

int walsh_chip(std::size_t index, std::size_t chip) noexcept {
  return (std::popcount((index & chip) % kWalshLength) & 1) != 0 ? -1 : 1;
}

}  // namespace soopnav::cdma
