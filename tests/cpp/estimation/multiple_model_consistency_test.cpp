// A vehicle that cruises, turns hard and cruises on: the multiple-model filter against either model alone.
#include <gtest/gtest.h>

#include <cmath>

#include "estimation/tracking_scene.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/interacting_multiple_model.hpp"

namespace soopnav {
namespace {

using test::Fix;
using test::Motion;
using test::Vehicle;

constexpr double kSigma = 10.0;  // of a fix [m]
constexpr int kSteps = 150;      // of one second
constexpr int kTurnFrom = 60;
constexpr int kTurnTo = 80;

// 20 m/s; from kTurnFrom to kTurnTo an arc of 4 m/s² across.
Vehicle truth_after(const Vehicle& x, int k) {
  const double rate = k >= kTurnFrom && k < kTurnTo ? 0.2 : 0.0;
  const Eigen::Vector2d v(std::cos(rate) * x.x[2] - std::sin(rate) * x.x[3],
                          std::sin(rate) * x.x[2] + std::cos(rate) * x.x[3]);
  return test::vehicle(x.x[0] + 0.5 * (x.x[2] + v[0]), x.x[1] + 0.5 * (x.x[3] + v[1]), v[0], v[1]);
}

TEST(InteractingMultipleModel, BeatsEitherModelOnAManoeuvre) {
  constexpr int kRuns = 100;
  const Motion calm{{1e-3, 1e-3}};
  const Motion hard{{10.0, 10.0}};
  const Eigen::Matrix2d chain = (Eigen::Matrix2d() << 0.98, 0.02, 0.05, 0.95).finished();
  const Eigen::Matrix2d R = kSigma * kSigma * Eigen::Matrix2d::Identity();
  double imm_square = 0.0, calm_square = 0.0, hard_square = 0.0;
  double hard_in_turn = 0.0, hard_in_cruise = 0.0;
  for (int run = 0; run < kRuns; ++run) {
    RandomStream random(101, static_cast<std::uint64_t>(run));
    Vehicle truth = test::vehicle(0, 0, 20, 0);
    const Eigen::Matrix4d P0 = Eigen::Vector4d(100, 100, 1, 1).asDiagonal();
    const Vehicle x0 = truth.retract(P0.cwiseSqrt() * test::normals<4>(random));
    InteractingMultipleModel imm(x0, P0, chain, Eigen::Vector2d(0.9, 0.1), calm, hard);
    ExtendedKalmanFilter<Vehicle> with_calm(x0, P0), with_hard(x0, P0);
    for (int k = 0; k < kSteps; ++k) {
      truth = truth_after(truth, k);
      const Eigen::Vector2d z = truth.x.head<2>() + kSigma * test::normals<2>(random);
      ASSERT_EQ(imm.predict(1.0), UpdateStatus::kAccepted);
      ASSERT_EQ(with_calm.predict(calm, 1.0), UpdateStatus::kAccepted);
      ASSERT_EQ(with_hard.predict(hard, 1.0), UpdateStatus::kAccepted);
      ASSERT_TRUE(imm.update(Fix{}, z, R).accepted());
      ASSERT_TRUE(with_calm.update(Fix{}, z, R).accepted());
      ASSERT_TRUE(with_hard.update(Fix{}, z, R).accepted());
      imm_square += (imm.state().x - truth.x).head<2>().squaredNorm();
      calm_square += (with_calm.state().x - truth.x).head<2>().squaredNorm();
      hard_square += (with_hard.state().x - truth.x).head<2>().squaredNorm();
      if (k >= kTurnFrom + 8 && k < kTurnTo) hard_in_turn += imm.probabilities()[1];
      if (k >= 20 && k < kTurnFrom) hard_in_cruise += imm.probabilities()[1];
    }
  }
  const double imm_rmse = std::sqrt(imm_square / (kRuns * kSteps));
  const double calm_rmse = std::sqrt(calm_square / (kRuns * kSteps));
  const double hard_rmse = std::sqrt(hard_square / (kRuns * kSteps));
  hard_in_turn /= kRuns * (kTurnTo - kTurnFrom - 8);
  hard_in_cruise /= kRuns * (kTurnFrom - 20);
  RecordProperty("rmse", std::to_string(imm_rmse) + " " + std::to_string(calm_rmse) + " " + std::to_string(hard_rmse));
  RecordProperty("probability", std::to_string(hard_in_turn) + " " + std::to_string(hard_in_cruise));
  EXPECT_LT(imm_rmse, 0.85 * hard_rmse);
  EXPECT_LT(imm_rmse, 0.5 * calm_rmse);
  EXPECT_GT(hard_in_turn, 0.8);
  EXPECT_LT(hard_in_cruise, 0.15);
}

}  // namespace
}  // namespace soopnav
