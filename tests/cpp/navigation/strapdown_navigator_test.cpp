#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <vector>

#include "measurement/jacobian_battery.hpp"
#include "navigation/strapdown_scene.hpp"
#include "support/allocation_count.hpp"
#include "support/nan.hpp"

namespace soopnav::test {
namespace {

using inertial::ImuStatus;
using ::soopnav::test::kNan;

struct Case {
  StrapdownScene scene;
  PerfectRun perfect;
  StrapdownTruth truth;
  explicit Case(const StrapdownScene& s = {}) : scene(s), perfect(s), truth(simulate(s, perfect, RandomStream(5))) {}
  [[nodiscard]] navigation::StrapdownRun run() const {
    return make_navigator(scene, perfect, truth).run(data_of(truth));
  }
  [[nodiscard]] double error_m(const navigation::StrapdownRun& r, std::size_t record) const {
    return (recorded(r, record)(kPosition) - truth.states[record](kPosition)).norm();
  }
  // Position error against what the filter says of it, in deviations.
  [[nodiscard]] double share(const navigation::StrapdownRun& r, std::size_t record) const {
    const Eigen::Matrix3d P = recorded_covariance(r, record).block<3, 3>(6, 6);
    return error_m(r, record) / std::sqrt(P.trace());
  }
};

std::uint8_t code(UpdateStatus s) { return static_cast<std::uint8_t>(s); }
std::uint8_t code(ImuStatus s) { return static_cast<std::uint8_t>(s); }

TEST(StrapdownNavigator, RangeChangesHoldThePosition) {
  const Case c;
  const auto aided = c.run();
  EXPECT_LT(c.error_m(aided, 39), 5.0);
  EXPECT_TRUE(std::all_of(aided.update_status.begin(), aided.update_status.end(),
                          [](auto s) { return s == code(UpdateStatus::kAccepted); }));
  auto alone = data_of(c.truth);
  alone.epochs_s = {};
  alone.range_changes_m = {};
  const auto free = make_navigator(c.scene, c.perfect, c.truth).run(alone);
  EXPECT_GT(c.error_m(free, 39), 2.0 * c.error_m(aided, 39));
}

TEST(StrapdownNavigator, AmbiguousRangesAreUnwrappedByThePrediction) {
  Case c;
  const auto plain = c.run();
  c.scene.options.ambiguity_m = 60.0;
  for (double& z : c.truth.range_changes_m) z = std::remainder(z, 60.0);
  const auto wrapped = c.run();
  for (std::size_t i = 0; i < plain.position_m.size(); ++i) {
    EXPECT_NEAR(plain.position_m[i], wrapped.position_m[i], 1e-6);
  }
  // The wrapped residual is the same model's Jacobian.
  RandomStream random(3);
  const Place<Navigator::State> place(kLocal, random);
  const navigation::AmbiguousRangeDifference model{{Known<3>{3e3, 4e2, -50.0}, Known<3>{1.0, 2.0, 3.0}}, 1e9};
  EXPECT_LT(worst_jacobian_error(model.model, place.x, place.scale), 1e-7);
  EXPECT_NEAR((navigation::AmbiguousRangeDifference{{}, 100.0}.residual(0, 130.0, 10.0)), 20.0, 1e-12);
}

TEST(StrapdownNavigator, EpochsBetweenSamples) {
  Case c;
  // The same epochs, 3.7 ms late, with the ranges of that time: as good as on time.
  std::size_t at = 0;
  RandomStream random(8);
  for (double& t : c.truth.epochs_s) {
    t += 0.0037 - 0.01;
    const Eigen::Vector3d p = c.perfect.path.at(t).p_n_m;
    for (const auto& q : c.scene.transmitters) {
      c.truth.range_changes_m[at++] = (p - q).norm() - (c.perfect.path.at(0.0).p_n_m - q).norm();
    }
  }
  const auto run = c.run();
  EXPECT_LT(c.share(run, 39), 3.0);
  double worst = 0.0;
  for (std::size_t i = 20 * 4; i < run.innovation_m.size(); ++i) worst = std::max(worst, std::abs(run.innovation_m[i]));
  EXPECT_LT(worst, 0.5);  // a sample's way is 0.15 m, and these ranges have no noise
  EXPECT_EQ(run.update_status[0], code(UpdateStatus::kAccepted));
}

TEST(StrapdownNavigator, TransmittersLostForHalfAMinute) {
  Case c;
  for (std::size_t e = 5; e < 35; ++e) {
    for (std::size_t i = 0; i < 4; ++i) c.truth.range_changes_m[4 * e + i] = kNan;
  }
  c.scene.options.gate_sigmas = 4.0;
  c.scene.options.gate_floor_m = 3.0;
  const auto run = c.run();
  EXPECT_EQ(run.update_status[4 * 20], code(UpdateStatus::kNonFinite));
  EXPECT_TRUE(std::isnan(run.innovation_m[4 * 20]));
  for (const std::size_t r : {10u, 20u, 30u, 34u}) EXPECT_LT(c.share(run, r), 3.0) << r;
  EXPECT_GT(recorded_covariance(run, 34)(6, 6), 100.0 * recorded_covariance(run, 4)(6, 6));
  EXPECT_EQ(run.update_status[4 * 35], code(UpdateStatus::kAccepted));  // the gate did not lock it out
  EXPECT_LT(c.error_m(run, 39), 3.0);
}

TEST(StrapdownNavigator, BadSamplesAreNamedAndSurvived) {
  Case c;
  c.scene.options.limits.gyro_range_radps = 5.0;
  c.scene.options.gap = {.rate_sigma_radps = 0.3, .acceleration_sigma_mps2 = 3.0};
  auto& t = c.truth;
  // Half a second missing at 10 s; a duplicate and a reversal; one saturated and one NaN sample.
  const auto cut = [&](std::size_t from, std::size_t to) {
    const auto f = static_cast<std::ptrdiff_t>(from), l = static_cast<std::ptrdiff_t>(to);
    t.t_s.erase(t.t_s.begin() + f, t.t_s.begin() + l);
    t.delta_theta.erase(t.delta_theta.begin() + 3 * f, t.delta_theta.begin() + 3 * l);
    t.delta_velocity.erase(t.delta_velocity.begin() + 3 * f, t.delta_velocity.begin() + 3 * l);
  };
  t.delta_theta[3 * 2000] = 0.06;
  t.delta_velocity[3 * 2100 + 1] = kNan;
  t.t_s[1500] = t.t_s[1499];
  t.t_s[1600] = t.t_s[1599] - 0.5;
  cut(1000, 1050);
  const auto run = c.run();
  const auto count = [&](ImuStatus s) { return std::count(run.imu_status.begin(), run.imu_status.end(), code(s)); };
  EXPECT_EQ(run.imu_status[1000], code(ImuStatus::kGap));
  EXPECT_EQ(run.imu_status[1450], code(ImuStatus::kDuplicate));
  EXPECT_EQ(run.imu_status[1550], code(ImuStatus::kReversed));
  EXPECT_EQ(run.imu_status[1950], code(ImuStatus::kSaturated));
  EXPECT_EQ(run.imu_status[2050], code(ImuStatus::kNonFinite));
  EXPECT_EQ(count(ImuStatus::kGap), 3);  // and behind each sample that was left out
  for (const double p : run.position_m) ASSERT_TRUE(std::isfinite(p));
  const Eigen::Vector3d p(run.position_m[run.position_m.size() - 3], run.position_m[run.position_m.size() - 2],
                          run.position_m.back());
  EXPECT_LT((p - c.perfect.path.at(run.t_s.back()).p_n_m).norm(), 6.0);
  // Over the gap the deviation of the velocity grew by what was stated: 3 m/s² for half a second.
  Case calm;
  const auto before = calm.run();
  EXPECT_GT(run.sigma[15 * 10 + 3], 2.0 * before.sigma[15 * 10 + 3]);
}

TEST(StrapdownNavigator, WrongRangesAreGated) {
  Case c;
  c.scene.options.gate_sigmas = 5.0;
  c.scene.options.gate_floor_m = 3.0;
  c.truth.range_changes_m[4 * 30 + 2] += 80.0;
  const auto run = c.run();
  EXPECT_EQ(run.update_status[4 * 30 + 2], code(UpdateStatus::kGated));
  EXPECT_GT(std::abs(run.innovation_m[4 * 30 + 2]), 70.0);
  EXPECT_LT(c.share(run, 39), 3.0);
}

TEST(StrapdownNavigator, StatusesOfWhatCannotBeTaken) {
  Case c;
  auto navigator = make_navigator(c.scene, c.perfect, c.truth);
  EXPECT_EQ(navigator.update_range_change(9, 0.0).status, UpdateStatus::kUndefined);
  EXPECT_EQ(navigator.update_range_change(0, kNan).status, UpdateStatus::kNonFinite);
  // A transmitter where the receiver is.
  StrapdownScene near = c.scene;
  near.transmitters[1] = c.truth.start(kPosition);
  auto close = make_navigator(near, c.perfect, c.truth);
  EXPECT_EQ(close.update_range_change(1, 0.0).status, UpdateStatus::kUndefined);
  EXPECT_EQ(close.state().x, c.truth.start.x);
  // Epochs before the start, and behind the last sample.
  c.truth.epochs_s.front() = -3.0;
  c.truth.epochs_s.back() = 1e3;
  const auto run = c.run();
  EXPECT_EQ(run.update_status.front(), code(UpdateStatus::kTooLate));
  EXPECT_EQ(run.update_status.back(), code(UpdateStatus::kTimeNotAdvancing));
  // Set-up.
  auto data = data_of(c.truth);
  data.range_changes_m = data.range_changes_m.first(7);
  EXPECT_THROW(static_cast<void>(navigator.run(data)), std::invalid_argument);
  data = data_of(c.truth, 0);
  EXPECT_THROW(static_cast<void>(navigator.run(data)), std::invalid_argument);
  StrapdownScene bad = c.scene;
  bad.options.range_sigma_m = 0.0;
  EXPECT_THROW(make_navigator(bad, c.perfect, c.truth), std::invalid_argument);
  bad = c.scene;
  bad.transmitters[0][0] = kNan;
  EXPECT_THROW(make_navigator(bad, c.perfect, c.truth), std::invalid_argument);
}

TEST(StrapdownNavigator, RestHoldsVelocityAndFindsGyroBiases) {
  // Two minutes at rest without any transmitter.
  StrapdownScene scene;
  scene.transmitters.clear();
  scene.options.zero_velocity = inertial::ZeroVelocityOptions{
      .window = 50, .accelerometer_sigma_mps2 = 0.01, .gyro_sigma_radps = 1e-3, .threshold = 12.0};
  scene.options.hold_heading = true;
  scene.options.zero_rate_sigma_radps = 1e-6;
  const std::vector<Eigen::Vector3d> still(16, Eigen::Vector3d(0.0, 0.0, 0.0));
  const simulation::SpatialTrajectory path(geometry::LocalFrame(kHome, geometry::LocalAxes::kNed), still, 12.0, {});
  scene.duration_s = 120.0;
  PerfectRun perfect(StrapdownScene{});
  perfect.path = path;
  perfect.increments = path.imu_increments(100.0, 0.0, 120.0);
  const auto truth = simulate(scene, perfect, RandomStream(9));
  const auto run = make_navigator(scene, perfect, truth).run(data_of(truth));
  EXPECT_GE(run.zero_velocity_updates, 200u);
  const auto last = recorded(run, 119);
  EXPECT_LT(last(kVelocity).norm(), 0.02);
  const double bias = (last(inertial::kGyroBias) - truth.states.back()(inertial::kGyroBias)).norm();
  EXPECT_LT(bias, 2.4e-5);
  EXPECT_LT(run.sigma[15 * 119 + 9], 0.6 * 2.4e-5);
  scene.options.zero_velocity.reset();
  const auto without = make_navigator(scene, perfect, truth).run(data_of(truth));
  EXPECT_EQ(without.zero_velocity_updates, 0u);
  EXPECT_GT(recorded(without, 119)(kPosition).norm(), 10.0 * last(kPosition).norm());
}

TEST(StrapdownNavigator, NothingAllocates) {
  if (!kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  StrapdownScene scene;
  scene.options.zero_velocity = inertial::ZeroVelocityOptions{};
  Case c(scene);
  auto navigator = make_navigator(c.scene, c.perfect, c.truth);
  const auto three = [](const std::vector<double>& from, std::size_t i) {
    return Eigen::Vector3d(from[3 * i], from[3 * i + 1], from[3 * i + 2]);
  };
  int accepted = 0;
  EXPECT_EQ(allocations_of([&] {
              for (std::size_t k = 0; k < 120; ++k) {
                static_cast<void>(navigator.add_imu(c.truth.t_s[k] + (k > 50 ? 0.5 : 0.0),
                                                    three(c.truth.delta_theta, k), three(c.truth.delta_velocity, k)));
              }
              accepted += navigator.update_range_change(0, 10.0).accepted() ? 1 : 0;
            }),
            0);
  EXPECT_EQ(accepted, 1);
  inertial::StrapdownIntegrator integrator(c.perfect.path.navigation_state(0.0));
  EXPECT_EQ(allocations_of([&] {
              for (std::size_t k = 0; k < 50; ++k) static_cast<void>(integrator.step(c.perfect.increments[k]));
            }),
            0);
}

}  // namespace
}  // namespace soopnav::test
