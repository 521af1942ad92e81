#include "soopnav/core/random.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <random>
#include <vector>

namespace soopnav {
namespace {

// The known answers that come with Random123 (kat_vectors, philox4x32 with 10 rounds).
TEST(Philox, KnownAnswers) {
  using Counter = std::array<std::uint32_t, 4>;
  EXPECT_EQ(philox_4x32_10({0, 0, 0, 0}, {0, 0}), (Counter{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  constexpr std::uint32_t kOnes = 0xffffffff;
  EXPECT_EQ(philox_4x32_10({kOnes, kOnes, kOnes, kOnes}, {kOnes, kOnes}),
            (Counter{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
  EXPECT_EQ(philox_4x32_10({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0}),
            (Counter{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}));
}

TEST(RandomStream, WordsAreThePhiloxBlocksOfItsCounter) {
  RandomStream zero(0, 0);
  EXPECT_EQ(zero.next_u64(), 0xe169c58d6627e8d5U);
  EXPECT_EQ(zero.next_u64(), 0x9b00dbd8bc57ac4cU);
  EXPECT_EQ(zero.position(), 2U);
  // Seed in the key, stream in the upper half of the counter, block number in the lower.
  RandomStream stream(0x299f31d0a4093822U, 0x0370734413198a2eU);
  stream.seek(2 * 0x05a308d3243f6a88U);
  const auto words = philox_4x32_10({0x243f6a88, 0x05a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0});
  EXPECT_EQ(stream.next_u64(), words[0] | (std::uint64_t{words[1]} << 32));
  EXPECT_EQ(stream.next_u64(), words[2] | (std::uint64_t{words[3]} << 32));
}

TEST(RandomStream, UniformIsTheTopOfTheWord) {
  RandomStream bits(5);
  RandomStream uniform(5);
  for (int i = 0; i < 1000; ++i) {
    const double u = uniform.uniform();
    EXPECT_EQ(u, static_cast<double>(bits.next_u64() >> 11) / 9007199254740992.0);
    EXPECT_GE(u, 0.0);
    EXPECT_LT(u, 1.0);
  }
  RandomStream scaled(5);
  uniform.seek(0);
  EXPECT_EQ(scaled.uniform(-2.0, 6.0), -2.0 + 8.0 * uniform.uniform());
}

TEST(RandomStream, MeanAndSigmaScaleTheNormal) {
  RandomStream a(9);
  RandomStream b(9);
  EXPECT_EQ(a.normal(3.0, 2.0), 3.0 + 2.0 * b.normal());
}

TEST(RandomStream, SeekAndSkipMoveThePosition) {
  RandomStream a(1);
  std::vector<double> all(50);
  for (double& x : all) x = a.normal();
  EXPECT_EQ(a.position(), 50U);
  RandomStream b(1);
  b.seek(31);
  EXPECT_EQ(b.normal(), all[31]);
  b.skip(3);
  EXPECT_EQ(b.normal(), all[35]);
  b.seek(0);
  EXPECT_EQ(b, RandomStream(1));
  EXPECT_NE(b, RandomStream(1, 1));
}

TEST(RandomStream, EmptyFillsDrawNothing) {
  RandomStream random(1);
  random.fill_normal(std::span<float>());
  random.fill_normal(std::span<double>());
  random.fill_complex_normal(std::span<Cf32>());
  EXPECT_EQ(random.position(), 0U);
}

TEST(RandomStream, NoVarianceIsNoNoise) {
  std::vector<Cf32> samples(100, Cf32(1.0F, -2.0F));
  RandomStream random(1);
  random.add_complex_normal(samples, 0.0);
  for (const Cf32 x : samples) EXPECT_EQ(x, Cf32(1.0F, -2.0F));
  EXPECT_EQ(random.position(), 200U);
}

TEST(RandomStream, ServesTheStandardLibrary) {
  static_assert(std::uniform_random_bit_generator<RandomStream>);
  RandomStream random(4);
  std::vector<int> order(100);
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = static_cast<int>(i);
  std::shuffle(order.begin(), order.end(), random);
  EXPECT_FALSE(std::is_sorted(order.begin(), order.end()));
  std::sort(order.begin(), order.end());
  EXPECT_EQ(order[99], 99);
}

}  // namespace
}  // namespace soopnav
