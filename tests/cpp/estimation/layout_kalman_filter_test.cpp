#include "soopnav/estimation/layout_kalman_filter.hpp"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/measurement/azimuth.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "soopnav/process/random_walk.hpp"

namespace soopnav {
namespace {

using Receiver = LayoutState<EnuFrame, Role<3, PositionTag>, Role<1, ClockBiasTag>>;
using Filter = ExtendedKalmanFilter<Receiver>;
using WithClock = Pseudorange<EnuFrame, Block<1>>;

Receiver::Fixed start() {
  Receiver::Fixed x;
  x.x << 10, 20, 30, 5;
  return x;
}

TEST(StateLayout, HandlesGoStale) {
  StateLayout layout(4, 8, 3);
  const auto a = layout.add<1>("clock of 301");
  const auto b = layout.add<2>("emitter");
  EXPECT_EQ(layout.dim(), 7);
  EXPECT_EQ(layout.offset(b), 5);
  EXPECT_EQ(layout.component_name(6), "emitter [1]");
  EXPECT_FALSE(layout.holds(Block<1>{}));
  EXPECT_FALSE(layout.holds(layout.add<2>("too large")));  // two components, room for one
  EXPECT_TRUE(layout.remove(a));
  EXPECT_FALSE(layout.remove(a));
  EXPECT_FALSE(layout.holds(a));
  EXPECT_EQ(layout.offset(b), 4);
  const auto c = layout.add<1>("clock of 30");
  EXPECT_EQ(c.slot, a.slot);  // the slot has a new tenant, and the old handle is still refused
  EXPECT_FALSE(layout.holds(a));
  EXPECT_TRUE(layout.holds(c));
  EXPECT_FALSE(layout.holds(Block<2>{c.slot, c.generation}));  // of another size
  EXPECT_THROW(StateLayout(4, 3, 1), std::invalid_argument);
  EXPECT_THROW(StateLayout(4, 8, -1), std::invalid_argument);
}

TEST(LayoutKalmanFilter, KnownSourceClockEqualsTheFixedFilter) {
  const Eigen::Matrix4d P0 = Eigen::Vector4d(4, 9, 1, 25).asDiagonal();
  ExtendedKalmanFilter<Receiver::Fixed> fixed(start(), P0);
  Filter layout(start(), P0, 20, 10);
  static_cast<void>(layout.join(1.0, 100.0, "clock of a bystander"));
  RandomStream random(3);
  for (int k = 0; k < 50; ++k) {
    const Pseudorange<EnuFrame> model{Eigen::Vector3d(900 * random.normal(), 900 * random.normal(), 80), Known<1>{7.0}};
    const double z = 1000.0 + random.normal();
    ASSERT_EQ(fixed.predict(RandomWalk{kPosition, {1.0, 2.0, 3.0}}, 0.5), UpdateStatus::kAccepted);
    ASSERT_EQ(layout.predict(RandomWalk{kPosition, {1.0, 2.0, 3.0}}, 0.5), UpdateStatus::kAccepted);
    const auto a = fixed.update(model, z, 2.0);
    const auto b = layout.update(model, z, 2.0);
    ASSERT_EQ(a.status, b.status);
    ASSERT_NEAR(a.nis, b.nis, 1e-9 * (1.0 + a.nis));
  }
  EXPECT_NEAR((layout.state().x().head<4>() - fixed.state().x).norm(), 0.0, 1e-8);
  EXPECT_NEAR((layout.covariance().topLeftCorner<4, 4>() - fixed.covariance()).norm(), 0.0, 1e-9);
  EXPECT_EQ(layout.state().x()[4], 1.0);
  EXPECT_EQ(layout.covariance()(4, 4), 100.0);
}

// Two rows: a coordinate, and its sum with a clock.
struct TwoRows {
  using Frame = EnuFrame;
  static constexpr int kDim = 2;
  Block<1> clock;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    y.value(0) = x(kPosition)[0];
    y.value(1) = x(kPosition)[0] + x(clock)[0];
    if constexpr (Y::kJacobian) {
      auto&& to_p = y.jacobian(kPosition);
      to_p(0, 0) += 1.0;
      to_p(1, 0) += 1.0;
      y.jacobian(clock)(1, 0) += 1.0;
    }
    return true;
  }
};

TEST(LayoutKalmanFilter, SeveralRowsDoNotDependOnTheRoomThatIsLeft) {
  Eigen::Matrix2d R;
  R << 4.0, 1.0, 1.0, 9.0;
  std::vector<Eigen::VectorXd> means;
  std::vector<Eigen::MatrixXd> covariances;
  for (const int room : {0, 1, 30}) {
    Filter filter(start(), Eigen::Matrix4d(Eigen::Vector4d(4, 9, 1, 25).asDiagonal()), 5 + room, 1 + room);
    const auto clock = filter.join(1.0, 100.0, "clock");
    for (int k = 0; k < 3; ++k) ASSERT_TRUE(filter.update(TwoRows{clock}, Eigen::Vector2d(11.0, 14.0), R).accepted());
    means.emplace_back(filter.state().x());
    covariances.emplace_back(filter.covariance());
  }
  // By the information: three times Hᵀ R⁻¹ H on the coordinate and the clock.
  Eigen::Matrix2d H;
  H << 1.0, 0.0, 1.0, 1.0;
  const Eigen::Matrix2d prior = Eigen::Vector2d(4.0, 100.0).asDiagonal();
  const Eigen::Matrix2d P = (prior.inverse() + 3.0 * H.transpose() * R.inverse() * H).inverse();
  for (std::size_t i = 0; i < means.size(); ++i) {
    EXPECT_EQ(means[i], means[0]);
    EXPECT_EQ(covariances[i], covariances[0]);
  }
  EXPECT_NEAR(covariances[0](0, 0), P(0, 0), 1e-12);
  EXPECT_NEAR(covariances[0](4, 4), P(1, 1), 1e-10);
  EXPECT_NEAR(covariances[0](0, 4), P(0, 1), 1e-11);
}

TEST(LayoutKalmanFilter, EstimatedClocksEqualTheDenseFilterThroughJoinsAndLeaves) {
  // The same run with dense matrices over a fixed order of columns: 4 of the receiver, one per source that ever was.
  constexpr int kSources = 12;
  constexpr int kN = 4 + kSources;
  Eigen::Matrix<double, kN, 1> x = Eigen::Matrix<double, kN, 1>::Zero();
  Eigen::Matrix<double, kN, kN> P = Eigen::Matrix<double, kN, kN>::Zero();
  x.head<4>() = start().x;
  P.topLeftCorner<4, 4>() = 25.0 * Eigen::Matrix4d::Identity();
  Filter filter(start(), P.topLeftCorner<4, 4>(), 4 + 5, 5);
  std::array<Block<1>, kSources> handle{};
  std::vector<int> present;
  RandomStream random(17);
  for (int k = 0; k < 300; ++k) {
    // Every fifth step one joins; at five the eldest leaves first.
    if (k % 5 == 0 && k / 5 < kSources) {
      const int joining = k / 5;
      if (present.size() == 5) {
        const int leaving = present.front();
        present.erase(present.begin());
        ASSERT_TRUE(filter.marginalise(handle[static_cast<std::size_t>(leaving)]));
        ASSERT_FALSE(filter.marginalise(handle[static_cast<std::size_t>(leaving)]));
      }
      handle[static_cast<std::size_t>(joining)] = filter.join(3.0 * joining, 50.0, "clock");
      ASSERT_TRUE(filter.state().layout().holds(handle[static_cast<std::size_t>(joining)]));
      x[4 + joining] = 3.0 * joining;
      P(4 + joining, 4 + joining) = 50.0;
      present.push_back(joining);
    }
    const int source = present[static_cast<std::size_t>(k) % present.size()];
    const auto block = handle[static_cast<std::size_t>(source)];
    ASSERT_EQ(filter.predict(RandomWalk<Block<1>>{block, {0.3}}, 1.0), UpdateStatus::kAccepted);
    P(4 + source, 4 + source) += 0.3;
    const Eigen::Vector3d q(3e3 * std::cos(0.7 * source), 3e3 * std::sin(0.7 * source), 40.0 + source);
    const Eigen::Vector3d d = x.head<3>() - q;
    Eigen::Matrix<double, 1, kN> H = Eigen::Matrix<double, 1, kN>::Zero();
    H.head<3>() = d.normalized();
    H[3] = 1.0;
    H[4 + source] = -1.0;
    const double z = 3e3 + 5.0 * random.normal();
    const double innovation = z - (d.norm() + x[3] - x[4 + source]);
    const double S = (H * P * H.transpose())(0) + 4.0;
    const Eigen::Matrix<double, kN, 1> K = P * H.transpose() / S;
    x += K * innovation;
    const Eigen::Matrix<double, kN, kN> A = Eigen::Matrix<double, kN, kN>::Identity() - K * H;
    P = (A * P * A.transpose() + K * 4.0 * K.transpose()).eval();
    const auto report = filter.update(WithClock{q, block}, z, 4.0);
    ASSERT_TRUE(report.accepted());
    ASSERT_NEAR(report.nis, innovation * innovation / S, 1e-7 * (1.0 + report.nis)) << k;
  }
  EXPECT_NEAR((filter.state().x().head<4>() - x.head<4>()).norm(), 0.0, 1e-7);
  for (std::size_t i = 0; i < present.size(); ++i) {
    const int column = 4 + present[i];
    EXPECT_NEAR(filter.state()(handle[static_cast<std::size_t>(present[i])])[0], x[column], 1e-7);
    EXPECT_NEAR(filter.covariance()(static_cast<Eigen::Index>(4 + i), 0), P(column, 0), 1e-9);
  }
  const Eigen::MatrixXd C = filter.covariance();
  EXPECT_EQ(C, C.transpose());
  EXPECT_GT(Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(C).eigenvalues()[0], 0.0);
}

TEST(LayoutKalmanFilter, RefusedInputChangesNothing) {
  Filter filter(start(), Eigen::Matrix4d::Identity(), 6, 2);
  const auto block = filter.join(1.0, 2.0, "clock");
  const auto gone = filter.join(1.0, 2.0, "short-lived");
  EXPECT_FALSE(filter.state().layout().holds(filter.join(1.0, 2.0, "no room")));
  ASSERT_TRUE(filter.marginalise(gone));
  EXPECT_FALSE(filter.state().layout().holds(filter.join(std::numeric_limits<double>::quiet_NaN(), 2.0, "bad")));
  EXPECT_FALSE(filter.state().layout().holds(filter.join(1.0, 0.0, "no variance")));
  const Eigen::VectorXd x = filter.state().x();
  const Eigen::MatrixXd P = filter.covariance();
  const Eigen::Vector3d q(600, 800, 30);
  const auto unchanged = [&](UpdateStatus got, UpdateStatus want) {
    EXPECT_EQ(got, want);
    EXPECT_EQ(x, filter.state().x());
    EXPECT_EQ(P, filter.covariance());
  };
  unchanged(filter.update(WithClock{q, gone}, 1000.0, 1.0).status, UpdateStatus::kStaleHandle);
  unchanged(filter.update(WithClock{q, Block<1>{}}, 1000.0, 1.0).status, UpdateStatus::kStaleHandle);
  unchanged(filter.predict(RandomWalk<Block<1>>{gone, {1.0}}, 1.0), UpdateStatus::kStaleHandle);
  unchanged(filter.predict(RandomWalk<Block<1>>{block, {1.0}}, 0.0), UpdateStatus::kTimeNotAdvancing);
  unchanged(filter.predict(RandomWalk<Block<1>>{block, {-1.0}}, 1.0), UpdateStatus::kNonFinite);
  unchanged(filter.update(WithClock{start().x.head<3>(), block}, 5.0, 1.0).status, UpdateStatus::kUndefined);
  unchanged(filter.update(WithClock{q, block}, 1000.0, 0.0).status, UpdateStatus::kNotPositiveDefinite);
  unchanged(filter.update(WithClock{q, block}, 1e9, 1.0, Gate{.nis = 10.0}).status, UpdateStatus::kGated);
  EXPECT_TRUE(filter.update(WithClock{q, block}, 1000.0, 1.0).accepted());
}

TEST(LayoutKalmanFilter, AngleBlocksWrap) {
  // The mounting angle of an antenna as a block: the bearing's zero is estimated, over the seam.
  using Plane = LayoutState<PlanarFrame, Role<2, PositionTag>>;
  Plane::Fixed x0;
  ExtendedKalmanFilter<Plane> filter(x0, 1e-6 * Eigen::Matrix2d::Identity(), 4, 2);
  const auto mounting = filter.join(3.1, 0.04, "mounting", BlockKind::kAngle);
  const Azimuth<PlanarFrame, Block<1>> model{Eigen::Vector2d(100, 0), mounting};  // z = 0 - psi
  const auto report = filter.update(model, -3.1 - 0.2, 1e-6);
  ASSERT_TRUE(report.accepted());
  EXPECT_NEAR(report.innovation[0], -0.2, 1e-12);
  EXPECT_NEAR(filter.state()(mounting)[0], 3.3 - kTwoPi, 1e-4);
}

}  // namespace
}  // namespace soopnav
