#include "soopnav/navigation/handset_locator.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/simulation/handset_world.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::navigation {
namespace {

using simulation::HandsetWorld;
using simulation::HandsetWorldOptions;
using simulation::NlosOptions;
using simulation::NlosSchedule;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

HandsetWorld walk(std::uint64_t seed, double duration_s = 30.0, double foot_sigma_m = 0.0) {
  HandsetWorldOptions o;
  o.duration_s = duration_s;
  o.foot_sigma_m = foot_sigma_m;
  o.nlos.min_clear_share = 0.2;
  return HandsetWorld::generate(o, seed);
}

HandsetOptions start_of(const HandsetWorld& w, std::size_t particles = 300) {
  HandsetOptions o;
  o.nodes_m = w.nodes_m;
  o.particles = particles;
  o.start_sigma_m = 6.0;
  o.start_heading_rad = w.told_heading_rad;
  o.start_heading_sigma_rad = 0.1;
  return o;
}

HandsetMotion step_of(const Eigen::Vector3d& increment, double foot_sigma_m = 0.0) {
  HandsetMotion m;
  m.increment = increment;
  m.track_covariance.diagonal() << 1e-6, 1e-6, 1.3e-7;
  m.foot_covariance.diagonal().setConstant(foot_sigma_m * foot_sigma_m);
  m.foot_covariance_previous = m.foot_covariance;
  return m;
}

struct Played {
  double rms_m = 0.0;  // of the position after `settled_s`
  double nees = 0.0;   // mean of it
  double right = 0.0;  // share of links and epochs told rightly
  HandsetEstimate last;
};

// The walk through a locator. `change` may alter a copy of each epoch's ranges.
template <class Change>
Played play(HandsetLocator& f, const HandsetWorld& w, double settled_s, bool camera, double foot_sigma_m,
            const Change& change) {
  const std::size_t L = w.nodes_m.size();
  const std::vector<double> sigma(L, 1.0);
  std::vector<double> z(L);
  Played out;
  double n = 0.0;
  std::size_t k = 0;
  for (std::size_t e = 0; e < w.epoch_s.size(); ++e) {
    for (; camera && k + 1 < w.frame_s.size() && w.frame_s[k + 1] <= w.epoch_s[e]; ++k) {
      EXPECT_EQ(f.move(step_of(w.increment[k], foot_sigma_m), w.frame_s[k + 1]).use, HandsetUse::kUsed);
    }
    for (std::size_t l = 0; l < L; ++l) z[l] = w.range_m[e * L + l];
    change(e, z);
    (void)f.update_ranges(z, sigma, w.epoch_s[e]);
    if (w.epoch_s[e] < settled_s) continue;
    const HandsetEstimate x = f.estimate();
    const Eigen::Vector2d d = x.position_m - w.position_m[e];
    out.rms_m += d.squaredNorm();
    out.nees += d.dot(x.covariance_m2.inverse() * d);
    for (std::size_t l = 0; l < L; ++l) {
      out.right += ((x.p_los[l] < 0.5) == (w.nlos.blocked[e * L + l] != 0) ? 1.0 : 0.0) / static_cast<double>(L);
    }
    n += 1.0;
  }
  out.rms_m = std::sqrt(out.rms_m / n);
  out.nees /= n;
  out.right /= n;
  out.last = f.estimate();
  return out;
}
Played play(HandsetLocator& f, const HandsetWorld& w, double settled_s = 15.0, bool camera = true,
            double foot_sigma_m = 0.0) {
  return play(f, w, settled_s, camera, foot_sigma_m, [](std::size_t, std::vector<double>&) {});
}

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
  const Eigen::Matrix2d C = R * x.covariance_m2 * R.inverse().toRotationMatrix();
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
    second_nees += f.dot(z.covariance_m2.inverse() * f) / kRuns;
    nees += d.dot(x.covariance_m2.inverse() * d) / kRuns;
    independent += e.dot(y.covariance_m2.inverse() * e) / kRuns;
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

TEST(HandsetLocator, StatusesAndRefusals) {
  const HandsetWorld w = walk(8, 3.0);
  HandsetOptions o = start_of(w, 50);
  HandsetLocator f(o);
  const std::vector<double> sigma(6, 1.0), z(w.range_m.begin(), w.range_m.begin() + 6), nothing(6, kNan);
  EXPECT_EQ(f.estimate().status, HandsetStatus::kStarting);
  EXPECT_LT((f.estimate().position_m - o.start_m).norm(), 6.0);
  EXPECT_EQ(f.update_ranges(z, sigma, kNan).use, HandsetUse::kNotFinite);
  EXPECT_EQ(f.update_ranges(std::vector<double>(5, 1.0), sigma, 0.0).use, HandsetUse::kNotFinite);
  EXPECT_EQ(f.update_ranges(nothing, sigma, 0.0).use, HandsetUse::kNothingHeard);
  const HandsetReport good = f.update_ranges(z, sigma, 0.1);
  EXPECT_EQ(good.use, HandsetUse::kUsed);
  EXPECT_EQ(good.heard, 6);
  EXPECT_EQ(f.update_ranges(z, sigma, 0.05).use, HandsetUse::kOutOfOrder);
  EXPECT_EQ(f.estimate().status, HandsetStatus::kCoasting);
  EXPECT_EQ(f.move(step_of({kNan, 0.0, 0.0}), 0.2).use, HandsetUse::kNotFinite);
  HandsetMotion bad = step_of({0.0, 0.0, 0.0});
  bad.track_covariance(0, 0) = -1.0;
  EXPECT_EQ(f.move(bad, 0.2).use, HandsetUse::kNotFinite);
  EXPECT_EQ(f.move(step_of({0.0, 0.0, 0.0}), 0.2).use, HandsetUse::kUsed);
  EXPECT_EQ(f.move(step_of({0.0, 0.0, 0.0}), 0.2).use, HandsetUse::kOutOfOrder);
  EXPECT_EQ(f.estimate().status, HandsetStatus::kTracking);
  EXPECT_EQ(f.coast(0.25).use, HandsetUse::kCoasted);
  for (int k = 0; k < 100; ++k) EXPECT_EQ(f.move(step_of({0.01, 0.0, 0.0}), 0.3 + 0.05 * k).use, HandsetUse::kUsed);
  EXPECT_EQ(f.estimate().status, HandsetStatus::kCameraOnly);
  EXPECT_EQ(f.update_ranges(z, sigma, 1.0).use, HandsetUse::kClocksDisagree);
  const double before = f.estimate().covariance_m2.trace();
  EXPECT_EQ(f.update_ranges(nothing, sigma, 12.0).use, HandsetUse::kNothingHeard);
  EXPECT_EQ(f.estimate().status, HandsetStatus::kCoasting);
  EXPECT_GT(f.estimate().covariance_m2.trace(), before + 3.0);                  // six seconds without a camera
  EXPECT_EQ(f.move(step_of({0.0, 0.0, 0.0}), 12.1).use, HandsetUse::kCoasted);  // begins before what was gone through
  EXPECT_EQ(f.move(step_of({0.0, 0.0, 0.0}), 12.2).use, HandsetUse::kUsed);
  EXPECT_EQ(f.move(step_of({0.0, 0.0, 0.0}), 9.0).use, HandsetUse::kOutOfOrder);
  EXPECT_TRUE(f.estimate().position_m.allFinite());
}

TEST(HandsetLocator, NonsenseNeitherEntersNorStays) {
  const HandsetWorld w = walk(9, 20.0);
  const std::size_t L = w.nodes_m.size();
  HandsetOptions o = start_of(w, 500);
  o.recover_after = 5;
  HandsetLocator f(o);
  int recovered = 0;
  const std::vector<double> sigma(L, 1.0);
  const Played p = play(f, w, 15.0, true, 0.0, [&](std::size_t e, std::vector<double>& z) {
    if (e >= 40 && e < 60) {
      for (std::size_t l = 0; l < L; ++l) z[l] = 1e5 * static_cast<double>(l + 1) * (e % 2 == 0 ? 1.0 : -1.0);
    }
    if (e == 50) recovered = f.update_ranges(z, sigma, w.epoch_s[e]).use == HandsetUse::kUsed ? 0 : 1;
  });
  EXPECT_EQ(recovered, 1);
  EXPECT_TRUE(p.last.position_m.allFinite() && p.last.covariance_m2.allFinite());
  EXPECT_LT(p.rms_m, 3.0);  // found again
}

// A clock unknown by a second, or ranges of a micrometre: variances 1e18 apart in one Gaussian.
TEST(HandsetLocator, FarApartVariancesKeepTheirDigits) {
  const HandsetWorld w = walk(1, 12.0);
  for (const double clock_m : {0.0, 2.5e8}) {
    for (const bool alone : {false, true}) {
      HandsetOptions o = alone ? HandsetOptions::lte_alone(w.nodes_m) : start_of(w);
      double rms[2] = {0.0, 0.0};
      for (const double sigma_m : {1000.0, 3e8}) {
        if (clock_m > sigma_m) continue;
        o.clock_sigma_m = sigma_m;
        HandsetLocator f(o);
        const Played p = play(f, w, 8.0, !alone, 0.0, [&](std::size_t, std::vector<double>& z) {
          for (double& r : z) r += clock_m;
        });
        rms[sigma_m > 1e6 ? 1 : 0] = p.rms_m;
        EXPECT_TRUE(p.last.covariance_m2.allFinite());
        EXPECT_GT(p.last.covariance_m2.determinant(), 1e-8);
        EXPECT_LT(std::abs(p.last.clock_m - clock_m - w.clock_m.back()), alone ? 20.0 : 1.0);
        EXPECT_LT(p.rms_m, alone ? 20.0 : 1.0);
      }
      if (clock_m == 0.0 && alone) {
        EXPECT_NEAR(rms[0], rms[1], 0.05 * rms[0]);
      }
    }
  }
}

TEST(HandsetLocator, RangesOfAMicrometreAreNotTheOrigin) {
  const HandsetWorld w = walk(1, 4.0);
  for (const HandsetFilter kind : {HandsetFilter::kControl, HandsetFilter::kMeasurement}) {
    for (const double sigma_m : {1e-6, 1e-12, 1e-200}) {
      HandsetOptions o = start_of(w, 64);
      o.filter = kind;
      HandsetLocator f(o);
      const std::vector<double> sigma(6, sigma_m);
      for (std::size_t e = 0; e < 20; ++e) {
        (void)f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.epoch_s[e]);
        const HandsetEstimate x = f.estimate();
        ASSERT_TRUE(x.position_m.allFinite());
        ASSERT_GT(x.covariance_m2.determinant(), 0.0);
        ASSERT_TRUE(std::isfinite(x.clock_m) && std::isfinite(x.heading_sigma_rad));
      }
    }
  }
}

