#include "soopnav/navigation/cooperative_model.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "navigation/cooperative_world.hpp"
#include "soopnav/estimation/prediction.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/measurement/range_difference.hpp"
#include "soopnav/measurement/range_rate.hpp"

namespace soopnav::navigation {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using pair_test::Clocks;
using pair_test::exact_pair;
using pair_test::kC;
using pair_test::kCarrierHz;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
using State = PositionVelocityClock<EcefFrame, 3>;

// A satellite overhead of nobody in particular, and two receivers 200 km apart, both moving.
struct Scene {
  geometry::SampledOrbit orbit;
  PairReceiver target, anchor;
  Clocks clocks{2.5e5, 250.0, 0.0};
  double t = 40.0;

  explicit Scene(double separation_m = 2e5) : orbit(some_orbit()) {
    geometry::OrbitState s;
    EXPECT_TRUE(orbit.at(t, s));
    const auto below = geometry::ecef_to_geodetic(s.p_e);
    EXPECT_TRUE(below);
    const double latitude = below->latitude_rad - 0.08, longitude = below->longitude_rad + 0.1;
    anchor = {geometry::geodetic_to_ecef(latitude, longitude, 100.0), {20.0, -10.0, 5.0}};
    const double angle = separation_m / 6.38e6;
    target = {geometry::geodetic_to_ecef(latitude + 0.6 * angle, longitude + 0.8 * angle, 300.0), {-80.0, 120.0, 60.0}};
  }
  static geometry::SampledOrbit some_orbit() {
    auto shape = geometry::WalkerConstellation::iridium();
    shape.first_phase_rad = 0.7;
    return shape.orbits()[0].sampled(0.0, 100.0);
  }
  [[nodiscard]] Vector2d observed() const {
    const Vector2d z = exact_pair(orbit, t, target, anchor, clocks);
    return {kC * z[0], -kC / kCarrierHz * z[1]};
  }
  [[nodiscard]] PairGeometry expected(double along_m = 0.0) const {
    PairGeometry g;
    EXPECT_TRUE(
        pair_geometry(orbit, t, target, anchor, clocks.theta_m, clocks.alpha_mps, clocks.anchor_drift_mps, along_m, g));
    return g;
  }
};

TEST(PairModel, MeetsTheWavefrontAtEachReceiversOwnInstant) {
  for (const double separation : {0.0, 1e3, 2e5, 8e5}) {
    Scene scene(separation);
    scene.clocks.anchor_drift_mps = -120.0;
    const PairGeometry g = scene.expected();
    const Vector2d z = scene.observed();
    EXPECT_NEAR(g.value[0], z[0], 2e-5) << separation;
    EXPECT_NEAR(g.value[1], z[1], 1e-7) << separation;
  }
}

TEST(PairModel, SignsAreThoseOfTheContract) {
  Scene scene;
  const PairGeometry g = scene.expected();
  Scene later = scene;
  geometry::SignalPath path;
  ASSERT_TRUE(geometry::signal_path(scene.orbit, scene.t, scene.target.p_e, Vector3d::Zero(), path));
  later.target.p_e -= 1000.0 * path.direction_e;  // farther from the satellite: later
  EXPECT_NEAR(later.expected().value[0] - g.value[0], 1000.0, 1.0);
  Scene receding = scene;
  receding.target.v_e -= 10.0 * path.direction_e;  // recedes: a lower frequency, a higher range rate
  EXPECT_NEAR(receding.expected().value[1] - g.value[1], 10.0, 0.01);
  Scene ahead = scene;
  ahead.clocks.theta_m += 300.0;  // a clock that is ahead stamps later
  EXPECT_NEAR(ahead.expected().value[0] - g.value[0], 300.0, 1e-6);
  Scene fast = scene;
  fast.clocks.alpha_mps += 3.0;  // a clock that is fast sees carriers lower
  EXPECT_NEAR(fast.expected().value[1] - g.value[1], 3.0, 1e-3);
  PairMeasurement m;
  m.tdoa_s = 1e-6;
  m.fdoa_hz = 10.0;
  m.carrier_hz = kCarrierHz;
  m.covariance << 4e-12, 1e-6, 1e-6, 9.0;
  PairObservation o;
  ASSERT_TRUE(pair_observation(m, o));
  EXPECT_NEAR(o.z[0], 299.792458, 1e-9);
  EXPECT_LT(o.z[1], 0.0);
  EXPECT_NEAR(std::sqrt(o.R(1, 1)), 3.0 * kC / kCarrierHz, 1e-12);
  EXPECT_LT(o.R(0, 1), 0.0);
}

TEST(PairModel, SwappingTheReceiversTurnsTheSigns) {
  Scene scene;
  scene.clocks = {0.0, 0.0, 0.0};
  const PairGeometry g = scene.expected();
  Scene swapped = scene;
  // By the target's time now: the anchor is met at what was the target's instant.
  swapped.t = scene.t + g.later_s;
  swapped.target = {scene.anchor.p_e + g.later_s * scene.anchor.v_e, scene.anchor.v_e};
  swapped.anchor = {scene.target.p_e + g.later_s * scene.target.v_e, scene.target.v_e};
  const PairGeometry h = swapped.expected();
  EXPECT_NEAR(h.value[0], -g.value[0], 2e-5);
  EXPECT_NEAR(h.value[1], -g.value[1], 1e-7);
}

TEST(PairModel, AgreesWithTdoaAndFdoaOfAMast) {
  Scene scene(2e4);
  const Vector3d mast = scene.anchor.p_e + Vector3d(9e3, -7e3, 300.0);
  scene.orbit = geometry::SampledOrbit::fixed(mast);
  const PairGeometry g = scene.expected();
  State x;
  x.x << scene.target.p_e, scene.target.v_e, scene.clocks.theta_m, scene.clocks.alpha_mps;
  Prediction<1, State> tdoa, fdoa;
  ASSERT_TRUE((Tdoa<EcefFrame, Known<3>, Known<3>, Role<1, ClockBiasTag>>{mast, scene.anchor.p_e}.predict(x, tdoa)));
  ASSERT_TRUE((Fdoa<EcefFrame, Known<3>, Known<3>, Known<3>, Known<3>, Role<1, ClockDriftTag>>{
      kCarrierHz, mast, {}, scene.anchor.p_e, scene.anchor.v_e}
                   .predict(x, fdoa)));
  EXPECT_NEAR(g.value[0], tdoa.z[0], 0.1);                      // the Earth turns below the light
  EXPECT_NEAR(g.value[1], -kC / kCarrierHz * fdoa.z[0], 1e-3);  // v²/c
  EXPECT_NEAR((g.target_p.row(0) - tdoa.H.leftCols<3>()).norm(), 0.0, 1e-5);
  EXPECT_EQ(g.along_track, Vector2d::Zero());
}

TEST(PairModel, JacobianIsTheDerivative) {
  for (const double separation : {1e4, 5e5}) {
    Scene scene(separation);
    scene.clocks.anchor_drift_mps = 90.0;
    const double along = 700.0;
    const PairGeometry g = scene.expected(along);
    const auto difference = [&](double step, const auto& change) {
      Scene up = scene, down = scene;
      change(up, step);
      change(down, -step);
      return Vector2d((up.expected(along).value - down.expected(along).value) / (2.0 * step));
    };
    const auto agrees = [](const Vector2d& numeric, const Vector2d& analytic, const Vector2d& scale) {
      // What is left out: the rate's change between the arrivals, 4e-5 of the gradient.
      EXPECT_NEAR(numeric[0], analytic[0], 1e-4 * scale[0]);
      EXPECT_NEAR(numeric[1], analytic[1], 3e-4 * scale[1]);
    };
    for (const double step : {3.0, 30.0}) {
      for (int k = 0; k < 3; ++k) {
        agrees(difference(step, [&](Scene& s, double d) { s.target.p_e[k] += d; }), g.target_p.col(k), {1.0, 5e-3});
        agrees(difference(step, [&](Scene& s, double d) { s.anchor.p_e[k] += d; }), g.anchor_p.col(k), {1.0, 5e-3});
        agrees(difference(step, [&](Scene& s, double d) { s.target.v_e[k] += d; }), g.target_v.col(k), {1.0, 1.0});
        agrees(difference(step, [&](Scene& s, double d) { s.anchor.v_e[k] += d; }), g.anchor_v.col(k), {1.0, 1.0});
      }
      agrees(difference(step, [](Scene& s, double d) { s.clocks.theta_m += d; }), g.theta, {1.0, 1.0});
      agrees(difference(step, [](Scene& s, double d) { s.clocks.alpha_mps += d; }), g.alpha, {1.0, 1.0});
      const auto at = [&](double a) { return scene.expected(along + a).value; };
      agrees((at(10.0 * step) - at(-10.0 * step)) / (20.0 * step), g.along_track, {0.1, 1e-3});
    }
  }
}

TEST(PairModel, IsTheSameForRolesAndForKnownAnchors) {
  const Scene scene;
  State x;
  x.x << scene.target.p_e, scene.target.v_e, scene.clocks.theta_m, scene.clocks.alpha_mps;
  const PairModel<> model{&scene.orbit, scene.t, scene.anchor.p_e, scene.anchor.v_e};
  Prediction<2, State> y;
  ASSERT_TRUE(model.predict(x, y));
  const PairGeometry g = scene.expected();
  EXPECT_EQ(y.z, g.value);
  EXPECT_EQ((y.H.block<2, 3>(0, State::at(kPosition))), g.target_p);
  EXPECT_EQ((y.H.block<2, 3>(0, State::at(kVelocity))), g.target_v);
  EXPECT_EQ((y.H.col(State::at(kClockBias))), g.theta);
  EXPECT_EQ((y.H.col(State::at(kClockDrift))), g.alpha);
}

TEST(PairModel, RefusesWhatHasNoAnswer) {
  const Scene scene;
  PairGeometry g;
  const auto asks = [&](const geometry::SampledOrbit& orbit, double t, const PairReceiver& a, double theta) {
    return pair_geometry(orbit, t, a, scene.anchor, theta, 0.0, 0.0, 0.0, g);
  };
  EXPECT_TRUE(asks(scene.orbit, scene.t, scene.target, 0.0));
  EXPECT_FALSE(asks(scene.orbit, 1000.0, scene.target, 0.0));  // outside the samples
  EXPECT_FALSE(asks(scene.orbit, kNan, scene.target, 0.0));
  EXPECT_FALSE(asks(scene.orbit, scene.t, {{kNan, 0.0, 0.0}, Vector3d::Zero()}, 0.0));
  EXPECT_FALSE(asks(scene.orbit, scene.t, scene.target, kNan));
  EXPECT_FALSE(asks(geometry::SampledOrbit::fixed(scene.anchor.p_e), scene.t, scene.target, 0.0));
  PairMeasurement m;
  PairObservation o;
  EXPECT_FALSE(pair_observation(m, o));  // no carrier
  m.carrier_hz = kCarrierHz;
  EXPECT_TRUE(pair_observation(m, o));
  m.anchor_p_e[1] = kNan;
  EXPECT_FALSE(pair_observation(m, o));
}

}  // namespace
}  // namespace soopnav::navigation
