#include <gtest/gtest.h>

#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/geometry/rotation.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::geometry {
namespace {

TEST(GeometryNoAlloc, NothingAllocates) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  double sum = 0.0;
  EXPECT_EQ(test::allocations_of([&] {
              const LocalFrame frame({0.3, 0.4, 5.0}, LocalAxes::kNed);
              const Eigen::Vector3d p_e = frame.position_to_ecef({100.0, 200.0, -30.0});
              sum += ecef_to_geodetic(p_e)->height_m + frame.direction_to(p_e)->range_m;
              sum += frame.covariance_from_ecef(Eigen::Matrix3d::Identity())(0, 0);
              const Eigen::Matrix3d T = rotation_from_euler({0.1, 0.2, 0.3});
              sum += rotation_vector_from_quaternion(quaternion_from_rotation(T)).norm();
              sum += euler_from_rotation(T).yaw_rad;
            }),
            0);
  EXPECT_GT(sum, 0.0);
}

}  // namespace
}  // namespace soopnav::geometry
