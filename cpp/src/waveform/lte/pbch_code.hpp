#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

// The linear code of the broadcast channel, shared by its encoder and decoder.
namespace soopnav::lte::detail {

inline constexpr std::size_t kMibBits = 24;
inline constexpr std::size_t kProtectedBits = 40;  // with the CRC
inline constexpr std::size_t kCodedBits = 120;

/// 120 bits, bit i of the word in bit i % 64 of part i / 64.
struct CodedWord {
  std::array<std::uint64_t, 2> part{};

  constexpr CodedWord& operator^=(const CodedWord& other) noexcept {
    part[0] ^= other.part[0];
    part[1] ^= other.part[1];
    return *this;
  }
  friend constexpr CodedWord operator^(CodedWord a, const CodedWord& b) noexcept { return a ^= b; }
  [[nodiscard]] constexpr bool bit(std::size_t i) const noexcept { return ((part[i / 64] >> (i % 64)) & 1U) != 0U; }
  constexpr void set(std::size_t i) noexcept { part[i / 64] |= std::uint64_t{1} << (i % 64); }
};

/// CRC of TS 36.212 5.1.1 (g_CRC16) of the 24 bits whose first is bit 0. p_0 is bit 0 of the result.
constexpr std::uint32_t crc16(std::uint32_t mib) noexcept {
  std::uint32_t remainder = 0;
  for (std::size_t i = 0; i < kMibBits; ++i) {
    const std::uint32_t feedback = ((remainder >> 15) ^ (mib >> i)) & 1U;
    remainder = ((remainder << 1) & 0xFFFFU) ^ (feedback != 0U ? 0x1021U : 0U);
  }
  std::uint32_t parity = 0;
  for (std::size_t i = 0; i < 16; ++i) parity |= ((remainder >> (15 - i)) & 1U) << i;
  return parity;
}

/// CRC mask of 1, 2 or 4 antenna ports (TS 36.212 table 5.3.1.1-1), first bit in bit 0.
constexpr std::uint32_t crc_mask(int n_ports) noexcept {
  if (n_ports == 1) return 0U;
  return n_ports == 2 ? 0xFFFFU : 0xAAAAU;
}

/// Which output (time, stream) stands at each place of the circular buffer (TS 36.212 5.1.4.2.1), as 3 * time + stream.
/// The interleaver's matrix has two rows of 32, of which the first 24 elements are dummies.
constexpr std::array<std::uint8_t, kCodedBits> make_circular_order() noexcept {
  constexpr std::array<std::uint8_t, 32> kColumns{1, 17, 9, 25, 5, 21, 13, 29, 3, 19, 11, 27, 7, 23, 15, 31,
                                                  0, 16, 8, 24, 4, 20, 12, 28, 2, 18, 10, 26, 6, 22, 14, 30};
  std::array<std::uint8_t, kCodedBits> order{};
  std::size_t place = 0;
  for (std::size_t stream = 0; stream < 3; ++stream) {
    for (const std::uint8_t column : kColumns) {
      if (column >= 24) order[place++] = static_cast<std::uint8_t>(3U * (column - 24U) + stream);
      order[place++] = static_cast<std::uint8_t>(3U * (column + 8U) + stream);
    }
  }
  return order;
}

inline constexpr std::array<std::uint8_t, kCodedBits> kCircularOrder = make_circular_order();

/// Generators 133, 171, 165 (octal); the highest of the seven bits weighs the newest input.
inline constexpr std::array<unsigned, 3> kGenerators{0133U, 0171U, 0165U};

/// Tail-biting convolutional code (TS 36.212 5.1.3.1) and sub-block interleaver: 40 bits to the 120 of the buffer.
constexpr CodedWord convolve(std::uint64_t bits) noexcept {
  std::array<std::uint64_t, 3> stream{};
  for (std::size_t s = 0; s < 3; ++s) {
    for (unsigned delay = 0; delay < 7; ++delay) {
      if (((kGenerators[s] >> (6U - delay)) & 1U) == 0U) continue;
      stream[s] ^= (bits << delay) | (bits >> (kProtectedBits - delay));  // output k sees input k - delay, cyclically
    }
  }
  CodedWord word;
  for (std::size_t i = 0; i < kCodedBits; ++i) {
    const std::size_t place = kCircularOrder[i];
    if (((stream[place % 3] >> (place / 3)) & 1U) != 0U) word.set(i);
  }
  return word;
}

constexpr std::array<CodedWord, kMibBits> make_basis() noexcept {
  std::array<CodedWord, kMibBits> basis{};
  for (std::size_t i = 0; i < kMibBits; ++i) {
    const std::uint32_t mib = 1U << i;
    basis[i] = convolve(mib | (std::uint64_t{crc16(mib)} << kMibBits));
  }
  return basis;
}

/// Coded words of the 24 unit vectors: CRC and code are linear, so any word is a sum of these and of a mask's word.
inline constexpr std::array<CodedWord, kMibBits> kBasis = make_basis();

constexpr CodedWord mask_word(int n_ports) noexcept { return convolve(std::uint64_t{crc_mask(n_ports)} << kMibBits); }

/// Circular buffer of the MIB whose first bit is bit 0, without the mask of the ports.
constexpr CodedWord encode_linear(std::uint32_t mib) noexcept {
  CodedWord word;
  for (std::size_t i = 0; i < kMibBits; ++i) {
    if (((mib >> i) & 1U) != 0U) word ^= kBasis[i];
  }
  return word;
}

inline constexpr std::size_t kSfnFirstBit = 6;  // eight bits, most significant first

/// The eight bits of the frame counter at their places in a MIB.
constexpr std::uint32_t place_counter(unsigned counter) noexcept {
  std::uint32_t mib = 0;
  for (std::size_t i = 0; i < 8; ++i) mib |= ((counter >> (7U - i)) & 1U) << (kSfnFirstBit + i);
  return mib;
}

constexpr unsigned read_counter(std::uint32_t mib) noexcept {
  unsigned counter = 0;
  for (std::size_t i = 0; i < 8; ++i) counter = (counter << 1) | ((mib >> (kSfnFirstBit + i)) & 1U);
  return counter;
}

}  // namespace soopnav::lte::detail
