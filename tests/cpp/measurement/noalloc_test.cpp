// No heap in any model: counted.
#include <gtest/gtest.h>

#include <Eigen/Core>

#include "measurement/jacobian_battery.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/core/stacked.hpp"
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
#include "support/allocation_count.hpp"

namespace soopnav {
namespace {

template <class State, class Model>
void ask(const char* what, const State& x, const Model& model) {
  bool defined = false;
  EXPECT_EQ(test::allocations_of([&] {
              Prediction<Model::kDim, State> full;
              ValuePrediction<double, Model::kDim> values;
              defined = model.predict(x, full) && model.predict(x, values);
            }),
            0)
      << what;
  EXPECT_TRUE(defined) << what;
}

TEST(MeasurementNoAlloc, Models) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  RandomStream random(1);
  const auto x = test::Place<test::Space<EnuFrame>>(test::kLocal, random).x;
  const auto p = test::Place<test::Plane<PlanarFrame>>(test::kLocal, random).x;
  const Eigen::Vector3d q(100, 200, 300);
  ask("range", x, Range<EnuFrame>{q});
  ask("pseudorange", x, Pseudorange<EnuFrame>{q});
  ask("range difference", x, RangeDifference<EnuFrame>{q});
  ask("TDOA", x, Tdoa<EnuFrame>{q});
  ask("range rate", x, RangeRate<EnuFrame>{q});
  ask("Doppler", x, Doppler<EnuFrame>{1e9, q});
  ask("FDOA", x, Fdoa<EnuFrame>{1e9, q});
  ask("azimuth and elevation", x, AzimuthElevation<EnuFrame>{q});
  ask("body direction", x, BodyDirection<EnuFrame>{q});
  ask("power", x, ReceivedPower<EnuFrame>{q, -30.0, 2.0});
  ask("phase", x, CarrierPhase<EnuFrame>{0.2, q});
  ask("position", x, PositionFix<EnuFrame>{});
  ask("increment", p, PlanarIncrement<PlanarFrame>{});
  ask("stacked", p, Stacked(PlanarIncrement<PlanarFrame>{}, Azimuth<PlanarFrame, Role<1, HeadingTag>>{{10.0, 20.0}}));
}

}  // namespace
}  // namespace soopnav
