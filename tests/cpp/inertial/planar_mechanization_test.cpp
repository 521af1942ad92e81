#include "soopnav/inertial/planar_mechanization.hpp"

#include <gtest/gtest.h>

#include <Eigen/Core>

#include "process/process_battery.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav::inertial {
namespace {

static_assert(ProcessModelFor<PlanarMechanization, PlanarInertialState>);

TEST(PlanarMechanization, JacobianEqualsCentralDifferences) {
  RandomStream random(23);
  for (const auto integration : {PlanarIntegration::kZeroOrderHold, PlanarIntegration::kEuler}) {
    const PlanarMechanization process{{0.01, 0.2}, integration};
    for (const double dt : {0.02, 0.5}) {
      for (int k = 0; k < 20; ++k) {
        const test::Place<PlanarInertialState> place(test::kLocal, random);
        const PlanarImuSample u{random.normal(), {3.0 * random.normal(), 3.0 * random.normal()}};
        EXPECT_LT(test::worst_transition_error(process, place.x, place.scale, dt, u), 1e-7) << dt << ", state " << k;
      }
    }
  }
}

TEST(PlanarMechanization, PacketsFollowStates) {
  const PlanarMechanization process{{0.01, 0.2}};
  EXPECT_LE((test::worst_packet_ulps<PlanarInertialState>(process, 0.02, {0.3, {1.0, -2.0}})), 4.0);
}

TEST(PlanarMechanization, TurnsForceIntoThePlane) {
  // Heading along the second axis: a push forward goes there, a push to the left goes against the first.
  PlanarInertialState x;
  x.x << kPi / 2.0, 0.0, 0.0, 0.0, 0.0;
  const PlanarMechanization process{};
  const auto forward = test::next_state(process, x, 2.0, ZeroNoise{}, {0.0, {1.0, 0.0}});
  EXPECT_NEAR(forward.x[2], 2.0, 1e-12);
  EXPECT_NEAR(forward.x[4], 2.0, 1e-12);
  const auto left = test::next_state(process, x, 2.0, ZeroNoise{}, {0.0, {0.0, 1.0}});
  EXPECT_NEAR(left.x[1], -2.0, 1e-12);
  EXPECT_NEAR(left.x[3], -2.0, 1e-12);
  // A positive yaw rate turns from the first axis towards the second.
  EXPECT_NEAR(test::next_state(process, PlanarInertialState{}, 2.0, ZeroNoise{}, {0.1, {0.0, 0.0}}).x[0], 0.2, 1e-12);
}

}  // namespace
}  // namespace soopnav::inertial
