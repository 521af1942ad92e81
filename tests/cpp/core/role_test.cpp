#include "soopnav/core/role.hpp"

#include <gtest/gtest.h>

#include <type_traits>

namespace soopnav {
namespace {

static_assert(kPosition.kDim == 3 && kPlanarPosition.kDim == 2 && kClockBias.kDim == 1);
static_assert(std::is_same_v<decltype(kPosition), const Role<3, PositionTag>>);
static_assert(!std::is_same_v<decltype(kPosition), decltype(kVelocity)>);
static_assert(!std::is_same_v<decltype(kPosition), decltype(kPlanarPosition)>);
static_assert(std::is_same_v<decltype(kPositionOf<2>), decltype(kPlanarPosition)>);
static_assert(std::is_empty_v<Role<3, PositionTag>>);

static_assert(RoleType<Role<1, HeadingTag>> && !RoleType<Known<1>> && !RoleType<Block<1>> && !RoleType<double>);
static_assert(StatePart<Known<2>> && StatePart<Block<2>> && StatePart<const Role<2, PositionTag>&>);
static_assert(!StatePart<double>);
static_assert(PartOf<Known<1>, 1> && PartOf<Block<1>, 1> && PartOf<Role<1, ClockBiasTag>, 1> && !PartOf<Known<2>, 1>);

struct FreeModel {};
struct EcefModel {
  using Frame = EcefFrame;
};
struct EcefState {
  using Frame = EcefFrame;
};
struct EnuState {
  using Frame = EnuFrame;
};
struct FramelessState {};
static_assert(FrameCompatible<FreeModel, EnuState> && FrameCompatible<FreeModel, FramelessState>);
static_assert(FrameCompatible<EcefModel, EcefState>);
static_assert(!FrameCompatible<EcefModel, EnuState> && !FrameCompatible<EcefModel, FramelessState>);

TEST(Role, KnownHoldsItsNumbers) {
  constexpr Known<1> zero{};
  constexpr Known<1> bias{3.5};
  constexpr Known<3> place{1.0, 2.0, 3.0};
  EXPECT_EQ(zero[0], 0.0);
  EXPECT_EQ(bias[0], 3.5);
  EXPECT_EQ(place[2], 3.0);
  EXPECT_EQ(bias, Known<1>{3.5});
  EXPECT_NE(bias, zero);
}

TEST(Role, BlockOfANewGenerationIsAnother) {
  const Block<2> first{4, 1};
  const Block<2> second{4, 2};
  EXPECT_NE(first, second);
  EXPECT_EQ(first, (Block<2>{4, 1}));
  EXPECT_EQ(Block<2>{}.slot, -1);  // names nothing
}

TEST(Role, DiscardedJacobianTakesWhatABlockTakes) {
  DiscardedJacobian sink;
  sink << 1.0, 2.0, 3.0;
  sink(0) = -1.0;
  sink(0, 1) += 2.0;
  sink.row(0) << 1.0, 2.0;
  sink.setZero();
  sink = 4.0;
  static_assert(std::is_empty_v<DiscardedJacobian>);
}

}  // namespace
}  // namespace soopnav
