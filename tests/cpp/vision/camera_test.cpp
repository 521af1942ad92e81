#include "soopnav/vision/camera.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

namespace soopnav::vision {
namespace {

using Vector2 = Eigen::Vector2d;
using Vector3 = Eigen::Vector3d;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

Camera pinhole() { return {640, 480, 525.0, 520.0, 319.5, 239.5}; }

Camera bent() {
  const std::vector<double> k{-0.28, 0.09, 0.0008, -0.0005, -0.012};
  return {640, 480, 525.0, 520.0, 322.0, 236.0, Lens::kRadialTangential, k};
}

Camera fisheye() {
  const std::vector<double> k{-0.02, 0.006, -0.003, 0.0004};
  return {640, 480, 290.0, 291.0, 318.0, 241.0, Lens::kFisheye, k};
}

class EveryLens : public testing::TestWithParam<int> {
 protected:
  Camera camera() const { return GetParam() == 0 ? pinhole() : GetParam() == 1 ? bent() : fisheye(); }
};

INSTANTIATE_TEST_SUITE_P(Lenses, EveryLens, testing::Values(0, 1, 2));

TEST_P(EveryLens, PixelToRayToPixelIsTheSame) {
  const Camera camera = this->camera();
  int seen = 0;
  for (double v = 0.0; v < 480.0; v += 13.0) {
    for (double u = 0.0; u < 640.0; u += 17.0) {
      Vector3 ray;
      Vector2 pixel;
      if (!camera.unproject({u, v}, ray)) continue;
      ++seen;
      EXPECT_EQ(ray.z(), 1.0);
      ASSERT_TRUE(camera.project(3.7 * ray, pixel));
      EXPECT_LT((pixel - Vector2(u, v)).norm(), 1e-9) << u << ", " << v;
    }
  }
  EXPECT_GT(seen, 1350);  // of 1406: all but a few corners of the fisheye
}

TEST_P(EveryLens, JacobiansAreTheDifferences) {
  const Camera camera = this->camera();
  for (const Vector2& at : {Vector2(320.0, 240.0), Vector2(100.0, 60.0), Vector2(601.0, 455.0)}) {
    Vector3 ray, up, down;
    Camera::UnprojectionJacobian back;
    ASSERT_TRUE(camera.unproject(at, ray, back));
    for (int k = 0; k < 2; ++k) {
      const Vector2 step = 1e-3 * Vector2::Unit(k);
      ASSERT_TRUE(camera.unproject(at + step, up) && camera.unproject(at - step, down));
      EXPECT_LT((back.col(k) - (up - down) / 2e-3).norm(), 1e-7 * (1.0 + back.norm()));
    }
    const Vector3 point = 1.3 * ray;
    Vector2 pixel, right, left;
    Camera::ProjectionJacobian forth;
    ASSERT_TRUE(camera.project(point, pixel, forth));
    for (int k = 0; k < 3; ++k) {
      const Vector3 step = 1e-5 * Vector3::Unit(k);
      ASSERT_TRUE(camera.project(point + step, right) && camera.project(point - step, left));
      EXPECT_LT((forth.col(k) - (right - left) / 2e-5).norm(), 1e-6 * forth.norm());
    }
  }
}

TEST_P(EveryLens, RightAndDownAreWhereTheyBelong) {
  const Camera camera = this->camera();
  Vector2 pixel;
  ASSERT_TRUE(camera.project({0.1, 0.05, 1.0}, pixel));
  EXPECT_GT(pixel.x(), camera.cx() + 20.0);
  EXPECT_GT(pixel.y(), camera.cy() + 10.0);
}

TEST_P(EveryLens, NothingIsMadeOfNonsense) {
  const Camera camera = this->camera();
  Vector2 pixel(7.0, 8.0);
  for (const Vector3& point : {Vector3(0.0, 0.0, 0.0), Vector3(0.1, 0.1, -1.0), Vector3(kNan, 0.0, 1.0),
                               Vector3(0.0, 0.0, kNan), Vector3(1e9, 0.0, 1.0)}) {
    EXPECT_FALSE(camera.project(point, pixel));
  }
  EXPECT_EQ(pixel, Vector2(7.0, 8.0));
  Vector3 ray(1.0, 2.0, 3.0);
  EXPECT_FALSE(camera.unproject({kNan, 0.0}, ray));
  EXPECT_FALSE(camera.unproject({1e300, 1e300}, ray));
  EXPECT_EQ(ray, Vector3(1.0, 2.0, 3.0));
}

TEST(Camera, ValuesByHand) {
  Vector2 pixel;
  ASSERT_TRUE(pinhole().project({0.2, -0.1, 2.0}, pixel));
  EXPECT_NEAR(pixel.x(), 319.5 + 52.5, 1e-12);
  EXPECT_NEAR(pixel.y(), 239.5 - 26.0, 1e-12);

  // r^2 = 0.05, radial 1 - 0.28 * 0.05 + 0.09 * 0.0025 - 0.012 * 0.000125 = 0.9862235; tangential terms by hand.
  ASSERT_TRUE(bent().project({0.2, 0.1, 1.0}, pixel));
  EXPECT_NEAR(pixel.x(), 525.0 * (0.2 * 0.9862235 + 2 * 0.0008 * 0.02 - 0.0005 * 0.13) + 322.0, 1e-9);
  EXPECT_NEAR(pixel.y(), 520.0 * (0.1 * 0.9862235 + 0.0008 * 0.07 - 2 * 0.0005 * 0.02) + 236.0, 1e-9);

  // 45 degrees along x: t = pi/4.
  const double t = std::atan(1.0), t2 = t * t;
  ASSERT_TRUE(fisheye().project({1.0, 0.0, 1.0}, pixel));
  EXPECT_NEAR(pixel.x(), 290.0 * t * (1 + t2 * (-0.02 + t2 * (0.006 + t2 * (-0.003 + t2 * 0.0004)))) + 318.0, 1e-9);
  EXPECT_NEAR(pixel.y(), 241.0, 1e-9);
}

TEST(Camera, KnowsWhereItsPolynomialTurns) {
  // 1 + 3 k1 r^2 = 0 at r^2 = 1 / 0.84.
  const std::vector<double> k{-0.28, 0.0, 0.0, 0.0};
  const Camera camera(640, 480, 500.0, 500.0, 319.5, 239.5, Lens::kRadialTangential, k);
  EXPECT_NEAR(std::tan(camera.max_angle_rad()), std::sqrt(1.0 / 0.84), 1e-9);
  Vector2 pixel;
  EXPECT_TRUE(camera.project({1.09, 0.0, 1.0}, pixel));
  EXPECT_FALSE(camera.project({1.10, 0.0, 1.0}, pixel));
  Vector3 ray;
  EXPECT_FALSE(camera.unproject({319.5 + 500.0 * 0.8, 239.5}, ray));  // the largest radius seen is 0.727
  EXPECT_TRUE(camera.unproject({319.5 + 500.0 * 0.72, 239.5}, ray));
  EXPECT_LT(ray.x(), 1.092);
}

TEST(Camera, AnotherSizeSeesTheSame) {
  const Camera whole = bent(), half = whole.resized(320, 240);
  Vector2 at, at_half;
  ASSERT_TRUE(whole.project({0.3, 0.2, 1.0}, at) && half.project({0.3, 0.2, 1.0}, at_half));
  EXPECT_NEAR((at.x() + 0.5) / 640.0, (at_half.x() + 0.5) / 320.0, 1e-12);
  EXPECT_NEAR((at.y() + 0.5) / 480.0, (at_half.y() + 0.5) / 240.0, 1e-12);
  EXPECT_TRUE(whole.contains({-0.5, 479.5}));
  EXPECT_FALSE(whole.contains({-0.51, 0.0}));
  EXPECT_FALSE(whole.contains({5.0, 100.0}, 10.0));
  EXPECT_FALSE(whole.contains({kNan, 1.0}));
}

TEST(Camera, SaysWhatIsWrong) {
  const auto sentence = [](int width, double fx, Lens lens, std::vector<double> k) -> std::string {
    try {
      const Camera camera(width, 480, fx, 520.0, 319.5, 239.5, lens, k);
      static_cast<void>(camera);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_EQ(sentence(640, 525.0, Lens::kPinhole, {}), "");
  EXPECT_EQ(sentence(0, 525.0, Lens::kPinhole, {}), "width: 0; 1 to 65535 pixels are possible");
  EXPECT_THAT(sentence(640, -1.0, Lens::kPinhole, {}), testing::StartsWith("fx: -1.000000; it must be positive"));
  EXPECT_THAT(sentence(640, kNan, Lens::kPinhole, {}), testing::HasSubstr("finite"));
  EXPECT_EQ(sentence(640, 525.0, Lens::kFisheye, {0.1, 0.2}), "distortion: 2 numbers; a fisheye lens has 4");
  EXPECT_THAT(sentence(640, 525.0, Lens::kRadialTangential, {-1e5, 0.0, 0.0, 0.0, 0.0}),
              testing::HasSubstr("several rays share a pixel"));
  EXPECT_THROW(static_cast<void>(pinhole().resized(0, 10)), std::invalid_argument);
}

}  // namespace
}  // namespace soopnav::vision
