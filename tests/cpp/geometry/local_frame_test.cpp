#include "soopnav/geometry/local_frame.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>

#include "soopnav/core/angle.hpp"
#include "support/nan.hpp"

namespace soopnav::geometry {
namespace {

using ::soopnav::test::kNan;

TEST(LocalFrame, RefusesAnOriginThatIsNoPlace) {
  const auto message_of = [](const Geodetic& origin) -> std::string {
    try {
      const LocalFrame frame(origin);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  using testing::HasSubstr;
  using testing::StartsWith;
  EXPECT_THAT(message_of({1.6, 0.0, 0.0}), StartsWith("origin.latitude_rad: 1.6; it must lie"));
  EXPECT_THAT(message_of({kNan, 0.0, 0.0}), StartsWith("origin.latitude_rad"));
  EXPECT_THAT(message_of({0.0, kNan, 0.0}), HasSubstr("longitude_rad: nan; it must be finite"));
  EXPECT_THAT(message_of({0.0, 0.0, -7e6}), HasSubstr("height_m: -7e+06; it must lie"));
  EXPECT_THAT(message_of({0.0, 0.0, kNan}), HasSubstr("height_m"));
  EXPECT_EQ(message_of({kPi / 2.0, 10.0, -100.0}), "");
}

TEST(LocalFrame, RotationsOfTheEquatorAndGreenwich) {
  Eigen::Matrix3d T_enu_e;
  T_enu_e << 0, 1, 0, 0, 0, 1, 1, 0, 0;  // east = y, north = z, up = x
  Eigen::Matrix3d T_ned_e;
  T_ned_e << 0, 0, 1, 0, 1, 0, -1, 0, 0;
  EXPECT_EQ(rotation_ecef_to_enu(0.0, 0.0), T_enu_e);
  EXPECT_EQ(rotation_ecef_to_ned(0.0, 0.0), T_ned_e);
  EXPECT_EQ(swap_enu_ned({1.0, 2.0, 3.0}), Eigen::Vector3d(2.0, 1.0, -3.0));
}

TEST(LocalFrame, DirectionsOfTheCompass) {
  const Eigen::Vector3d here(10.0, 20.0, 30.0);
  struct Row {
    Eigen::Vector3d line;
    double azimuth_deg, elevation_deg, range_m;
  };
  const Row rows[] = {{{0, 5, 0}, 0, 0, 5},
                      {{5, 0, 0}, 90, 0, 5},
                      {{0, -5, 0}, 180, 0, 5},
                      {{-5, 0, 0}, 270, 0, 5},
                      {{0, 0, 5}, 0, 90, 5},
                      {{0, 0, -5}, 0, -90, 5},
                      {{3, 0, 4}, 90, 53.13010235415598, 5},
                      {{-1, 1, 0}, 315, 0, std::sqrt(2.0)}};
  for (const Row& row : rows) {
    const auto direction = direction_enu(here, here + row.line);
    ASSERT_TRUE(direction);
    EXPECT_NEAR(degrees(direction->azimuth_rad), row.azimuth_deg, 1e-12);
    EXPECT_NEAR(degrees(direction->elevation_rad), row.elevation_deg, 1e-12);
    EXPECT_NEAR(direction->range_m, row.range_m, 1e-14);
  }
}

TEST(LocalFrame, NoDirectionToOneself) {
  EXPECT_FALSE(direction_enu({1.0, 2.0, 3.0}, {1.0, 2.0, 3.0}));
  EXPECT_FALSE(direction_enu({1.0, 2.0, 3.0}, {1.0, kNan, 3.0}));
  EXPECT_FALSE(direction_enu({1.0, 2.0, 3.0}, {std::numeric_limits<double>::infinity(), 2.0, 3.0}));
  const LocalFrame frame({0.3, 0.4, 5.0});
  EXPECT_FALSE(frame.direction_to(frame.origin_ecef()));
}

TEST(LocalFrame, NamesItsOriginAndAxes) {
  const LocalFrame frame({0.3, 0.4, 5.0}, LocalAxes::kNed);
  EXPECT_EQ(frame.axes(), LocalAxes::kNed);
  EXPECT_EQ(frame.origin().longitude_rad, 0.4);
  EXPECT_EQ(frame.origin_ecef(), geodetic_to_ecef({0.3, 0.4, 5.0}));
  EXPECT_EQ(frame.position_from_ecef(frame.origin_ecef()), Eigen::Vector3d::Zero());
  EXPECT_FALSE(frame.position_to_geodetic({0.0, 0.0, 6.37e6}));  // the centre of the Earth
}

}  // namespace
}  // namespace soopnav::geometry
