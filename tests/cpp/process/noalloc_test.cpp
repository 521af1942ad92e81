// No heap in any process: counted.
#include <gtest/gtest.h>

#include <Eigen/Core>

#include "measurement/jacobian_battery.hpp"
#include "soopnav/clock/two_state.hpp"
#include "soopnav/core/joint_process.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/transition.hpp"
#include "soopnav/process/attitude_random_walk.hpp"
#include "soopnav/process/coordinated_turn.hpp"
#include "soopnav/process/nearly_constant_velocity.hpp"
#include "soopnav/process/planar_odometry.hpp"
#include "support/allocation_count.hpp"

namespace soopnav {
namespace {

template <class State, class Process>
void step(const char* what, const Process& process) {
  RandomStream random(1);
  const State x = test::Place<State>(test::kLocal, random).x;
  bool defined = false;
  EXPECT_EQ(test::allocations_of([&] {
              Transition<State, Process::kNoise> y(x);
              ValueTransition<State> values(x);
              defined = detail::propagate(process, x, InputOf<Process>{}, 0.1, ZeroNoise{}, y) &&
                        detail::propagate(process, x, InputOf<Process>{}, 0.1, ZeroNoise{}, values);
            }),
            0)
      << what;
  EXPECT_TRUE(defined) << what;
}

TEST(ProcessNoAlloc, Models) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  using Receiver = PositionVelocityClock<EnuFrame, 3>;
  using Turning = ComposedState<PlanarFrame, Role<2, PositionTag>, Role<2, VelocityTag>, Role<1, TurnRateTag>>;
  step<Receiver>("motion and clock", JointProcess{NearlyConstantVelocity<3>{{1.0, 1.0, 1.0}},
                                                  clock::TwoState{clock::ClockNoise{1.0, 2.0}}});
  step<Receiver>("acceleration", PiecewiseConstantAcceleration<3>{{1.0, 1.0, 1.0}});
  step<Turning>("turn", CoordinatedTurn<>{1.0, 0.1});
  step<ComposedState<EnuFrame, Role<3, AttitudeTag>>>("attitude", AttitudeRandomWalk{{1.0, 1.0, 1.0}});
  step<ComposedState<PlanarFrame, Role<1, HeadingTag>, Role<2, PositionTag>>>("odometry", PlanarOdometry{});
}

}  // namespace
}  // namespace soopnav