// One set of ranges that no clock could explain leaves filters as they are that know no outliers.
TEST(HandsetLocator, RangesBeyondAllSigmasAreOutliersAlways) {
  const HandsetWorld w = walk(2, 4.0);
  for (const bool alone : {false, true}) {
    HandsetOptions o = alone ? HandsetOptions::lte_alone(w.nodes_m) : start_of(w, 64);
    o.outlier_probability = 0.0;
    HandsetLocator f(o);
    const std::vector<double> sigma(6, 1.0);
    for (std::size_t e = 0; e < 20; ++e) {
      (void)f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.epoch_s[e]);
    }
    const HandsetEstimate before = f.estimate();
    for (const double far : {1e160, -1e300, 1e6}) {
      EXPECT_EQ(f.update_ranges(std::vector<double>(6, far), sigma, w.epoch_s[19]).use, HandsetUse::kOutliers);
    }
    EXPECT_LT((f.estimate().position_m - before.position_m).norm(), 1e-6);
    EXPECT_EQ(f.update_ranges({w.range_m.data() + 6 * 20, 6}, sigma, w.epoch_s[20]).use, HandsetUse::kUsed);
  }
}

// What nobody foresaw: particles that are no numbers any more begin anew, and the report says so.
TEST(HandsetLocator, BeginsAnewWhenNoParticleIsANumber) {
  const HandsetWorld w = walk(2, 8.0);
  for (const HandsetFilter kind : {HandsetFilter::kControl, HandsetFilter::kMeasurement}) {
    HandsetOptions o = start_of(w, 100);
    o.filter = kind;
    HandsetLocator f(o);
    const std::vector<double> sigma(6, 1.0);
    HandsetMotion m = step_of({0.01, 0.0, 0.0});
    m.track_covariance.diagonal().setConstant(1e308);
    EXPECT_EQ(f.move(m, 0.05).use, HandsetUse::kUsed);
    m.foot_covariance = m.foot_covariance_previous = 1e308 * Eigen::Matrix2d::Identity();
    (void)f.move(m, 0.1);
    (void)f.move(m, 0.15);
    int recovered = 0;
    for (std::size_t e = 2; e < 40; ++e) {
      const HandsetReport r = f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.epoch_s[e]);
      recovered += r.use == HandsetUse::kRecovered ? 1 : 0;
    }
    if (kind == HandsetFilter::kControl) {
      EXPECT_GE(recovered, 1);  // type 2 takes such steps for measurements that say nothing
    }
    const HandsetEstimate x = f.estimate();
    EXPECT_TRUE(x.position_m.allFinite() && x.covariance_m2.allFinite());
    EXPECT_LT((x.position_m - w.position_m[39]).norm(), 6.0);
    std::vector<double> px(100), py(100), pa(100), weight(100);
    f.particles(px, py, pa, weight);
    EXPECT_TRUE(std::all_of(px.begin(), px.end(), [](double v) { return std::isfinite(v); }));
  }
}

