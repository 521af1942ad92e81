#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <vector>

#include "estimation/allocation_count.hpp"
#include "soopnav/navigation/ofdm_inertial_navigator.hpp"
#include "support/nan.hpp"

namespace soopnav::navigation {
namespace {

using ::soopnav::test::kNan;

TEST(NoAllocation, OfdmInertialNavigator) {
  if (SOOPNAV_COUNTS_ALLOCATIONS == 0) GTEST_SKIP() << "this allocator cannot be counted";
  const std::vector<Eigen::Vector2d> sources{{1000.0, 1500.0}, {-2000.0, 1000.0}, {500.0, -2000.0}};
  const std::vector<PlanarStart> starts{{}, {.position_m = {300.0, -200.0}}};
  OfdmInertialOptions options;
  options.imu = {0.1, 0.1};
  options.ambiguity_m = 1199.0;
  options.gate = {.residual = 45.0, .residual_sigmas = 3.0};
  options.multipath = MultipathBias{5.0, 10.0};
  for (const bool clocks : {true, false}) {
    options.transmitter_clock.reset();
    if (clocks) options.transmitter_clock = clock::ClockNoise{0.036, 0.141};
    options.reference_receiver = !clocks;
    OfdmInertialNavigator nav(sources, starts, options);
    std::vector<RangeChange> epoch;
    for (int k = 0; k < 3; ++k) epoch.push_back({kReferenceReceiver, k, 0.1, 4.0});
    for (int r = 0; r < 2; ++r) {
      for (int k = 0; k < 3; ++k) epoch.push_back({r, k, k == 2 ? kNan : 1.0, 4.0});
    }
    epoch.push_back({7, 0, 0.0, 1.0});  // nobody
    std::vector<RangeChangeReport> reports(epoch.size());
    const long before = test::allocations.load();
    for (int step = 0; step < 50; ++step) {
      for (int r = 0; r < 2; ++r) {
        EXPECT_EQ(nav.predict(r, {0.1, {0.5, 0.1}}, 0.02), UpdateStatus::kAccepted);
      }
      EXPECT_EQ(nav.predict_links(0.02), UpdateStatus::kAccepted);
    }
    EXPECT_EQ(nav.coast(1, 1.0), UpdateStatus::kAccepted);
    nav.update(epoch, reports);
    EXPECT_EQ(test::allocations.load(), before);
    for (std::size_t i = 0; i < 5; ++i) EXPECT_EQ(reports[i].status, UpdateStatus::kAccepted) << i;
    EXPECT_EQ(reports[5].status, UpdateStatus::kNonFinite);
    EXPECT_EQ(reports.back().status, UpdateStatus::kStaleHandle);
    EXPECT_TRUE(nav.state().x().allFinite());
    EXPECT_EQ(nav.state().dim(), 10 + (clocks ? 6 : 0) + 6);
    EXPECT_EQ(nav.predict(2, {}, 0.02), UpdateStatus::kStaleHandle);
    EXPECT_EQ(nav.predict_links(0.0), UpdateStatus::kTimeNotAdvancing);
  }
}

}  // namespace
}  // namespace soopnav::navigation
