#include "soopnav/estimation/state.hpp"

#include <gtest/gtest.h>

#include "soopnav/estimation/prediction.hpp"
#include "soopnav/estimation/unobservable.hpp"

namespace soopnav {
namespace {

using Full =
    ComposedState<NedFrame, Role<3, PositionTag>, Role<3, VelocityTag>, Role<1, ClockBiasTag>, Role<1, ClockDriftTag>>;
using Plane = PlanarPositionClock<EnuFrame>;

static_assert(FixedStateType<Full> && FixedStateType<Plane> && FixedStateType<PositionClock<EcefFrame>>);
static_assert(Full::kDim == 8 && Full::at(kPosition) == 0 && Full::at(kVelocity) == 3 && Full::at(kClockBias) == 6 &&
              Full::at(kClockDrift) == 7);
static_assert(!HoldsRole<PositionClock<EnuFrame>, Role<3, VelocityTag>>);
static_assert(!HoldsRole<Full, Role<1, HeadingTag>>);

TEST(ComposedState, RolesReadTheirSegments) {
  Full state;
  state.x << 1, 2, 3, 4, 5, 6, 7, 8;
  EXPECT_EQ(state(kPosition), Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(state(kVelocity), Eigen::Vector3d(4, 5, 6));
  EXPECT_EQ(state(kClockBias)[0], 7);
  EXPECT_EQ(state(kClockDrift)[0], 8);
  EXPECT_EQ((state(Known<2>{9.0, 10.0})[1]), 10.0);
}

template <class State>
class StateLaws : public testing::Test {};
using States = testing::Types<Full, Plane, PositionClock<EcefFrame>>;
TYPED_TEST_SUITE(StateLaws, States);

TYPED_TEST(StateLaws, LocalInvertsRetract) {
  TypeParam state;
  state.x.setLinSpaced(-3.0, 17.0);
  typename TypeParam::Tangent d;
  d.setLinSpaced(0.25, 2.0);
  EXPECT_NEAR((state.local(state.retract(d)) - d).norm(), 0.0, 1e-14);
  EXPECT_EQ(state.local(state).norm(), 0.0);
}

TEST(PlanarPositionClock, KeepsItsHeight) {
  const auto state = Plane::make({1.0, 2.0, 30.0}, 5.0).retract(Eigen::Vector3d(0.5, 10.0, 20.0));
  EXPECT_EQ(state(kPosition), Eigen::Vector3d(11.0, 22.0, 30.0));
  EXPECT_EQ(state(kPlanarPosition), Eigen::Vector2d(11.0, 22.0));
  EXPECT_EQ(state(kClockBias)[0], 5.5);
}

TEST(Prediction, DropsWhatIsNotEstimated) {
  Prediction<1, Plane> y;
  y.jacobian(kPosition) << 1.0, 2.0, 3.0;
  y.jacobian(kClockBias)(0) = 4.0;
  y.jacobian(Known<1>{})(0) = 5.0;
  EXPECT_EQ(y.estimated(), Eigen::RowVector3d(4.0, 1.0, 2.0));
}

TEST(ComponentNames, FollowTheFrame) {
  EXPECT_EQ(Full::component_name(2), "down");
  EXPECT_EQ(Full::component_name(4), "east velocity");
  EXPECT_EQ(Full::component_name(7), "clock drift");
  EXPECT_EQ(Plane::component_name(0), "clock bias");
  EXPECT_EQ(Plane::component_name(2), "north");
  EXPECT_EQ(PositionClock<EcefFrame>::component_name(1), "y");
}

TEST(NameDirections, NamesComponentsAndCombinations) {
  using Names = std::vector<std::string>;
  using Placed = PositionClock<EnuFrame>;
  Eigen::MatrixXd basis(4, 1);
  basis << 0.0, 0.0, -1.0, 0.0;
  EXPECT_EQ(name_directions<Placed>(basis), Names{"up"});
  basis << 0.6, 0.0, 0.0, -0.8;
  EXPECT_EQ(name_directions<Placed>(basis), Names{"0.80 clock bias - 0.60 east"});
  // Two columns that hide two components, and a third that is a mixture.
  Eigen::MatrixXd turned(4, 2);
  turned.col(0) << 0.6, 0.0, 0.8, 0.0;
  turned.col(1) << -0.8, 0.0, 0.6, 0.0;
  EXPECT_EQ(name_directions<Placed>(turned), (Names{"east", "up"}));
  Eigen::MatrixXd mixed(4, 2);
  mixed.col(0) << 0.0, 1.0, 0.0, 0.0;
  mixed.col(1) << std::sqrt(0.5), 0.0, 0.0, std::sqrt(0.5);
  EXPECT_EQ(name_directions<Placed>(mixed), (Names{"north", "0.71 east + 0.71 clock bias"}));
  EXPECT_TRUE(name_directions<Placed>(Eigen::MatrixXd(4, 0)).empty());
  EXPECT_THROW(static_cast<void>(name_directions<Placed>(Eigen::MatrixXd::Identity(3, 1))), std::invalid_argument);
}

}  // namespace
}  // namespace soopnav
