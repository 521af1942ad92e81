#include "soopnav/geometry/sampled_orbit.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::geometry {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kRadiusM = wgs84::kSemiMajorAxisM + 780e3;
constexpr double kOmega = wgs84::kEarthRateRadps;

// A circular orbit in space seen from the turning Earth, in closed form.
struct Circle {
  double inclination_rad = 86.4 / 180.0 * kPi;
  double node_rad = 0.7;
  double phase_rad = 0.2;
  double rate_radps = std::sqrt(wgs84::kGravitationalParameterM3ps2 / (kRadiusM * kRadiusM * kRadiusM));

  [[nodiscard]] OrbitState at(double t_s) const {
    const double u = phase_rad + rate_radps * t_s;
    const double node = node_rad - kOmega * t_s;  // in the turning axes
    const double ci = std::cos(inclination_rad), si = std::sin(inclination_rad);
    const double cn = std::cos(node), sn = std::sin(node);
    const Eigen::Vector3d along(cn, sn, 0.0), up(-sn * ci, cn * ci, si);
    OrbitState s;
    s.p_e = kRadiusM * (std::cos(u) * along + std::sin(u) * up);
    s.v_e = kRadiusM * rate_radps * (-std::sin(u) * along + std::cos(u) * up);
    s.v_e += kOmega * Eigen::Vector3d(s.p_e.y(), -s.p_e.x(), 0.0);
    return s;
  }
  [[nodiscard]] SampledOrbit sampled(double start_s, double step_s, int n) const {
    std::vector<double> p, v;
    for (int i = 0; i < n; ++i) {
      const OrbitState s = at(start_s + step_s * i);
      p.insert(p.end(), s.p_e.data(), s.p_e.data() + 3);
      v.insert(v.end(), s.v_e.data(), s.v_e.data() + 3);
    }
    return {start_s, step_s, p, v};
  }
};

Eigen::Vector3d below(const Circle& circle, double t_s, double off_rad) {
  const auto place = ecef_to_geodetic(circle.at(t_s).p_e);
  return geodetic_to_ecef(place->latitude_rad + off_rad, place->longitude_rad - 0.5 * off_rad, 30.0);
}

TEST(SampledOrbit, HermiteErrorIsTheStatedOne) {
  const Circle circle;
  const struct { double step_s, p_m, v_mps; } rows[] = {{10.0, 3.2e-4, 1.2e-4}, {60.0, 0.40, 2.5e-2}};
  for (const auto& row : rows) {
    const SampledOrbit orbit = circle.sampled(-120.0, row.step_s, static_cast<int>(7200.0 / row.step_s));
    double p_m = 0.0, v_mps = 0.0;
    for (double t = -120.0; t < 6900.0; t += 0.739) {
      OrbitState s;
      ASSERT_TRUE(orbit.at(t, s));
      const OrbitState truth = circle.at(t);
      p_m = std::max(p_m, (s.p_e - truth.p_e).norm());
      v_mps = std::max(v_mps, (s.v_e - truth.v_e).norm());
    }
    EXPECT_LT(p_m, row.p_m);
    EXPECT_GT(p_m, 0.3 * row.p_m);
    EXPECT_LT(v_mps, row.v_mps);
    EXPECT_GT(v_mps, 0.3 * row.v_mps);
  }
}

TEST(SampledOrbit, SamplesAreMetAndEndsHold) {
  const Circle circle;
  const SampledOrbit orbit = circle.sampled(100.0, 10.0, 5);
  OrbitState s;
  for (int i = 0; i < 5; ++i) {
    ASSERT_TRUE(orbit.at(100.0 + 10.0 * i, s));
    EXPECT_LT((s.p_e - circle.at(100.0 + 10.0 * i).p_e).norm(), 2e-8);
    EXPECT_LT((s.v_e - circle.at(100.0 + 10.0 * i).v_e).norm(), 1e-10);
  }
  EXPECT_DOUBLE_EQ(orbit.end_s(), 140.0);
  EXPECT_FALSE(orbit.at(99.999, s));
  EXPECT_FALSE(orbit.at(140.001, s));
  EXPECT_FALSE(orbit.at(kNan, s));
  const SampledOrbit mast = SampledOrbit::fixed({1.0, 2.0, 3.0});
  ASSERT_TRUE(mast.at(1e12, s));
  EXPECT_EQ(s.p_e, Eigen::Vector3d(1.0, 2.0, 3.0));
  EXPECT_EQ(s.v_e, Eigen::Vector3d(0.0, 0.0, 0.0));
  EXPECT_FALSE(mast.at(kNan, s));
}

