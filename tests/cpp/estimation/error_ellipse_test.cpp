#include "soopnav/estimation/error_ellipse.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

namespace soopnav {
namespace {

Eigen::Matrix2d covariance(double major, double minor, double angle) {
  const Eigen::Matrix2d turn = Eigen::Rotation2Dd(angle).toRotationMatrix();
  return turn * Eigen::Vector2d(major * major, minor * minor).asDiagonal() * turn.transpose();
}

TEST(ErrorEllipse, AxesAndAngleComeBack) {
  for (const double angle : {-1.5, -0.7, 0.0, 0.3, 1.2, 0.5 * std::numbers::pi}) {
    const auto ellipse = error_ellipse(covariance(5.0, 2.0, angle));
    ASSERT_TRUE(ellipse);
    EXPECT_NEAR(ellipse->semi_major_m, 5.0, 1e-12);
    EXPECT_NEAR(ellipse->semi_minor_m, 2.0, 1e-12);
    EXPECT_NEAR(std::cos(2.0 * (ellipse->angle_rad - angle)), 1.0, 1e-12) << angle;
    EXPECT_LE(ellipse->angle_rad, 0.5 * std::numbers::pi);
    EXPECT_GT(ellipse->angle_rad, -0.5 * std::numbers::pi);
  }
}

TEST(ErrorEllipse, OfAProbabilityHoldsIt) {
  // A circle is its own ellipse: what the ellipse claims, the exact circle must confirm.
  const Eigen::Matrix2d P = covariance(3.0, 3.0, 0.4);
  for (const double p : {0.1, 0.5, 0.95, 0.999}) {
    const auto ellipse = error_ellipse(P, p);
    ASSERT_TRUE(ellipse);
    EXPECT_NEAR(probability_within(P, ellipse->semi_major_m), p, 1e-12);
  }
}

TEST(ErrorEllipse, NearlySingularKeepsTheSmallAxis) {
  const auto ellipse = error_ellipse(Eigen::Vector2d(1e6, 1e-6).asDiagonal().toDenseMatrix());
  ASSERT_TRUE(ellipse);
  EXPECT_NEAR(ellipse->semi_minor_m, 1e-3, 1e-12);
}

// H. L. Harter, "Circular error probabilities", J. Am. Statist. Assoc. 55 (1960), table 2, P = 0.5: radius over the
// larger standard deviation for ratios 0, 0.1, ..., 1.
TEST(CircularError, EqualsThePublishedTable) {
  const double kRadius[] = {0.67449, 0.68199, 0.70585, 0.74993, 0.80785, 0.87042,
                            0.93365, 0.99621, 1.05769, 1.11807, 1.17741};
  for (int i = 0; i <= 10; ++i) {
    const auto radius = circular_error_m(covariance(2.0, 0.2 * i, 0.9));
    ASSERT_TRUE(radius);
    EXPECT_NEAR(*radius / 2.0, kRadius[i], 1e-5) << "ratio " << 0.1 * i;
  }
}

TEST(CircularError, EndsAreExact) {
  const Eigen::Matrix2d line = covariance(4.0, 0.0, 0.0);
  const Eigen::Matrix2d circle = covariance(4.0, 4.0, 0.0);
  for (const double r : {1e-6, 1e-3, 0.1, 1.0, 4.0, 10.0, 20.0}) {
    EXPECT_NEAR(probability_within(line, r), std::erf(r / (4.0 * std::sqrt(2.0))), 1e-13) << r;
    EXPECT_NEAR(probability_within(circle, r), -std::expm1(-r * r / 32.0), 1e-13) << r;
  }
  for (const double p : {1e-6, 0.3, 0.5, 0.9, 0.999999}) {
    EXPECT_NEAR(circular_error_m(circle, p).value_or(0.0) / (4.0 * std::sqrt(-2.0 * std::log1p(-p))), 1.0, 1e-9) << p;
    for (const double ratio : {0.0, 1e-3, 0.3, 1.0}) {
      const Eigen::Matrix2d P = covariance(7.0, 7.0 * ratio, 1.1);
      EXPECT_NEAR(probability_within(P, circular_error_m(P, p).value_or(0.0)), p, 1e-9 * p + 1e-12)
          << p << " " << ratio;
    }
  }
}

TEST(CircularError, IsInvariantUnderRotationAndScalesWithLength) {
  const double radius = circular_error_m(covariance(3.0, 1.0, 0.0), 0.8).value_or(0.0);
  EXPECT_NEAR(circular_error_m(covariance(3.0, 1.0, 0.77), 0.8).value_or(0.0), radius, 1e-9);
  EXPECT_NEAR(circular_error_m(covariance(3e5, 1e5, 0.77), 0.8).value_or(0.0), 1e5 * radius, 1e-4);
}

TEST(ErrorEllipse, Refusals) {
  Eigen::Matrix2d negative;
  negative << 1.0, 2.0, 2.0, 1.0;
  Eigen::Matrix2d skew;
  skew << 1.0, 0.5, -0.5, 1.0;
  for (const Eigen::Matrix2d& bad : {negative, skew, Eigen::Matrix2d(-Eigen::Matrix2d::Identity()),
                                     Eigen::Matrix2d(Eigen::Matrix2d::Constant(std::nan("")))}) {
    EXPECT_FALSE(error_ellipse(bad)) << bad;
    EXPECT_FALSE(circular_error_m(bad)) << bad;
    EXPECT_TRUE(std::isnan(probability_within(bad, 1.0))) << bad;
  }
  const Eigen::Matrix2d good = Eigen::Matrix2d::Identity();
  for (const double p : {0.0, 1.0, -0.5, std::nan("")}) {
    EXPECT_FALSE(error_ellipse(good, p)) << p;
    EXPECT_FALSE(circular_error_m(good, p)) << p;
  }
  EXPECT_TRUE(std::isnan(probability_within(good, -1.0)));
  EXPECT_EQ(probability_within(good, 0.0), 0.0);
  EXPECT_EQ(circular_error_m(Eigen::Matrix2d::Zero()).value_or(-1.0), 0.0);
  EXPECT_EQ(probability_within(Eigen::Matrix2d::Zero(), 0.0), 1.0);
}

}  // namespace
}  // namespace soopnav
