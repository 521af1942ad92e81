#include "soopnav/gnss/gps_phase.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/geometry/wgs84.hpp"

namespace soopnav::gnss {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kL1M = kSpeedOfLightMps / kL1Hz, kL2M = kSpeedOfLightMps / kL2Hz;
constexpr std::int64_t kWeek = 2200;
constexpr double kStartS = 302'400.0;

// A standing antenna's measurements, made from the model that solve_static_phase states.
struct World {
  std::vector<Ephemeris> ephemerides;
  Eigen::Vector3d place;
  std::vector<int> prn;
  std::vector<double> week, second, code1, code2, phase1, phase2;
  std::vector<std::uint8_t> lost;

  [[nodiscard]] std::size_t satellites() const { return prn.size(); }
  [[nodiscard]] PhaseTable table() const { return {prn, week, second, code1, code2, phase1, phase2, lost}; }
  [[nodiscard]] StaticPhaseFix solve(const StaticPhaseOptions& options = {}) const {
    return solve_static_phase(EphemerisTable(ephemerides), std::nullopt, table(), options);
  }
};

World make_world(std::uint64_t seed, std::size_t epochs = 200, double range_error_m = 0.0, double zenith_m = 0.05) {
  World world;
  world.ephemerides =
      walker_constellation({.satellites = 30, .planes = 6, .phasing = 1, .week = kWeek, .toe_s = kStartS});
  for (Ephemeris& eph : world.ephemerides) eph.tgd_s = 5e-9 * eph.prn / 30.0;
  world.place = geometry::geodetic_to_ecef({0.7, 2.4, 120.0});
  const geometry::LocalFrame frame(geometry::Geodetic{0.7, 2.4, 120.0});
  RandomStream random(seed);
  std::vector<double> constant1, constant2, error, ionosphere, wind(30, 0.0);
  for (const Ephemeris& eph : world.ephemerides) {
    world.prn.push_back(eph.prn);
    constant1.push_back(std::round(random.normal(0.0, 1e6)));
    constant2.push_back(std::round(random.normal(0.0, 1e6)));
    error.push_back(random.normal(0.0, range_error_m));
    ionosphere.push_back(random.uniform(2.0, 8.0));
  }
  const double ratio = (kL1Hz * kL1Hz) / (kL2Hz * kL2Hz);
  const double zenith_map = troposphere_delay_m({0.7, 2.4, 120.0}, 0.5 * kPi);
  for (std::size_t k = 0; k < epochs; ++k) {
    const double clock_s = 1e-5 + 2e-8 * static_cast<double>(k);
    world.week.push_back(static_cast<double>(kWeek));
    world.second.push_back(kStartS + static_cast<double>(k));
    const Epoch received = gps_epoch(kWeek, world.second.back()) + (-clock_s);
    for (std::size_t i = 0; i < 30; ++i) {
      const auto seen = sight(world.ephemerides[i], received, world.place);
      const auto direction = frame.direction_to(seen->position_e);
      if (direction->elevation_rad < 0.17) {
        for (auto* v : {&world.code1, &world.code2, &world.phase1, &world.phase2}) v->push_back(kNan);
        world.lost.push_back(0);
        continue;
      }
      const double dry = troposphere_delay_m({0.7, 2.4, 120.0}, direction->elevation_rad);
      wind[i] = phase_wind_up_cycles(seen->position_e, sun_direction_e(received), world.place, wind[i]).value();
      const double dt = seen->at_transmission.clock_s + world.ephemerides[i].tgd_s;
      const double range =
          seen->range_m + kSpeedOfLightMps * (clock_s - dt) + dry * (1.0 + zenith_m / zenith_map) + error[i];
      const double io = ionosphere[i] * (1.0 + 1e-3 * static_cast<double>(k));
      world.code1.push_back(range + io + random.normal(0.0, 0.3));
      world.code2.push_back(range + ratio * io + random.normal(0.0, 0.3));
      world.phase1.push_back((range - io + random.normal(0.0, 0.002)) / kL1M + wind[i] + constant1[i]);
      world.phase2.push_back((range - ratio * io + random.normal(0.0, 0.002)) / kL2M + wind[i] + constant2[i]);
      world.lost.push_back(0);
    }
  }
  return world;
}

TEST(PhaseCombinations, IonosphereAndRangesDropOut) {
  const double ratio = (kL1Hz * kL1Hz) / (kL2Hz * kL2Hz);
  EXPECT_NEAR(ionosphere_free_m(2e7 + 5.0, 2e7 + 5.0 * ratio), 2e7, 1e-6);
  const double range = 2.1e7, io = 7.0;
  const double wide =
      wide_lane_cycles((range - io) / kL1M + 17.0, (range - ratio * io) / kL2M + 5.0, range + io, range + ratio * io);
  EXPECT_NEAR(wide, 12.0, 1e-6);
}

TEST(SunDirection, EquinoxSolsticeAndNoon) {
  // 2021-03-20 09:37 UTC equinox: GPS week 2149, second 553020 + 18.
  const Eigen::Vector3d equinox = sun_direction_e(gps_epoch(2149, 553'038.0));
  EXPECT_NEAR(equinox.norm(), 1.0, 1e-12);
  EXPECT_NEAR(std::asin(equinox[2]), 0.0, 0.002);
  // Nearly noon at 36 degrees east then, less the equation of time of 7.4 minutes: 37.6.
  EXPECT_NEAR(std::atan2(equinox[1], equinox[0]) * 180.0 / kPi, 15.0 * (12.0 - 9.617) + 1.86, 0.3);
  // 2021-06-21 03:32 UTC solstice: week 2163, second 98 838.
  EXPECT_NEAR(std::asin(sun_direction_e(gps_epoch(2163, 98'838.0))[2]) * 180.0 / kPi, 23.436, 0.02);
  EXPECT_TRUE(std::isnan(sun_direction_e(Epoch::invalid(TimeScale::kGps))[0]));
}

TEST(PhaseWindUp, ContinuesAndTurnsWithTheSatellite) {
  const auto ephemerides = walker_constellation({.week = kWeek, .toe_s = kStartS});
  const Eigen::Vector3d place = geometry::geodetic_to_ecef({0.7, 2.4, 120.0});
  double before = 0.0, least = 0.0, most = 0.0;
  for (int k = 0; k < 3600; k += 10) {
    const Epoch t = gps_epoch(kWeek, kStartS + k);
    const auto seen = sight(ephemerides[3], t, place);
    const double now = phase_wind_up_cycles(seen->position_e, sun_direction_e(t), place, before).value();
    if (k > 0) {
      EXPECT_LT(std::abs(now - before), 0.01) << k;  // no jump by a cycle
    }
    before = now;
    least = std::min(least, now);
    most = std::max(most, now);
  }
  EXPECT_GT(most - least, 1e-3);
  const Eigen::Vector3d up = 26.6e6 * place.normalized();
  const Eigen::Vector3d sun = sun_direction_e(gps_epoch(kWeek, kStartS));
  const double one = phase_wind_up_cycles(up, sun, place, 0.0).value();
  EXPECT_NEAR(phase_wind_up_cycles(up, sun, place, 5.0).value() - one, 5.0, 0.51);
  EXPECT_FALSE(phase_wind_up_cycles(place, sun, place).has_value());
  EXPECT_FALSE(phase_wind_up_cycles(up, Eigen::Vector3d::Constant(kNan), place).has_value());
}

TEST(StaticPhase, FindsThePositionOfItsOwnModel) {
  const World world = make_world(1);
  StaticPhaseOptions options;
  options.range_error_sigma_m = 1e-3;
  options.range_error_rate_mps = 1e-7;
  options.phase_correlation_s = 0.0;
  const StaticPhaseFix fix = world.solve(options);
  ASSERT_EQ(fix.status, StaticPhaseStatus::kSolved);
  const Eigen::Vector3d error = fix.position_e - world.place;
  EXPECT_LT(error.dot(fix.covariance_m2.llt().solve(error)), 21.1);  // once in 1e4
  EXPECT_LT(error.norm(), 0.3);
  EXPECT_NEAR(fix.zenith_m, 0.05, 5.0 * fix.zenith_sigma_m);
  EXPECT_NEAR(fix.phase_rms_m, 0.002 * 2.98, 0.0006);
  EXPECT_EQ(fix.slips, 0U);
  EXPECT_EQ(fix.rejected, 0U);
  EXPECT_NEAR(fix.clock_m[100] / kSpeedOfLightMps, 1e-5 + 2e-6, 3e-9);
}

TEST(StaticPhase, CovarianceIsHonestForTheBroadcastsErrors) {
  double nees = 0.0, formal = 0.0;
  constexpr int kRuns = 12;
  for (std::uint64_t seed = 1; seed <= kRuns; ++seed) {
    const World world = make_world(seed, 60, 1.0);
    const StaticPhaseFix fix = world.solve();
    ASSERT_EQ(fix.status, StaticPhaseStatus::kSolved);
    const Eigen::Vector3d error = fix.position_e - world.place;
    nees += error.dot(fix.covariance_m2.llt().solve(error));
    formal += error.dot(fix.formal_m2.llt().solve(error));
  }
  // Chi-square of 36 degrees of freedom: 9.8 ... 78 all but twice in 1e5.
  EXPECT_GT(nees, 9.0);
  EXPECT_LT(nees, 80.0);
  EXPECT_GT(formal, 2.0 * nees);
}

TEST(StaticPhase, SlipsBeginNewConstants) {
  World world = make_world(2);
  const std::size_t s = world.satellites();
  std::vector<std::size_t> high;
  for (std::size_t i = 0; i < s; ++i) {
    bool all = true;
    for (std::size_t k = 0; k < 200; ++k) all = all && std::isfinite(world.code1[k * s + i]);
    if (all) high.push_back(i);
  }
  ASSERT_GE(high.size(), 5U);
  const StaticPhaseFix before = world.solve();
  // One cycle of both, one of L1, (9, 7) that the geometry-free hardly sees, and the receiver's word.
  const double first[] = {1.0, 1.0, 9.0, 0.0}, second[] = {1.0, 0.0, 7.0, 0.0};
  for (std::size_t j = 0; j < 4; ++j) {
    for (std::size_t k = 80 + 5 * j; k < 200; ++k) {
      world.phase1[k * s + high[j]] += first[j];
      world.phase2[k * s + high[j]] += second[j];
    }
  }
  world.lost[95 * s + high[3]] = 1;
  const StaticPhaseFix after = world.solve();
  ASSERT_EQ(after.status, StaticPhaseStatus::kSolved);
  EXPECT_EQ(after.slips, 4U + before.slips);
  EXPECT_EQ(after.arcs, 4U + before.arcs);
  EXPECT_LT((after.position_e - before.position_e).norm(), 0.1);
  EXPECT_NE(after.arc[79 * s + high[0]], after.arc[80 * s + high[0]]);
}

TEST(StaticPhase, NumbersThatAreNoneAndPartialSatellitesAreNamed) {
  World world = make_world(3);
  const std::size_t s = world.satellites();
  const StaticPhaseFix before = world.solve();
  std::size_t partial = s;
  for (std::size_t i = 0; i < s && partial == s; ++i) {
    if (std::isfinite(world.code1[i])) partial = i;
  }
  for (std::size_t k = 0; k < 200; ++k) world.phase2[k * s + partial] = k % 2 == 0 ? kNan : HUGE_VAL;
  const StaticPhaseFix fix = world.solve();
  ASSERT_EQ(fix.status, StaticPhaseStatus::kSolved);
  EXPECT_EQ(fix.use[partial], static_cast<std::uint8_t>(PhaseUse::kPartial));
  EXPECT_LT((fix.position_e - before.position_e).norm(), 2.0);
  EXPECT_TRUE(std::isnan(fix.phase_residual_m[partial]));
}

TEST(StaticPhase, WhatDataCannotGiveIsAStatus) {
  World none = make_world(4, 40);
  for (auto* v : {&none.code1, &none.code2, &none.phase1, &none.phase2}) std::fill(v->begin(), v->end(), kNan);
  const StaticPhaseFix empty = none.solve();
  EXPECT_EQ(empty.status, StaticPhaseStatus::kTooFewSatellites);
  EXPECT_TRUE(std::isnan(empty.position_e[0]));
  EXPECT_EQ(World{}.solve().status, StaticPhaseStatus::kTooFewSatellites);

  const World brief = make_world(4, 20);
  EXPECT_EQ(brief.solve().status, StaticPhaseStatus::kTooShort);  // 30 epochs are asked for

  World slipping = make_world(4, 60);  // every epoch
  for (std::size_t m = 0; m < slipping.phase1.size(); ++m) slipping.phase1[m] += 50.0 * static_cast<double>(m % 977U);
  EXPECT_EQ(slipping.solve().status, StaticPhaseStatus::kTooShort);

  World unhealthy = make_world(4, 40);
  for (Ephemeris& eph : unhealthy.ephemerides) eph.health = 1;
  EXPECT_EQ(unhealthy.solve().status, StaticPhaseStatus::kTooFewSatellites);
  for (int k = 0; k <= static_cast<int>(StaticPhaseStatus::kTooManyArcs); ++k) {
    EXPECT_NE(to_string(static_cast<StaticPhaseStatus>(k)), "unknown");
  }
}

TEST(StaticPhase, SetUpIsChecked) {
  const World world = make_world(5, 3);
  const auto refused = [&world](const PhaseTable& table, const StaticPhaseOptions& options, const char* name) {
    try {
      static_cast<void>(solve_static_phase(EphemerisTable(world.ephemerides), std::nullopt, table, options));
      ADD_FAILURE() << name << " was taken";
    } catch (const std::invalid_argument& error) {
      EXPECT_EQ(std::string(error.what()).rfind(name, 0), 0U) << error.what();
    }
  };
  PhaseTable table = world.table();
  table.code2_m = {};
  refused(table, {}, "code2_m");
  table = world.table();
  const std::vector<double> back{3.0, 2.0, 1.0};
  table.time_of_week_s = back;
  refused(table, {}, "time_of_week_s");
  table = world.table();
  refused(table, {.elevation_mask_rad = 2.0}, "elevation_mask_rad");
  refused(table, {.code_sigma_m = 0.0}, "code_sigma_m");
  refused(table, {.phase_sigma_m = kNan}, "phase_sigma_m");
  refused(table, {.phase_correlation_s = -1.0}, "phase_correlation_s");
  refused(table, {.range_error_sigma_m = 0.0}, "range_error_sigma_m");
  refused(table, {.range_error_rate_mps = 0.0}, "range_error_rate_mps");
  refused(table, {.zenith_sigma_m = -1.0}, "zenith_sigma_m");
  refused(table, {.relative_humidity = 2.0}, "relative_humidity");
  refused(table, {.max_gap_s = 0.0}, "max_gap_s");
  refused(table, {.slip_m = 0.0}, "slip_m");
  refused(table, {.min_arc_epochs = 1}, "min_arc_epochs");
  refused(table, {.max_age_s = -1.0}, "max_age_s");
}

}  // namespace
}  // namespace soopnav::gnss
