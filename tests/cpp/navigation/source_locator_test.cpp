#include "soopnav/navigation/source_locator.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <string>
#include <vector>

#include "navigation/source_filter.hpp"
#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/navigation/source_crlb.hpp"
#include "soopnav/navigation/source_likelihood.hpp"
#include "soopnav/navigation/source_tracks.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::navigation {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr std::array kMethods = {
    SourceMethod::kCentroid,       SourceMethod::kIncenter,     SourceMethod::kLinear,
    SourceMethod::kStansfield,     SourceMethod::kLeastSquares, SourceMethod::kMaximumLikelihood,
    SourceMethod::kExtendedKalman, SourceMethod::kEkfBank,      SourceMethod::kParticle};

// Bearings from a drive along y = -200 and up x = 600, a degree of noise times `noise`.
std::vector<SourceBearing> drive(const Eigen::Vector3d& source, const Eigen::Vector3d& velocity, double noise,
                                 std::uint64_t seed, std::size_t n = 80) {
  RandomStream random(seed);
  std::vector<SourceBearing> out(n);
  for (std::size_t i = 0; i < n; ++i) {
    const double s = static_cast<double>(i) / static_cast<double>(n - 1);
    SourceBearing& b = out[i];
    b.t_s = 100.0 * s;
    b.position_m = s < 0.5 ? Eigen::Vector3d(-600.0 + 2400.0 * s, -200.0, 0.0)
                           : Eigen::Vector3d(600.0, -200.0 + 1600.0 * (s - 0.5), 0.0);
    const Eigen::Vector3d to = source + b.t_s * velocity - b.position_m;
    b.sigma_azimuth_rad = b.sigma_elevation_rad = radians(1.0);
    b.azimuth_rad = std::atan2(to[1], to[0]) + noise * b.sigma_azimuth_rad * random.normal();
    b.elevation_rad = std::atan2(to[2], std::hypot(to[0], to[1])) + noise * b.sigma_elevation_rad * random.normal();
  }
  return out;
}

SourceFix locate(const SourceOptions& options, const std::vector<SourceBearing>& bearings) {
  SourceLocator locator(options);
  for (const SourceBearing& b : bearings) locator.observe(b);
  return locator.fix();
}

SourceOptions with(SourceMethod method, int dimensions = 2) {
  SourceOptions o;
  o.method = method;
  o.dimensions = dimensions;
  o.particles = 1000;
  o.triple_spacing = 5;
  if (method == SourceMethod::kExtendedKalman || method == SourceMethod::kParticle) {
    o.start_m = Eigen::Vector3d(150.0, 200.0, 30.0);
    o.start_sigma_m = 150.0;
  }
  return o;
}

PackedBearing packed(const SourceBearing& b, bool inexact) {
  PackedBearing p;
  p.x = b.position_m[0];
  p.y = b.position_m[1];
  p.z = b.position_m[2];
  p.cos_azimuth = std::cos(b.azimuth_rad);
  p.sin_azimuth = std::sin(b.azimuth_rad);
  p.elevation = b.elevation_rad;
  p.variance_azimuth = 0.01;
  p.variance_elevation = 0.02;
  if (inexact) {
    p.xx = 25.0, p.xy = -9.0, p.yy = 16.0, p.xz = 3.0, p.yz = 2.0, p.zz = 9.0;
  }
  return p;
}

// ln of the density of one bearing, by the C library and the model's own gradients.
double reference(const PackedBearing& b, double x, double y, double z, bool space, double outlier) {
  detail::Kept kept;
  kept.b = b;
  kept.azimuth = std::atan2(b.sin_azimuth, b.cos_azimuth);
  detail::Angles angles;
  EXPECT_TRUE(detail::predict({space ? std::size_t{3} : std::size_t{2}, false, false}, {x, y, z}, 0.0, kept, angles));
  double normal = 1.0 - outlier;
  for (std::size_t r = 0; r < (space ? 2U : 1U); ++r) {
    normal *= std::exp(-0.5 * angles.residual[r] * angles.residual[r] / angles.variance[r]) /
              std::sqrt(kTwoPi * angles.variance[r]);
  }
  return std::log(normal + outlier / (space ? 2.0 * kPi * kPi : kTwoPi));
}

