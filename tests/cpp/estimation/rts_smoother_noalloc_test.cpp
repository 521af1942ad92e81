#include <gtest/gtest.h>

#include <vector>

#include "estimation/linear_systems.hpp"
#include "soopnav/estimation/rts_smoother.hpp"
#include "support/allocation_count.hpp"

namespace soopnav {
namespace {

using Attitude = ComposedState<NedFrame, Role<3, AttitudeTag>, Role<3, VelocityTag>>;

TEST(RtsSmootherNoAlloc, RecordAndSmooth) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  RtsSmoother<Attitude> smoother(50);
  StepRecord<Attitude> record;
  record.P_pred = 2.0 * record.P_pred.Identity();
  record.P = record.P.Identity();
  record.cross = record.P;
  int done = 0;
  const long allocations = test::allocations_of([&] {
    for (int repeat = 0; repeat < 2; ++repeat) {
      smoother.clear();
      for (int k = 0; k < 51; ++k) {
        if (k == 25) record.P_pred(5, 5) = record.P(5, 5) = record.cross(5, 5) = 0.0;  // singular from here on
        done += smoother.record(record) == SmoothStatus::kDone ? 1 : 0;
      }
      done += smoother.smooth() == SmoothStatus::kDone ? 1 : 0;
    }
  });
  EXPECT_EQ(allocations, 0);
  EXPECT_EQ(done, 102);
  EXPECT_GT(smoother.singular_steps(), 0);
}

// A whole run allocates its result and its workspace, however long it is.
TEST(RtsSmootherNoAlloc, WholeRunsAllocateOnce) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  const auto s = test::fourteen_states();
  const auto count = [&s](int steps) {
    const auto data = test::simulate(s, steps, 5);
    std::vector<double> x(static_cast<std::size_t>(steps) * 14);
    std::vector<double> P(static_cast<std::size_t>(steps) * 196);
    return test::allocations_of([&] {
      const LinearRun r = linear_filter(s.view(), {.z = data.values()}, s.x0, s.P0);
      static_cast<void>(rts_smooth(s.F, r.x_pred, r.P_pred, r.x, r.P, x, P));
    });
  };
  const long few = count(3);
  EXPECT_EQ(count(300), few);
  EXPECT_GT(few, 0);
}

}  // namespace
}  // namespace soopnav