// A speed unknown by that of light takes all digits of a covariance: seen, said and begun anew, then found.
TEST(HandsetLocator, CovariancesThatBreakBeginAnew) {
  const HandsetWorld w = walk(2, 4.0);
  HandsetOptions o = HandsetOptions::lte_alone(w.nodes_m);
  o.start_speed_sigma_mps = 1e9;
  HandsetLocator f(o);
  const std::vector<double> sigma(6, 1.0);
  int recovered = 0;
  for (std::size_t e = 0; e < 40; ++e) {
    const HandsetReport r = f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.epoch_s[e]);
    recovered += r.use == HandsetUse::kRecovered ? 1 : 0;
  }
  EXPECT_GE(recovered, 1);
  EXPECT_LT((f.estimate().position_m - w.position_m[39]).norm(), 20.0);
  EXPECT_GT(f.estimate().covariance_m2.determinant(), 0.0);
}

TEST(HandsetLocator, StepsFasterThanAnyoneWalksCoast) {
  const HandsetWorld w = walk(2, 12.0);
  for (const HandsetFilter kind : {HandsetFilter::kControl, HandsetFilter::kMeasurement}) {
    for (const Eigen::Vector3d& glitch : {Eigen::Vector3d(1000.0, 0.0, 0.0), Eigen::Vector3d(0.0, 1e12, 0.0),
                                          Eigen::Vector3d(1e300, 1e300, 0.0), Eigen::Vector3d(0.0, 0.0, 1e9)}) {
      HandsetOptions o = start_of(w, 100);
      o.filter = kind;
      HandsetLocator f(o);
      const std::vector<double> sigma(6, 1.0);
      for (std::size_t e = 0, k = 0; e < 60; ++e) {
        for (; k + 1 < w.frame_s.size() && w.frame_s[k + 1] <= w.epoch_s[e]; ++k) {
          const bool bad = k == 0 || k == 81;
          EXPECT_EQ(f.move(step_of(bad ? glitch : w.increment[k]), w.frame_s[k + 1]).use,
                    bad ? HandsetUse::kTooFast : HandsetUse::kUsed);
        }
        (void)f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.epoch_s[e]);
      }
      EXPECT_LT((f.estimate().position_m - w.position_m[59]).norm(), 2.0);
    }
  }
  HandsetOptions o = start_of(w, 10);
  o.max_speed_mps = 2.0;
  HandsetLocator slow(o);
  EXPECT_EQ(slow.move(step_of({0.0, 0.0, 0.0}), 0.0).use, HandsetUse::kUsed);
  EXPECT_EQ(slow.move(step_of({0.3, 0.0, 0.0}), 0.1).use, HandsetUse::kTooFast);
  EXPECT_EQ(slow.move(step_of({0.1, 0.0, 0.0}), 0.2).use, HandsetUse::kUsed);
}

