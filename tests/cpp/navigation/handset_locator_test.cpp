#include "soopnav/navigation/handset_locator.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "navigation/handset_walk.hpp"
#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/simulation/handset_world.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::navigation {
namespace {

using simulation::HandsetWorld;
using simulation::HandsetWorldOptions;
using namespace walks;

TEST(HandsetLocator, BothTypesFindTheHandsetAndTheLinks) {
  double alone = 0.0, both = 0.0;
  for (const std::uint64_t seed : {1u, 2u}) {
    const HandsetWorld w = walk(seed);
    HandsetOptions o = start_of(w);
    HandsetLocator one(o);
    const Played first = play(one, w);
    o.filter = HandsetFilter::kMeasurement;
    o.particles = 100;
    HandsetLocator two(o);
    const Played second = play(two, w);
    HandsetOptions lte = HandsetOptions::lte_alone(w.nodes_m);
    lte.acceleration_psd_m2ps3 = 0.1;
    HandsetLocator without(lte);
    alone += play(without, w, 15.0, false).rms_m;
    both += first.rms_m;
    for (const Played& p : {first, second}) {
      EXPECT_LT(p.rms_m, 0.6);
      EXPECT_GT(p.right, 0.97);
      EXPECT_LT(p.nees, 12.0);
      EXPECT_EQ(p.last.status, HandsetStatus::kTracking);
      EXPECT_LT(std::abs(p.last.clock_m - w.clock_m.back()), 1.0);
      EXPECT_LT(std::abs(wrap_to_pi(p.last.heading_rad - w.pose.back()[2])), 0.1);
    }
  }
  EXPECT_GT(alone, 5.0 * both);
}

// A frame turned and moved changes nothing but the frame.
TEST(HandsetLocatorLaw, TurnedAndMovedFrame) {
  const HandsetWorld w = walk(3, 6.0);
  const double turn = 1.1;
  const Eigen::Vector2d shift(300.0, -120.0);
  const Eigen::Rotation2Dd R(turn);
  HandsetOptions o = start_of(w, 64);
  HandsetOptions turned = o;
  turned.start_m = R * o.start_m + shift;
  turned.start_heading_rad += turn;
  // One Gaussian each, so that no draw is in another place: the filters are the same but for the frame.
  for (HandsetOptions* each : {&o, &turned}) {
    each->particles = 1;
    each->kernel = 1.0;
    each->kernel_m = 10.0;
    each->kernel_rad = 1.0;
    each->nlos = false;
    each->outlier_probability = 0.0;
  }
  for (Eigen::Vector3d& q : turned.nodes_m) q.head<2>() = R * Eigen::Vector2d(q.head<2>()) + shift;
  HandsetLocator a(o), b(turned);
  const auto nothing = [](std::size_t, std::vector<double>&) {};
  const HandsetEstimate x = play(a, w, 0.0, true, 0.01, nothing).last, y = play(b, w, 0.0, true, 0.01, nothing).last;
  EXPECT_LT((y.position_m - (R * x.position_m + shift)).norm(), 1e-6);
  EXPECT_LT(std::abs(wrap_to_pi(y.heading_rad - x.heading_rad - turn)), 1e-8);
  const Eigen::Matrix2d C = R * x.covariance_m2 * R.toRotationMatrix().transpose();
  EXPECT_LT((y.covariance_m2 - C).cwiseAbs().maxCoeff(), 1e-6);
  EXPECT_NEAR(y.clock_m, x.clock_m, 1e-6);
}

TEST(HandsetLocatorLaw, StepsAreInTheAxesOfThePreviousBody) {
  HandsetOptions o;
  o.nodes_m = {{40.0, 0.0, 0.0}};
  o.particles = 1;
  o.start_sigma_m = 0.01;
  o.start_heading_rad = kPi / 2.0;  // first axis along y
  o.start_heading_sigma_rad = 1e-3;
  HandsetLocator f(o);
  ASSERT_EQ(f.move(step_of({1.0, 0.0, 0.0}), 0.1).use, HandsetUse::kUsed);
  const HandsetEstimate before = f.estimate();
  ASSERT_EQ(f.move(step_of({1.0, 0.5, -kPi / 2.0}), 0.2).use, HandsetUse::kUsed);
  ASSERT_EQ(f.move(step_of({1.0, 0.0, 0.0}), 0.3).use, HandsetUse::kUsed);
  const Eigen::Vector2d way = f.estimate().position_m - before.position_m;
  EXPECT_NEAR(way[0], -0.5 + 1.0, 0.02);
  EXPECT_NEAR(way[1], 1.0, 0.02);
  EXPECT_NEAR(wrap_to_pi(f.estimate().heading_rad - before.heading_rad), -kPi / 2.0, 1e-9);
}

// Foot points' noise does not add up: what the increments say together is the last minus the first (eq. 4). Taken as
// independent it grows without bound and, with ranges too poor to notice, the covariance is far too large.
TEST(HandsetLocatorConsistency, FootNoiseTelescopes) {
  constexpr double kFoot = 0.03;
  double nees = 0.0, second_nees = 0.0, independent = 0.0, claimed = 0.0;
  constexpr int kRuns = 24;
  for (std::uint64_t seed = 1; seed <= kRuns; ++seed) {
    const HandsetWorld w = walk(seed, 25.0, kFoot);
    HandsetOptions o;
    o.nodes_m = w.nodes_m;
    o.particles = 1;
    o.start_m = w.pose[0].head<2>();
    o.start_sigma_m = 0.01;
    o.start_heading_rad = w.pose[0][2];
    o.start_heading_sigma_rad = 1e-4;
    RandomStream draw(seed, 9);
    o.start_m += 0.01 * Eigen::Vector2d(draw.normal(), draw.normal());
    HandsetLocator right(o), wrong(o);
    o.filter = HandsetFilter::kMeasurement;
    HandsetLocator second(o);
    for (std::size_t k = 0; k < w.increment.size(); ++k) {
      HandsetMotion m = step_of(w.increment[k], kFoot);
      m.track_covariance.diagonal() << 4e-8, 4e-8, 1.2184e-7;
      (void)right.move(m, w.frame_s[k + 1]);
      if (k == 0) (void)second.coast(w.frame_s[0]);
      (void)second.move(m, w.frame_s[k + 1]);
      m.track_covariance.topLeftCorner<2, 2>() += 2.0 * m.foot_covariance;
      m.foot_covariance.setZero();
      m.foot_covariance_previous.setZero();
      (void)wrong.move(m, w.frame_s[k + 1]);
    }
    const Eigen::Vector2d truth = w.pose.back().head<2>();
    const HandsetEstimate x = right.estimate(), y = wrong.estimate(), z = second.estimate();
    const Eigen::Vector2d d = x.position_m - truth, e = y.position_m - truth, f = z.position_m - truth;
    second_nees += soopnav::nees(f, z.covariance_m2).value() / kRuns;
    nees += soopnav::nees(d, x.covariance_m2).value() / kRuns;
    independent += soopnav::nees(e, y.covariance_m2).value() / kRuns;
    claimed += std::sqrt(x.covariance_m2.trace()) / kRuns;
  }
  // Mean of 24 chi-squares of 2 degrees: 0.9 ... 3.9 holds with 1 - 1e-4.
  EXPECT_GT(nees, 0.9);
  EXPECT_LT(nees, 3.9);
  EXPECT_GT(second_nees, 0.9);
  EXPECT_LT(second_nees, 3.9);
  EXPECT_LT(independent, 0.2);
  EXPECT_LT(claimed, 0.25);
}

// Ranges whose errors hang together over metres of walking (eq. 8), from a clock and a pose that are known: the filter
// that is told so is right about itself, the one that takes them for white noise is not.
TEST(HandsetLocatorConsistency, MultipathThatHangsTogether) {
  constexpr double kSigma = 1.0, kLength = 5.0;
  constexpr int kRuns = 24;
  for (const HandsetFilter kind : {HandsetFilter::kControl, HandsetFilter::kMeasurement}) {
    double nees = 0.0, white = 0.0;
    for (std::uint64_t seed = 1; seed <= kRuns; ++seed) {
      const HandsetWorld w = walk(seed, 12.0);
      const std::size_t L = w.nodes_m.size();
      RandomStream draw(seed, 5);
      std::vector<double> late(L);
      for (double& m : late) m = kSigma * draw.normal();
      Eigen::Vector2d before = w.position_m[0];
      const auto change = [&](std::size_t e, std::vector<double>& z) {
        const double kept = std::exp(-(w.position_m[e] - before).norm() / kLength);
        before = w.position_m[e];
        for (std::size_t l = 0; l < L; ++l) {
          late[l] = kept * late[l] + kSigma * std::sqrt(1.0 - kept * kept) * draw.normal();
          z[l] += late[l] - w.nlos.excess_m[e * L + l];
        }
      };
      HandsetOptions o = start_of(w, 1);
      o.filter = kind;
      o.kernel = 1.0;
      o.kernel_m = 10.0;
      o.nlos = false;
      o.outlier_probability = 0.0;
      o.start_m = w.pose[0].head<2>() + Eigen::Vector2d(draw.normal(), draw.normal());
      o.start_sigma_m = 1.0;
      o.start_heading_rad = w.pose[0][2] + 0.1 * draw.normal();
      const RandomStream here = draw;
      HandsetLocator plain(o);
      white += play(plain, w, 11.0, true, 0.0, change).nees / kRuns;
      draw = here;
      late.assign(L, 0.0);
      for (double& m : late) m = kSigma * draw.normal();
      before = w.position_m[0];
      o.multipath_sigma_m = kSigma;
      o.multipath_length_m = kLength;
      HandsetLocator told(o);
      EXPECT_EQ(told.dimension(), plain.dimension() + 6);
      nees += play(told, w, 11.0, true, 0.0, change).nees / kRuns;
    }
    // Mean of 24 chi-squares of 2 degrees: 0.9 ... 3.9 holds with 1 - 1e-4.
    EXPECT_GT(nees, 0.9);
    EXPECT_LT(nees, 3.9);
    EXPECT_GT(white, 3.9);
  }
}

// A handset that stands still learns no more from the thousandth range than from the first: what multipath does to it
// stays. One that has walked far begins anew.
TEST(HandsetLocator, MultipathStaysWhileTheHandsetDoes) {
  HandsetOptions o;
  o.nodes_m = {{0.0, 0.0, 0.0}, {40.0, 0.0, 0.0}};
  o.particles = 1;
  o.kernel = 1.0;
  o.kernel_m = 10.0;
  o.nlos = false;
  o.start_m = {20.0, 0.0};
  o.start_sigma_m = 5.0;
  o.start_heading_sigma_rad = 1e-3;
  o.outlier_probability = 0.0;
  o.multipath_sigma_m = 2.0;
  o.multipath_length_m = 3.0;
  HandsetLocator f(o);
  const std::vector<double> z(2, 20.0), sigma(2, 0.1);
  HandsetMotion still = step_of({0.0, 0.0, 0.0});
  still.track_covariance.diagonal().setConstant(1e-12);
  double t = 0.0;
  const auto stand = [&](int epochs) {
    for (int k = 0; k < epochs; ++k) {
      t += 0.05;
      ASSERT_EQ(f.move(still, t).use, HandsetUse::kUsed);
      ASSERT_EQ(f.update_ranges(z, sigma, t).use, HandsetUse::kUsed);
    }
  };
  // Half of the difference of two ranges, each off by 2 m: sigma 2 / sqrt(2) against the start's 5 m.
  const double expected = 1.0 / (1.0 / 25.0 + 1.0 / 2.0);
  stand(1000);
  EXPECT_NEAR(f.estimate().covariance_m2(0, 0), expected, 0.02 * expected);
  // To and fro across, 60 m in all: an error as good as new.
  HandsetMotion across = still;
  for (int k = 0; k < 60; ++k) {
    across.increment[1] = k % 2 == 0 ? 1.0 : -1.0;
    t += 0.05;
    ASSERT_EQ(f.move(across, t).use, HandsetUse::kUsed);
  }
  stand(1);
  EXPECT_NEAR(f.estimate().covariance_m2(0, 0), 1.0 / (1.0 / expected + 1.0 / 2.0), 0.03 * expected);
  // Without a camera for so long that it may have gone anywhere, multipath included.
  const double before = f.estimate().covariance_m2(0, 0);
  ASSERT_EQ(f.update_ranges(z, sigma, t + 100.0).use, HandsetUse::kUsed);
  EXPECT_GT(f.estimate().covariance_m2(0, 0), before);
}

TEST(HandsetLocator, SeparateClocksOffsetsDriftAndUnknownPlaces) {
  HandsetWorld w = walk(5, 30.0);
  const std::size_t L = w.nodes_m.size();
  std::array<double, 6> own{};
  RandomStream draw(5, 1);
  for (double& o : own) o = 30.0 * draw.normal();
  const auto late = [&](std::size_t e, std::vector<double>& z) {
    for (std::size_t l = 0; l < L; ++l) {
      z[l] += own[l] - w.nlos.excess_m[e * L + l] + 0.02 * static_cast<double>(e);  // 0.2 m/s of drift
    }
  };
  HandsetOptions o = start_of(w, 1);
  o.kernel = 1.0;
  o.kernel_m = 3.0;
  o.nlos = false;
  o.start_m = w.pose[0].head<2>();
  o.start_sigma_m = 0.5;
  o.node_offset_sigma_m = 50.0;
  o.clock_drift_sigma_mps = 1.0;
  HandsetLocator offsets(o);
  EXPECT_EQ(offsets.dimension(), 3 + 2 + 6 + 2);
  const Played a = play(offsets, w, 20.0, true, 0.0, late);
  EXPECT_LT(a.rms_m, 1.5);
  // Offsets are known up to what all share, which the clock takes.
  for (std::size_t l = 1; l < L; ++l) EXPECT_NEAR(a.last.offset_m[l] - a.last.offset_m[0], own[l] - own[0], 2.5);
  o.clock = HandsetClock::kSeparate;
  o.node_offset_sigma_m = 0.0;
  HandsetLocator separate(o);
  EXPECT_EQ(separate.dimension(), 3 + 12 + 2);
  const Played b = play(separate, w, 20.0, true, 0.0, late);
  EXPECT_LT(b.rms_m, 1.5);
  for (std::size_t l = 1; l < L; ++l) EXPECT_NEAR(b.last.offset_m[l] - b.last.offset_m[0], own[l] - own[0], 2.5);
  // A node 3 m beside where it is said to be.
  HandsetOptions p = start_of(w, 1);
  p.kernel = 1.0;
  p.nlos = false;
  p.start_m = w.pose[0].head<2>();
  p.start_sigma_m = 0.5;
  p.nodes_m[2] += Eigen::Vector3d(2.0, -2.2, 0.0);
  p.node_sigma_m = {0.0, 0.0, 3.0, 0.0, 0.0, 0.0};
  HandsetLocator places(p);
  const Played c = play(places, w, 20.0, true, 0.0, [&](std::size_t e, std::vector<double>& z) {
    for (std::size_t l = 0; l < L; ++l) z[l] -= w.nlos.excess_m[e * L + l];
  });
  EXPECT_LT(c.rms_m, 0.8);
  const Eigen::Vector2d off = c.last.node_m[2] - w.nodes_m[2].head<2>();
  const Eigen::Vector2d line = w.nodes_m[2].head<2>().normalized();
  EXPECT_LT(std::abs(off.dot(line)), 1.0);  // along the line of sight; across it a room says little
  EXPECT_LT(c.last.node_sigma_m[2], 3.0);
}

TEST(HandsetLocator, BearingsOfTheBodyTellTheHeading) {
  const HandsetWorld w = walk(7, 6.0);
  const std::size_t L = w.nodes_m.size();
  HandsetOptions o = start_of(w, 500);
  o.start_heading_sigma_rad = 3.2;  // unknown
  o.nlos = false;
  HandsetLocator f(o), mirrored(o);
  std::vector<double> z(L), other(L), ranges(L);
  const std::vector<double> sigma(L, 0.02), range_sigma(L, 1.0);
  RandomStream draw(7, 2);
  for (int k = 0; k < 8; ++k) {
    const double t = 0.1 * k;
    for (std::size_t l = 0; l < L; ++l) {
      const Eigen::Vector2d to = w.nodes_m[l].head<2>() - w.pose[0].head<2>();
      z[l] = std::atan2(to[1], to[0]) - w.pose[0][2] + 0.02 * draw.normal();
      other[l] = wrap_to_pi(-z[l]);
      ranges[l] = to.norm() + 3.0 + draw.normal();
    }
    ASSERT_EQ(f.update_ranges(ranges, range_sigma, t).use, HandsetUse::kUsed);
    ASSERT_EQ(mirrored.update_ranges(ranges, range_sigma, t).use, HandsetUse::kUsed);
    ASSERT_NE(f.update_bearings(z, sigma, t + 0.01).use, HandsetUse::kNotFinite);
    ASSERT_NE(mirrored.update_bearings(other, sigma, t + 0.01, true, z).use, HandsetUse::kNotFinite);
  }
  EXPECT_LT(std::abs(wrap_to_pi(f.estimate().heading_rad - w.pose[0][2])), 0.06);
  EXPECT_LT((f.estimate().position_m - w.pose[0].head<2>()).norm(), 2.5);
  // The wrong answers come with the right ones: nodes all round tell which is which.
  EXPECT_LT(std::abs(wrap_to_pi(mirrored.estimate().heading_rad - w.pose[0][2])), 0.06);
  EXPECT_EQ(f.update_bearings(z, sigma, 1.0, true, std::vector<double>{1.0}).use, HandsetUse::kNotFinite);
}

TEST(HandsetLocator, RoomAndWalls) {
  HandsetOptions o;
  o.nodes_m = {{30.0, 0.0, 0.0}, {0.0, 30.0, 0.0}};
  o.particles = 2000;
  o.start_sigma_m = 6.0;
  o.start_heading_sigma_rad = 0.01;
  o.room_m = {{-5.0, -5.0}, {5.0, -5.0}, {5.0, 5.0}, {-5.0, 5.0}};
  o.walls_m = {{0.0, -5.0, 0.0, 5.0}};
  HandsetLocator f(o);
  std::vector<double> x(2000), y(2000), a(2000), weight(2000);
  f.particles(x, y, a, weight);
  EXPECT_TRUE(std::all_of(x.begin(), x.end(), [](double v) { return std::abs(v) <= 5.0; }));
  const auto left = std::count_if(x.begin(), x.end(), [](double v) { return v < 0.0; });
  EXPECT_GT(left, 700);
  // Three metres to the right: whoever stood up to three metres left of the wall would have to go through it.
  for (int k = 1; k <= 30; ++k) ASSERT_EQ(f.move(step_of({0.1, 0.0, 0.0}), 0.05 * k).use, HandsetUse::kUsed);
  f.particles(x, y, a, weight);
  for (std::size_t i = 0; i < x.size(); ++i) {
    EXPECT_TRUE(weight[i] == 0.0 || (x[i] <= 5.0 && (x[i] < 0.05 || x[i] > 2.9))) << x[i];
  }
  EXPECT_EQ(f.move(step_of({20.0, 0.0, 0.0}), 5.0).use, HandsetUse::kWalls);
  EXPECT_TRUE(f.estimate().position_m.allFinite());
}

TEST(HandsetLocator, SameSeedSameBitsAndResetIsNew) {
  const HandsetWorld w = walk(4, 4.0);
  HandsetOptions o = start_of(w, 100);
  o.seed = 11;
  HandsetLocator a(o), b(o);
  const HandsetEstimate x = play(a, w, 0.0).last, y = play(b, w, 0.0).last;
  EXPECT_EQ(x.position_m, y.position_m);
  b.reset(12);
  EXPECT_EQ(b.estimate().status, HandsetStatus::kStarting);
  EXPECT_NE(play(b, w, 0.0).last.position_m, x.position_m);
  b.reset(11);
  EXPECT_EQ(play(b, w, 0.0).last.position_m, x.position_m);
}

TEST(HandsetLocatorNoalloc, Steps) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  const HandsetWorld w = walk(6, 4.0);
  for (const HandsetFilter kind : {HandsetFilter::kControl, HandsetFilter::kMeasurement}) {
    HandsetOptions o = start_of(w, 200);
    o.filter = kind;
    o.multipath_sigma_m = 0.5;
    o.room_m = {{-11.0, -11.0}, {11.0, -11.0}, {11.0, 11.0}, {-11.0, 11.0}};
    HandsetLocator f(o);
    const std::vector<double> sigma(6, 1.0);
    HandsetEstimate x;
    EXPECT_EQ(test::allocations_of([&] {
                for (std::size_t k = 0; k < 40; ++k) {
                  (void)f.move(step_of(w.increment[k], 0.002), w.frame_s[k + 1]);
                  if (k % 2 != 0) continue;
                  const std::size_t e = k / 2;
                  (void)f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.frame_s[k + 1]);
                  (void)f.update_bearings({w.range_m.data() + 6 * e, 6}, sigma, w.frame_s[k + 1]);
                  x = f.estimate();
                }
                (void)f.coast(w.frame_s[45]);
                f.reset(3);
              }),
              0);
  }
}

}  // namespace
}  // namespace soopnav::navigation
