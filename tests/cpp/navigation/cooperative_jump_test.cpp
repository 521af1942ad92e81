#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "navigation/cooperative_iterate.hpp"
#include "navigation/cooperative_world.hpp"
#include "soopnav/navigation/cooperative_inertial.hpp"
#include "soopnav/navigation/cooperative_manoeuvre.hpp"
#include "soopnav/navigation/cooperative_tracker.hpp"

namespace soopnav::navigation {
namespace {

using pair_test::count;
using pair_test::nees;
using pair_test::position_error;
using pair_test::until;
using pair_test::World;
using pair_test::WorldOptions;

TEST(ClockJump, AClockThatJumpsIsReopenedAndThePositionStays) {
  WorldOptions o;
  o.jump_s = 0.4e-3;
  o.jump_at_s = 200.0;
  const World world(4, o);
  CooperativeTracker tracker(world.beacons, world.options());
  ASSERT_TRUE(tracker.start(until(world, 90.0)).ok());
  double worst = 0.0;
  for (std::size_t k = until(world, 90.0).size(); k < world.bursts.size(); ++k) {
    static_cast<void>(tracker.update(world.bursts[k]));
    worst = std::max(worst, position_error(tracker, world.truth[k]));
  }
  EXPECT_EQ(count(tracker, PairUse::kClockJump), 1);
  EXPECT_EQ(count(tracker, PairUse::kGated), 2);
  EXPECT_LT(worst, 400.0);
  EXPECT_NEAR(tracker.estimate().mean[6], world.truth.back()[6], 2000.0);
  EXPECT_LT(nees(tracker.estimate().mean - world.truth.back(), tracker.estimate().covariance), 40.0);

  // Never, when told so: then all bursts after the jump are refused, and nothing moves.
  auto options = world.options();
  options.jump_after = 0;
  CooperativeTracker unaware(world.beacons, options);
  ASSERT_TRUE(unaware.start(until(world, 90.0)).ok());
  for (std::size_t k = until(world, 90.0).size(); k < world.bursts.size(); ++k) {
    static_cast<void>(unaware.update(world.bursts[k]));
  }
  EXPECT_GT(count(unaware, PairUse::kGated), 50);
  EXPECT_EQ(count(unaware, PairUse::kClockJump), 0);
}

TEST(ClockJump, AFrequencyJumpReopensBoth) {
  WorldOptions o;
  o.jump_drift = 3e-7;
  o.jump_at_s = 200.0;
  const World world(6, o);
  CooperativeTracker tracker(world.beacons, world.options());
  ASSERT_TRUE(tracker.start(until(world, 90.0)).ok());
  for (std::size_t k = until(world, 90.0).size(); k < world.bursts.size(); ++k) {
    static_cast<void>(tracker.update(world.bursts[k]));
  }
  EXPECT_EQ(count(tracker, PairUse::kFrequencyJump), 1);
  EXPECT_LT(count(tracker, PairUse::kGated), 12);
  EXPECT_LT(position_error(tracker, world.truth.back()), 400.0);
  EXPECT_NEAR(tracker.estimate().mean[7], world.truth.back()[7], 5.0);
}

WorldOptions of_the_bound(WorldOptions o) {
  o.sigma_tdoa_s = 148e-9;
  o.sigma_fdoa_hz = 45e-3;
  return o;
}
double nees_now(const CooperativeTracker& tracker, const PairVector& truth) {
  return nees(tracker.estimate().mean - truth, tracker.estimate().covariance);
}
// All bursts after the first, from a start near the truth.
void run(CooperativeTracker& tracker, const World& world) {
  world.start_near(tracker, 0, 100.0, 200.0);
  for (std::size_t k = 1; k < world.bursts.size(); ++k) static_cast<void>(tracker.update(world.bursts[k]));
}
std::unique_ptr<CooperativeFilter> engine(int kind, const World& world) {
  const clock::ClockNoise both = world.clock + world.clock;
  if (kind == 0) return joseph_filter({.clock_noise = both});
  if (kind == 1) return information_filter({.clock_noise = both});
  if (kind == 2) {
    ManoeuvreOptions o;
    o.clock_noise = both;
    return manoeuvre_filter(o);
  }
  InertialPairOptions o;
  o.clock_noise = both;
  o.gap = {.rate_sigma_radps = 1e-6, .acceleration_sigma_mps2 = 1e-4};
  o.smoother_steps = 200;
  return inertial_filter(o);
}

TEST(ClockJump, IsNotSmoothedBackOntoEarlierTimes) {
  WorldOptions o;
  o.duration_s = 120.0;
  o.jump_s = 0.4e-3;
  o.jump_at_s = 80.0;
  const World world(4, o);
  auto options = world.options();
  options.smoother_capacity = static_cast<int>(world.bursts.size());  // the jump takes a spare one
  CooperativeTracker tracker(world.beacons, options);
  run(tracker, world);
  ASSERT_EQ(count(tracker, PairUse::kClockJump), 1);
  ASSERT_EQ(tracker.smooth(), SmoothStatus::kDone);
  const auto smoothed = tracker.smoothed();
  ASSERT_EQ(smoothed.size(), world.bursts.size() + 1);
  std::size_t k = 0;
  for (; tracker.smoothed_t_s()[k] < o.jump_at_s; ++k) {
    const PairVector error = smoothed[k].state.x - world.truth[k];
    EXPECT_LT(std::abs(error[6]), 5.0 * std::sqrt(smoothed[k].P(6, 6))) << k;
    EXPECT_LT(std::sqrt(smoothed[k].P(6, 6)), 500.0) << k;
  }
  EXPECT_GT(k, 70U);
  EXPECT_EQ(smoothed.back().state.x, tracker.estimate().mean);
}

TEST(ClockJump, IsNotSmoothedBackByTheInertialEngineEither) {
  WorldOptions o;
  o.duration_s = 120.0;
  o.jump_s = 0.4e-3;
  o.jump_at_s = 80.0;
  const World world(4, o);
  const auto sound = [&](InertialFilter& filter, std::size_t steps) {
    const auto all = filter.smooth();
    ASSERT_EQ(all.size(), steps);
    std::size_t k = 0;
    for (; all[k].t_s < o.jump_at_s; ++k) {
      const double error = all[k].mean[6] - world.truth[k][6];
      EXPECT_LT(std::abs(error), 5.0 * std::sqrt(all[k].covariance(6, 6))) << k;
      EXPECT_LT(std::sqrt(all[k].covariance(6, 6)), 500.0) << k;
    }
    EXPECT_GT(k, 70U);
  };
  CooperativeTracker tracker(world.beacons, world.options(), engine(3, world));
  run(tracker, world);
  ASSERT_EQ(count(tracker, PairUse::kClockJump), 1);
  // Nothing had been learnt in the step of the jump: it is noise of its prediction.
  sound(dynamic_cast<InertialFilter&>(tracker.engine()), world.bursts.size());

  // Reopened after an update: the step is cut, and what was undone is not there.
  const auto own = engine(3, world);
  PairVector sigma;
  sigma << Eigen::Vector3d::Constant(200.0), Eigen::Vector3d::Constant(1e-3), 1e5, 300.0;
  own->restart(world.bursts[0].t_s, world.truth[0], PairSquare(sigma.cwiseAbs2().asDiagonal()));
  for (std::size_t k = 1; k < world.bursts.size(); ++k) {
    const PairMeasurement& m = world.bursts[k];
    if (m.t_s >= o.jump_at_s && world.bursts[k - 1].t_s < o.jump_at_s) {
      own->save();
      ASSERT_EQ(own->reopen_clock(1e4, 1.0), UpdateStatus::kAccepted);
      own->load();
      ASSERT_EQ(own->shift_clock(1e5, 0.0), UpdateStatus::kAccepted);
      ASSERT_EQ(own->reopen_clock(1e10, 0.0), UpdateStatus::kAccepted);
    }
    ASSERT_EQ(own->predict(m.t_s - world.bursts[k - 1].t_s, nullptr), UpdateStatus::kAccepted);
    PairObservation observed;
    ASSERT_TRUE(pair_observation(m, observed));
    const PairModel<> model{
        &world.beacons[static_cast<std::size_t>(m.beacon)].orbit, m.t_s, m.anchor_p_e, m.anchor_v_e, {}, 0.0};
    ASSERT_TRUE(own->update(model, m.beacon, observed, {}).accepted());
  }
  sound(dynamic_cast<InertialFilter&>(*own), world.bursts.size() + 1);
}

TEST(ClockJump, OfAnySizeLeavesTheRestSound) {
  for (const double jump_s : {1e-3, 30.0, 1e3, 1e5}) {
    WorldOptions o;
    o.duration_s = 100.0;
    o.jump_s = jump_s;
    o.jump_at_s = 60.0;
    const World world(4, of_the_bound(o));
    for (int kind = 0; kind < 4; ++kind) {
      CooperativeTracker tracker(world.beacons, world.options(), engine(kind, world));
      run(tracker, world);
      EXPECT_EQ(count(tracker, PairUse::kClockJump), 1) << jump_s << ", engine " << kind;
      EXPECT_EQ(count(tracker, PairUse::kGated), 2) << jump_s << ", engine " << kind;
      EXPECT_EQ(count(tracker, PairUse::kBadState), 0) << jump_s << ", engine " << kind;
      EXPECT_LT(nees_now(tracker, world.truth.back()), 30.0) << jump_s << ", engine " << kind;
    }
  }
}

TEST(ClockJump, AbsurdBurstsPoisonNothing) {
  const World world(5, {.duration_s = 60.0});
  CooperativeTracker tracker(world.beacons, world.options());
  run(tracker, world);
  const PairEstimate before = tracker.estimate();
  PairMeasurement bad = world.bursts.back();
  for (const double tdoa_s : {1e100, -1e300, 2e6}) {
    for (int k = 0; k < 4; ++k) {
      bad.tdoa_s = tdoa_s;
      EXPECT_EQ(tracker.update(bad).use, PairUse::kNotFinite);
    }
  }
  bad = world.bursts.back();
  for (const double fdoa_hz : {1e20, -1e7}) {
    for (int k = 0; k < 4; ++k) {
      bad.fdoa_hz = fdoa_hz;
      bad.beacon = k;
      EXPECT_EQ(tracker.update(bad).use, PairUse::kNotFinite);
    }
  }
  EXPECT_EQ(tracker.estimate().mean, before.mean);
  EXPECT_EQ(tracker.estimate().covariance, before.covariance);
}

// An engine whose every update finds its own covariance unsound.
class Unsound final : public CooperativeFilter {
 public:
  void restart(double, const PairVector& mean, const PairSquare& P) override {
    mean_ = mean;
    P_ = P;
  }
  UpdateStatus predict(double, PairSquare*) noexcept override { return UpdateStatus::kAccepted; }
  UpdateReport<2> update(const PairModel<>&, int, const PairObservation&, const Gate&) noexcept override {
    UpdateReport<2> report;
    report.status = UpdateStatus::kNotPositiveDefinite;
    return report;
  }
  UpdateReport<1> update(const PlaneDistance<>&, double, double) noexcept override { return UpdateReport<1>(); }
  UpdateStatus reopen_clock(double, double) noexcept override { return UpdateStatus::kAccepted; }
  [[nodiscard]] PairVector mean() const noexcept override { return mean_; }
  [[nodiscard]] PairSquare covariance() const noexcept override { return P_; }
  void save() noexcept override {}
  void load() noexcept override {}

