// Values, sign conventions, refusals and frames of the measurement models.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <concepts>
#include <limits>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/core/stacked.hpp"
#include "soopnav/estimation/prediction.hpp"
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

using Enu = PositionVelocityClock<EnuFrame, 3>;
using Ned = PositionVelocityClock<NedFrame, 3>;
using Ecef = PositionVelocityClock<EcefFrame, 3>;
using Plane = PlanarInertialState;
using Bias = Role<1, ClockBiasTag>;
using Drift = Role<1, ClockDriftTag>;
using Pos3 = Role<3, PositionTag>;
using Bearing = Azimuth<PlanarFrame, Role<1, HeadingTag>>;

// What is stated in one frame does not compile in another, nor where the state lacks a role.
static_assert(MeasurementModelFor<Range<EnuFrame>, Enu> && !MeasurementModelFor<Range<>, Enu>);
static_assert(MeasurementModelFor<Range<EnuFrame, Pos3, Known<3>>, Enu>);
static_assert(!MeasurementModelFor<RangeDifference<NedFrame>, Enu> && MeasurementModelFor<RangeDifference<>, Ecef>);
static_assert(!MeasurementModelFor<Tdoa<>, Ned> && MeasurementModelFor<Tdoa<NedFrame>, Ned>);
static_assert(!MeasurementModelFor<RangeRate<EnuFrame>, Ned> && MeasurementModelFor<RangeRate<EnuFrame>, Enu>);
static_assert(!MeasurementModelFor<RangeRate<EnuFrame>, PositionClock<EnuFrame>>);
static_assert(!MeasurementModelFor<Doppler<>, Enu> && MeasurementModelFor<Doppler<>, Ecef>);
static_assert(!MeasurementModelFor<Fdoa<>, Enu> && MeasurementModelFor<Fdoa<>, Ecef>);
static_assert(!MeasurementModelFor<Bearing, Enu> && MeasurementModelFor<Bearing, Plane>);
static_assert(!MeasurementModelFor<Elevation<NedFrame>, Enu> && MeasurementModelFor<Elevation<EnuFrame>, Enu>);
static_assert(!MeasurementModelFor<AzimuthElevation<NedFrame>, Enu>);
static_assert(!MeasurementModelFor<BodyDirection<EnuFrame>, Enu>);  // no attitude
static_assert(!MeasurementModelFor<ReceivedPower<>, Enu> && MeasurementModelFor<ReceivedPower<>, Ecef>);
static_assert(!MeasurementModelFor<CarrierPhase<>, Enu> && MeasurementModelFor<CarrierPhase<>, Ecef>);
static_assert(!MeasurementModelFor<PlanarIncrement<NedFrame>, Plane>);
static_assert(MeasurementModelFor<PlanarIncrement<PlanarFrame>, Plane>);
static_assert(!MeasurementModelFor<PositionFix<>, Enu> && MeasurementModelFor<PositionFix<EnuFrame>, Enu>);
static_assert(MeasurementModelFor<Stacked<Range<EnuFrame>, Elevation<EnuFrame>>, Enu>);
static_assert(!MeasurementModelFor<Stacked<Range<EnuFrame>, Range<>>, Enu>);
static_assert(!MeasurementModelFor<Range<EnuFrame, Block<3>>, Enu>);  // no layout
// What is deduced from the source alone.
static_assert(std::same_as<decltype(Range{Eigen::Vector3d()}), Range<EcefFrame>>);
static_assert(std::same_as<decltype(Range{Eigen::Vector2d()}), Range<PlanarFrame, Known<2>>>);

template <class State>
State at(const Eigen::Vector3d& p, const Eigen::Vector3d& v = {0, 0, 0}, double bias = 0.0, double drift = 0.0) {
  State x;
  x.x << p, v, bias, drift;
  return x;
}
Plane pose(double east, double north, double heading) {
  Plane x;
  x.x << heading, 0.0, 0.0, east, north;
  return x;
}
template <class Model, class State>
Eigen::Matrix<double, Model::kDim, 1> values(const Model& model, const State& x) {
  ValuePrediction<double, Model::kDim> y{};
  EXPECT_TRUE(model.predict(x, y));
  Eigen::Matrix<double, Model::kDim, 1> z;
  for (int i = 0; i < Model::kDim; ++i) z[i] = y.value(i);
  return z;
}
template <class Model, class State>
double value(const Model& model, const State& x) {
  return values(model, x)[0];
}
template <class Model, class State>
bool has_jacobian(const Model& model, const State& x) {
  Prediction<Model::kDim, State> y;
  return model.predict(x, y);
}

