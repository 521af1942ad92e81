#include <gtest/gtest.h>

#include <vector>

#include "estimation/allocation_count.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/consistency.hpp"
#include "soopnav/estimation/error_ellipse.hpp"
#include "soopnav/estimation/least_squares.hpp"
#include "soopnav/measurement/pseudorange.hpp"

namespace soopnav {
namespace {

using State = PositionClock<EnuFrame>;
using Pr = Pseudorange<EnuFrame>;

template <class F>
long allocations_of(F&& f) {
  const long before = test::allocations.load();
  f();
  return test::allocations.load() - before;
}

class NoAllocation : public testing::Test {
 protected:
  void SetUp() override {
    if (SOOPNAV_COUNTS_ALLOCATIONS == 0) GTEST_SKIP() << "this allocator cannot be counted";
    ASSERT_GE(allocations_of([] {
                std::vector<double> v(10);
                ASSERT_EQ(v.size(), 10U);
              }),
              1)
        << "the counter counts nothing";
    for (int i = 0; i < 40; ++i) {
      const Eigen::Vector3d q(1000.0 * (i % 7 - 3), 900.0 * (i % 5 - 2), 50.0 * i);
      models_.push_back(Pr{q});
      z_.emplace_back(Pr{q}, (q - Eigen::Vector3d(120, -60, 10)).norm() + 5.0 + 0.1 * (i % 3), 4.0);
    }
  }
  std::vector<Pr> models_;
  std::vector<Observed<Pr>> z_;
};

TEST_F(NoAllocation, SolveAndFisherInformation) {
  State start;
  start.x << 1, 2, 3, 4;
  SolveStatus status = SolveStatus::kUndefined;
  EXPECT_EQ(allocations_of([&] { status = solve<64>(start, {}, z_).status; }), 0);
  EXPECT_EQ(status, SolveStatus::kConverged);
  EXPECT_EQ(allocations_of([&] { status = fisher_information<64>(start, z_).status; }), 0);
  EXPECT_EQ(status, SolveStatus::kConverged);
  const std::vector<State> starts{start, start};
  EXPECT_EQ(allocations_of([&] { status = solve_from<64>(std::span<const State>(starts), {}, 6.0, z_).best.status; }),
            0);
  EXPECT_EQ(status, SolveStatus::kConverged);
  const std::span<const Observed<Pr>> two(z_.data(), 2);
  EXPECT_EQ(allocations_of([&] { status = solve<64>(start, {}, two).status; }), 0);
  EXPECT_EQ(status, SolveStatus::kTooFewMeasurements);
}

TEST_F(NoAllocation, SolveWithAFullCovariance) {
  Eigen::VectorXd z(40);
  for (int i = 0; i < 40; ++i) z[i] = z_[static_cast<std::size_t>(i)].z[0];
  const Eigen::MatrixXd R = Eigen::MatrixXd::Identity(40, 40) + Eigen::MatrixXd::Constant(40, 40, 0.5);
  const Correlated<Pr> group{models_, z, R};
  SolveStatus status = SolveStatus::kUndefined;
  EXPECT_EQ(allocations_of([&] { status = solve<64>(State{}, {}, group).status; }), 0);
  EXPECT_EQ(status, SolveStatus::kConverged);
}

TEST_F(NoAllocation, Statistics) {
  double sum = 0.0;
  const Eigen::Matrix2d P = Eigen::Vector2d(4.0, 1.0).asDiagonal();
  EXPECT_EQ(allocations_of([&] {
              sum +=
                  chi_square_quantile(0.9, 7.0) + normal_two_sided_gate(1e-3) + mean_nees_bounds(2.0, 50, 1e-4).upper;
              sum += circular_error_m(P).value_or(0.0) + error_ellipse(P, 0.9)->semi_major_m;
              sum += nees(Eigen::Vector2d(1.0, 1.0), P).value_or(0.0);
            }),
            0);
  EXPECT_GT(sum, 0.0);
}

}  // namespace
}  // namespace soopnav
