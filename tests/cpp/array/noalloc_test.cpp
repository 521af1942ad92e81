#include <gtest/gtest.h>

#include <memory>
#include <vector>

#include "soopnav/array/direction_finder.hpp"
#include "soopnav/core/random.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::array {
namespace {

TEST(ArrayNoAlloc, EstimatesDoNotTouchTheHeap) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  const Manifold manifold(ArrayGeometry::uca(6, 0.4));
  const auto table = std::make_shared<const SteeringTable>(manifold, GridOptions{0.05, 0.05, 0.0, 0.0, 0.0});
  std::vector<Cf32> iq(6 * 300);
  RandomStream(1).fill_complex_normal(iq);
  const ChannelSpan span{iq.data(), 6, 300, 300};
  for (const DirectionMethod method : {DirectionMethod::kMusic, DirectionMethod::kCapon, DirectionMethod::kBartlett,
                                       DirectionMethod::kSubspaceFitting, DirectionMethod::kMaximumLikelihood}) {
    for (const int n_sources : {0, 1, 3}) {
      DirectionFinder finder(table, {method, n_sources, 0.0, true});
      EXPECT_EQ(test::allocations_of([&] { static_cast<void>(finder.estimate(span)); }), 0)
          << static_cast<int>(method) << " " << n_sources;
    }
  }
  ComplexMatrix R;
  HermitianEigen eigen;
  double angles[2];
  EXPECT_EQ(test::allocations_of([&] {
              static_cast<void>(covariance(span, R));
              R = forward_backward(spatial_smoothing(R, 5));
              ASSERT_TRUE(hermitian_eigen(R, eigen));
              static_cast<void>(root_music(eigen, 0.5, angles));
              static_cast<void>(esprit(eigen, 0.5, true, angles));
              static_cast<void>(source_count(SourceCount::kMdl, {eigen.values.data(), 5}, 300.0));
            }),
            0);
}

}  // namespace
}  // namespace soopnav::array
