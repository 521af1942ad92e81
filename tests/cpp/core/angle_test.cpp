#include "soopnav/core/angle.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "soopnav/core/constants.hpp"
#include "support/nan.hpp"

namespace soopnav {
namespace {

using ::soopnav::test::kNan;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

TEST(Angle, DegreesAndRadians) {
  EXPECT_DOUBLE_EQ(radians(180.0), kPi);
  EXPECT_DOUBLE_EQ(radians(-30.0), -kPi / 6.0);
  EXPECT_DOUBLE_EQ(degrees(kPi / 4.0), 45.0);
  EXPECT_DOUBLE_EQ(degrees(radians(123.456)), 123.456);
}

TEST(Angle, WrapToPiTable) {
  struct Row {
    double in;
    double out;
  };
  const Row rows[] = {{0.0, 0.0},        {3.0, 3.0},          {-3.0, -3.0},        {kPi, -kPi},
                      {-kPi, -kPi},      {1e-300, 1e-300},    {kTwoPi, 0.0},       {-kTwoPi, 0.0},
                      {3.0 * kPi, -kPi}, {4.0, 4.0 - kTwoPi}, {-4.0, kTwoPi - 4.0}};
  for (const Row& row : rows) EXPECT_NEAR(wrap_to_pi(row.in), row.out, 4e-16) << row.in;
}

TEST(Angle, WrapToPiIsHalfOpen) {
  EXPECT_EQ(wrap_to_pi(kPi), -kPi);
  EXPECT_EQ(wrap_to_pi(-kPi), -kPi);
  const double below = std::nextafter(kPi, 0.0);
  EXPECT_EQ(wrap_to_pi(below), below);
  for (int k = -2000; k <= 2000; ++k) {
    const double wrapped = wrap_to_pi(static_cast<double>(k) * kPi);
    EXPECT_GE(wrapped, -kPi) << k;
    EXPECT_LT(wrapped, kPi) << k;
  }
}

TEST(Angle, WrapToTwoPiIsHalfOpen) {
  EXPECT_EQ(wrap_to_two_pi(0.0), 0.0);
  EXPECT_EQ(wrap_to_two_pi(kTwoPi), 0.0);
  EXPECT_EQ(wrap_to_two_pi(-1e-20), 0.0);  // 2 pi - 1e-20 is not a double below 2 pi
  EXPECT_DOUBLE_EQ(wrap_to_two_pi(-1.0), kTwoPi - 1.0);
  EXPECT_DOUBLE_EQ(wrap_to_two_pi(7.0), 7.0 - kTwoPi);
  for (int k = -2000; k <= 2000; ++k) {
    const double wrapped = wrap_to_two_pi(static_cast<double>(k) * 0.7);
    EXPECT_GE(wrapped, 0.0) << k;
    EXPECT_LT(wrapped, kTwoPi) << k;
  }
}

TEST(Angle, WrappingKeepsTheDirection) {
  for (double angle = -1000.0; angle < 1000.0; angle += 0.37) {
    EXPECT_NEAR(std::sin(wrap_to_pi(angle)), std::sin(angle), 2e-13);
    EXPECT_NEAR(std::cos(wrap_to_two_pi(angle)), std::cos(angle), 2e-13);
    EXPECT_EQ(wrap_to_pi(wrap_to_pi(angle)), wrap_to_pi(angle));
  }
}

TEST(Angle, NotFiniteGivesNan) {
  for (const double bad : {kNan, kInfinity, -kInfinity}) {
    EXPECT_TRUE(std::isnan(wrap_to_pi(bad)));
    EXPECT_TRUE(std::isnan(wrap_to_two_pi(bad)));
  }
}

TEST(Angle, DifferenceTakesTheShortWay) {
  EXPECT_NEAR(angle_difference(radians(-179.0), radians(179.0)), radians(2.0), 1e-15);
  EXPECT_NEAR(angle_difference(radians(179.0), radians(-179.0)), radians(-2.0), 1e-15);
  EXPECT_NEAR(angle_difference(radians(10.0), radians(350.0)), radians(20.0), 1e-15);
}

// Derived constants against the values of table 3.2 of NGA.STND.0036.
TEST(Constants, DerivedValuesOfWgs84) {
  EXPECT_NEAR(wgs84::kSemiMinorAxisM, 6'356'752.3142, 5e-5);
  EXPECT_NEAR(wgs84::kEccentricitySquared, 6.694379990141e-3, 5e-16);
  EXPECT_NEAR(wgs84::kSecondEccentricitySquared, 6.739496742276e-3, 5e-16);
}

}  // namespace
}  // namespace soopnav
