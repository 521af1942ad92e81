// Baselines from synthetic code and phase: integers, signs, covariances, the sphere, tracking through cycle slips.

#include "soopnav/gnss/baseline.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/consistency.hpp"
#include "soopnav/gnss/receiver_differences.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::gnss {
namespace {

constexpr double kDeg = kPi / 180.0;
const double kNan = BaselineFix::kNan;

struct Scene {
  BaselineOptions options;
  std::vector<BaselineSatellite> satellites;
  std::vector<double> integers;
};

// One epoch; `noise` scales both code and phase. Elevations from 20 to 80 deg.
Scene scene(const Eigen::Vector3d& b, int count, RandomStream& random, double noise = 1.0,
            const BaselineOptions& options = {}) {
  Scene out{.options = options, .satellites = {}, .integers = {}};
  const BaselineSolver solver(options);
  const double code_clock = random.uniform(-1e4, 1e4), phase_clock = random.uniform(-1e4, 1e4);
  const double offset = random.uniform(0.0, kTwoPi);
  for (int i = 0; i < count; ++i) {
    const double az = offset + 2.4 * i, el = kDeg * (20.0 + 60.0 * ((i * 3) % count) / count);
    BaselineSatellite s;
    s.id = 10 + i;
    s.direction = {std::cos(el) * std::sin(az), std::cos(el) * std::cos(az), std::sin(el)};
    const double sigma = noise * std::sqrt(solver.phase_variance_m2(s));
    const double integer = std::round(1e6 * random.normal());
    s.code_m = -s.direction.dot(b) + code_clock + sigma * options.code_phase_ratio * random.normal();
    s.phase_cycles = (-s.direction.dot(b) + phase_clock + sigma * random.normal()) / options.wavelength_m + integer;
    out.satellites.push_back(s);
    out.integers.push_back(integer);
  }
  return out;
}

bool right_integers(const Scene& s, const BaselineFix& fix) {
  double datum = 0.0;
  for (std::size_t i = 0; i < fix.ids.size(); ++i) {
    const double truth = s.integers[static_cast<std::size_t>(fix.ids[i] - 10)];
    if (i == 0) datum = truth;
    if (fix.integers[i] != truth - datum) return false;
  }
  return fix.ids.size() >= 4;
}

const Eigen::Vector3d kBaseline(-0.223, -0.964, 0.05);

TEST(Baseline, ExactForExactData) {
  RandomStream random(41);
  for (int trial = 0; trial < 20; ++trial) {
    const Scene s = scene(kBaseline, 8, random, 0.0);
    BaselineSolver solver(s.options);
    const BaselineFix fix = solver.solve(s.satellites);
    ASSERT_EQ(fix.status, BaselineStatus::kFixed) << to_string(fix.status);
    EXPECT_TRUE(right_integers(s, fix));
    EXPECT_LT((fix.baseline_m - kBaseline).norm(), 1e-5);
    EXPECT_LT((fix.float_m - kBaseline).norm(), 1e-5);
    EXPECT_NEAR(fix.heading_rad, std::atan2(kBaseline.x(), kBaseline.y()) + kTwoPi, 1e-5);
    EXPECT_NEAR(fix.pitch_rad, std::asin(kBaseline.z() / kBaseline.norm()), 1e-5);
    for (const double r : fix.residuals_m) EXPECT_LT(std::abs(r), 1e-5);
  }
}

// Swapping base and rover turns the baseline round.
TEST(Baseline, SwappedReceiversGiveTheOppositeBaseline) {
  RandomStream random(42);
  Scene s = scene(kBaseline, 9, random, 0.3);
  BaselineSolver solver(s.options);
  const BaselineFix fix = solver.solve(s.satellites);
  for (BaselineSatellite& satellite : s.satellites) {
    satellite.code_m = -satellite.code_m;
    satellite.phase_cycles = -satellite.phase_cycles;
  }
  const BaselineFix swapped = solver.solve(s.satellites);
  ASSERT_TRUE(fix.fixed());
  ASSERT_TRUE(swapped.fixed());
  EXPECT_LT((fix.baseline_m + swapped.baseline_m).norm(), 1e-6);
  EXPECT_NEAR(std::abs(fix.heading_rad - swapped.heading_rad), kPi, 1e-6);
  EXPECT_NEAR(fix.ratio, swapped.ratio, 1e-6 * fix.ratio);
}

TEST(Baseline, CovarianceAndAnglesAreThoseOfTheErrors) {
  RandomStream random(43);
  constexpr int kRuns = 600;
  for (const bool constrained : {false, true}) {
    BaselineOptions options;
    if (constrained) options.length_m = kBaseline.norm();
    if (constrained) options.search = ConstraintSearch::kCandidates;
    double nees = 0.0, heading = 0.0, pitch = 0.0;
    for (int run = 0; run < kRuns; ++run) {
      const Scene s = scene(kBaseline, 9, random, 1.0, options);
      BaselineSolver solver(options);
      std::vector<double> known = s.integers;
      const BaselineFix fix = solver.with_integers(s.satellites, known);
      ASSERT_EQ(fix.status, BaselineStatus::kTracked);
      const Eigen::Vector3d e = fix.baseline_m - kBaseline;
      if (!constrained) {
        nees += e.dot(fix.covariance_m2.llt().solve(e)) / kRuns;
      } else {
        EXPECT_NEAR(fix.baseline_m.norm(), kBaseline.norm(), 1e-9);
        const Eigen::Matrix3d pseudo = fix.covariance_m2.completeOrthogonalDecomposition().pseudoInverse();
        nees += e.dot(pseudo * e) / kRuns;
      }
      const double to = std::atan2(kBaseline.x(), kBaseline.y()) + kTwoPi;
      heading += std::pow((fix.heading_rad - to) / fix.heading_sigma_rad, 2) / kRuns;
      pitch += std::pow((fix.pitch_rad - std::asin(kBaseline.z() / kBaseline.norm())) / fix.pitch_sigma_rad, 2) / kRuns;
    }
    const auto bounds = mean_nees_bounds(constrained ? 2 : 3, kRuns, 1e-6);
    EXPECT_GT(nees, bounds.lower) << constrained;
    EXPECT_LT(nees, bounds.upper * 1.01) << constrained;
    const auto one = mean_nees_bounds(1, kRuns, 1e-6);
    for (const double angle : {heading, pitch}) {
      EXPECT_GT(angle, one.lower) << constrained;
      EXPECT_LT(angle, one.upper * 1.01) << constrained;
    }
  }
}

TEST(Baseline, RatioTestKeepsWrongIntegersOut) {
  RandomStream random(44);
  int fixed = 0, wrong = 0, right = 0;
  BaselineSolver solver;
  for (int run = 0; run < 400; ++run) {
    const Scene s = scene(kBaseline, 9, random, 0.4);
    const BaselineFix fix = solver.solve(s.satellites);
    right += right_integers(s, fix) ? 1 : 0;
    if (!fix.fixed()) {
      EXPECT_LT(fix.ratio, 3.0);
      EXPECT_EQ(fix.baseline_m, fix.float_m);
      continue;
    }
    ++fixed;
    wrong += right_integers(s, fix) ? 0 : 1;
  }
  EXPECT_GE(right, 380);
  EXPECT_GE(fixed, 280);
  EXPECT_LE(wrong, 1);
}

// Phases without any integers: the ratio passes one in ten, and of these a third disagree with the integers they got.
TEST(Baseline, PhasesThatFitNoIntegersAreNotFixed) {
  RandomStream random(50);
  BaselineOptions options;
  options.length_m = 1.0;
  options.ratio = 2.0;
  BaselineSolver solver(options);
  constexpr int kRuns = 300;
  const double limit = chi_square_upper_quantile(1e-3, 8.0);
  int by_ratio = 0, fixed = 0, refused = 0;
  for (int run = 0; run < kRuns; ++run) {
    Scene s = scene(kBaseline.normalized(), 8, random, 1.0, options);
    for (BaselineSatellite& satellite : s.satellites) satellite.phase_cycles = random.uniform(-0.5, 0.5);
    const BaselineFix fix = solver.solve(s.satellites);
    double squares = 0.0;
    for (std::size_t i = 0; i < fix.ids.size(); ++i) {
      const auto& satellite = s.satellites[static_cast<std::size_t>(fix.ids[i] - 10)];
      squares += fix.residuals_m[i] * fix.residuals_m[i] / solver.phase_variance_m2(satellite);
    }
    by_ratio += fix.ratio >= options.ratio ? 1 : 0;
    fixed += fix.fixed() ? 1 : 0;
    refused += fix.ratio >= options.ratio && !fix.fixed() ? 1 : 0;
    if (fix.fixed()) {
      EXPECT_LE(squares, limit);
    } else {
      EXPECT_EQ(fix.baseline_m, fix.float_m);
    }
  }
  EXPECT_GT(by_ratio, kRuns / 20);
  EXPECT_GE(refused, by_ratio / 5);
  EXPECT_LT(fixed, kRuns / 10);
}

// What keeps garbage out costs right integers nothing: noise as stated, a ratio that all pass.
TEST(Baseline, NoiseAsStatedIsNotRefused) {
  RandomStream random(51);
  for (const bool constrained : {false, true}) {
    BaselineOptions options;
    options.ratio = 1.0;
    if (constrained) options.length_m = kBaseline.norm();
    BaselineSolver solver(options);
    const int runs = constrained ? 100 : 1000;
    int fixed = 0;
    for (int run = 0; run < runs; ++run) fixed += solver.solve(scene(kBaseline, 9, random).satellites).fixed() ? 1 : 0;
    EXPECT_GE(fixed, runs - runs / 100) << constrained;
  }
}

// Five satellites: without the length the integers are guesses; with it the sphere's optimum is nearly always right,
// and is never worse than what weighing LAMBDA's candidates finds.
TEST(Baseline, KnownLengthFixesFiveSatellites) {
  RandomStream random(45);
  BaselineOptions sphere;
  sphere.length_m = kBaseline.norm();
  sphere.ratio = 1.0;
  BaselineOptions candidates = sphere;
  candidates.search = ConstraintSearch::kCandidates;
  BaselineSolver free({.ratio = 1.0}), on_sphere(sphere), on_candidates(candidates);
  int without = 0, with = 0;
  for (int run = 0; run < 60; ++run) {
    const Scene s = scene(kBaseline, 5, random, 0.4);
    without += right_integers(s, free.solve(s.satellites)) ? 1 : 0;
    const BaselineFix fix = on_sphere.solve(s.satellites);
    ASSERT_TRUE(fix.fixed());
    EXPECT_NEAR(fix.baseline_m.norm(), kBaseline.norm(), 1e-9);
    with += right_integers(s, fix) ? 1 : 0;
    const BaselineFix other = on_candidates.solve(s.satellites);
    // Phase and code misfit of both, from their residuals: the sphere's is the smaller.
    const auto cost = [&](const BaselineFix& f) {
      double sum = 0.0;
      for (std::size_t i = 0; i < f.ids.size(); ++i) {
        const auto& satellite = s.satellites[static_cast<std::size_t>(f.ids[i] - 10)];
        sum += f.residuals_m[i] * f.residuals_m[i] / on_sphere.phase_variance_m2(satellite);
      }
      return sum;
    };
    if (fix.integers == other.integers) {
      EXPECT_NEAR(cost(fix), cost(other), 1e-6 * (1.0 + cost(fix)));
      EXPECT_LE(fix.ratio, other.ratio * (1.0 + 1e-6));  // the sphere may know a better second
    }
  }
  EXPECT_LT(without, 40);
  EXPECT_GE(with, 50);
  EXPECT_GT(with, without + 10);
}

TEST(Baseline, PitchLimitShrinksTheSphere) {
  RandomStream random(46);
  BaselineOptions options;
  options.length_m = kBaseline.norm();
  options.max_pitch_rad = 20.0 * kDeg;
  const Scene s = scene(kBaseline, 8, random, 0.3);
  BaselineSolver limited(options);
  EXPECT_TRUE(right_integers(s, limited.solve(s.satellites)));
  const Eigen::Vector3d steep(0.1, 0.2, 0.97);
  const Scene up = scene(steep * (kBaseline.norm() / steep.norm()), 8, random, 0.3);
  EXPECT_FALSE(right_integers(up, limited.solve(up.satellites)));
  options.max_pitch_rad = 0.5 * kPi;
  EXPECT_TRUE(right_integers(up, BaselineSolver(options).solve(up.satellites)));
}

TEST(Baseline, BadInputGivesAStatus) {
  RandomStream random(47);
  Scene s = scene(kBaseline, 8, random);
  BaselineSolver solver;
  EXPECT_EQ(solver.solve({}).status, BaselineStatus::kTooFewSatellites);
  EXPECT_EQ(solver.solve({s.satellites.data(), 3}).status, BaselineStatus::kTooFewSatellites);
  auto broken = s.satellites;
  for (std::size_t i = 0; i < 5; ++i) broken[i].phase_cycles = kNan;
  EXPECT_EQ(solver.solve(broken).status, BaselineStatus::kTooFewSatellites);
  EXPECT_TRUE(std::isnan(solver.solve(broken).baseline_m.x()));
  auto low = s.satellites;
  for (BaselineSatellite& satellite : low) satellite.direction = {std::cos(0.1), 0.0, std::sin(0.1)};
  EXPECT_EQ(solver.solve(low).status, BaselineStatus::kTooFewSatellites);
  // All at one elevation lie on a cone: height and clock cannot be told apart.
  auto cone = s.satellites;
  for (std::size_t i = 0; i < cone.size(); ++i) {
    const double az = 0.8 * static_cast<double>(i);
    cone[i].direction = {std::cos(1.0) * std::sin(az), std::cos(1.0) * std::cos(az), std::sin(1.0)};
  }
  EXPECT_EQ(solver.solve(cone).status, BaselineStatus::kDegenerate);
  // Numbers that are finite and absurd.
  auto absurd = s.satellites;
  for (std::size_t i = 0; i < absurd.size(); ++i) absurd[i].code_m = (i % 2 == 0 ? 1.0 : -1.0) * 1e300;
  const BaselineFix none = BaselineSolver({.length_m = 1.0}).solve(absurd);
  EXPECT_FALSE(none.fixed());
  EXPECT_FALSE(std::isnan(none.baseline_m.x()) && none.status == BaselineStatus::kFloat);
  for (const bool constrained : {false, true}) {
    BaselineOptions options;
    if (constrained) options.length_m = 1.0;
    BaselineSolver any(options);
    BaselineTracker tracker(options);
    for (const double size : {1e9, 1e12, 1.1e12, 1e17, 1e155, 1e300}) {
      for (const bool code : {false, true}) {
        for (std::size_t i = 0; i < absurd.size(); ++i) {
          absurd[i] = s.satellites[i];
          (code ? absurd[i].code_m : absurd[i].phase_cycles) = size * random.uniform(-1.0, 1.0);
        }
        absurd[0].code_m = absurd[0].phase_cycles = size;
        const BaselineFix fix = any.solve(absurd);
        EXPECT_FALSE(std::isinf(fix.ratio)) << size << code;
        EXPECT_EQ(std::isnan(fix.heading_rad), std::isnan(fix.baseline_m.x())) << size << code;
        EXPECT_EQ(any.usable(absurd[0]), size <= 1e12);
        if (size > 1e13) {
          EXPECT_FALSE(fix.fixed()) << size << code;
          EXPECT_FALSE(tracker.step(absurd).fixed()) << size << code;
        }
      }
    }
  }
  // Integers that are none, and a wavelength that overflows.
  for (const double integer : {kNan, std::numeric_limits<double>::infinity(), 1e300}) {
    std::vector<double> known = s.integers;
    known[2] = integer;
    const BaselineFix fix = solver.with_integers(s.satellites, known);
    EXPECT_EQ(fix.status, BaselineStatus::kDegenerate) << integer;
    EXPECT_TRUE(std::isnan(fix.baseline_m.x()));
  }
  EXPECT_EQ(BaselineSolver({.wavelength_m = 1e200}).solve(s.satellites).status, BaselineStatus::kDegenerate);
  // A code that is far off moves the float, not the sphere's length.
  BaselineOptions length;
  length.length_m = 1.5;
  BaselineSolver wrong(length);
  const BaselineFix misfit = wrong.solve(s.satellites);  // the true length is 0.99 m
  EXPECT_TRUE(!misfit.fixed() || std::abs(misfit.baseline_m.norm() - 1.5) < 1e-9);
  EXPECT_FALSE(misfit.fixed() && right_integers(s, misfit));

  BaselineOptions bad;
  const auto refused = [](BaselineOptions o) { EXPECT_THROW(BaselineSolver{o}, std::invalid_argument); };
  refused({.wavelength_m = 0.0});
  refused({.phase_sigma_m = -1.0});
  refused({.code_phase_ratio = 1.0});
  refused({.mask_rad = 2.0});
  refused({.ratio = 0.5});
  refused({.length_m = 0.0});
  refused({.length_m = 11.0});
  refused({.candidates = 1});
  refused({.max_pitch_rad = 0.0});
  refused({.max_satellites = 3});
  EXPECT_NO_THROW(BaselineSolver({.length_m = 11.0, .search = ConstraintSearch::kCandidates}));
}

// A receiver pair that turns: phases go on, integers stay, slips of one satellite are found, named and repaired.
TEST(BaselineTracker, CarriesIntegersThroughSlips) {
  for (const bool constrained : {false, true}) {
    RandomStream random(48);
    BaselineOptions options;
    if (constrained) options.length_m = kBaseline.norm();
    BaselineTracker tracker(options);
    Scene first = scene(kBaseline, 8, random, 0.0, options);
    std::vector<double> integers = first.integers;
    const auto epoch = [&](double turn) {
      const Eigen::Vector3d b = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()) * kBaseline;
      auto out = first.satellites;
      const double clock = random.uniform(-1e3, 1e3);
      for (std::size_t i = 0; i < out.size(); ++i) {
        const double range = -out[i].direction.dot(b) + clock;
        out[i].code_m = range + 0.1 * random.normal();
        out[i].phase_cycles = (range + 0.002 * random.normal()) / options.wavelength_m + integers[i];
      }
      return std::pair(out, b);
    };
    auto [start, b0] = epoch(0.0);
    BaselineFix fix = tracker.step(start);
    ASSERT_EQ(fix.status, BaselineStatus::kFixed);
    for (int k = 1; k <= 50; ++k) {
      const bool slips = k == 20;
      if (slips) integers[3] += 1.0;
      auto [satellites, b] = epoch(0.05 * k);
      if (k == 30) integers[5] += 7.0;
      if (k == 30) std::tie(satellites, b) = epoch(0.05 * k);
      if (k == 30) satellites[5].lost_lock = true;
      fix = tracker.step(satellites);
      ASSERT_EQ(fix.status, BaselineStatus::kTracked) << k;
      EXPECT_LT((fix.baseline_m - b).norm(), 0.03) << k;
      ASSERT_EQ(fix.slips.size(), slips || k == 30 ? 1U : 0U) << k;
      if (slips) {
        EXPECT_EQ(fix.slips[0], 13);
      }
      if (k == 30) {
        EXPECT_EQ(fix.slips[0], 15);
      }
      EXPECT_EQ(tracker.tracked(), 8U) << k;  // repaired at once
    }
    // Every count lost at once: solved anew. Then nothing in view, and back.
    for (double& n : integers) n += std::round(100.0 * random.normal());
    auto [lost, b] = epoch(3.0);
    fix = tracker.step(lost);
    EXPECT_EQ(fix.slips.size(), 8U);
    EXPECT_TRUE(fix.fixed());
    EXPECT_LT((fix.baseline_m - b).norm(), 0.03);
    EXPECT_EQ(tracker.step({}).status, BaselineStatus::kTooFewSatellites);
    EXPECT_EQ(tracker.tracked(), 0U);
    auto [back, b2] = epoch(3.1);
    EXPECT_EQ(tracker.step(back).status, BaselineStatus::kFixed);
    tracker.reset();
    EXPECT_EQ(tracker.tracked(), 0U);
  }
}

