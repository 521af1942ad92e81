#include "soopnav/waveform/lte/sequences.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <cstdint>
#include <numbers>
#include <set>
#include <utility>
#include <vector>

#include "waveform/naive_gold.hpp"

namespace soopnav::lte {
namespace {

std::size_t index(int i) { return static_cast<std::size_t>(i); }

TEST(GoldSequence, EqualsTheDefinitionBitByBit) {
  const std::vector<std::uint32_t> seeds{0U,          1U,          2U,          503U,       0x12345678U,
                                         0x55555555U, 0x2AAAAAAAU, 0x40000000U, 0x7FFFFFFFU};
  for (const std::uint32_t seed : seeds) {
    GoldSequence fast(seed);
    const auto slow = test::naive_gold(seed, 4096);
    for (std::size_t word = 0; word < 128; ++word) {
      const std::uint32_t bits = fast.next_word();
      for (std::size_t i = 0; i < 32; ++i) {
        ASSERT_EQ(static_cast<int>((bits >> i) & 1U), slow[32 * word + i])
            << "c_init " << seed << ", n " << 32 * word + i;
      }
    }
  }
}

TEST(GoldSequence, EverySeedBitCounts) {
  std::set<std::pair<std::uint32_t, std::uint32_t>> seen;
  for (int bit = 0; bit < 31; ++bit) {
    GoldSequence c(1U << bit);
    const std::uint32_t first = c.next_word();
    const std::uint32_t second = c.next_word();
    seen.insert({first, second});
    const auto slow = test::naive_gold(1U << bit, 64);
    for (std::size_t i = 0; i < 64; ++i) {
      ASSERT_EQ(static_cast<int>(((i < 32 ? first : second) >> (i % 32)) & 1U), slow[i])
          << "bit " << bit << ", n " << i;
    }
  }
  EXPECT_EQ(seen.size(), 31U);
}

TEST(Pss, EqualsTheFormulaForAllRoots) {
  constexpr int kRoots[] = {25, 29, 34};
  for (int n_id_2 = 0; n_id_2 < 3; ++n_id_2) {
    const auto& d = pss(n_id_2);
    for (int n = 0; n < 62; ++n) {
      const double u = kRoots[n_id_2];
      const double exponent = n <= 30 ? u * n * (n + 1) / 63.0 : u * (n + 1) * (n + 2) / 63.0;
      const std::complex<double> expected = std::polar(1.0, -std::numbers::pi * exponent);
      EXPECT_NEAR(d[index(n)].real(), expected.real(), 1e-7) << n_id_2 << ' ' << n;
      EXPECT_NEAR(d[index(n)].imag(), expected.imag(), 1e-7) << n_id_2 << ' ' << n;
    }
  }
}

TEST(Pss, RootsTwentyNineAndThirtyFourAreConjugates) {
  for (std::size_t n = 0; n < 62; ++n) EXPECT_LT(std::abs(pss(1)[n] - std::conj(pss(2)[n])), 1e-6F);
}

// The tables of m0 and m1 (TS 36.211 table 6.11.2.1-1): pairs in rows of growing distance, here counted out.
std::vector<std::pair<int, int>> sss_indices() {
  std::vector<std::pair<int, int>> rows;
  for (int distance = 1; distance <= 7; ++distance) {
    for (int m0 = 0; m0 + distance <= 30; ++m0) rows.emplace_back(m0, m0 + distance);
  }
  rows.resize(168);
  return rows;
}

std::vector<int> sss_register(const std::vector<int>& taps) {
  std::vector<int> x{0, 0, 0, 0, 1};
  for (std::size_t i = 0; i < 26; ++i) {
    int sum = 0;
    for (const int tap : taps) sum += x[i + index(tap)];
    x.push_back(sum % 2);
  }
  for (int& bit : x) bit = 1 - 2 * bit;
  return x;
}

TEST(Sss, EqualsTheTableAndRegistersForAllCells) {
  const auto rows = sss_indices();
  const auto s = sss_register({2, 0}), c = sss_register({3, 0}), z = sss_register({4, 2, 1, 0});
  for (int cell = 0; cell < 504; ++cell) {
    const auto [m0, m1] = rows[index(cell / 3)];
    for (const int subframe : {0, 5}) {
      const auto d = sss(cell, subframe);
      for (int n = 0; n < 31; ++n) {
        const int s0 = s[index((n + m0) % 31)], s1 = s[index((n + m1) % 31)];
        const int c0 = c[index((n + cell % 3) % 31)], c1 = c[index((n + cell % 3 + 3) % 31)];
        const int z0 = z[index((n + m0 % 8) % 31)], z1 = z[index((n + m1 % 8) % 31)];
        const int even = subframe == 0 ? s0 * c0 : s1 * c0;
        const int odd = subframe == 0 ? s1 * c1 * z0 : s0 * c1 * z1;
        ASSERT_EQ(d[index(2 * n)], static_cast<float>(even)) << cell << ' ' << subframe << ' ' << n;
        ASSERT_EQ(d[index(2 * n + 1)], static_cast<float>(odd)) << cell << ' ' << subframe << ' ' << n;
      }
    }
  }
}

TEST(Sss, NoTwoCellsOfOneGroupShareASequence) {
  std::set<std::array<float, kSyncSubcarriers>> seen;
  for (int cell = 0; cell < 504; ++cell) {
    seen.insert(sss(cell, 0));
    seen.insert(sss(cell, 5));
  }
  EXPECT_EQ(seen.size(), 1008U);
}

TEST(Crs, SymbolsOfEachPort) {
  for (const CyclicPrefix cp : {CyclicPrefix::kNormal, CyclicPrefix::kExtended}) {
    const int last = cp == CyclicPrefix::kNormal ? 4 : 3;
    for (int symbol = 0; symbol < symbols_per_slot(cp); ++symbol) {
      for (const int port : {0, 1}) EXPECT_EQ(has_crs(symbol, port, cp), symbol == 0 || symbol == last);
      for (const int port : {2, 3}) EXPECT_EQ(has_crs(symbol, port, cp), symbol == 1);
    }
  }
}

TEST(Crs, PositionsOfEachPort) {
  for (int cell = 0; cell < 504; ++cell) {
    for (int slot = 0; slot < 20; ++slot) {
      const auto at = [&](int v) { return (v + cell) % 6; };
      EXPECT_EQ(crs_first_subcarrier(cell, slot, 0, 0), at(0));
      EXPECT_EQ(crs_first_subcarrier(cell, slot, 4, 0), at(3));
      EXPECT_EQ(crs_first_subcarrier(cell, slot, 0, 1), at(3));
      EXPECT_EQ(crs_first_subcarrier(cell, slot, 3, 1), at(0));
      EXPECT_EQ(crs_first_subcarrier(cell, slot, 1, 2), at(slot % 2 == 0 ? 0 : 3));
      EXPECT_EQ(crs_first_subcarrier(cell, slot, 1, 3), at(slot % 2 == 0 ? 3 : 6));
    }
  }
}

TEST(Crs, ValuesEqualTheDefinitionForEveryCellBandwidthAndPrefix) {
  const double a = std::numbers::sqrt2 / 2.0;
  int compared = 0;
  for (int cell = 0; cell < 504; ++cell) {
    // Every cell, and over the cells every slot, both prefixes and each symbol with reference signals.
    const int slot = (cell * 7) % 20;
    for (const CyclicPrefix cp : {CyclicPrefix::kNormal, CyclicPrefix::kExtended}) {
      const bool normal = cp == CyclicPrefix::kNormal;
      for (const int symbol : {0, 1, normal ? 4 : 3}) {
        const auto c_init = static_cast<std::uint32_t>((7 * (slot + 1) + symbol + 1) * (2 * cell + 1)) * 1024U +
                            static_cast<std::uint32_t>(2 * cell + (normal ? 1 : 0));
        const auto c = test::naive_gold(c_init, 440);
        for (const int n_rb : kBandwidthsRb) {
          std::vector<Cf32> values(index(2 * n_rb));
          crs_values(cell, slot, symbol, cp, n_rb, values);
          for (int m = 0; m < 2 * n_rb; ++m) {
            const auto first = index(2 * (m + 110 - n_rb));
            ASSERT_NEAR(values[index(m)].real(), a * (1 - 2 * c[first]), 1e-7) << cell << ' ' << symbol << ' ' << m;
            ASSERT_NEAR(values[index(m)].imag(), a * (1 - 2 * c[first + 1]), 1e-7) << cell << ' ' << symbol << ' ' << m;
            ++compared;
          }
        }
      }
    }
  }
  EXPECT_EQ(compared, 504 * 2 * 3 * 2 * 271);
}

TEST(Crs, ANarrowBandIsTheMiddleOfAWideOne) {
  std::vector<Cf32> wide(200), narrow(12);
  crs_values(301, 7, 4, CyclicPrefix::kNormal, 100, wide);
  crs_values(301, 7, 4, CyclicPrefix::kNormal, 6, narrow);
  for (std::size_t i = 0; i < narrow.size(); ++i) EXPECT_EQ(narrow[i], wide[94 + i]);
}

}  // namespace
}  // namespace soopnav::lte
