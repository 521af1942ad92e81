// A packet of particles gets the values its particles get one by one.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "measurement/jacobian_battery.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/core/stacked.hpp"
#include "soopnav/estimation/particle_view.hpp"
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

using Space = test::Space<EnuFrame>;
using Plane = test::Plane<PlanarFrame>;
using E3 = test::Emitter<3>;
using E2 = test::Emitter<2>;
using V3 = test::EmitterVelocity<3>;
using Bias = Role<1, ClockBiasTag>;

// Largest difference between packets and single states over random particles, in units in the last place of the value,
// or of one where the value is smaller (angles are differences of angles).
template <class State, class T, class Model>
double worst_ulps(const Model& model) {
  constexpr int kWidth = Packet<T>::kWidth;
  RandomStream random(21);
  double worst = 0.0;
  for (int k = 0; k < 64; ++k) {
    std::array<State, static_cast<std::size_t>(kWidth)> states;
    ParticleView<State, T> view;
    for (int lane = 0; lane < kWidth; ++lane) {
      State& x = states[static_cast<std::size_t>(lane)];
      x = test::Place<State>(test::kLocal, random).x;
      for (std::size_t i = 0; i < view.values.size(); ++i) {
        view.values[i].set(lane, static_cast<T>(x.x[static_cast<Eigen::Index>(i)]));
      }
    }
    ValuePrediction<Packet<T>, Model::kDim> packet;
    EXPECT_TRUE(model.predict(view, packet));
    for (int lane = 0; lane < kWidth; ++lane) {
      ValuePrediction<double, Model::kDim> one;
      EXPECT_TRUE(model.predict(states[static_cast<std::size_t>(lane)], one));
      for (int i = 0; i < Model::kDim; ++i) {
        const double got = static_cast<double>(packet.value(i)[lane]);
        const double difference = soopnav::detail::residual<Model>(i, got, one.value(i));
        const double ulp =
            static_cast<double>(std::numeric_limits<T>::epsilon()) * std::max(1.0, std::abs(one.value(i)));
        // Not max(): a NaN must show.
        if (!(std::abs(difference) <= worst * ulp)) worst = std::abs(difference) / ulp;
      }
    }
  }
  return worst;
}

const Eigen::Vector3d kQ(700.0, -300.0, 60.0);
const Eigen::Vector3d kR(-200.0, 900.0, 20.0);
const Eigen::Vector2d kQ2(700.0, -300.0);

TEST(Packets, HaveTheBitsOfSingleStatesWhereOnlyRootsAreTaken) {
  EXPECT_EQ((worst_ulps<Space, double>(Range<EnuFrame>{kQ})), 0.0);
  EXPECT_EQ((worst_ulps<Space, double>(Range<EnuFrame, E3, Known<3>>{{}, kQ})), 0.0);
  EXPECT_EQ((worst_ulps<Plane, double>(Range<PlanarFrame, Known<2>>{kQ2})), 0.0);
  EXPECT_EQ((worst_ulps<Space, double>(Pseudorange<EnuFrame, test::EmitterClock>{kQ})), 0.0);
  EXPECT_EQ((worst_ulps<Space, double>(RangeDifference<EnuFrame>{kQ, kR})), 0.0);
  EXPECT_EQ((worst_ulps<Space, double>(Tdoa<EnuFrame, Known<3>, Known<3>, Bias>{kQ, kR})), 0.0);
  EXPECT_EQ(
      (worst_ulps<Space, double>(Tdoa<EnuFrame, E3, Known<3>, Known<1>, Known<1>, Known<3>>{{}, kQ, 10.0, {}, kR})),
      0.0);
  EXPECT_EQ((worst_ulps<Space, double>(RangeRate<EnuFrame>{kQ})), 0.0);
  EXPECT_EQ((worst_ulps<Space, double>(Doppler<EnuFrame, E3, V3>{4e8})), 0.0);
  EXPECT_EQ((worst_ulps<Space, double>(Fdoa<EnuFrame>{4e8, kQ, kR / 100.0, kR})), 0.0);
  EXPECT_EQ((worst_ulps<Space, double>(CarrierPhase<EnuFrame, test::Ambiguity>{0.19, kQ})), 0.0);
  EXPECT_EQ((worst_ulps<Plane, double>(PositionFix<PlanarFrame, 2>{})), 0.0);
}

TEST(Packets, AreWithinFourUlpsWhereAnglesAndLogarithmsAreTaken) {
  EXPECT_LE((worst_ulps<Plane, double>(Azimuth<PlanarFrame, Role<1, HeadingTag>>{kQ2})), 4.0);
  EXPECT_LE((worst_ulps<Plane, double>(AzimuthToEmitter<PlanarFrame, 2>{.heading = 0.3, .receiver_p = kQ2})), 4.0);
  EXPECT_LE((worst_ulps<Space, double>(AzimuthElevation<EnuFrame>{kQ})), 4.0);
  EXPECT_LE((worst_ulps<Space, double>(BodyDirection<EnuFrame, E3>{})), 4.0);
  EXPECT_LE((worst_ulps<Plane, double>(ReceivedPower<PlanarFrame, E2, test::Power, test::Exponent>{})), 4.0);
  // Two products of a kilometre each that may cancel.
  EXPECT_LE((worst_ulps<Plane, double>(PlanarIncrement<PlanarFrame, Known<2>, Role<1, test::PreviousTag>>{kQ2})), 4e3);
  EXPECT_LE(
      (worst_ulps<Plane, double>(Stacked(Range<PlanarFrame, E2>{}, Azimuth<PlanarFrame, Role<1, HeadingTag>>{kQ2}))),
      4.0);
}

TEST(Packets, OfFloatsFollow) {
  // A range is known to the rounding of the coordinates it comes from: kilometres in single precision.
  EXPECT_LE((worst_ulps<Space, float>(Range<EnuFrame>{kQ})), 16.0);
  EXPECT_LE((worst_ulps<Space, float>(Tdoa<EnuFrame, Known<3>, Known<3>, Bias>{kQ, kR})), 4e3);
  EXPECT_LE((worst_ulps<Space, float>(ReceivedPower<EnuFrame>{kQ, -30.0, 2.0})), 64.0);
}

}  // namespace
}  // namespace soopnav
