// Every process model: F and G against central differences.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <array>

#include "process/process_battery.hpp"
#include "soopnav/core/joint_process.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/process/attitude_random_walk.hpp"
#include "soopnav/process/coordinated_turn.hpp"
#include "soopnav/process/nearly_constant_velocity.hpp"
#include "soopnav/process/planar_odometry.hpp"
#include "soopnav/process/random_walk.hpp"

namespace soopnav {
namespace {

using Moving = ComposedState<EcefFrame, Role<3, PositionTag>, Role<3, VelocityTag>, Role<3, AttitudeTag>>;
using Turning = ComposedState<PlanarFrame, Role<2, VelocityTag>, Role<1, TurnRateTag>, Role<2, PositionTag>>;
using Pose = ComposedState<PlanarFrame, Role<2, PositionTag>, Role<1, HeadingTag>>;

template <class State, class Process>
void hold(const char* what, const Process& process, const test::Scene& scene = test::kLocal,
          const InputOf<Process>& u = {}) {
  RandomStream random(17);
  for (const double dt : {0.02, 1.0, 7.0}) {
    for (int k = 0; k < 10; ++k) {
      const test::Place<State> place(scene, random);
      EXPECT_LT(test::worst_transition_error(process, place.x, place.scale, dt, u), 1e-7)
          << what << ", step " << dt << ", state " << k;
    }
  }
}

TEST(ProcessJacobian, ConstantVelocity) {
  hold<PositionVelocity<EnuFrame, 3>>("nearly constant velocity", NearlyConstantVelocity<3>{{0.3, 1.0, 2.0}});
  hold<PositionVelocity<PlanarFrame, 2>>("nearly constant velocity, planar", NearlyConstantVelocity<2>{{0.3, 1.0}});
  hold<PositionVelocity<PlanarFrame, 2>>("constant velocity", NearlyConstantVelocity<2>{});
  hold<PositionVelocity<EnuFrame, 3>>("constant acceleration", PiecewiseConstantAcceleration<3>{{0.3, 1.0, 2.0}});
  // At Earth magnitudes the noise has to be seen beside 6e6 m.
  hold<Moving>("nearly constant velocity, ECEF", NearlyConstantVelocity<3>{{10.0, 10.0, 10.0}}, test::kEarth);
}

TEST(ProcessJacobian, Walks) {
  hold<Moving>("position", RandomWalk{kPosition, {1.0, 2.0, 3.0}});
  hold<Pose>("heading", RandomWalk{kHeading, {0.01}});
  hold<Moving>("attitude", AttitudeRandomWalk{{1e-4, 4e-4, 9e-4}});
}

TEST(ProcessJacobian, CoordinatedTurn) {
  const CoordinatedTurn<> process{0.5, 0.01};
  hold<Turning>("turn", process);
  // Straight on, nearly so, and where the series hands over (turned by half a radian).
  RandomStream random(18);
  for (const double rate : {0.0, 1e-12, 1e-6, 1e-3, 0.4999, 0.5001, -0.5, 3.0}) {
    test::Place<Turning> place(test::kLocal, random);
    place.x.x[2] = rate;
    EXPECT_LT(test::worst_transition_error(process, place.x, place.scale, 1.0), 1e-7) << rate;
  }
}

TEST(ProcessJacobian, Odometry) {
  Eigen::Matrix3d L;
  L << 0.1, 0.0, 0.0, 0.02, 0.2, 0.0, 0.003, 0.004, 0.01;
  hold<Pose>("odometry", PlanarOdometry{L}, test::kLocal, {{1.2, -0.3}, 0.2});
}

TEST(ProcessJacobian, JoinedProcesses) {
  hold<Moving>("motion and attitude",
               JointProcess{NearlyConstantVelocity<3>{{0.3, 1.0, 2.0}}, AttitudeRandomWalk{{1e-4, 4e-4, 9e-4}}});
  hold<Turning>("turn and diffusion",
                JointProcess{CoordinatedTurn<>{0.5, 0.01}, RandomWalk{kPlanarPosition, {1.0, 2.0}}});
}

// The battery must see what it is made to see.
template <int Wrong>
struct Spoiled {
  static constexpr int kNoise = 6;
  CoordinatedTurn<> right;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    const bool defined = right.propagate(x, dt_s, w, y);
    if constexpr (Y::kJacobian) {
      if constexpr (Wrong == 0) y.transition(kPlanarPosition, kTurnRate)(0) *= -1.0;
      if constexpr (Wrong == 1) y.transition(kPlanarVelocity, kPlanarVelocity)(0, 0) += 1e-6;
      if constexpr (Wrong == 2) y.noise(kPlanarPosition)(0, 1) *= -1.0;
      if constexpr (Wrong == 3) y.noise(kTurnRate)(0, 4) *= 1.0 + 1e-5;
      if constexpr (Wrong == 4) y.next(kPlanarPosition)[0] += 1e-9;
    }
    return defined;
  }
};

TEST(ProcessBatteryItself, FindsWrongJacobians) {
  RandomStream random(19);
  const test::Place<Turning> place(test::kLocal, random);
  const CoordinatedTurn<> right{0.5, 0.01};
  const auto error = [&](const auto& process) {
    return test::worst_transition_error(process, place.x, place.scale, 1.0);
  };
  EXPECT_LT(error(right), 1e-7);
  EXPECT_GT(error(Spoiled<0>{right}), 1e-3);
  EXPECT_GT(error(Spoiled<1>{right}), 2e-7);
  EXPECT_GT(error(Spoiled<2>{right}), 1e-3);
  EXPECT_GT(error(Spoiled<3>{right}), 1e-6);
  EXPECT_GT(error(Spoiled<4>{right}), 1.0);
}

}  // namespace
}  // namespace soopnav
