#include "soopnav/measurement/range.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/estimation/least_squares.hpp"
#include "soopnav/estimation/prediction.hpp"
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

// A cloud of particles as structure of arrays, asked one particle or one packet at a time.
struct Cloud {
  std::array<std::vector<double>, 4> column;
};
struct OneParticle {
  using Frame = EnuFrame;
  const Cloud& cloud;
  std::size_t i;
  std::array<double, 3> operator()(Role<3, PositionTag>) const {
    return {cloud.column[0][i], cloud.column[1][i], cloud.column[2][i]};
  }
  std::array<double, 1> operator()(Role<1, ClockBiasTag>) const { return {cloud.column[3][i]}; }
  Known<1> operator()(const Known<1>& known) const { return known; }
};
using Packet = Eigen::Array<double, 4, 1>;
struct ParticlePacket {
  using Frame = EnuFrame;
  const Cloud& cloud;
  std::size_t i;
  Packet load(std::size_t c) const { return Eigen::Map<const Packet>(cloud.column[c].data() + i); }
  std::array<Packet, 3> operator()(Role<3, PositionTag>) const { return {load(0), load(1), load(2)}; }
  std::array<Packet, 1> operator()(Role<1, ClockBiasTag>) const { return {load(3)}; }
  std::array<Packet, 1> operator()(const Known<1>& known) const { return {Packet::Constant(known[0])}; }
};

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
  EXPECT_TRUE((Pseudorange<EnuFrame>{Eigen::Vector3d(1, 2, 3), Known<1>{{30.0}}}.predict(enu(3, 5, 9, 100.0), y)));
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

TEST(Pseudorange, PacketsParticlesAndStatesAgreeToTheBit) {
  RandomStream random(5);
  Cloud cloud;
  for (auto& column : cloud.column) {
    column.resize(64);
    for (double& v : column) v = 100.0 * random.normal();
  }
  const Pseudorange<EnuFrame> model{Eigen::Vector3d(400, -300, 20), Known<1>{{12.0}}};
  for (std::size_t i = 0; i < 64; i += 4) {
    ValuePrediction<Packet, 1> packet{};
    ASSERT_TRUE(model.predict(ParticlePacket{cloud, i}, packet));
    for (std::size_t k = 0; k < 4; ++k) {
      ValuePrediction<double, 1> one{};
      ASSERT_TRUE(model.predict(OneParticle{cloud, i + k}, one));
      Prediction<1, Enu> full;
      ASSERT_TRUE(model.predict(
          enu(cloud.column[0][i + k], cloud.column[1][i + k], cloud.column[2][i + k], cloud.column[3][i + k]), full));
      EXPECT_EQ(packet.value(0)[static_cast<Eigen::Index>(k)], one.value(0));
      EXPECT_EQ(full.value(0), one.value(0));
    }
  }
}

// A state with one more block: the clock of the source, estimated.
struct WithSourceClock {
  using Frame = EnuFrame;
  Eigen::Matrix<double, 5, 1> x;
  Eigen::Vector3d operator()(Role<3, PositionTag>) const { return x.head<3>(); }
  std::array<double, 1> operator()(Role<1, ClockBiasTag>) const { return {x[3]}; }
  std::array<double, 1> operator()(Block<1> handle) const { return {x[4 + handle.slot]}; }
};
struct WithSourceClockPrediction {
  static constexpr bool kJacobian = true;
  double z = 0.0;
  Eigen::Matrix<double, 1, 5> H = Eigen::Matrix<double, 1, 5>::Zero();
  double& value(int) { return z; }
  auto jacobian(Role<3, PositionTag>) { return H.middleCols<3>(0); }
  auto jacobian(Role<1, ClockBiasTag>) { return H.middleCols<1>(3); }
  auto jacobian(Block<1> handle) { return H.middleCols<1>(4 + handle.slot); }
};

TEST(Pseudorange, SourceClockCanBeEstimated) {
  const Pseudorange<EnuFrame, Block<1>> model{Eigen::Vector3d(1, 2, 3), Block<1>{0, 0}};
  WithSourceClock x;
  x.x << 3, 5, 9, 100, 30;
  WithSourceClockPrediction y;
  EXPECT_TRUE(model.predict(x, y));
  EXPECT_EQ(y.z, 77.0);
  EXPECT_EQ(y.H(3), 1.0);
  EXPECT_EQ(y.H(4), -1.0);
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
