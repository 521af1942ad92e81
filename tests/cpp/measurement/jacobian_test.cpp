// Every measurement model against central differences: 2-D and 3-D, receiver, source or both unknown, at local and at
// Earth-centred magnitudes.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "measurement/jacobian_battery.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/core/stacked.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/measurement/azimuth.hpp"
#include "soopnav/measurement/carrier_phase.hpp"
#include "soopnav/measurement/direction.hpp"
#include "soopnav/measurement/planar_increment.hpp"
#include "soopnav/measurement/position_fix.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "soopnav/measurement/range.hpp"
#include "soopnav/measurement/range_difference.hpp"
#include "soopnav/measurement/range_rate.hpp"
#include "soopnav/measurement/received_power.hpp"

namespace soopnav {
namespace {

using test::kEarth;
using test::kLocal;
using test::Scene;
using Space = test::Space<EnuFrame>;
using Ned = test::Space<NedFrame>;
using Ecef = test::Space<EcefFrame>;
using Plane = test::Plane<PlanarFrame>;
using E3 = test::Emitter<3>;
using E2 = test::Emitter<2>;
using V3 = test::EmitterVelocity<3>;
using V2 = test::EmitterVelocity<2>;
using Pos3 = Role<3, PositionTag>;
using Pos2 = Role<2, PositionTag>;
using Bias = Role<1, ClockBiasTag>;
using Drift = Role<1, ClockDriftTag>;
constexpr double kL1 = 1575.42e6;

// `make(random, scene)` draws what the model knows.
template <class State, class Make>
void hold(const char* what, const Scene& scene, Make&& make) {
  RandomStream random(11);
  for (int k = 0; k < 30; ++k) {
    const test::Place<State> place(scene, random);
    const auto model = make(random, scene);
    EXPECT_LT(test::worst_jacobian_error(model, place.x, place.scale), 1e-7) << what << ", state " << k;
  }
}
template <class State, class Make>
void hold_everywhere(const char* what, Make&& make) {
  hold<State>(what, kLocal, make);
  hold<State>(what, kEarth, make);
  // Far satellites.
  const Scene sky{kEarth.centre * 4.0, 4e6};
  RandomStream random(12);
  for (int k = 0; k < 30; ++k) {
    const test::Place<State> place(kEarth, random);
    EXPECT_LT(test::worst_jacobian_error(make(random, sky), place.x, place.scale), 1e-7) << what << ", sky " << k;
  }
}

TEST(Jacobian, Ranges) {
  hold_everywhere<Space>("range", [](auto& r, auto& s) { return Range<EnuFrame>{s.template point<3>(r)}; });
  hold_everywhere<Ecef>("range, ECEF", [](auto& r, auto& s) { return Range<>{s.template point<3>(r)}; });
  hold_everywhere<Space>("range to the unknown", [](auto&, auto&) { return Range<EnuFrame, E3>{}; });
  hold_everywhere<Space>("range from a known place", [](auto& r, auto& s) {
    return Range<EnuFrame, E3, Known<3>>{{}, s.template point<3>(r)};
  });
  hold<Plane>("planar range", kLocal,
              [](auto& r, auto& s) { return Range<PlanarFrame, Known<2>>{s.template point<2>(r)}; });
  hold<Plane>("planar range to the unknown", kLocal, [](auto&, auto&) { return Range<PlanarFrame, E2>{}; });
  hold<PlanarPositionClock<EnuFrame>>("range of stated height", kLocal,
                                      [](auto& r, auto& s) { return Range<EnuFrame>{s.template point<3>(r)}; });
}

TEST(Jacobian, Pseudoranges) {
  hold_everywhere<Ecef>("pseudorange", [](auto& r, auto& s) { return Pseudorange<>{s.template point<3>(r), 12.0}; });
  hold_everywhere<Space>("pseudorange, all unknown",
                         [](auto&, auto&) { return Pseudorange<EnuFrame, test::EmitterClock, E3>{}; });
  hold<Plane>("planar pseudorange", kLocal,
              [](auto&, auto&) { return Pseudorange<PlanarFrame, test::EmitterClock, E2, Bias>{}; });
  hold<PlanarPositionClock<EnuFrame>>("pseudorange of stated height", kLocal,
                                      [](auto& r, auto& s) { return Pseudorange<EnuFrame>{s.template point<3>(r)}; });
  hold_everywhere<Ecef>("carrier phase", [](auto& r, auto& s) {
    return CarrierPhase<EcefFrame, test::Ambiguity>{0.19, s.template point<3>(r)};
  });
  hold_everywhere<Space>("carrier phase, all unknown", [](auto&, auto&) {
    return CarrierPhase<EnuFrame, test::Ambiguity, test::EmitterClock, E3>{0.19};
  });
  hold<Plane>("planar carrier phase", kLocal, [](auto& r, auto& s) {
    return CarrierPhase<PlanarFrame, Known<1>, Known<1>, Known<2>>{0.35, s.template point<2>(r)};
  });
}

TEST(Jacobian, Differences) {
  hold_everywhere<Ecef>("range difference", [](auto& r, auto& s) {
    return RangeDifference<>{s.template point<3>(r), s.template point<3>(r)};
  });
  hold_everywhere<Space>("range difference of an emitter", [](auto& r, auto& s) {
    return RangeDifference<EnuFrame, E3, Known<3>, Known<3>>{{}, s.template point<3>(r), s.template point<3>(r)};
  });
  hold<Plane>("planar range difference", kLocal, [](auto& r, auto& s) {
    return RangeDifference<PlanarFrame, Known<2>>{s.template point<2>(r), s.template point<2>(r)};
  });
  hold<Plane>("planar range difference of an emitter", kLocal, [](auto& r, auto& s) {
    return RangeDifference<PlanarFrame, E2, Known<2>, Known<2>>{{}, s.template point<2>(r), s.template point<2>(r)};
  });
  hold<Plane>("range difference, all unknown", kLocal,
              [](auto&, auto&) { return RangeDifference<PlanarFrame, E2, Role<2, test::PreviousTag>>{}; });
  hold_everywhere<Ecef>("TDOA", [](auto& r, auto& s) {
    return Tdoa<EcefFrame, Known<3>, Known<3>, Bias>{s.template point<3>(r), s.template point<3>(r)};
  });
  hold_everywhere<Space>("TDOA, all unknown", [](auto& r, auto& s) {
    return Tdoa<EnuFrame, E3, Known<3>, Bias, test::EmitterClock>{{}, s.template point<3>(r)};
  });
  hold<Plane>("planar TDOA", kLocal, [](auto& r, auto& s) {
    return Tdoa<PlanarFrame, Known<2>, Known<2>, Bias>{s.template point<2>(r), s.template point<2>(r)};
  });
}

TEST(Jacobian, Rates) {
  hold_everywhere<Ecef>("range rate", [](auto& r, auto& s) {
    return RangeRate<>{s.template point<3>(r), Scene::velocity<3>(r), 0.4};
  });
  hold_everywhere<Space>("range rate, all unknown",
                         [](auto&, auto&) { return RangeRate<EnuFrame, E3, V3, test::EmitterDrift>{}; });
  hold<Plane>("planar range rate", kLocal, [](auto& r, auto& s) {
    return RangeRate<PlanarFrame, Known<2>>{s.template point<2>(r), Scene::velocity<2>(r)};
  });
  hold_everywhere<Ecef>("Doppler", [](auto& r, auto& s) {
    return Doppler<>{kL1, s.template point<3>(r), Scene::velocity<3>(r), 0.4};
  });
  hold<Plane>("planar Doppler of an emitter", kLocal, [](auto& r, auto& s) {
    return Doppler<PlanarFrame, E2, V2, Known<1>, Known<1>, Known<2>, Known<2>>{
        4e8, {}, {}, 0.1, 0.2, s.template point<2>(r), Scene::velocity<2>(r)};
  });
  hold_everywhere<Ecef>("FDOA", [](auto& r, auto& s) {
    return Fdoa<EcefFrame, Known<3>, Known<3>, Known<3>, Known<3>, Drift>{
        kL1, s.template point<3>(r), Scene::velocity<3>(r), s.template point<3>(r), Scene::velocity<3>(r)};
  });
  hold_everywhere<Space>("FDOA, all unknown", [](auto& r, auto& s) {
    return Fdoa<EnuFrame, E3, V3, Known<3>, Known<3>, Drift, test::EmitterDrift>{
        kL1, {}, {}, s.template point<3>(r), Scene::velocity<3>(r)};
  });
  hold<Plane>("planar FDOA", kLocal, [](auto& r, auto& s) {
    return Fdoa<PlanarFrame, E2, V2>{4e8, {}, {}, s.template point<2>(r), Scene::velocity<2>(r)};
  });
}

TEST(Jacobian, Directions) {
  hold_everywhere<Space>("azimuth, ENU", [](auto& r, auto& s) {
    return Azimuth<EnuFrame, Known<1>, Known<3>>{s.template point<3>(r), 0.7};
  });
  hold<Ned>("azimuth, NED", kLocal, [](auto&, auto&) { return Azimuth<NedFrame, Known<1>, E3>{}; });
  hold<Plane>("bearing", kLocal,
              [](auto& r, auto& s) { return Azimuth<PlanarFrame, Role<1, HeadingTag>>{s.template point<2>(r)}; });
  hold<Plane>("bearing of an emitter", kLocal, [](auto& r, auto& s) {
    return Azimuth<PlanarFrame, Role<1, HeadingTag>, E2, Known<2>>{{}, {}, s.template point<2>(r)};
  });
  hold<Plane>("azimuth to the state", kLocal, [](auto& r, auto& s) {
    return AzimuthToEmitter<PlanarFrame, 2>{.heading = 0.3, .receiver_p = s.template point<2>(r)};
  });
  hold_everywhere<Space>("elevation, ENU",
                         [](auto& r, auto& s) { return Elevation<EnuFrame>{s.template point<3>(r)}; });
  hold<Ned>("elevation, NED", kLocal, [](auto&, auto&) { return Elevation<NedFrame, E3>{}; });
  hold<Ned>("azimuth and elevation", kLocal, [](auto& r, auto& s) {
    return AzimuthElevation<NedFrame, Known<1>, E3>{.heading = 0.2 + 0.0 * s.template point<3>(r)[0]};
  });
  hold_everywhere<Ecef>("direction from a body",
                        [](auto& r, auto& s) { return BodyDirection<EcefFrame>{s.template point<3>(r)}; });
  hold<Ned>("direction from a body, all unknown", kLocal, [](auto&, auto&) { return BodyDirection<NedFrame, E3>{}; });
}

TEST(Jacobian, PowersPosesAndFixes) {
  hold_everywhere<Space>("received power", [](auto& r, auto& s) {
    return ReceivedPower<EnuFrame>{s.template point<3>(r), -30.0, 2.3, 10.0};
  });
  hold<Plane>("received power, all unknown", kLocal,
              [](auto&, auto&) { return ReceivedPower<PlanarFrame, E2, test::Power, test::Exponent>{}; });
  hold<Plane>("increment", kLocal, [](auto& r, auto& s) {
    return PlanarIncrement<PlanarFrame>{s.template point<2>(r), r.uniform(-3.0, 3.0)};
  });
  hold<Plane>("increment, both poses unknown", kLocal, [](auto&, auto&) {
    return PlanarIncrement<PlanarFrame, Role<2, test::PreviousTag>, Role<1, test::PreviousTag>>{};
  });
  hold_everywhere<Ecef>("position", [](auto&, auto&) { return PositionFix<>{}; });
  hold<Plane>("velocity", kLocal, [](auto&, auto&) { return PositionFix<PlanarFrame, 2, Role<2, VelocityTag>>{}; });
}

TEST(Jacobian, StackedModels) {
  hold<Plane>("range, bearing and increment", kLocal, [](auto& r, auto& s) {
    return Stacked(Range<PlanarFrame, E2>{}, Azimuth<PlanarFrame, Role<1, HeadingTag>>{s.template point<2>(r)},
                   PlanarIncrement<PlanarFrame, Role<2, test::PreviousTag>, Role<1, test::PreviousTag>>{});
  });
}

// The battery must see what it is made to see.
struct WrongSign {
  static constexpr int kDim = 1;
  Range<EnuFrame> right;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const bool defined = right.predict(x, y);
    if constexpr (Y::kJacobian) y.jacobian(kPosition)(1) *= -1.0;
    return defined;
  }
};
struct SlightlyWrong {
  static constexpr int kDim = 1;
  Range<EnuFrame> right;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const bool defined = right.predict(x, y);
    if constexpr (Y::kJacobian) y.jacobian(kPosition)(0) += 1e-6;
    return defined;
  }
};
// The attitude's columns as if its tangent lay in the frame's axes.
struct WrongTangent {
  static constexpr int kDim = 2;
  BodyDirection<EnuFrame> right;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const bool defined = right.predict(x, y);
    if constexpr (Y::kJacobian) {
      const Eigen::Matrix<double, 2, 3> body = y.jacobian(kAttitude);
      const Eigen::Quaterniond q(x(kAttitude)[0], x(kAttitude)[1], x(kAttitude)[2], x(kAttitude)[3]);
      y.jacobian(kAttitude) = body * q.toRotationMatrix().transpose();
    }
    return defined;
  }
  template <class T>
  [[nodiscard]] static T residual(int row, const T& z, const T& predicted) {
    return BodyDirection<EnuFrame>::residual(row, z, predicted);
  }
};
// Depends on something it has no column for.
struct Forgetful {
  static constexpr int kDim = 1;
  Range<EnuFrame> right;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const bool defined = right.predict(x, y);
    y.value(0) += 1e-3 * x(kClockBias)[0];
    return defined;
  }
};

TEST(JacobianBatteryItself, FindsWrongJacobians) {
  RandomStream random(3);
  for (const Scene& scene : {kLocal, kEarth}) {
    const test::Place<Space> place(scene, random);
    const Range<EnuFrame> right{scene.point<3>(random)};
    const BodyDirection<EnuFrame> direction{scene.point<3>(random)};
    EXPECT_LT(test::worst_jacobian_error(right, place.x, place.scale), 1e-8);
    EXPECT_GT(test::worst_jacobian_error(WrongSign{right}, place.x, place.scale), 0.01);
    EXPECT_GT(test::worst_jacobian_error(SlightlyWrong{right}, place.x, place.scale), 4e-7);
    EXPECT_GT(test::worst_jacobian_error(WrongTangent{direction}, place.x, place.scale), 0.01);
    EXPECT_GT(test::worst_jacobian_error(Forgetful{right}, place.x, place.scale), 1e-4);
  }
}

}  // namespace
}  // namespace soopnav
