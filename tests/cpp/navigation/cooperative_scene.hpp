#pragma once

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <vector>

#include "inertial/manoeuvre.hpp"
#include "soopnav/clock/clock_simulator.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/geometry/sampled_orbit.hpp"
#include "soopnav/navigation/cooperative_filter.hpp"

namespace soopnav::test {

/// A satellite on a circular orbit of 780 km that passes over `at` at t = 60 s, flying towards `azimuth_rad` there.
inline geometry::SampledOrbit pass_over(const geometry::Geodetic& at, double azimuth_rad) {
  const double r = wgs84::kSemiMajorAxisM + 780e3;
  const double w = std::sqrt(wgs84::kGravitationalParameterM3ps2 / (r * r * r));
  const geometry::LocalFrame frame(at);
  const Eigen::Vector3d up = frame.velocity_to_ecef({0.0, 0.0, 1.0});
  const Eigen::Vector3d along = frame.velocity_to_ecef({std::sin(azimuth_rad), std::cos(azimuth_rad), 0.0});
  const Eigen::Vector3d earth(0.0, 0.0, wgs84::kEarthRateRadps);
  std::vector<double> p;
  std::vector<double> v;
  for (int k = 0; k <= 30; ++k) {
    const double t = -60.0 + 10.0 * k;
    const double angle = w * (t - 60.0);
    const Eigen::Matrix3d turn =
        Eigen::AngleAxisd(-wgs84::kEarthRateRadps * (t - 60.0), Eigen::Vector3d::UnitZ()).toRotationMatrix();
    const Eigen::Vector3d q = turn * (r * (std::cos(angle) * up + std::sin(angle) * along));
    const Eigen::Vector3d u = turn * (r * w * (std::cos(angle) * along - std::sin(angle) * up)) - earth.cross(q);
    p.insert(p.end(), q.begin(), q.end());
    v.insert(v.end(), u.begin(), u.end());
  }
  return {-60.0, 10.0, p, v};
}

/// Four satellites above a car that turns and climbs; an anchor 10 km away.
struct PairWorld {
  simulation::SpatialTrajectory path = manoeuvre();
  std::vector<geometry::SampledOrbit> beacons{
      pass_over({kHome.latitude_rad + 0.10, kHome.longitude_rad, 0.0}, 0.2),
      pass_over({kHome.latitude_rad - 0.08, kHome.longitude_rad + 0.12, 0.0}, 2.5),
      pass_over({kHome.latitude_rad, kHome.longitude_rad - 0.15, 0.0}, 1.3),
      pass_over({kHome.latitude_rad + 0.02, kHome.longitude_rad + 0.05, 0.0}, -1.0)};
  Eigen::Vector3d anchor_p_e = path.frame().position_to_ecef({7000.0, 7000.0, 0.0});
  clock::ClockNoise clock_noise = clock::ClockNoise::from_allan(8e-20, 4e-23);  // of each clock
  double carrier_hz = 1626e6;
  Eigen::Matrix2d R = Eigen::Vector2d(148e-9 * 148e-9, 0.045 * 0.045).asDiagonal();  // [s, Hz]

  [[nodiscard]] navigation::PairVector truth(double t_s, const clock::ClockState& difference) const {
    const auto m = path.at(t_s);
    navigation::PairVector x;
    x << path.frame().position_to_ecef(m.p_n_m), path.frame().velocity_to_ecef(m.v_n_mps), difference.bias_m,
        difference.drift_mps;
    return x;
  }
  [[nodiscard]] navigation::PairModel<> model(std::size_t beacon, double t_s) const {
    navigation::PairModel<> one;
    one.beacon = &beacons[beacon];
    one.t_s = t_s;
    one.anchor_p = Known<3>(anchor_p_e);
    return one;
  }
  /// Both rows of a target, in seconds and hertz.
  [[nodiscard]] Eigen::Vector2d measured(std::size_t beacon, double t_s, const navigation::PairVector& x) const {
    navigation::PairGeometry g;
    if (!navigation::pair_geometry(beacons[beacon], t_s, {x.head<3>(), x.segment<3>(3)},
                                   {anchor_p_e, Eigen::Vector3d::Zero()}, x[6], x[7], 0.0, 0.0, g)) {
      return Eigen::Vector2d::Constant(std::nan(""));
    }
    return {g.value[0] / kSpeedOfLightMps, -g.value[1] * carrier_hz / kSpeedOfLightMps};
  }
  [[nodiscard]] navigation::PairObservation observed(std::size_t beacon, double t_s, const Eigen::Vector2d& z) const {
    navigation::PairObservation out;
    const navigation::PairMeasurement m{t_s,        static_cast<int>(beacon), z[0], z[1], R, carrier_hz,
                                        anchor_p_e, Eigen::Vector3d::Zero()};
    if (!navigation::pair_observation(m, out)) out.z.setConstant(std::nan(""));
    return out;
  }
};

inline Eigen::VectorXd normals(RandomStream& random, Eigen::Index n) {
  Eigen::VectorXd out(n);
  for (double& x : out) x = random.normal();
  return out;
}

/// Deviations of a start: 20 m, 0.5 m/s, 100 m, 1 m/s.
inline navigation::PairVector start_sigma() {
  navigation::PairVector s;
  s << Eigen::Vector3d::Constant(20.0), Eigen::Vector3d::Constant(0.5), 100.0, 1.0;
  return s;
}

inline const PairWorld& world() {
  static const PairWorld one;
  return one;
}
inline navigation::PairSquare start_covariance() { return start_sigma().cwiseAbs2().asDiagonal(); }

struct Drawn {
  double t_s;
  std::size_t beacon;
  navigation::PairVector truth;
  Eigen::Vector2d z;
};

// Bursts once a second while the car drives, with the clocks' and the measurements' noise.
inline std::vector<Drawn> drive(RandomStream random, double until_s) {
  std::vector<Drawn> out;
  clock::ClockSimulator clock(world().clock_noise + world().clock_noise, random.substream(0), {3e4, 40.0});
  const Eigen::Matrix2d L = world().R.cwiseSqrt();
  double t = 0.0;
  for (int k = 1; k <= static_cast<int>(until_s); ++k) {
    const double next = k - 0.3 * random.uniform();
    EXPECT_TRUE(clock.advance(next - t));
    t = next;
    const auto beacon = static_cast<std::size_t>(4.0 * random.uniform());
    const navigation::PairVector x = world().truth(t, clock.state());
    out.push_back({t, beacon, x, world().measured(beacon, t, x) + L * normals(random, 2)});
  }
  return out;
}
inline navigation::PairVector wrong_start(RandomStream& random) {
  return world().truth(0.0, {3e4, 40.0}) +
         start_sigma().cwiseProduct(navigation::PairVector(normals(random, navigation::kPairDim)));
}

}  // namespace soopnav::test