TEST(Range, BetweenKnownAndUnknownEitherWayRound) {
  const auto x = at<Enu>({3, 5, 9});
  EXPECT_EQ(value(Range<EnuFrame>{{1, 2, 3}}, x), 7.0);
  EXPECT_EQ((value(Range<EnuFrame, Pos3, Known<3>>{{}, {1, 2, 3}}, x)), 7.0);
  EXPECT_EQ((value(Range<PlanarFrame, Known<2>>{{0, 0}}, pose(3, 4, 0))), 5.0);
}

TEST(Pseudorange, LocatesASourceWithAKnownReceiver) {
  const Pseudorange<EnuFrame, Bias, Pos3, Known<1>, Known<3>> model{{}, {}, 30.0, {1, 2, 3}};
  EXPECT_EQ(value(model, at<Enu>({3, 5, 9}, {0, 0, 0}, 100.0)), 7.0 + 30.0 - 100.0);
}

TEST(RangeDifference, IsReceiverMinusReference) {
  const Eigen::Vector3d source(0, 0, 0);
  const Eigen::Vector3d far(0, 300, 400);
  const Eigen::Vector3d near(10, 0, 0);
  EXPECT_EQ(value(RangeDifference<EnuFrame>{source, near}, at<Enu>(far)), 490.0);
  EXPECT_EQ(value(RangeDifference<EnuFrame>{source, far}, at<Enu>(near)), -490.0);
  EXPECT_EQ((value(RangeDifference<EnuFrame, Pos3, Known<3>, Known<3>>{{}, near, far}, at<Enu>(source))), 490.0);
  // Crosby (3.9): initial minus present distance to the transmitter, the receiver having started in the origin.
  const Eigen::Vector2d transmitter(30, 40);
  const double crosby = std::hypot(30.0, 40.0) - std::hypot(30.0 - 6.0, 40.0 - 8.0);
  EXPECT_NEAR(-value(RangeDifference<PlanarFrame, Known<2>>{transmitter, Eigen::Vector2d(0, 0)}, pose(6, 8, 0)), crosby,
              1e-12);
}

TEST(Tdoa, SwappedReceiversChangeItsSign) {
  RandomStream random(2);
  for (int k = 0; k < 20; ++k) {
    const auto draw = [&]() -> Eigen::Vector3d {
      return Eigen::Vector3d(random.normal(), random.normal(), random.normal()) * 1e3;
    };
    const Eigen::Vector3d q = draw();
    const Eigen::Vector3d a = draw();
    const Eigen::Vector3d b = draw();
    using Model = Tdoa<EnuFrame, Known<3>, Known<3>, Known<1>, Known<1>>;
    const double one = value(Model{q, b, 20.0, 50.0}, at<Enu>(a));
    EXPECT_EQ(one, -value(Model{q, a, 50.0, 20.0}, at<Enu>(b)));
    EXPECT_NEAR(one, ((a - q).norm() + 20.0) - ((b - q).norm() + 50.0), 1e-9);
  }
}

TEST(Tdoa, AReceiverClockAheadLengthensIt) {
  const Tdoa<EnuFrame, Known<3>, Known<3>, Bias> model{{0, 0, 0}, {10, 0, 0}};
  EXPECT_EQ(value(model, at<Enu>({0, 300, 400}, {0, 0, 0}, 5.0)), 495.0);
  // Two receivers of one clock.
  const Tdoa<EnuFrame, Known<3>, Known<3>, Bias, Bias> same{{0, 0, 0}, {10, 0, 0}};
  const auto x = at<Enu>({0, 300, 400}, {0, 0, 0}, 5.0);
  EXPECT_EQ(value(same, x), 490.0);
  Prediction<1, Enu> y;
  EXPECT_TRUE(same.predict(x, y));
  EXPECT_EQ(y.H(Enu::at(kClockBias)), 0.0);
}

