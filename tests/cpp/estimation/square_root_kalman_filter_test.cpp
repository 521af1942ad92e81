#include "soopnav/estimation/square_root_kalman_filter.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <array>
#include <cmath>

#include "estimation/tracking_scene.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/detail/triangular.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"

namespace soopnav {
namespace {

using Spot = ComposedState<EnuFrame, Role<3, PositionTag>>;

// z = a · p
struct Projection {
  using Frame = EnuFrame;
  static constexpr int kDim = 1;
  Eigen::Vector3d a;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto p = x(kPosition);
    y.value(0) = a[0] * p[0] + a[1] * p[1] + a[2] * p[2];
    if constexpr (Y::kJacobian) y.jacobian(kPosition) = a.transpose();
    return true;
  }
};

TEST(LowerTriangular, KeepsTheProductWithItsTranspose) {
  RandomStream random(11);
  Eigen::Matrix<double, 4, 7> A;
  for (double& a : A.reshaped()) a = random.normal();
  A.row(2).setZero();  // a state known exactly
  A.row(1) = 3.0 * A.row(0);
  const Eigen::Matrix4d product = A * A.transpose();
  detail::make_lower_triangular(A);
  const Eigen::Matrix4d L = A.leftCols<4>();
  EXPECT_LT((L * L.transpose() - product).norm(), 1e-13 * product.norm());
  EXPECT_EQ(A.rightCols<3>().norm(), 0.0);
  for (int j = 0; j < 4; ++j) {
    EXPECT_GE(L(j, j), 0.0);
    for (int i = 0; i < j; ++i) EXPECT_EQ(L(i, j), 0.0);
  }
}

TEST(SquareRootKalmanFilter, KeepsDigitsThatTheCovarianceFormLoses) {
  // Two nearly parallel projections, each of noise e (after Grewal and Andrews): the innovation of the
  // second has a variance of 2 e² beside numbers of one. Condition number of the posterior: 1e16 and above.
  const double e = 3e-9;
  const Eigen::Vector3d first(1, 1, 1);
  const Eigen::Vector3d second(1, 1, 1 + e);
  // The truth, from the information form in extended precision, where nothing cancels.
  using Wide = Eigen::Matrix<long double, 3, 3>;
  const Eigen::Matrix<long double, 3, 1> a = first.cast<long double>();
  const Eigen::Matrix<long double, 3, 1> b = second.cast<long double>();
  const Eigen::Matrix<long double, 3, 1> z_weighted = (a * 2.0L + b * 2.0L) / (static_cast<long double>(e) * e);
  const Wide information =
      Wide::Identity() + (a * a.transpose() + b * b.transpose()) / (static_cast<long double>(e) * e);
  const Eigen::PartialPivLU<Wide> lu(information);
  const Eigen::Matrix3d P = lu.solve(Wide::Identity()).eval().cast<double>();
  const Eigen::Vector3d x = lu.solve(z_weighted).eval().cast<double>();

  const auto worst = [&](auto& filter) {
    EXPECT_TRUE(filter.update(Projection{first}, 2.0, e * e).accepted());
    EXPECT_TRUE(filter.update(Projection{second}, 2.0, e * e).accepted());
    const Eigen::Matrix3d got = filter.covariance();
    return (got - P).cwiseAbs().maxCoeff() / P.cwiseAbs().maxCoeff();
  };
  SquareRootKalmanFilter<Spot> root({}, Eigen::Matrix3d::Identity());
  ExtendedKalmanFilter<Spot> joseph({}, Eigen::Matrix3d::Identity());
  EXPECT_LT(worst(root), 1e-6);
  EXPECT_LT((root.state().x - x).norm(), 1e-6);
  EXPECT_GT(worst(joseph), 1e-3);  // the covariance form is left with noise there
}

TEST(SquareRootKalmanFilter, PredictsASingularCovariance) {
  // Position known exactly, velocity not; a random walk of nothing.
  Eigen::Matrix4d P0 = Eigen::Matrix4d::Zero();
  P0(2, 2) = 4.0;
  SquareRootKalmanFilter<test::Vehicle> filter(test::vehicle(0, 0, 1, 2), P0);
  Eigen::Matrix4d cross;
  ASSERT_EQ(filter.predict(test::Motion{{0.0, 0.0}}, 2.0, &cross), UpdateStatus::kAccepted);
  Eigen::Matrix4d want = Eigen::Matrix4d::Zero();
  want(0, 0) = 16.0;
  want(0, 2) = want(2, 0) = 8.0;
  want(2, 2) = 4.0;
  EXPECT_LT((filter.covariance() - want).norm(), 1e-14);
  Eigen::Matrix4d want_cross = Eigen::Matrix4d::Zero();
  want_cross(2, 0) = 8.0;
  want_cross(2, 2) = 4.0;
  EXPECT_LT((cross - want_cross).norm(), 1e-14);
  // What is known exactly stays so.
  const auto report = filter.update(test::Fix{}, Eigen::Vector2d(1, 5), Eigen::Matrix2d::Identity());
  ASSERT_TRUE(report.accepted());
  EXPECT_EQ(filter.covariance()(1, 1), 0.0);
  EXPECT_EQ(filter.state().x[1], 4.0);
}

TEST(SquareRootKalmanFilter, RestoresByCovarianceAndByRoot) {
  const Eigen::Matrix4d P0 = Eigen::Vector4d(2, 3, 5, 7).asDiagonal();
  SquareRootKalmanFilter<test::Vehicle> filter(test::vehicle(1, 2, 3, 4), P0);
  ASSERT_TRUE(filter.update(test::PlanarRange{Eigen::Vector2d(30, 40)}, 45.0, 1.0).accepted());
  SquareRootKalmanFilter<test::Vehicle> other(test::vehicle(0, 0, 0, 0), P0);
  other.restore_root(filter.state(), filter.root());
  EXPECT_EQ(other.covariance(), filter.covariance());
  EXPECT_TRUE(other.restore(filter.state(), filter.covariance()));
  EXPECT_LT((other.covariance() - filter.covariance()).norm(), 1e-14);
  Eigen::Matrix4d bad = P0;
  bad(0, 0) = -1.0;
  EXPECT_FALSE(other.restore(test::vehicle(9, 9, 9, 9), bad));
  EXPECT_EQ(other.state().x, filter.state().x);
}

}  // namespace
}  // namespace soopnav
