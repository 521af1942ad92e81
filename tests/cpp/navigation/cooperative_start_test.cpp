#include "soopnav/navigation/cooperative_start.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <cstdio>
#include <span>
#include <vector>

#include "navigation/cooperative_world.hpp"

namespace soopnav::navigation::start_test {
namespace {

using pair_test::World;
using pair_test::WorldOptions;

WorldOptions with_old_elements() {
  WorldOptions o;
  o.duration_s = 240.0;
  o.sigma_tdoa_s = 148e-9;
  o.sigma_fdoa_hz = 45e-3;
  o.separation_m = 50e3;
  o.along_track_m = 2000.0;
  return o;
}
std::span<const PairMeasurement> first_bursts(const World& world, double t_s) {
  std::size_t n = 0;
  while (n < world.bursts.size() && world.bursts[n].t_s < t_s) ++n;
  return std::span(world.bursts).first(n);
}
double nees_of(const PairVector& truth, const PairVector& mean, const PairSquare& P) {
  const PairVector error = truth - mean;
  return error.dot(P.ldlt().solve(error));
}
double sigma_of(const PairSquare& P) { return std::sqrt(P.topLeftCorner<3, 3>().trace()); }
PairStartOptions near(const World& world) {
  PairStartOptions search;
  search.guess_p_e = world.target + 20e3 * world.east;
  search.search_radius_m = 0.0;
  return search;
}

// One error along the orbit is in all bursts of a satellite, before and after the start: NEES of both.
TEST(PairStart, OldElementsLeaveItAndWhatFollowsConsistent) {
  constexpr int kRuns = 16;
  double at_start = 0.0, estimated = 0.0, noise = 0.0, from_rest = 0.0, blind = 0.0;
  double sigma = 0.0, wider = 0.0;
  for (std::uint64_t seed = 100; seed < 100 + kRuns; ++seed) {
    const World world(seed, with_old_elements());
    const auto batch = first_bursts(world, 90.0);
    auto options = world.options();
    options.gate_probability = 0.0;
    options.orbit_sigma_m = 2000.0;
    CooperativeTracker noisy(world.beacons, options), known(world.beacons, options);
    options.along_track_states = 12;
    CooperativeTracker states(world.beacons, options);
    options.along_track_states = 0;
    options.orbit_sigma_m = 0.0;
    CooperativeTracker exact(world.beacons, options);
    const PairStart start = states.start(batch, near(world));
    ASSERT_TRUE(states.started()) << to_string(start.status) << seed;
    static_cast<void>(noisy.start(batch, near(world)));
    ASSERT_TRUE(noisy.started());
    const PairVector& then = world.truth[batch.size() - 1];
    at_start += nees_of(then, start.best.mean, start.best.covariance) / kRuns;
    exact.start_at(start.t_s, start.best.mean, start.best.covariance);
    world.start_near(known, 0, 100.0, 500.0);
    for (std::size_t k = 1; k < world.bursts.size(); ++k) {
      static_cast<void>(known.update(world.bursts[k]));
      if (k < batch.size()) continue;
      for (CooperativeTracker* one : {&states, &noisy, &exact}) static_cast<void>(one->update(world.bursts[k]));
    }
    const auto nees = [&](const CooperativeTracker& one) {
      return nees_of(world.truth.back(), one.estimate().mean, one.estimate().covariance) / kRuns;
    };
    estimated += nees(states);
    noise += nees(noisy);
    from_rest += nees(known);
    blind += nees(exact);
    sigma += sigma_of(states.estimate().covariance) / kRuns;
    wider += sigma_of(noisy.estimate().covariance) / kRuns;
  }
  std::printf("nees at the start %.2f, states %.2f, noise %.2f and %.2f, none %.0f; sigmas %.0f and %.0f m\n", at_start,
              estimated, noise, from_rest, blind, sigma, wider);
  // Chi-square of 16 x 5 degrees (v is at its prior, its error is none) leaves 2.6 ... 8.4 once in 1e4.
  EXPECT_GT(at_start, 2.6);
  EXPECT_LT(at_start, 8.4);
  EXPECT_GT(estimated, 2.6);
  EXPECT_LT(estimated, 8.4);
  // As noise it is wider than need be, and no optimist.
  EXPECT_LT(noise, 8.4);
  EXPECT_LT(from_rest, 8.4);
  EXPECT_GT(noise, 0.2);
  EXPECT_LT(wider, 10.0 * sigma);
  EXPECT_GT(blind, 20.0);
}

TEST(PairStart, ErrorsOfOrbitsGoOnAsTheBatchLeftThem) {
  const World world(120, with_old_elements());
  auto options = world.options();
  options.orbit_sigma_m = 2000.0;
  const auto batch = first_bursts(world, 90.0);
  for (const int room : {12, 2}) {
    options.along_track_states = room;
    CooperativeTracker tracker(world.beacons, options);
    const PairStart start = tracker.start(batch, near(world));
    ASSERT_TRUE(tracker.started());
    const auto n = static_cast<Eigen::Index>(start.along_track.size());
    ASSERT_GE(n, 3);
    ASSERT_EQ(start.joint_covariance.rows(), kPairDim + n);
    EXPECT_EQ(start.along_track.front(), batch.back().beacon);
    EXPECT_LT((start.joint_covariance.topLeftCorner<kPairDim, kPairDim>() - start.best.covariance).norm(), 1e-6);
    for (Eigen::Index i = 0; i < n; ++i) {
      double mean = 0.0, sigma = 0.0;
      const bool held = tracker.along_track(start.along_track[static_cast<std::size_t>(i)], mean, sigma);
      EXPECT_EQ(held, i < room);
      if (!held) continue;
      EXPECT_EQ(mean, start.along_track_m[i]);
      EXPECT_NEAR(sigma, std::sqrt(start.joint_covariance(kPairDim + i, kPairDim + i)), 1e-6 * sigma);
      EXPECT_LT(sigma, 2000.0);
    }
    EXPECT_EQ(tracker.estimate().covariance, start.best.covariance);
  }
}

// What joined is what the joint covariance says: a measurement of one of them moves the others accordingly.
TEST(PairStart, JointErrorsMoveTogether) {
  const World world(121, with_old_elements());
  auto options = world.options();
  options.orbit_sigma_m = 2000.0;
  options.along_track_states = 12;
  CooperativeTracker tracker(world.beacons, options);
  const PairStart start = tracker.start(first_bursts(world, 90.0), near(world));
  ASSERT_TRUE(tracker.started());
  const Eigen::MatrixXd& P = start.joint_covariance;
  const Eigen::Vector3d up = world.up;
  const double variance = 100.0;
  ASSERT_TRUE(tracker.engine().update(PlaneDistance<>{up, start.best.mean.head<3>()}, 50.0, variance).accepted());
  const double S = up.dot(P.topLeftCorner<3, 3>() * up) + variance;
  for (Eigen::Index i = 0; i < static_cast<Eigen::Index>(start.along_track.size()); ++i) {
    double mean = 0.0, sigma = 0.0;
    ASSERT_TRUE(tracker.along_track(start.along_track[static_cast<std::size_t>(i)], mean, sigma));
    const double gain = P.row(kPairDim + i).head<3>().dot(up) / S;
    EXPECT_NEAR(std::abs(mean - start.along_track_m[i]), std::abs(50.0 * gain), 1e-3 * std::abs(50.0 * gain) + 1e-3);
    EXPECT_NEAR(sigma * sigma, P(kPairDim + i, kPairDim + i) - gain * gain * S, 1e-4 * sigma * sigma);
  }
}

TEST(PairStart, WhatFitsNothingStartsNothing) {
  WorldOptions o;
  o.duration_s = 95.0;
  const World world(2, o);
  CooperativeTracker tracker(world.beacons, world.options());
  RandomStream random(5);
  auto noise = world.bursts;
  for (PairMeasurement& m : noise) {
    m.tdoa_s = random.uniform(-1e-3, 1e-3);
    m.fdoa_hz = random.uniform(-2e3, 2e3);
  }
  const PairStart start = tracker.start(noise, near(world));
  EXPECT_TRUE(start.status == PairStartStatus::kPoorFit || start.status == PairStartStatus::kNotConverged)
      << to_string(start.status);
  EXPECT_FALSE(tracker.started());
  // A few wrong by too little to be told apart, and too many to be left out: a place is found, and does not fit.
  auto half = world.bursts;
  for (std::size_t k = 0; k < half.size(); k += 2) half[k].fdoa_hz += random.uniform(-60.0, 60.0);
  const PairStart poor = tracker.start(half, near(world));
  EXPECT_EQ(poor.status, PairStartStatus::kPoorFit);
  EXPECT_TRUE(poor.best.mean.allFinite());
  EXPECT_FALSE(tracker.started());
  EXPECT_EQ(tracker.update(world.bursts.back()).use, PairUse::kNotStarted);
  ASSERT_TRUE(tracker.start(first_bursts(world, 90.0), near(world)).ok());
  EXPECT_TRUE(tracker.started());
}

TEST(PairStart, ItsLastBurstIsNotTakenTwice) {
  WorldOptions o;
  o.duration_s = 95.0;
  const World world(3, o);
  CooperativeTracker tracker(world.beacons, world.options());
  const auto batch = first_bursts(world, 90.0);
  ASSERT_TRUE(tracker.start(batch, near(world)).ok());
  const PairEstimate before = tracker.estimate();
  EXPECT_EQ(tracker.update(batch.back()).use, PairUse::kNotAdvancing);
  EXPECT_EQ(tracker.estimate().covariance, before.covariance);
  PairMeasurement other = batch.back();
  other.beacon = other.beacon == 0 ? 1 : 0;
  EXPECT_NE(tracker.update(other).use, PairUse::kNotAdvancing);
  tracker.start_at(batch.back().t_s, before.mean, before.covariance);
  EXPECT_TRUE(tracker.update(batch.back()).accepted());
}

}  // namespace
}  // namespace soopnav::navigation::start_test
