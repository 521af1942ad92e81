#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/clock/clock_simulator.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/geometry/orbit.hpp"
#include "soopnav/geometry/wgs84.hpp"
#include "soopnav/navigation/cooperative_tracker.hpp"

namespace soopnav::navigation::pair_test {

inline constexpr double kC = kSpeedOfLightMps;
inline constexpr double kCarrierHz = 1626.27e6;

/// What a clock's reading is off where it matters: c times bias [m] and its rate.
struct Clocks {
  double theta_m, alpha_mps, anchor_drift_mps = 0.0;
};

/// TDOA [s] and FDOA [Hz] of a pair, from the instant of sending forwards: each arrival is found by its own fixed
/// point.
inline Eigen::Vector2d exact_pair(const geometry::SampledOrbit& beacon, double t_b, const PairReceiver& a,
                                  const PairReceiver& b, const Clocks& clocks, double ahead_s = 0.0) {
  geometry::SignalPath near, far;
  if (!geometry::signal_path(beacon, t_b, b.p_e, b.v_e, near, ahead_s)) return Eigen::Vector2d::Constant(std::nan(""));
  const double sent = t_b - near.delay_s;
  double t_a = t_b;
  for (int i = 0; i < 30; ++i) {
    if (!geometry::signal_path(beacon, t_a, a.p_e + (t_a - t_b) * a.v_e, a.v_e, far, ahead_s)) break;
    t_a = sent + far.delay_s;
  }
  const double drift = (clocks.alpha_mps + clocks.anchor_drift_mps) / kC;
  const double reading_a = (t_a - t_b) * (1.0 + drift) + clocks.theta_m / kC;
  const double f_a = kCarrierHz * (1.0 - far.delay_rate) / (1.0 + drift);
  const double f_b = kCarrierHz * (1.0 - near.delay_rate) / (1.0 + clocks.anchor_drift_mps / kC);
  return {reading_a, f_a - f_b};
}

struct WorldOptions {
  double duration_s = 300.0;
  double interval_s = 1.0;
  double separation_m = 10e3;
  double sigma_tdoa_s = 2.73e-6;
  double sigma_fdoa_hz = 2.19;
  double h0 = 8e-20;
  double h_minus_2 = 4e-23;
  double along_track_m = 0.0;  ///< deviation of how far satellites really are ahead
  double jump_s = 0.0;         ///< of the target's clock, from `jump_at_s` on
  double jump_drift = 0.0;
  double jump_at_s = 1e9;
  int only_satellite_of = 0;            ///< 1: one satellite for all
  Eigen::Vector2d speed_mps{0.0, 0.0};  ///< east, north, of the target
  double mask_rad = 0.14;
};

/// 66 satellites over Helsinki, an anchor, a target, clocks and bursts; everything follows from the seed.
struct World {
  std::vector<PairBeacon> beacons;
  std::vector<PairMeasurement> bursts;
  std::vector<PairVector> truth;  ///< of each burst
  std::vector<double> along_m;    ///< of each beacon
  Eigen::Vector3d anchor, target, east, north, up;
  double height_m = 0.0;  ///< as it is
  clock::ClockNoise clock{};

