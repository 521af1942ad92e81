#include "soopnav/navigation/cooperative_tracker.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "navigation/cooperative_world.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::navigation {
namespace {

using Eigen::Vector3d;
using pair_test::count;
using pair_test::nees;
using pair_test::position_error;
using pair_test::until;
using pair_test::World;
using pair_test::WorldOptions;
constexpr double kNoNumber = std::numeric_limits<double>::quiet_NaN();

WorldOptions fine(double duration_s = 300.0) {
  WorldOptions o;
  o.duration_s = duration_s;
  o.sigma_tdoa_s = 148e-9;
  o.sigma_fdoa_hz = 45e-3;
  return o;
}

TEST(CooperativeTracker, StartsFromNowhereAndFindsTheTarget) {
  double sum = 0.0, squares = 0.0;
  constexpr int kRuns = 12;
  for (std::uint64_t seed = 0; seed < kRuns; ++seed) {
    const World world(seed);
    CooperativeTracker tracker(world.beacons, world.options());
    const auto batch = until(world, 90.0);
    const PairStart start = tracker.start(batch);
    ASSERT_TRUE(start.ok()) << to_string(start.status) << ", seed " << seed;
    EXPECT_EQ(start.t_s, batch.back().t_s);
    EXPECT_GT(start.cells, 50);
    squares += nees(start.best.mean - world.truth[batch.size() - 1], start.best.covariance);
    for (std::size_t k = batch.size(); k < world.bursts.size(); ++k)
      EXPECT_TRUE(tracker.update(world.bursts[k]).accepted());
    const PairEstimate end = tracker.estimate();
    EXPECT_LT(position_error(tracker, world.truth.back()), 300.0) << seed;
    EXPECT_LT(std::sqrt(end.covariance.topLeftCorner<3, 3>().trace()), 100.0);
    sum += nees(end.mean - world.truth.back(), end.covariance);
    EXPECT_EQ(count(tracker, PairUse::kAccepted), static_cast<long>(world.bursts.size() - batch.size()));
  }
  // Chi-square of 12 x 6 degrees (v is at its prior, its error is none: 5 count) leaves 0.4 ... 2 once in 1e5.
  EXPECT_GT(sum / kRuns, 2.0);
  EXPECT_LT(sum / kRuns, 10.0);
  EXPECT_GT(squares / kRuns, 2.0);
  EXPECT_LT(squares / kRuns, 10.0);
}

TEST(CooperativeTracker, AnExtendedFilterAloneFailsFromFarAndTheBatchDoesNot) {
  const World world(3, fine());
  auto options = world.options();
  options.gate_probability = 0.0;
  CooperativeTracker plain(world.beacons, options), batch(world.beacons, options);
  world.start_near(plain, 0, 50e3, 50e3);
  for (const auto& burst : world.bursts) static_cast<void>(plain.update(burst));
  PairStartOptions search;
  search.guess_p_e = world.target + 50e3 * world.east;
  search.search_radius_m = 0.0;
  const auto first = until(world, 90.0);
  const PairStart start = batch.start(first, search);
  ASSERT_TRUE(start.ok());
  EXPECT_EQ(start.cells, 0);
  for (const auto& burst : std::span(world.bursts).subspan(first.size())) static_cast<void>(batch.update(burst));
  EXPECT_LT(position_error(batch, world.truth.back()), 20.0);
  const PairEstimate wrong = plain.estimate();
  EXPECT_GT(nees(wrong.mean - world.truth.back(), wrong.covariance), 80.0);
}

TEST(CooperativeTracker, BothFormsGiveTheSameNumbers) {
  const World world(5);
  auto options = world.options();
  CooperativeTracker joseph(world.beacons, options);
  options.form = PairForm::kInformation;
  CooperativeTracker information(world.beacons, options);
  world.start_near(joseph, 0, 300.0, 500.0);
  world.start_near(information, 0, 300.0, 500.0);
  double apart = 0.0, sigmas = 0.0;
  for (std::size_t k = 1; k < world.bursts.size(); ++k) {
    EXPECT_EQ(joseph.update(world.bursts[k]).use, information.update(world.bursts[k]).use);
    const PairEstimate a = joseph.estimate(), b = information.estimate();
    for (int i = 0; i < kPairDim; ++i) {
      const double sigma = std::sqrt(a.covariance(i, i));
      apart = std::max(apart, std::abs(a.mean[i] - b.mean[i]) / std::max(sigma, std::abs(a.mean[i])));
      sigmas = std::max(sigmas, std::abs(a.covariance(i, i) - b.covariance(i, i)) / a.covariance(i, i));
    }
  }
  EXPECT_LT(apart, 1e-9);
  EXPECT_LT(sigmas, 1e-7);
}

TEST(CooperativeTracker, IteratedUpdatesStandABadLinearisation) {
  // The first burst of a start that is kilometres off: a plain update trusts a derivative of the wrong place.
  double plain_error = 0.0, iterated_error = 0.0;
  for (std::uint64_t seed = 20; seed < 24; ++seed) {
    const World world(seed, fine(120.0));
    auto options = world.options();
    options.gate_probability = 0.0;
    CooperativeTracker plain(world.beacons, options);
    options.iterations = 10;
    CooperativeTracker iterated(world.beacons, options);
    options.form = PairForm::kInformation;
    CooperativeTracker information(world.beacons, options);
    for (CooperativeTracker* tracker : {&plain, &iterated, &information}) {
      world.start_near(*tracker, 0, 15e3, 15e3);
      for (std::size_t k = 1; k < world.bursts.size(); ++k) static_cast<void>(tracker->update(world.bursts[k]));
    }
    plain_error += position_error(plain, world.truth.back());
    iterated_error += position_error(iterated, world.truth.back());
    EXPECT_NEAR((iterated.estimate().mean - information.estimate().mean).head<3>().norm(), 0.0, 0.1);
  }
  EXPECT_LT(iterated_error, 0.7 * plain_error);
}

TEST(CooperativeTracker, RefusesBadBurstsAndSaysWhy) {
  const World world(1);
  CooperativeTracker tracker(world.beacons, world.options());
  EXPECT_EQ(tracker.update(world.bursts[0]).use, PairUse::kNotStarted);
  EXPECT_TRUE(std::isnan(tracker.estimate().t_s));
  EXPECT_FALSE(tracker.coast(10.0));
  world.start_near(tracker, 10, 100.0, 200.0);
  const PairEstimate before = tracker.estimate();
  PairMeasurement m = world.bursts[11];
  const auto refused = [&](const PairMeasurement& burst, PairUse use) {
    EXPECT_EQ(tracker.update(burst).use, use) << to_string(use);
    const PairEstimate now = tracker.estimate();
    EXPECT_EQ(now.mean, before.mean) << to_string(use);
    EXPECT_EQ(now.covariance, before.covariance) << to_string(use);
    EXPECT_EQ(now.t_s, before.t_s);
    EXPECT_GE(count(tracker, use), 1);
  };
  for (int k = 0; k < 6; ++k) {
    PairMeasurement bad = m;
    (k == 0   ? bad.tdoa_s
     : k == 1 ? bad.fdoa_hz
     : k == 2 ? bad.t_s
     : k == 3 ? bad.carrier_hz
     : k == 4 ? bad.covariance(0, 1)
              : bad.anchor_v_e[2]) = kNoNumber;
    refused(bad, PairUse::kNotFinite);
  }
  PairMeasurement bad = m;
  bad.carrier_hz = 0.0;
  refused(bad, PairUse::kNotFinite);
  bad = world.bursts[5];
  refused(bad, PairUse::kNotAdvancing);
  for (const int number : {-1, static_cast<int>(world.beacons.size()), std::numeric_limits<int>::max()}) {
    bad = m;
    bad.beacon = number;
    refused(bad, PairUse::kUnknownBeacon);
  }
  bad = m;
  bad.covariance(0, 0) = -1e-12;
  refused(bad, PairUse::kBadCovariance);
  bad = m;
  bad.t_s = 1e5;
  refused(bad, PairUse::kOutsideEphemeris);
  int low = -1;
  for (int i = 0; i < 66 && low < 0; ++i) {
    if (world.elevation(world.anchor, i, m.t_s) < -0.3) low = i;
  }
  ASSERT_GE(low, 0);
  bad = m;
  bad.beacon = low;
  refused(bad, PairUse::kBelowHorizon);
  EXPECT_TRUE(tracker.update(m).accepted());
  bad = world.bursts[12];
  bad.tdoa_s += 1e-3;
  const PairReport gated = tracker.update(bad);
  EXPECT_EQ(gated.use, PairUse::kGated);
  EXPECT_GT(gated.nis, 1e3);
  EXPECT_NEAR(gated.innovation[0], 3e5, 3e3);
  EXPECT_TRUE(tracker.update(world.bursts[13]).accepted());
}

TEST(CooperativeTracker, CoastsThroughSilenceAndComesBack) {
  const World world(2);
  CooperativeTracker tracker(world.beacons, world.options());
  const PairStart start = tracker.start(until(world, 90.0));
  ASSERT_TRUE(start.ok());
  const PairSquare before = tracker.estimate().covariance;
  for (double t = 95.0; t < 240.0; t += 5.0) ASSERT_TRUE(tracker.coast(t));
  const PairEstimate silent = tracker.estimate();
  const double dt = silent.t_s - start.t_s;
  const clock::ClockNoise both = world.clock + world.clock;
  const double grown = before(6, 6) + 2.0 * dt * before(6, 7) + dt * dt * before(7, 7) +
                       both.white_frequency_m2ps * dt + both.frequency_walk_m2ps3 * dt * dt * dt / 3.0;
  EXPECT_NEAR(silent.covariance(6, 6), grown, 1e-6 * grown);
  EXPECT_NEAR(silent.covariance(7, 7), before(7, 7) + both.frequency_walk_m2ps3 * dt, 1e-9);
  EXPECT_NEAR(silent.silent_s, 240.0 - 90.0, 8.0);
  EXPECT_FALSE(tracker.coast(100.0));
  EXPECT_FALSE(tracker.coast(kNoNumber));
  for (std::size_t k = 0; k < world.bursts.size(); ++k) {
    if (world.bursts[k].t_s < tracker.estimate().t_s) continue;
    EXPECT_TRUE(tracker.update(world.bursts[k]).accepted());
  }
  EXPECT_LT(nees(tracker.estimate().mean - world.truth.back(), tracker.estimate().covariance), 40.0);
}

TEST(CooperativeTracker, OneBeaconForMinutesIsHonestAboutWhatItDoesNotShow) {
  WorldOptions o;
  o.only_satellite_of = 1;
  double sum = 0.0;
  int runs = 0;
  for (std::uint64_t seed = 30; seed < 38; ++seed) {
    const World world(seed, o);
    if (world.bursts.size() < 100) continue;
    CooperativeTracker tracker(world.beacons, world.options());
    world.start_near(tracker, 0, 3e3, 5e3);
    for (std::size_t k = 1; k < world.bursts.size(); ++k) {
      static_cast<void>(tracker.update(world.bursts[k]));
      ASSERT_TRUE(tracker.estimate().mean.allFinite());
    }
    const PairEstimate end = tracker.estimate();
    ++runs;
    sum += nees(end.mean - world.truth.back(), end.covariance);
    EXPECT_GT(Eigen::LLT<PairSquare>(end.covariance).matrixL()(7, 7), 0.0);
  }
  ASSERT_GE(runs, 4);
  EXPECT_LT(sum / runs, 16.0);
}

TEST(CooperativeTracker, AHeightIsNotLearntTwice) {
  WorldOptions o;
  o.speed_mps = {12.0, -5.0};
  o.duration_s = 200.0;
  const World world(7, o);
  auto options = world.options();
  options.acceleration_psd_m2ps3 = 1.0;
  options.velocity_sigma_mps = 20.0;
  options.height_m += 25.0;  // wrong by its deviation
  options.height_sigma_m = 25.0;
  CooperativeTracker tracker(world.beacons, options);
  world.start_near(tracker, 0, 100.0, 200.0);
  for (std::size_t k = 1; k < world.bursts.size(); ++k) {
    static_cast<void>(tracker.update(world.bursts[k]));
    const double variance = world.up.dot(tracker.estimate().covariance.topLeftCorner<3, 3>() * world.up);
    EXPECT_LT(variance, 1.1 * 625.0);
    EXPECT_GT(variance, 100.0);  // learnt each time as if anew it would be 625 / 200
  }
  EXPECT_LT(std::abs(world.up.dot(tracker.estimate().mean.head<3>() - world.truth.back().head<3>())), 100.0);
}

TEST(CooperativeTracker, ARoadHoldsATargetAcross) {
  WorldOptions o;
  o.speed_mps = {14.0, 0.0};
  const World world(8, o);
  auto options = world.options();
  options.acceleration_psd_m2ps3 = 0.3;
  options.velocity_sigma_mps = 20.0;
  CooperativeTracker free(world.beacons, options);
  options.road_p_e = {world.target - 2e3 * world.east, world.target + 8e3 * world.east};
  options.road_sigma_m = 15.0;
  CooperativeTracker held(world.beacons, options);
  for (CooperativeTracker* tracker : {&free, &held}) {
    world.start_near(*tracker, 0, 300.0, 400.0);
    for (std::size_t k = 1; k < world.bursts.size(); ++k) static_cast<void>(tracker->update(world.bursts[k]));
  }
  const auto across = [&](const CooperativeTracker& tracker) {
    return std::sqrt(world.north.dot(tracker.estimate().covariance.topLeftCorner<3, 3>() * world.north));
  };
  EXPECT_LT(across(held), 18.0);
  EXPECT_GT(across(free), 2.0 * across(held));
  EXPECT_LT(std::abs(world.north.dot(held.estimate().mean.head<3>() - world.truth.back().head<3>())), 75.0);
}

TEST(CooperativeTracker, AlongTrackErrorsAreEstimatedWhereTheyShow) {
  double sum = 0.0, without = 0.0;
  for (std::uint64_t seed = 40; seed < 44; ++seed) {
    WorldOptions o = fine();
    o.separation_m = 3e5;
    o.along_track_m = 2000.0;
    const World world(seed, o);
    auto options = world.options();
    options.gate_probability = 0.0;
    CooperativeTracker blind(world.beacons, options);
    options.orbit_sigma_m = 2000.0;
    options.along_track_states = 8;
    CooperativeTracker aware(world.beacons, options);
    for (CooperativeTracker* tracker : {&blind, &aware}) {
      world.start_near(*tracker, 0, 1000.0, 2000.0);
      for (std::size_t k = 1; k < world.bursts.size(); ++k) static_cast<void>(tracker->update(world.bursts[k]));
    }
    const int last = world.bursts.back().beacon;
    double mean = 0.0, sigma = 0.0;
    ASSERT_TRUE(aware.along_track(last, mean, sigma));
    EXPECT_LT(sigma, 1999.0);
    EXPECT_NEAR(mean, world.along_m[static_cast<std::size_t>(last)], 5.0 * sigma + 100.0);
    sum += nees(aware.estimate().mean - world.truth.back(), aware.estimate().covariance);
    without += nees(blind.estimate().mean - world.truth.back(), blind.estimate().covariance);
  }
  EXPECT_LT(sum / 4.0, 20.0);
  EXPECT_GT(without / 4.0, 100.0);
}

TEST(CooperativeTracker, AlongTrackStatesLeaveAndMakeRoom) {
  WorldOptions o;
  o.separation_m = 2e5;
  o.duration_s = 600.0;
  const World world(9, o);
  auto options = world.options();
  options.orbit_sigma_m = 1000.0;
  options.along_track_states = 1;
  options.forget_after_s = 100.0;
  CooperativeTracker tracker(world.beacons, options);
  world.start_near(tracker, 0, 500.0, 1000.0);
  for (std::size_t k = 1; k < world.bursts.size(); ++k) {
    static_cast<void>(tracker.update(world.bursts[k]));
    int held = 0;
    double mean = 0.0, sigma = 0.0;
    for (int i = 0; i < 66; ++i) held += tracker.along_track(i, mean, sigma) ? 1 : 0;
    EXPECT_EQ(held, 1);
    EXPECT_TRUE(tracker.along_track(world.bursts[k].beacon, mean, sigma));
  }
  EXPECT_LT(nees(tracker.estimate().mean - world.truth.back(), tracker.estimate().covariance), 60.0);
}

TEST(CooperativeTracker, OldElementsWidenTheAnswer) {
  WorldOptions o = fine(120.0);
  o.separation_m = 2e5;
  const World world(10, o);
  auto options = world.options();
  options.orbit_sigma_m = 100.0;
  options.orbit_sigma_mps = 0.02;
  double sigma[2];
  for (int k = 0; k < 2; ++k) {
    auto beacons = world.beacons;
    for (PairBeacon& beacon : beacons) beacon.epoch_s = k == 0 ? 0.0 : -14.0 * 86400.0;
    CooperativeTracker tracker(beacons, options);
    world.start_near(tracker, 0, 1000.0, 2000.0);
    for (std::size_t i = 1; i < world.bursts.size(); ++i) static_cast<void>(tracker.update(world.bursts[i]));
    sigma[k] = std::sqrt(tracker.estimate().covariance.topLeftCorner<3, 3>().trace());
    EXPECT_LT(position_error(tracker, world.truth.back()), 6.0 * sigma[k] + 50.0);
  }
  EXPECT_GT(sigma[1], 2.0 * sigma[0]);
}

TEST(CooperativeTracker, SmoothsTheWholeInterval) {
  WorldOptions o;
  o.speed_mps = {9.0, 6.0};
  double filtered = 0.0, smoothed = 0.0, sum = 0.0;
  int n = 0;
  for (std::uint64_t seed = 50; seed < 54; ++seed) {
    const World world(seed, o);
    auto options = world.options();
    options.acceleration_psd_m2ps3 = 0.02;
    options.velocity_sigma_mps = 15.0;
    options.smoother_capacity = 400;
    CooperativeTracker tracker(world.beacons, options);
    PairVector x = world.truth[0], sigma;
    sigma << Vector3d::Constant(500.0), Vector3d::Constant(15.0), 1e4, 30.0;
    x += 0.3 * sigma;
    tracker.start_at(world.bursts[0].t_s, x, PairSquare(sigma.cwiseAbs2().asDiagonal()));
    std::vector<PairEstimate> forwards{tracker.estimate()};
    for (std::size_t k = 1; k < world.bursts.size(); ++k) {
      static_cast<void>(tracker.update(world.bursts[k]));
      forwards.push_back(tracker.estimate());
    }
    ASSERT_EQ(tracker.smooth(), SmoothStatus::kDone);
    const auto states = tracker.smoothed();
    ASSERT_EQ(states.size(), forwards.size());
    EXPECT_EQ(states.back().state.x, forwards.back().mean);
    for (std::size_t k = 0; k < states.size(); ++k) {
      EXPECT_EQ(tracker.smoothed_t_s()[k], world.bursts[k].t_s);
      const auto trace = [](const PairSquare& P) { return P(0, 0) + P(1, 1) + P(2, 2); };
      EXPECT_LE(trace(states[k].P), trace(forwards[k].covariance) * 1.01);
      filtered += (forwards[k].mean - world.truth[k]).head<3>().squaredNorm();
      smoothed += (states[k].state.x - world.truth[k]).head<3>().squaredNorm();
      if (k % 40 == 0) {
        sum += nees(states[k].state.x - world.truth[k], states[k].P);
        ++n;
      }
    }
  }
  EXPECT_LT(smoothed, 0.7 * filtered);
  EXPECT_LT(sum / n, 16.0);
}

TEST(CooperativeTracker, SmoothingStopsWhereItsRoomEndsAndIsRefusedBesideAlongTrackStates) {
  const World world(11);
  auto options = world.options();
  options.smoother_capacity = 20;
  CooperativeTracker tracker(world.beacons, options);
  EXPECT_EQ(tracker.smooth(), SmoothStatus::kDone);
  EXPECT_TRUE(tracker.smoothed().empty());
  world.start_near(tracker, 0, 100.0, 200.0);
  for (std::size_t k = 1; k < 40; ++k) static_cast<void>(tracker.update(world.bursts[k]));
  EXPECT_EQ(tracker.smooth(), SmoothStatus::kFull);
  EXPECT_EQ(tracker.smoothed().size(), 20U);
  options.along_track_states = 2;
  options.orbit_sigma_m = 100.0;
  EXPECT_THROW(CooperativeTracker(world.beacons, options), std::invalid_argument);
}

TEST(CooperativeTracker, DoesNotAllocateAfterConstruction) {
  if (!soopnav::test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  WorldOptions o;
  o.duration_s = 60.0;
  const World world(12, o);
  for (const int form : {0, 1, 2}) {
    auto options = world.options();
    options.iterations = form == 2 ? 4 : 1;
    if (form == 1) options.form = PairForm::kInformation;
    if (form == 0) options.smoother_capacity = 100;
    if (form == 2) {
      options.along_track_states = 2;
      options.orbit_sigma_m = 100.0;
      options.acceleration_psd_m2ps3 = 0.1;
      options.road_p_e = {world.target - 2e3 * world.east, world.target + 8e3 * world.east};
    }
    CooperativeTracker tracker(world.beacons, options);
    world.start_near(tracker, 0, 100.0, 200.0);
    const long made = soopnav::test::allocations_of([&] {
      for (std::size_t k = 1; k < world.bursts.size(); ++k) static_cast<void>(tracker.update(world.bursts[k]));
      static_cast<void>(tracker.coast(100.0));
      static_cast<void>(tracker.estimate());
    });
    EXPECT_EQ(made, 0) << form;
    EXPECT_GT(count(tracker, PairUse::kAccepted), 40) << form;
  }
}

TEST(PairStart, SaysWhenTwoPlacesFit) {
  // Two minutes of one satellite: left and right of its track look alike but for the Earth's turn.
  int two = 0, wrong = 0;
  for (std::uint64_t seed = 60; seed < 66; ++seed) {
    WorldOptions o;
    o.only_satellite_of = 1;
    o.duration_s = 60.0;
    o.sigma_fdoa_hz = 20.0;
    o.sigma_tdoa_s = 20e-6;
    const World world(seed, o);
    if (world.bursts.size() < 40) continue;
    CooperativeTracker tracker(world.beacons, world.options());
    const PairStart start = tracker.start(world.bursts);
    two += start.status == PairStartStatus::kAmbiguous ? 1 : 0;
    double nearest = (start.best.mean - world.truth.back()).head<3>().norm();
    for (const auto& other : start.alternatives) {
      nearest = std::min(nearest, (other.mean - world.truth.back()).head<3>().norm());
    }
    wrong += start.status == PairStartStatus::kFound && nearest > 2e5 ? 1 : 0;
    EXPECT_EQ(start.alternatives.empty(), start.status != PairStartStatus::kAmbiguous);
  }
  EXPECT_GE(two, 2);
  EXPECT_EQ(wrong, 0);
}

TEST(PairStart, LeavesOutliersOut) {
  World world(13);
  auto batch = std::vector<PairMeasurement>(until(world, 100.0).begin(), until(world, 100.0).end());
  for (const std::size_t k : {5U, 17U, 18U, 44U, 70U}) {
    batch[k].tdoa_s += 60e-6;
    batch[k].fdoa_hz -= 4000.0;
  }
  CooperativeTracker tracker(world.beacons, world.options());
  const PairStart start = tracker.start(batch);
  EXPECT_TRUE(start.ok()) << to_string(start.status);
  for (const std::size_t k : {5U, 17U, 18U, 44U, 70U}) EXPECT_EQ(start.used[k], 0) << k;
  EXPECT_EQ(std::count(start.used.begin(), start.used.end(), 0), 5);
  EXPECT_LT(nees(start.best.mean - world.truth[batch.size() - 1], start.best.covariance), 40.0);
}

TEST(PairStart, AnswersWithAStatusWhereThereIsNoPlace) {
  const World world(14);
  CooperativeTracker tracker(world.beacons, world.options());
  EXPECT_EQ(tracker.start({}).status, PairStartStatus::kTooFew);
  EXPECT_EQ(tracker.start(until(world, 5.0)).status, PairStartStatus::kTooFew);
  EXPECT_FALSE(tracker.started());
  auto bad = std::vector<PairMeasurement>(until(world, 60.0).begin(), until(world, 60.0).end());
  for (auto& m : bad) m.tdoa_s = kNoNumber;
  EXPECT_EQ(tracker.start(bad).status, PairStartStatus::kTooFew);
  PairStartOptions far;
  far.guess_p_e = -world.anchor;  // the other side of the Earth
  far.search_radius_m = 5e5;
  EXPECT_EQ(tracker.start(until(world, 60.0), far).status, PairStartStatus::kNoView);
  EXPECT_FALSE(tracker.started());
  // Bursts that nothing explains.
  RandomStream random(1);
  auto noise = std::vector<PairMeasurement>(until(world, 60.0).begin(), until(world, 60.0).end());
  for (auto& m : noise) m.fdoa_hz += 800.0 * random.normal();
  const PairStart poor = tracker.start(noise);
  EXPECT_TRUE(poor.status == PairStartStatus::kPoorFit || poor.status == PairStartStatus::kNotConverged);
}

TEST(CooperativeOptions, RefusesWhatBreaksARuleByItsName) {
  const World world(15, {.duration_s = 5.0});
  const auto refuses = [&](const char* name, auto change) {
    CooperativeOptions options = world.options();
    change(options);
    try {
      CooperativeTracker tracker(world.beacons, options);
      ADD_FAILURE() << name;
    } catch (const std::invalid_argument& error) {
      EXPECT_NE(std::string(error.what()).find(name), std::string::npos) << error.what();
    }
  };
  refuses("target_clock.white", [](auto& o) { o.target_clock.white_frequency_m2ps = -1.0; });
  refuses("anchor_clock.frequency", [](auto& o) { o.anchor_clock.frequency_walk_m2ps3 = kNoNumber; });
  refuses("acceleration_psd", [](auto& o) { o.acceleration_psd_m2ps3 = -1.0; });
  refuses("velocity_sigma", [](auto& o) { o.velocity_sigma_mps = 0.0; });
  refuses("iterations", [](auto& o) { o.iterations = 0; });
  refuses("gate_probability", [](auto& o) { o.gate_probability = 1.0; });
  refuses("mask_rad", [](auto& o) { o.mask_rad = 2.0; });
  refuses("height_m", [](auto& o) { o.height_m = 1e7; });
  refuses("height_sigma_m", [](auto& o) { o.height_sigma_m = 0.0; });
  refuses("road_p_e", [](auto& o) { o.road_p_e = {Vector3d::Zero()}; });
  refuses("road_sigma_m", [](auto& o) { o.road_sigma_m = -1.0; });
  refuses("orbit_sigma_m", [](auto& o) { o.orbit_sigma_m = kNoNumber; });
  refuses("orbit_sigma_m", [](auto& o) { o.along_track_states = 2; });
  refuses("along_track_states", [](auto& o) { o.along_track_states = 65; });
  refuses("along_track_states", [](auto& o) {
    o.along_track_states = 1;
    o.orbit_sigma_m = 1.0;
    o.form = PairForm::kInformation;
  });
  refuses("forget_after_s", [](auto& o) { o.forget_after_s = 0.0; });
  refuses("jump_after", [](auto& o) { o.jump_after = -1; });
  refuses("anchor_drift", [](auto& o) { o.anchor_drift_mps = kNoNumber; });
  EXPECT_THROW(CooperativeTracker({}, world.options()), std::invalid_argument);
  EXPECT_THROW(CooperativeTracker(world.beacons, world.options(), nullptr), std::invalid_argument);
  CooperativeTracker tracker(world.beacons, world.options());
  EXPECT_THROW(tracker.start_at(kNoNumber, PairVector::Zero(), PairSquare::Identity()), std::invalid_argument);
  EXPECT_THROW(tracker.start_at(0.0, PairVector::Zero(), PairSquare::Zero()), std::invalid_argument);
  EXPECT_THROW(tracker.start_at(0.0, PairVector::Constant(kNoNumber), PairSquare::Identity()), std::invalid_argument);
  const auto start_refuses = [&](auto change) {
    PairStartOptions search;
    change(search);
    EXPECT_THROW(tracker.start(world.bursts, search), std::invalid_argument);
  };
  start_refuses([](auto& o) { o.cell_m = 0.0; });
  start_refuses([](auto& o) { o.search_radius_m = kNoNumber; });
  start_refuses([](auto& o) { o.candidates = 0; });
  start_refuses([](auto& o) { o.min_bursts = 1; });
  start_refuses([](auto& o) { o.guess_p_e = Vector3d::Zero(); });
  start_refuses([](auto& o) { o.alpha_sigma_mps = 0.0; });
  start_refuses([](auto& o) { o.ambiguous_chi_square = -1.0; });
  start_refuses([](auto& o) { o.cell_m = 1.0; });
  for (int use = 0; use < kPairUses; ++use) EXPECT_NE(to_string(static_cast<PairUse>(use)), "unknown");
}

}  // namespace
}  // namespace soopnav::navigation
