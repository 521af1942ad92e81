#include <gtest/gtest.h>

#include <array>

#include "soopnav/core/epoch.hpp"
#include "soopnav/core/observation.hpp"
#include "soopnav/core/random.hpp"
#include "support/allocation_count.hpp"

namespace soopnav {
namespace {

TEST(CoreNoAlloc, TheCounterCounts) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  EXPECT_EQ(test::allocations_of([] { Eigen::VectorXd(100).setZero(); }), 1);
}

TEST(CoreNoAlloc, RandomNumbers) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  std::array<float, 1000> floats{};
  std::array<double, 1000> doubles{};
  std::array<Cf32, 1000> samples{};
  std::array<std::uint64_t, 1000> words{};
  RandomStream random(1);
  EXPECT_EQ(test::allocations_of([&] {
              random.fill_normal(std::span<float>(floats));
              random.fill_normal(std::span<double>(doubles));
              random.fill_uniform(doubles);
              random.fill_u64(words);
              random.fill_complex_normal(samples);
              random.add_complex_normal(samples, 1.0);
              RandomStream child = random.substream(4);
              doubles[0] = child.normal() + child.uniform();
            }),
            0);
}

TEST(CoreNoAlloc, ObservationsAndEpochs) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  EXPECT_EQ(test::allocations_of([] {
              Observation observation(Epoch(TimeScale::kGps, 5, 0.5) + 1.0);
              for (std::uint32_t i = 0; i < 16; ++i) EXPECT_TRUE(observation.append(1.0 * i, 1.0 + i, SourceId{i}));
              const auto differences = observation.minus_reference(SourceId{3});
              ASSERT_TRUE(differences);
              Observation copy;
              copy = *differences;
              EXPECT_EQ(copy.size(), 15);
              Observation full;
              const std::array<SourceId, 2> sources{SourceId{1}, SourceId{2}};
              Eigen::Matrix2d R = Eigen::Matrix2d::Identity();
              EXPECT_EQ(full.assign(Eigen::Vector2d(1.0, 2.0), R, sources), UpdateStatus::kAccepted);
            }),
            0);
}

}  // namespace
}  // namespace soopnav
