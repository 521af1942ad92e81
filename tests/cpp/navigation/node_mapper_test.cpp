#include "soopnav/navigation/node_mapper.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::navigation {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// 60 s of a walk 24 m across among nodes some 18 m away; the odometry drifts when asked to.
struct Walk {
  std::vector<double> t;
  std::vector<Vector3d> measured;
  std::vector<Vector2d> truth;
  std::vector<Vector2d> nodes;
  std::vector<double> offset, ranges, heights;
  double sigma = 1.0;

  Walk(std::size_t epochs, std::size_t links, std::uint64_t seed, double noise, double heading, double step,
       double clock_step, bool straight = false)
      : sigma(noise) {
    RandomStream random(seed);
    const double dt = 60.0 / static_cast<double>(epochs);
    double turn = 0.0, clock = 321.0;
    for (std::size_t l = 0; l < links; ++l) {
      double a = 2.0 * kPi * (static_cast<double>(l) + 0.6 * random.uniform()) / static_cast<double>(links) + 0.5;
      if (straight) a = l == 0 ? 0.9 : l == 1 ? 2.1 : -0.8;  // none in line with the walk
      nodes.emplace_back(18.0 * std::cos(a), 18.0 * std::sin(a));
      offset.push_back(l == 0 ? 0.0 : random.uniform(-900.0, 900.0));
      heights.push_back(0.0);
    }
    for (std::size_t k = 0; k < epochs; ++k) {
      const double u = 2.0 * kPi * static_cast<double>(k) / static_cast<double>(epochs);
      truth.emplace_back(straight ? Vector2d(-12.0 + 24.0 * u / (2.0 * kPi), 0.0)
                                  : Vector2d(12.0 * std::sin(2.0 * u), 12.0 * std::sin(3.0 * u + 0.5)));
      t.push_back(dt * static_cast<double>(k));
      if (k == 0) {
        measured.emplace_back(truth[0].x(), truth[0].y(), 0.0);
      } else {
        Vector2d d = truth[k] - truth[k - 1];
        d -= step * std::sqrt(dt) * Vector2d(random.normal(), random.normal());
        const double c = std::cos(turn), s = std::sin(turn);
        const Vector3d& before = measured.back();
        measured.emplace_back(before.x() + c * d.x() + s * d.y(), before.y() - s * d.x() + c * d.y(), 0.0);
        turn += heading * std::sqrt(dt) * random.normal();
        clock += clock_step * std::sqrt(dt) * random.normal();
      }
      for (std::size_t l = 0; l < links; ++l) {
        ranges.push_back((truth[k] - nodes[l]).norm() + clock + offset[l] + noise * random.normal());
      }
    }
  }

  [[nodiscard]] NodeMap locate(const NodeMapperOptions& o) const {
    const std::vector<double> s{sigma};
    return NodeMapper(o).locate(t, measured, ranges, s, heights);
  }
};

TEST(NodeMapper, ExactRangesGiveExactPlaces) {
  for (const ClockMotion clock : {ClockMotion::kRandomWalk, ClockMotion::kFree}) {
    const Walk walk(120, 4, 3, 1e-6, 0.0, 0.0, 0.2);
    NodeMapperOptions o;
    o.clock = clock;
    const NodeMap map = walk.locate(o);
    for (std::size_t l = 0; l < 4; ++l) {
      EXPECT_NEAR((map.position_m[l] - walk.nodes[l]).norm(), 0.0, 2e-3);
      EXPECT_NEAR(map.offset_m[l], walk.offset[l], 2e-3);
      EXPECT_FALSE(map.mirrored[l]);
    }
    EXPECT_EQ(map.undetermined, 0);
  }
}

TEST(NodeMapper, ErrorsAreThoseOfTheCovarianceDriftIncluded) {
  double nees = 0.0, square = 0.0;
  const int runs = 20;
  for (int run = 0; run < runs; ++run) {
    const Walk walk(240, 4, static_cast<std::uint64_t>(100 + run), 1.0, 0.0016, 0.0045, 0.2);
    NodeMapperOptions o;
    o.track_m_per_sqrt_s = 0.0045;
    o.heading_rad_per_sqrt_s = 0.0016;
    const NodeMap map = walk.locate(o);
    ASSERT_EQ(map.status, NodeMapStatus::kOk);
    Eigen::VectorXd e(8);
    for (std::size_t l = 0; l < 4; ++l)
      e.segment<2>(static_cast<Eigen::Index>(2 * l)) = map.position_m[l] - walk.nodes[l];
    nees += e.dot(map.covariance_m2.llt().solve(e));
    square += e.squaredNorm() / 4.0 / runs;
  }
  // chi-square with 160 degrees over 160: 1 +- 0.11; five times, and some per cent for the ranges' curvature.
  EXPECT_GT(nees / (8.0 * runs), 0.45);
  EXPECT_LT(nees / (8.0 * runs), 1.65);
  EXPECT_LT(std::sqrt(square), 1.2);
}