TEST(SourceLikelihood, KernelsAgreeWithTheLibraryFunctions) {
  const auto bearings = drive({100.0, 150.0, 40.0}, Eigen::Vector3d::Zero(), 3.0, 1, 30);
  std::vector<double> x(512), y(512), z(512);
  RandomStream random(2);
  for (std::size_t i = 0; i < x.size(); ++i) {
    x[i] = random.uniform(-900.0, 900.0);
    y[i] = random.uniform(-700.0, 900.0);
    z[i] = random.uniform(-50.0, 200.0);
  }
  for (const bool space : {false, true}) {
    for (const bool inexact : {false, true}) {
      for (const double outlier : {0.0, 0.02}) {
        std::vector<PackedBearing> all;
        for (const auto& b : bearings) all.push_back(packed(b, inexact));
        const Places places{x, y, space ? std::span<const double>(z) : std::span<const double>()};
        std::vector<double> logs(x.size(), 1.0);
        add_log_likelihood(all, places, outlier, logs);
        std::vector<double> weights(x.size(), 0.5);
        const WeightSum sums = weigh_places(all[3], places, outlier, 2.0, weights);
        const double top = (1.0 - outlier) / (space ? kTwoPi * std::sqrt(0.01 * 0.02) : std::sqrt(kTwoPi * 0.01));
        double total = 0.0;
        for (std::size_t i = 0; i < x.size(); ++i) {
          double sum = 1.0;
          for (const auto& b : all) sum += reference(b, x[i], y[i], z[i], space, outlier);
          // In single precision an angle is right to 3e-7 and more near the platform: times the largest slope, pi /
          // variance, of each bearing.
          const double coarse = space || inexact ? 0.0 : 2e-6 * kPi / 0.01;
          ASSERT_NEAR(logs[i], sum, 1e-9 * std::abs(sum) + coarse * static_cast<double>(all.size()))
              << space << inexact << outlier << " place " << i;
          const double one = std::exp(reference(all[3], x[i], y[i], z[i], space, outlier)) / top;
          // The arc tangent is right to 4e-12: of an error of k sigma that is 4e-12 k² of the density.
          ASSERT_NEAR(weights[i], one,
                      one * (1e-9 + 2e-8 * std::abs(std::log(one)) + (outlier > 0.0 ? coarse : 0.0)) + 1e-300);
          total += weights[i];
        }
        EXPECT_NEAR(sums.sum, total, 1e-12 * total);
      }
    }
  }
}

TEST(SourceLikelihood, SurfaceHasRowsAlongYAndRefusesBadGrids) {
  const auto bearings = drive({100.0, 150.0, 0.0}, Eigen::Vector3d::Zero(), 0.0, 1, 20);
  std::vector<PackedBearing> all;
  for (const auto& b : bearings) all.push_back(packed(b, false));
  const SurfaceGrid grid{-400.0, 400.0, -100.0, 300.0, 17, 9};
  std::vector<double> surface(17 * 9);
  likelihood_surface(all, grid, 0.02, surface);
  const auto best = static_cast<std::size_t>(std::max_element(surface.begin(), surface.end()) - surface.begin());
  EXPECT_EQ(best % 17, 10U);  // x = 100
  EXPECT_EQ(best / 17, 5U);   // y = 150
  EXPECT_THROW(likelihood_surface(all, {0.0, 0.0, 0.0, 1.0, 17, 9}, 0.02, surface), std::invalid_argument);
  EXPECT_THROW(likelihood_surface(all, grid, 1.0, surface), std::invalid_argument);
  EXPECT_THROW(likelihood_surface(all, {0.0, 1.0, 0.0, 1.0, 16, 9}, 0.02, surface), std::invalid_argument);
}