TEST(SampledOrbit, BadSamplesAreRefused) {
  const std::vector<double> p{7e6, 0, 0, 7e6, 1e4, 0}, v{0, 7e3, 0, 0, 7e3, 0};
  EXPECT_NO_THROW(SampledOrbit(0.0, 1.0, p, v));
  EXPECT_THROW(SampledOrbit(kNan, 1.0, p, v), std::invalid_argument);
  EXPECT_THROW(SampledOrbit(0.0, 0.0, p, v), std::invalid_argument);
  EXPECT_THROW(SampledOrbit(0.0, -1.0, p, v), std::invalid_argument);
  EXPECT_THROW(SampledOrbit(0.0, 1.0, std::span(p).first(3), std::span(v).first(3)), std::invalid_argument);
  EXPECT_THROW(SampledOrbit(0.0, 1.0, p, std::span(v).first(5)), std::invalid_argument);
  EXPECT_THROW(SampledOrbit(0.0, 1.0, std::span(p).first(5), v), std::invalid_argument);
  std::vector<double> bad = v;
  bad[4] = kNan;
  EXPECT_THROW(SampledOrbit(0.0, 1.0, p, bad), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(SampledOrbit::fixed({0.0, kNan, 0.0})), std::invalid_argument);
}

// In space the signal goes straight: both ends taken to inertial axes, each at its own time.
TEST(SignalPath, StraightLineInSpace) {
  const Circle circle;
  const SampledOrbit orbit = circle.sampled(0.0, 10.0, 200);
  const double t = 1003.7;
  const Eigen::Vector3d p = below(circle, t, 0.12);
  SignalPath path;
  ASSERT_TRUE(signal_path(orbit, t, p, Eigen::Vector3d::Zero(), path));
  const auto to_space = [](const Eigen::Vector3d& v, double time) {
    const double c = std::cos(kOmega * time), s = std::sin(kOmega * time);
    return Eigen::Vector3d(c * v.x() - s * v.y(), s * v.x() + c * v.y(), v.z());
  };
  OrbitState sent;
  ASSERT_TRUE(orbit.at(t - path.delay_s, sent));
  const double way_m = (to_space(sent.p_e, t - path.delay_s) - to_space(p, t)).norm();
  EXPECT_NEAR(way_m, kSpeedOfLightMps * path.delay_s, 2e-8);
  EXPECT_NEAR(path.range_m, way_m, 2e-8);
  // What leaving each part out would cost: light time some metres, the Earth's turn up to one.
  OrbitState now;
  ASSERT_TRUE(orbit.at(t, now));
  EXPECT_GT(std::abs((now.p_e - p).norm() - path.range_m), 1.0);
  EXPECT_GT(std::abs((sent.p_e - p).norm() - path.range_m), 0.02);
}

TEST(SignalPath, IsSolvedWhereverTheLastDigitOfTheTimeFalls) {
  // Late in a day a time's last digit is worth more of the way than the tolerance: two roundings may take turns.
  const SampledOrbit orbit = Circle{}.sampled(0.0, 60.0, 1500);
  const Eigen::Vector3d p = geodetic_to_ecef(1.05, 0.4, 20.0);
  RandomStream random(1);
  SignalPath path;
  int missed = 0;
  for (int i = 0; i < 600000; ++i) {
    missed += signal_path(orbit, random.uniform(80000.0, 89000.0), p, Eigen::Vector3d::Zero(), path) ? 0 : 1;
  }
  EXPECT_EQ(missed, 0);
}