TEST(RangeRate, IsPositiveWhenReceding) {
  const RangeRate<EnuFrame> model{{0, 0, 0}};
  EXPECT_EQ(value(model, at<Enu>({0, 300, 400}, {0, 3, 4})), 5.0);
  EXPECT_EQ(value(model, at<Enu>({0, 300, 400}, {0, -3, -4})), -5.0);
  EXPECT_EQ(value(model, at<Enu>({0, 300, 400}, {7, 0, 0})), 0.0);
  // A source that follows, a receiver clock that runs fast, a source clock that does.
  EXPECT_EQ(value(RangeRate<EnuFrame>{{0, 0, 0}, {0, 3, 4}}, at<Enu>({0, 300, 400}, {0, 3, 4})), 0.0);
  EXPECT_EQ(value(model, at<Enu>({0, 300, 400}, {0, 0, 0}, 0.0, 2.0)), 2.0);
  EXPECT_EQ((value(RangeRate<EnuFrame>{{0, 0, 0}, {}, 2.0}, at<Enu>({0, 300, 400}))), -2.0);
}

TEST(RangeRate, IsTheDerivativeOfThePseudorange) {
  RandomStream random(4);
  const Eigen::Vector3d q(500, -800, 100);
  const Eigen::Vector3d vq(-30, 10, 5);
  for (int k = 0; k < 20; ++k) {
    const Eigen::Vector3d p = 1e3 * Eigen::Vector3d(random.normal(), random.normal(), random.normal());
    const Eigen::Vector3d v(random.normal(), 30.0 * random.normal(), random.normal());
    const double dt = 1e-3;
    const auto later = [&](double t) {
      return value(Pseudorange<EnuFrame>{Eigen::Vector3d(q + t * vq), 4.0 * t}, at<Enu>(p + t * v, v, 7.0 * t));
    };
    const double rate = value(RangeRate<EnuFrame>{q, vq, 4.0}, at<Enu>(p, v, 0.0, 7.0));
    EXPECT_NEAR((later(dt) - later(-dt)) / (2.0 * dt), rate, 1e-6);
    // The same through the phase, in cycles, and the Doppler shift.
    const double lambda = kSpeedOfLightMps / 4e8;
    EXPECT_NEAR(value(Doppler<EnuFrame>{4e8, q, vq, 4.0}, at<Enu>(p, v, 0.0, 7.0)), -rate / lambda, 1e-9);
  }
}

TEST(Doppler, IsNegativeWhenReceding) {
  const double carrier = kSpeedOfLightMps;  // a wavelength of one metre
  EXPECT_EQ(value(Doppler<EnuFrame>{carrier, {0, 0, 0}}, at<Enu>({0, 300, 400}, {0, 3, 4})), -5.0);
  EXPECT_EQ(value(Doppler<EnuFrame>{2.0 * carrier, {0, 0, 0}}, at<Enu>({0, 300, 400}, {0, 3, 4}, 0.0, 1.0)), -12.0);
}

TEST(Fdoa, IsTheDopplerOfTheReceiverLessThatOfTheReference) {
  RandomStream random(8);
  for (int k = 0; k < 20; ++k) {
    const auto draw = [&](double size) {
      return Eigen::Vector3d(size * random.normal(), size * random.normal(), size * random.normal());
    };
    const Eigen::Vector3d q = draw(1e3), vq = draw(50), a = draw(1e3), va = draw(20), b = draw(1e3), vb = draw(20);
    using Model = Fdoa<EnuFrame, Known<3>, Known<3>, Known<3>, Known<3>, Drift, Known<1>>;
    const double fdoa = value(Model{1e9, q, vq, b, vb, {}, 2.0}, at<Enu>(a, va, 0.0, 3.0));
    const double here = value(Doppler<EnuFrame>{1e9, q, vq, 0.7}, at<Enu>(a, va, 0.0, 3.0));
    const double there = value(Doppler<EnuFrame>{1e9, q, vq, 0.7}, at<Enu>(b, vb, 0.0, 2.0));
    EXPECT_NEAR(fdoa, here - there, 1e-9);
    EXPECT_EQ(fdoa, -value(Model{1e9, q, vq, a, va, {}, 3.0}, at<Enu>(b, vb, 0.0, 2.0)));
  }
}

TEST(CarrierPhase, GrowsWithRangeClockAndAmbiguity) {
  const auto x = at<Enu>({0, 300, 400}, {0, 0, 0}, 10.0);
  EXPECT_EQ(value(CarrierPhase<EnuFrame>{0.5, {0, 0, 0}}, x), 1020.0);
  EXPECT_EQ(value(CarrierPhase<EnuFrame>{0.5, {0, 0, 0}, 7.0, 4.0}, x), 1019.0);
  EXPECT_LT(value(CarrierPhase<EnuFrame>{0.5, {0, 100, 100}}, x), 1020.0);
}