TEST(SourceFilter, GradientsAgreeWithDifferences) {
  const auto bearings = drive({100.0, 150.0, 40.0}, Eigen::Vector3d::Zero(), 1.0, 1, 12);
  for (const std::size_t d : {2UL, 3UL}) {
    for (const bool moving : {false, true}) {
      const detail::Layout layout{d, moving, true};
      detail::Vector x{80.0, 170.0, 25.0};
      if (moving) x[d] = 1.5;
      x[layout.bias()] = 0.1;
      for (const auto& b : bearings) {
        detail::Kept kept;
        ASSERT_EQ(detail::pack(b, d, kept), BearingUse::kUsed);
        detail::Angles at;
        ASSERT_TRUE(detail::predict(layout, x, 30.0, kept, at));
        for (std::size_t i = 0; i < layout.size(); ++i) {
          const double step = i < d ? 0.1 : 1e-3;
          detail::Vector up = x;
          detail::Vector down = x;
          up[i] += step;
          down[i] -= step;
          detail::Angles above;
          detail::Angles below;
          ASSERT_TRUE(detail::predict(layout, up, 30.0, kept, above) &&
                      detail::predict(layout, down, 30.0, kept, below));
          for (std::size_t row = 0; row + 1 < d; ++row) {
            const double slope = -wrap_to_pi(above.residual[row] - below.residual[row]) / (2.0 * step);
            EXPECT_NEAR(at.gradient[row][i], slope, 1e-7 + 1e-5 * std::abs(slope));
          }
        }
      }
    }
  }
}

TEST(SourceLocator, EveryMethodFindsASourceFromExactBearings) {
  for (const int dimensions : {2, 3}) {
    const Eigen::Vector3d source(100.0, 150.0, dimensions == 3 ? 40.0 : 0.0);
    const auto bearings = drive(source, Eigen::Vector3d::Zero(), 0.0, 1);
    for (const SourceMethod method : kMethods) {
      const SourceFix fix = locate(with(method, dimensions), bearings);
      EXPECT_EQ(fix.status, SourceStatus::kConverged) << to_string(method) << dimensions << fix.message();
      const bool batch = method <= SourceMethod::kMaximumLikelihood;
      EXPECT_LT((fix.position_m - source).norm(), batch ? 1e-3 : 4.0) << to_string(method) << dimensions;
      EXPECT_EQ(fix.used, bearings.size());
    }
  }
}

TEST(SourceLocator, FollowsAMovingSource) {
  const Eigen::Vector3d start(100.0, 350.0, 30.0);
  const Eigen::Vector3d velocity(-1.0, 2.0, 0.0);
  for (const int dimensions : {2, 3}) {
    for (const SourceMethod method :
         {SourceMethod::kLeastSquares, SourceMethod::kMaximumLikelihood, SourceMethod::kEkfBank}) {
      SourceOptions options = with(method, dimensions);
      options.motion = SourceMotion::kConstantVelocity;
      const SourceFix fix = locate(options, drive(start, velocity, 0.0, 1));
      Eigen::Vector3d end = start + 100.0 * velocity;
      if (dimensions == 2) end[2] = 0.0;
      const double limit = method == SourceMethod::kEkfBank ? 10.0 : 0.01;
      EXPECT_LT((fix.position_m - end).norm(), limit) << to_string(method) << dimensions;
      EXPECT_LT((fix.velocity_mps - velocity).head(2).norm(), 0.05 * limit + 1e-3) << to_string(method) << dimensions;
    }
  }
}

TEST(SourceLocator, EstimatesAHeadingBias) {
  auto bearings = drive({100.0, 150.0, 0.0}, Eigen::Vector3d::Zero(), 0.0, 1);
  for (auto& b : bearings) b.azimuth_rad += radians(4.0);
  SourceOptions options = with(SourceMethod::kMaximumLikelihood);
  const SourceFix without = locate(options, bearings);
  options.heading_bias_sigma_rad = radians(20.0);
  const SourceFix fix = locate(options, bearings);
  EXPECT_NEAR(fix.heading_bias_rad, radians(4.0), radians(0.01));
  EXPECT_LT((fix.position_m - Eigen::Vector3d(100.0, 150.0, 0.0)).norm(), 0.2);
  EXPECT_GT((without.position_m - Eigen::Vector3d(100.0, 150.0, 0.0)).norm(), 5.0);
}

