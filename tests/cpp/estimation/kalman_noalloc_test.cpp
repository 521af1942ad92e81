// No heap in predict and update: counted.
#include <gtest/gtest.h>

#include <array>
#include <concepts>

#include "soopnav/core/joint_process.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/layout_kalman_filter.hpp"
#include "soopnav/estimation/unscented_kalman_filter.hpp"
#include "soopnav/inertial/planar_mechanization.hpp"
#include "soopnav/measurement/azimuth.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "soopnav/process/random_walk.hpp"
#include "support/allocation_count.hpp"

namespace soopnav {
namespace {

using Bearing = Azimuth<PlanarFrame, Role<1, HeadingTag>>;

template <class Filter>
void step_planar(Filter& filter) {
  const JointProcess process{inertial::PlanarMechanization{{0.01, 0.1}}, RandomWalk{kPlanarPosition, {0.1, 0.1}}};
  ASSERT_EQ(filter.predict(process, {0.1, {0.3, 0.1}}, 0.02), UpdateStatus::kAccepted);
  ASSERT_TRUE(filter.update(Bearing{Eigen::Vector2d(100, 50), kHeading}, 0.4, 1e-2).accepted());
  const std::array<Bearing, 2> both{Bearing{Eigen::Vector2d(100, 50), kHeading},
                                    Bearing{Eigen::Vector2d(-100, 50), kHeading}};
  if constexpr (std::same_as<Filter, ExtendedKalmanFilter<PlanarInertialState>>) {
    const Eigen::Vector2d z(0.4, 2.6);
    Eigen::Matrix2d R;
    R << 0.02, 0.01, 0.01, 0.02;
    ASSERT_TRUE(filter.template update<4>(Correlated<Bearing>{both, z, R}).accepted());
  }
}

TEST(KalmanNoAlloc, FixedStates) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  PlanarInertialState x0;
  const auto P0 = Eigen::Matrix<double, 5, 5>::Identity() * 0.01;
  ExtendedKalmanFilter<PlanarInertialState> ekf(x0, P0);
  UnscentedKalmanFilter<PlanarInertialState> ukf(x0, P0);
  EXPECT_EQ(test::allocations_of([&] {
              step_planar(ekf);
              step_planar(ukf);
            }),
            0);
}

TEST(KalmanNoAlloc, Layout) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  using Receiver = LayoutState<EnuFrame, Role<3, PositionTag>, Role<1, ClockBiasTag>>;
  ExtendedKalmanFilter<Receiver> filter({}, 100.0 * Eigen::Matrix4d::Identity(), 60, 50);
  std::array<Block<1>, 40> clocks;
  const auto run = [&] {
    for (Block<1>& clock : clocks) clock = filter.join(0.0, 10.0, "clock");
    for (int k = 0; k < 40; ++k) {
      const Block<1> clock = clocks[static_cast<std::size_t>(k)];
      ASSERT_EQ(filter.predict(RandomWalk<Block<1>>{clock, {0.1}}, 1.0), UpdateStatus::kAccepted);
      ASSERT_TRUE(filter.update(Pseudorange<EnuFrame, Block<1>>{Eigen::Vector3d(300, 400 + k, 20), clock}, 500.0, 1.0)
                      .accepted());
      ASSERT_TRUE(k % 2 == 1 || filter.marginalise(clock));
    }
  };
  EXPECT_EQ(test::allocations_of(run), 0);
}

}  // namespace
}  // namespace soopnav