// Frames that take 70 ms to come are as good as those that take none.
TEST(HandsetLocator, LateFramesAreTakenWhereTheyBelong) {
  for (const HandsetFilter kind : {HandsetFilter::kControl, HandsetFilter::kMeasurement}) {
    double rms[2] = {0.0, 0.0};
    for (const std::uint64_t seed : {1u, 2u}) {
      const HandsetWorld w = walk(seed, 25.0);
      for (const bool late : {false, true}) {
        HandsetOptions o = start_of(w, 100);
        o.filter = kind;
        HandsetLocator f(o);
        const std::vector<double> sigma(6, 1.0);
        double square = 0.0;
        std::size_t k = 0;
        for (std::size_t e = 0; e < w.epoch_s.size(); ++e) {
          for (; k + 1 < w.frame_s.size() && w.frame_s[k + 1] + (late ? 0.07 : 0.0) <= w.epoch_s[e] + 1e-9; ++k) {
            EXPECT_EQ(f.move(step_of(w.increment[k]), w.frame_s[k + 1]).use, HandsetUse::kUsed);
          }
          (void)f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.epoch_s[e]);
          if (e >= 150) square += (f.estimate().position_m - w.position_m[e]).squaredNorm();
        }
        rms[late ? 1 : 0] += std::sqrt(square / static_cast<double>(w.epoch_s.size() - 150));
      }
    }
    RecordProperty("late over in time", std::to_string(rms[1] / rms[0]));
    EXPECT_LT(rms[1], 1.5 * rms[0]) << rms[0] << " " << rms[1];
  }
}