TEST(SourceLocator, SaysWhatIsNotObservable) {
  auto still = drive({100.0, 150.0, 0.0}, Eigen::Vector3d::Zero(), 1.0, 3);
  for (auto& b : still) {
    b.azimuth_rad += std::atan2(350.0, 700.0) - std::atan2(150.0 - b.position_m[1], 100.0 - b.position_m[0]);
    b.position_m = {-600.0, -200.0, 0.0};
  }
  auto parallel = drive({100.0, 150.0, 0.0}, Eigen::Vector3d::Zero(), 1.0, 3);
  for (auto& b : parallel) b.azimuth_rad += 1.0 - std::atan2(150.0 - b.position_m[1], 100.0 - b.position_m[0]);
  for (const SourceMethod method : kMethods) {
    SourceOptions options = with(method);
    options.start_sigma_m = 1000.0;
    const SourceFix fix = locate(options, still);
    EXPECT_EQ(fix.status, SourceStatus::kUnobservable) << to_string(method) << fix.message();
    ASSERT_TRUE(fix.line.has_value()) << to_string(method);
    if (method > SourceMethod::kMaximumLikelihood) continue;
    EXPECT_NEAR(std::atan2(fix.line->direction[1], fix.line->direction[0]), std::atan2(350.0, 700.0), radians(1.0));
    EXPECT_NEAR(fix.line->sigma_rad, radians(1.0) / std::sqrt(80.0), 1e-9);
    EXPECT_NEAR((fix.line->point_m - Eigen::Vector3d(-600.0, -200.0, 0.0)).norm(), 0.0, 1e-9);
    EXPECT_FALSE(fix.position_m.allFinite());
    EXPECT_EQ(locate(with(method), parallel).status, SourceStatus::kUnobservable) << to_string(method);
  }
}

// Bearings from `places`, of `sigma` in each angle, errors `noise` times that.
std::vector<SourceBearing> taken(const std::vector<Eigen::Vector3d>& places, const Eigen::Vector3d& source,
                                 double sigma, std::uint64_t seed, double noise = 1.0) {
  RandomStream random(seed);
  std::vector<SourceBearing> out;
  for (const Eigen::Vector3d& p : places) {
    SourceBearing b;
    const Eigen::Vector3d to = source - p;
    b.t_s = static_cast<double>(out.size());
    b.position_m = p;
    b.sigma_azimuth_rad = b.sigma_elevation_rad = sigma;
    b.azimuth_rad = std::atan2(to[1], to[0]) + noise * sigma * random.normal();
    b.elevation_rad = std::atan2(to[2], std::hypot(to[0], to[1])) + noise * sigma * random.normal();
    out.push_back(b);
  }
  return out;
}

std::vector<Eigen::Vector3d> straight(const Eigen::Vector3d& from, const Eigen::Vector3d& to, std::size_t n) {
  std::vector<Eigen::Vector3d> out;
  for (std::size_t i = 0; i < n; ++i) {
    out.push_back(from + (to - from) * (static_cast<double>(i) / static_cast<double>(n - 1)));
  }
  return out;
}

TEST(SourceLocator, FindsByElevationWhatNeverTurnsInAzimuth) {
  const Eigen::Vector3d away(500.0, 0.0, 0.0);
  const Eigen::Vector3d above(500.0, 0.0, 60.0);
  const auto climb = taken(straight(Eigen::Vector3d::Zero(), {0.0, 0.0, 200.0}, 40), away, 0.01, 1);
  const auto towards = taken(straight(Eigen::Vector3d::Zero(), {400.0, 0.0, 0.0}, 40), above, 0.01, 2);
  for (const auto method : {SourceMethod::kStansfield, SourceMethod::kLeastSquares, SourceMethod::kMaximumLikelihood,
                            SourceMethod::kEkfBank}) {
    SourceOptions options;
    options.method = method;
    options.dimensions = 3;
    const SourceFix one = locate(options, climb);
    EXPECT_EQ(one.status, SourceStatus::kConverged) << to_string(method) << one.message();
    EXPECT_LT((one.position_m - away).norm(), 40.0) << to_string(method);
    const SourceFix two = locate(options, towards);
    EXPECT_EQ(two.status, SourceStatus::kConverged) << to_string(method) << two.message();
    EXPECT_LT((two.position_m - above).norm(), 12.0) << to_string(method);
  }
}

TEST(SourceLocator, ManyWeakBearingsAddUp) {
  const Eigen::Vector3d source(0.0, 1500.0, 0.0);
  int found = 0;
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    const auto bearings = taken(straight({-200.0, 0.0, 0.0}, {200.0, 0.0, 0.0}, 240), source, radians(8.0), seed);
    const SourceFix fix = locate(with(SourceMethod::kMaximumLikelihood), bearings);
    if (fix.status == SourceStatus::kConverged && (fix.position_m - source).norm() < 800.0) ++found;
    // Its lines are drawn to the platform, and it says nothing rather than that.
    EXPECT_NE(locate(with(SourceMethod::kLinear), bearings).status, SourceStatus::kConverged) << seed;
  }
  EXPECT_GE(found, 19);  // of range known to 12 %: chi-square about one direction let 14 of 20 pass
}

