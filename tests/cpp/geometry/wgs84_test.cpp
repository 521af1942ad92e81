#include "soopnav/geometry/wgs84.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"
#include "support/nan.hpp"

namespace soopnav::geometry {
namespace {

using ::soopnav::test::kNan;
constexpr double kA = wgs84::kSemiMajorAxisM;
constexpr double kB = wgs84::kSemiMinorAxisM;

TEST(Wgs84, AxesOfTheFrame) {
  EXPECT_LT((geodetic_to_ecef(0.0, 0.0, 10.0) - Eigen::Vector3d(kA + 10.0, 0.0, 0.0)).norm(), 1e-9);
  EXPECT_LT((geodetic_to_ecef(0.0, kPi / 2.0, 10.0) - Eigen::Vector3d(0.0, kA + 10.0, 0.0)).norm(), 1e-9);
  EXPECT_LT((geodetic_to_ecef(kPi / 2.0, 1.0, 10.0) - Eigen::Vector3d(0.0, 0.0, kB + 10.0)).norm(), 2e-9);
  EXPECT_LT((geodetic_to_ecef(-kPi / 2.0, 1.0, -10.0) - Eigen::Vector3d(0.0, 0.0, -kB + 10.0)).norm(), 2e-9);
}

TEST(Wgs84, PolesAndAxis) {
  for (const double sign : {1.0, -1.0}) {
    const auto place = ecef_to_geodetic({0.0, 0.0, sign * (kB + 1234.5)});
    ASSERT_TRUE(place);
    EXPECT_EQ(place->latitude_rad, sign * kPi / 2.0);
    EXPECT_EQ(place->longitude_rad, 0.0);
    EXPECT_NEAR(place->height_m, 1234.5, 2e-9);
    // A micrometre beside the axis the latitude is off by a micrometre; a unit in its last place is 1.4 nm.
    const auto beside = ecef_to_geodetic({0.0, 1e-6, sign * kB});
    ASSERT_TRUE(beside);
    EXPECT_NEAR((kPi / 2.0 - std::abs(beside->latitude_rad)) * meridian_radius_m(kPi / 2.0), 1e-6, 1.5e-9);
    EXPECT_EQ(beside->longitude_rad, kPi / 2.0);
  }
}

TEST(Wgs84, Equator) {
  const auto place = ecef_to_geodetic({-(kA + 500.0), 0.0, 0.0});
  ASSERT_TRUE(place);
  EXPECT_EQ(place->latitude_rad, 0.0);
  EXPECT_EQ(std::abs(place->longitude_rad), kPi);
  EXPECT_NEAR(place->height_m, 500.0, 1e-9);
}

TEST(Wgs84, RefusesWhatHasNoPlace) {
  EXPECT_FALSE(ecef_to_geodetic({0.0, 0.0, 0.0}));
  EXPECT_FALSE(ecef_to_geodetic({0.999 * kMinCentreDistanceM, 0.0, 0.0}));
  EXPECT_TRUE(ecef_to_geodetic({0.0, 1.001 * kMinCentreDistanceM, 0.0}));
  EXPECT_FALSE(ecef_to_geodetic({kNan, 0.0, 7e6}));
  EXPECT_FALSE(ecef_to_geodetic({7e6, 0.0, kNan}));
  EXPECT_FALSE(ecef_to_geodetic({0.0, std::numeric_limits<double>::infinity(), 0.0}));
  EXPECT_FALSE(ecef_to_geodetic({1e16, 0.0, 0.0}));
}

TEST(Wgs84, NanGivesNan) {
  EXPECT_TRUE(geodetic_to_ecef(kNan, 0.0, 0.0).hasNaN());
  EXPECT_TRUE(geodetic_to_ecef(0.0, 0.0, kNan).hasNaN());
}

// Radii against central differences along the meridian and the parallel.
TEST(Wgs84, RadiiOfCurvature) {
  for (const double latitude_deg : {-80.0, -45.0, 0.0, 30.0, 60.0, 89.0}) {
    const double latitude = radians(latitude_deg);
    const double step = 1e-4;
    const double north =
        (geodetic_to_ecef(latitude + step, 0.3, 0.0) - geodetic_to_ecef(latitude - step, 0.3, 0.0)).norm();
    const double east =
        (geodetic_to_ecef(latitude, 0.3 + step, 0.0) - geodetic_to_ecef(latitude, 0.3 - step, 0.0)).norm();
    EXPECT_NEAR(meridian_radius_m(latitude), north / (2.0 * step), 0.05);
    EXPECT_NEAR(prime_vertical_radius_m(latitude) * std::cos(latitude), east / (2.0 * step), 0.05);
  }
  // The published extremes: 6335.439 km at the equator, 6399.594 km at the poles (both radii).
  EXPECT_NEAR(meridian_radius_m(0.0), 6'335'439.327, 1e-3);
  EXPECT_NEAR(meridian_radius_m(kPi / 2.0), 6'399'593.626, 1e-3);
  EXPECT_NEAR(prime_vertical_radius_m(kPi / 2.0), 6'399'593.626, 1e-3);
}

}  // namespace
}  // namespace soopnav::geometry