TEST(SignalPath, RateIsTheDerivativeOfTheDelay) {
  const Circle circle;
  const SampledOrbit orbit = circle.sampled(0.0, 10.0, 200);
  const double t = 1005.0;
  for (const double off : {-0.2, -0.02, 0.01, 0.15}) {
    const Eigen::Vector3d p = below(circle, t, off);
    const Eigen::Vector3d v(120.0, -230.0, 40.0);
    SignalPath path, before, after;
    ASSERT_TRUE(signal_path(orbit, t, p, v, path));
    const double h = 0.003;
    ASSERT_TRUE(signal_path(orbit, t - h, p - v * h, v, before));
    ASSERT_TRUE(signal_path(orbit, t + h, p + v * h, v, after));
    const double difference = (after.delay_s - before.delay_s) / (2.0 * h);
    EXPECT_NEAR(path.delay_rate, difference, 1e-14);  // 3 um/s, by rounding and h² of the third derivative
    // A rate without light time and turn is off by some mm/s to m/s.
    OrbitState now;
    ASSERT_TRUE(orbit.at(t, now));
    const double naive = (now.p_e - p).normalized().dot(now.v_e - v) / kSpeedOfLightMps;
    EXPECT_GT(std::abs(naive - difference), 1e-11);
  }
}

TEST(SignalPath, GradientsAreTheDifferences) {
  const Circle circle;
  const SampledOrbit orbit = circle.sampled(0.0, 10.0, 200);
  const double t = 1004.0;
  const Eigen::Vector3d p = below(circle, t, 0.1), v(60.0, 20.0, -5.0);
  SignalPath path;
  PathGradient g;
  ASSERT_TRUE(signal_path(orbit, t, p, v, path, g));
  SignalPath plain;
  ASSERT_TRUE(signal_path(orbit, t, p, v, plain));
  EXPECT_EQ(plain.delay_s, path.delay_s);
  EXPECT_EQ(plain.delay_rate, path.delay_rate);
  const double h = 100.0;
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d d = h * Eigen::Vector3d::Unit(k);
    SignalPath a, b;
    ASSERT_TRUE(signal_path(orbit, t, p + d, v, a) && signal_path(orbit, t, p - d, v, b));
    EXPECT_NEAR(g.delay_p[k], (a.delay_s - b.delay_s) / (2 * h), 1e-8 / kSpeedOfLightMps);
    EXPECT_NEAR(g.rate_p[k], (a.delay_rate - b.delay_rate) / (2 * h), 1e-8 * 7e-3 / kSpeedOfLightMps * 10.0);
    EXPECT_NEAR(g.delay_p[k], -path.direction_e[k] / kSpeedOfLightMps, 3e-5 / kSpeedOfLightMps);
    ASSERT_TRUE(signal_path(orbit, t, p, v + d, a) && signal_path(orbit, t, p, v - d, b));
    EXPECT_NEAR(g.rate_v[k], (a.delay_rate - b.delay_rate) / (2 * h), 1e-9 / kSpeedOfLightMps);
  }
  SignalPath a, b;
  const double ahead = 0.02;
  ASSERT_TRUE(signal_path(orbit, t, p, v, a, ahead) && signal_path(orbit, t, p, v, b, -ahead));
  EXPECT_NEAR(g.delay_ahead, (a.delay_s - b.delay_s) / (2 * ahead), 1e-12);
  EXPECT_NEAR(g.rate_ahead, (a.delay_rate - b.delay_rate) / (2 * ahead), 1e-12);
  EXPECT_GT(std::abs(g.rate_ahead), 1e-8);
}

TEST(SignalPath, AheadMovesAlongTheOrbitInSpace) {
  Circle circle;
  const SampledOrbit orbit = circle.sampled(0.0, 10.0, 200);
  const double t = 1004.0, ahead = 0.5;
  const Eigen::Vector3d p = below(circle, t, 0.1);
  SignalPath moved;
  ASSERT_TRUE(signal_path(orbit, t, p, Eigen::Vector3d::Zero(), moved, ahead));
  circle.phase_rad += circle.rate_radps * ahead;  // the same orbit plane
  SignalPath truth;
  ASSERT_TRUE(signal_path(circle.sampled(0.0, 10.0, 200), t, p, Eigen::Vector3d::Zero(), truth));
  EXPECT_NEAR(moved.range_m, truth.range_m, 2e-3);
  EXPECT_NEAR(moved.delay_rate, truth.delay_rate, 1e-12);
}