TEST(SourceLocator, AFarSourceHasNoRangeWhateverThePrior) {
  for (const SourceMethod method : kMethods) {
    SourceOptions options = with(method);
    options.start_m = std::nullopt;
    options.max_range_m = 8000.0;
    options.min_range_m = 80.0;
    int claimed = 0;
    for (std::uint64_t seed = 0; seed < 10; ++seed) {
      for (const double noise : {0.0, 1.0}) {
        const auto bearings =
            taken(straight(Eigen::Vector3d::Zero(), {400.0, 0.0, 0.0}, 40), {6e5, 8e5, 0.0}, radians(1.0), seed, noise);
        if (locate(options, bearings).status == SourceStatus::kConverged) ++claimed;
      }
    }
    EXPECT_LE(claimed, 1) << to_string(method);  // two tests at 1 %
  }
  // Outliers that make the directions differ leave the range to the prior all the same.
  auto bearings = taken(straight(Eigen::Vector3d::Zero(), {400.0, 0.0, 0.0}, 40), {6e5, 8e5, 0.0}, radians(1.0), 4);
  bearings[20].azimuth_rad += 2.0;
  SourceOptions options = with(SourceMethod::kParticle);
  options.start_m = std::nullopt;
  EXPECT_EQ(locate(options, bearings).status, SourceStatus::kUnobservable);
}

TEST(SourceLocator, NoMethodIsSureOfAWrongPlaceWhenDrivenOver) {
  const Eigen::Vector3d source(5.0, 0.0, 0.0);
  for (const SourceMethod method : kMethods) {
    for (std::uint64_t seed = 0; seed < 6; ++seed) {
      SourceOptions options = with(method);
      options.start_m = std::nullopt;
      const auto bearings =
          taken(straight({-100.0, 0.0, 0.0}, {100.0, 0.0, 0.0}, seed % 2 == 0 ? 41 : 40), source, 0.02, seed);
      const SourceFix fix = locate(options, bearings);
      EXPECT_NE(fix.status, SourceStatus::kConverged) << to_string(method) << seed << fix.message();
      if (method == SourceMethod::kMaximumLikelihood) {
        EXPECT_EQ(fix.status, SourceStatus::kOnPlatform) << seed << fix.message();
        EXPECT_LT((fix.position_m - source).norm(), 6.0) << seed;  // places are 5 m apart
      }
    }
  }
  // Four bearings from behind are no source there.
  const Eigen::Vector3d aside(100.0, 150.0, 0.0);
  auto burst = taken(straight({-300.0, 0.0, 0.0}, {300.0, 0.0, 0.0}, 80), aside, 0.02, 3);
  for (std::size_t i = 20; i < 24; ++i) burst[i].azimuth_rad += kPi;
  const SourceFix fix = locate(with(SourceMethod::kMaximumLikelihood), burst);
  EXPECT_EQ(fix.status, SourceStatus::kConverged) << fix.message();
  EXPECT_LT((fix.position_m - aside).norm(), 10.0);
}

TEST(SourceLocator, ABankIsHonestAboutAHeadingBias) {
  const Eigen::Vector3d source(0.0, 150.0, 0.0);
  const double sigma_bias = 0.2;
  RandomStream random(9);
  double nees = 0.0;
  constexpr int kRuns = 60;
  for (int run = 0; run < kRuns; ++run) {
    auto bearings = taken(straight({-500.0, 0.0, 0.0}, {500.0, 0.0, 0.0}, 100), source, 0.03,
                          static_cast<std::uint64_t>(100 + run));
    const double bias = sigma_bias * random.normal();
    for (SourceBearing& b : bearings) b.azimuth_rad += bias;
    SourceOptions options;
    options.method = SourceMethod::kEkfBank;
    options.heading_bias_sigma_rad = sigma_bias;
    const SourceFix fix = locate(options, bearings);
    const Eigen::Vector2d error = (fix.position_m - source).head<2>();
    nees += error.dot(fix.covariance_m2.topLeftCorner<2, 2>().inverse() * error) / kRuns;
  }
  EXPECT_LT(nees, 2.0 * (1.0 + 3.9 / std::sqrt(static_cast<double>(kRuns))));  // 930 without the pieces
}

