#include "soopnav/geometry/orbit.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "soopnav/core/constants.hpp"
#include "soopnav/geometry/gravity.hpp"

namespace soopnav::geometry {
namespace {

constexpr double kOrbitNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kDegree = kPi / 180.0;

MeanElements eccentric() {
  MeanElements e;
  e.semi_major_axis_m = 8.2e6;
  e.eccentricity = 0.15;
  e.inclination_rad = 63.0 * kDegree;
  e.node_rad = 1.0;
  e.perigee_rad = 0.4;
  e.mean_anomaly_rad = 2.0;
  return e;
}

TEST(SiderealTime, PublishedValues) {
  // Meeus, Astronomical Algorithms, examples 12.a and 12.b: 1987 April 10, 0h and 19h21m UT.
  const double hour = kTwoPi / 24.0;
  EXPECT_NEAR(gmst82_rad(2446895.5, 0.0), (13.0 + 10.0 / 60.0 + 46.3668 / 3600.0) * hour, 1e-4 / 3600.0 * hour);
  EXPECT_NEAR(gmst82_rad(2446895.5, 19.35 / 24.0), (8.0 + 34.0 / 60.0 + 57.0896 / 3600.0) * hour, 1e-4 / 3600.0 * hour);
  // The split of the date does not matter, and the rate is the stated one.
  EXPECT_NEAR(gmst82_rad(2456896.0, 0.75), gmst82_rad(2456896.5, 0.25), 2e-12);
  EXPECT_NEAR(std::remainder(gmst82_rad(2451545.0, 0.01) - gmst82_rad(2451545.0, 0.0), kTwoPi),
              kSiderealRateRadps * 864.0, 1e-12);
  EXPECT_TRUE(std::isnan(gmst82_rad(kOrbitNan, 0.0)));
}

TEST(Teme, VelocityIsTheDerivativeOfThePosition) {
  // A straight line in space stays one: its ECEF velocity must be the derivative of its ECEF position.
  const Eigen::Vector3d p(7e6, -1e6, 2e6), v(1e3, 6e3, -4e3);
  const double day = 1.0 / 86400.0, h = 0.5;
  const auto at = [&](double t) { return teme_to_ecef(2456896.5, 0.25 + t * day, p + v * t, v); };
  const Eigen::Vector3d difference = (at(h).p_e - at(-h).p_e) / (2.0 * h);
  EXPECT_LT((at(0.0).v_e - difference).norm(), 2e-5);
  EXPECT_NEAR(at(0.0).p_e.norm(), p.norm(), 1e-8);
  EXPECT_NEAR(at(0.0).p_e.z(), p.z(), 0.0);
}

TEST(J2Orbit, VelocityIsTheDerivativeOfThePosition) {
  const J2Orbit orbit(eccentric(), 10.0, 0.7);
  for (double t = -3000.0; t < 9000.0; t += 371.0) {
    const double h = 0.05;
    const Eigen::Vector3d difference = (orbit.at(t + h).p_e - orbit.at(t - h).p_e) / (2.0 * h);
    EXPECT_LT((orbit.at(t).v_e - difference).norm(), 1e-5) << t;
  }
}

TEST(J2Orbit, KeplersLawsWithoutJ2) {
  const J2Orbit orbit(eccentric(), 0.0, 0.0, 0.0);
  const double mu = wgs84::kGravitationalParameterM3ps2;
  const auto space = [&](double t) {
    OrbitState s = orbit.at(t);
    const Eigen::AngleAxisd turn(wgs84::kEarthRateRadps * t, Eigen::Vector3d::UnitZ());
    s.v_e += wgs84::kEarthRateRadps * Eigen::Vector3d(-s.p_e.y(), s.p_e.x(), 0.0);
    return OrbitState{turn * s.p_e, turn * s.v_e};
  };
  const Eigen::Vector3d momentum = space(0.0).p_e.cross(space(0.0).v_e);
  EXPECT_NEAR(std::acos(momentum.normalized().z()), 63.0 * kDegree, 1e-12);
  for (double t = 0.0; t < 8000.0; t += 500.0) {
    const OrbitState s = space(t);
    EXPECT_NEAR(0.5 * s.v_e.squaredNorm() - mu / s.p_e.norm(), -0.5 * mu / 8.2e6, 1e-6 * mu / 8.2e6 * 1e-3);
    EXPECT_LT((s.p_e.cross(s.v_e) - momentum).norm(), 1e-9 * momentum.norm());
  }
  const double period = kTwoPi * std::sqrt(8.2e6 * 8.2e6 * 8.2e6 / mu);
  EXPECT_LT((space(period).p_e - space(0.0).p_e).norm(), 1e-5);
}

// Integrated with J2's force, node and argument of latitude drift as the formulas say, apart from the periodic part.
TEST(J2Orbit, DriftsAreThoseOfTheForce) {
  MeanElements e;
  e.semi_major_axis_m = wgs84::kSemiMajorAxisM + 780e3;
  e.inclination_rad = 60.0 * kDegree;
  const J2Orbit orbit(e);
  EXPECT_NEAR(orbit.node_rate_radps() * 86400.0 / kDegree, -3.32, 0.03);  // textbook: -9.96 (R/a)^3.5 cos i
  Eigen::Vector3d p(e.semi_major_axis_m, 0.0, 0.0);
  const double speed = std::sqrt(wgs84::kGravitationalParameterM3ps2 / e.semi_major_axis_m);
  Eigen::Vector3d v = speed * Eigen::Vector3d(0.0, std::cos(e.inclination_rad), std::sin(e.inclination_rad));
  const double h = 5.0;
  const auto force = [](const Eigen::Vector3d& x) { return j2_gravitation_ecef(x); };
  const auto node_of = [&] {
    const Eigen::Vector3d m = p.cross(v);
    return std::atan2(m.x(), -m.y());
  };
  const double node_before = node_of();
  const double end = 10.0 * kTwoPi / (orbit.anomaly_rate_radps() + orbit.perigee_rate_radps());
  const int steps = static_cast<int>(end / h);
  for (int i = 0; i < steps; ++i) {  // leapfrog: energy does not drift
    v += 0.5 * h * force(p);
    p += h * v;
    v += 0.5 * h * force(p);
  }
  EXPECT_NEAR((node_of() - node_before) / (steps * h) / orbit.node_rate_radps(), 1.0, 0.02);
}

TEST(J2Orbit, SamplesAndRefusals) {
  const J2Orbit orbit(eccentric());
  const SampledOrbit samples = orbit.sampled(100.0, 95.0, 10.0);
  EXPECT_EQ(samples.samples().size(), 11U);  // to at least the end
  EXPECT_DOUBLE_EQ(samples.end_s(), 200.0);
  OrbitState s;
  ASSERT_TRUE(samples.at(144.0, s));
  EXPECT_LT((s.p_e - orbit.at(144.0).p_e).norm(), 1e-3);
  EXPECT_THROW(static_cast<void>(orbit.sampled(kOrbitNan, 10.0)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(orbit.sampled(0.0, 0.0)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(orbit.sampled(0.0, 10.0, -1.0)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(orbit.sampled(0.0, 1e12, 1.0)), std::invalid_argument);
  EXPECT_FALSE(orbit.at(kOrbitNan).p_e.allFinite());
  const auto refused = [](auto change) {
    MeanElements e = eccentric();
    change(e);
    EXPECT_THROW(static_cast<void>(J2Orbit(e)), std::invalid_argument);
  };
  refused([](MeanElements& e) { e.eccentricity = 1.0; });
  refused([](MeanElements& e) { e.eccentricity = -0.1; });
  refused([](MeanElements& e) { e.semi_major_axis_m = 6.5e6; });  // perigee underground
  refused([](MeanElements& e) { e.semi_major_axis_m = kOrbitNan; });
  refused([](MeanElements& e) { e.node_rad = kOrbitNan; });
}

TEST(Walker, NotationAndSpacing) {
  const auto delta = WalkerConstellation::delta(24, 3, 2, 55.0 * kDegree, 2e7);
  EXPECT_EQ(delta.per_plane, 8);
  EXPECT_NEAR(delta.plane_spacing_rad, 120.0 * kDegree, 1e-12);
  EXPECT_NEAR(delta.phase_step_rad, 30.0 * kDegree, 1e-12);
  EXPECT_NEAR(WalkerConstellation::star(66, 6, 2, 1.5, 780e3).plane_spacing_rad, 30.0 * kDegree, 1e-12);
  EXPECT_THROW(static_cast<void>(WalkerConstellation::delta(10, 3, 0, 1.0, 1e6)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(WalkerConstellation::delta(0, 0, 0, 1.0, 1e6)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(WalkerConstellation::delta(3, 3, 0, 1.0, -1e6).orbits()), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(WalkerConstellation::delta(3, 3, 0, kOrbitNan, 1e6).orbits()), std::invalid_argument);

  const auto orbits = WalkerConstellation::iridium().orbits();
  ASSERT_EQ(orbits.size(), 66U);
  const auto angle = [&](std::size_t a, std::size_t b) {
    const Eigen::Vector3d p = orbits[a].at(0.0).p_e, q = orbits[b].at(0.0).p_e;
    return std::atan2(p.cross(q).norm(), p.dot(q)) / kDegree;
  };
  EXPECT_NEAR(angle(0, 1), 360.0 / 11.0, 1e-9);
  EXPECT_NEAR(orbits[11].elements().node_rad / kDegree, 31.6, 1e-9);
  EXPECT_NEAR(orbits[11].elements().mean_anomaly_rad / kDegree, 15.1, 1e-9);
  EXPECT_NEAR(orbits[0].at(0.0).p_e.norm(), 7158137.0, 1e-6);
  // Nobody meets anybody, seam included.
  for (std::size_t b = 1; b < 66; ++b) EXPECT_GT(angle(0, b), 1.0);
}

}  // namespace
}  // namespace soopnav::geometry