 private:
  PairVector mean_;
  PairSquare P_;
};

TEST(ClockJump, AnUnsoundStateIsNotTheBurstsFault) {
  const World world(5, {.duration_s = 20.0});
  CooperativeTracker tracker(world.beacons, world.options(), std::make_unique<Unsound>());
  world.start_near(tracker, 0, 100.0, 200.0);
  PairMeasurement m = world.bursts[1];
  EXPECT_EQ(tracker.update(m).use, PairUse::kBadState);
  m.covariance(0, 1) = 0.5 * std::sqrt(m.covariance(0, 0) * m.covariance(1, 1));  // not symmetric
  EXPECT_EQ(tracker.update(m).use, PairUse::kBadCovariance);
}

struct Steps {
  double nees = 0.0;
  int found = 0, runs = 0;
};
Steps small_steps(double jump_s, double jump_drift) {
  Steps out;
  for (std::uint64_t seed = 100; seed < 112; ++seed) {
    WorldOptions o;
    o.duration_s = 300.0;
    o.jump_s = jump_s;
    o.jump_drift = jump_drift;
    o.jump_at_s = 200.0;
    const World world(seed, o);
    CooperativeTracker tracker(world.beacons, world.options());
    run(tracker, world);
    const double n = nees_now(tracker, world.truth.back());
    out.nees += n / 12.0;
    out.found += count(tracker, PairUse::kClockJump) + count(tracker, PairUse::kFrequencyJump) > 0 ? 1 : 0;
    ++out.runs;
  }
  return out;
}

TEST(ClockJump, InsideTheGateOfOneBurstIsSeenByMany) {
  for (const auto& [jump_s, jump_drift] : {std::pair{4e-6, 0.0}, std::pair{10e-6, 0.0}, std::pair{0.0, 5e-9}}) {
    const Steps steps = small_steps(jump_s, jump_drift);
    EXPECT_EQ(steps.found, steps.runs) << jump_s << " " << jump_drift;
    EXPECT_LT(steps.nees, 8.5) << jump_s << " " << jump_drift;  // 5 x 12 degrees: once in 1700 by chance
  }
}

TEST(ClockJump, IsNotSeenWhereThereIsNone) {
  // Four tests of 1e-7 at each of 3600 bursts: an alarm once in 700 such tests.
  const Steps steps = small_steps(0.0, 0.0);
  EXPECT_EQ(steps.found, 0);
  EXPECT_GT(steps.nees, 2.0);
  EXPECT_LT(steps.nees, 8.5);
}

TEST(ClockJump, OfFrequencyWithOneBeaconEndsTheRefusals) {
  WorldOptions o;
  o.only_satellite_of = 1;
  o.duration_s = 150.0;
  o.jump_drift = 5e-8;
  o.jump_at_s = 60.0;
  int runs = 0;
  for (std::uint64_t seed = 30; seed < 36; ++seed) {
    const World world(seed, o);
    if (world.bursts.size() < 100) continue;
    CooperativeTracker tracker(world.beacons, world.options());
    run(tracker, world);
    ++runs;
    EXPECT_LT(count(tracker, PairUse::kGated), 20) << seed;
    EXPECT_GE(count(tracker, PairUse::kFrequencyJump), 1) << seed;
    EXPECT_NEAR(tracker.estimate().mean[7], world.truth.back()[7], 5.0 * std::sqrt(tracker.estimate().covariance(7, 7)))
        << seed;
  }
  EXPECT_GE(runs, 2);
}

// An engine whose second look at a burst is refused.
struct Reluctant {
  PairVector now = PairVector::Zero(), before = now, taken = now;
  [[nodiscard]] PairVector mean() const { return now; }
  void revert() noexcept {
    taken = now;
    now = before;
  }
  void restore_taken() noexcept { now = taken; }
};
struct AnyRows {
  [[nodiscard]] static bool linearise(const PairModel<>&, const PairVector&, double) noexcept { return true; }
};

TEST(CooperativeFilter, AnIterationThatIsRefusedLeavesTheUpdateTaken) {
  Reluctant one;
  one.now[0] = 5.0;  // as an update left it, that began at zero
  iterate_pair(one, PairModel<>{}, AnyRows{}, 0.0, 4, [](const AnyRows&) { return false; });
  EXPECT_EQ(one.now[0], 5.0);
}

}  // namespace
}  // namespace soopnav::navigation