TEST(SourceLocator, RefusesASigmaThatNoNumberHolds) {
  const auto good = drive({100.0, 150.0, 40.0}, Eigen::Vector3d::Zero(), 1.0, 4);
  for (const SourceMethod method : kMethods) {
    for (int which = 0; which < 3; ++which) {
      auto bearings = good;
      (which == 0   ? bearings[10].sigma_azimuth_rad
       : which == 1 ? bearings[10].sigma_elevation_rad
                    : bearings[10].heading_sigma_rad) = 1e200;
      const SourceFix fix = locate(with(method, 3), bearings);
      EXPECT_EQ(fix.rejected, 1U) << to_string(method) << which;
      EXPECT_EQ(fix.status, SourceStatus::kConverged) << to_string(method) << which << fix.message();
    }
  }
}

TEST(SourceLocator, SaysWhatIsWrongWithTheBearings) {
  const auto good = drive({100.0, 150.0, 0.0}, Eigen::Vector3d::Zero(), 1.0, 4);
  for (const SourceMethod method : kMethods) {
    auto bearings = good;
    bearings[10].azimuth_rad = kNan;
    bearings[20].sigma_azimuth_rad = 0.0;
    bearings[30].position_m[0] = std::numeric_limits<double>::infinity();
    bearings[40].position_covariance_m2(0, 0) = -1.0;
    const SourceFix fix = locate(with(method), bearings);
    EXPECT_EQ(fix.used, 76U) << to_string(method);
    EXPECT_EQ(fix.rejected, 4U);
    EXPECT_TRUE(fix.position_m.allFinite()) << to_string(method);
    EXPECT_EQ(locate(with(method), {}).status, SourceStatus::kTooFewBearings);
  }
  SourceLocator one(with(SourceMethod::kMaximumLikelihood));
  EXPECT_EQ(one.step(good[0]).status, SourceStatus::kTooFewBearings);
  EXPECT_TRUE(one.step(good[0]).line.has_value());
  // Half of the bearings point elsewhere.
  auto contrary = good;
  for (std::size_t i = 0; i < contrary.size(); i += 2) contrary[i].azimuth_rad += 2.0;
  for (const auto method : {SourceMethod::kStansfield, SourceMethod::kLeastSquares, SourceMethod::kMaximumLikelihood}) {
    EXPECT_EQ(locate(with(method), contrary).status, SourceStatus::kInconsistent) << to_string(method);
  }
  // A few do: the likelihood's floor leaves them out, least squares says no.
  auto some = good;
  for (std::size_t i = 3; i < some.size(); i += 20) some[i].azimuth_rad += 2.0;
  const SourceFix robust = locate(with(SourceMethod::kMaximumLikelihood), some);
  EXPECT_EQ(robust.status, SourceStatus::kConverged);
  EXPECT_EQ(robust.outliers, 4U);
  EXPECT_LT((robust.position_m - Eigen::Vector3d(100.0, 150.0, 0.0)).norm(), 10.0);
  EXPECT_EQ(locate(with(SourceMethod::kLeastSquares), some).status, SourceStatus::kInconsistent);
}

TEST(SourceLocator, SaysWhenTheSourceIsOnThePlatform) {
  auto bearings = drive({100.0, 150.0, 0.0}, Eigen::Vector3d::Zero(), 1.0, 5);
  bearings.back().position_m = {100.0, 150.0, 0.0};
  bearings.back().azimuth_rad = 0.3;
  for (const auto method : {SourceMethod::kStansfield, SourceMethod::kLeastSquares, SourceMethod::kMaximumLikelihood}) {
    const SourceFix fix = locate(with(method), bearings);
    EXPECT_TRUE(fix.status == SourceStatus::kOnPlatform || fix.status == SourceStatus::kInconsistent)
        << to_string(method) << fix.message();
    EXPECT_TRUE(fix.position_m.allFinite());
  }
}

