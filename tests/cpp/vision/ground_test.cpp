// Planes of the ground, rays on them, rigid motions over them: values, laws, Jacobians, consistency, no heap.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/vision/ground_plane.hpp"
#include "soopnav/vision/ground_projection.hpp"
#include "soopnav/vision/rigid_motion.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::vision {
namespace {

using Vector2 = Eigen::Vector2d;
using Vector3 = Eigen::Vector3d;
using Matrix3 = Eigen::Matrix3d;

constexpr float kNanF = std::numeric_limits<float>::quiet_NaN();
constexpr double kDegree = 0.017453292519943295;

struct Cloud {
  double outliers = 0.0;
  double noise = 1.0;  // times the options' sigma
  int points = 4000;
};

/// Points of a plane with the noise that PlaneOptions stand for.
std::vector<float> cloud_of(RandomStream& random, const GroundPlane& plane, const Cloud& cloud = {}) {
  std::vector<float> out;
  for (int i = 0; i < cloud.points; ++i) {
    const Vector3 ray(random.uniform(-0.55, 0.55), random.uniform(-0.42, 0.42), 1.0);
    double z = plane.distance_m / plane.normal_c.dot(ray);
    const double error = cloud.noise * (0.0005 + 0.0014 * z * z) * random.normal();
    z = random.uniform() < cloud.outliers ? z * random.uniform(0.3, 0.9) : z + error;
    for (int k = 0; k < 3; ++k) out.push_back(static_cast<float>(ray[k] * z));
  }
  return out;
}

GroundPlane tilted(double a_x, double a_y, double height) {
  return GroundPlane::known(normal_of_tilt({a_x, a_y}), height);
}

/// What the covariance is of: [eta_1, eta_2, d].
Vector3 error_of(const GroundPlane& plane, const GroundPlane& truth) {
  Vector3 e;
  e << body_axes(plane.normal_c).topRows<2>() * (plane.normal_c - truth.normal_c), plane.distance_m - truth.distance_m;
  return e;
}

GroundPlane moved_by(const GroundPlane& plane, const Vector3& error) {
  GroundPlane out = plane;
  out.normal_c = (plane.normal_c + body_axes(plane.normal_c).topRows<2>().transpose() * error.head<2>()).normalized();
  out.distance_m += error.z();
  return out;
}

std::string refusal(const std::function<void()>& body) {
  try {
    body();
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

// ---- planes

TEST(PlaneFitter, MeanNeesOfManyCloudsIsThree) {
  RandomStream random(11);
  for (const double outliers : {0.0, 0.4}) {
    PlaneFitter fitter;
    double nees = 0.0;
    constexpr int kRuns = 150;
    for (int k = 0; k < kRuns; ++k) {
      const GroundPlane truth = tilted(random.uniform(-0.2, 0.2), random.uniform(-0.2, 0.2), random.uniform(0.5, 2.0));
      const GroundPlane plane = fitter.fit(cloud_of(random, truth, {outliers, 1.0, 3000}));
      ASSERT_TRUE(plane.ok()) << name(plane.status);
      const Vector3 e = error_of(plane, truth);
      nees += e.dot(plane.covariance.inverse() * e) / kRuns;
    }
    // chi-square of 450 degrees: 1e-4 bounds 2.29 ... 3.85 after division; cutting at three sigma costs 3 %.
    EXPECT_GT(nees, 2.2) << outliers;
    EXPECT_LT(nees, 4.0) << outliers;
  }
}

TEST(PlaneFitter, TheHeightIsNotPulledTowardsTheCamera) {
  // 3 m up, weights by the measured depth put it 1.2 of its standard deviations too low with 30 000 points.
  RandomStream random(12);
  PlaneFitter fitter;
  const GroundPlane truth = tilted(0.08, -0.05, 3.0);
  constexpr int kRuns = 25;
  double off = 0.0;
  for (int run = 0; run < kRuns; ++run) {
    const GroundPlane plane = fitter.fit(cloud_of(random, truth, {.points = 20000}));
    ASSERT_TRUE(plane.ok());
    off += (plane.distance_m - truth.distance_m) / std::sqrt(plane.covariance(2, 2)) / kRuns;
  }
  EXPECT_LT(std::fabs(off), 0.6);  // three standard deviations of a mean of 25
}

TEST(PlaneFitter, PointsOfAllHeightsAroundTheGroundAreNotOnIt) {
  // At the camera's own height a ray meets the ground nowhere; far away the sensor's noise allows everything.
  RandomStream random(13);
  PlaneFitter fitter({.sigma_per_m = 0.02});
  const GroundPlane truth = tilted(0.6, 0.0, 1.0);
  auto cloud = cloud_of(random, truth, {.noise = 0.05});
  const int ground = fitter.fit(cloud).inliers;
  for (int i = 0; i < 2000; ++i) {
    const double up = random.uniform(-1.0, 0.4);  // n . p
    const Vector3 p = up * truth.normal_c + random.uniform(1.0, 4.0) * body_axes(truth.normal_c).row(1).transpose();
    for (int k = 0; k < 3; ++k) cloud.push_back(static_cast<float>(p[k]));
  }
  const GroundPlane plane = fitter.fit(cloud);
  ASSERT_TRUE(plane.ok());
  EXPECT_EQ(plane.inliers, ground);
  EXPECT_NEAR(plane.distance_m, 1.0, 1e-3);
}

TEST(PlaneFitter, OutliersPullTheSvdByDegreesAndNotTheRansac) {
  RandomStream random(12);
  const GroundPlane truth = tilted(0.1, -0.14, 1.0);
  std::vector<float> points = cloud_of(random, truth, {0.0, 1.0, 6000});
  for (std::size_t i = 0; i + 2 < points.size(); i += 3) {  // a box on one side
    if (points[i] > 0.25F) points[i + 2] *= 0.7F;
  }
  PlaneOptions svd;
  svd.method = PlaneMethod::kSvd;
  const GroundPlane plain = PlaneFitter(svd).fit(points);
  const GroundPlane robust = PlaneFitter().fit(points);
  ASSERT_TRUE(robust.ok());
  EXPECT_LT(std::acos(std::min(1.0, robust.normal_c.dot(truth.normal_c))), 0.05 * kDegree);
  EXPECT_GT(std::acos(std::min(1.0, plain.normal_c.dot(truth.normal_c))), 2.0 * kDegree);
}

TEST(PlaneFitter, WithoutOutliersBothMethodsAgree) {
  RandomStream random(13);
  const auto points = cloud_of(random, tilted(-0.05, 0.08, 1.2));
  PlaneOptions svd;
  svd.method = PlaneMethod::kSvd;
  const GroundPlane a = PlaneFitter(svd).fit(points), b = PlaneFitter().fit(points);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_LT((a.normal_c - b.normal_c).norm(), 5e-4);
  EXPECT_NEAR(a.distance_m, b.distance_m, 2e-4);
  EXPECT_EQ(a.inliers, 4000);
  EXPECT_NEAR(a.rms_m, 0.0005 + 0.0014 * 1.44, 4e-4);
}

TEST(PlaneFitter, EachStatusHasACloud) {
  RandomStream random(14);
  PlaneFitter fitter;
  EXPECT_EQ(fitter.fit({}).status, PlaneStatus::kTooFew);
  const std::vector<float> lost(30000, kNanF);
  EXPECT_EQ(fitter.fit(lost).status, PlaneStatus::kTooFew);
  EXPECT_EQ(fitter.fit(cloud_of(random, tilted(0.0, 1.2, 0.6))).status, PlaneStatus::kWall);
  EXPECT_EQ(fitter.fit(cloud_of(random, tilted(0.0, 0.0, 14.0))).status, PlaneStatus::kHeight);
  std::vector<float> line, place, fog;
  for (int i = 0; i < 900; ++i) {
    line.insert(line.end(), {0.001F * static_cast<float>(i), 0.0F, 1.0F});
    place.insert(place.end(), {0.1F, 0.2F, 1.0F});
    for (const double low : {-0.5, -0.4, 0.5}) fog.push_back(static_cast<float>(random.uniform(low, low + 1.0)));
  }
  EXPECT_EQ(fitter.fit(line).status, PlaneStatus::kDegenerate);
  EXPECT_EQ(fitter.fit(place).status, PlaneStatus::kDegenerate);
  EXPECT_EQ(fitter.fit(fog).status, PlaneStatus::kNoPlane);
  PlaneOptions svd;
  svd.method = PlaneMethod::kSvd;
  EXPECT_EQ(PlaneFitter(svd).fit(line).status, PlaneStatus::kDegenerate);
  const GroundPlane none = fitter.fit(fog);
  EXPECT_TRUE(none.normal_c.allFinite() && none.covariance.isZero() && none.distance_m == 0.0);
  EXPECT_STREQ(name(none.status), "no plane");
}

TEST(PlaneFitter, NansAndPointsBehindAreSkippedAndAWallBesideTheGroundIsNotTaken) {
  RandomStream random(15);
  const GroundPlane truth = tilted(0.05, 0.02, 1.1);
  auto points = cloud_of(random, truth, {0.0, 1.0, 1500});
  const auto wall = cloud_of(random, tilted(0.1, 1.25, 0.4), {0.0, 1.0, 3000});  // twice as many points
  points.insert(points.end(), wall.begin(), wall.end());
  for (int i = 0; i < 500; ++i) points.insert(points.end(), {kNanF, 0.0F, 1.0F, 0.1F, 0.1F, -1.0F});
  const GroundPlane plane = PlaneFitter().fit(points);
  ASSERT_TRUE(plane.ok()) << name(plane.status);
  int in_front = 0;
  for (std::size_t i = 2; i < points.size(); i += 3)
    in_front += points[i] > 0.0F && std::isfinite(points[i - 2]) ? 1 : 0;
  EXPECT_EQ(plane.points, in_front);
  EXPECT_GT(plane.points - 1500, 1500) << "more points of the wall than of the ground";
  EXPECT_LT((plane.normal_c - truth.normal_c).norm(), 1e-3);
}

TEST(PlaneFitter, AFixedBandTakesWhatLiesWithinIt) {
  RandomStream random(17);
  const auto points = cloud_of(random, tilted(0.02, 0.1, 1.0), {0.0, 1.0, 3000});
  PlaneOptions wide;
  wide.band_m = 0.05;
  PlaneOptions tight;
  tight.band_m = 0.0005;
  tight.min_share = 0.1;
  EXPECT_EQ(PlaneFitter(wide).fit(points).inliers, 3000);
  const GroundPlane thin = PlaneFitter(tight).fit(points);
  ASSERT_TRUE(thin.ok());
  EXPECT_LT(thin.inliers, 1200);
  EXPECT_LT(thin.rms_m, 0.0005 / std::sqrt(3.0) * 1.1);
}

TEST(PlaneFitter, SameSeedSameBits) {
  RandomStream random(16);
  const auto points = cloud_of(random, tilted(0.1, 0.1, 1.0), {0.5, 1.0, 3000});
  PlaneFitter a, b;
  for (int k = 0; k < 3; ++k) {
    const GroundPlane first = a.fit(points), second = b.fit(points);
    EXPECT_EQ(first.normal_c, second.normal_c);
    EXPECT_EQ(first.covariance, second.covariance);
  }
}

TEST(GroundPlane, FromAnotherCameraIsTheSameGround) {
  const GroundPlane ir = [] {
    GroundPlane p = tilted(0.1, -0.2, 1.3);
    p.covariance << 4.0, 1.0, 0.5, 1.0, 3.0, -0.2, 0.5, -0.2, 2.0;
    p.covariance *= 1e-6;
    return p;
  }();
  const Matrix3 turn =
      (Eigen::AngleAxisd(0.3, Vector3::UnitZ()) * Eigen::AngleAxisd(0.05, Vector3::UnitX())).toRotationMatrix();
  const Vector3 at(0.025, -0.01, 0.004);
  const GroundPlane rgb = ir.seen_from(at, turn);
  // A point of the ground satisfies both equations.
  const Vector3 p = GroundProjection(ir).to_camera({0.3, -0.2});
  EXPECT_NEAR(rgb.normal_c.dot(turn * (p - at)), rgb.distance_m, 1e-12);
  // nielsen: D -> D + A D_cam.
  const GroundPlane beside = ir.seen_from({0.025, 0.0, 0.0});
  EXPECT_NEAR(nielsen_coefficients(beside)[3], nielsen_coefficients(ir)[3] + nielsen_coefficients(ir)[0] * 0.025,
              1e-15);
  // There and back, covariance included.
  const GroundPlane again = rgb.seen_from(-(turn * at), turn.transpose());
  EXPECT_LT((again.covariance - ir.covariance).norm(), 1e-18);
  // The covariance moves as errors do.
  const Vector3 small(1e-5, -2e-5, 3e-5);
  const Vector3 seen = error_of(moved_by(ir, small).seen_from(at, turn), rgb);
  GroundPlane one = ir;
  one.covariance = small * small.transpose();
  EXPECT_LT((one.seen_from(at, turn).covariance - seen * seen.transpose()).norm(), 1e-13);
  EXPECT_EQ(ir.seen_from({0.0, 0.0, 5.0}).status, PlaneStatus::kHeight);
  EXPECT_EQ(GroundPlane().seen_from(at).status, PlaneStatus::kNone);
}

TEST(GroundPlane, RefusesWhatCannotBe) {
  EXPECT_THAT(refusal([] { (void)GroundPlane::known({0.0, 0.0, -1.0}, 1.0); }), testing::HasSubstr("normal_c"));
  EXPECT_THAT(refusal([] { (void)GroundPlane::known({0.0, 0.0, 1.0}, 0.0); }), testing::HasSubstr("distance_m"));
  EXPECT_THAT(refusal([] {
                (void)GroundPlane::known({0.0, 0.0, 1.0}, 1.0, -Matrix3::Identity());
              }),
              testing::HasSubstr("covariance"));
  const auto with = [](auto member, auto value) {
    PlaneOptions o;
    o.*member = value;
    return refusal([&] { const PlaneFitter fitter(o); });
  };
  EXPECT_THAT(with(&PlaneOptions::sigma_m, -1.0), testing::HasSubstr("sigma_m: -1"));
  EXPECT_THAT(with(&PlaneOptions::sigma_per_m, std::nan("")), testing::HasSubstr("sigma_per_m"));
  EXPECT_THAT(with(&PlaneOptions::band_sigmas, 0.0), testing::HasSubstr("band_sigmas"));
  EXPECT_THAT(with(&PlaneOptions::band_m, -0.1), testing::HasSubstr("band_m"));
  EXPECT_THAT(with(&PlaneOptions::min_share, 0.0), testing::HasSubstr("min_share"));
  EXPECT_THAT(with(&PlaneOptions::min_points, 3), testing::HasSubstr("min_points"));
  EXPECT_THAT(with(&PlaneOptions::max_tilt_rad, 2.0), testing::HasSubstr("max_tilt_rad"));
  EXPECT_THAT(with(&PlaneOptions::max_height_m, 0.01), testing::HasSubstr("max_height_m"));
  EXPECT_THAT(with(&PlaneOptions::max_hypotheses, 0), testing::HasSubstr("max_hypotheses"));
  EXPECT_THAT(with(&PlaneOptions::confidence, 1.0), testing::HasSubstr("confidence"));
  EXPECT_THAT(with(&PlaneOptions::noise_cluster, 0.5), testing::HasSubstr("noise_cluster"));
}

// ---- frames and projection

TEST(Frames, TheChainGoesRoundAndTheGroundIsWhereThePlaneSays) {
  RandomStream random(21);
  for (int k = 0; k < 50; ++k) {
    const NielsenFrames frames{{random.uniform(-9.0, 9.0), random.uniform(-9.0, 9.0), random.uniform(-3.1, 3.1)},
                               {random.uniform(-0.4, 0.4), random.uniform(-0.4, 0.4)},
                               random.uniform(0.5, 2.0)};
    const Vector3 p(random.uniform(-9.0, 9.0), random.uniform(-9.0, 9.0), random.uniform(-0.5, 0.5));
    EXPECT_LT((frames.ground_from_camera(frames.camera_from_ground(p)) - p).norm(), 1e-12);
    // A point of the ground is on the plane of the tilt, and in our body where pose and increment say.
    const Vector3 on(p.x(), p.y(), 0.0);
    const Vector3 seen = frames.camera_from_ground(on);
    const Vector3 n = normal_of_tilt(frames.tilt);
    EXPECT_NEAR(n.dot(seen), frames.height_m, 1e-12);
    const Vector2 in_body = body_axes(n).topRows<2>() * seen;
    const Vector3 expected = increment_between(frames.pose, {on.x(), on.y(), 0.0});
    EXPECT_LT((in_body - expected.head<2>()).norm(), 1e-12);
    const TiltAngles tilt = tilt_of_normal(n);
    EXPECT_NEAR(tilt.a_x_rad, frames.tilt.a_x_rad, 1e-12);
    EXPECT_NEAR(tilt.a_y_rad, frames.tilt.a_y_rad, 1e-12);
  }
}

TEST(Frames, SignsOfTiltAndHeading) {
  // Looking straight down: image right is ground x, image up is ground y.
  const NielsenFrames down{{0.0, 0.0, 0.0}, {}, 1.0};
  EXPECT_TRUE(down.camera_from_ground({0.1, 0.0, 0.0}).isApprox(Vector3(0.1, 0.0, 1.0)));
  EXPECT_TRUE(down.camera_from_ground({0.0, 0.1, 0.0}).isApprox(Vector3(0.0, -0.1, 1.0)));
  EXPECT_TRUE(down.camera_from_ground({0.0, 0.0, 0.4}).isApprox(Vector3(0.0, 0.0, 0.6)));
  // A quarter turn counterclockwise: what was ahead along y lies along the body's first axis.
  const NielsenFrames turned{{0.0, 0.0, 90.0 * kDegree}, {}, 1.0};
  EXPECT_TRUE(turned.camera_from_ground({0.0, 0.1, 0.0}).isApprox(Vector3(0.1, 0.0, 1.0), 1e-12));
  // nielsen's printed signs (4.1): A = -sin a_y cos a_x, B = sin a_x for the normal out of the ground.
  const TiltAngles tilt{0.1, 0.2};
  const Eigen::Vector4d abcd = nielsen_coefficients(tilted(0.1, 0.2, 1.5));
  EXPECT_NEAR(-abcd[0], -std::sin(0.2) * std::cos(0.1), 1e-15);
  EXPECT_NEAR(-abcd[1], std::sin(0.1), 1e-15);
  EXPECT_NEAR(-abcd[2], -std::cos(0.2) * std::cos(0.1), 1e-15);
  EXPECT_NEAR(abcd[3], -1.5, 1e-15);
  EXPECT_GT(normal_of_tilt(tilt).x(), 0.0);
  // One angle alone: its frame c is our body.
  EXPECT_NEAR((NielsenFrames{{}, {0.3, 0.0}, 1.0}.heading_offset_rad()), 0.0, 1e-15);
  EXPECT_NEAR((NielsenFrames{{}, {0.0, 0.3}, 1.0}.heading_offset_rad()), 0.0, 1e-15);
  EXPECT_GT(std::fabs((NielsenFrames{{}, {0.3, 0.3}, 1.0}.heading_offset_rad())), 0.05);
}

TEST(Frames, IncrementsGoRound) {
  const GroundPose from{1.0, 2.0, 3.0}, to{1.2, 1.9, -3.1};
  const Vector3 step = increment_between(from, to);
  EXPECT_NEAR(step.z(), 0.18318530717958623, 1e-12);
  const GroundPose again = moved(from, step);
  EXPECT_NEAR(again.x_m, to.x_m, 1e-14);
  EXPECT_NEAR(again.y_m, to.y_m, 1e-14);
  EXPECT_NEAR(again.heading_rad, to.heading_rad, 1e-14);
  EXPECT_LT((to_previous_axes(to_present_axes(step)) - step).norm(), 1e-15);
  // The same step seen from its end, backwards, is nielsen's with the sign turned.
  const Vector3 back = increment_between(to, from);
  EXPECT_LT((back.head<2>() + to_present_axes(step).head<2>()).norm(), 1e-14);
}

TEST(GroundProjection, JacobiansAgainstDifferences) {
  RandomStream random(22);
  for (int k = 0; k < 20; ++k) {
    const GroundPlane plane = tilted(random.uniform(-0.5, 0.5), random.uniform(-0.5, 0.5), random.uniform(0.5, 3.0));
    const Vector3 ray(random.uniform(-0.4, 0.4), random.uniform(-0.4, 0.4), 1.0);
    Vector2 f;
    Eigen::Matrix2d to_ray;
    Eigen::Matrix<double, 2, 3> to_plane;
    const GroundProjection projection(plane);
    ASSERT_TRUE(projection.project(ray, f, &to_ray, &to_plane));
    EXPECT_LT(projection.to_camera(f).normalized().cross(ray.normalized()).norm(), 1e-12);
    constexpr double kStep = 1e-6;
    for (int i = 0; i < 3; ++i) {
      Vector2 high, low;
      const Vector3 step = kStep * Vector3::Unit(i);
      if (i < 2) {
        ASSERT_TRUE(projection.project(ray + step, high) && projection.project(ray - step, low));
        EXPECT_LT(((high - low) / (2.0 * kStep) - to_ray.col(i)).norm(), 1e-7) << i;
      }
      ASSERT_TRUE(GroundProjection(moved_by(plane, step)).project(ray, high));
      ASSERT_TRUE(GroundProjection(moved_by(plane, -step)).project(ray, low));
      EXPECT_LT(((high - low) / (2.0 * kStep) - to_plane.col(i)).norm(), 1e-7) << i;
    }
  }
}

TEST(GroundProjection, RefusesRaysThatDoNotComeDown) {
  const GroundProjection projection(tilted(0.0, 0.7, 1.0));
  Vector2 f(7.0, 7.0);
  EXPECT_FALSE(projection.project({-1.2, 0.0, 1.0}, f));     // over the horizon
  EXPECT_FALSE(projection.project({-1.1872, 0.0, 1.0}, f));  // along it
  EXPECT_FALSE(projection.project({0.0, 0.0, -1.0}, f));     // backwards
  EXPECT_FALSE(projection.project({std::nan(""), 0.0, 1.0}, f));
  EXPECT_EQ(f, Vector2(7.0, 7.0));
  EXPECT_TRUE(projection.project({0.0, 0.0, 1.0}, f));
}

// ---- rigid motion

struct Pairs {
  std::vector<Vector2> before, now;
};

struct Scene {
  Camera camera{640, 480, 525.0, 525.0, 319.5, 239.5};
  RandomStream random{31};

  Pairs pairs(const GroundPlane& before, const GroundPlane& now, const Vector3& step, int count, double sigma_px,
              double outliers = 0.0) {
    const GroundProjection first(before), second(now);
    const Eigen::Matrix2d turn = Eigen::Rotation2Dd(step.z()).toRotationMatrix();
    Pairs out;
    while (out.now.size() < static_cast<std::size_t>(count)) {
      const Vector2 f(random.uniform(-0.9, 0.9) * now.distance_m, random.uniform(-0.8, 0.8) * now.distance_m);
      Vector2 a, b;
      if (!camera.project(first.to_camera(turn * f + step.head<2>()), a) || !camera.project(second.to_camera(f), b) ||
          !camera.contains(a) || !camera.contains(b)) {
        continue;
      }
      b += sigma_px * Vector2(random.normal(), random.normal());
      if (random.uniform() < outliers) b += Vector2(random.uniform(-40.0, 40.0), random.uniform(-40.0, 40.0));
      out.before.push_back(a);
      out.now.push_back(b);
    }
    return out;
  }
};

TEST(RigidMotion, WithoutNoiseItIsExact) {
  Scene scene;
  RigidMotionEstimator estimator;
  const Vector3 step(0.02, -0.011, 0.03);
  const GroundPlane before = tilted(0.1, -0.05, 1.0), now = tilted(0.06, 0.02, 1.02);
  const Pairs pairs = scene.pairs(before, now, step, 60, 0.0);
  const PlanarMotion motion = estimator.estimate(scene.camera, pairs.before, pairs.now, before, now);
  ASSERT_TRUE(motion.ok()) << name(motion.status);
  EXPECT_LT((motion.increment - step).norm(), 1e-10);
  EXPECT_EQ(motion.inliers, 60);
  EXPECT_NEAR(motion.height_ratio, 1.02, 1e-9);
  EXPECT_NEAR(motion.height_ratio_plane, 1.02, 1e-12);
  EXPECT_NEAR(motion.height_m, 1.02, 1e-12);
  EXPECT_NEAR(motion.sigma_px, 0.01, 1e-12) << "the floor";
}

TEST(RigidMotion, CovarianceHoldsWithOutliersAndPlanes) {
  Scene scene;
  PlaneFitter fitter;
  for (const bool fitted : {false, true}) {
    RigidMotionEstimator estimator;
    double nees = 0.0, tracks_only = 0.0;
    constexpr int kRuns = 150;
    for (int k = 0; k < kRuns; ++k) {
      const auto angle = [&] { return scene.random.uniform(-0.14, 0.14); };
      const GroundPlane truth_before = tilted(angle(), angle(), scene.random.uniform(0.8, 1.2));
      const GroundPlane truth = tilted(angle(), angle(), truth_before.distance_m + scene.random.uniform(-0.01, 0.01));
      const Vector3 step(0.02 * scene.random.normal(), 0.02 * scene.random.normal(), 0.02 * scene.random.normal());
      const Pairs pairs = scene.pairs(truth_before, truth, step, 120, 0.15, 0.3);
      const GroundPlane before =
          fitted ? fitter.fit(cloud_of(scene.random, truth_before, {0.2, 1.0, 3000})) : truth_before;
      const GroundPlane now = fitted ? fitter.fit(cloud_of(scene.random, truth, {0.2, 1.0, 3000})) : truth;
      const PlanarMotion motion = estimator.estimate(scene.camera, pairs.before, pairs.now, before, now);
      ASSERT_TRUE(motion.ok()) << name(motion.status);
      const Vector3 e = motion.increment - step;
      nees += e.dot(motion.covariance.inverse() * e) / kRuns;
      tracks_only += e.dot(motion.track_covariance.inverse() * e) / kRuns;
      if (!fitted) {
        EXPECT_EQ(motion.covariance, motion.track_covariance);
      }
    }
    EXPECT_GT(nees, 2.2) << fitted;  // as above
    EXPECT_LT(nees, 4.0) << fitted;
    if (fitted) {
      EXPECT_GT(tracks_only, 20.0) << "the planes' part is what matters here";
    }
  }
}

TEST(RigidMotion, FootNoiseIsThePlanesAndCancelsInTheNextIncrement) {
  Scene scene;
  RigidMotionEstimator estimator;
  const GroundPlane truth = tilted(0.0, 0.0, 1.0);
  GroundPlane noisy = truth;
  noisy.covariance.diagonal() << 1e-6, 1e-6, 1e-8;
  const Vector3 error(1e-3, -0.7e-3, 0.0);
  const GroundPlane off = moved_by(noisy, error);
  const Vector3 step(0.02, 0.01, 0.0);
  const Pairs first = scene.pairs(truth, truth, step, 200, 0.0), second = scene.pairs(truth, truth, step, 200, 0.0);
  const PlanarMotion in = estimator.estimate(scene.camera, first.before, first.now, truth, off);
  const PlanarMotion out = estimator.estimate(scene.camera, second.before, second.now, off, truth);
  ASSERT_TRUE(in.ok() && out.ok());
  const Vector3 alone = in.increment - step;
  EXPECT_NEAR(alone.x(), 1e-3, 2.5e-4);  // d times the normal's error
  EXPECT_NEAR(alone.y(), -0.7e-3, 2.5e-4);
  EXPECT_LT((in.increment + out.increment - 2.0 * step).head<2>().norm(), 0.1 * alone.head<2>().norm());
  EXPECT_NEAR(in.foot_covariance(0, 0), 1e-6, 0.5e-6);
  EXPECT_NEAR(out.foot_covariance_previous(0, 0), in.foot_covariance(0, 0), 0.2e-6);
  EXPECT_TRUE(in.foot_covariance_previous.isZero());
  EXPECT_NEAR(in.covariance(0, 0), in.track_covariance(0, 0) + in.foot_covariance(0, 0), 1e-8);
}

TEST(RigidMotion, FarPointsCountLess) {
  // Half of the picture far away, with the noise that pixels make there: the estimate is as good as the covariance
  // says, which an unweighted fit would miss by far.
  Scene scene;
  RigidMotionEstimator estimator;
  const GroundPlane slanted = tilted(-0.9, 0.0, 1.0);
  double weighted = 0.0;
  constexpr int kRuns = 60;
  for (int k = 0; k < kRuns; ++k) {
    const Vector3 step(0.01, 0.02, 0.004);
    const Pairs pairs = scene.pairs(slanted, slanted, step, 100, 0.2);
    const PlanarMotion motion = estimator.estimate(scene.camera, pairs.before, pairs.now, slanted, slanted);
    ASSERT_TRUE(motion.ok()) << name(motion.status);
    const Vector3 e = motion.increment - step;
    weighted += e.dot(motion.covariance.inverse() * e) / kRuns;
  }
  EXPECT_GT(weighted, 1.8);
  EXPECT_LT(weighted, 4.6);
}

TEST(RigidMotion, EachStatusHasACase) {
  Scene scene;
  RigidMotionEstimator estimator;
  const GroundPlane plane = tilted(0.0, 0.0, 1.0);
  const Vector3 step(0.01, 0.0, 0.0);
  Pairs pairs = scene.pairs(plane, plane, step, 50, 0.05);
  const auto status = [&](const Pairs& p, const GroundPlane& a, const GroundPlane& b) {
    const PlanarMotion motion = estimator.estimate(scene.camera, p.before, p.now, a, b);
    EXPECT_TRUE(motion.ok() || (motion.increment.isZero() && motion.covariance.isZero()));
    return motion.status;
  };
  EXPECT_EQ(status(pairs, plane, plane), MotionStatus::kMeasured);
  EXPECT_EQ(status(pairs, GroundPlane(), plane), MotionStatus::kNoPlane);
  EXPECT_EQ(status(pairs, plane, GroundPlane()), MotionStatus::kNoPlane);
  EXPECT_EQ(status({}, plane, plane), MotionStatus::kTooFewTracks);
  // The camera rose by 2 %, or a little less than the tracks' gate would notice; the planes say it did not.
  for (const double height : {1.02, 1.0035}) {
    const Pairs rising = scene.pairs(plane, tilted(0.0, 0.0, height), step, 50, 0.05);
    RigidMotionOptions strict;
    strict.height_tolerance = 0.001;
    const PlanarMotion motion =
        RigidMotionEstimator(strict).estimate(scene.camera, rising.before, rising.now, plane, plane);
    EXPECT_EQ(motion.status, MotionStatus::kHeightDisagreement) << height << " " << name(motion.status);
    EXPECT_NEAR(motion.height_ratio, height, 0.15 * (height - 1.0));
    EXPECT_TRUE(motion.increment.isZero());
  }
  Pairs chaos = pairs;
  for (auto& pixel : chaos.now) pixel = {scene.random.uniform(0.0, 640.0), scene.random.uniform(0.0, 480.0)};
  EXPECT_EQ(status(chaos, plane, plane), MotionStatus::kNoConsensus);
  Pairs lost = pairs;
  for (auto& pixel : lost.now) pixel.x() = std::nan("");
  EXPECT_EQ(status(lost, plane, plane), MotionStatus::kTooFewTracks);
  Pairs place = pairs;
  for (std::size_t i = 0; i < place.now.size(); ++i) {
    place.now[i] = pairs.now[0];
    place.before[i] = pairs.before[0];
  }
  EXPECT_FALSE(estimator.estimate(scene.camera, place.before, place.now, plane, plane).ok());
}

TEST(RigidMotion, FlagsTheTracksThatAgree) {
  Scene scene;
  RigidMotionEstimator estimator;
  const GroundPlane plane = tilted(0.05, 0.0, 1.0);
  Pairs pairs = scene.pairs(plane, plane, {0.0, 0.02, 0.0}, 40, 0.05);
  for (std::size_t i = 0; i < 40; i += 4) pairs.now[i] += Vector2(8.0, -5.0);
  std::vector<std::uint8_t> flags(40, 9);
  ASSERT_TRUE(estimator.estimate(scene.camera, pairs.before, pairs.now, plane, plane, flags).ok());
  for (std::size_t i = 0; i < 40; ++i) EXPECT_EQ(flags[i], i % 4 == 0 ? 0 : 1) << i;
}

TEST(RigidMotion, RefusesOptionsOutOfRange) {
  const auto with = [](auto member, auto value) {
    RigidMotionOptions o;
    o.*member = value;
    return refusal([&] { const RigidMotionEstimator estimator(o); });
  };
  EXPECT_THAT(with(&RigidMotionOptions::min_sigma_px, 0.0), testing::HasSubstr("min_sigma_px"));
  EXPECT_THAT(with(&RigidMotionOptions::inlier_px, 0.01), testing::HasSubstr("inlier_px"));
  EXPECT_THAT(with(&RigidMotionOptions::min_tracks, 2), testing::HasSubstr("min_tracks"));
  EXPECT_THAT(with(&RigidMotionOptions::min_share, 1.5), testing::HasSubstr("min_share"));
  EXPECT_THAT(with(&RigidMotionOptions::max_hypotheses, 0), testing::HasSubstr("max_hypotheses"));
  EXPECT_THAT(with(&RigidMotionOptions::confidence, 0.0), testing::HasSubstr("confidence"));
  EXPECT_THAT(with(&RigidMotionOptions::height_sigmas, 0.0), testing::HasSubstr("height_sigmas"));
  EXPECT_THAT(with(&RigidMotionOptions::height_tolerance, -1.0), testing::HasSubstr("height_tolerance"));
  EXPECT_THAT(with(&RigidMotionOptions::track_inflation, 0.5), testing::HasSubstr("track_inflation"));
}

TEST(Ground, FitsAndMotionsDoNotAllocate) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  Scene scene;
  const GroundPlane plane = tilted(0.05, 0.02, 1.0);
  const auto points = cloud_of(scene.random, plane, {0.2, 1.0, 3000});
  const Pairs pairs = scene.pairs(plane, plane, {0.01, 0.0, 0.0}, 100, 0.1, 0.2);
  PlaneFitter fitter;
  fitter.reserve(3000);
  RigidMotionEstimator estimator;
  estimator.reserve(100);
  GroundPlane fitted;
  PlanarMotion motion;
  EXPECT_EQ(test::allocations_of([&] {
              fitted = fitter.fit(points);
              motion = estimator.estimate(scene.camera, pairs.before, pairs.now, fitted, fitted);
            }),
            0);
  EXPECT_TRUE(fitted.ok() && motion.ok());
}

}  // namespace
}  // namespace soopnav::vision
