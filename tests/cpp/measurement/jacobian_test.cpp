#include <gtest/gtest.h>

#include <Eigen/Core>
#include <vector>

#include "measurement/jacobian_battery.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "soopnav/measurement/range.hpp"

namespace soopnav {
namespace {

template <class M, class S>
struct With {
  using Model = M;
  using State = S;
};

template <class T>
class JacobianBattery : public testing::Test {};
using Cases =
    testing::Types<With<Range<EnuFrame>, PositionClock<EnuFrame>>, With<Range<EnuFrame>, PlanarPositionClock<EnuFrame>>,
                   With<Range<>, PositionClock<EcefFrame>>, With<Pseudorange<EnuFrame>, PositionClock<EnuFrame>>,
                   With<Pseudorange<EnuFrame>, PlanarPositionClock<EnuFrame>>,
                   With<Pseudorange<>, PositionClock<EcefFrame>>>;
TYPED_TEST_SUITE(JacobianBattery, Cases);

template <class State>
State state_at(const Eigen::Vector3d& p, double clock) {
  State x;
  x.x.template segment<3>(State::at(kPosition)) = p;
  x.x[State::at(kClockBias)] = clock;
  return x;
}

TYPED_TEST(JacobianBattery, EqualsCentralDifferencesLocally) {
  RandomStream random(11);
  for (int k = 0; k < 50; ++k) {
    const auto x = state_at<typename TypeParam::State>(
        {random.uniform(-2e3, 2e3), random.uniform(-2e3, 2e3), random.uniform(-50, 50)}, 300.0);
    typename TypeParam::Model model{
        Eigen::Vector3d(random.uniform(-2e3, 2e3), random.uniform(-2e3, 2e3), random.uniform(60, 200))};
    EXPECT_LT(test::worst_jacobian_error(model, x), 1e-8) << k;
  }
}

TYPED_TEST(JacobianBattery, EqualsCentralDifferencesAtEarthMagnitude) {
  RandomStream random(12);
  const Eigen::Vector3d centre(3912960.8, 299353.1, 5014176.3);
  for (int k = 0; k < 50; ++k) {
    const Eigen::Vector3d p = centre + 1e4 * Eigen::Vector3d(random.normal(), random.normal(), random.normal());
    const auto x = state_at<typename TypeParam::State>(p, -2e5);
    // A near base station and a far satellite.
    const double far = k % 2 == 0 ? 2e3 : 2e7;
    typename TypeParam::Model model{p +
                                    far * Eigen::Vector3d(random.normal(), random.normal(), 1.0 + random.uniform())};
    EXPECT_LT(test::worst_jacobian_error(model, x), 1e-8) << k;
  }
}

// The battery must see what it is made to see.
struct WrongSign {
  static constexpr int kDim = 1;
  Range<EnuFrame> right;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const bool defined = right.predict(x, y);
    if constexpr (Y::kJacobian) y.jacobian(kPosition)(1) *= -1.0;
    return defined;
  }
};
struct SlightlyWrong {
  static constexpr int kDim = 1;
  Range<EnuFrame> right;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const bool defined = right.predict(x, y);
    if constexpr (Y::kJacobian) y.jacobian(kPosition)(0) += 1e-6;
    return defined;
  }
};

TEST(JacobianBatteryItself, FindsWrongJacobians) {
  const auto x = state_at<PositionClock<EnuFrame>>({300, 400, 10}, 0.0);
  const Range<EnuFrame> right{Eigen::Vector3d(-500, 100, 30)};
  EXPECT_LT(test::worst_jacobian_error(right, x), 1e-9);
  EXPECT_GT(test::worst_jacobian_error(WrongSign{right}, x), 0.1);
  EXPECT_GT(test::worst_jacobian_error(SlightlyWrong{right}, x), 5e-7);
}

}  // namespace
}  // namespace soopnav
