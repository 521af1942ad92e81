#include "soopnav/measurement/range.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <concepts>

#include "soopnav/estimation/prediction.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/measurement/pseudorange.hpp"

namespace soopnav {
namespace {

using Enu = PositionClock<EnuFrame>;
using Plane = PlanarPositionClock<EnuFrame>;

// A model belongs to its frame.
static_assert(MeasurementModelFor<Range<EnuFrame>, Enu>);
static_assert(!MeasurementModelFor<Range<EcefFrame>, Enu>);
static_assert(!MeasurementModelFor<Pseudorange<NedFrame>, Enu>);
static_assert(MeasurementModelFor<Pseudorange<>, PositionClock<EcefFrame>>);
// The style of the examples: ECEF unless said otherwise, the source clock deduced.
static_assert(std::same_as<decltype(Pseudorange{Eigen::Vector3d()}), Pseudorange<EcefFrame, Known<1>>>);
static_assert(std::same_as<decltype(Pseudorange{Eigen::Vector3d(), Block<1>{}}), Pseudorange<EcefFrame, Block<1>>>);

Enu enu(double e, double n, double u, double b) {
  Enu x;
  x.x << e, n, u, b;
  return x;
}

TEST(Range, IsTheDistance) {
  ValuePrediction<double, 1> y{};
  EXPECT_TRUE(Range<EnuFrame>{Eigen::Vector3d(1, 2, 3)}.predict(enu(3, 5, 9, 1e6), y));
  EXPECT_EQ(y.value(0), 7.0);
}

TEST(Pseudorange, SignsOfTheClocks) {
  // A receiver clock ahead makes it longer, a source clock ahead makes it shorter.
  ValuePrediction<double, 1> y{};
  EXPECT_TRUE((Pseudorange<EnuFrame>{Eigen::Vector3d(1, 2, 3)}.predict(enu(3, 5, 9, 100.0), y)));
  EXPECT_EQ(y.value(0), 107.0);
  EXPECT_TRUE((Pseudorange<EnuFrame>{Eigen::Vector3d(1, 2, 3), 30.0}.predict(enu(3, 5, 9, 100.0), y)));
  EXPECT_EQ(y.value(0), 77.0);
}

TEST(Pseudorange, JacobianPointsFromTheSource) {
  Prediction<1, Enu> y;
  EXPECT_TRUE((Pseudorange<EnuFrame>{Eigen::Vector3d(1, 2, 3)}.predict(enu(3, 5, 9, 100.0), y)));
  EXPECT_NEAR((y.estimated() - Eigen::RowVector4d(2.0 / 7, 3.0 / 7, 6.0 / 7, 1.0)).norm(), 0.0, 1e-15);
}

TEST(Pseudorange, PlanarStateSuppliesItsHeight) {
  const auto x = Plane::make({3, 5, 9}, 100.0);
  Prediction<1, Plane> y;
  EXPECT_TRUE((Pseudorange<EnuFrame>{Eigen::Vector3d(1, 2, 3)}.predict(x, y)));
  EXPECT_EQ(y.value(0), 107.0);
  EXPECT_NEAR((y.estimated() - Eigen::RowVector3d(1.0, 2.0 / 7, 3.0 / 7)).norm(), 0.0, 1e-15);
}

TEST(Pseudorange, CoincidentPointsHaveAValueButNoDirection) {
  const Pseudorange<EnuFrame> model{Eigen::Vector3d(1, 2, 3)};
  ValuePrediction<double, 1> value{};
  EXPECT_TRUE(model.predict(enu(1, 2, 3, 5), value));
  EXPECT_EQ(value.value(0), 5.0);
  Prediction<1, Enu> y;
  EXPECT_FALSE(model.predict(enu(1, 2, 3, 5), y));
  EXPECT_TRUE(y.H.isZero());
  EXPECT_FALSE(model.predict(enu(1, 2, 3 + 0.5 * kMinRangeM, 5), y));
  EXPECT_TRUE(model.predict(enu(1, 2, 3 + 2.0 * kMinRangeM, 5), y));
}

TEST(Pseudorange, NanIsNeitherHiddenNorDefined) {
  Prediction<1, Enu> y;
  EXPECT_FALSE((Pseudorange<EnuFrame>{Eigen::Vector3d(1, 2, 3)}.predict(enu(std::nan(""), 2, 3, 5), y)));
  EXPECT_TRUE(std::isnan(y.value(0)));
}

TEST(Pseudorange, TranslationAndRotationLeaveItAlone) {
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(0.8, Eigen::Vector3d(1, -1, 2).normalized()).toRotationMatrix();
  const Eigen::Vector3d shift(1e3, -2e3, 5e2);
  const Eigen::Vector3d p(30, 40, 50);
  const Eigen::Vector3d q(-700, 100, 20);
  const auto at = [](const Eigen::Vector3d& receiver, const Eigen::Vector3d& source) {
    ValuePrediction<double, 1> y{};
    EXPECT_TRUE(Pseudorange<EnuFrame>{source}.predict(enu(receiver[0], receiver[1], receiver[2], 7.0), y));
    return y.value(0);
  };
  EXPECT_NEAR(at(turn * p + shift, turn * q + shift), at(p, q), 1e-9);
  EXPECT_EQ(at(p, q), at(q, p));
}

}  // namespace
}  // namespace soopnav
