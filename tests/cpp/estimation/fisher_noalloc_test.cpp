#include <gtest/gtest.h>

#include <vector>

#include "estimation/allocation_count.hpp"
#include "soopnav/estimation/observability.hpp"
#include "soopnav/estimation/posterior_crlb.hpp"
#include "soopnav/estimation/statistics.hpp"
#include "soopnav/measurement/pseudorange.hpp"

namespace soopnav {
namespace {

using State = PositionClock<EnuFrame>;
using Pr = Pseudorange<EnuFrame>;

TEST(FisherNoAllocation, FixedSizesNeedNoHeap) {
  if (SOOPNAV_COUNTS_ALLOCATIONS == 0) GTEST_SKIP() << "this allocator cannot be counted";
  const auto allocations_of = [](auto&& f) {
    const long before = test::allocations.load();
    f();
    return test::allocations.load() - before;
  };
  ASSERT_GE(allocations_of([] {
              std::vector<double> v(10);
              ASSERT_EQ(v.size(), 10U);
            }),
            1)
      << "the counter counts nothing";

  std::vector<Pr> models;
  std::vector<Observed<Pr>> z;
  for (int i = 0; i < 20; ++i) {
    const Eigen::Vector3d q(1000.0 * (i % 7 - 3), 900.0 * (i % 5 - 2), 50.0 * i + 10.0);
    models.push_back(Pr{q});
    z.emplace_back(Pr{q}, 0.0, 4.0);
  }
  const Eigen::VectorXd values = Eigen::VectorXd::Zero(20);
  const Eigen::MatrixXd R = Eigen::MatrixXd::Identity(20, 20) + Eigen::MatrixXd::Constant(20, 20, 0.5);
  const Correlated<Pr> group{models, values, R};
  const Eigen::Matrix4d F = 1.1 * Eigen::Matrix4d::Identity();
  const Eigen::Matrix<double, 4, 2> G = Eigen::Matrix<double, 4, 2>::Ones();
  const Eigen::Matrix2d R2 = Eigen::Matrix2d::Identity();
  State x;
  int good = 0;
  double sum = 0.0;
  EXPECT_EQ(allocations_of([&] {
              InformationSum<State> information(Eigen::Matrix4d::Identity());
              good += information.add(x, z) == SolveStatus::kConverged;
              good += information.add(x, z[0], group) == SolveStatus::kConverged;
              sum += information.bound().sigma.sum();
              sum += information.marginal(kPosition).trace();
              InformationSum<State> singular;
              good += singular.add(x, z[0]) == SolveStatus::kConverged;
              good += singular.bound().rank == 1;
              SequenceObservability<State> sequence;
              good += sequence.add(x, z) == SolveStatus::kConverged;
              good += sequence.propagate(F);
              sum += sequence.bound().singular_values.sum();
            }),
            0);
  EXPECT_EQ(good, 6);
  PosteriorCrlb<4> bound(Eigen::Matrix4d::Identity());
  EXPECT_EQ(allocations_of([&] {
              good += bound.predict(F, G);
              good += bound.update(G.transpose(), R2);
              good += bound.update_at(x, z) == SolveStatus::kConverged;
              good += bound.predict_expected(F, F, 5.0 * F);
              good += bound.update_expected(F);
              sum += bound.bound().sigma.sum() + coverage_bounds(0.3, 100, 1e-3).upper;
            }),
            0);
  EXPECT_EQ(good, 11);
  EXPECT_GT(sum, 0.0);
}

}  // namespace
}  // namespace soopnav
