#include <gtest/gtest.h>

#include <array>
#include <cstddef>

#include "navigation/strapdown_scene.hpp"
#include "soopnav/estimation/consistency.hpp"

namespace soopnav::test {
namespace {

struct Mean {
  std::array<double, 4> nees{};  // after 10, 20, 30, 40 s
  double biases = 0.0;           // of the six biases, at the end
  double nis = 0.0;
};

Mean mean_nees(int runs, double wrong) {
  const StrapdownScene scene;
  const PerfectRun perfect(scene);
  Mean mean;
  for (int run = 0; run < runs; ++run) {
    const auto truth = simulate(scene, perfect, RandomStream(77).substream(static_cast<std::uint64_t>(run)), wrong);
    const auto result = make_navigator(scene, perfect, truth).run(data_of(truth));
    for (std::size_t i = 0; i < 4; ++i) {
      const std::size_t r = 10 * (i + 1) - 1;
      const auto e = recorded(result, r).local(truth.states[r]);
      mean.nees[i] += nees(e, recorded_covariance(result, r)).value_or(1e9) / runs;
      if (i == 3) {
        const Eigen::Matrix<double, 6, 1> b = e.tail<6>();
        const Eigen::Matrix<double, 6, 6> P = recorded_covariance(result, r).bottomRightCorner<6, 6>();
        mean.biases += nees(b, P).value_or(1e9) / runs;
      }
    }
    for (const double one : result.nis) mean.nis += one / (160.0 * runs);
  }
  return mean;
}

// Fifteen states, initial errors drawn from P0, over 120 runs: each bound is left with probability 1e-5.
TEST(StrapdownConsistency, NeesOfAllFifteenStates) {
  constexpr int kRuns = 120;
  const Mean mean = mean_nees(kRuns, 1.0);
  const auto bounds = mean_nees_bounds(15, kRuns, 1e-5);
  for (const double one : mean.nees) {
    EXPECT_GT(one, bounds.lower);
    EXPECT_LT(one, bounds.upper);
  }
  const auto six = mean_nees_bounds(6, kRuns, 1e-5);
  EXPECT_GT(mean.biases, six.lower);
  EXPECT_LT(mean.biases, six.upper);
  const auto one = mean_nees_bounds(1, 160 * kRuns, 1e-5);
  EXPECT_GT(mean.nis, one.lower);
  EXPECT_LT(mean.nis, one.upper);
  RecordProperty("nees_40s", std::to_string(mean.nees[3]));
}

// Sensors half as good again as stated are noticed, by 20 runs.
TEST(StrapdownConsistency, WorseSensorsThanStatedAreNoticed) {
  constexpr int kRuns = 20;
  const Mean mean = mean_nees(kRuns, 1.5);
  EXPECT_GT(mean.nees[3], mean_nees_bounds(15, kRuns, 1e-5).upper);
  EXPECT_GT(mean.nis, mean_nees_bounds(1, 160 * kRuns, 1e-5).upper);
}

}  // namespace
}  // namespace soopnav::test