TEST(NodeMapper, AStraightWalkNamesBothSides) {
  const Walk walk(240, 3, 8, 0.3, 0.0, 0.0, 0.1, true);
  NodeMapperOptions o;
  o.clock_m_per_sqrt_s = 0.1;
  const NodeMap map = walk.locate(o);
  for (std::size_t l = 0; l < 3; ++l) {
    ASSERT_TRUE(map.mirrored[l]) << l;
    const double near = std::min((map.position_m[l] - walk.nodes[l]).norm(), (map.mirror_m[l] - walk.nodes[l]).norm());
    EXPECT_LT(near, 5.0 * std::sqrt(map.covariance_m2.diagonal().segment<2>(static_cast<Eigen::Index>(2 * l)).sum()));
    EXPECT_LT(map.position_m[l].y() * map.mirror_m[l].y(), 0.0);
  }
}

TEST(NodeMapper, TooFewPoorAndUnheard) {
  Walk walk(60, 3, 5, 0.5, 0.0, 0.0, 0.2);
  NodeMapperOptions o;
  for (std::size_t k = 0; k < 60; ++k) walk.ranges[3 * k + 1] = k % 30 == 0 ? 7.0 : kNan;  // twice heard
  NodeMap map = walk.locate(o);
  EXPECT_TRUE(std::isnan(map.position_m[1].x()));
  EXPECT_TRUE(std::isfinite(map.position_m[2].x()));
  o.clock = ClockMotion::kFree;
  EXPECT_EQ(walk.locate(o).status, NodeMapStatus::kTooFew);
  o.clock = ClockMotion::kRandomWalk;
  for (std::size_t k = 30; k < 60; ++k) walk.ranges[3 * k] += 15.0;  // a sight that shuts
  EXPECT_EQ(walk.locate(o).status, NodeMapStatus::kPoorFit);
  walk.ranges.assign(walk.ranges.size(), kNan);
  EXPECT_EQ(walk.locate(o).status, NodeMapStatus::kTooFew);
}

TEST(NodeMapper, SetUpIsRefused) {
  const Walk walk(10, 2, 1, 1.0, 0.0, 0.0, 0.1);
  const NodeMapper mapper{NodeMapperOptions{}};
  const std::vector<double> one{1.0}, none{-1.0}, two{1.0, 1.0};
  auto late = walk.t;
  late[4] = late[3];
  const auto call = [&](const auto& t, const auto& z, const auto& s) {
    static_cast<void>(mapper.locate(t, walk.measured, z, s, walk.heights));
  };
  EXPECT_THROW(call(late, walk.ranges, one), std::invalid_argument);
  EXPECT_THROW(call(walk.t, two, one), std::invalid_argument);
  EXPECT_THROW(call(walk.t, walk.ranges, none), std::invalid_argument);
  EXPECT_THROW(call(walk.t, walk.ranges, two), std::invalid_argument);
  NodeMapperOptions o;
  o.clock_m_per_sqrt_s = kNan;
  EXPECT_THROW(NodeMapper{o}, std::invalid_argument);
  o = {};
  o.starts = 0;
  EXPECT_THROW(NodeMapper{o}, std::invalid_argument);
}

TEST(NodeStart, FindsANodeAndItsMirrorWithoutHeap) {
  const Walk walk(100, 1, 2, 0.1, 0.0, 0.0, 0.0);
  std::vector<Vector2d> places = walk.truth;
  std::vector<double> z = walk.ranges;
  z[7] = kNan;
  const NodeStart s = start_node(places, z, 0.1, 100.0);
  ASSERT_TRUE(s.ok);
  const Vector2d e = s.position_m - walk.nodes[0];
  EXPECT_LT(e.dot(s.covariance.topLeftCorner<2, 2>().llt().solve(e)), 25.0);
  EXPECT_NEAR(s.offset_m, 321.0, 5.0 * std::sqrt(s.covariance(2, 2)));
  EXPECT_GT(s.mirror_cost, s.cost + 20.0);  // a walk with two dimensions tells the side
  EXPECT_FALSE(start_node(std::span(places).first(3), std::span(z).first(3), 0.1, 100.0).ok);
  EXPECT_FALSE(start_node(places, z, kNan, 100.0).ok);
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  EXPECT_EQ(test::allocations_of([&] { static_cast<void>(start_node(places, z, 0.1, 100.0)); }), 0);
}

}  // namespace
}  // namespace soopnav::navigation
