#include "soopnav/navigation/cooperative_group.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "navigation/cooperative_scene.hpp"
#include "soopnav/estimation/consistency.hpp"
#include "support/nan.hpp"

namespace soopnav::test {
namespace {

using namespace navigation;
using ::soopnav::test::kNan;

PairModel<> model_at(std::size_t beacon, double t_s) { return world().model(beacon, t_s); }

GroupOptions group_options() {
  GroupOptions o;
  o.anchor_clock = world().clock_noise;
  o.target_clock = world().clock_noise;
  o.horizontal_psd_m2ps3 = 9.0;
  o.vertical_psd_m2ps3 = 9.0;
  o.gate_probability = 0.0;
  return o;
}
GroupBurst burst_at(const Drawn& one) {
  return {one.t_s, static_cast<int>(one.beacon), world().carrier_hz, world().anchor_p_e, Eigen::Vector3d::Zero()};
}

TEST(PairNoise, SharesAreSteinsTermsAndTheCorrelationTheirs) {
  const auto one = pair_noise_shares(2.0, 5.0);
  EXPECT_NEAR(one.first + one.second + one.both, 1.0, 1e-15);
  EXPECT_NEAR(one.first / one.second, 2.5, 1e-14);
  EXPECT_NEAR(one.both / one.first, 0.2, 1e-14);
  EXPECT_NEAR(shared_anchor_correlation(1.0, 1.0, 1.0), 1.0 / 3.0, 1e-15);
  EXPECT_NEAR(shared_anchor_correlation(10.0, 10.0, 10.0), 10.0 / 21.0, 1e-15);
  EXPECT_NEAR(shared_anchor_correlation(100.0, 100.0, 100.0), 100.0 / 201.0, 1e-15);
  EXPECT_TRUE(std::isnan(shared_anchor_correlation(0.0, 1.0, 1.0)));
  EXPECT_TRUE(std::isnan(pair_noise_shares(1.0, kNan).both));
  const double none = std::numeric_limits<double>::infinity();
  EXPECT_EQ(shared_anchor_correlation(none, none, none), 0.5);
  EXPECT_EQ(shared_anchor_correlation(1.0, 1.0, none), 0.0);
}

TEST(CooperativeGroup, OneTargetAloneIsASingleFilter) {
  RandomStream random(17);
  PairFilterOptions single{group_options().anchor_clock + group_options().target_clock};
  single.acceleration_psd_m2ps3 = 9.0;
  const auto filter = joseph_filter(single);
  const PairVector mean = wrong_start(random);
  filter->restart(0.0, mean, start_covariance());
  CooperativeGroup group(world().beacons, 0.0, group_options());
  ASSERT_EQ(group.join(mean, start_covariance()), 0);
  double t = 0.0;
  for (const Drawn& burst : drive(random.substream(1), 20.0)) {
    ASSERT_EQ(filter->predict(burst.t_s - t, nullptr), UpdateStatus::kAccepted);
    t = burst.t_s;
    ASSERT_TRUE(filter
                    ->update(model_at(burst.beacon, t), static_cast<int>(burst.beacon),
                             world().observed(burst.beacon, t, burst.z), {})
                    .accepted());
    const GroupRow row{0, -1, burst.z[0], burst.z[1], world().R, 3.0, 5.0};
    GroupStatus status{};
    ASSERT_TRUE(group.update(burst_at(burst), {&row, 1}, {&status, 1}));
    ASSERT_EQ(status, GroupStatus::kAccepted);
  }
  EXPECT_LT((group.mean() - filter->mean()).head<6>().norm(), 1e-6);
  EXPECT_LT((group.covariance() - filter->covariance()).norm(), 1e-6 * filter->covariance().norm());
}

// Rows of two targets against the anchor and one against the other, in one burst: gain by a dense R, made here.
TEST(CooperativeGroup, RowsOfABurstAreThoseOfAFullCovariance) {
  RandomStream random(23);
  const double snr[3] = {2.0, 0.7, 4.0};  // two targets, the anchor
  const std::size_t beacon = 1;
  std::vector<PairVector> truth;
  GroupOptions options = group_options();
  CooperativeGroup group(world().beacons, 30.0, options);
  Eigen::VectorXd mean(16);
  Eigen::MatrixXd P = Eigen::MatrixXd::Zero(16, 16);
  for (int i = 0; i < 2; ++i) {
    truth.push_back(world().truth(30.0 + 3.0 * i, {1e3 * i, 2.0}));
    const PairSquare root =
        start_sigma().asDiagonal() *
        (0.2 * Eigen::MatrixXd::NullaryExpr(8, 8, [&] { return random.normal(); }) + Eigen::MatrixXd::Identity(8, 8));
    P.block<8, 8>(8 * i, 8 * i) = 1e-2 * root * root.transpose();  // small: models hardly bend
    mean.segment<8>(8 * i) = truth.back() + 0.1 * root * normals(random, 8);
    ASSERT_EQ(group.join(mean.segment<8>(8 * i), P.block<8, 8>(8 * i, 8 * i)), i);
  }
  Eigen::Matrix2d R = world().R;
  R(0, 1) = R(1, 0) = 0.3 * std::sqrt(R(0, 0) * R(1, 1));
  const int pair[3][2] = {{0, 2}, {1, 2}, {0, 1}};  // 2: the anchor
  std::vector<GroupRow> rows;
  Eigen::VectorXd z(6);
  Eigen::VectorXd h(6);
  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(6, 16);
  const double c = kSpeedOfLightMps;
  const Eigen::Vector2d units(c, -c / world().carrier_hz);
  const Eigen::Matrix2d D = units.asDiagonal();
  const auto value = [&](const Eigen::VectorXd& x) {
    Eigen::VectorXd out(6);
    for (int k = 0; k < 3; ++k) {
      out.segment<2>(2 * k) = D * world().measured(beacon, 30.0, x.segment<8>(8 * pair[k][0]));
      if (pair[k][1] < 2) out.segment<2>(2 * k) -= D * world().measured(beacon, 30.0, x.segment<8>(8 * pair[k][1]));
    }
    return out;
  };
  h = value(mean);
  for (int j = 0; j < 16; ++j) {
    const double step = j % 8 < 3 ? 10.0 : 1.0;
    Eigen::VectorXd up = mean;
    Eigen::VectorXd down = mean;
    up[j] += step;
    down[j] -= step;
    H.col(j) = (value(up) - value(down)) / (2.0 * step);
  }
  // R as a sum over recordings: what each does to every row (doc/cooperative_motion.md eq. 12).
  Eigen::MatrixXd full = Eigen::MatrixXd::Zero(6, 6);
  const Eigen::Matrix2d Rm = D * R * D;
  const Eigen::Matrix2d L = Rm.llt().matrixL();
  for (int node = 0; node < 3; ++node) {
    Eigen::MatrixXd G = Eigen::MatrixXd::Zero(6, 2);
    for (int k = 0; k < 3; ++k) {
      const double a = 1.0 / snr[pair[k][0]];
      const double b = 1.0 / snr[pair[k][1]];
      const double all = a + b + a * b;
      if (pair[k][0] == node) G.block<2, 2>(2 * k, 0) = std::sqrt(a / all) * L;
      if (pair[k][1] == node) G.block<2, 2>(2 * k, 0) = -std::sqrt(b / all) * L;
    }
    full += G * G.transpose();
  }
  for (int k = 0; k < 3; ++k) {
    const double a = 1.0 / snr[pair[k][0]];
    const double b = 1.0 / snr[pair[k][1]];
    full.block<2, 2>(2 * k, 2 * k) += a * b / (a + b + a * b) * Rm;
    const Eigen::Vector2d exact =
        world().measured(beacon, 30.0, truth[static_cast<std::size_t>(pair[k][0])]) -
        (pair[k][1] < 2 ? world().measured(beacon, 30.0, truth[static_cast<std::size_t>(pair[k][1])])
                        : Eigen::Vector2d::Zero().eval());
    rows.push_back(
        {pair[k][0], pair[k][1] < 2 ? pair[k][1] : -1, exact[0], exact[1], R, snr[pair[k][0]], snr[pair[k][1]]});
    z.segment<2>(2 * k) = D * exact;
  }
  const Eigen::MatrixXd S = H * P * H.transpose() + full;
  const Eigen::MatrixXd K = S.ldlt().solve(H * P).transpose();
  const Eigen::VectorXd expected = mean + K * (z - h);
  const Eigen::MatrixXd left = P - K * S * K.transpose();
  GroupStatus status[3];
  const GroupBurst burst{30.0, static_cast<int>(beacon), world().carrier_hz, world().anchor_p_e,
                         Eigen::Vector3d::Zero()};
  ASSERT_TRUE(group.update(burst, rows, status));
  for (const GroupStatus one : status) EXPECT_EQ(one, GroupStatus::kAccepted);
  const Eigen::VectorXd sigma = left.diagonal().cwiseSqrt();
  EXPECT_LT((group.mean() - expected).cwiseQuotient(sigma).cwiseAbs().maxCoeff(), 1e-3);
  const Eigen::MatrixXd scaled =
      sigma.cwiseInverse().asDiagonal() * (group.covariance() - left) * sigma.cwiseInverse().asDiagonal();
  EXPECT_LT(scaled.cwiseAbs().maxCoeff(), 1e-4);
  // Rows taken for independent ones give another answer.
  options.shared_anchor_noise = false;
  CooperativeGroup blind(world().beacons, 30.0, options);
  for (int i = 0; i < 2; ++i) ASSERT_EQ(blind.join(mean.segment<8>(8 * i), P.block<8, 8>(8 * i, 8 * i)), i);
  ASSERT_TRUE(blind.update(burst, rows, status));
  EXPECT_GT((blind.mean() - expected).cwiseQuotient(sigma).cwiseAbs().maxCoeff(), 0.05);
}

TEST(CooperativeGroup, ClocksOfTheTargetsWanderWithTheAnchors) {
  CooperativeGroup group(world().beacons, 0.0, group_options());
  for (int i = 0; i < 2; ++i) ASSERT_EQ(group.join(world().truth(0.0, {}), start_covariance()), i);
  ASSERT_TRUE(group.update({40.0, 0, 1e9, world().anchor_p_e, Eigen::Vector3d::Zero()}, {}, {}));
  const clock::ClockNoise& n = world().clock_noise;
  const Eigen::MatrixXd P = group.covariance();
  const double t = 40.0;
  const double across = n.white_frequency_m2ps * t + n.frequency_walk_m2ps3 * t * t * t / 3.0;
  EXPECT_NEAR(P(6, 14), across, 1e-9 * across);
  EXPECT_NEAR(P(7, 14), n.frequency_walk_m2ps3 * t * t / 2.0, 1e-9 * across);
  EXPECT_NEAR(P(7, 15), n.frequency_walk_m2ps3 * t, 1e-9 * across);
  EXPECT_NEAR(P(6, 6), 1e4 + t * t + 2.0 * across, 1e-6);
  EXPECT_EQ(P(0, 8), 0.0);
}

TEST(CooperativeGroup, TargetsJoinAndLeaveAndRowsAreJudged) {
  EXPECT_THROW(CooperativeGroup(world().beacons, kNan, group_options()), std::invalid_argument);
  EXPECT_THROW(CooperativeGroup({}, 0.0, group_options()), std::invalid_argument);
  auto options = group_options();
  options.max_targets = 0;
  EXPECT_THROW(CooperativeGroup(world().beacons, 0.0, options), std::invalid_argument);
  options = group_options();
  options.gate_probability = 1.0;
  EXPECT_THROW(CooperativeGroup(world().beacons, 0.0, options), std::invalid_argument);
  options.gate_probability = 1e-4;
  options.jump_after = -1;
  EXPECT_THROW(CooperativeGroup(world().beacons, 0.0, options), std::invalid_argument);
  options.jump_after = 3;
  options.mask_rad = 2.0;
  EXPECT_THROW(CooperativeGroup(world().beacons, 0.0, options), std::invalid_argument);
  options.mask_rad = 0.0;
  options.max_targets = 2;
  CooperativeGroup group(world().beacons, 0.0, options);
  const PairVector x = world().truth(1.0, {});
  PairVector bad = x;
  bad[2] = kNan;
  EXPECT_EQ(group.join(bad, start_covariance()), -1);
  EXPECT_EQ(group.join(x, PairSquare::Zero()), -1);
  ASSERT_EQ(group.join(x, start_covariance()), 0);
  ASSERT_EQ(group.join(x, start_covariance()), 1);
  EXPECT_EQ(group.join(x, start_covariance()), -1);  // no room
  ASSERT_TRUE(group.leave(0));
  EXPECT_FALSE(group.leave(0));
  ASSERT_EQ(group.join(x, start_covariance()), 2);
  EXPECT_EQ(group.targets()[0], 1);
  EXPECT_EQ(group.targets()[1], 2);

  const Eigen::Vector2d z = world().measured(0, 1.0, x);
  const GroupRow good{1, -1, z[0], z[1], world().R, 2.0, 2.0};
  std::vector<GroupRow> rows(8, good);
  rows[1].target = 0;
  rows[2].reference = 1;
  rows[3].tdoa_s = kNan;
  rows[4].reference_snr = 0.0;
  rows[5].covariance.setZero();
  rows[6].target = 2;
  rows[6].tdoa_s += 1e-3;
  rows[7].target = 2;
  rows[7].covariance(1, 0) = 1e-9;  // not symmetric
  std::vector<GroupStatus> status(rows.size());
  GroupBurst burst{1.0, 0, world().carrier_hz, world().anchor_p_e, Eigen::Vector3d::Zero()};
  ASSERT_TRUE(group.update(burst, rows, status));
  const std::vector<GroupStatus> expected{
      GroupStatus::kAccepted,  GroupStatus::kUnknownTarget, GroupStatus::kUnknownTarget, GroupStatus::kNonFinite,
      GroupStatus::kNonFinite, GroupStatus::kRefused,       GroupStatus::kGated,         GroupStatus::kRefused};
  EXPECT_EQ(status, expected);
  EXPECT_TRUE(group.mean().allFinite());
  EXPECT_EQ(group.mean().size(), 16);
  burst.t_s = 0.5;
  EXPECT_FALSE(group.update(burst, rows, status));
  EXPECT_EQ(status[0], GroupStatus::kTimeNotAdvancing);
  burst.t_s = 2.0;
  burst.beacon = 4;
  EXPECT_TRUE(group.update(burst, rows, status));
  EXPECT_EQ(status[0], GroupStatus::kUnknownBeacon);
  burst.t_s = 2000.0;
  burst.beacon = 0;
  EXPECT_TRUE(group.update(burst, rows, status));
  EXPECT_EQ(status[0], GroupStatus::kOutsideOrbit);
  burst.carrier_hz = 0.0;
  EXPECT_TRUE(group.update(burst, rows, status));
  EXPECT_EQ(status[0], GroupStatus::kNonFinite);
}

TEST(CooperativeGroup, SatellitesBelowTheMaskAreNotHeard) {
  const PairVector x = world().truth(1.0, {});
  const Eigen::Vector2d z = world().measured(0, 1.0, x);
  const GroupRow row{0, -1, z[0], z[1], world().R, 2.0, 2.0};
  for (const double mask : {0.0, 1.5}) {
    GroupOptions options = group_options();
    options.mask_rad = mask;
    CooperativeGroup group(world().beacons, 0.0, options);
    ASSERT_EQ(group.join(x, start_covariance()), 0);
    GroupStatus status{};
    ASSERT_TRUE(group.update({1.0, 0, world().carrier_hz, world().anchor_p_e, Eigen::Vector3d::Zero()}, {&row, 1},
                             {&status, 1}));
    EXPECT_EQ(status, mask > 0.0 ? GroupStatus::kBelowHorizon : GroupStatus::kAccepted);
  }
}

// Two targets that follow the same path on clocks of their own, from bursts that both hear or each in turn.
struct Jumped {
  GroupOptions options = group_options();
  double target_m = 0.0;  // jump of target 0's theta at 20 s
  double anchor_m = 0.0;  // of both
  bool in_turn = false;
  std::uint64_t seed = 0;
};
struct Aftermath {
  int refused = 0;
  int jumped = 0;
  int last = 0;  // accepted in the last ten seconds, of target 0
  GroupJumps jumps;
  double nees = 0.0;
};
Aftermath after(Jumped scene) {
  scene.options.gate_probability = 1e-4;
  RandomStream random(RandomStream(90).substream(scene.seed));
  const PairVector mean = wrong_start(random);
  CooperativeGroup group(world().beacons, 0.0, scene.options);
  const PairVector start = world().truth(0.0, {3e4, 40.0});
  EXPECT_EQ(group.join(mean, start_covariance()), 0);
  const PairVector other = wrong_start(random);
  EXPECT_EQ(group.join(other, start_covariance()), 1);
  const Eigen::Matrix2d L = world().R.cwiseSqrt() / std::sqrt(2.0);
  Aftermath out;
  PairVector truth = start;
  int k = 0;
  for (const Drawn& burst : drive(random.substream(1), 60.0)) {
    const bool later = burst.t_s > 20.0;
    const Eigen::Vector2d anchor = L * normals(random, 2);
    std::vector<GroupRow> rows;
    for (int i = 0; i < 2; ++i) {
      PairVector x = burst.truth;
      if (later) x[6] += scene.anchor_m + (i == 0 ? scene.target_m : 0.0);
      if (i == 0) truth = x;
      if (scene.in_turn && k % 2 != i) continue;
      const Eigen::Vector2d z = world().measured(burst.beacon, burst.t_s, x) + L * normals(random, 2) - anchor;
      rows.push_back({i, -1, z[0], z[1], world().R, 1e3, 1e3});
    }
    ++k;
    std::vector<GroupStatus> status(rows.size());
    EXPECT_TRUE(group.update(burst_at(burst), rows, status));
    for (std::size_t i = 0; i < rows.size(); ++i) {
      out.refused += status[i] == GroupStatus::kGated ? 1 : 0;
      out.jumped += status[i] == GroupStatus::kClockJump ? 1 : 0;
      out.last += burst.t_s > 50.0 && rows[i].target == 0 && status[i] == GroupStatus::kAccepted ? 1 : 0;
    }
  }
  out.jumps = group.jumps();
  out.nees = nees(PairVector(truth - group.mean().head<8>()), PairSquare(group.covariance().topLeftCorner<8, 8>()))
                 .value_or(kNan);
  return out;
}

TEST(CooperativeGroup, AClockThatJumpsIsReopenedAndItsTargetAloneWhenItIsItsOwn) {
  constexpr int kRuns = 12;
  double sum = 0.0;
  for (std::uint64_t seed = 0; seed < kRuns; ++seed) {
    const Aftermath own = after({.target_m = 3e4, .seed = seed});
    EXPECT_EQ(own.jumps.targets, 1);
    EXPECT_EQ(own.jumps.anchor, 0);
    EXPECT_EQ(own.jumped, 1);
    EXPECT_EQ(own.refused, 2);
    EXPECT_GE(own.last, 9);
    sum += own.nees;
  }
  const MeanBounds bounds = mean_nees_bounds(kPairDim, kRuns, 1e-4);
  EXPECT_GT(sum / kRuns, bounds.lower);
  EXPECT_LT(sum / kRuns, bounds.upper);
  Jumped never{.target_m = 3e4};
  never.options.jump_after = 0;
  EXPECT_EQ(after(never).last, 0);
}

TEST(CooperativeGroup, AJumpOfTheAnchorsClockReopensAllOfThem) {
  constexpr int kRuns = 12;
  double sum = 0.0;
  for (std::uint64_t seed = 0; seed < kRuns; ++seed) {
    const Aftermath both = after({.anchor_m = -3e4, .seed = seed});
    EXPECT_EQ(both.jumps.anchor, 1);
    EXPECT_EQ(both.jumps.targets, 0);
    EXPECT_EQ(both.jumped, 2);
    EXPECT_EQ(both.refused, 4);
    EXPECT_GE(both.last, 9);
    sum += both.nees;
    const Aftermath turns = after({.anchor_m = -3e4, .in_turn = true, .seed = seed});
    EXPECT_EQ(turns.jumps.anchor, 1);
    EXPECT_EQ(turns.jumps.targets, 0);
    EXPECT_LE(turns.refused, 4);
  }
  const MeanBounds bounds = mean_nees_bounds(kPairDim, kRuns, 1e-4);
  EXPECT_GT(sum / kRuns, bounds.lower);
  EXPECT_LT(sum / kRuns, bounds.upper);
  // Nothing jumped: nothing is reopened, and a row that is wrong now and then is refused and no more.
  const Aftermath calm = after({});
  EXPECT_EQ(calm.jumps.anchor + calm.jumps.targets, 0);
}

}  // namespace
}  // namespace soopnav::test
