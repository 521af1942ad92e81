#include "soopnav/navigation/position_fix.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "navigation/fix_scene.hpp"
#include "soopnav/core/random.hpp"
#include "support/nan.hpp"

namespace soopnav::navigation {
namespace {

using ::soopnav::test::kNan;
using test::planar;
using test::Scene;
using test::town;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
constexpr double kInf = std::numeric_limits<double>::infinity();

std::string refusal(const Scene& scene, const PositionFixOptions& options = {}) {
  try {
    static_cast<void>(scene.fix(options));
  } catch (const std::invalid_argument& e) {
    return e.what();
  }
  return "";
}

TEST(PositionFix, FindsTheReceiverInThreeDimensions) {
  const Scene scene(town());
  const auto fix = scene.fix();
  EXPECT_EQ(fix.status, FixStatus::kConverged);
  EXPECT_EQ(fix.dimensions, 3);
  EXPECT_NEAR((fix.position_m - scene.receiver_m).norm(), 0.0, 1e-4);
  EXPECT_NEAR(fix.clock_bias_s, scene.clock_bias_s, 1e-13);
  EXPECT_EQ(fix.used_count(), 5U);
  EXPECT_EQ(fix.degrees_of_freedom, 1);
  EXPECT_LT(fix.chi_square, 1e-6);
  EXPECT_THAT(fix.unobservable(), IsEmpty());
  EXPECT_EQ(fix.alternatives_m.cols(), 0);
  EXPECT_EQ(fix.message(), "3-D position from 5 of 5 nodes");
}

TEST(PositionFix, FindsTheReceiverAtAStatedHeight) {
  const Scene scene(town());
  const auto fix = scene.fix(planar(1.5));
  EXPECT_EQ(fix.status, FixStatus::kConverged);
  EXPECT_EQ(fix.dimensions, 2);
  EXPECT_NEAR((fix.position_m - scene.receiver_m).norm(), 0.0, 1e-5);
  EXPECT_EQ(fix.covariance_m2.row(2).norm(), 0.0);
  EXPECT_EQ(fix.covariance_m2.col(2).norm(), 0.0);
  EXPECT_TRUE(std::isnan(fix.dop.vdop));
  EXPECT_EQ(fix.degrees_of_freedom, 2);
}

TEST(PositionFix, CovarianceIsDopTimesSigmaWhenAllAreEquallyGood) {
  Scene scene(town());
  scene.sigma_s = 20e-9;
  const double sigma_m = scene.sigma_s * kSpeedOfLightMps;
  for (const auto& fix : {scene.fix(), scene.fix(planar(1.5))}) {
    const auto& P = fix.covariance_m2;
    EXPECT_NEAR(std::sqrt(P(0, 0) + P(1, 1)), fix.dop.hdop * sigma_m, 1e-6);
    EXPECT_NEAR(std::sqrt(P.trace()), fix.dop.pdop * sigma_m, 1e-4);
    EXPECT_NEAR(fix.clock_sigma_s, fix.dop.tdop * scene.sigma_s, 1e-14);
    EXPECT_NEAR(std::pow(fix.dop.gdop, 2), std::pow(fix.dop.pdop, 2) + std::pow(fix.dop.tdop, 2), 1e-6);
  }
}

TEST(PositionFix, NodeSigmaAddsToTheArrivalsSigma) {
  Scene scene(town());
  const auto plain = scene.fix(planar(1.5));
  for (auto& node : scene.nodes) node.sigma_s = std::sqrt(3.0) * scene.sigma_s;
  const auto doubled = scene.fix(planar(1.5));
  EXPECT_LT((4.0 * plain.covariance_m2 - doubled.covariance_m2).norm(), 1e-6 * doubled.covariance_m2.norm());
}

TEST(PositionFix, ClockOffsetsOfNodesAreTakenOut) {
  Scene scene(town());
  for (std::size_t i = 0; i < scene.nodes.size(); ++i)
    scene.nodes[i].clock_offset_s = 1e-6 * static_cast<double>(i * i) - 3e-6;
  EXPECT_NEAR((scene.fix().position_m - scene.receiver_m).norm(), 0.0, 1e-3);
  // Told wrongly, a node is no longer where it seems: a late node looks farther away.
  auto wrong = scene.nodes;
  wrong[0].clock_offset_s -= 100e-9;
  const auto fix = position_fix(wrong, scene.toas_s(), scene.sigmas_s(), planar(1.5));
  EXPECT_GT(fix.residuals_m[0], 0.0);
}

TEST(PositionFix, ArrivalsWrapAtTheFrame) {
  Scene scene(town());
  for (const double bias : {-5e-3, -2e-6, -1e-6, 0.0, 4.999e-3, 9.998e-3, 9.9999e-3, 0.123456}) {
    scene.clock_bias_s = bias;
    const auto fix = scene.fix(planar(1.5));
    ASSERT_EQ(fix.status, FixStatus::kConverged) << bias;
    EXPECT_NEAR((fix.position_m - scene.receiver_m).norm(), 0.0, 1e-4) << bias;
    EXPECT_NEAR(std::remainder(fix.clock_bias_s - bias, 10e-3), 0.0, 1e-13) << bias;
    EXPECT_GE(fix.clock_bias_s, -5e-3);
    EXPECT_LT(fix.clock_bias_s, 5e-3);
  }
  scene.period_s = kInf;
  scene.clock_bias_s = 0.5;
  PositionFixOptions options = planar(1.5);
  options.period_s = kInf;
  const auto fix = scene.fix(options);
  EXPECT_NEAR(fix.clock_bias_s, 0.5, 1e-12);
  EXPECT_NEAR((fix.position_m - scene.receiver_m).norm(), 0.0, 1e-4);
}

TEST(PositionFix, ReceiverOnTopOfAMast) {
  Scene scene(town());
  scene.receiver_m = scene.nodes[1].position_m;
  const auto fix = scene.fix();
  EXPECT_EQ(fix.status, FixStatus::kConverged);
  EXPECT_NEAR((fix.position_m - scene.receiver_m).norm(), 0.0, 0.05);
}

TEST(PositionFix, EarthCentredMagnitudes) {
  Scene scene(town());
  const Eigen::Vector3d centre(3912960.8, 299353.1, 5014176.3);
  for (auto& node : scene.nodes) node.position_m += centre;
  scene.receiver_m += centre;
  const auto fix = scene.fix();
  EXPECT_EQ(fix.status, FixStatus::kConverged);
  EXPECT_NEAR((fix.position_m - scene.receiver_m).norm(), 0.0, 1e-3);
}

TEST(PositionFix, FarOutsideTheNodes) {
  Scene scene(town());
  scene.receiver_m = {15e3, -9e3, 1.5};
  scene.sigma_s = 1e-9;
  const auto fix = scene.fix(planar(1.5));
  EXPECT_EQ(fix.status, FixStatus::kConverged);
  EXPECT_NEAR((fix.position_m - scene.receiver_m).norm(), 0.0, 1e-2);
}

TEST(PositionFix, OutlierIsRejectedAndNamed) {
  const Scene scene(town());
  auto toas = scene.toas_s();
  toas[2] += 137e-9;
  const auto fix = position_fix(scene.nodes, toas, scene.sigmas_s(), planar(1.5));
  EXPECT_EQ(fix.status, FixStatus::kConverged);
  EXPECT_EQ(fix.use[2], NodeUse::kRejected);
  EXPECT_EQ(fix.used_count(), 4U);
  EXPECT_NEAR((fix.position_m - scene.receiver_m).norm(), 0.0, 1e-4);
  // The residual is the whole error, since the fix does not see the node.
  EXPECT_NEAR(fix.residuals_m[2], 137e-9 * kSpeedOfLightMps, 1e-3);
  EXPECT_GT(fix.gates_m[2], 3.0 * scene.sigma_s * kSpeedOfLightMps);
  EXPECT_LT(fix.gates_m[2], fix.residuals_m[2]);
  EXPECT_THAT(fix.message(), HasSubstr("rejected: node 2 (residual 41.1 m, gate "));
  // Kept when asked to: then no position explains the times.
  PositionFixOptions keep = planar(1.5);
  keep.reject_outliers = false;
  const auto kept = position_fix(scene.nodes, toas, scene.sigmas_s(), keep);
  EXPECT_EQ(kept.status, FixStatus::kInconsistent);
  EXPECT_EQ(kept.used_count(), 5U);
  EXPECT_GT(kept.chi_square, kept.chi_square_limit);
}

TEST(PositionFix, HalfAFrameWrongIsRejectedToo) {
  const Scene scene(town());
  for (std::size_t k = 0; k < 5; ++k) {
    auto toas = scene.toas_s();
    toas[k] = std::fmod(toas[k] + 4.99e-3, 10e-3);
    const auto fix = position_fix(scene.nodes, toas, scene.sigmas_s(), planar(1.5));
    EXPECT_EQ(fix.status, FixStatus::kConverged) << k;
    EXPECT_EQ(fix.use[k], NodeUse::kRejected) << k;
    EXPECT_NEAR((fix.position_m - scene.receiver_m).norm(), 0.0, 1e-3) << k;
  }
}

TEST(PositionFix, TwoOutliersOfEight) {
  auto positions = town();
  positions.insert(positions.end(), {{1800, 1200, 60}, {-2000, -300, 25}, {1300, -1400, 70}});
  const Scene scene(positions);
  auto toas = scene.toas_s();
  toas[1] += 300e-9;
  toas[6] += 250e-9;
  const auto fix = position_fix(scene.nodes, toas, scene.sigmas_s(), planar(1.5));
  EXPECT_EQ(fix.status, FixStatus::kConverged);
  EXPECT_EQ(fix.use[1], NodeUse::kRejected);
  EXPECT_EQ(fix.use[6], NodeUse::kRejected);
  EXPECT_EQ(fix.used_count(), 6U);
  EXPECT_NEAR((fix.position_m - scene.receiver_m).norm(), 0.0, 1e-3);
}

TEST(PositionFix, OneRedundantNodeShowsAnErrorButNotWhose) {
  auto positions = town();
  positions.pop_back();
  const Scene scene(positions);
  auto toas = scene.toas_s();
  toas[0] += 200e-9;
  const auto fix = position_fix(scene.nodes, toas, scene.sigmas_s(), planar(1.5));
  EXPECT_EQ(fix.status, FixStatus::kInconsistent);
  EXPECT_EQ(fix.used_count(), 4U);
  EXPECT_THAT(fix.message(), HasSubstr("disagree"));
  EXPECT_THAT(fix.message(), HasSubstr("with more nodes the one at fault could be told"));
}

TEST(PositionFix, SuspectsAreNamedWhenTheyCannotBeToldApart) {
  // Two masts in nearly the same direction: either may be wrong.
  const Scene scene({{1000, 0, 10}, {1020, 5, 10}, {-700, 1200, 10}, {-700, -1200, 10}, {-695, -1215, 10}});
  auto toas = scene.toas_s();
  toas[0] += 200e-9;
  const auto fix = position_fix(scene.nodes, toas, scene.sigmas_s(), planar(1.5));
  EXPECT_EQ(fix.status, FixStatus::kInconsistent);
  EXPECT_THAT(fix.suspects, testing::Contains(0U));
  EXPECT_GE(fix.suspects.size(), 2U);
  EXPECT_LT(fix.suspects.size(), 5U);
  EXPECT_THAT(fix.message(), HasSubstr("the node at fault may be 0"));
}

TEST(PositionFix, MinimumOfNodesMayHaveTwoAnswers) {
  // Near the corner of a triangle, on the far side of one mast, three hyperbolas meet twice.
  RandomStream random(31);
  int twice = 0;
  for (int k = 0; k < 300; ++k) {
    Scene scene({{0, 0, 30}, {1000, 0, 30}, {300, 900, 30}});
    scene.receiver_m = {random.uniform(-1500, 2500), random.uniform(-1500, 2500), 1.5};
    const auto fix = scene.fix(planar(1.5));
    if (fix.status == FixStatus::kConverged) {
      EXPECT_NEAR((fix.position_m - scene.receiver_m).norm(), 0.0, 0.1) << scene.receiver_m.transpose();
    } else if (fix.status == FixStatus::kAmbiguous) {
      ++twice;
      ASSERT_EQ(fix.alternatives_m.cols(), 1);
      const double a = (fix.position_m - scene.receiver_m).norm();
      const double b = (fix.alternatives_m.col(0) - scene.receiver_m).norm();
      EXPECT_NEAR(std::min(a, b), 0.0, 0.1) << scene.receiver_m.transpose();
      EXPECT_THAT(fix.message(), HasSubstr("are the minimum, and their hyperbolas meet twice"));
      // Each is an answer: its own predictions are the arrivals.
      Scene other = scene;
      other.receiver_m = fix.alternatives_m.col(0);
      other.clock_bias_s = fix.alternative_clock_biases_s[0];
      for (std::size_t i = 0; i < 3; ++i) {
        EXPECT_NEAR(std::remainder(other.toas_s()[i] - scene.toas_s()[i], 10e-3), 0.0, 1e-13);
      }
    } else {
      // At the fold between one answer and two.
      EXPECT_EQ(fix.status, FixStatus::kRankDeficient) << fix.message();
    }
  }
  EXPECT_GT(twice, 20);
  EXPECT_LT(twice, 200);
}

TEST(PositionFix, AHintChoosesBetweenTwoAnswers) {
  Scene scene({{0, 0, 30}, {1000, 0, 30}, {300, 900, 30}});
  scene.receiver_m = {-300, -250, 1.5};
  const auto fix = scene.fix(planar(1.5));
  ASSERT_EQ(fix.status, FixStatus::kAmbiguous) << fix.message();
  for (const Eigen::Vector3d& hint : {Eigen::Vector3d(fix.position_m), Eigen::Vector3d(fix.alternatives_m.col(0))}) {
    PositionFixOptions options = planar(1.5);
    options.near_m = hint;
    const auto hinted = scene.fix(options);
    EXPECT_EQ(hinted.status, FixStatus::kAmbiguous);
    EXPECT_NEAR((hinted.position_m - hint).norm(), 0.0, 1e-3);
    ASSERT_EQ(hinted.alternatives_m.cols(), 1);
    EXPECT_GT((hinted.alternatives_m.col(0) - hint).norm(), 1.0);
  }
}

TEST(PositionFix, CollinearNodesSeeTwoSides) {
  auto positions = town();
  for (auto& p : positions) p[1] = 0.5 * p[0] + 10.0;
  const Scene scene(positions);
  const auto fix = scene.fix(planar(1.5));
  EXPECT_EQ(fix.status, FixStatus::kAmbiguous);
  EXPECT_TRUE(fix.nodes_in_line);
  ASSERT_EQ(fix.alternatives_m.cols(), 1);
  EXPECT_LT(std::min((fix.position_m - scene.receiver_m).norm(), (fix.alternatives_m.col(0) - scene.receiver_m).norm()),
            1e-3);
  EXPECT_THAT(fix.message(), HasSubstr("the nodes lie on one line, and its two sides look alike"));
}

TEST(PositionFix, OnTheLineOfTheNodesTheSideIsFree) {
  Scene scene({{-900, 0, 10}, {0, 0, 10}, {500, 0, 10}, {1500, 0, 10}});
  scene.receiver_m = {200, 0, 10};
  const auto fix = scene.fix(planar(10.0));
  EXPECT_EQ(fix.status, FixStatus::kRankDeficient);
  EXPECT_THAT(fix.unobservable(), ElementsAre("north"));
  EXPECT_THAT(fix.message(), HasSubstr("the nodes do not determine north: they lie on one line"));
  EXPECT_TRUE(std::isnan(fix.covariance_m2(1, 1)));
}

TEST(PositionFix, CoplanarNodesSeeTwoHeights) {
  auto positions = town();
  for (auto& p : positions) p[2] = 430.0;
  Scene scene(positions);
  scene.receiver_m[2] = 10.0;
  const auto fix = scene.fix();
  EXPECT_EQ(fix.status, FixStatus::kAmbiguous);
  ASSERT_EQ(fix.alternatives_m.cols(), 1);
  // Of two mirror images the lower one is taken: receivers stand below masts.
  EXPECT_NEAR(fix.position_m[2], 10.0, 1e-2);
  EXPECT_NEAR(fix.alternatives_m(2, 0), 850.0, 1e-2);
  EXPECT_THAT(fix.message(), HasSubstr("the nodes lie in one plane"));
  // A stated height is used where three dimensions are not determined, and only there.
  const auto stated = scene.fix({.height_m = 10.0});
  EXPECT_EQ(stated.status, FixStatus::kConverged);
  EXPECT_EQ(stated.dimensions, 2);
  EXPECT_TRUE(stated.fell_back);
  EXPECT_THAT(stated.message(), HasSubstr("at the stated height, since they do not determine three dimensions"));
  EXPECT_EQ(scene.fix({.dimension = FixDimension::kSpatial, .height_m = 10.0}).status, FixStatus::kAmbiguous);
  EXPECT_EQ(Scene(town()).fix({.height_m = 1.5}).dimensions, 3);
}

TEST(PositionFix, NearThePlaneOfTheNodesTheTwoHeightsRunTogether) {
  // Twenty metres below a plane of masts, noise of 3 m in range leaves any height between the mirror images.
  auto positions = town();
  for (auto& p : positions) p[2] = 30.0;
  Scene scene(positions);
  scene.receiver_m[2] = 10.0;
  const auto fix = scene.fix();
  EXPECT_EQ(fix.status, FixStatus::kRankDeficient);
  EXPECT_THAT(fix.unobservable(), ElementsAre("up"));
  EXPECT_THAT(fix.message(),
              HasSubstr("they lie in one plane; two dimensions may be had by stating the receiver's height"));
  EXPECT_NEAR((fix.position_m - scene.receiver_m).head<2>().norm(), 0.0, 1.0);
  EXPECT_EQ(scene.fix({.height_m = 10.0}).status, FixStatus::kConverged);
  // With noise of 3 mm they are two.
  scene.sigma_s = 0.01e-9;
  EXPECT_EQ(scene.fix().status, FixStatus::kAmbiguous);
}

TEST(PositionFix, MastsOfATownInNoiseAlwaysEndInAnAnswer) {
  // Masts of 15 to 60 m leave the height to chance: whatever is claimed, an end is found, and horizontally it is right.
  RandomStream random(33);
  int undetermined = 0;
  for (int k = 0; k < 200; ++k) {
    Scene scene;
    for (int i = 0; i < 7; ++i) {
      scene.nodes.push_back(
          {.position_m = {random.uniform(-1500, 1500), random.uniform(-1500, 1500), random.uniform(15, 60)}});
    }
    scene.receiver_m = {random.uniform(-800, 800), random.uniform(-800, 800), 1.5};
    auto toas = scene.toas_s();
    for (double& t : toas) t += scene.sigma_s * std::clamp(random.normal(), -2.0, 2.0);
    const auto fix = position_fix(scene.nodes, toas, scene.sigmas_s());
    EXPECT_NE(fix.status, FixStatus::kNotConverged) << k;
    EXPECT_NE(fix.status, FixStatus::kTooFewNodes) << k;
    EXPECT_LT((fix.position_m - scene.receiver_m).head<2>().norm(), 60.0) << k << " " << fix.message();
    if (fix.status == FixStatus::kRankDeficient) ++undetermined;
    PositionFixOptions stated;
    stated.height_m = 1.5;
    stated.dimension = FixDimension::kPlanar;
    const auto flat = position_fix(scene.nodes, toas, scene.sigmas_s(), stated);
    EXPECT_EQ(flat.status, FixStatus::kConverged) << k << " " << flat.message();
    EXPECT_LT((flat.position_m - scene.receiver_m).norm(), 40.0) << k;
  }
  EXPECT_GT(undetermined, 50);
}

TEST(PositionFix, InThePlaneOfTheNodesTheHeightIsFree) {
  auto positions = town();
  for (auto& p : positions) p[2] = 30.0;
  Scene scene(positions);
  scene.receiver_m[2] = 30.0;
  const auto fix = scene.fix();
  EXPECT_EQ(fix.status, FixStatus::kRankDeficient);
  EXPECT_THAT(fix.unobservable(), ElementsAre("up"));
  EXPECT_NEAR((fix.position_m - scene.receiver_m).head<2>().norm(), 0.0, 1e-2);
}

TEST(PositionFix, TooFewNodesIsASentence) {
  const auto all = town();
  for (std::size_t n = 0; n < 4; ++n) {
    const Scene scene({all.begin(), all.begin() + static_cast<std::ptrdiff_t>(n)});
    const auto fix = scene.fix();
    EXPECT_EQ(fix.status, FixStatus::kTooFewNodes) << n;
    EXPECT_TRUE(std::isnan(fix.position_m[0]) && std::isnan(fix.clock_bias_s));
    EXPECT_THAT(fix.message(), HasSubstr(std::to_string(n) + " usable node"));
    EXPECT_THAT(fix.message(), HasSubstr("a 3-D position with an unknown receiver clock needs 4"));
    const auto flat = scene.fix({.height_m = 1.5});
    EXPECT_EQ(flat.dimensions, 2);
    if (n < 3) {
      EXPECT_EQ(flat.status, FixStatus::kTooFewNodes) << n;
      EXPECT_THAT(flat.message(), HasSubstr("a 2-D position with an unknown receiver clock needs 3"));
    } else {
      EXPECT_EQ(flat.status, FixStatus::kConverged);
    }
  }
}

TEST(PositionFix, NodesAtOnePlaceDetermineNothing) {
  const Scene scene(std::vector<Eigen::Vector3d>(5, Eigen::Vector3d(500, 500, 20)));
  const auto fix = scene.fix(planar(1.5));
  EXPECT_NE(fix.status, FixStatus::kConverged);
  EXPECT_NE(fix.status, FixStatus::kAmbiguous);
  // Two masts at one place are one mast seen twice: here too few for a plane.
  const Scene pair({{500, 500, 20}, {500, 500, 20}, {-700, 300, 20}});
  const auto two = pair.fix(planar(1.5));
  EXPECT_NE(two.status, FixStatus::kConverged);
  EXPECT_NE(two.status, FixStatus::kAmbiguous);
  // One doubled mast among enough others is no harm.
  auto positions = town();
  positions.push_back(positions[0]);
  EXPECT_EQ(Scene(positions).fix(planar(1.5)).status, FixStatus::kConverged);
}

TEST(PositionFix, NoiseThatKeepsTheHyperbolasApartIsNotHidden) {
  // Three nodes and a difference longer than their distance: no point on Earth explains it.
  const Scene scene({{0, 0, 30}, {1000, 0, 30}, {300, 900, 30}});
  auto toas = scene.toas_s();
  toas[1] += 20e-6;
  const auto fix = position_fix(scene.nodes, toas, scene.sigmas_s(), planar(1.5));
  EXPECT_TRUE(fix.status == FixStatus::kInconsistent || fix.status == FixStatus::kNotConverged) << fix.message();
}

TEST(PositionFix, UnusableArrivalsAreLeftOut) {
  const Scene scene(town());
  for (const double bad : {kNan, kInf, -kInf}) {
    auto toas = scene.toas_s();
    toas[1] = bad;
    const auto fix = position_fix(scene.nodes, toas, scene.sigmas_s(), planar(1.5));
    EXPECT_EQ(fix.status, FixStatus::kConverged);
    EXPECT_EQ(fix.use[1], NodeUse::kNotFinite);
    EXPECT_TRUE(std::isnan(fix.residuals_m[1]));
    EXPECT_NEAR((fix.position_m - scene.receiver_m).norm(), 0.0, 1e-4);
    EXPECT_THAT(fix.message(), HasSubstr("node 1 left out: its time of arrival or sigma is not finite"));
  }
  for (const double bad : {0.0, -1e-9}) {
    auto sigmas = scene.sigmas_s();
    sigmas[4] = bad;
    const auto fix = position_fix(scene.nodes, scene.toas_s(), sigmas, planar(1.5));
    EXPECT_EQ(fix.status, FixStatus::kConverged);
    EXPECT_EQ(fix.use[4], NodeUse::kBadSigma);
    EXPECT_THAT(fix.message(), HasSubstr("node 4 left out: its sigma is not positive"));
  }
  auto sigmas = scene.sigmas_s();
  sigmas[0] = kNan;
  EXPECT_EQ(position_fix(scene.nodes, scene.toas_s(), sigmas, planar(1.5)).use[0], NodeUse::kNotFinite);
  const std::vector<double> nothing(5, kNan);
  EXPECT_EQ(position_fix(scene.nodes, nothing, scene.sigmas_s()).status, FixStatus::kTooFewNodes);
}

TEST(PositionFix, MistakesAreRefusedByName) {
  Scene scene(town());
  const auto toas = scene.toas_s();
  const auto sigmas = scene.sigmas_s();
  const std::vector<double> four(4, 1e-3);
  EXPECT_THROW(static_cast<void>(position_fix(scene.nodes, four, sigmas)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(position_fix(scene.nodes, toas, four)), std::invalid_argument);
  Scene bad = scene;
  bad.nodes[3].position_m[1] = kNan;
  EXPECT_THAT(refusal(bad), HasSubstr("nodes[3].position_m"));
  bad = scene;
  bad.nodes[2].sigma_s = -1e-9;
  EXPECT_THAT(refusal(bad), HasSubstr("nodes[2].sigma_s"));
  bad = scene;
  bad.nodes[0].clock_offset_s = kInf;
  EXPECT_THAT(refusal(bad), HasSubstr("nodes[0].clock_offset_s"));
  EXPECT_THAT(refusal(Scene(std::vector<Eigen::Vector3d>(65, Eigen::Vector3d::Zero()))),
              HasSubstr("nodes: 65 given; at most 64"));
  EXPECT_THAT(refusal(scene, {.dimension = FixDimension::kPlanar}), HasSubstr("height_m: not given"));
  EXPECT_THAT(refusal(scene, {.height_m = kNan}), HasSubstr("height_m"));
  EXPECT_THAT(refusal(scene, {.near_m = Eigen::Vector3d::Constant(kInf)}), HasSubstr("near_m"));
  EXPECT_THAT(refusal(scene, {.period_s = 0.0}), HasSubstr("period_s"));
  EXPECT_THAT(refusal(scene, {.period_s = kNan}), HasSubstr("period_s"));
  EXPECT_THAT(refusal(scene, {.false_alarm_probability = 0.5}), HasSubstr("false_alarm_probability: 0.5"));
  EXPECT_THAT(refusal(scene, {.max_iterations = 0}), HasSubstr("max_iterations: 0"));
}

TEST(PositionFix, EveryStatusHasAName) {
  for (int i = 0; i <= static_cast<int>(FixStatus::kNotConverged); ++i) {
    EXPECT_NE(to_string(static_cast<FixStatus>(i)), "unknown") << i;
  }
  EXPECT_EQ(to_string(static_cast<FixStatus>(99)), "unknown");
}

}  // namespace
}  // namespace soopnav::navigation
