#include "soopnav/geometry/gravity.hpp"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>

#include "soopnav/core/angle.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/geometry/wgs84.hpp"

namespace soopnav::geometry {
namespace {

// Published: NGA.STND.0036_1.0.0_WGS84, table 3.6 (equator, pole); at 45 degrees the Geodetic Reference System 1980 has
// 9.806199203, and is 1.4 um/s² above this one everywhere.
TEST(Gravity, SurfaceValues) {
  EXPECT_DOUBLE_EQ(normal_gravity_surface_mps2(0.0), 9.7803253359);
  EXPECT_NEAR(normal_gravity_surface_mps2(kPi / 2.0), 9.8321849378, 1e-10);
  EXPECT_NEAR(normal_gravity_surface_mps2(radians(45.0)), 9.806199203 - 1.43e-6, 2e-8);
  EXPECT_EQ(normal_gravity_surface_mps2(-0.7), normal_gravity_surface_mps2(0.7));
}

// The closed form on the ellipsoid is Somigliana's, and stands on the normal: no part along north.
TEST(Gravity, ClosedFormIsSomiglianaOnTheEllipsoid) {
  for (double latitude = -1.5; latitude <= 1.5; latitude += 0.25) {
    const Eigen::Vector3d g = normal_gravity_ned(latitude, 0.0);
    EXPECT_NEAR(g.z(), normal_gravity_surface_mps2(latitude), 2e-10) << latitude;
    EXPECT_NEAR(g.x(), 0.0, 2e-11) << latitude;
    const Eigen::Vector3d p_e = geodetic_to_ecef(latitude, 0.8, 1234.0);
    const Eigen::Vector3d turned = rotation_ecef_to_ned(latitude, 0.8) * normal_gravity_ecef(p_e);
    EXPECT_LT((turned - normal_gravity_ned(latitude, 1234.0)).norm(), 1e-14) << latitude;
  }
  const Eigen::Vector3d pole = normal_gravity_ecef({0.0, 0.0, wgs84::kSemiMinorAxisM});
  EXPECT_NEAR(pole.z(), -9.8321849378, 2e-10);
  EXPECT_EQ(pole.x(), 0.0);
}

// It is the gradient of a potential that satisfies Laplace's equation but for the centrifugal part: div g = 2 w².
TEST(Gravity, DivergenceIsTheCentrifugalOne) {
  const Eigen::Vector3d p = geodetic_to_ecef(0.7, 0.3, 2e4);
  const double h = 100.0;
  double divergence = 0.0;
  Eigen::Matrix3d slope;
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d step = h * Eigen::Vector3d::Unit(i);
    slope.col(i) = (normal_gravity_ecef(p + step) - normal_gravity_ecef(p - step)) / (2.0 * h);
    divergence += slope(i, i);
  }
  const double w = wgs84::kEarthRateRadps;
  EXPECT_NEAR(divergence / (2.0 * w * w), 1.0, 1e-4);
  EXPECT_LT((slope - slope.transpose()).norm(), 1e-12);
  EXPECT_LT((slope - gravity_gradient(p, {0.0, 0.0, w})).norm(), 0.01 * slope.norm());
}

// Far out the ellipsoid's field is that of a point mass with J2.
TEST(Gravity, J2IsTheLeadingTerm) {
  for (const double latitude : {0.0, 0.4, 1.0, 1.5}) {
    const Eigen::Vector3d p = geodetic_to_ecef(latitude, 1.0, 2e7);
    const Eigen::Vector3d exact = normal_gravity_ecef(p) - centrifugal_ecef(p);
    EXPECT_LT((exact - j2_gravitation_ecef(p)).norm(), 1e-7 * exact.norm()) << latitude;
    EXPECT_GT((exact - j2_gravitation_ecef(p, 0.0)).norm(), 2e-5 * exact.norm()) << latitude;
  }
}

TEST(Gravity, HeightExpansion) {
  for (const double latitude : {0.0, 0.5, 1.2}) {
    EXPECT_NEAR(normal_gravity_mps2(latitude, 5e3), normal_gravity_ned(latitude, 5e3).norm(), 5e-7);
    EXPECT_NEAR(normal_gravity_mps2(latitude, 0.0), normal_gravity_surface_mps2(latitude), 0.0);
  }
}

TEST(EarthRate, SignsAndSizes) {
  const Eigen::Vector3d w = earth_rate_ned(radians(30.0));
  EXPECT_NEAR(w.norm(), wgs84::kEarthRateRadps, 1e-20);
  EXPECT_GT(w.x(), 0.0);
  EXPECT_EQ(w.y(), 0.0);
  EXPECT_NEAR(w.z(), -0.5 * wgs84::kEarthRateRadps, 1e-19);
  // Going east turns the frame clockwise seen from above on the north; going north dips it.
  const Eigen::Vector3d east = transport_rate_ned(radians(45.0), 0.0, {0.0, 100.0, 0.0});
  EXPECT_GT(east.x(), 0.0);
  EXPECT_LT(east.z(), 0.0);
  const Eigen::Vector3d north = transport_rate_ned(radians(45.0), 0.0, {100.0, 0.0, 0.0});
  EXPECT_NEAR(north.y(), -100.0 / meridian_radius_m(radians(45.0)), 1e-18);
}

// The transport rate is what the frame does: rotation of north-east-down along a short way, by differences.
TEST(EarthRate, TransportRateIsTheFramesTurn) {
  const double latitude = 0.8, height = 1e4, dt = 1.0;
  const Eigen::Vector3d v(120.0, 90.0, 0.0);
  const double d_lat = v.x() * dt / (meridian_radius_m(latitude) + height);
  const double d_lon = v.y() * dt / ((prime_vertical_radius_m(latitude) + height) * std::cos(latitude));
  const Eigen::Matrix3d before = rotation_ecef_to_ned(latitude - 0.5 * d_lat, -0.5 * d_lon);
  const Eigen::Matrix3d after = rotation_ecef_to_ned(latitude + 0.5 * d_lat, 0.5 * d_lon);
  const Eigen::Matrix3d moved = after * before.transpose();  // exp(-[w x] dt)
  const Eigen::Matrix3d turn = 0.5 * (moved - moved.transpose());
  const Eigen::Vector3d w = transport_rate_ned(latitude, height, v);
  EXPECT_NEAR(-turn(2, 1) / dt, w.x(), 1e-13);
  EXPECT_NEAR(-turn(0, 2) / dt, w.y(), 1e-13);
  EXPECT_NEAR(-turn(1, 0) / dt, w.z(), 1e-13);
}

}  // namespace
}  // namespace soopnav::geometry
