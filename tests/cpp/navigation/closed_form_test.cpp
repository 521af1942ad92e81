#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>

#include "soopnav/core/random.hpp"
#include "soopnav/navigation/position_fix.hpp"

namespace soopnav::navigation {
namespace {

// Distance of the nearest candidate from the truth.
double error_of(const Eigen::Matrix3Xd& q, const Eigen::Vector3d& p, double clock, std::optional<double> height) {
  const Eigen::VectorXd rho = (q.colwise() - p).colwise().norm().transpose().array() + clock;
  std::array<ClosedFormFix, 3> candidates;
  const int count = closed_form_fixes(q, rho, height, candidates);
  double best = std::numeric_limits<double>::infinity();
  for (int i = 0; i < count; ++i) {
    const auto& c = candidates[static_cast<std::size_t>(i)];
    best = std::min(best, (c.position_m - p).norm() + std::abs(c.clock_bias_m - clock));
  }
  return best;
}

TEST(ClosedForm, IsExactForExactData) {
  RandomStream random(21);
  for (int k = 0; k < 300; ++k) {
    for (const int n : {4, 5, 9}) {
      Eigen::Matrix3Xd q(3, n);
      for (int i = 0; i < n; ++i)
        q.col(i) << random.uniform(-2e3, 2e3), random.uniform(-2e3, 2e3), random.uniform(-1e3, 1e3);
      const Eigen::Vector3d p(random.uniform(-2e3, 2e3), random.uniform(-2e3, 2e3), random.uniform(-1e3, 1e3));
      const double clock = random.uniform(-1e5, 1e5);
      EXPECT_LT(error_of(q, p, clock, std::nullopt), 1e-2) << k << " " << n;
      EXPECT_LT(error_of(q, p, clock, p[2]), 1e-2) << k << " " << n;
      EXPECT_LT(error_of(q.leftCols(3), p, clock, p[2]), 1e-2) << k;
    }
  }
}

TEST(ClosedForm, CoplanarAndCollinearNodesGiveBothSides) {
  Eigen::Matrix3Xd q(3, 5);
  q << 1000, -800, -500, 300, 0, 0, 900, -900, 1500, -2000, 30, 30, 30, 30, 30;
  const Eigen::Vector3d above(100, -50, 80);
  const Eigen::VectorXd rho = (q.colwise() - above).colwise().norm().transpose();
  std::array<ClosedFormFix, 3> c;
  ASSERT_GE(closed_form_fixes(q, rho, std::nullopt, c), 2);
  EXPECT_NEAR(c[0].position_m[2] + c[1].position_m[2], 60.0, 1e-6);
  EXPECT_NEAR(std::abs(c[0].position_m[2] - 30.0), 50.0, 1e-5);

  q.row(1) = 2.0 * q.row(0);
  const Eigen::VectorXd line = (q.colwise() - above).colwise().norm().transpose();
  ASSERT_GE(closed_form_fixes(q, line, 80.0, c), 2);
  EXPECT_LT(std::min((c[0].position_m - above).norm(), (c[1].position_m - above).norm()), 1e-5);
  EXPECT_GT((c[0].position_m - c[1].position_m).norm(), 100.0);
}

TEST(ClosedForm, PossibleCandidatesComeFirst) {
  RandomStream random(22);
  int impossible = 0;
  for (int k = 0; k < 200; ++k) {
    Eigen::Matrix3Xd q(3, 3);
    for (int i = 0; i < 3; ++i) q.col(i) << random.uniform(-2e3, 2e3), random.uniform(-2e3, 2e3), 0.0;
    const Eigen::Vector3d p(random.uniform(-2e3, 2e3), random.uniform(-2e3, 2e3), 0.0);
    const Eigen::VectorXd rho = (q.colwise() - p).colwise().norm().transpose();
    std::array<ClosedFormFix, 3> c;
    const int count = closed_form_fixes(q, rho, 0.0, c);
    ASSERT_GE(count, 1);
    const auto possible = [&](int i) { return rho.minCoeff() >= c[static_cast<std::size_t>(i)].clock_bias_m; };
    EXPECT_TRUE(possible(0)) << k;
    for (int i = 1; i < count; ++i) {
      EXPECT_LE(possible(i), possible(i - 1));
      impossible += possible(i) ? 0 : 1;
    }
  }
  EXPECT_GT(impossible, 0);
}

TEST(ClosedForm, RefusesWhatItCannotUse) {
  std::array<ClosedFormFix, 3> c;
  const Eigen::Matrix3Xd q = Eigen::Matrix3Xd::Random(3, 4);
  EXPECT_EQ(closed_form_fixes(q.leftCols(3), Eigen::VectorXd::Ones(3), std::nullopt, c), 0);
  EXPECT_EQ(closed_form_fixes(q.leftCols(2), Eigen::VectorXd::Ones(2), 0.0, c), 0);
  EXPECT_EQ(closed_form_fixes(q, Eigen::VectorXd::Ones(3), 0.0, c), 0);
  EXPECT_EQ(closed_form_fixes(q, Eigen::VectorXd::Constant(4, std::nan("")), 0.0, c), 0);
  EXPECT_EQ(closed_form_fixes(Eigen::Matrix3Xd::Ones(3, 4), Eigen::VectorXd::Zero(4), 0.0, c), 0);
}

}  // namespace
}  // namespace soopnav::navigation