TEST(SourceLocator, AnInexactPlatformWidensTheCovariance) {
  auto bearings = drive({100.0, 150.0, 0.0}, Eigen::Vector3d::Zero(), 1.0, 6);
  for (const SourceMethod method : kMethods) {
    if (method == SourceMethod::kCentroid || method == SourceMethod::kIncenter) continue;
    const double before = locate(with(method), bearings).covariance_m2.trace();
    auto rough = bearings;
    for (auto& b : rough) b.position_covariance_m2.topLeftCorner<2, 2>().diagonal().setConstant(400.0);
    EXPECT_GT(locate(with(method), rough).covariance_m2.trace(), 2.0 * before) << to_string(method);
  }
}

TEST(SourceLocator, RefusesOptions) {
  const auto refused = [](auto change, const char* name) {
    SourceOptions o;
    change(o);
    try {
      const SourceLocator locator(o);
      ADD_FAILURE() << name;
    } catch (const std::invalid_argument& error) {
      EXPECT_NE(std::string(error.what()).find(name), std::string::npos) << error.what();
    }
  };
  refused([](SourceOptions& o) { o.dimensions = 4; }, "dimensions");
  refused([](SourceOptions& o) { o.start_m = Eigen::Vector3d(kNan, 0.0, 0.0); }, "start_m");
  refused([](SourceOptions& o) { o.start_sigma_m = 0.0; }, "start_sigma_m");
  refused([](SourceOptions& o) { o.max_range_m = 10.0; }, "max_range_m");
  refused([](SourceOptions& o) { o.outlier_probability = 1.0; }, "outlier_probability");
  refused([](SourceOptions& o) { o.particles = 3; }, "particles");
  refused([](SourceOptions& o) { o.grid_size = 7; }, "grid_size");
  refused([](SourceOptions& o) { o.filters = 1; }, "filters");
  refused([](SourceOptions& o) { o.max_bearings = 2; }, "max_bearings");
  refused([](SourceOptions& o) { o.false_alarm_probability = kNan; }, "false_alarm_probability");
  refused(
      [](SourceOptions& o) {
        o.method = SourceMethod::kStansfield;
        o.motion = SourceMotion::kConstantVelocity;
      },
      "motion");
}

TEST(SourceLocator, StepsWithoutTheHeapAndRepeatsItself) {
  const auto bearings = drive({100.0, 150.0, 40.0}, Eigen::Vector3d::Zero(), 1.0, 7, 60);
  for (const int dimensions : {2, 3}) {
    for (const SourceMethod method : kMethods) {
      SourceOptions options = with(method, dimensions);
      options.max_bearings = 40;  // also while old ones are dropped
      options.grid_size = 16;
      SourceLocator locator(options);
      SourceFix last;
      const auto run = [&] {
        for (const SourceBearing& b : bearings) last = locator.step(b);
      };
      if (test::kAllocationsCounted) {
        EXPECT_EQ(test::allocations_of(run), 0) << to_string(method);
      } else {
        run();
      }
      const Eigen::Vector3d first = last.position_m;
      locator.reset(options.start_m, options.seed);
      run();
      EXPECT_EQ(first, last.position_m) << to_string(method);
    }
  }
}

TEST(SourceTracks, AssignsAtLeastCost) {
  RandomStream random(8);
  for (int trial = 0; trial < 200; ++trial) {
    const std::size_t rows = 1 + random.next_u32() % 5;
    const std::size_t columns = rows + random.next_u32() % 3;
    std::vector<double> cost(rows * columns);
    for (double& c : cost) c = random.uniform(-3.0, 5.0);
    std::vector<std::size_t> chosen(rows);
    assign(cost, rows, columns, chosen);
    double got = 0.0;
    for (std::size_t i = 0; i < rows; ++i) got += cost[i * columns + chosen[i]];
    std::vector<std::size_t> order(columns);
    std::iota(order.begin(), order.end(), 0U);
    double best = std::numeric_limits<double>::infinity();
    do {
      double sum = 0.0;
      for (std::size_t i = 0; i < rows; ++i) sum += cost[i * columns + order[i]];
      best = std::min(best, sum);
    } while (std::next_permutation(order.begin(), order.end()));
    ASSERT_NEAR(got, best, 1e-12);
  }
}

