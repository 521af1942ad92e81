// The models' Jacobians where source clocks, sources, ambiguities and cloned poses are blocks that joined at run time.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <optional>
#include <string>

#include "measurement/jacobian_battery.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/core/stacked.hpp"
#include "soopnav/estimation/layout_kalman_filter.hpp"
#include "soopnav/measurement/azimuth.hpp"
#include "soopnav/measurement/carrier_phase.hpp"
#include "soopnav/measurement/planar_increment.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "soopnav/measurement/range_difference.hpp"
#include "soopnav/measurement/range_rate.hpp"
#include "soopnav/measurement/received_power.hpp"

namespace soopnav {

// Found by the battery through the state's namespace.
template <class Model, class Frame, class... Roles>
std::optional<Eigen::MatrixXd> jacobian_of(const Model& model, const LayoutState<Frame, Roles...>& x) {
  LayoutPrediction<Model::kDim, LayoutState<Frame, Roles...>> y(x);
  if (!model.predict(x, y) || y.touched.overflow() || x.take_stale()) return std::nullopt;
  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(Model::kDim, x.dim());
  for (int c = 0; c < y.touched.size(); ++c) H.col(y.touched.component(c)) += y.H.col(c);
  return H;
}
template <class Frame, class... Roles>
LayoutState<Frame, Roles...> moved(const LayoutState<Frame, Roles...>& x, int j, double step) {
  auto copy = x;
  Eigen::VectorXd d = Eigen::VectorXd::Zero(x.dim());
  d[j] = step;
  copy.move(d);
  return copy;
}
template <class Frame, class... Roles>
double step_between(const LayoutState<Frame, Roles...>& below, const LayoutState<Frame, Roles...>& above, int j) {
  const double step = above.x()[j] - below.x()[j];
  return above.is_angle(j) ? wrap_to_pi(step) : step;
}

namespace {

using Receiver =
    ComposedState<EnuFrame, Role<3, PositionTag>, Role<3, VelocityTag>, Role<1, ClockBiasTag>, Role<1, ClockDriftTag>>;
using WithSources =
    LayoutState<EnuFrame, Role<3, PositionTag>, Role<3, VelocityTag>, Role<1, ClockBiasTag>, Role<1, ClockDriftTag>>;
using Pose = LayoutState<PlanarFrame, Role<2, PositionTag>, Role<1, HeadingTag>>;

// A receiver and two sources; what leaves and joins in between shuffles slots and offsets.
struct Sources {
  static constexpr int kMax = 40;
  WithSources x;
  Eigen::VectorXd scale;
  Block<3> p, v;
  Block<1> clock, drift, power, exponent, ambiguity;

  explicit Sources(RandomStream& random) : x(test::Place<Receiver>(test::kLocal, random).x, kMax, 20) {
    const auto one = [&](double mean, const char* name) {
      return x.add<1>(Eigen::Matrix<double, 1, 1>(mean + random.normal()), name, BlockKind::kVector);
    };
    const Block<1> leaves = one(0.0, "leaves");
    clock = one(30.0, "clock");
    p = x.add<3>(test::kLocal.point<3>(random), "source", BlockKind::kVector);
    x.remove(leaves);
    drift = one(2.0, "drift");
    v = x.add<3>(test::Scene::velocity<3>(random), "velocity", BlockKind::kVector);
    power = one(-40.0, "power");
    exponent = one(3.0, "exponent");
    ambiguity = one(1e3, "ambiguity");
    scale = Eigen::VectorXd::Constant(x.dim(), 1e3);
    for (const int first : {3, x.layout().offset(v)}) scale.segment<3>(first).setConstant(20.0);
    for (const int i : {7, x.layout().offset(drift), x.layout().offset(power)}) scale[i] = 20.0;
    scale[x.layout().offset(exponent)] = 1.0;
  }
};

TEST(LayoutJacobian, SourcesAsBlocks) {
  RandomStream random(5);
  for (int k = 0; k < 20; ++k) {
    const Sources s(random);
    const auto hold = [&](const char* what, const auto& model) {
      EXPECT_LT(test::worst_jacobian_error(model, s.x, s.scale), 1e-7) << what << ", state " << k;
    };
    const Eigen::Vector3d q = test::kLocal.point<3>(random);
    hold("source clock", Pseudorange<EnuFrame, Block<1>>{q, s.clock});
    hold("source and clock", Pseudorange<EnuFrame, Block<1>, Block<3>>{s.p, s.clock});
    hold("phase", CarrierPhase<EnuFrame, Block<1>, Block<1>, Block<3>>{0.19, s.p, s.ambiguity, s.clock});
    hold("TDOA", Tdoa<EnuFrame, Block<3>, Known<3>, Role<1, ClockBiasTag>, Block<1>>{s.p, q, {}, s.clock});
    hold("TDOA at an estimated reference", Tdoa<EnuFrame, Known<3>, Block<3>>{q, s.p});
    hold("range rate", RangeRate<EnuFrame, Block<3>, Block<3>, Block<1>>{s.p, s.v, s.drift});
    hold("FDOA", Fdoa<EnuFrame, Known<3>, Known<3>, Block<3>, Block<3>, Role<1, ClockDriftTag>, Block<1>>{
                     4e8, q, {}, s.p, s.v, {}, s.drift});
    hold("power", ReceivedPower<EnuFrame, Block<3>, Block<1>, Block<1>>{s.p, s.power, s.exponent});
    hold("stacked", Stacked(Pseudorange<EnuFrame, Block<1>>{q, s.clock},
                            RangeRate<EnuFrame, Block<3>, Block<3>, Block<1>>{s.p, s.v, s.drift}));
  }
}

TEST(LayoutJacobian, ClonedPose) {
  RandomStream random(6);
  for (int k = 0; k < 20; ++k) {
    Pose x({}, 10, 4);
    Eigen::Vector3d start;
    start << test::kLocal.point<2>(random), random.uniform(-3.0, 3.0);
    x.move(start);
    const auto p = x.add<2>(test::kLocal.point<2>(random), "previous place", BlockKind::kVector);
    const auto heading = x.add<1>(Eigen::Matrix<double, 1, 1>(3.1415), "previous heading", BlockKind::kAngle);
    Eigen::VectorXd scale(6);
    scale << 1e3, 1e3, 1.0, 1e3, 1e3, 1.0;
    EXPECT_LT(test::worst_jacobian_error(PlanarIncrement<PlanarFrame, Block<2>, Block<1>>{p, heading}, x, scale), 1e-7)
        << k;
    EXPECT_LT(test::worst_jacobian_error(Azimuth<PlanarFrame, Role<1, HeadingTag>, Block<2>>{p}, x, scale), 1e-7) << k;
  }
}

TEST(LayoutJacobian, AStaleSourceIsSeen) {
  RandomStream random(7);
  Sources s(random);
  const Pseudorange<EnuFrame, Block<1>> model{Eigen::Vector3d(1, 2, 3), s.clock};
  EXPECT_TRUE(jacobian_of(model, s.x).has_value());
  EXPECT_TRUE(s.x.remove(s.clock));
  EXPECT_FALSE(jacobian_of(model, s.x).has_value());
}

}  // namespace
}  // namespace soopnav