TEST(Azimuth, CountsFromNorthToEastInLocalFrames) {
  using Model = Azimuth<EnuFrame, Known<1>, Known<3>>;
  EXPECT_NEAR(value(Model{{0, 100, 0}}, at<Enu>({0, 0, 0})), 0.0, 1e-15);
  EXPECT_NEAR(value(Model{{100, 0, 50}}, at<Enu>({0, 0, 0})), kPi / 2.0, 1e-15);
  EXPECT_NEAR((value(Azimuth<NedFrame, Known<1>, Known<3>>{{0, 100, 0}}, at<Ned>({0, 0, 0}))), kPi / 2.0, 1e-15);
  // In a plane from the first axis to the second, and from the heading.
  EXPECT_NEAR(value(Azimuth<PlanarFrame>{{0, 100}}, pose(0, 0, 0)), kPi / 2.0, 1e-15);
  EXPECT_NEAR(value(Bearing{{0, 100}}, pose(0, 0, 0.2)), kPi / 2.0 - 0.2, 1e-15);
  // Seen from the emitter it is the opposite direction.
  EXPECT_NEAR((value(AzimuthToEmitter<PlanarFrame, 2>{.receiver_p = {0, 100}}, pose(0, 0, 0))), -kPi / 2.0, 1e-15);
}

TEST(Azimuth, WrapsValueAndResidual) {
  const double z = value(Bearing{{-100, -1}}, pose(0, 0, 3.0));
  EXPECT_GE(z, -kPi);
  EXPECT_LT(z, kPi);
  EXPECT_NEAR(Bearing::residual(0, 3.1, -3.1), 6.2 - kTwoPi, 1e-12);
  EXPECT_NEAR(AzimuthElevation<EnuFrame>::residual(0, -3.1, 3.1), kTwoPi - 6.2, 1e-12);
  EXPECT_EQ(AzimuthElevation<EnuFrame>::residual(1, -1.5, 1.5), -3.0);
  EXPECT_NEAR(BodyDirection<EnuFrame>::residual(0, -3.1, 3.1), kTwoPi - 6.2, 1e-12);
  EXPECT_EQ(BodyDirection<EnuFrame>::residual(1, -1.5, 1.5), -3.0);
  EXPECT_NEAR(PlanarIncrement<PlanarFrame>::residual(2, -3.1, 3.1), kTwoPi - 6.2, 1e-12);
  EXPECT_EQ(PlanarIncrement<PlanarFrame>::residual(0, -3.1, 3.1), -6.2);
}

TEST(Elevation, IsPositiveAbove) {
  EXPECT_NEAR(value(Elevation<EnuFrame>{{3, 4, 5}}, at<Enu>({0, 0, 0})), kPi / 4.0, 1e-15);
  EXPECT_NEAR(value(Elevation<NedFrame>{{3, 4, -5}}, at<Ned>({0, 0, 0})), kPi / 4.0, 1e-15);
  EXPECT_NEAR(value(Elevation<EnuFrame>{{0, 0, 5}}, at<Enu>({0, 0, 0})), kPi / 2.0, 1e-15);
  const auto both = values(AzimuthElevation<EnuFrame>{{3, 4, 5}, 0.1}, at<Enu>({0, 0, 0}));
  EXPECT_NEAR(both[0], std::atan2(3.0, 4.0) - 0.1, 1e-15);
  EXPECT_NEAR(both[1], kPi / 4.0, 1e-15);
}

TEST(BodyDirection, TurnsWithTheBody) {
  using Tilted = ComposedState<EnuFrame, Role<3, PositionTag>, Role<3, AttitudeTag>>;
  Tilted x;
  x.x.head<3>() << 0, 0, 0;
  const Eigen::Vector3d q(0, 100, 0);
  EXPECT_NEAR(values(BodyDirection<EnuFrame>{q}, x)[0], kPi / 2.0, 1e-15);
  // The body turned by 30 degrees towards its second axis: the source is 30 degrees less far round.
  const Eigen::Quaterniond yaw(Eigen::AngleAxisd(kPi / 6.0, Eigen::Vector3d::UnitZ()));
  x.x.tail<4>() << yaw.w(), yaw.x(), yaw.y(), yaw.z();
  EXPECT_NEAR(values(BodyDirection<EnuFrame>{q}, x)[0], kPi / 3.0, 1e-12);
  EXPECT_NEAR(values(BodyDirection<EnuFrame>{q}, x)[1], 0.0, 1e-12);
  // Rolled about its first axis, second axis up: the source sinks below its plane.
  const Eigen::Quaterniond roll(Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitX()));
  x.x.tail<4>() << roll.w(), roll.x(), roll.y(), roll.z();
  EXPECT_NEAR(values(BodyDirection<EnuFrame>{q}, x)[1], -0.4, 1e-12);
  // Against Eigen's rotation, any attitude.
  RandomStream random(9);
  for (int k = 0; k < 20; ++k) {
    for (int i = 0; i < 7; ++i) x.x[i] = random.normal();
    x.normalize();
    const Eigen::Quaterniond turn(x.x[3], x.x[4], x.x[5], x.x[6]);
    const Eigen::Vector3d d = turn.conjugate() * (q - x.x.head<3>());
    const auto z = values(BodyDirection<EnuFrame>{q}, x);
    EXPECT_NEAR(z[0], std::atan2(d[1], d[0]), 1e-12);
    EXPECT_NEAR(z[1], std::asin(d[2] / d.norm()), 1e-12);
  }
}