  explicit World(std::uint64_t seed, const WorldOptions& o = {}) {
    RandomStream random(seed);
    auto shape = geometry::WalkerConstellation::iridium();
    shape.first_node_rad = random.uniform(0.0, kTwoPi);
    shape.first_phase_rad = random.uniform(0.0, kTwoPi);
    for (const auto& orbit : shape.orbits(0.0, random.uniform(0.0, kTwoPi))) {
      beacons.push_back({orbit.sampled(-60.0, o.duration_s + 120.0)});
      along_m.push_back(o.along_track_m * random.normal());
    }
    const double latitude = 60.2 * kPi / 180.0, longitude = 25.0 * kPi / 180.0;
    anchor = geometry::geodetic_to_ecef(latitude, longitude, 20.0);
    const double azimuth = random.uniform(0.0, kTwoPi);
    const double angle = o.separation_m / 6.39e6;
    const auto place =
        geometry::Geodetic{latitude + angle * std::cos(azimuth),
                           longitude + angle * std::sin(azimuth) / std::cos(latitude), random.uniform(-30.0, 70.0)};
    height_m = place.height_m;
    target = geometry::geodetic_to_ecef(place);
    east = {-std::sin(longitude), std::cos(longitude), 0.0};
    up = {std::cos(latitude) * std::cos(longitude), std::cos(latitude) * std::sin(longitude), std::sin(latitude)};
    north = up.cross(east);
    const Eigen::Vector3d velocity = o.speed_mps[0] * east + o.speed_mps[1] * north;
    clock = clock::ClockNoise::from_allan(o.h0, o.h_minus_2);
    clock::ClockSimulator both(clock + clock, random.substream(1),
                               {random.uniform(-3e5, 3e5), random.uniform(-300.0, 300.0)});
    double now = 0.0;
    for (int k = 0; k < static_cast<int>(o.duration_s / o.interval_s); ++k) {
      const double t = o.interval_s * (k + 0.5 + random.uniform(-0.3, 0.3));
      static_cast<void>(both.advance(t - now));
      now = t;
      const PairReceiver a{target + t * velocity, velocity}, b{anchor, Eigen::Vector3d::Zero()};
      std::vector<int> seen;
      for (int i = 0; i < static_cast<int>(beacons.size()); ++i) {
        if (elevation(a.p_e, i, t) > o.mask_rad && elevation(anchor, i, t) > o.mask_rad) seen.push_back(i);
      }
      const double lot = random.uniform(), first = random.normal(), second = random.normal();
      if (seen.empty()) continue;
      const int beacon = o.only_satellite_of != 0
                             ? highest(seen, t)
                             : seen[static_cast<std::size_t>(lot * static_cast<double>(seen.size()))];
      if (o.only_satellite_of != 0 && !bursts.empty() && beacon != bursts.front().beacon) continue;
      Clocks clocks{both.state().bias_m, both.state().drift_mps};
      if (t >= o.jump_at_s) {
        clocks.theta_m += kC * (o.jump_s + o.jump_drift * (t - o.jump_at_s));
        clocks.alpha_mps += kC * o.jump_drift;
      }
      const auto i = static_cast<std::size_t>(beacon);
      const Eigen::Vector2d z = exact_pair(beacons[i].orbit, t, a, b, clocks, along_m[i] / 7461.0);
      PairMeasurement m;
      m.t_s = t;
      m.beacon = beacon;
      m.tdoa_s = z[0] + o.sigma_tdoa_s * first;
      m.fdoa_hz = z[1] + o.sigma_fdoa_hz * second;
      m.covariance << o.sigma_tdoa_s * o.sigma_tdoa_s, 0.0, 0.0, o.sigma_fdoa_hz * o.sigma_fdoa_hz;
      m.carrier_hz = kCarrierHz;
      m.anchor_p_e = anchor;
      bursts.push_back(m);
      PairVector x;
      x << a.p_e, a.v_e, clocks.theta_m, clocks.alpha_mps;
      truth.push_back(x);
    }
  }

  [[nodiscard]] double elevation(const Eigen::Vector3d& p, int beacon, double t) const {
    geometry::OrbitState s;
    if (!beacons[static_cast<std::size_t>(beacon)].orbit.at(t, s)) return -2.0;
    return std::asin(up.dot((s.p_e - p).normalized()));
  }
  [[nodiscard]] int highest(const std::vector<int>& seen, double t) const {
    return *std::max_element(seen.begin(), seen.end(),
                             [&](int i, int j) { return elevation(anchor, i, t) < elevation(anchor, j, t); });
  }
  [[nodiscard]] CooperativeOptions options() const {
    CooperativeOptions o;
    o.target_clock = o.anchor_clock = clock;
    o.height_m = height_m;
    o.height_sigma_m = 10.0;
    return o;
  }
  /// A start at `off_m` to the east of the truth at burst `k`, with the deviation that it says.
  void start_near(CooperativeTracker& tracker, std::size_t k, double off_m, double sigma_m) const {
    PairVector x = truth[k], sigma;
    x.head<3>() += off_m * east;
    sigma << Eigen::Vector3d::Constant(sigma_m), Eigen::Vector3d::Constant(1e-3), 1e5, 300.0;
    tracker.start_at(bursts[k].t_s, x, PairSquare(sigma.cwiseAbs2().asDiagonal()));
  }
};

inline double nees(const PairVector& error, const PairSquare& P) { return error.dot(P.ldlt().solve(error)); }
inline double position_error(const CooperativeTracker& tracker, const PairVector& truth) {
  return (tracker.estimate().mean - truth).head<3>().norm();
}
inline long count(const CooperativeTracker& tracker, PairUse use) {
  return tracker.counts()[static_cast<std::size_t>(use)];
}
inline std::span<const PairMeasurement> until(const World& world, double t_s) {
  std::size_t n = 0;
  while (n < world.bursts.size() && world.bursts[n].t_s < t_s) ++n;
  return std::span(world.bursts).first(n);
}

}  // namespace soopnav::navigation::pair_test
