#include "soopnav/estimation/fisher_information.hpp"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/estimation/unobservable.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "soopnav/measurement/range.hpp"
#include "support/nan.hpp"

namespace soopnav {
namespace {

using State = PositionClock<EnuFrame>;
using Pr = Pseudorange<EnuFrame>;
using Eigen::MatrixXd;
using Eigen::VectorXd;

using ::soopnav::test::kNan;
const std::vector<Eigen::Vector3d> kSources{
    {1000, 0, 50}, {-300, 900, 20}, {-800, -700, 90}, {200, -900, 400}, {50, 60, 1500}};

State here() {
  State x;
  x.x << 100, -50, 20, 1234;
  return x;
}

MatrixXd rows_at(const State& x) {
  MatrixXd H(5, 4);
  for (int i = 0; i < 5; ++i) {
    H.row(i).head<3>() = (x.x.head<3>() - kSources[static_cast<std::size_t>(i)]).normalized().transpose();
    H(i, 3) = 1.0;
  }
  return H;
}

std::vector<Pr> models() {
  std::vector<Pr> all;
  for (const auto& q : kSources) all.push_back(Pr{q});
  return all;
}

MatrixXd random_matrix(std::uint64_t seed, Eigen::Index rows, Eigen::Index columns) {
  RandomStream stream(seed, 7);
  return MatrixXd::NullaryExpr(rows, columns, [&] { return stream.normal(); });
}

TEST(InformationSum, AddsUpWhatEachMeasurementKnows) {
  InformationSum<State> sum;
  MatrixXd expected = MatrixXd::Zero(4, 4);
  const MatrixXd H = rows_at(here());
  for (int i = 0; i < 5; ++i) {
    const double variance = 1.0 + i;
    const Observed<Pr> one(Pr{kSources[static_cast<std::size_t>(i)]}, 0.0, variance);
    ASSERT_EQ(sum.add(here(), one), SolveStatus::kConverged);
    expected += H.row(i).transpose() * H.row(i) / variance;
    EXPECT_LT((sum.information() - expected).norm(), 1e-12 * expected.norm());
    EXPECT_EQ(sum.bound().rank, std::min(i + 1, 4));
  }
  const auto bound = sum.bound();
  const MatrixXd inverse = expected.fullPivLu().solve(MatrixXd::Identity(4, 4));
  EXPECT_LT((bound.covariance - inverse).norm(), 1e-9 * inverse.norm());
  EXPECT_LT((bound.sigma - inverse.diagonal().cwiseSqrt()).norm(), 1e-9 * bound.sigma.norm());
  EXPECT_EQ(bound.unobservable.cols(), 0);
}

TEST(InformationSum, OfTwoHalvesIsTheSumAndGroupsMayShareACovariance) {
  const auto all = models();
  const VectorXd z = VectorXd::Zero(5);
  MatrixXd R = MatrixXd::Constant(5, 5, 0.5);
  R.diagonal().setConstant(2.0);
  InformationSum<State> whole;
  ASSERT_EQ(whole.add(here(), Correlated<Pr>{all, z, R}), SolveStatus::kConverged);
  const MatrixXd H = rows_at(here());
  const MatrixXd expected = H.transpose() * R.fullPivLu().solve(H);
  EXPECT_LT((whole.information() - expected).norm(), 1e-12 * expected.norm());

  InformationSum<State> twice = whole;
  twice += whole;
  EXPECT_LT((twice.information() - 2.0 * expected).norm(), 1e-12 * expected.norm());
  InformationSum<State> by_rows;
  const Eigen::Matrix<double, 4, 4> root = whole.root();
  ASSERT_TRUE(by_rows.add_whitened(root));
  EXPECT_LT((by_rows.information() - expected).norm(), 1e-12 * expected.norm());
}

TEST(InformationSum, WithUnitVariancesGivesTheDilutionOfPrecision) {
  InformationSum<State> sum;
  std::vector<Observed<Pr>> z;
  for (const auto& m : models()) z.emplace_back(m, 0.0, 1.0);
  ASSERT_EQ(sum.add(here(), z), SolveStatus::kConverged);
  State start = here();
  std::vector<Observed<Pr>> exact;
  for (const auto& q : kSources) exact.emplace_back(Pr{q}, (here().x.head<3>() - q).norm() + 1234.0, 25.0);
  const auto fix = solve(start, {}, exact);
  const Dop dop = dilution_of_precision<State>(sum.bound().covariance);
  EXPECT_NEAR(dop.gdop, fix.dop.gdop, 1e-9 * dop.gdop);
  EXPECT_NEAR(dop.hdop, fix.dop.hdop, 1e-9 * dop.gdop);
  EXPECT_NEAR(dop.vdop, fix.dop.vdop, 1e-9 * dop.gdop);
}

TEST(InformationSum, RefusesWithoutAChange) {
  InformationSum<State> sum;
  ASSERT_EQ(sum.add(here(), Observed<Pr>(Pr{kSources[0]}, 0.0, 1.0)), SolveStatus::kConverged);
  const auto before = sum.root();
  State on_top = here();
  on_top.x.head<3>() = kSources[1];
  EXPECT_EQ(sum.add(on_top, Observed<Pr>(Pr{kSources[1]}, 0.0, 1.0)), SolveStatus::kUndefined);
  EXPECT_EQ(sum.add(here(), Observed<Pr>(Pr{kSources[1]}, 0.0, 0.0)), SolveStatus::kNotPositiveDefinite);
  EXPECT_EQ(sum.add(here(), Observed<Pr>(Pr{kSources[1]}, 0.0, kNan)), SolveStatus::kNonFinite);
  EXPECT_EQ(sum.add(here(), Observed<Pr>(Pr{kSources[1]}, kNan, 1.0)), SolveStatus::kNonFinite);
  const std::vector<Observed<Pr>> many(40, Observed<Pr>(Pr{kSources[1]}, 0.0, 1.0));
  EXPECT_EQ(sum.add(here(), many), SolveStatus::kTooManyMeasurements);
  EXPECT_FALSE(sum.add_whitened(Eigen::RowVector4d(1.0, kNan, 0.0, 0.0)));
  EXPECT_EQ(sum.root(), before);
  EXPECT_THROW(InformationSum<State>(Eigen::Matrix4d::Constant(kNan)), std::invalid_argument);
  EXPECT_THROW(InformationSum<State>(Eigen::Matrix4d(-Eigen::Matrix4d::Identity())), std::invalid_argument);
}

TEST(InformationSum, OneNodeHasRankOneAndNamesWhatItCannotSee) {
  // nielsen §3.4.3: the information of one node about (x, y, z, b) has rank one.
  InformationSum<State> sum;
  ASSERT_EQ(sum.add(here(), Observed<Pr>(Pr{kSources[0]}, 0.0, 4.0)), SolveStatus::kConverged);
  const auto bound = sum.bound();
  EXPECT_EQ(bound.rank, 1);
  EXPECT_EQ(bound.unobservable.cols(), 3);
  const MatrixXd seen = sum.information() * MatrixXd(bound.unobservable);
  EXPECT_LT(seen.norm(), 1e-14);
  const MatrixXd basis = bound.unobservable;
  const Eigen::Matrix3d gram = basis.transpose() * basis;
  EXPECT_LT((gram - Eigen::Matrix3d::Identity()).norm(), 1e-13);
  for (int i = 0; i < 4; ++i) EXPECT_TRUE(std::isinf(bound.sigma[i]));
}

TEST(InformationSum, WhatIsDeterminedStaysFiniteBesideWhatIsNot) {
  // A range from a source far away on the x axis says x and nothing else; a prior says the clock.
  Eigen::Matrix4d prior = Eigen::Matrix4d::Zero();
  prior(3, 3) = 1.0 / 9.0;
  InformationSum<State> sum(prior);
  State x;
  x.x << 0, 0, 0, 0;
  ASSERT_EQ(sum.add(x, Observed<Range<EnuFrame>>(Range<EnuFrame>{{1000, 0, 0}}, 1000.0, 4.0)), SolveStatus::kConverged);
  const auto bound = sum.bound();
  EXPECT_EQ(bound.rank, 2);
  EXPECT_NEAR(bound.sigma[0], 2.0, 1e-12);
  EXPECT_NEAR(bound.sigma[3], 3.0, 1e-12);
  EXPECT_NEAR(bound.covariance(0, 3), 0.0, 1e-12);
  EXPECT_TRUE(std::isinf(bound.sigma[1]) && std::isinf(bound.sigma[2]));
  EXPECT_TRUE(std::isnan(bound.covariance(0, 1)));
  const auto names = name_directions<State>(MatrixXd(bound.unobservable));
  EXPECT_EQ(names, (std::vector<std::string>{"north", "up"}));
}

TEST(InformationSum, MarginalInformationIsTheInverseOfTheBoundsBlock) {
  InformationSum<State> sum;
  std::vector<Observed<Pr>> z;
  for (const auto& m : models()) z.emplace_back(m, 0.0, 3.0);
  ASSERT_EQ(sum.add(here(), z), SolveStatus::kConverged);
  const auto bound = sum.bound();
  const Eigen::Matrix3d position = sum.marginal(kPosition);
  const Eigen::Matrix3d block = bound.covariance.topLeftCorner<3, 3>();
  EXPECT_LT((position * block - Eigen::Matrix3d::Identity()).norm(), 1e-9);
  const Eigen::Matrix<double, 1, 1> clock = sum.marginal(kClockBias);
  EXPECT_NEAR(clock(0, 0) * bound.covariance(3, 3), 1.0, 1e-9);
  // Knowing the clock never hurts: the marginal is below the block of the whole (eigenvalues of the difference >= 0).
  const Eigen::Matrix3d gain = sum.information().topLeftCorner<3, 3>() - position;
  EXPECT_GT(gain.selfadjointView<Eigen::Lower>().eigenvalues().minCoeff(), -1e-12);
}

TEST(MarginalInformation, OfASingularNuisanceBlockUsesItsPseudoInverse) {
  // Two nuisance columns that are equal, and one wanted: only what lies off them counts.
  Eigen::Matrix3d rows;
  rows << 1, 1, 1,  //
      0, 0, 2,      //
      0, 0, 3;
  const std::vector<int> kept{2};
  EXPECT_NEAR((marginal_information<1, 3>(rows, kept)(0, 0)), 13.0, 1e-12);
  EXPECT_NEAR((marginal_information<Eigen::Dynamic, Eigen::Dynamic>(MatrixXd(rows), kept)(0, 0)), 13.0, 1e-12);
  const std::vector<int> outside{3};
  const std::vector<int> twice{1, 1};
  EXPECT_THROW(static_cast<void>(marginal_information<1, 3>(rows, outside)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(marginal_information<2, 3>(rows, twice)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(marginal_information<1, 3>(rows, twice)), std::invalid_argument);
}

TEST(MarginalInformation, OfEverythingIsTheWholeAndOfNothingIsEmpty) {
  const MatrixXd H = random_matrix(3, 9, 4);
  const Eigen::Matrix4d root = root_of_rows(H, VectorXd::Ones(9));
  const std::vector<int> all{0, 1, 2, 3};
  const Eigen::Matrix4d whole = marginal_information<4, 4>(root, all);
  EXPECT_LT((whole - H.transpose() * H).norm(), 1e-12 * whole.norm());
  EXPECT_EQ((marginal_information<Eigen::Dynamic, 4>(root, std::vector<int>{}).size()), 0);
}

TEST(CramerRao, EqualsTheInverseForAnyFullCovariance) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const MatrixXd H = random_matrix(seed, 11, 5);
    const MatrixXd A = random_matrix(seed + 100, 11, 11);
    const MatrixXd R = A * A.transpose() + MatrixXd::Identity(11, 11);
    const auto bound = cramer_rao_bound(H, R);
    const MatrixXd J = H.transpose() * R.fullPivLu().solve(H);
    EXPECT_EQ(bound.rank, 5);
    EXPECT_LT((bound.covariance * J - MatrixXd::Identity(5, 5)).norm(), 1e-9);
    const MatrixXd root = root_of_rows(H, R);
    EXPECT_LT((root.transpose() * root - J).norm(), 1e-11 * J.norm());
    EXPECT_EQ(MatrixXd(root.triangularView<Eigen::StrictlyLower>()).norm(), 0.0);
  }
}

TEST(CramerRao, TakesABlockOfRThatRepeats) {
  const MatrixXd H = random_matrix(4, 6, 3);
  MatrixXd block(2, 2);
  block << 2.0, 0.8, 0.8, 1.0;
  MatrixXd whole = MatrixXd::Zero(6, 6);
  for (int i = 0; i < 6; i += 2) whole.block(i, i, 2, 2) = block;
  const auto a = cramer_rao_bound(H, whole);
  const auto b = cramer_rao_bound(H, block);
  EXPECT_LT((a.covariance - b.covariance).norm(), 1e-12 * a.covariance.norm());
  const auto c = cramer_rao_bound(H, MatrixXd::Constant(1, 1, 4.0));
  const auto d = cramer_rao_bound(H, VectorXd::Constant(6, 4.0));
  EXPECT_LT((c.covariance - d.covariance).norm(), 1e-12 * c.covariance.norm());
  EXPECT_THROW(static_cast<void>(cramer_rao_bound(H, MatrixXd::Identity(4, 4))), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(cramer_rao_bound(H, MatrixXd(0, 0))), std::invalid_argument);
}

TEST(CramerRao, DoesNotDependOnTheUnitsOfTheParameters) {
  // Metres and seconds: a factor of the speed of light between columns changes neither rank nor the bound.
  const MatrixXd H = random_matrix(5, 8, 4);
  const Eigen::Vector4d unit(1.0, 3e8, 1e-3, 1.0);
  const MatrixXd scaled = H * unit.asDiagonal();
  const VectorXd variances = VectorXd::Constant(8, 2.0);
  const auto a = cramer_rao_bound(H, variances);
  const auto b = cramer_rao_bound(scaled, variances);
  EXPECT_EQ(a.rank, 4);
  EXPECT_EQ(b.rank, 4);
  const MatrixXd back = unit.asDiagonal() * b.covariance * unit.asDiagonal();
  EXPECT_LT((back - a.covariance).norm(), 1e-9 * a.covariance.norm());
  EXPECT_LT((a.singular_values - b.singular_values).norm(), 1e-12);
}

TEST(CramerRao, PriorInformationFillsWhatTheRowsLeaveFree) {
  MatrixXd H(1, 2);
  H << 1.0, 1.0;
  const MatrixXd R = MatrixXd::Constant(1, 1, 4.0);
  const auto alone = cramer_rao_bound(H, R);
  EXPECT_EQ(alone.rank, 1);
  EXPECT_TRUE(std::isinf(alone.sigma[0]) && std::isinf(alone.sigma[1]));
  MatrixXd prior = MatrixXd::Zero(2, 2);
  prior(1, 1) = 1.0 / 9.0;
  const auto both = cramer_rao_bound(H, R, prior);
  EXPECT_EQ(both.rank, 2);
  EXPECT_NEAR(both.covariance(0, 0), 13.0, 1e-11);
  EXPECT_NEAR(both.covariance(0, 1), -9.0, 1e-11);
  EXPECT_NEAR(both.covariance(1, 1), 9.0, 1e-11);
}

TEST(CramerRao, WithoutRowsOrWithZeroColumnsKnowsNothing) {
  const auto none = cramer_rao_bound(MatrixXd(0, 3), MatrixXd(0, 0));
  EXPECT_EQ(none.rank, 0);
  EXPECT_EQ(none.unobservable.cols(), 3);
  EXPECT_TRUE((none.sigma.array() == std::numeric_limits<double>::infinity()).all());
  MatrixXd H = MatrixXd::Zero(3, 2);
  H.col(0).setOnes();
  const auto half = cramer_rao_bound(H, VectorXd::Ones(3));
  EXPECT_EQ(half.rank, 1);
  EXPECT_NEAR(half.sigma[0], std::sqrt(1.0 / 3.0), 1e-14);
  EXPECT_TRUE(std::isinf(half.sigma[1]));
}

TEST(CramerRao, RefusesWithTheNameOfTheArgument) {
  const auto message = [](const MatrixXd& H, const MatrixXd& R, const MatrixXd& prior = {}, double tolerance = 1e-7) {
    try {
      static_cast<void>(cramer_rao_bound(H, R, prior, tolerance));
    } catch (const std::invalid_argument& error) {
      return std::string(error.what());
    }
    return std::string("not refused");
  };
  const MatrixXd H = random_matrix(9, 3, 2);
  const MatrixXd I = MatrixXd::Identity(3, 3);
  MatrixXd skew = I;
  skew(0, 1) = 0.5;
  MatrixXd bad = H;
  bad(1, 1) = kNan;
  EXPECT_EQ(message(MatrixXd(3, 0), I).substr(0, 2), "H:");
  EXPECT_EQ(message(bad, I), "H: it holds NaN or infinity");
  EXPECT_EQ(message(H, MatrixXd::Identity(2, 2)),
            "R: shape (2, 2); (3, 3), a block of it that repeats, or (3, 1) expected, for the 3 rows of H");
  EXPECT_EQ(message(H, Eigen::Vector3d(1, 0, 1)), "R: variance 1 is 0; it must be positive");
  EXPECT_EQ(message(H, Eigen::Vector3d(1, kNan, 1)), "R: it holds NaN or infinity");
  EXPECT_EQ(message(H, skew), "R: it must be symmetric");
  EXPECT_EQ(message(H, -I), "R: it must be positive definite");
  EXPECT_EQ(message(H, I, MatrixXd::Identity(3, 3)).substr(0, 17), "prior_information");
  EXPECT_EQ(message(H, I, -MatrixXd::Identity(2, 2)),
            "prior_information: it must be finite, symmetric and positive semidefinite");
  EXPECT_EQ(message(H, I, {}, 0.0), "tolerance: 0; it must lie between 0 and 1");
  EXPECT_EQ(message(H, I), "not refused");
}

TEST(CramerRao, SeesADirectionThatTheInformationMatrixLoses) {
  // Two columns that differ by 1e-6: HᵀH has a condition of 1e12 or more, and the bound needs its small eigenvalue.
  MatrixXd H(3, 2);
  H << 1, 1 + 1e-6, 1, 1, 1, 1;
  const auto bound = cramer_rao_bound(H, VectorXd::Ones(3));
  EXPECT_EQ(bound.rank, 2);
  // By hand: the part of the second column at right angles to the first has squared length (1e-6)² 2/3.
  EXPECT_NEAR(bound.covariance(1, 1) * 1e-12 * 2.0 / 3.0, 1.0, 1e-8);
  EXPECT_EQ(bound_of_root<2>(Eigen::Matrix2d::Constant(kNan)).rank, 0);
}

TEST(InformationRoot, SquaresBackAndRefuses) {
  const Eigen::Matrix4d A = random_matrix(2, 4, 4);
  const Eigen::Matrix4d J = A.transpose() * A;
  const auto root = information_root<4>(J);
  ASSERT_TRUE(root);
  EXPECT_LT((root->transpose() * *root - J).norm(), 1e-12 * J.norm());
  Eigen::Matrix4d singular = J;
  singular.row(2).setZero();
  singular.col(2).setZero();
  const auto partial = information_root<4>(singular);
  ASSERT_TRUE(partial);
  EXPECT_LT((partial->transpose() * *partial - singular).norm(), 1e-12 * J.norm());
  Eigen::Matrix4d skew = J;
  skew(0, 1) += 1.0;
  EXPECT_FALSE(information_root<4>(skew));
  EXPECT_FALSE(information_root<4>(Eigen::Matrix4d(-J)));
  EXPECT_FALSE(information_root<4>(Eigen::Matrix4d::Constant(kNan)));
  EXPECT_FALSE(information_root<Eigen::Dynamic>(MatrixXd(2, 3)));
}

}  // namespace
}  // namespace soopnav