TEST(SignalPath, MastsAndRefusals) {
  const Eigen::Vector3d p = geodetic_to_ecef(1.0, 0.4, 10.0);
  const Eigen::Vector3d q = geodetic_to_ecef(1.001, 0.4, 300.0);
  const SampledOrbit mast = SampledOrbit::fixed(q);
  SignalPath there, back;
  PathGradient g;
  ASSERT_TRUE(signal_path(mast, 5.0, p, Eigen::Vector3d::Zero(), there, g, 3.0));
  ASSERT_TRUE(signal_path(SampledOrbit::fixed(p), 1e9, q, Eigen::Vector3d::Zero(), back));
  EXPECT_NEAR(there.range_m, (p - q).norm(), 0.05);                         // the Earth turns 9 mm in 20 us
  EXPECT_NEAR(0.5 * (there.range_m + back.range_m), (p - q).norm(), 1e-6);  // east one way, west the other
  EXPECT_NEAR(there.delay_rate, 0.0, 1e-20);
  EXPECT_EQ(g.delay_ahead, 0.0);
  EXPECT_EQ(g.rate_ahead, 0.0);

  const Circle circle;
  const SampledOrbit orbit = circle.sampled(0.0, 10.0, 20);
  const Eigen::Vector3d near = below(circle, 100.0, 0.1), rest = Eigen::Vector3d::Zero();
  SignalPath path;
  path.delay_s = 42.0;
  EXPECT_FALSE(signal_path(orbit, 0.001, near, rest, path));  // sent before the first sample
  EXPECT_FALSE(signal_path(orbit, 191.0, near, rest, path));
  EXPECT_FALSE(signal_path(orbit, 1e300, near, rest, path));
  EXPECT_FALSE(signal_path(orbit, kNan, near, rest, path));
  EXPECT_FALSE(signal_path(orbit, 100.0, {kNan, 0.0, 0.0}, rest, path));
  EXPECT_FALSE(signal_path(orbit, 100.0, near, {0.0, kNan, 0.0}, path));
  EXPECT_FALSE(signal_path(orbit, 100.0, near, rest, path, kNan));
  EXPECT_FALSE(signal_path(mast, kNan, p, rest, path));
  EXPECT_FALSE(signal_path(mast, 0.0, q, rest, path));
  EXPECT_EQ(path.delay_s, 42.0);
  EXPECT_TRUE(signal_path(orbit, 190.0, near, rest, path));
}

TEST(SignalPath, BelowTheHorizonIsSeenAsSuch) {
  const Circle circle;
  const SampledOrbit orbit = circle.sampled(0.0, 10.0, 20);
  const auto place = ecef_to_geodetic(circle.at(100.0).p_e);
  Direction seen;
  ASSERT_TRUE(look_at(orbit, 100.0, LocalFrame({place->latitude_rad, place->longitude_rad, 0.0}), seen));
  EXPECT_NEAR(seen.elevation_rad, 0.5 * kPi, 1e-3);
  EXPECT_NEAR(seen.range_m, place->height_m, 20.0);
  ASSERT_TRUE(look_at(orbit, 100.0, LocalFrame({-place->latitude_rad, place->longitude_rad + kPi, 0.0}), seen));
  EXPECT_LT(seen.elevation_rad, -1.5);
  EXPECT_FALSE(look_at(orbit, 1e4, LocalFrame({0.0, 0.0, 0.0}), seen));
}

TEST(SignalPath, NothingAllocates) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  const Circle circle;
  const SampledOrbit orbit = circle.sampled(0.0, 10.0, 20);
  const Eigen::Vector3d p = below(circle, 100.0, 0.1), v = Eigen::Vector3d::Zero();
  const LocalFrame frame({0.1, 0.2, 3.0});
  SignalPath path;
  PathGradient g;
  OrbitState s;
  Direction seen;
  bool good = true;
  EXPECT_EQ(test::allocations_of([&] {
              good = orbit.at(50.0, s) && signal_path(orbit, 100.0, p, v, path, g) &&
                     signal_path(orbit, 100.0, p, v, path) && look_at(orbit, 100.0, frame, seen);
            }),
            0);
  EXPECT_TRUE(good);
}

}  // namespace
}  // namespace soopnav::geometry
