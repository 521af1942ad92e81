// No heap in predict, update and a fixed-lag filter's replay: counted.
#include <gtest/gtest.h>

#include <array>
#include <type_traits>

#include "estimation/tracking_scene.hpp"
#include "soopnav/estimation/adaptive_noise.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/fixed_lag_filter.hpp"
#include "soopnav/estimation/information_filter.hpp"
#include "soopnav/estimation/interacting_multiple_model.hpp"
#include "soopnav/estimation/iterated_kalman_filter.hpp"
#include "soopnav/estimation/square_root_kalman_filter.hpp"
#include "support/allocation_count.hpp"

namespace soopnav {
namespace {

using test::Fix;
using test::Motion;
using test::PlanarRange;
using test::Vehicle;

template <class Filter>
class NoAlloc : public testing::Test {};
using Filters =
    testing::Types<IteratedKalmanFilter<Vehicle>, SquareRootKalmanFilter<Vehicle>, InformationFilter<Vehicle>>;
TYPED_TEST_SUITE(NoAlloc, Filters);

TYPED_TEST(NoAlloc, Variants) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  const Eigen::Matrix4d P0 = 25.0 * Eigen::Matrix4d::Identity();
  TypeParam filter(test::vehicle(0, 0, 1, 1), P0);
  filter.set_covariance_floor(Eigen::Vector4d(0.5, 0.5, 0.5, 0.5));
  if constexpr (std::is_same_v<TypeParam, InformationFilter<Vehicle>>) {
    filter.restore_information(filter.state(), Eigen::Matrix4d::Zero());  // the singular way too
  }
  const std::array<PlanarRange, 2> pair{PlanarRange{Eigen::Vector2d(60, 10)}, PlanarRange{Eigen::Vector2d(-20, 70)}};
  const Eigen::Vector2d z(58.0, 70.0);
  const Eigen::Matrix2d R = Eigen::Matrix2d::Identity();
  AdaptiveProcessNoise noise;
  Eigen::Matrix4d cross;
  EXPECT_EQ(test::allocations_of([&] {
              for (int k = 0; k < 5; ++k) {
                ASSERT_EQ(filter.predict(noise.scaled(Motion{{0.2, 0.2}}), 0.5, &cross), UpdateStatus::kAccepted);
                const auto report = filter.update(Fix{}, Eigen::Vector2d(1 + 0.5 * k, 2), R);
                ASSERT_TRUE(report.accepted());
                static_cast<void>(noise.observe(report, R));
                ASSERT_TRUE(filter.update(Correlated<PlanarRange>{pair, z, R}).accepted());
              }
            }),
            0);
}

TEST(NoAllocOfMany, MultipleModelsAndFixedLag) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  const Eigen::Matrix4d P0 = Eigen::Matrix4d::Identity();
  const Eigen::Matrix2d R = Eigen::Matrix2d::Identity();
  const Eigen::Matrix2d chain = (Eigen::Matrix2d() << 0.9, 0.1, 0.2, 0.8).finished();
  InteractingMultipleModel imm(test::vehicle(0, 0, 1, 1), P0, chain, Eigen::Vector2d(0.5, 0.5), Motion{{0.1, 0.1}},
                               Motion{{3.0, 3.0}});
  const Epoch start = Epoch::from_seconds(TimeScale::kGps, 1e9);
  FixedLagFilter<ExtendedKalmanFilter<Vehicle>, Motion, Fix, PlanarRange> lagged(
      ExtendedKalmanFilter<Vehicle>(test::vehicle(0, 0, 1, 1), P0), Motion{{0.1, 0.1}}, start, 6);
  const std::array<PlanarRange, 2> ranges{PlanarRange{Eigen::Vector2d(60, 10)}, PlanarRange{Eigen::Vector2d(10, 60)}};
  const Eigen::MatrixXd noise = R;
  Eigen::VectorXd z(2);
  EXPECT_EQ(test::allocations_of([&] {
              for (int k = 1; k <= 20; ++k) {
                ASSERT_EQ(imm.predict(1.0), UpdateStatus::kAccepted);
                z.setConstant((Eigen::Vector2d(60, 10) - Eigen::Vector2d(k, k)).norm());
                ASSERT_TRUE(imm.update(Correlated<PlanarRange>{ranges, z, noise}).accepted());
                ASSERT_TRUE(imm.update(Fix{}, Eigen::Vector2d(k, k), R).accepted());
                ASSERT_TRUE(lagged.update(Observed<Fix>({}, Eigen::Vector2d(k, k), R), start + k).accepted());
                if (k > 4) {
                  const double t = k - 1.5;
                  const double range = (Eigen::Vector2d(60, 10) - Eigen::Vector2d(t, t)).norm();
                  ASSERT_TRUE(lagged.update(PlanarRange{Eigen::Vector2d(60, 10)}, range, 1.0, start + t).accepted());
                }
                ASSERT_EQ(lagged.smooth(), SmoothStatus::kDone);
              }
            }),
            0);
}

}  // namespace
}  // namespace soopnav