// Two receivers a metre apart whose clocks differ by 0.3 ms: the satellite moves by up to 0.25 m between them.
TEST(ReceiverDifferences, TakesTheSatellitesMotionOff) {
  const EphemerisTable table(walker_constellation());
  const geometry::LocalFrame frame({0.6, 2.4, 50.0});
  const Eigen::Vector3d rover_e = frame.position_to_ecef(kBaseline);
  const double bias_s = 3e-4, wavelength = 0.19029367;
  int seen = 0;
  double largest_motion = 0.0;
  for (const int prn : table.prns()) {
    const Epoch t = gps_epoch(2200, 1000.0);
    const auto* eph = table.find(prn, t);
    ASSERT_NE(eph, nullptr);
    // Both clocks read 1000 s: the base is right, the rover is ahead, so it reads earlier.
    const auto base = sight(*eph, t, frame.origin_ecef());
    const auto rover = sight(*eph, gps_epoch(2200, 1000.0 - bias_s), rover_e);
    ASSERT_TRUE(base && rover);
    if (frame.velocity_from_ecef(base->direction_e).z() < 0.1) continue;
    const double code_base = base->range_m - kSpeedOfLightMps * base->at_transmission.clock_s;
    const double code_rover = rover->range_m + kSpeedOfLightMps * (bias_s - rover->at_transmission.clock_s);
    const ReceiverPair pair{.prn = prn,
                            .base_code_m = code_base,
                            .rover_code_m = code_rover,
                            .base_phase_cycles = code_base / wavelength,
                            .rover_phase_cycles = code_rover / wavelength};
    const auto difference = difference_receivers(table, t, t, frame, pair, wavelength);
    ASSERT_TRUE(difference.has_value());
    EXPECT_NEAR(difference->code_m, -difference->direction.dot(kBaseline) + kSpeedOfLightMps * bias_s, 1e-4);
    EXPECT_NEAR(difference->phase_cycles * wavelength, difference->code_m, 1e-4);
    largest_motion = std::max(largest_motion, std::abs(code_rover - code_base - difference->code_m));
    ++seen;
    ReceiverPair missing = pair;
    missing.rover_phase_cycles = kNan;
    EXPECT_FALSE(difference_receivers(table, t, t, frame, missing, wavelength).has_value());
    missing = pair;
    missing.prn = 60;
    EXPECT_FALSE(difference_receivers(table, t, t, frame, missing, wavelength).has_value());
  }
  EXPECT_GE(seen, 5);
  EXPECT_GT(largest_motion, 0.05);  // without which the test would show nothing
}

TEST(NoAllocation, Baselines) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "this allocator cannot be counted";
  RandomStream random(49);
  BaselineOptions options;
  options.length_m = kBaseline.norm();
  const Scene s = scene(kBaseline, 9, random, 1.0, options);
  BaselineSolver free, sphere(options);
  BaselineTracker tracker(options);
  int fixed = 0;
  EXPECT_EQ(test::allocations_of([&] {
              fixed += free.solve(s.satellites).fixed() ? 1 : 0;
              fixed += sphere.solve(s.satellites).fixed() ? 1 : 0;
              fixed += tracker.step(s.satellites).fixed() ? 1 : 0;
              fixed += tracker.step(s.satellites).fixed() ? 1 : 0;
            }),
            0);
  EXPECT_GE(fixed, 3);
}

}  // namespace
}  // namespace soopnav::gnss