// Of a movement that was gone through already nothing is added twice.
TEST(HandsetLocatorLaw, LateFramesMoveOnce) {
  for (const bool lost : {false, true}) {
    HandsetOptions o;
    o.nodes_m = {{300.0, 0.0, 0.0}};
    o.filter = HandsetFilter::kMeasurement;
    o.particles = 1;
    o.start_sigma_m = o.start_heading_sigma_rad = 1e-3;
    HandsetLocator f(o);
    const std::vector<double> nothing(1, kNan), sigma(1, 1.0);
    for (int k = 0; k <= 20; ++k) ASSERT_EQ(f.move(step_of({0.05, 0.0, 0.0}), 0.05 * k).use, HandsetUse::kUsed);
    const double begin = f.estimate().position_m[0];
    (void)f.update_ranges(nothing, sigma, 1.3);
    for (int k = 21; k <= 40; ++k) {
      if (lost && k == 22) {
        ASSERT_EQ(f.coast(0.05 * k).use, HandsetUse::kCoasted);
        continue;
      }
      ASSERT_EQ(f.move(step_of({0.05, 0.0, 0.0}), 0.05 * k).use, HandsetUse::kUsed);
    }
    EXPECT_NEAR(f.estimate().position_m[0] - begin, 1.0, 0.01);
  }
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

std::string refusal(const HandsetOptions& o) {
  try {
    const HandsetLocator f(o);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

TEST(HandsetLocator, OptionsAreRefusedByName) {
  const auto with = [](auto change) {
    HandsetOptions o;
    o.nodes_m = {{10.0, 0.0, 0.0}};
    change(o);
    return refusal(o);
  };
  EXPECT_EQ(with([](HandsetOptions&) {}), "");
  EXPECT_EQ(with([](HandsetOptions& o) { o.particles = 0; }), "particles: 0; 1 ... 1 000 000 expected");
  EXPECT_NE(with([](HandsetOptions& o) { o.nodes_m.clear(); }).find("nodes_m: 0"), std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.nodes_m[0][0] = kNan; }).find("nodes_m"), std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.node_sigma_m = {1.0, 1.0}; }).find("node_sigma_m"), std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.kernel = 0.0; }).find("kernel: 0"), std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.excess_max_m = 4.0; }).find("excess_max_m"), std::string::npos);
  EXPECT_EQ(with([](HandsetOptions& o) { o.multipath_sigma_m = -1.0; }), "multipath_sigma_m: -1; at least 0 expected");
  EXPECT_NE(with([](HandsetOptions& o) { o.multipath_length_m = 0.0; }).find("multipath_length_m: 0"),
            std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.outlier_probability = 0.5; }).find("outlier_probability"),
            std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.room_m = {{0.0, 0.0}}; }).find("room_m"), std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.ess_threshold = kNan; }).find("ess_threshold"), std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.max_speed_mps = 0.0; }).find("max_speed_mps: 0"), std::string::npos);
  EXPECT_EQ(to_string(HandsetUse::kClocksDisagree), "clocks disagree");
  EXPECT_EQ(to_string(HandsetUse::kTooFast), "too fast");
  EXPECT_EQ(to_string(HandsetStatus::kCameraOnly), "camera only");
  EXPECT_EQ(to_string(HandsetFilter::kControl), "control");
  EXPECT_EQ(to_string(HandsetClock::kSeparate), "separate");
}

