#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <vector>

#include "navigation/fix_scene.hpp"
#include "soopnav/core/random.hpp"

namespace soopnav::navigation {
namespace {

struct Arrivals {
  test::Scene scene;
  std::vector<double> toas, sigmas;
  [[nodiscard]] PositionFix fix(const PositionFixOptions& options) const {
    return position_fix(scene.nodes, toas, sigmas, options);
  }
};

// Seven masts, noise below the gate, unequal weights.
Arrivals make_arrivals(std::uint64_t seed) {
  RandomStream random(seed);
  auto positions = test::town();
  positions.insert(positions.end(), {{1800, 1200, 160}, {-2000, -300, 25}});
  Arrivals run{test::Scene(positions), {}, {}};
  run.scene.receiver_m = {random.uniform(-500, 500), random.uniform(-500, 500), random.uniform(0, 5)};
  run.scene.clock_bias_s = random.uniform(-5e-3, 5e-3);
  run.toas = run.scene.toas_s();
  for (double& t : run.toas) {
    const double sigma = random.uniform(3e-9, 12e-9);
    t += sigma * std::clamp(random.normal(), -1.5, 1.5);
    run.sigmas.push_back(sigma);
  }
  return run;
}

class PositionFixLaw : public testing::TestWithParam<std::uint64_t> {};
INSTANTIATE_TEST_SUITE_P(Seeds, PositionFixLaw, testing::Range<std::uint64_t>(1, 9));

void expect_equal(const PositionFix& a, const PositionFix& b, double tolerance_m) {
  ASSERT_EQ(a.status, FixStatus::kConverged);
  ASSERT_EQ(b.status, FixStatus::kConverged);
  EXPECT_NEAR((a.position_m - b.position_m).norm(), 0.0, tolerance_m);
  EXPECT_LT((a.covariance_m2 - b.covariance_m2).norm(), 1e-6 * a.covariance_m2.norm());
  EXPECT_NEAR(a.chi_square, b.chi_square, 1e-5);
}

TEST_P(PositionFixLaw, ACommonClockShiftMovesOnlyTheClock) {
  const Arrivals run = make_arrivals(GetParam());
  for (const double shift : {1e-6, 3.3e-3, 7e-3, -4.4e-3}) {
    Arrivals shifted = run;
    for (double& t : shifted.toas) t = t + shift - 10e-3 * std::floor((t + shift) / 10e-3);
    for (const auto& options : {PositionFixOptions{}, test::planar(1.5)}) {
      const auto a = run.fix(options);
      const auto b = shifted.fix(options);
      expect_equal(a, b, 1e-4);
      EXPECT_NEAR(std::remainder(b.clock_bias_s - a.clock_bias_s - shift, 10e-3), 0.0, 1e-12);
    }
  }
}

TEST_P(PositionFixLaw, TranslationCarriesOver) {
  const Arrivals run = make_arrivals(GetParam());
  Arrivals moved = run;
  const Eigen::Vector3d shift(3e5, -4e5, 2e3);
  for (auto& node : moved.scene.nodes) node.position_m += shift;
  for (const bool flat : {false, true}) {
    auto a = run.fix(flat ? test::planar(1.5) : PositionFixOptions{});
    const auto b = moved.fix(flat ? test::planar(1.5 + shift[2]) : PositionFixOptions{});
    a.position_m += shift;
    expect_equal(a, b, 1e-4);
    EXPECT_NEAR(a.clock_bias_s, b.clock_bias_s, 1e-13);
  }
}

TEST_P(PositionFixLaw, TurningAboutTheVerticalCarriesOver) {
  const Arrivals run = make_arrivals(GetParam());
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(2.1, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  Arrivals turned = run;
  for (auto& node : turned.scene.nodes) node.position_m = turn * node.position_m;
  for (const auto& options : {PositionFixOptions{}, test::planar(1.5)}) {
    auto a = run.fix(options);
    const auto b = turned.fix(options);
    a.position_m = turn * a.position_m;
    a.covariance_m2 = turn * a.covariance_m2 * turn.transpose();
    expect_equal(a, b, 1e-4);
    EXPECT_NEAR(a.dop.hdop, b.dop.hdop, 1e-6);
  }
}

TEST_P(PositionFixLaw, OrderOfNodesDoesNotMatter) {
  const Arrivals run = make_arrivals(GetParam());
  Arrivals reversed = run;
  std::reverse(reversed.scene.nodes.begin(), reversed.scene.nodes.end());
  std::reverse(reversed.toas.begin(), reversed.toas.end());
  std::reverse(reversed.sigmas.begin(), reversed.sigmas.end());
  const auto a = run.fix(test::planar(1.5));
  const auto b = reversed.fix(test::planar(1.5));
  expect_equal(a, b, 1e-5);
  for (std::size_t i = 0; i < 7; ++i) EXPECT_NEAR(a.residuals_m[i], b.residuals_m[6 - i], 1e-5);
}

TEST_P(PositionFixLaw, AClockOffsetAndItsArrivalCancel) {
  const Arrivals run = make_arrivals(GetParam());
  Arrivals late = run;
  late.scene.nodes[3].clock_offset_s += 2.5e-3;
  late.toas[3] = std::fmod(late.toas[3] + 2.5e-3, 10e-3);
  expect_equal(run.fix(test::planar(1.5)), late.fix(test::planar(1.5)), 1e-4);
}

TEST_P(PositionFixLaw, AUselessNodeChangesNothing) {
  const Arrivals run = make_arrivals(GetParam());
  Arrivals more = run;
  more.scene.nodes.push_back({.position_m = {50, 60, 70}});
  more.toas.push_back(1e-3);
  more.sigmas.push_back(10.0);  // three million kilometres
  const auto a = run.fix({});
  const auto b = more.fix({});
  ASSERT_EQ(b.status, FixStatus::kConverged);
  EXPECT_NEAR((a.position_m - b.position_m).norm(), 0.0, 1e-3);
  EXPECT_LT((a.covariance_m2 - b.covariance_m2).norm(), 1e-6 * a.covariance_m2.norm());
}

}  // namespace
}  // namespace soopnav::navigation
