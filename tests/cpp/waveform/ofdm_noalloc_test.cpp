#include <gtest/gtest.h>

#include <vector>

#include "soopnav/waveform/ofdm/boundary.hpp"
#include "soopnav/waveform/ofdm/synthesis.hpp"
#include "soopnav/waveform/ofdm/two_ray.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::ofdm {
namespace {

TEST(OfdmNoAlloc, SynthesisBoundariesAndTwoRays) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  Synthesizer synthesizer(Numerology{});
  BoundaryEstimator nearest({}, 50);
  BoundaryEstimator likelihood({}, 50, 1, {BoundaryMethod::kMaximumLikelihood, 10.0});
  BoundaryEstimator interpolated({}, 50, 1, {BoundaryMethod::kInterpolated, std::nullopt});
  TwoRayTiming timing({}, 50);
  std::vector<Cf32> y(51 * 80);
  std::vector<double> folded(80);
  RandomStream random(1);
  synthesizer.fill(y, random);  // the first transform may set its library up
  bool ok = true;
  EXPECT_EQ(test::allocations_of([&] {
              synthesizer.fill(y, random);
              random.add_complex_normal(y, 0.01);
              ok = nearest.estimate(y).status == BoundaryStatus::kOk && ok;
              ok = likelihood.estimate(y).status == BoundaryStatus::kOk && ok;
              ok = interpolated.estimate(y).status == BoundaryStatus::kOk && ok;
              interpolated.folded_differences(folded);
              ok = timing.estimate(folded, 0.0, 1.0).status == BoundaryStatus::kOk && ok;
            }),
            0);
  EXPECT_TRUE(ok);
}

}  // namespace
}  // namespace soopnav::ofdm