TEST(SourceTracks, FollowsTwoSourcesThroughFalseBearings) {
  const Eigen::Vector3d one(100.0, 150.0, 0.0);
  const Eigen::Vector3d two(300.0, -350.0, 0.0);
  const auto first = drive(one, Eigen::Vector3d::Zero(), 1.0, 9);
  const auto second = drive(two, Eigen::Vector3d::Zero(), 1.0, 10);
  SourceTrackOptions options;
  SourceTracks tracks(options);
  RandomStream random(11);
  long allocations = 0;
  for (std::size_t i = 0; i < first.size(); ++i) {
    std::vector<SourceBearing> scan = {second[i], first[i]};
    if (i % 3 == 0) scan.pop_back();  // one is not heard now and then
    if (i % 4 == 0) {
      scan.push_back(first[i]);
      scan.back().azimuth_rad = random.uniform(-kPi, kPi);
    }
    if (i % 7 == 0) scan[0].azimuth_rad = kNan;
    allocations += test::allocations_of([&] { tracks.step(scan); });
  }
  EXPECT_EQ(allocations, 0);
  std::vector<SourceTrack> confirmed;
  for (const auto& t : tracks.tracks()) {
    if (t.state == TrackState::kConfirmed) confirmed.push_back(t);
  }
  ASSERT_EQ(confirmed.size(), 2U);
  for (const Eigen::Vector3d& source : {one, two}) {
    EXPECT_TRUE(std::any_of(confirmed.begin(), confirmed.end(),
                            [&](const SourceTrack& t) { return (t.fix.position_m - source).norm() < 15.0; }));
  }
  // Silence ends a track.
  for (int i = 0; i < options.drop_misses + 1; ++i) tracks.step({});
  EXPECT_TRUE(tracks.tracks().empty());
  SourceTrackOptions bad;
  bad.clutter_density_per_rad = 0.0;
  EXPECT_THROW(SourceTracks{bad}, std::invalid_argument);
}

TEST(SourceCrlb, IsTheInverseOfTheInformation) {
  const Eigen::Vector3d source(100.0, 150.0, 40.0);
  const auto bearings = drive(source, Eigen::Vector3d::Zero(), 0.0, 1, 30);
  Eigen::Matrix2d J = Eigen::Matrix2d::Zero();
  const auto bounds = source_crlb(bearings, source, Eigen::Vector3d::Zero(), {});
  for (std::size_t i = 0; i < bearings.size(); ++i) {
    const Eigen::Vector2d d = (source - bearings[i].position_m).head<2>();
    const Eigen::Vector2d h = Eigen::Vector2d(-d[1], d[0]) / d.squaredNorm() / bearings[i].sigma_azimuth_rad;
    J += h * h.transpose();
    if (i == 0) {
      EXPECT_TRUE(std::isinf(bounds[0](0, 0)));
    } else {
      EXPECT_LT((bounds[i] * J - Eigen::Matrix2d::Identity()).norm(), 1e-6) << i;
    }
  }
  // A velocity to be known as well, and noise that moves the source, cost accuracy.
  SourceBoundOptions moving;
  moving.motion = SourceMotion::kConstantVelocity;
  const auto rest = source_crlb(bearings, source, Eigen::Vector3d::Zero(), moving);
  moving.acceleration_psd = 1.0;
  const auto pushed = source_crlb(bearings, source, Eigen::Vector3d::Zero(), moving);
  EXPECT_GT(rest.back()(0, 0), 1.5 * bounds.back()(0, 0));
  EXPECT_GT(pushed.back()(0, 0), 1.2 * rest.back()(0, 0));
  // What a locator leaves out tells nothing.
  auto fewer = bearings;
  fewer.resize(28);
  auto spoilt = bearings;
  spoilt[28].sigma_azimuth_rad = -0.01;
  spoilt[29].position_covariance_m2(0, 0) = -1.0;
  EXPECT_EQ(source_crlb(spoilt, source, Eigen::Vector3d::Zero(), {}).back(),
            source_crlb(fewer, source, Eigen::Vector3d::Zero(), {}).back());
  SourceBoundOptions bad;
  bad.start_sigma_m = -1.0;
  EXPECT_THROW(source_crlb(bearings, source, Eigen::Vector3d::Zero(), bad), std::invalid_argument);
}

}  // namespace
}  // namespace soopnav::navigation
