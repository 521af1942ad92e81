// The bits themselves: a run is named by its seed, so these may change only on purpose (CHANGELOG, Numerics).

#include <gtest/gtest.h>

#include <bit>
#include <cstdint>
#include <vector>

#include "soopnav/core/random.hpp"

namespace soopnav {
namespace {

// FNV-1a over 64-bit words.
template <class Range>
std::uint64_t digest(const Range& words) {
  std::uint64_t hash = 0xcbf29ce484222325U;
  for (const std::uint64_t word : words) {
    for (unsigned byte = 0; byte < 8; ++byte) {
      hash ^= (word >> (8 * byte)) & 0xffU;
      hash *= 0x100000001b3U;
    }
  }
  return hash;
}

TEST(RandomGolden, BitsOfSeed42) {
  RandomStream random(42, 1);
  std::vector<double> normals(100'000);
  random.fill_normal(std::span(normals));
  std::vector<std::uint64_t> words;
  for (const double x : normals) words.push_back(std::bit_cast<std::uint64_t>(x));
  EXPECT_EQ(digest(words), 12074325049158537068U);

  std::vector<float> floats(100'000);
  RandomStream(42, 1).fill_normal(std::span(floats));
  words.clear();
  for (const float x : floats) words.push_back(std::bit_cast<std::uint32_t>(x));
  EXPECT_EQ(digest(words), 13566647368468839173U);

  std::vector<std::uint64_t> child(1000);
  RandomStream(42, 1).substream(3).fill_u64(child);
  EXPECT_EQ(digest(child), 1930237157197660568U);
}

}  // namespace
}  // namespace soopnav