TEST(NlosSchedule, KeepsItsGuards) {
  for (const int most : {0, 1, 2, 6}) {
    NlosOptions o;
    o.max_blocked = most;
    const NlosSchedule s = NlosSchedule::generate(o, 600, 0.1, 17);
    EXPECT_TRUE(s.guarded);
    double clear = 1.0;
    std::vector<int> open(6, 0);
    for (std::size_t k = 0; k < 600; ++k) {
      int blocked = 0;
      for (std::size_t l = 0; l < 6; ++l) {
        const std::size_t at = 6 * k + l;
        blocked += s.blocked[at];
        open[l] += 1 - s.blocked[at];
        if (s.blocked[at] != 0) {
          EXPECT_TRUE(s.excess_m[at] >= 4.0 && s.excess_m[at] <= 20.0);
        } else {
          EXPECT_EQ(s.excess_m[at], 0.0);
        }
      }
      EXPECT_LE(blocked, most);
    }
    clear = *std::min_element(open.begin(), open.end()) / 600.0;
    EXPECT_DOUBLE_EQ(clear, s.clear_share);
    EXPECT_GE(clear, 0.4);
  }
  // Half the time blocked on average and nearly always clear asked for: said, not hidden.
  NlosOptions o;
  o.max_blocked = 6;
  o.mean_los_s = o.mean_nlos_s = 2.0;
  o.min_clear_share = 0.95;
  o.attempts = 5;
  const NlosSchedule s = NlosSchedule::generate(o, 600, 0.1, 1);
  EXPECT_FALSE(s.guarded);
  EXPECT_EQ(s.attempts, 5);
  EXPECT_LT(s.clear_share, 0.95);
}

