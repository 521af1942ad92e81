// The normals' own polynomials against Box-Muller in long double by the C library, from the same Philox words.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <numbers>

#include "soopnav/core/random.hpp"

namespace soopnav {
namespace {

constexpr std::uint64_t kSeed = 0x0123456789abcdefU;
constexpr std::uint64_t kKindNormal = std::uint64_t{1} << 62;
constexpr std::uint64_t kKindNormalFloat = std::uint64_t{2} << 62;

std::array<std::uint32_t, 4> block(std::uint64_t index) {
  return philox_4x32_10({static_cast<std::uint32_t>(index), static_cast<std::uint32_t>(index >> 32), 0, 0},
                        {static_cast<std::uint32_t>(kSeed), static_cast<std::uint32_t>(kSeed >> 32)});
}

struct Reference {
  long double x;
  long double y;
};

// `angle_turns` from the first axis' lower quadrant border on: the quadrants are centred on the axes.
Reference box_muller(long double u, long double angle_turns) {
  const long double r = std::sqrt(-2.0L * std::log(u));
  const long double angle = 2.0L * std::numbers::pi_v<long double> * (angle_turns - 0.125L);
  return {r * std::cos(angle), r * std::sin(angle)};
}

TEST(RandomCrosscheck, NormalsAreBoxMullerInDouble) {
  RandomStream random(kSeed);
  for (std::uint64_t k = 0; k < 200'000; ++k) {
    const auto w = block(kKindNormal | k);
    const std::uint64_t radius = (w[0] | (std::uint64_t{w[1]} << 32)) >> 12;
    const std::uint64_t angle = (w[2] | (std::uint64_t{w[3]} << 32)) >> 10;
    const Reference expected = box_muller((static_cast<long double>(radius) + 0.5L) * 0x1p-52L,
                                          (static_cast<long double>(angle) + 0.5L) * 0x1p-54L);
    const double x = random.normal();
    const double y = random.normal();
    const double r = std::hypot(x, y);
    ASSERT_NEAR(x, static_cast<double>(expected.x), 6e-16 * r + 1e-300) << k;
    ASSERT_NEAR(y, static_cast<double>(expected.y), 6e-16 * r + 1e-300) << k;
  }
}

TEST(RandomCrosscheck, FloatNormalsAreBoxMullerInFloat) {
  RandomStream random(kSeed);
  for (std::uint64_t k = 0; k < 200'000; ++k) {
    const auto w = block(kKindNormalFloat | k);
    for (std::size_t pair = 0; pair < 4; pair += 2) {
      // u is rounded to float before the logarithm; near 1 that moves the radius by up to sqrt(2^-24).
      const float u = (static_cast<float>(w[pair] >> 1) + 0.5F) * 0x1p-31F;
      const auto turns = (static_cast<long double>(w[pair + 1]) + 0.0L) * 0x1p-32L;
      // The angle's lower 30 bits are signed about the quadrant's centre.
      const long double quadrant = std::floor(turns * 4.0L);
      const long double within = turns * 4.0L - quadrant;
      const long double centred = within < 0.5L ? within : within - 1.0L;
      const Reference expected = box_muller(static_cast<long double>(u), (quadrant + centred + 0.5L) / 4.0L);
      const float x = random.normal_float();
      const float y = random.normal_float();
      const float r = std::hypot(x, y);
      ASSERT_NEAR(x, static_cast<float>(expected.x), 4e-7F * r + 1e-30F) << k;
      ASSERT_NEAR(y, static_cast<float>(expected.y), 4e-7F * r + 1e-30F) << k;
    }
  }
}

}  // namespace
}  // namespace soopnav
