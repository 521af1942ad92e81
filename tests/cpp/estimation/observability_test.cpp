#include "soopnav/estimation/observability.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "soopnav/estimation/unobservable.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "support/nan.hpp"

namespace soopnav {
namespace {

using Eigen::MatrixXd;
using MovingState = PositionVelocityClock<EnuFrame, 3>;
using Pr = Pseudorange<EnuFrame>;
using ::soopnav::test::kNan;

Eigen::Matrix<double, 8, 8> step(double dt) {
  Eigen::Matrix<double, 8, 8> F = Eigen::Matrix<double, 8, 8>::Identity();
  for (int i = 0; i < 3; ++i) F(i, i + 3) = dt;
  F(6, 7) = dt;
  return F;
}

TEST(SequenceObservability, TwoEpochsOfFourSourcesDetermineTheVelocityAsWell) {
  MovingState x;
  x.x << 10, 20, 5, 1, 2, 0, 100, 3;
  const std::vector<Eigen::Vector3d> sources{{900, 0, 100}, {-500, 800, 300}, {-300, -900, 700}, {100, 200, 1200}};
  std::vector<Observed<Pr>> z;
  for (const auto& q : sources) z.emplace_back(Pr{q}, 0.0, 1.0);
  SequenceObservability<MovingState> sequence;
  ASSERT_EQ(sequence.add(x, z), SolveStatus::kConverged);
  const auto first = sequence.bound();
  EXPECT_EQ(first.rank, 4);
  const auto names = name_directions<MovingState>(MatrixXd(first.unobservable));
  EXPECT_EQ(names, (std::vector<std::string>{"east velocity", "north velocity", "up velocity", "clock drift"}));
  ASSERT_TRUE(sequence.propagate(step(2.0)));
  MovingState later = x;
  later.x.head<3>() += 2.0 * x.x.segment<3>(3);
  ASSERT_EQ(sequence.add(later, z), SolveStatus::kConverged);
  EXPECT_EQ(sequence.bound().rank, 8);

  // The same by the stack of matrices.
  InformationSum<MovingState> one;
  ASSERT_EQ(one.add(x, z), SolveStatus::kConverged);
  InformationSum<MovingState> two;
  ASSERT_EQ(two.add(later, z), SolveStatus::kConverged);
  MatrixXd H(16, 8);
  H << one.root(), two.root();
  const MatrixXd stack = observability_matrix(MatrixXd(step(2.0)), H, 8, 2);
  EXPECT_LT((stack.transpose() * stack - sequence.gramian()).norm(), 1e-10 * sequence.gramian().norm());
}

TEST(SequenceObservability, RefusesWithoutAChange) {
  MovingState x;
  SequenceObservability<MovingState> sequence;
  ASSERT_EQ(sequence.add(x, Observed<Pr>(Pr{Eigen::Vector3d(900, 0, 0)}, 0.0, 1.0)), SolveStatus::kConverged);
  const auto before = sequence.gramian();
  EXPECT_EQ(sequence.add(x, Observed<Pr>(Pr{Eigen::Vector3d(0, 0, 0)}, 0.0, 1.0)), SolveStatus::kUndefined);
  EXPECT_FALSE(sequence.propagate(step(kNan)));
  EXPECT_EQ(sequence.gramian(), before);
  ASSERT_EQ(sequence.add(x, Observed<Pr>(Pr{Eigen::Vector3d(900, 0, 0)}, 0.0, 1.0)), SolveStatus::kConverged);
  EXPECT_LT((sequence.gramian() - 2.0 * before).norm(), 1e-12);
}

TEST(ObservabilityMatrix, StacksThePropagatedRows) {
  MatrixXd F(2, 2);
  F << 1, 1, 0, 1;
  const MatrixXd H = (MatrixXd(1, 2) << 1, 0).finished();
  const MatrixXd expected = (MatrixXd(3, 2) << 1, 0, 1, 1, 1, 2).finished();
  EXPECT_EQ(observability_matrix(F, H, 1, 3), expected);
  // A rate alone never tells the position, however long.
  const MatrixXd rate = (MatrixXd(1, 2) << 0, 1).finished();
  const MatrixXd stack = observability_matrix(F, rate, 1, 5);
  const auto bound = cramer_rao_bound(stack, Eigen::VectorXd::Ones(5));
  EXPECT_EQ(bound.rank, 1);
  EXPECT_EQ(std::abs(bound.unobservable(0, 0)), 1.0);
}

TEST(ObservabilityMatrix, OfAVaryingSequenceMultipliesInOrder) {
  MatrixXd F(4, 2);
  F << 1, 2, 0, 1, 3, 0, 1, 1;
  MatrixXd H(3, 2);
  H << 1, 0, 0, 1, 1, 1;
  const MatrixXd O = observability_matrix(F, H, 1, 3);
  EXPECT_EQ(O.row(0), H.row(0));
  EXPECT_EQ(O.row(1), (H.row(1) * F.topRows(2)).eval());
  EXPECT_EQ(O.row(2), (H.row(2) * F.bottomRows(2) * F.topRows(2)).eval());
}

TEST(ObservabilityMatrix, RefusesWithTheNameOfTheArgument) {
  const MatrixXd I = MatrixXd::Identity(2, 2);
  const auto message = [](const MatrixXd& F, const MatrixXd& H, Eigen::Index rows, Eigen::Index steps) {
    try {
      static_cast<void>(observability_matrix(F, H, rows, steps));
    } catch (const std::invalid_argument& error) {
      return std::string(error.what()).substr(0, 5);
    }
    return std::string("none");
  };
  EXPECT_EQ(message(I, I, 2, 4), "none");
  EXPECT_EQ(message(I, MatrixXd(2, 0), 2, 4), "H: no");
  EXPECT_EQ(message(I, I, 2, 0), "steps");
  EXPECT_EQ(message(I, I, 0, 4), "rows:");
  EXPECT_EQ(message(I, MatrixXd::Ones(3, 2), 2, 4), "H: 3 ");
  EXPECT_EQ(message(MatrixXd::Ones(4, 2), I, 2, 4), "F: 4 ");
  EXPECT_EQ(message(MatrixXd::Ones(2, 3), I, 2, 4), "F: 2 ");
  EXPECT_EQ(message(I * kNan, I, 2, 4), "F: it");
  EXPECT_EQ(message(I, I * kNan, 2, 4), "H: it");
  EXPECT_EQ(message(1e200 * I, I, 2, 4), "F: it");
}

}  // namespace
}  // namespace soopnav
