#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/geometry/rotation.hpp"

namespace soopnav::geometry {
namespace {

// The rounding of latitude and longitude alone moves a point by 2^-53 |p| and 2^-52 |p|, its coordinates' by as much.
double round_trip_bound(const Eigen::Vector3d& p_e) { return 1e-9 + 7e-16 * p_e.norm(); }

TEST(FramesLaw, EcefRoundTripOverAllHeights) {
  double worst_m = 0.0;
  for (const double height : {-10e3, -100.0, 0.0, 1.0, 8848.0, 4e5, 2.02e7, 3.6e7, 1e8}) {
    for (double latitude_deg = -90.0; latitude_deg <= 90.0; latitude_deg += 0.5) {
      for (const double longitude_deg : {-180.0, -91.3, 0.0, 45.0, 179.99}) {
        const Eigen::Vector3d p_e = geodetic_to_ecef(radians(latitude_deg), radians(longitude_deg), height);
        const auto place = ecef_to_geodetic(p_e);
        ASSERT_TRUE(place);
        const double error_m = (geodetic_to_ecef(*place) - p_e).norm();
        ASSERT_LT(error_m, round_trip_bound(p_e)) << latitude_deg << " " << longitude_deg << " " << height;
        ASSERT_NEAR(place->height_m, height, round_trip_bound(p_e));
        ASSERT_NEAR(place->latitude_rad, radians(latitude_deg), 1e-15);
        if (height < 1e4) worst_m = std::max(worst_m, error_m);
      }
    }
  }
  EXPECT_LT(worst_m, 5e-9);  // near the ground
}

TEST(FramesLaw, EcefRoundTripDownToTheCentreLimit) {
  RandomStream random(1);
  for (int i = 0; i < 20'000; ++i) {
    const Eigen::Vector3d direction(random.normal(), random.normal(), random.normal());
    const double distance = kMinCentreDistanceM * std::pow(10.0, random.uniform(0.0, 9.0));
    const Eigen::Vector3d p_e = distance * direction.normalized();
    const auto place = ecef_to_geodetic(p_e);
    if (!place) {
      EXPECT_LT(p_e.norm(), kMinCentreDistanceM * (1.0 + 1e-15));
      continue;
    }
    // Deep inside, height is the difference of two numbers of the Earth's size.
    ASSERT_LT((geodetic_to_ecef(*place) - p_e).norm(), 4e-9 + 7e-16 * p_e.norm()) << distance;
  }
}

TEST(FramesLaw, LatitudeOfTheMirrorImageIsMirrored) {
  const Eigen::Vector3d p_e(3.1e6, -2.2e6, 5.0e6);
  const auto north = ecef_to_geodetic(p_e);
  const auto south = ecef_to_geodetic({p_e.x(), p_e.y(), -p_e.z()});
  const auto back = ecef_to_geodetic({-p_e.x(), -p_e.y(), p_e.z()});
  ASSERT_TRUE(north && south && back);
  EXPECT_EQ(south->latitude_rad, -north->latitude_rad);
  EXPECT_EQ(south->height_m, north->height_m);
  EXPECT_NEAR(angle_difference(back->longitude_rad, north->longitude_rad + kPi), 0.0, 1e-15);
}

TEST(FramesLaw, LocalFramesAreRotationsAndComeBack) {
  RandomStream random(2);
  for (int i = 0; i < 200; ++i) {
    const Geodetic origin{random.uniform(-kPi / 2.0, kPi / 2.0), random.uniform(-kPi, kPi), random.uniform(-1e3, 1e4)};
    for (const LocalAxes axes : {LocalAxes::kEnu, LocalAxes::kNed}) {
      const LocalFrame frame(origin, axes);
      const Eigen::Matrix3d T = frame.rotation_from_ecef();
      ASSERT_LT((T * T.transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-15);
      ASSERT_NEAR(T.determinant(), 1.0, 1e-15);
      const Eigen::Vector3d p_l(random.normal(0.0, 1e4), random.normal(0.0, 1e4), random.normal(0.0, 1e3));
      ASSERT_LT((frame.position_from_ecef(frame.position_to_ecef(p_l)) - p_l).norm(), 4e-9);
      ASSERT_LT((frame.velocity_from_ecef(frame.velocity_to_ecef(p_l)) - p_l).norm(), 1e-15 * 1e5);
      const auto place = frame.position_to_geodetic(p_l);
      ASSERT_TRUE(place);
      ASSERT_LT((frame.position_from_geodetic(*place) - p_l).norm(), 8e-9);
    }
  }
}

// Up is where height grows, north where latitude grows, east where longitude grows.
TEST(FramesLaw, AxesPointWhereTheirNamesSay) {
  const Geodetic origin{radians(52.2), radians(-7.5), 30.0};
  const LocalFrame enu(origin, LocalAxes::kEnu);
  const LocalFrame ned(origin, LocalAxes::kNed);
  const double h = 1e-6;
  const Geodetic north{origin.latitude_rad + h, origin.longitude_rad, origin.height_m};
  const Geodetic east{origin.latitude_rad, origin.longitude_rad + h, origin.height_m};
  const Geodetic up{origin.latitude_rad, origin.longitude_rad, origin.height_m + 6.0};
  const double tolerance_m = 2e-5;  // curvature: h^2 R / 2 = 3e-6 m
  const double north_m = h * (meridian_radius_m(origin.latitude_rad) + 30.0);
  const double east_m = h * (prime_vertical_radius_m(origin.latitude_rad) + 30.0) * std::cos(origin.latitude_rad);
  EXPECT_LT((enu.position_from_geodetic(north) - Eigen::Vector3d(0.0, north_m, 0.0)).norm(), tolerance_m);
  EXPECT_LT((enu.position_from_geodetic(east) - Eigen::Vector3d(east_m, 0.0, 0.0)).norm(), tolerance_m);
  EXPECT_LT((enu.position_from_geodetic(up) - Eigen::Vector3d(0.0, 0.0, 6.0)).norm(), tolerance_m);
  EXPECT_LT((ned.position_from_geodetic(north) - Eigen::Vector3d(north_m, 0.0, 0.0)).norm(), tolerance_m);
  EXPECT_LT((ned.position_from_geodetic(east) - Eigen::Vector3d(0.0, east_m, 0.0)).norm(), tolerance_m);
  EXPECT_LT((ned.position_from_geodetic(up) - Eigen::Vector3d(0.0, 0.0, -6.0)).norm(), tolerance_m);
}

// A covariance is turned as the vectors it describes are: the sum of their outer products.
TEST(FramesLaw, CovariancesTurnWithTheirVectors) {
  const LocalFrame frame({0.7, 2.1, 100.0}, LocalAxes::kNed);
  RandomStream random(3);
  Eigen::Matrix3d P_e = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d P_l = Eigen::Matrix3d::Zero();
  for (int i = 0; i < 10; ++i) {
    const Eigen::Vector3d v_e(random.normal(), random.normal(), random.normal());
    const Eigen::Vector3d v_l = frame.velocity_from_ecef(v_e);
    P_e += v_e * v_e.transpose();
    P_l += v_l * v_l.transpose();
  }
  EXPECT_LT((frame.covariance_from_ecef(P_e) - P_l).norm(), 1e-14 * P_l.norm());
  EXPECT_LT((frame.covariance_to_ecef(P_l) - P_e).norm(), 1e-14 * P_l.norm());
  const Eigen::Matrix3d turned = frame.covariance_from_ecef(P_e);
  EXPECT_EQ(turned, turned.transpose());
}

TEST(FramesLaw, RotationsComeBack) {
  RandomStream random(4);
  for (int i = 0; i < 2000; ++i) {
    const Euler euler{random.uniform(-kPi, kPi), random.uniform(-1.57, 1.57), random.uniform(-kPi, kPi)};
    const Eigen::Matrix3d T = rotation_from_euler(euler);
    ASSERT_NEAR(T.determinant(), 1.0, 1e-14);
    const Euler back = euler_from_rotation(T);
    ASSERT_NEAR(angle_difference(back.yaw_rad, euler.yaw_rad), 0.0, 1e-12);
    ASSERT_NEAR(back.pitch_rad, euler.pitch_rad, 1e-12);
    ASSERT_NEAR(angle_difference(back.roll_rad, euler.roll_rad), 0.0, 1e-12);
    const Eigen::Quaterniond q = quaternion_from_rotation(T);
    ASSERT_GE(q.w(), 0.0);
    ASSERT_LT((rotation_from_quaternion(q) - T).norm(), 1e-14);
    const Eigen::Vector3d phi = rotation_vector_from_quaternion(q);
    ASSERT_LE(phi.norm(), kPi + 1e-15);
    ASSERT_LT((rotation_from_quaternion(quaternion_from_rotation_vector(phi)) - T).norm(), 1e-14);
  }
}

}  // namespace
}  // namespace soopnav::geometry
