#include "soopnav/estimation/rts_smoother.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "estimation/linear_systems.hpp"
#include "soopnav/core/angle.hpp"
#include "support/nan.hpp"

namespace soopnav {
namespace {

using test::DenseSystem;
using test::matrix_at;
using test::vector_at;

using ::soopnav::test::kNan;

struct Smoothed {
  std::vector<double> x, P;
  int singular = 0;
};

Smoothed smooth(const DenseSystem& s, const LinearRun& r) {
  Smoothed out{std::vector<double>(r.x.size()), std::vector<double>(r.P.size())};
  out.singular = rts_smooth(s.F, r.x_pred, r.P_pred, r.x, r.P, out.x, out.P);
  return out;
}

struct Batch {
  Eigen::VectorXd x;
  Eigen::MatrixXd P;
};

// All states of a run at once: the normal equations of its start, its transitions and its measurements.
Batch batch_solution(const DenseSystem& s, const RowMajorMatrix& z) {
  const Eigen::Index n = s.n();
  const Eigen::Index steps = z.rows();
  const Eigen::Index size = n * (steps + 1);
  const auto inverse = [](const Eigen::MatrixXd& M) -> Eigen::MatrixXd {
    return M.llt().solve(Eigen::MatrixXd::Identity(M.rows(), M.cols()));
  };
  const Eigen::MatrixXd Q = inverse(s.Q);
  const Eigen::MatrixXd R = inverse(s.R);
  const Eigen::MatrixXd P0 = inverse(s.P0);
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(size, size);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(size);
  information.topLeftCorner(n, n) += P0;
  right.head(n) += P0 * s.x0;
  for (Eigen::Index k = 1; k <= steps; ++k) {
    Eigen::MatrixXd D = Eigen::MatrixXd::Zero(n, size);
    D.middleCols((k - 1) * n, n) = -s.F;
    D.middleCols(k * n, n).setIdentity();
    information += D.transpose() * Q * D;
    information.block(k * n, k * n, n, n) += s.H.transpose() * R * s.H;
    right.segment(k * n, n) += s.H.transpose() * R * z.row(k - 1).transpose();
  }
  const Eigen::LLT<Eigen::MatrixXd> llt(information);
  return {llt.solve(right), llt.solve(Eigen::MatrixXd::Identity(size, size))};
}

TEST(RtsSmooth, IsTheBatchLeastSquaresSolution) {
  constexpr int kSteps = 12;
  for (const int n : {1, 4, 6, 19}) {
    SCOPED_TRACE(n);
    const auto s = n == 4 ? test::constant_velocity() : test::dense_system(n, 2, 31);
    const auto data = test::simulate(s, kSteps, 12);
    const LinearRun r = linear_filter(s.view(), {.z = data.values()}, s.x0, s.P0);
    const Smoothed smoothed = smooth(s, r);
    EXPECT_EQ(smoothed.singular, 0);
    const Batch batch = batch_solution(s, data.z);
    for (int k = 0; k < kSteps; ++k) {
      const Eigen::MatrixXd P = batch.P.block((k + 1) * n, (k + 1) * n, n, n);
      EXPECT_LT((vector_at(smoothed.x, k, n) - batch.x.segment((k + 1) * n, n)).norm(), 1e-9 * (1.0 + batch.x.norm()));
      EXPECT_LT((matrix_at(smoothed.P, k, n, n) - P).norm(), 1e-9 * P.norm());
    }
  }
}

TEST(RtsSmooth, KnowsNoLessThanTheFilter) {
  constexpr int kSteps = 120;
  const auto s = test::fourteen_states();
  const auto data = test::simulate(s, kSteps, 2);
  const LinearRun r = linear_filter(s.view(), {.z = data.values()}, s.x0, s.P0);
  const Smoothed smoothed = smooth(s, r);
  EXPECT_EQ(vector_at(smoothed.x, kSteps - 1, 14), vector_at(r.x, kSteps - 1, 14));
  EXPECT_EQ(matrix_at(smoothed.P, kSteps - 1, 14, 14), matrix_at(r.P, kSteps - 1, 14, 14));
  for (int k = 0; k < kSteps; ++k) {
    const Eigen::MatrixXd filtered = matrix_at(r.P, k, 14, 14);
    const Eigen::MatrixXd P = matrix_at(smoothed.P, k, 14, 14);
    EXPECT_EQ(P, P.transpose());
    // No eigenvalue of what was gained below -1e-12 of the filter's.
    Eigen::MatrixXd gained = filtered - P;
    for (int i = 0; i < 14; ++i) gained(i, i) += 1e-12 * filtered.norm();
    EXPECT_EQ(gained.llt().info(), Eigen::Success) << k;
    if (k < kSteps - 1) {
      EXPECT_LT(P.trace(), filtered.trace()) << k;
    }
  }
}

TEST(RtsSmooth, TransitionLeadsIntoItsStep) {
  // x_1 = 2 x_0 and x_2 = -3 x_1 without noise: what the last step knows, the others know.
  const std::vector<double> F{7.0, 2.0, -3.0};
  const std::vector<double> Q{0.0, 0.0, 0.0};
  const std::vector<double> H{0.0, 0.0, 1.0};
  const std::vector<double> R{1.0, 1.0, 1.0};
  const std::vector<double> z{0.0, 0.0, 6.0};
  const LinearSystem s{{F, 1, 1, 3}, {Q, 1, 1, 3}, {H, 1, 1, 3}, {R, 1, 1, 3}};
  const LinearRun r = linear_filter(s, {.z = z}, Eigen::VectorXd::Zero(1), Eigen::MatrixXd::Constant(1, 1, 1e2));
  std::vector<double> x(3);
  std::vector<double> P(3);
  EXPECT_EQ(rts_smooth(s.F, r.x_pred, r.P_pred, r.x, r.P, x, P), 0);
  EXPECT_NEAR(x[2], 6.0, 1e-4);
  EXPECT_NEAR(x[1], x[2] / -3.0, 1e-12);
  EXPECT_NEAR(x[0], x[1] / 2.0, 1e-12);
  EXPECT_NEAR(P[0], P[2] / 36.0, 1e-11);
}

// A component known exactly has no variance: P_pred is singular, and that component stays as the filter has it, while
// the others are smoothed as if it were not there.
TEST(RtsSmooth, LeavesWhatIsKnownExactly) {
  constexpr int kSteps = 15;
  const auto inner = test::constant_velocity();
  DenseSystem s = inner;
  for (RowMajorMatrix* M : {&s.F, &s.Q, &s.P0}) {
    const RowMajorMatrix small = *M;
    *M = RowMajorMatrix::Zero(6, 6);
    M->topLeftCorner(4, 4) = small;
  }
  s.F(4, 4) = s.F(5, 5) = 1.0;
  s.H = RowMajorMatrix::Zero(2, 6);
  s.H.leftCols(4) = inner.H;
  s.x0 = Eigen::VectorXd::Zero(6);
  s.x0.head(4) = inner.x0;
  s.x0[4] = 17.0;
  s.x0[5] = -2.0;
  const auto data = test::simulate(inner, kSteps, 3);
  const LinearRun r = linear_filter(s.view(), {.z = data.values()}, s.x0, s.P0);
  const Smoothed smoothed = smooth(s, r);
  const LinearRun r4 = linear_filter(inner.view(), {.z = data.values()}, inner.x0, inner.P0);
  const Smoothed smoothed4 = smooth(inner, r4);
  EXPECT_EQ(smoothed.singular, kSteps - 1);
  EXPECT_EQ(smoothed4.singular, 0);
  for (int k = 0; k < kSteps; ++k) {
    EXPECT_EQ(vector_at(smoothed.x, k, 6)[4], 17.0);
    EXPECT_EQ(vector_at(smoothed.x, k, 6)[5], -2.0);
    EXPECT_LT((vector_at(smoothed.x, k, 6).head(4) - vector_at(smoothed4.x, k, 4)).norm(), 1e-11);
    EXPECT_LT((matrix_at(smoothed.P, k, 6, 6).topLeftCorner(4, 4) - matrix_at(smoothed4.P, k, 4, 4)).norm(), 1e-11);
    EXPECT_EQ(matrix_at(smoothed.P, k, 6, 6).rightCols(2).norm(), 0.0);
  }
}

// Two components that are one and the same: singular without a zero on the diagonal.
TEST(RtsSmooth, TwinsStayTwins) {
  constexpr int kSteps = 10;
  DenseSystem one;
  const auto constant = [](double v, int n) { return RowMajorMatrix(RowMajorMatrix::Constant(n, n, v)); };
  one.F = constant(1.0, 1);
  one.Q = constant(0.5, 1);
  one.H = constant(1.0, 1);
  one.R = constant(2.0, 1);
  one.P0 = constant(4.0, 1);
  one.x0 = Eigen::VectorXd::Zero(1);
  DenseSystem two = one;
  two.F = RowMajorMatrix::Identity(2, 2);
  two.Q = constant(0.5, 2);
  two.P0 = constant(4.0, 2);
  two.H = RowMajorMatrix::Zero(1, 2);
  two.H(0, 0) = 1.0;
  two.x0 = Eigen::VectorXd::Zero(2);
  const auto data = test::simulate(one, kSteps, 3);
  const LinearRun r1 = linear_filter(one.view(), {.z = data.values()}, one.x0, one.P0);
  const LinearRun r2 = linear_filter(two.view(), {.z = data.values()}, two.x0, two.P0);
  const Smoothed s1 = smooth(one, r1);
  const Smoothed s2 = smooth(two, r2);
  EXPECT_EQ(s2.singular, kSteps - 1);
  for (int k = 0; k < kSteps; ++k) {
    EXPECT_NEAR(vector_at(s2.x, k, 2)[0], s1.x[static_cast<std::size_t>(k)], 1e-12);
    EXPECT_NEAR(vector_at(s2.x, k, 2)[1], s1.x[static_cast<std::size_t>(k)], 1e-12);
    EXPECT_LT((matrix_at(s2.P, k, 2, 2).array() - s1.P[static_cast<std::size_t>(k)]).abs().maxCoeff(), 1e-12);
  }
}

TEST(RtsSmooth, RefusalsNameTheParameter) {
  const auto s = test::constant_velocity();
  const auto data = test::simulate(s, 4, 5);
  const LinearRun r = linear_filter(s.view(), {.z = data.values()}, s.x0, s.P0);
  std::vector<double> x_pred(r.x_pred.begin(), r.x_pred.end());
  std::vector<double> P_pred(r.P_pred.begin(), r.P_pred.end());
  std::vector<double> x(r.x.begin(), r.x.end());
  std::vector<double> P(r.P.begin(), r.P.end());
  std::vector<double> x_out(x.size());
  std::vector<double> P_out(P.size());
  const auto refusal = [&](std::span<const double> given) -> std::string {
    try {
      rts_smooth(s.F, x_pred, given, x, P, x_out, P_out);
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "accepted";
  };
  EXPECT_EQ(refusal(P_pred), "accepted");
  EXPECT_EQ(refusal(std::span(P_pred).first(60)), "P_pred: 60 numbers, expected 4 x 16");
  std::swap(x_pred[9], x[9]);
  EXPECT_EQ(refusal(P_pred), "accepted");
  const auto spoiled = [&](double& value, double by) {
    const double before = value;
    value = by;
    const std::string text = refusal(P_pred);
    value = before;
    return text;
  };
  EXPECT_EQ(spoiled(x_pred[5], kNan), "x_pred: step 1 is not finite");
  EXPECT_EQ(spoiled(P_pred[3 * 16 + 2], kNan), "P_pred: step 3 is not finite");
  EXPECT_EQ(spoiled(x[15], kNan), "x: step 3 is not finite");
  EXPECT_EQ(spoiled(P[0], kNan), "P: step 0 is not finite");
  EXPECT_EQ(spoiled(P[3 * 16 + 1], 3.0), "P: step 3 is not symmetric");
  EXPECT_EQ(spoiled(P_pred[2 * 16 + 1], 3.0), "P_pred: step 2 is not symmetric");
  EXPECT_EQ(spoiled(x_pred[0], kNan), "accepted");  // the prediction into the first step is not used
  x.pop_back();
  EXPECT_EQ(refusal(P_pred), "x: 15 numbers, no whole steps of 4");
  EXPECT_EQ(rts_smooth(s.F, {}, {}, {}, {}, {}, {}), 0);
}

// ---- Any filter over a fixed state

using Planar = PositionVelocity<PlanarFrame, 2>;  // [x y vx vy]

TEST(RtsSmoother, EqualsTheLinearOne) {
  // Two axes of constant velocity with the components as Planar has them.
  constexpr int kSteps = 25;
  const auto other = test::constant_velocity();
  const std::vector<int> order{0, 2, 1, 3};
  DenseSystem s = other;
  s.F = other.F(order, order);
  s.Q = other.Q(order, order);
  s.P0 = other.P0(order, order);
  s.H = other.H(Eigen::all, order);
  s.x0 = other.x0(order);
  const auto data = test::simulate(s, kSteps, 12);
  const LinearRun r = linear_filter(s.view(), {.z = data.values()}, s.x0, s.P0);
  const Smoothed linear = smooth(s, r);
  RtsSmoother<Planar> smoother(kSteps);
  for (int k = 0; k < kSteps; ++k) {
    StepRecord<Planar> record;
    record.predicted.x = vector_at(r.x_pred, k, 4);
    record.P_pred = matrix_at(r.P_pred, k, 4, 4);
    record.filtered.x = vector_at(r.x, k, 4);
    record.P = matrix_at(r.P, k, 4, 4);
    if (k > 0) {
      record.cross = matrix_at(r.P, k - 1, 4, 4) * s.F.transpose();
    } else {
      record.cross.setConstant(kNan);  // not used
    }
    ASSERT_EQ(smoother.record(record), SmoothStatus::kDone);
  }
  ASSERT_EQ(smoother.smooth(), SmoothStatus::kDone);
  EXPECT_EQ(smoother.singular_steps(), 0);
  ASSERT_EQ(smoother.smoothed().size(), static_cast<std::size_t>(kSteps));
  for (int k = 0; k < kSteps; ++k) {
    const auto& step = smoother.smoothed()[static_cast<std::size_t>(k)];
    EXPECT_LT((step.state.x - vector_at(linear.x, k, 4)).norm(), 1e-12);
    EXPECT_LT((step.P - matrix_at(linear.P, k, 4, 4)).norm(), 1e-12);
    EXPECT_EQ(step.P, step.P.transpose());
  }
}

using Heading = ComposedState<PlanarFrame, Role<1, HeadingTag>>;

template <class State>
StepRecord<State> noted(const State& predicted, const State& filtered, double P_pred, double P, double P_before) {
  using Covariance = typename StepRecord<State>::Covariance;
  return {predicted, P_pred * Covariance::Identity(), filtered, P * Covariance::Identity(),
          P_before * Covariance::Identity()};
}

// A heading that walks across the cut is smoothed as the same walk elsewhere.
TEST(RtsSmoother, HeadingsGoTheShortWayRound) {
  const std::vector<double> z{0.02, 0.11, 0.07, 0.16, 0.12, 0.21};
  const auto smoothed_about = [&](double centre) {
    RtsSmoother<Heading> smoother(static_cast<int>(z.size()));
    Heading filtered;
    filtered.x[0] = wrap_to_pi(centre);
    double P = 0.01;
    for (const double value : z) {
      const Heading predicted = filtered;
      const double before = P;
      const double P_pred = P + 0.002;
      const double K = P_pred / (P_pred + 0.004);
      Heading measured;
      measured.x[0] = wrap_to_pi(centre + value);
      filtered = predicted.retract(K * predicted.local(measured));
      P = (1.0 - K) * P_pred;
      EXPECT_EQ(smoother.record(noted(predicted, filtered, P_pred, P, before)), SmoothStatus::kDone);
    }
    EXPECT_EQ(smoother.smooth(), SmoothStatus::kDone);
    std::vector<double> out;
    for (const auto& step : smoother.smoothed()) {
      EXPECT_GE(step.state.x[0], -kPi);
      EXPECT_LT(step.state.x[0], kPi);
      out.push_back(wrap_to_pi(step.state.x[0] - centre));
    }
    return out;
  };
  const auto plain = smoothed_about(0.0);
  const auto cut = smoothed_about(kPi - 0.1);
  EXPECT_GT(plain.back() - plain.front(), 0.05);
  for (std::size_t i = 0; i < plain.size(); ++i) EXPECT_NEAR(cut[i], plain[i], 1e-14);
}

using Attitude = ComposedState<NedFrame, Role<3, AttitudeTag>>;

// Rotations about one axis are a heading; wherever they start, and quaternions stay unit.
TEST(RtsSmoother, AttitudesAboutOneAxisAreHeadings) {
  const std::vector<double> z{0.3, 0.5, 0.2, 0.9, 0.6};
  const Eigen::Vector3d axis = Eigen::Vector3d(1.0, -2.0, 0.5).normalized();
  Attitude start;
  start = start.retract(Eigen::Vector3d(2.0, 1.0, -1.5));
  RtsSmoother<Heading> headings(5);
  RtsSmoother<Attitude> attitudes(5);
  Heading heading;
  Attitude attitude = start;
  double P = 0.02;
  for (const double value : z) {
    const Heading heading_before = heading;
    const Attitude attitude_before = attitude;
    const double before = P;
    const double P_pred = P + 0.003;
    const double K = P_pred / (P_pred + 0.01);
    const double step = K * (value - heading.x[0]);
    heading = heading.retract(Eigen::Matrix<double, 1, 1>(step));
    attitude = attitude.retract(step * axis);
    P = (1.0 - K) * P_pred;
    ASSERT_EQ(headings.record(noted(heading_before, heading, P_pred, P, before)), SmoothStatus::kDone);
    ASSERT_EQ(attitudes.record(noted(attitude_before, attitude, P_pred, P, before)), SmoothStatus::kDone);
  }
  ASSERT_EQ(headings.smooth(), SmoothStatus::kDone);
  ASSERT_EQ(attitudes.smooth(), SmoothStatus::kDone);
  for (std::size_t k = 0; k < z.size(); ++k) {
    const Eigen::Vector3d turn = start.local(attitudes.smoothed()[k].state);
    EXPECT_LT((turn - headings.smoothed()[k].state.x[0] * axis).norm(), 1e-13);
    EXPECT_NEAR(attitudes.smoothed()[k].state.x.norm(), 1.0, 1e-15);
    EXPECT_NEAR(attitudes.smoothed()[k].P(0, 0), headings.smoothed()[k].P(0, 0), 1e-15);
  }
}

TEST(RtsSmoother, SingularPredictionLeavesTheState) {
  RtsSmoother<Heading> smoother(2);
  Heading a;
  a.x[0] = 0.5;
  ASSERT_EQ(smoother.record(noted(a, a, 0.0, 0.0, 0.0)), SmoothStatus::kDone);
  ASSERT_EQ(smoother.record(noted(a, a, 0.0, 0.0, 0.0)), SmoothStatus::kDone);
  ASSERT_EQ(smoother.smooth(), SmoothStatus::kDone);
  EXPECT_EQ(smoother.singular_steps(), 1);
  EXPECT_EQ(smoother.smoothed()[0].state.x[0], 0.5);
  EXPECT_EQ(smoother.smoothed()[0].P(0, 0), 0.0);
}

TEST(RtsSmoother, RefusesWhatDoesNotFit) {
  EXPECT_THROW(RtsSmoother<Heading>(0), std::invalid_argument);
  RtsSmoother<Heading> smoother(2);
  EXPECT_EQ(smoother.smooth(), SmoothStatus::kDone);
  EXPECT_TRUE(smoother.smoothed().empty());
  const Heading a;
  const auto good = noted(a, a, 0.2, 0.1, 0.1);
  auto bad = good;
  bad.P(0, 0) = kNan;
  EXPECT_EQ(smoother.record(bad), SmoothStatus::kNonFinite);
  EXPECT_EQ(smoother.size(), 0);
  EXPECT_EQ(smoother.record(good), SmoothStatus::kDone);
  bad = good;
  bad.cross(0, 0) = std::numeric_limits<double>::infinity();
  EXPECT_EQ(smoother.record(bad), SmoothStatus::kNonFinite);
  EXPECT_EQ(smoother.record(good), SmoothStatus::kDone);
  EXPECT_EQ(smoother.record(good), SmoothStatus::kFull);
  EXPECT_EQ(smoother.size(), 2);
  EXPECT_EQ(smoother.capacity(), 2);
  EXPECT_EQ(smoother.records().size(), 2U);
  EXPECT_EQ(smoother.smooth(), SmoothStatus::kDone);
  EXPECT_EQ(smoother.smoothed().size(), 2U);
  smoother.clear();
  EXPECT_EQ(smoother.size(), 0);
  EXPECT_TRUE(smoother.smoothed().empty());

  // Finite records whose smoothed covariance overflows.
  ASSERT_EQ(smoother.record(noted(a, a, 1.0, 1e300, 1.0)), SmoothStatus::kDone);
  ASSERT_EQ(smoother.record(noted(a, a, 1e-300, 1e300, 1e100)), SmoothStatus::kDone);
  EXPECT_EQ(smoother.smooth(), SmoothStatus::kNonFinite);
  EXPECT_TRUE(smoother.smoothed().empty());
}

TEST(SmoothStatus, HasAPhrase) {
  EXPECT_EQ(to_string(SmoothStatus::kDone), "done");
  EXPECT_EQ(to_string(SmoothStatus::kFull), "full");
  EXPECT_EQ(to_string(SmoothStatus::kNonFinite), "not finite");
  EXPECT_EQ(to_string(static_cast<SmoothStatus>(99)), "unknown");
}

}  // namespace
}  // namespace soopnav