TEST(ReceivedPower, FallsByTheExponentPerDecade) {
  const ReceivedPower<EnuFrame> model{{0, 0, 0}, -30.0, 2.0, 10.0};
  EXPECT_NEAR(value(model, at<Enu>({10, 0, 0})), -30.0, 1e-12);
  EXPECT_NEAR(value(model, at<Enu>({0, 100, 0})), -50.0, 1e-12);
  EXPECT_NEAR((value(ReceivedPower<EnuFrame>{{0, 0, 0}, -30.0, 3.5, 10.0}, at<Enu>({0, 100, 0}))), -65.0, 1e-12);
}

TEST(PlanarIncrement, IsSeenFromThePreviousBody) {
  // Facing along the second axis, one metre on and two to the left, turned by 0.3.
  const PlanarIncrement<PlanarFrame> model{{5, 5}, kPi / 2.0};
  const auto z = values(model, pose(3, 6, kPi / 2.0 + 0.3));
  EXPECT_NEAR(z[0], 1.0, 1e-12);
  EXPECT_NEAR(z[1], 2.0, 1e-12);
  EXPECT_NEAR(z[2], 0.3, 1e-12);
  EXPECT_NEAR(values(PlanarIncrement<PlanarFrame>{{5, 5}, 3.1}, pose(5, 5, -3.1))[2], kTwoPi - 6.2, 1e-12);
}

TEST(PlanarIncrement, GoesTheOtherWayWhenPosesSwap) {
  const Eigen::Vector2d a(3, -1), b(4, 2);
  const double psi_a = 0.4, psi_b = 1.3;
  const auto there = values(PlanarIncrement<PlanarFrame>{a, psi_a}, pose(b[0], b[1], psi_b));
  const auto back = values(PlanarIncrement<PlanarFrame>{b, psi_b}, pose(a[0], a[1], psi_a));
  EXPECT_NEAR(back[2], -there[2], 1e-12);
  const Eigen::Vector2d returned = -(Eigen::Rotation2Dd(-there[2]) * there.head<2>());
  EXPECT_NEAR((back.head<2>() - returned).norm(), 0.0, 1e-12);
}

