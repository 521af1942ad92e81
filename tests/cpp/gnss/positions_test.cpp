// Orbits, atmosphere, single-point positions and simulated observables.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/geometry/wgs84.hpp"
#include "soopnav/gnss/atmosphere.hpp"
#include "soopnav/gnss/ephemeris.hpp"
#include "soopnav/gnss/single_point.hpp"
#include "soopnav/simulation/gnss_observables.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::gnss {
namespace {

constexpr std::int64_t kWeek = 2200;
constexpr double kToe = 302'400.0;

// An orbit with every term of the message, each of a size that is broadcast, on an ellipse.
Ephemeris full_orbit() {
  Ephemeris eph;
  eph.prn = 7;
  eph.week = kWeek;
  eph.toe_s = kToe;
  eph.toc_s = kToe - 16.0;
  eph.af0_s = -3.1e-4;
  eph.af1 = 2.2e-11;
  eph.af2_ps = 3e-18;
  eph.tgd_s = -1.1e-8;
  eph.sqrt_a = 5153.7;
  eph.eccentricity = 0.018;
  eph.m0_rad = 1.3;
  eph.delta_n_radps = 4.4e-9;
  eph.omega_rad = -0.7;
  eph.omega0_rad = 2.9;
  eph.omega_dot_radps = -8.1e-9;
  eph.i0_rad = 0.97;
  eph.i_dot_radps = 3e-10;
  eph.cuc_rad = 3e-6;
  eph.cus_rad = 8e-6;
  eph.crc_m = 220.0;
  eph.crs_m = -70.0;
  eph.cic_rad = 1e-7;
  eph.cis_rad = -5e-8;
  return eph;
}

Epoch at(double since_toe_s) { return gps_epoch(kWeek, kToe + since_toe_s); }

TEST(GpsTime, WeeksAndSeconds) {
  const auto t = week_and_second(gps_epoch(2200, 604'800.5));
  ASSERT_TRUE(t);
  EXPECT_EQ(t->first, 2201);
  EXPECT_DOUBLE_EQ(t->second, 0.5);
  const auto before = week_and_second(gps_epoch(0, -1.0));
  ASSERT_TRUE(before);
  EXPECT_EQ(before->first, -1);
  EXPECT_DOUBLE_EQ(before->second, 604'799.0);
  EXPECT_FALSE(week_and_second(gps_epoch(2200, std::nan(""))));
  EXPECT_FALSE(week_and_second(Epoch(TimeScale::kUtc, 0, 0.0)));
}

// Without the harmonic terms the orbit is Kepler's: energy and angular momentum in inertial axes stay.
TEST(Orbit, KeplerInvariants) {
  Ephemeris eph = full_orbit();
  eph.delta_n_radps = eph.omega_dot_radps = eph.i_dot_radps = 0.0;
  eph.cuc_rad = eph.cus_rad = eph.crc_m = eph.crs_m = eph.cic_rad = eph.cis_rad = 0.0;
  const double a = eph.sqrt_a * eph.sqrt_a;
  const Eigen::Vector3d earth(0.0, 0.0, kEarthRateRadps);
  for (double t = -7200.0; t <= 36'000.0; t += 900.0) {
    const auto s = satellite_state(eph, at(t));
    ASSERT_TRUE(s);
    const Eigen::Vector3d inertial = s->velocity_e + earth.cross(s->position_e);
    EXPECT_NEAR(inertial.squaredNorm() / 2.0 - kGravitationalParameterM3ps2 / s->position_e.norm(),
                -kGravitationalParameterM3ps2 / (2.0 * a), 1e-4);
    const double momentum = std::sqrt(kGravitationalParameterM3ps2 * a * (1.0 - eph.eccentricity * eph.eccentricity));
    EXPECT_NEAR(s->position_e.cross(inertial).norm() / momentum, 1.0, 1e-12);
    EXPECT_NEAR(s->position_e.cross(inertial)[2] / momentum, std::cos(eph.i0_rad), 1e-12);
  }
}

TEST(Orbit, VelocityAndClockRateAreDerivatives) {
  const Ephemeris eph = full_orbit();
  constexpr double kStep = 0.125;  // exact in binary; the jerk shows below 3e-7 m/s
  for (double t = -7200.0; t <= 7200.0; t += 1111.0) {
    const auto s = satellite_state(eph, at(t));
    const auto before = satellite_state(eph, at(t - kStep));
    const auto after = satellite_state(eph, at(t + kStep));
    ASSERT_TRUE(s && before && after);
    EXPECT_LT(((after->position_e - before->position_e) / (2.0 * kStep) - s->velocity_e).norm(), 4e-7) << t;
    EXPECT_NEAR((after->clock_s - before->clock_s) / (2.0 * kStep), s->clock_rate, 1e-17) << t;
  }
}

TEST(Orbit, ClockHoldsEveryTerm) {
  const Ephemeris eph = full_orbit();
  Ephemeris bare = eph;
  bare.tgd_s = 0.0;
  const auto with = satellite_state(eph, at(100.0));
  const auto without = satellite_state(bare, at(100.0));
  EXPECT_NEAR(with->clock_s - without->clock_s, -eph.tgd_s, 1e-18);
  // Relativity: -2 r·v / c² (IS-GPS-200N 20.3.3.3.3.1), v inertial.
  const Eigen::Vector3d v = with->velocity_e + Eigen::Vector3d(0.0, 0.0, kEarthRateRadps).cross(with->position_e);
  const double relativity = -2.0 * with->position_e.dot(v) / (kSpeedOfLightMps * kSpeedOfLightMps);
  const double dt = 116.0;  // since toc
  EXPECT_NEAR(without->clock_s - (eph.af0_s + eph.af1 * dt + eph.af2_ps * dt * dt), relativity,
              1e-10);  // the harmonics of the orbit are in one only
  EXPECT_GT(std::abs(relativity), 1e-9);
}

TEST(Orbit, SightKeepsItsLaws) {
  const Ephemeris eph = full_orbit();
  const Eigen::Vector3d p = geometry::geodetic_to_ecef(0.6, 2.4, 100.0);
  const Eigen::Vector3d v(30.0, -20.0, 5.0);
  const auto s = sight(eph, at(500.0), p, v);
  ASSERT_TRUE(s);
  const double flight = s->range_m / kSpeedOfLightMps;
  const auto then = satellite_state(eph, at(500.0) - flight);
  EXPECT_LT((rotated_for_flight(then->position_e, flight) - s->position_e).norm(), 1e-6);
  EXPECT_NEAR(s->direction_e.norm(), 1.0, 1e-14);
  EXPECT_LT((p + s->range_m * s->direction_e - s->position_e).norm(), 1e-6);
  const auto before = sight(eph, at(499.5), p - 0.5 * v, v);
  const auto after = sight(eph, at(500.5), p + 0.5 * v, v);
  EXPECT_NEAR(after->range_m - before->range_m, s->range_rate_mps, 1e-6);
  EXPECT_FALSE(sight(eph, Epoch::invalid(TimeScale::kGps), p));
  EXPECT_FALSE(sight(eph, at(0.0), Eigen::Vector3d::Constant(std::nan(""))));
  // A pseudorange dates the transmission whatever the receiver's clock: late by 1 ms, and the satellite's by its own.
  const double pseudorange = s->range_m + 1e-3 * kSpeedOfLightMps - kSpeedOfLightMps * then->clock_s;
  const auto dated = state_at_transmission(eph, at(500.0) + 1e-3, pseudorange);
  ASSERT_TRUE(dated);
  EXPECT_LT((dated->position_e - then->position_e).norm(), 1e-5);
  EXPECT_FALSE(state_at_transmission(eph, at(0.0), std::nan("")));
}

TEST(Ephemerides, LookUp) {
  Ephemeris early = full_orbit();
  Ephemeris late = full_orbit();
  late.toe_s += 7200.0;
  late.toc_s += 7200.0;
  const EphemerisTable table({late, early});
  EXPECT_EQ(table.prns(), std::vector<int>{7});
  EXPECT_EQ(table.find(7, at(3000.0))->toe_s, kToe);
  EXPECT_EQ(table.find(7, at(4000.0))->toe_s, kToe + 7200.0);
  EXPECT_EQ(table.find(7, at(-7201.0)), nullptr);  // beyond half the fit interval
  EXPECT_NE(table.find(7, at(-7201.0), 8000.0), nullptr);
  EXPECT_EQ(table.find(8, at(0.0)), nullptr);
  EXPECT_FALSE(table.has(8));
  EXPECT_EQ(table.find(7, Epoch::invalid(TimeScale::kGps)), nullptr);
}

TEST(Ephemerides, Refusals) {
  const auto refuses = [](const std::function<void(Ephemeris&)>& spoil) {
    Ephemeris eph = full_orbit();
    spoil(eph);
    EXPECT_THROW(EphemerisTable({eph}), std::invalid_argument);
  };
  refuses([](Ephemeris& e) { e.prn = 0; });
  refuses([](Ephemeris& e) { e.sqrt_a = 0.0; });
  refuses([](Ephemeris& e) { e.eccentricity = 1.0; });
  refuses([](Ephemeris& e) { e.fit_interval_s = 0.0; });
  refuses([](Ephemeris& e) { e.crs_m = std::nan(""); });
  const auto refuses_walker = [](const std::function<void(WalkerOptions&)>& spoil) {
    WalkerOptions options;
    spoil(options);
    EXPECT_THROW(walker_constellation(options), std::invalid_argument);
  };
  refuses_walker([](WalkerOptions& o) { o.planes = 0; });
  refuses_walker([](WalkerOptions& o) { o.satellites = 25; });
  refuses_walker([](WalkerOptions& o) { o.satellites = 66; });
  refuses_walker([](WalkerOptions& o) { o.phasing = 6; });
  refuses_walker([](WalkerOptions& o) { o.inclination_rad = -0.1; });
  refuses_walker([](WalkerOptions& o) { o.radius_m = 1e6; });
  refuses_walker([](WalkerOptions& o) { o.toe_s = std::nan(""); });
  refuses_walker([](WalkerOptions& o) { o.first_node_rad = std::nan(""); });
  refuses_walker([](WalkerOptions& o) { o.fit_interval_s = 0.0; });
}

TEST(Atmosphere, Ionosphere) {
  Klobuchar k;
  k.alpha = {1.118e-8, 7.451e-9, -5.96e-8, -5.96e-8};
  k.beta = {9.011e4, 0.0, -1.966e5, -6.554e4};
  const geometry::Geodetic place{0.6, 2.43, 50.0};
  const double night = ionosphere_delay_m(k, place, 1.0, kPi / 2, 57'600.0);  // two in the morning there
  EXPECT_NEAR(night, kSpeedOfLightMps * 5e-9 * (1.0 + 16.0 * std::pow(0.03, 3)), 1e-9);
  const double noon = ionosphere_delay_m(k, place, 1.0, kPi / 2, 17'000.0);
  EXPECT_GT(noon, night + 1.0);
  EXPECT_GT(ionosphere_delay_m(k, place, 1.0, 0.1, 17'000.0), 2.0 * noon);
  EXPECT_DOUBLE_EQ(ionosphere_delay_m(k, place, 1.0, -0.1, 0.0), ionosphere_delay_m(k, place, 1.0, 0.0, 0.0));
  k.beta[2] = std::nan("");
  EXPECT_THROW(k.check(), std::invalid_argument);
}

// The worked example that goes round with the model: 40 N, 100 W, azimuth 210, elevation 20 degrees: 23.784 m.
TEST(Atmosphere, IonosphereOfTheWorkedExample) {
  const Klobuchar k{{3.82e-8, 1.49e-8, -1.79e-7, 0.0}, {1.43e5, 0.0, -3.28e5, 1.13e5}};
  constexpr double kDegree = kPi / 180.0;
  const geometry::Geodetic place{40.0 * kDegree, -100.0 * kDegree, 0.0};
  EXPECT_NEAR(ionosphere_delay_m(k, place, 210.0 * kDegree, 20.0 * kDegree, 593'100.0), 23.784, 5e-4);
}

TEST(Atmosphere, Troposphere) {
  const geometry::Geodetic sea{0.7853981633974483, 0.0, 0.0};
  // 0.0022768 * 1013.25 at 45 degrees, dry; Black and Eisner's mapping is 1.0000 at the zenith.
  EXPECT_NEAR(troposphere_delay_m(sea, kPi / 2, 0.0), 0.0022768 * 1013.25, 1e-5);
  EXPECT_NEAR(troposphere_delay_m(sea, kPi / 2, 0.7) - troposphere_delay_m(sea, kPi / 2, 0.0), 0.12, 0.02);
  EXPECT_NEAR(troposphere_delay_m(sea, kPi / 6) / troposphere_delay_m(sea, kPi / 2), 2.0, 0.01);
  geometry::Geodetic mountain = sea;
  mountain.height_m = 5500.0;
  EXPECT_NEAR(troposphere_delay_m(mountain, kPi / 2, 0.0) / troposphere_delay_m(sea, kPi / 2, 0.0), 0.5, 0.03);
  mountain.height_m = 40'000.0;
  EXPECT_EQ(troposphere_delay_m(mountain, kPi / 2), 0.0);
  EXPECT_TRUE(std::isfinite(troposphere_delay_m(sea, -0.3)));
}

// A receiver under a synthetic constellation, and what it measures without noise.
struct Sky {
  EphemerisTable table;
  Eigen::Vector3d p = geometry::geodetic_to_ecef(0.6, 2.4, 100.0);
  Eigen::Vector3d v = Eigen::Vector3d(12.0, -7.0, 3.0);
  double bias_m = 1e-3 * kSpeedOfLightMps;
  double drift_mps = 30.0;
  Klobuchar klobuchar{{1.118e-8, 7.451e-9, -5.96e-8, -5.96e-8}, {9.011e4, 0.0, -1.966e5, -6.554e4}};

  explicit Sky(const WalkerOptions& walker = {.satellites = 30, .week = kWeek, .toe_s = kToe}) {
    auto all = walker_constellation(walker);
    for (Ephemeris& eph : all) {
      eph.eccentricity = 0.01;
      eph.af0_s = 1e-5 * eph.prn;
      eph.af1 = 1e-11;
    }
    table = EphemerisTable(std::move(all));
  }

  [[nodiscard]] std::vector<PointMeasurement> measure(double t, bool noise = false, std::uint64_t seed = 1) const {
    simulation::GnssObservableOptions options;
    options.noise = noise;
    options.ionosphere = klobuchar;
    options.troposphere = true;
    simulation::GnssObservables simulator(table, options, 1, RandomStream(seed));
    std::vector<simulation::GnssObservable> seen(simulator.prns().size());
    simulator.observe(0, 0, at(t), p, v, bias_m, drift_mps, seen);
    std::vector<PointMeasurement> out;
    for (std::size_t i = 0; i < seen.size(); ++i) {
      if (!seen[i].visible) continue;
      out.push_back({simulator.prns()[i], seen[i].code_m, -kSpeedOfLightMps / kL1Hz * seen[i].doppler_hz});
    }
    return out;
  }
};

TEST(SinglePoint, ExactWithoutNoise) {
  const Sky sky;
  const SinglePoint solver(sky.table, sky.klobuchar);
  for (const double t : {-3000.0, 0.0, 900.0, 5000.0}) {
    const auto z = sky.measure(t);
    const PointFix fix = solver.fix(at(t), z);
    ASSERT_EQ(fix.status, PointStatus::kConverged) << fix.message();
    EXPECT_LT((fix.position_e - sky.p).norm(), 1e-4) << t;  // the claim: below a millimetre
    EXPECT_NEAR(fix.clock_bias_m, sky.bias_m, 1e-4);
    ASSERT_TRUE(fix.has_velocity);
    // The broadcast orbit is at hand to 1e-5 m/s: atmospheric rates are in neither.
    EXPECT_LT((fix.velocity_e - sky.v).norm(), 1e-5);
    EXPECT_NEAR(fix.clock_drift_mps, sky.drift_mps, 1e-5);
    EXPECT_GT(fix.used_count(), 5u);
    EXPECT_NEAR(fix.dop.gdop * fix.dop.gdop, fix.dop.pdop * fix.dop.pdop + fix.dop.tdop * fix.dop.tdop, 1e-9);
    EXPECT_NEAR(fix.dop.pdop * fix.dop.pdop, fix.dop.hdop * fix.dop.hdop + fix.dop.vdop * fix.dop.vdop, 1e-9);
    EXPECT_NEAR(fix.covariance_enu_m2.trace(), fix.covariance_m2.trace(), 1e-9);
  }
}

TEST(SinglePoint, CovarianceIsDopTimesSigmaWhenAllAreAlike) {
  const Sky sky;
  const SinglePoint solver(sky.table, sky.klobuchar, {.sigma_m = 2.5, .weight_by_elevation = false});
  const PointFix fix = solver.fix(at(0.0), sky.measure(0.0));
  ASSERT_EQ(fix.status, PointStatus::kConverged);
  EXPECT_NEAR(std::sqrt(fix.covariance_m2.trace()), 2.5 * fix.dop.pdop, 1e-6);
  EXPECT_NEAR(std::sqrt(fix.covariance_enu_m2(2, 2)), 2.5 * fix.dop.vdop, 1e-6);
  EXPECT_NEAR(fix.clock_sigma_m, 2.5 * fix.dop.tdop, 1e-6);
}

TEST(SinglePoint, RejectsOutliers) {
  const Sky sky;
  const SinglePoint solver(sky.table, sky.klobuchar, {.elevation_mask_rad = 0.0});
  auto z = sky.measure(0.0);
  ASSERT_GE(z.size(), 8u);
  z[2].pseudorange_m += 80.0;
  PointFix fix = solver.fix(at(0.0), z);
  EXPECT_EQ(fix.status, PointStatus::kConverged) << fix.message();
  EXPECT_EQ(fix.use[2], SatelliteUse::kRejected);
  EXPECT_LT((fix.position_e - sky.p).norm(), 1e-4);
  z[5].pseudorange_m -= 300.0;
  fix = solver.fix(at(0.0), z);
  EXPECT_EQ(fix.status, PointStatus::kConverged) << fix.message();
  EXPECT_EQ(fix.use[5], SatelliteUse::kRejected);
  const SinglePoint trusting(sky.table, sky.klobuchar, {.elevation_mask_rad = 0.0, .reject_outliers = false});
  EXPECT_EQ(trusting.fix(at(0.0), z).status, PointStatus::kInconsistent);
  // One satellite to spare shows that something is wrong, and not what.
  std::vector<PointMeasurement> five;
  for (const std::size_t i : {0u, 1u, 2u, 3u, 4u}) five.push_back(z[i]);
  five[2].pseudorange_m += 2000.0;
  EXPECT_EQ(solver.fix(at(0.0), five).status, PointStatus::kInconsistent);
}

TEST(SinglePoint, WhatBecomesOfSatellites) {
  Sky sky;
  auto z = sky.measure(0.0);
  std::vector<Ephemeris> all(sky.table.all().begin(), sky.table.all().end());
  for (Ephemeris& eph : all) {
    if (eph.prn == z[0].prn) eph.health = 1;
    if (eph.prn == z[1].prn) eph.fit_interval_s = 1.0;
  }
  const SinglePoint solver(EphemerisTable(all), sky.klobuchar);
  z[2].pseudorange_m = std::nan("");
  z[3].sigma_m = 0.0;
  z.push_back({63, 2.2e7});
  const PointFix fix = solver.fix(at(10.0), z);
  EXPECT_EQ(fix.use[0], SatelliteUse::kUnhealthy);
  EXPECT_EQ(fix.use[1], SatelliteUse::kStale);
  EXPECT_EQ(fix.use[2], SatelliteUse::kNotFinite);
  EXPECT_EQ(fix.use[3], SatelliteUse::kNotFinite);
  EXPECT_EQ(fix.use[z.size() - 1], SatelliteUse::kNoEphemeris);
  EXPECT_NE(fix.message().find("1 with a stale ephemeris"), std::string::npos) << fix.message();
}

TEST(SinglePoint, SaysWhyThereIsNoPosition) {
  const Sky sky;
  const SinglePoint solver(sky.table, sky.klobuchar);
  const auto z = sky.measure(0.0);
  EXPECT_EQ(solver.fix(at(0.0), {}).status, PointStatus::kTooFewSatellites);
  const PointFix three = solver.fix(at(0.0), std::span(z).first(3));
  EXPECT_EQ(three.status, PointStatus::kTooFewSatellites);
  EXPECT_TRUE(std::isnan(three.position_e[0]));
  EXPECT_EQ(solver.fix(at(200'000.0), z).status, PointStatus::kTooFewSatellites);  // all stale
  EXPECT_EQ(solver.fix(Epoch::invalid(TimeScale::kGps), z).status, PointStatus::kTooFewSatellites);
  EXPECT_EQ(SinglePoint(EphemerisTable(), std::nullopt).fix(at(0.0), z).status, PointStatus::kTooFewSatellites);
  // Numbers without sense do not become a position.
  auto wild = z;
  for (std::size_t i = 0; i < wild.size(); ++i) wild[i].pseudorange_m = 1e7 * static_cast<double>((i * 7) % 5 + 1);
  const PointFix nowhere = solver.fix(at(0.0), wild);
  EXPECT_NE(nowhere.status, PointStatus::kConverged) << nowhere.message();
}

TEST(SinglePoint, SatellitesInOnePlaneLeaveADirectionOpen) {
  // All above the equator: north and south look alike.
  Sky sky({.satellites = 24, .planes = 1, .phasing = 0, .inclination_rad = 0.0, .week = kWeek, .toe_s = kToe});
  sky.p = geometry::geodetic_to_ecef(0.0, 2.4, 0.0);
  sky.v.setZero();
  const auto z = sky.measure(0.0);
  ASSERT_GE(z.size(), 5u);
  const PointFix fix = SinglePoint(sky.table, std::nullopt, {.troposphere = false}).fix(at(0.0), z);
  EXPECT_EQ(fix.status, PointStatus::kRankDeficient);
  ASSERT_EQ(fix.unobservable.cols(), 1);
  EXPECT_NEAR(std::abs(fix.unobservable(2, 0)), 1.0, 1e-6);
  EXPECT_TRUE(std::isnan(fix.position_e[0]));
}

TEST(SinglePoint, Refusals) {
  const auto refuses = [](const PointOptions& options) {
    EXPECT_THROW(SinglePoint(EphemerisTable(), std::nullopt, options), std::invalid_argument);
  };
  refuses({.elevation_mask_rad = 2.0});
  refuses({.sigma_m = 0.0});
  refuses({.sigma_rate_mps = -1.0});
  refuses({.relative_humidity = 1.5});
  refuses({.false_alarm_probability = 0.5});
  refuses({.max_age_s = -1.0});
  refuses({.max_iterations = 2});
}

TEST(GnssObservables, NoiseDoesNotDependOnWhoElseIsThere) {
  const Sky sky;
  const auto all = sky.measure(0.0, true, 5);
  Sky few;
  std::vector<Ephemeris> half;
  for (const Ephemeris& eph : sky.table.all()) {
    if (eph.prn % 2 == 0) half.push_back(eph);
  }
  few.table = EphemerisTable(half);
  int compared = 0;
  for (const PointMeasurement& z : few.measure(0.0, true, 5)) {
    for (const PointMeasurement& other : all) {
      if (other.prn != z.prn) continue;
      EXPECT_EQ(other.pseudorange_m, z.pseudorange_m);
      ++compared;
    }
  }
  EXPECT_GE(compared, 3);
}

TEST(GnssObservables, Refusals) {
  const auto refuses = [](const std::function<void(simulation::GnssObservableOptions&)>& spoil) {
    simulation::GnssObservableOptions options;
    spoil(options);
    EXPECT_THROW(simulation::GnssObservables(EphemerisTable(), options, 1, RandomStream(1)), std::invalid_argument);
  };
  refuses([](auto& o) { o.elevation_mask_rad = 2.0; });
  refuses([](auto& o) { o.cn0_zenith_dbhz = std::nan(""); });
  refuses([](auto& o) { o.cn0_drop_db = -1.0; });
  refuses([](auto& o) { o.code_sigma_m = -1.0; });
  refuses([](auto& o) { o.phase_sigma_m = -1.0; });
  refuses([](auto& o) { o.doppler_sigma_hz = -1.0; });
  refuses([](auto& o) { o.multipath_sigma_m = -1.0; });
  refuses([](auto& o) { o.multipath_time_s = 0.0; });
  refuses([](auto& o) { o.multipath_phase_ratio = 2.0; });
  refuses([](auto& o) { o.relative_humidity = -0.1; });
  refuses([](auto& o) { o.max_age_s = -1.0; });
  refuses([](auto& o) { o.code_loop.early_late_chips = 0.0; });
  refuses([](auto& o) { o.phase_loop.power_fraction = 0.0; });
  EXPECT_THROW(simulation::GnssObservables(EphemerisTable(), {}, 0, RandomStream(1)), std::invalid_argument);
}

TEST(NoAllocation, FixAndObserve) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "this allocator cannot be counted";
  const Sky sky;
  const SinglePoint solver(sky.table, sky.klobuchar);
  auto z = sky.measure(0.0);
  z[2].pseudorange_m += 80.0;
  PointFix fix;
  EXPECT_EQ(test::allocations_of([&] { fix = solver.fix(at(0.0), z); }), 0);
  EXPECT_EQ(fix.status, PointStatus::kConverged);
  simulation::GnssObservables simulator(sky.table, {}, 2, RandomStream(3));
  std::vector<simulation::GnssObservable> seen(simulator.prns().size());
  EXPECT_EQ(test::allocations_of([&] { simulator.observe(1, 4, at(0.0), sky.p, sky.v, 0.0, 0.0, seen); }), 0);
  EXPECT_GT(test::allocations_of([&] { z.reserve(2 * z.capacity() + 1); }), 0);
}

}  // namespace
}  // namespace soopnav::gnss
