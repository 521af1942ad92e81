#include <gtest/gtest.h>

#include <vector>

#include "estimation/allocation_count.hpp"
#include "navigation/fix_scene.hpp"

namespace soopnav::navigation {
namespace {

TEST(NoAllocation, PositionFix) {
  if (SOOPNAV_COUNTS_ALLOCATIONS == 0) GTEST_SKIP() << "this allocator cannot be counted";
  const test::Scene scene(test::town());
  auto toas = scene.toas_s();
  const auto sigmas = scene.sigmas_s();
  const auto count = [&](const PositionFixOptions& options, FixStatus expected) {
    const long before = test::allocations.load();
    const auto fix = position_fix(scene.nodes, toas, sigmas, options);
    const long after = test::allocations.load();
    EXPECT_EQ(fix.status, expected);
    return after - before;
  };
  EXPECT_EQ(count({}, FixStatus::kConverged), 0);
  EXPECT_EQ(count(test::planar(1.5), FixStatus::kConverged), 0);
  toas[2] += 200e-9;  // the outlier search fits every subset
  EXPECT_EQ(count(test::planar(1.5), FixStatus::kConverged), 0);
  EXPECT_EQ(count({}, FixStatus::kInconsistent), 0);
  const long before = test::allocations.load();
  const std::vector<double> seen(100, 1.0);
  EXPECT_GT(test::allocations.load(), before) << "the counter counts nothing: " << seen.size();
}

}  // namespace
}  // namespace soopnav::navigation