TEST(PositionFix, IsThePart) {
  EXPECT_EQ((values(PositionFix<EnuFrame>{}, at<Enu>({1, 2, 3}))), Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ((values(PositionFix<EnuFrame, 3, Role<3, VelocityTag>>{}, at<Enu>({1, 2, 3}, {4, 5, 6}))),
            Eigen::Vector3d(4, 5, 6));
}

TEST(Models, HaveNoJacobianOnTopOfTheirSource) {
  const Eigen::Vector3d here(1, 2, 3);
  const Eigen::Vector3d away(100, 2, 3);
  const auto x = at<Enu>(here, {1, 0, 0});
  // A distance of nothing is a distance; an azimuth to where one stands is none.
  const auto refuses = [&](const char* what, const auto& model, bool has_value = true) {
    EXPECT_FALSE(has_jacobian(model, x)) << what;
    ValuePrediction<double, std::remove_cvref_t<decltype(model)>::kDim> y{};
    EXPECT_EQ(model.predict(x, y), has_value) << what;
    // One beside it will do.
    EXPECT_TRUE(has_jacobian(model, at<Enu>(here + Eigen::Vector3d(0.1, 0.1, 0.1)))) << what;
  };
  refuses("range", Range<EnuFrame>{here});
  refuses("range difference", RangeDifference<EnuFrame>{here, away});
  EXPECT_FALSE(has_jacobian(RangeDifference<EnuFrame>{away, away}, x));
  refuses("TDOA", Tdoa<EnuFrame>{here, away});
  EXPECT_FALSE(has_jacobian(Tdoa<EnuFrame>{away, away}, x));
  refuses("range rate", RangeRate<EnuFrame>{here});
  refuses("Doppler", Doppler<EnuFrame>{1e9, here});
  refuses("FDOA", Fdoa<EnuFrame>{1e9, here, {}, away});
  EXPECT_FALSE(has_jacobian(Fdoa<EnuFrame>{1e9, away, {}, away}, x));
  refuses("azimuth", Azimuth<EnuFrame, Known<1>, Known<3>>{here + Eigen::Vector3d(0, 0, 50)}, false);
  refuses("elevation", Elevation<EnuFrame>{here + Eigen::Vector3d(0, 0, 50)});
  refuses("azimuth and elevation", AzimuthElevation<EnuFrame>{here + Eigen::Vector3d(0, 0, 50)}, false);
  refuses("power", ReceivedPower<EnuFrame>{here, -30.0, 2.0});
  refuses("phase", CarrierPhase<EnuFrame>{0.2, here});
  refuses("stacked", Stacked(PositionFix<EnuFrame>{}, Range<EnuFrame>{here}));
  using Tilted = ComposedState<EnuFrame, Role<3, PositionTag>, Role<3, AttitudeTag>>;
  EXPECT_FALSE(has_jacobian(BodyDirection<EnuFrame>{{0, 0, 50}}, Tilted{}));
  EXPECT_TRUE(has_jacobian(BodyDirection<EnuFrame>{{0, 1, 50}}, Tilted{}));
}

TEST(Models, ShowNan) {
  const auto x = at<Enu>({std::numeric_limits<double>::quiet_NaN(), 2, 3});
  const auto shows = [&](const char* what, const auto& model) {
    ValuePrediction<double, std::remove_cvref_t<decltype(model)>::kDim> y{};
    EXPECT_TRUE(model.predict(x, y)) << what;
    EXPECT_TRUE(std::isnan(y.value(0))) << what;
    EXPECT_FALSE(has_jacobian(model, x)) << what;
  };
  const Eigen::Vector3d q(100, 200, 300);
  shows("range", Range<EnuFrame>{q});
  shows("TDOA", Tdoa<EnuFrame>{q, {1, 1, 1}});
  shows("Doppler", Doppler<EnuFrame>{1e9, q});
  shows("azimuth", Azimuth<EnuFrame, Known<1>, Known<3>>{q});
  shows("elevation", Elevation<EnuFrame>{q});
  shows("power", ReceivedPower<EnuFrame>{q, -30.0, 2.0});
}

TEST(Stacked, HasTheRowsOfItsModelsInOrder) {
  const Range<PlanarFrame, Known<2>> range{{30, 40}};
  const Bearing bearing{{-100, 5}};
  const PlanarIncrement<PlanarFrame> increment{{1, 1}, 0.2};
  const Stacked all(range, bearing, increment);
  static_assert(decltype(all)::kDim == 5);
  const auto x = pose(3, 4, 0.5);
  Prediction<5, Plane> y;
  ASSERT_TRUE(all.predict(x, y));
  Prediction<1, Plane> a, b;
  Prediction<3, Plane> c;
  ASSERT_TRUE(range.predict(x, a) && bearing.predict(x, b) && increment.predict(x, c));
  EXPECT_EQ(y.z[0], a.z[0]);
  EXPECT_EQ(y.z[1], b.z[0]);
  EXPECT_EQ(y.z.tail<3>(), c.z);
  EXPECT_EQ(y.H.row(0), a.H);
  EXPECT_EQ(y.H.row(1), b.H);
  EXPECT_EQ(y.H.bottomRows<3>(), c.H);
  // Residuals: range plainly, bearing and turn the short way round.
  using All = std::remove_const_t<decltype(all)>;
  EXPECT_EQ(All::residual(0, 10.0, 1.0), 9.0);
  EXPECT_NEAR(All::residual(1, 3.1, -3.1), 6.2 - kTwoPi, 1e-12);
  EXPECT_EQ(All::residual(2, 10.0, 1.0), 9.0);
  EXPECT_EQ(All::residual(3, 10.0, 1.0), 9.0);
  EXPECT_NEAR(All::residual(4, 3.1, -3.1), 6.2 - kTwoPi, 1e-12);
}

}  // namespace
}  // namespace soopnav
