#include "soopnav/estimation/posterior_crlb.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <vector>

#include "soopnav/core/random.hpp"
#include "support/nan.hpp"

namespace soopnav {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix4d;
using Eigen::MatrixXd;

using ::soopnav::test::kNan;

// Position and velocity in a plane, driven by white acceleration: four states, two noises, Q of rank two.
struct Motion {
  Matrix4d F = Matrix4d::Identity();
  Eigen::Matrix<double, 4, 2> G = Eigen::Matrix<double, 4, 2>::Zero();
  explicit Motion(double dt) {
    F(0, 2) = F(1, 3) = dt;
    for (int axis = 0; axis < 2; ++axis) {
      G(axis, axis) = 0.3 * 0.5 * dt * dt;
      G(axis + 2, axis) = 0.3 * dt;
    }
  }
};

TEST(PosteriorCrlb, OfALinearSystemIsTheKalmanFiltersCovariance) {
  const Motion motion(0.5);
  Eigen::Matrix<double, 2, 4> H = Eigen::Matrix<double, 2, 4>::Zero();
  H(0, 0) = H(1, 1) = H(1, 0) = 1.0;
  Matrix2d R;
  R << 2.0, 0.7, 0.7, 1.0;
  Matrix4d P = Eigen::Vector4d(100.0, 50.0, 4.0, 9.0).asDiagonal();
  PosteriorCrlb<4> bound(P);
  PosteriorCrlb<Eigen::Dynamic> dynamic{MatrixXd(P)};
  for (int k = 0; k < 60; ++k) {
    ASSERT_TRUE(bound.predict(motion.F, motion.G));
    ASSERT_TRUE(dynamic.predict(MatrixXd(motion.F), MatrixXd(motion.G)));
    P = (motion.F * P * motion.F.transpose() + motion.G * motion.G.transpose()).eval();
    EXPECT_LT((bound.bound().covariance - P).norm(), 1e-10 * P.norm()) << "predicted, step " << k;
    if (k % 3 == 0) continue;
    ASSERT_TRUE(bound.update(H, R));
    ASSERT_TRUE(dynamic.update(MatrixXd(H), MatrixXd(R)));
    const Matrix2d S = H * P * H.transpose() + R;
    const Eigen::Matrix<double, 4, 2> K = S.llt().solve(H * P).transpose();
    const Matrix4d left = Matrix4d::Identity() - K * H;
    P = (left * P * left.transpose() + K * R * K.transpose()).eval();
    EXPECT_LT((bound.bound().covariance - P).norm(), 1e-10 * P.norm()) << "updated, step " << k;
    EXPECT_LT((dynamic.bound().covariance - P).norm(), 1e-10 * P.norm());
  }
}

TEST(PosteriorCrlb, StartsFromNothingKnownAndSaysWhatIsMissing) {
  const Motion motion(1.0);
  Eigen::Matrix<double, 2, 4> H = Eigen::Matrix<double, 2, 4>::Zero();
  H(0, 0) = H(1, 1) = 1.0;
  auto bound = PosteriorCrlb<4>::from_information(Matrix4d::Zero());
  EXPECT_EQ(bound.bound().rank, 0);
  ASSERT_TRUE(bound.predict(motion.F, motion.G));
  EXPECT_EQ(bound.bound().rank, 0);
  ASSERT_TRUE(bound.update(H, Matrix2d::Identity()));
  EXPECT_EQ(bound.bound().rank, 2);
  EXPECT_NEAR(bound.bound().sigma[0], 1.0, 1e-12);
  EXPECT_TRUE(std::isinf(bound.bound().sigma[2]));
  ASSERT_TRUE(bound.predict(motion.F, motion.G));
  ASSERT_TRUE(bound.update(H, Matrix2d::Identity()));
  EXPECT_EQ(bound.bound().rank, 4);
  // Two positions one second apart, and the acceleration between them: v1 = z1 - z0 + (noise 0.15) with errors of 1 m
  // each. By least squares over (x0, v0, w): cov(v1) = 2 + (0.15)².
  EXPECT_NEAR(bound.bound().covariance(2, 2), 2.0 + 0.15 * 0.15, 1e-12);
}

TEST(PosteriorCrlb, StepsThroughASingularTransition) {
  // A state that is forgotten: its transition is singular, its noise new.
  Matrix2d F = Matrix2d::Zero();
  F(0, 0) = F(0, 1) = 1.0;
  const Eigen::Vector2d g(0.0, 3.0);
  Matrix2d P = Eigen::Vector2d(4.0, 1.0).asDiagonal();
  PosteriorCrlb<2> bound(P);
  ASSERT_TRUE(bound.predict(F, g));
  Matrix2d expected = F * P * F.transpose();
  expected(1, 1) += 9.0;
  EXPECT_LT((bound.bound().covariance - expected).norm(), 1e-12);
  // Without that noise the next covariance is singular, and with nothing known there is nothing to map.
  EXPECT_FALSE(bound.predict(F, Eigen::Vector2d::Zero()));
  EXPECT_LT((bound.bound().covariance - expected).norm(), 1e-12);
  auto nothing = PosteriorCrlb<2>::from_information(Matrix2d::Zero());
  EXPECT_FALSE(nothing.predict(F, g));
}

TEST(PosteriorCrlb, ExpectedFormEqualsTheRootForm) {
  const Motion motion(0.5);
  Matrix4d Q = motion.G * motion.G.transpose();
  Q.diagonal().array() += 0.01;
  const Matrix4d L = Q.llt().matrixL();
  const Matrix4d inverse = Q.llt().solve(Matrix4d::Identity());
  Eigen::Matrix<double, 2, 4> H = Eigen::Matrix<double, 2, 4>::Zero();
  H(0, 0) = H(1, 3) = 1.0;
  PosteriorCrlb<4> a(Matrix4d::Identity());
  PosteriorCrlb<4> b(Matrix4d::Identity());
  for (int k = 0; k < 20; ++k) {
    ASSERT_TRUE(a.predict(motion.F, L));
    ASSERT_TRUE(
        b.predict_expected(motion.F.transpose() * inverse * motion.F, -motion.F.transpose() * inverse, inverse));
    ASSERT_TRUE(a.update(H, Matrix2d::Identity()));
    ASSERT_TRUE(b.update_expected(H.transpose() * H));
    EXPECT_LT((a.information() - b.information()).norm(), 1e-9 * a.information().norm());
  }
}

TEST(PosteriorCrlb, OfANonlinearSystemIsTheLastBlockOfTheWholeTrajectorys) {
  // x⁺ = x/2 + 25 x/(1 + x²) + w, z = x²/20 + v: the information of (x_0 ... x_T) is block tridiagonal, its blocks
  // averages over trajectories; the bound of x_T is the last diagonal element of its inverse (Tichavský et al. eq. 21).
  constexpr int kSteps = 12;
  constexpr int kRuns = 4000;
  constexpr double q = 10.0;
  constexpr double r = 1.0;
  std::vector<double> slope2(kSteps, 0.0);
  std::vector<double> slope(kSteps, 0.0);
  std::vector<double> seen(kSteps + 1, 0.0);
  RandomStream random(11);
  for (int run = 0; run < kRuns; ++run) {
    double x = random.normal(0.0, std::sqrt(5.0));
    for (int k = 0; k < kSteps; ++k) {
      const double f = 0.5 + 25.0 * (1.0 - x * x) / ((1.0 + x * x) * (1.0 + x * x));
      slope[static_cast<std::size_t>(k)] += f / kRuns;
      slope2[static_cast<std::size_t>(k)] += f * f / kRuns;
      x = 0.5 * x + 25.0 * x / (1.0 + x * x) + random.normal(0.0, std::sqrt(q));
      seen[static_cast<std::size_t>(k) + 1] += x * x / 100.0 / r / kRuns;
    }
  }
  using Scalar = Eigen::Matrix<double, 1, 1>;
  PosteriorCrlb<1> bound(Scalar(5.0));
  MatrixXd whole = MatrixXd::Zero(kSteps + 1, kSteps + 1);
  whole(0, 0) = 1.0 / 5.0;
  for (int k = 0; k < kSteps; ++k) {
    const auto at = static_cast<std::size_t>(k);
    ASSERT_TRUE(bound.predict_expected(Scalar(slope2[at] / q), Scalar(-slope[at] / q), Scalar(1.0 / q)));
    ASSERT_TRUE(bound.update_expected(Scalar(seen[at + 1])));
    whole(k, k) += slope2[at] / q;
    whole(k, k + 1) = whole(k + 1, k) = -slope[at] / q;
    whole(k + 1, k + 1) += 1.0 / q + seen[at + 1];
    const MatrixXd part = whole.topLeftCorner(k + 2, k + 2);
    const double last = part.llt().solve(MatrixXd::Identity(k + 2, k + 2))(k + 1, k + 1);
    EXPECT_NEAR(bound.bound().covariance(0, 0), last, 1e-10 * last) << "step " << k;
  }
}

TEST(PosteriorCrlb, RefusesWithoutAChange) {
  const Motion motion(1.0);
  PosteriorCrlb<4> bound(Matrix4d::Identity());
  const auto before = bound.root();
  Matrix4d bad = motion.F;
  bad(2, 2) = kNan;
  const Eigen::RowVector4d h(1.0, 0.0, 0.0, 0.0);
  EXPECT_FALSE(bound.predict(bad, motion.G));
  EXPECT_FALSE(bound.predict(motion.F, motion.G * kNan));
  EXPECT_FALSE(bound.predict_expected(bad, motion.F, motion.F));
  EXPECT_FALSE(bound.predict_expected(-4.0 * Matrix4d::Identity(), motion.F, motion.F));
  EXPECT_FALSE(bound.update(h, Eigen::Matrix<double, 1, 1>(0.0)));
  EXPECT_FALSE(bound.update(h * kNan, Eigen::Matrix<double, 1, 1>(1.0)));
  EXPECT_FALSE(bound.update_expected(-Matrix4d::Identity()));
  EXPECT_EQ(bound.root(), before);
  EXPECT_THROW(PosteriorCrlb<4>{Matrix4d(Matrix4d::Zero())}, std::invalid_argument);
  EXPECT_THROW(PosteriorCrlb<4>{Matrix4d(Matrix4d::Constant(kNan))}, std::invalid_argument);
  EXPECT_THROW(static_cast<void>(PosteriorCrlb<4>::from_information(-Matrix4d::Identity())), std::invalid_argument);
  PosteriorCrlb<Eigen::Dynamic> dynamic{MatrixXd(MatrixXd::Identity(2, 2))};
  EXPECT_FALSE(dynamic.predict(MatrixXd(MatrixXd::Identity(3, 3)), MatrixXd(MatrixXd::Zero(3, 1))));
  EXPECT_FALSE(dynamic.update(MatrixXd(MatrixXd::Ones(1, 3)), MatrixXd(MatrixXd::Ones(1, 1))));
  EXPECT_FALSE(dynamic.update_expected(MatrixXd(MatrixXd::Identity(3, 3))));
  EXPECT_FALSE(dynamic.predict_expected(MatrixXd(MatrixXd::Identity(2, 2)), MatrixXd(MatrixXd::Zero(2, 2)),
                                        MatrixXd(MatrixXd::Identity(3, 3))));
}

}  // namespace
}  // namespace soopnav