// Long run of one free chain: its share and its mean stays. 1e5 s of stays of 5 and 10 s: 6667 of each, so means are
// good to 1.3 % (1 sigma) and the share to 0.6 %.
TEST(NlosSchedule, WalksOfAnyLengthAreFolded) {
  for (const double walk_m2ps : {1e40, 1e300}) {
    NlosOptions o;
    o.excess_walk_m2ps = walk_m2ps;
    const NlosSchedule s = NlosSchedule::generate(o, 50, 0.1, 3);
    for (std::size_t i = 0; i < s.excess_m.size(); ++i) {
      EXPECT_TRUE(s.blocked[i] != 0 ? s.excess_m[i] >= o.excess_min_m && s.excess_m[i] <= o.excess_max_m
                                    : s.excess_m[i] == 0.0);
    }
  }
  NlosOptions o;
  o.excess_walk_m2ps = 1e300;
  EXPECT_THROW((void)NlosSchedule::generate(o, 5, 1e300, 3), std::invalid_argument);
}

TEST(NlosSchedule, StaysAsLongAsItShould) {
  NlosOptions o;
  o.links = 1;
  o.max_blocked = 1;
  o.min_clear_share = 0.0;
  const NlosSchedule s = NlosSchedule::generate(o, 1000000, 0.1, 5);
  double blocked = 0.0, begins = 0.0;
  for (std::size_t k = 1; k < s.epochs; ++k) {
    blocked += s.blocked[k];
    begins += s.blocked[k] > s.blocked[k - 1] ? 1.0 : 0.0;
  }
  EXPECT_NEAR(blocked / 1e6, 1.0 / 3.0, 0.01);
  EXPECT_NEAR(0.1 * blocked / begins, 5.0, 0.35);  // the step of 0.1 s hides the shortest: 1.5 % longer
}

TEST(HandsetWorld, StaysInItsRoomAtItsSpeeds) {
  for (const std::uint64_t seed : {1u, 2u, 3u}) {
    const HandsetWorld w = HandsetWorld::generate({}, seed);
    ASSERT_EQ(w.frame_s.size(), 1201u);
    ASSERT_EQ(w.epoch_s.size(), 600u);
    Eigen::Vector2d dead = w.pose[0].head<2>();
    double a = w.pose[0][2];
    for (std::size_t k = 0; k + 1 < w.pose.size(); ++k) {
      EXPECT_LT(w.pose[k].head<2>().cwiseAbs().maxCoeff(), 10.0);
      const double speed = (w.pose[k + 1] - w.pose[k]).head<2>().norm() * 20.0;
      EXPECT_TRUE(speed > 0.39 && speed < 1.01);
      dead += Eigen::Rotation2Dd(a) * Eigen::Vector2d(w.increment[k].head<2>());
      a += w.increment[k][2];
    }
    // Dead reckoning drifts: 0.02 degrees x sqrt(1200) = 0.7 degrees over 42 m.
    EXPECT_LT((dead - w.pose.back().head<2>()).norm(), 2.0);
    EXPECT_GT((dead - w.pose.back().head<2>()).norm(), 1e-4);
    for (const auto& q : w.nodes_m) EXPECT_TRUE(q.norm() >= 25.0 && q.norm() <= 60.0);
    EXPECT_LE(std::abs(w.told_heading_rad - w.pose[0][2]), radians(10.0) + 1e-12);
  }
  HandsetWorldOptions o;
  o.room_m = 4.0;
  EXPECT_THROW((void)HandsetWorld::generate(o, 1), std::invalid_argument);
  o = {};
  o.max_speed_mps = 3.0;
  EXPECT_THROW((void)HandsetWorld::generate(o, 1), std::invalid_argument);
}

}  // namespace
}  // namespace soopnav::navigation
