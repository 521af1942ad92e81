// Errors and innovations of the linear filter and its smoother against the covariances they state. Each bound is left
// by a right filter with a probability of 1e-5, for any seed.

#include <gtest/gtest.h>

#include <vector>

#include "estimation/linear_systems.hpp"
#include "soopnav/estimation/consistency.hpp"
#include "soopnav/estimation/linear_filter.hpp"
#include "soopnav/estimation/rts_smoother.hpp"

namespace soopnav {
namespace {

using test::matrix_at;
using test::vector_at;

struct Means {
  double filter_nees = 0.0;
  double smoother_nees = 0.0;
  double nis = 0.0;
};

constexpr int kRuns = 300;
constexpr int kSteps = 40;
constexpr int kMiddle = 20;

// Means over runs drawn from `truth`, filtered as if they came from `assumed`.
Means means(const test::DenseSystem& truth, const test::DenseSystem& assumed) {
  Means sum;
  std::vector<double> x(kSteps * 4);
  std::vector<double> P(kSteps * 16);
  for (int i = 0; i < kRuns; ++i) {
    const auto data = test::simulate(truth, kSteps, 9000 + static_cast<std::uint64_t>(i));
    const LinearRun r = linear_filter(assumed.view(), {.z = data.values()}, assumed.x0, assumed.P0);
    EXPECT_EQ(rts_smooth(assumed.F, r.x_pred, r.P_pred, r.x, r.P, x, P), 0);
    const Eigen::Vector4d last = data.truth.row(kSteps - 1).transpose() - vector_at(r.x, kSteps - 1, 4);
    const Eigen::Vector4d middle = data.truth.row(kMiddle).transpose() - vector_at(x, kMiddle, 4);
    sum.filter_nees += nees(last, matrix_at(r.P, kSteps - 1, 4, 4)).value() / kRuns;
    sum.smoother_nees += nees(middle, matrix_at(P, kMiddle, 4, 4)).value() / kRuns;
    for (const double value : r.nis) sum.nis += value / (kRuns * kSteps);
  }
  return sum;
}

TEST(LinearFilterConsistency, ErrorsMatchTheirCovariances) {
  const auto s = test::constant_velocity();
  const Means mean = means(s, s);
  const MeanBounds state = mean_nees_bounds(4, kRuns, 1e-5);
  const MeanBounds innovation = mean_nees_bounds(2, kRuns * kSteps, 1e-5);
  EXPECT_GT(mean.filter_nees, state.lower);
  EXPECT_LT(mean.filter_nees, state.upper);
  EXPECT_GT(mean.smoother_nees, state.lower);
  EXPECT_LT(mean.smoother_nees, state.upper);
  EXPECT_GT(mean.nis, innovation.lower);
  EXPECT_LT(mean.nis, innovation.upper);
}

// The same bounds notice noise that is half, or twice, what the filter assumes.
TEST(LinearFilterConsistency, BoundsNoticeWrongNoise) {
  const auto s = test::constant_velocity();
  const MeanBounds state = mean_nees_bounds(4, kRuns, 1e-5);
  const MeanBounds innovation = mean_nees_bounds(2, kRuns * kSteps, 1e-5);
  auto wrong = s;
  wrong.R *= 0.5;
  EXPECT_GT(means(s, wrong).nis, innovation.upper);
  wrong = s;
  wrong.Q *= 4.0;
  EXPECT_LT(means(s, wrong).smoother_nees, state.lower);
}

}  // namespace
}  // namespace soopnav
