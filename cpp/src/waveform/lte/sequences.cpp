#include "soopnav/waveform/lte/sequences.hpp"

#include <cmath>
#include <cstddef>
#include <numbers>

namespace soopnav::lte {
namespace {

constexpr std::uint32_t kStateMask = 0x7FFFFFFFU;

// Both registers have their highest feedback tap at n + 3, so from 31 known elements the next 28 follow at once and
// four more from those: 63 elements in two steps, of which 32 leave and 31 stay.
constexpr std::uint64_t extend_x1(std::uint32_t state) noexcept {
  std::uint64_t s = state;
  s |= ((s ^ (s >> 3)) & 0xFFFFFFFULL) << 31;
  s |= (((s >> 28) ^ (s >> 31)) & 0xFULL) << 59;
  return s;
}

constexpr std::uint64_t extend_x2(std::uint32_t state) noexcept {
  std::uint64_t s = state;
  s |= ((s ^ (s >> 1) ^ (s >> 2) ^ (s >> 3)) & 0xFFFFFFFULL) << 31;
  s |= (((s >> 28) ^ (s >> 29) ^ (s >> 30) ^ (s >> 31)) & 0xFULL) << 59;
  return s;
}

constexpr int kSkippedWords = 50;  // N_C = 1600 = 50 * 32

constexpr std::uint32_t skip_x1(std::uint32_t state) noexcept {
  for (int i = 0; i < kSkippedWords; ++i) state = static_cast<std::uint32_t>(extend_x1(state) >> 32);
  return state;
}

constexpr std::uint32_t skip_x2(std::uint32_t state) noexcept {
  for (int i = 0; i < kSkippedWords; ++i) state = static_cast<std::uint32_t>(extend_x2(state) >> 32);
  return state;
}

constexpr std::uint32_t kX1AfterSkip = skip_x1(1U);

// The skip is linear over GF(2): the image of c_init is the exclusive or of one entry for each of its bytes.
using SkipTable = std::array<std::array<std::uint32_t, 256>, 4>;

constexpr SkipTable make_skip_table() noexcept {
  SkipTable table{};
  for (std::size_t byte = 0; byte < 4; ++byte) {
    for (std::size_t bit = 0; bit < 8; ++bit) {
      const std::size_t position = 8 * byte + bit;
      const std::uint32_t image = position < 31 ? skip_x2(1U << position) : 0U;
      const std::size_t half = std::size_t{1} << bit;
      for (std::size_t i = 0; i < half; ++i) table[byte][half + i] = table[byte][i] ^ image;
    }
  }
  return table;
}

constexpr SkipTable kSkipX2 = make_skip_table();

// Length-31 sequences of TS 36.211 6.11.2.1 as -1 and +1: x(0..3) = 0, x(4) = 1; x(i + 5) is the sum of the x(i + tap).
constexpr std::array<float, 31> make_sss_sequence(unsigned taps) noexcept {
  std::array<unsigned, 36> x{};
  x[4] = 1;
  for (std::size_t i = 0; i < 31; ++i) {
    unsigned sum = 0;
    for (std::size_t tap = 0; tap < 5; ++tap) sum ^= ((taps >> tap) & 1U) * x[i + tap];
    x[i + 5] = sum;
  }
  std::array<float, 31> out{};
  for (std::size_t i = 0; i < 31; ++i) out[i] = x[i] != 0U ? -1.0F : 1.0F;
  return out;
}

constexpr std::array<float, 31> kSssS = make_sss_sequence(0b00101);  // x(i+2) + x(i)
constexpr std::array<float, 31> kSssC = make_sss_sequence(0b01001);  // x(i+3) + x(i)
constexpr std::array<float, 31> kSssZ = make_sss_sequence(0b10111);  // x(i+4) + x(i+2) + x(i+1) + x(i)

std::array<std::array<Cf32, kSyncSubcarriers>, 3> make_pss() noexcept {
  constexpr std::array<int, 3> kRoots{25, 29, 34};
  std::array<std::array<Cf32, kSyncSubcarriers>, 3> table{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (int n = 0; n < kSyncSubcarriers; ++n) {
      const int product = n < 31 ? n * (n + 1) : (n + 1) * (n + 2);
      const double phase = -std::numbers::pi * static_cast<double>((kRoots[i] * product) % 126) / 63.0;
      table[i][static_cast<std::size_t>(n)] = {static_cast<float>(std::cos(phase)),
                                               static_cast<float>(std::sin(phase))};
    }
  }
  return table;
}

constexpr float kHalfRoot = static_cast<float>(std::numbers::sqrt2 / 2.0);

}  // namespace

GoldSequence::GoldSequence(std::uint32_t c_init) noexcept
    : x1_(kX1AfterSkip),
      x2_(kSkipX2[0][c_init & 0xFFU] ^ kSkipX2[1][(c_init >> 8) & 0xFFU] ^ kSkipX2[2][(c_init >> 16) & 0xFFU] ^
          kSkipX2[3][(c_init >> 24) & 0x7FU]) {}

std::uint32_t GoldSequence::next_word() noexcept {
  const std::uint64_t x1 = extend_x1(x1_);
  const std::uint64_t x2 = extend_x2(x2_);
  x1_ = static_cast<std::uint32_t>(x1 >> 32) & kStateMask;
  x2_ = static_cast<std::uint32_t>(x2 >> 32) & kStateMask;
  return static_cast<std::uint32_t>(x1 ^ x2);
}

const std::array<Cf32, kSyncSubcarriers>& pss(int n_id_2) noexcept {
  static const auto kTable = make_pss();
  return kTable[static_cast<std::size_t>(n_id_2)];
}

std::array<float, kSyncSubcarriers> sss(int cell_id, int subframe) noexcept {
  const int n_id_1 = cell_id / 3;
  const int n_id_2 = cell_id % 3;
  const int q_prime = n_id_1 / 30;
  const int q = (n_id_1 + q_prime * (q_prime + 1) / 2) / 30;
  const int m_prime = n_id_1 + q * (q + 1) / 2;
  const int m0 = m_prime % 31;
  const int m1 = (m0 + m_prime / 31 + 1) % 31;
  // Subframe 5 exchanges the two indices.
  const int even = subframe == 0 ? m0 : m1;
  const int odd = subframe == 0 ? m1 : m0;
  const auto at = [](const std::array<float, 31>& sequence, int i) {
    return sequence[static_cast<std::size_t>(i % 31)];
  };
  std::array<float, kSyncSubcarriers> d{};
  for (int n = 0; n < 31; ++n) {
    const auto i = static_cast<std::size_t>(2 * n);
    d[i] = at(kSssS, n + even) * at(kSssC, n + n_id_2);
    d[i + 1] = at(kSssS, n + odd) * at(kSssC, n + n_id_2 + 3) * at(kSssZ, n + even % 8);
  }
  return d;
}

bool has_crs(int symbol, int port, CyclicPrefix cp) noexcept {
  return port < 2 ? symbol == 0 || symbol == symbols_per_slot(cp) - 3 : symbol == 1;
}

int crs_first_subcarrier(int cell_id, int slot, int symbol, int port) noexcept {
  int v = 0;
  if (port < 2) {
    v = (port == 0) == (symbol == 0) ? 0 : 3;
  } else {
    v = 3 * (slot % 2) + (port == 3 ? 3 : 0);
  }
  return (v + cell_id % 6) % 6;
}

void crs_values(int cell_id, int slot, int symbol, CyclicPrefix cp, int n_rb, std::span<Cf32> out) noexcept {
  const int n_cp = cp == CyclicPrefix::kNormal ? 1 : 0;
  const int c_init = 1024 * (7 * (slot + 1) + symbol + 1) * (2 * cell_id + 1) + 2 * cell_id + n_cp;
  GoldSequence c(static_cast<std::uint32_t>(c_init));
  constexpr std::array<Cf32, 4> kQpsk{Cf32{kHalfRoot, kHalfRoot}, Cf32{-kHalfRoot, kHalfRoot},
                                      Cf32{kHalfRoot, -kHalfRoot}, Cf32{-kHalfRoot, -kHalfRoot}};
  // Element m' takes bits 2 m' and 2 m' + 1; the band's first is m' = 110 - n_rb, sixteen to a word.
  const int first = kMaxRb - n_rb;
  for (int i = 0; i < first / 16; ++i) static_cast<void>(c.next_word());
  int left = 16 - first % 16;
  std::uint32_t word = c.next_word() >> (2 * (first % 16));
  for (int m = 0; m < 2 * n_rb; ++m) {
    if (left == 0) {
      word = c.next_word();
      left = 16;
    }
    out[static_cast<std::size_t>(m)] = kQpsk[word & 3U];
    word >>= 2;
    --left;
  }
}

}  // namespace soopnav::lte
