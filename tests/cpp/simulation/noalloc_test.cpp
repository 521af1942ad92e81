#include <gtest/gtest.h>

#include <array>
#include <cstdint>

#include "soopnav/simulation/channel.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::simulation {
namespace {

TEST(SimulationNoAlloc, PiecesThatWorkInPlace) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  std::array<Cf32, 1000> samples{};
  std::array<std::int8_t, 2000> pairs{};
  RandomStream random(1);
  EXPECT_EQ(test::allocations_of([&] {
              add_awgn(samples, 1.0, random);
              apply_cfo(samples, 1e3, 1.92e6, 0.1, 77);
              scale_to_rms(samples, 0.2);
              quantize_ci8(samples, 1.0, pairs);
            }),
            0);
  EXPECT_GT(mean_power(samples), 0.0);
}

}  // namespace
}  // namespace soopnav::simulation
