#include "soopnav/geometry/rotation.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "soopnav/core/angle.hpp"

namespace soopnav::geometry {
namespace {

const Eigen::Vector3d kX = Eigen::Vector3d::UnitX();
const Eigen::Vector3d kY = Eigen::Vector3d::UnitY();
const Eigen::Vector3d kZ = Eigen::Vector3d::UnitZ();

// With north-east-down below a forward-right-down body: yaw 90 faces east, pitch 90 faces up, roll 90 right wing down.
TEST(Rotation, SignsOfYawPitchAndRoll) {
  const double quarter = kPi / 2.0;
  EXPECT_LT((rotation_from_euler({quarter, 0.0, 0.0}) * kX - kY).norm(), 1e-15);
  EXPECT_LT((rotation_from_euler({0.0, quarter, 0.0}) * kX + kZ).norm(), 1e-15);
  EXPECT_LT((rotation_from_euler({0.0, 0.0, quarter}) * kY - kZ).norm(), 1e-15);
}

TEST(Rotation, EulerIsTheProductOfThreeTurns) {
  const Euler euler{0.3, -0.8, 2.0};
  const Eigen::Matrix3d expected = (Eigen::AngleAxisd(euler.yaw_rad, kZ) * Eigen::AngleAxisd(euler.pitch_rad, kY) *
                                    Eigen::AngleAxisd(euler.roll_rad, kX))
                                       .toRotationMatrix();
  EXPECT_LT((rotation_from_euler(euler) - expected).norm(), 1e-15);
}

TEST(Rotation, GimbalLockPutsEverythingIntoYaw) {
  for (const double pitch : {kPi / 2.0, -kPi / 2.0}) {
    const Eigen::Matrix3d T = rotation_from_euler({0.7, pitch, 0.4});
    const Euler euler = euler_from_rotation(T);
    EXPECT_EQ(euler.roll_rad, 0.0);
    EXPECT_NEAR(euler.pitch_rad, pitch, 1e-15);
    EXPECT_NEAR(euler.yaw_rad, pitch > 0.0 ? 0.3 : 1.1, 1e-15);
    EXPECT_LT((rotation_from_euler(euler) - T).norm(), 1e-15);
  }
}

TEST(Rotation, VectorsOfSmallLargeAndHalfTurns) {
  for (const double angle : {0.0, 1e-150, 1e-12, 1e-5, 1.9999e-4, 2.0001e-4, 1e-3, 1.0, 3.0, kPi}) {
    const Eigen::Vector3d phi = angle * Eigen::Vector3d(2.0, -1.0, 2.0) / 3.0;
    const Eigen::Quaterniond q = quaternion_from_rotation_vector(phi);
    EXPECT_NEAR(q.norm(), 1.0, 4e-16) << angle;
    EXPECT_LE((rotation_vector_from_quaternion(q) - phi).norm(), 1e-15 * angle) << angle;
    const Eigen::Quaterniond same(-q.w(), -q.x(), -q.y(), -q.z());
    EXPECT_NEAR(rotation_vector_from_quaternion(same).norm(), angle, 1e-15 * angle) << angle;
  }
  // Beyond half a turn the other way round is shorter.
  const Eigen::Vector3d back =
      rotation_vector_from_quaternion(quaternion_from_rotation_vector(Eigen::Vector3d(0.0, 0.0, 4.0)));
  EXPECT_NEAR(back.z(), 4.0 - kTwoPi, 1e-15);
}

TEST(Rotation, VectorMatchesTheAxisAndAngle) {
  const Eigen::Vector3d axis = Eigen::Vector3d(1.0, 2.0, -3.0).normalized();
  const Eigen::Quaterniond q = quaternion_from_rotation_vector(1.2 * axis);
  EXPECT_LT((rotation_from_quaternion(q) - Eigen::AngleAxisd(1.2, axis).toRotationMatrix()).norm(), 1e-15);
  EXPECT_LT((rotation_from_quaternion(quaternion_from_rotation_vector(kPi / 2.0 * kZ)) * kX - kY).norm(), 1e-15);
}

TEST(Rotation, SkewIsTheCrossProduct) {
  const Eigen::Vector3d v(1.0, -2.0, 3.0);
  const Eigen::Vector3d w(0.5, 4.0, -1.0);
  EXPECT_EQ(skew(v) * w, v.cross(w));
  EXPECT_EQ(skew(v).transpose(), -skew(v));
}

}  // namespace
}  // namespace soopnav::geometry
