#include "soopnav/estimation/consistency.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace soopnav {
namespace {

TEST(Nees, OfADiagonalCovarianceIsASumOfSquares) {
  const Eigen::Vector3d error(1.0, -4.0, 3.0);
  const Eigen::Matrix3d P = Eigen::Vector3d(1.0, 4.0, 9.0).asDiagonal();
  EXPECT_NEAR(nees(error, P).value_or(-1.0), 1.0 + 4.0 + 1.0, 1e-14);
}

TEST(Nees, IsInvariantUnderLinearMaps) {
  Eigen::Matrix2d P;
  P << 4.0, 1.5, 1.5, 2.0;
  Eigen::Matrix2d map;
  map << 2.0, -3.0, 0.5, 1.0;
  const Eigen::Vector2d error(0.7, -1.9);
  EXPECT_NEAR(nees(map * error, map * P * map.transpose()).value_or(-1.0), nees(error, P).value_or(-2.0), 1e-12);
}

TEST(Nees, RefusesWhatIsNoCovariance) {
  const Eigen::Vector2d error(1.0, 1.0);
  Eigen::Matrix2d indefinite;
  indefinite << 1.0, 2.0, 2.0, 1.0;
  EXPECT_FALSE(nees(error, indefinite));
  EXPECT_FALSE(nees(error, Eigen::Matrix2d::Constant(std::nan(""))));
  EXPECT_FALSE(nees(Eigen::Vector2d(std::nan(""), 0.0), Eigen::Matrix2d::Identity()));
  EXPECT_FALSE(nees(Eigen::VectorXd(Eigen::VectorXd::Ones(3)), Eigen::MatrixXd(Eigen::MatrixXd::Identity(2, 2))));
}

TEST(MeanNeesBounds, EqualThePublishedExample) {
  // Bar-Shalom, Li and Kirubarajan (2001), example below eq. 5.4.2-5: 50 runs, two states, 95 %: 74.22/50 and
  // 129.56/50.
  const MeanBounds bounds = mean_nees_bounds(2.0, 50, 0.05);
  EXPECT_NEAR(bounds.lower, 74.22 / 50.0, 1e-4);
  EXPECT_NEAR(bounds.upper, 129.56 / 50.0, 1e-4);
}

TEST(MeanNeesBounds, RefuseWhatIsOutOfRange) {
  for (const auto& bounds :
       {mean_nees_bounds(0.0, 5, 0.1), mean_nees_bounds(2.0, 0, 0.1), mean_nees_bounds(2.0, 5, 0.0),
        mean_nees_bounds(2.0, 5, 1.0), mean_nees_bounds(std::nan(""), 5, 0.5)}) {
    EXPECT_TRUE(std::isnan(bounds.lower));
    EXPECT_TRUE(std::isnan(bounds.upper));
  }
}

}  // namespace
}  // namespace soopnav
