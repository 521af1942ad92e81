#include "soopnav/navigation/cooperative_motion.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <stdexcept>
#include <vector>

#include "navigation/cooperative_scene.hpp"
#include "soopnav/estimation/consistency.hpp"
#include "soopnav/estimation/transition.hpp"
#include "soopnav/geometry/rotation.hpp"
#include "soopnav/inertial/strapdown_mechanization.hpp"
#include "soopnav/navigation/cooperative_group.hpp"
#include "soopnav/navigation/cooperative_inertial.hpp"
#include "soopnav/navigation/cooperative_manoeuvre.hpp"
#include "support/allocation_count.hpp"
#include "support/nan.hpp"

namespace soopnav::test {
namespace {

using namespace navigation;
using inertial::ImuIncrement;
using inertial::ImuStatus;
using ::soopnav::test::kNan;

PairModel<> model_at(std::size_t beacon, double t_s) { return world().model(beacon, t_s); }

TEST(GroundConstantVelocity, AxesAreThoseOfTheEllipsoid) {
  for (const double latitude : {-1.2, 0.0, 0.6, 1.5}) {
    for (const double height : {-100.0, 3000.0}) {
      const Eigen::Matrix3d axes = east_north_up(geometry::geodetic_to_ecef(latitude, 2.0, height));
      const Eigen::Matrix3d expected = geometry::rotation_ecef_to_enu(latitude, 2.0).transpose();
      EXPECT_LT((axes - expected).cwiseAbs().maxCoeff(), std::abs(height) / 5e8 + 1e-14) << latitude;
    }
  }
  const Eigen::Matrix3d pole = east_north_up({0.0, 0.0, 6.4e6});
  EXPECT_LT((pole.transpose() * pole - Eigen::Matrix3d::Identity()).norm(), 1e-15);
}

TEST(GroundConstantVelocity, NoiseIsThatOfItsAxesAndOfAnyStep) {
  using State = PositionVelocity<EcefFrame, 3>;
  State x;
  x(kPosition) = world().anchor_p_e;
  x(kVelocity) << 3.0, -4.0, 5.0;
  const GroundConstantVelocity<> motion{2.0, 0.5};
  using Square = Eigen::Matrix<double, 6, 6>;
  const auto moved = [&](const State& from, const Square& P, double dt_s, Square& next) {
    Transition<State, 6> y(from);
    EXPECT_TRUE(motion.propagate(from, dt_s, ZeroNoise{}, y));
    next = y.F * P * y.F.transpose() + y.G * y.G.transpose();
    return y.state;
  };
  Square whole;
  Square parts;
  const State once = moved(x, Square::Identity(), 2.0, whole);
  const State first = moved(x, Square::Identity(), 0.7, parts);
  const State twice = moved(first, Square(parts), 1.3, parts);
  const Eigen::Matrix3d T = east_north_up(x(kPosition));
  const Eigen::Matrix3d v = T.transpose() * whole.bottomRightCorner<3, 3>() * T;
  EXPECT_LT((v - Eigen::Matrix3d(Eigen::Vector3d(5.0, 5.0, 2.0).asDiagonal())).norm(), 1e-9);
  const Eigen::Matrix3d p = T.transpose() * whole.topLeftCorner<3, 3>() * T;
  EXPECT_NEAR(p(2, 2), 1.0 + 4.0 + 0.5 * 8.0 / 3.0, 1e-8);
  // The axes turn by 1e-6 rad on the way.
  EXPECT_LT((whole - parts).norm(), 1e-4);
  EXPECT_LT((once.x - twice.x).norm(), 1e-8);
}

TEST(StrapdownInEcef, AgreesWithTheLocalFrame) {
  using inertial::StrapdownMechanization;
  using Local = inertial::StrapdownState<NedFrame>;
  using Earth = inertial::StrapdownState<EcefFrame>;
  const auto& path = world().path;
  const StrapdownMechanization<NedFrame> near(kHome);
  const StrapdownMechanization<EcefFrame> earth;
  const Eigen::Matrix3d T_e_n = path.frame().rotation_from_ecef().transpose();
  const auto m = path.at(0.0);
  Local x;
  x(kAttitude) << m.q_n_b.w(), m.q_n_b.vec();
  x(kVelocity) = m.v_n_mps;
  x(kPosition) = m.p_n_m;
  Earth y;
  const Eigen::Quaterniond q(T_e_n * m.q_n_b.toRotationMatrix());
  y(kAttitude) << q.w(), q.vec();
  y(kVelocity) = T_e_n * m.v_n_mps;
  y(kPosition) = path.frame().position_to_ecef(m.p_n_m);
  for (const ImuIncrement& u : path.imu_increments(100.0, 0.0, 20.0)) {
    Transition<Local, 12> a(x);
    Transition<Earth, 12> b(y);
    ASSERT_TRUE(near.propagate(x, u, u.dt_s, ZeroNoise{}, a));
    ASSERT_TRUE(earth.propagate(y, u, u.dt_s, ZeroNoise{}, b));
    x = a.state;
    y = b.state;
    EXPECT_LT((T_e_n * a.F.block<3, 3>(3, 0) - b.F.block<3, 3>(3, 0)).norm(), 1e-9);  // of attitude: body axes
    EXPECT_LT((T_e_n * a.F.block<3, 3>(3, 6) * T_e_n.transpose() - b.F.block<3, 3>(3, 6)).norm(), 1e-12);
  }
  EXPECT_LT((path.frame().position_to_ecef(x(kPosition)) - y(kPosition)).norm(), 1e-6);
  EXPECT_LT((T_e_n * x(kVelocity) - y(kVelocity)).norm(), 1e-8);
}

// ---- The engine of two modes

ManoeuvreOptions manoeuvre_options() {
  ManoeuvreOptions o;
  o.clock_noise = world().clock_noise + world().clock_noise;
  o.manoeuvre_vertical_psd_m2ps3 = 3.0;  // this path climbs
  return o;
}

TEST(ManoeuvreFilter, HoldsACarThatTurnsAndItsNeesIsInBounds) {
  constexpr int kRuns = 60;
  double sum = 0.0;
  double square = 0.0;
  double straight = 0.0;  // a filter of one calm mode, on the same data
  double calm = 0.0;
  for (int run = 0; run < kRuns; ++run) {
    RandomStream random(RandomStream(70).substream(static_cast<std::uint64_t>(run)));
    const auto filter = manoeuvre_filter(manoeuvre_options());
    PairFilterOptions single{manoeuvre_options().clock_noise};
    single.acceleration_psd_m2ps3 = 0.01;
    const auto other = joseph_filter(single);
    const PairVector mean = wrong_start(random);
    filter->restart(0.0, mean, start_covariance());
    other->restart(0.0, mean, start_covariance());
    double t = 0.0;
    for (const Drawn& burst : drive(random.substream(9), 60.0)) {
      for (CooperativeFilter* one : {static_cast<CooperativeFilter*>(filter.get()), other.get()}) {
        ASSERT_EQ(one->predict(burst.t_s - t, nullptr), UpdateStatus::kAccepted);
        ASSERT_TRUE(one->update(model_at(burst.beacon, burst.t_s), static_cast<int>(burst.beacon),
                                world().observed(burst.beacon, burst.t_s, burst.z), {})
                        .accepted());
      }
      t = burst.t_s;
      if (t < 20.0) continue;
      const PairVector error = burst.truth - filter->mean();
      const PairVector lost = burst.truth - other->mean();
      sum += nees(error, filter->covariance()).value_or(kNan) / 40.0;
      square += error.head<3>().squaredNorm();
      straight += lost.head<3>().squaredNorm();
      calm += filter->probabilities()[0] / 40.0;
      EXPECT_NEAR(filter->probabilities()[0] + filter->probabilities()[1], 1.0, 1e-12);
    }
  }
  // Steps of a run are not independent: the bounds are those of runs alone, which is wide. Mixtures are no Gaussians.
  const MeanBounds bounds = mean_nees_bounds(kPairDim, kRuns, 1e-4);
  EXPECT_GT(sum / kRuns, 0.6 * bounds.lower);
  EXPECT_LT(sum / kRuns, 1.4 * bounds.upper);
  EXPECT_GT(straight, 9.0 * square);
  EXPECT_LT(calm / kRuns, 0.5);  // it turns all the time
  std::printf("nees %.2f rms %.1f m, one mode %.1f m, calm %.2f\n", sum / kRuns, std::sqrt(square / (40.0 * kRuns)),
              std::sqrt(straight / (40.0 * kRuns)), calm / kRuns);
}

TEST(ManoeuvreFilter, ChainStepsAreThoseOfTheTimeThatPassed) {
  // Without measurements: any cut of the time leads to the same probabilities, and to those of rest in the end.
  ManoeuvreOptions o = manoeuvre_options();
  o.calm_probability = 1.0;
  const auto once = manoeuvre_filter(o);
  const auto often = manoeuvre_filter(o);
  for (const auto* one : {&once, &often}) (*one)->restart(0.0, world().truth(0.0, {}), start_covariance());
  ASSERT_EQ(once->predict(7.0, nullptr), UpdateStatus::kAccepted);
  for (const double dt : {0.5, 2.5, 4.0}) ASSERT_EQ(often->predict(dt, nullptr), UpdateStatus::kAccepted);
  EXPECT_NEAR(once->probabilities()[0], often->probabilities()[0], 1e-12);
  const double rate = 1.0 / o.mean_calm_s + 1.0 / o.mean_manoeuvre_s;
  EXPECT_NEAR(once->probabilities()[1], (1.0 - std::exp(-7.0 * rate)) / (o.mean_calm_s * rate), 1e-12);
}

TEST(ManoeuvreFilter, CrossIsOfBothModes) {
  const auto filter = manoeuvre_filter(manoeuvre_options());
  PairSquare P = start_covariance();
  P(0, 3) = P(3, 0) = 4.0;
  filter->restart(0.0, world().truth(0.0, {}), P);
  PairSquare cross;
  ASSERT_EQ(filter->predict(2.0, &cross), UpdateStatus::kAccepted);
  PairSquare F = PairSquare::Identity();
  F.block<3, 3>(0, 3) = 2.0 * Eigen::Matrix3d::Identity();
  F(6, 7) = 2.0;
  EXPECT_LT((cross - P * F.transpose()).norm(), 1e-9);
  // And what the noise of the mixture adds to it is positive.
  const Eigen::LLT<PairSquare> noise(filter->covariance() - F * P * F.transpose() + 1e-6 * PairSquare::Identity());
  EXPECT_EQ(noise.info(), Eigen::Success);
}

TEST(ManoeuvreFilter, RefusesAndComesBack) {
  EXPECT_THROW(static_cast<void>(manoeuvre_filter({.calm_psd_m2ps3 = 0.0})), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(manoeuvre_filter({.manoeuvre_psd_m2ps3 = 1e-3})), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(manoeuvre_filter({.mean_calm_s = -1.0})), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(manoeuvre_filter({.calm_probability = 1.5})), std::invalid_argument);
  const auto filter = manoeuvre_filter(manoeuvre_options());
  filter->restart(0.0, world().truth(0.0, {3e4, 40.0}), start_covariance());
  const PairVector x = filter->mean();
  EXPECT_EQ(filter->predict(0.0, nullptr), UpdateStatus::kTimeNotAdvancing);
  EXPECT_EQ(filter->predict(kNan, nullptr), UpdateStatus::kTimeNotAdvancing);
  EXPECT_EQ(filter->reopen_clock(kNan, 0.0), UpdateStatus::kNonFinite);
  auto observed = world().observed(0, 0.0, world().measured(0, 0.0, x));
  observed.z[0] = kNan;
  EXPECT_EQ(filter->update(model_at(0, 0.0), 0, observed, {}).status, UpdateStatus::kNonFinite);
  EXPECT_EQ(filter->update(model_at(0, 1e6), 0, world().observed(0, 0.0, {0.0, 0.0}), {}).status,
            UpdateStatus::kUndefined);
  EXPECT_EQ(filter->mean(), x);
  filter->save();
  ASSERT_EQ(filter->predict(5.0, nullptr), UpdateStatus::kAccepted);
  ASSERT_EQ(filter->reopen_clock(1e6, 1e2), UpdateStatus::kAccepted);
  EXPECT_GT(filter->covariance()(6, 6), 1e6);
  filter->load();
  EXPECT_EQ(filter->mean(), x);
  EXPECT_LT((filter->covariance() - start_covariance()).norm(), 1e-9);
}

// ---- The engine with an inertial unit

constexpr double kRateHz = 100.0;

InertialPairOptions inertial_options() {
  InertialPairOptions o;
  o.clock_noise = world().clock_noise + world().clock_noise;
  o.noise = {.gyro_density = 4.4e-5, .accelerometer_density = 1e-3};
  o.limits.period_s = 1.0 / kRateHz;
  o.q_n_b = world().path.at(0.0).q_n_b;
  o.heading_sigma_rad = 0.0175;
  o.gyro_bias_sigma_radps = 2.4e-5;
  return o;
}
const std::vector<ImuIncrement>& perfect() {
  static const std::vector<ImuIncrement> all = world().path.imu_increments(kRateHz, 0.0, 60.0);
  return all;
}
double end_of(std::size_t k) { return static_cast<double>(k + 1) / kRateHz; }
PairSquare sure() { return (1e-8 * start_covariance()).eval(); }

TEST(InertialFilter, PerfectSamplesFollowThePathAndStepsMayFallAnywhere) {
  const PairVector start = world().truth(0.0, {});
  const auto once = inertial_filter(inertial_options());
  const auto often = inertial_filter(inertial_options());
  for (const auto* one : {&once, &often}) {
    (*one)->restart(0.0, start, sure());
    for (std::size_t k = 0; k < 1000; ++k) {
      ASSERT_EQ((*one)->add_imu(end_of(k), perfect()[k].delta_theta_b, perfect()[k].delta_velocity_b), ImuStatus::kOk);
    }
  }
  ASSERT_EQ(once->predict(10.0, nullptr), UpdateStatus::kAccepted);
  for (const double dt : {0.0034, 0.0042, 1.2345, 0.0001, 4.7578, 4.0}) {
    ASSERT_EQ(often->predict(dt, nullptr), UpdateStatus::kAccepted);
  }
  EXPECT_LT((once->mean() - world().truth(10.0, {})).head<3>().norm(), 0.01);
  EXPECT_LT((once->mean() - often->mean()).head<6>().norm(), 1e-3);
  EXPECT_LT((once->covariance() - often->covariance()).norm(), 1e-3 * once->covariance().norm());
  EXPECT_NEAR(often->estimate().t_s, 10.0, 1e-12);
  // Without samples it coasts, and knows that it does not know.
  const PairSquare P = once->covariance();
  PairSquare cross;
  ASSERT_EQ(once->predict(2.0, &cross), UpdateStatus::kAccepted);
  const Eigen::Vector3d expected = P.diagonal().head<3>() + 4.0 * P.block<3, 3>(0, 3).diagonal() +
                                   4.0 * P.diagonal().segment<3>(3) + Eigen::Vector3d::Constant(4.0);
  EXPECT_LT((once->covariance().diagonal().head<3>() - expected).norm(), 1e-6 * expected.norm());
  EXPECT_LT((cross.topRightCorner<3, 2>() - P.topRightCorner<3, 2>()).norm(), 1e-6);
  EXPECT_LT((cross.topLeftCorner<3, 3>() - P.topLeftCorner<3, 3>() - 2.0 * P.block<3, 3>(0, 3)).norm(), 1e-6);
}

TEST(InertialFilter, SamplesThatSayNothingAreTimeNobodyKnowsOf) {
  const auto run = [](const std::vector<std::size_t>& spoiled, bool missing) {
    auto options = inertial_options();
    options.limits.accelerometer_range_mps2 = 50.0;
    auto filter = inertial_filter(options);
    filter->restart(0.0, world().truth(0.0, {}), sure());
    for (std::size_t k = 0; k < 300; ++k) {
      Eigen::Vector3d dv = perfect()[k].delta_velocity_b;
      const bool bad = std::find(spoiled.begin(), spoiled.end(), k) != spoiled.end();
      if (bad && missing) continue;
      if (bad) dv[1] = k % 2 == 0 ? kNan : 1.0;
      const ImuStatus status = filter->add_imu(end_of(k), perfect()[k].delta_theta_b, dv);
      if (!bad && missing) continue;  // the one behind the hole is a gap
      EXPECT_EQ(status, !bad ? ImuStatus::kOk : k % 2 == 0 ? ImuStatus::kNonFinite : ImuStatus::kSaturated);
    }
    EXPECT_EQ(filter->add_imu(1.0, Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()), ImuStatus::kReversed);
    EXPECT_EQ(filter->add_imu(kNan, Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()), ImuStatus::kNonFinite);
    EXPECT_EQ(filter->predict(1.5, nullptr), UpdateStatus::kAccepted);
    return filter;
  };
  std::vector<std::size_t> hole;
  for (std::size_t k = 100; k < 150; ++k) hole.push_back(k);
  const auto whole = run({}, false);
  const auto spoiled = run(hole, false);
  const auto missing = run(hole, true);
  EXPECT_TRUE(spoiled->mean().allFinite());
  EXPECT_LT((spoiled->mean() - missing->mean()).norm(), 1e-6);
  // Half a second at an acceleration of 1 m/s² that nobody knows.
  const double grown = missing->covariance()(3, 3) - whole->covariance()(3, 3);
  EXPECT_NEAR(std::sqrt(grown), 0.5, 0.01);
  ASSERT_EQ(missing->predict(1.5, nullptr), UpdateStatus::kAccepted);
  const PairVector error = world().truth(3.0, {}) - missing->mean();
  EXPECT_LT(error.head<3>().norm(), 4.0 * std::sqrt(missing->covariance().topLeftCorner<3, 3>().trace()));
}

TEST(InertialFilter, LateAndTooManySamplesAreNotUsedTwice) {
  const auto filter = inertial_filter(inertial_options());
  filter->restart(0.0, world().truth(0.0, {}), sure());
  auto small = inertial_options();
  small.waiting_samples = 8;
  const auto tight = inertial_filter(small);
  tight->restart(0.0, world().truth(0.0, {}), sure());
  std::size_t k = 0;
  const auto add = [&](InertialFilter& to, std::size_t i) {
    return to.add_imu(end_of(i), perfect()[i].delta_theta_b, perfect()[i].delta_velocity_b);
  };
  for (; k < 50; ++k) ASSERT_EQ(add(*filter, k), ImuStatus::kOk);
  ASSERT_EQ(filter->predict(0.505, nullptr), UpdateStatus::kAccepted);  // 5 ms beyond what is there
  for (; k < 200; ++k) ASSERT_EQ(add(*filter, k), ImuStatus::kOk);
  ASSERT_EQ(filter->predict(1.495, nullptr), UpdateStatus::kAccepted);
  EXPECT_LT((filter->mean() - world().truth(2.0, {})).head<3>().norm(), 0.1);
  // No room: the oldest are integrated at once, and the state is where it should be all the same.
  for (std::size_t i = 0; i < 200; ++i) ASSERT_EQ(add(*tight, i), ImuStatus::kOk);
  ASSERT_EQ(tight->predict(2.0, nullptr), UpdateStatus::kAccepted);
  EXPECT_LT((tight->mean() - world().truth(2.0, {})).head<3>().norm(), 0.01);
}

// One drive of 40 s with an industrial unit; NEES of 17 states and squared errors at its end.
struct InertialRun {
  double nees_end = 0.0, nees_middle = 0.0, filtered = 0.0, smoothed = 0.0, smoothed_nees = 0.0;
};
InertialRun inertial_run(RandomStream random, double wrong = 1.0) {
  auto options = inertial_options();
  options.smoother_steps = 64;
  Eigen::Vector3d b_g = options.gyro_bias_sigma_radps * normals(random, 3);
  Eigen::Vector3d b_a = options.accelerometer_bias_sigma_mps2 * normals(random, 3);
  const Eigen::Vector3d tilt =
      Eigen::Vector3d(0.01, 0.01, 0.0175).cwiseProduct(Eigen::Vector3d(normals(random, 3)));  // about n
  const Eigen::Vector4d turn = soopnav::detail::rotation_exp(-tilt);
  options.q_n_b = Eigen::Quaterniond(turn[0], turn[1], turn[2], turn[3]) * world().path.at(0.0).q_n_b;
  const auto filter = inertial_filter(options);
  filter->restart(0.0, wrong_start(random), start_covariance());
  const double root = wrong / std::sqrt(kRateHz);
  for (std::size_t k = 0; k < 4000; ++k) {
    const Eigen::Vector3d dt = perfect()[k].delta_theta_b + b_g / kRateHz +
                               options.noise.gyro_density * root * Eigen::Vector3d(normals(random, 3));
    const Eigen::Vector3d dv = perfect()[k].delta_velocity_b + b_a / kRateHz +
                               options.noise.accelerometer_density * root * Eigen::Vector3d(normals(random, 3));
    EXPECT_EQ(filter->add_imu(end_of(k), dt, dv), ImuStatus::kOk);
  }
  const Eigen::Matrix3d T_e_n = world().path.frame().rotation_from_ecef().transpose();
  const auto error_of = [&](const InertialPairEstimate& x, const PairVector& truth) {
    Eigen::Matrix<double, 17, 1> e;
    e.head<8>() = truth - x.mean;
    const Eigen::Quaterniond q(T_e_n * world().path.at(x.t_s).q_n_b.toRotationMatrix());
    const Eigen::Quaterniond d = x.q_e_b.conjugate() * q;
    e.segment<3>(8) = soopnav::detail::rotation_log({d.w(), d.x(), d.y(), d.z()});
    e.segment<3>(11) = b_g - x.gyro_bias;
    e.tail<3>() = b_a - x.accelerometer_bias;
    return e;
  };
  InertialRun out;
  std::vector<PairVector> truths{world().truth(0.0, {3e4, 40.0})};
  std::vector<InertialPairEstimate> filtered{filter->estimate()};
  double t = 0.0;
  for (const Drawn& burst : drive(random.substream(9), 40.0)) {
    EXPECT_EQ(filter->predict(burst.t_s - t, nullptr), UpdateStatus::kAccepted);
    EXPECT_TRUE(filter
                    ->update(model_at(burst.beacon, burst.t_s), static_cast<int>(burst.beacon),
                             world().observed(burst.beacon, burst.t_s, burst.z), {})
                    .accepted());
    t = burst.t_s;
    truths.push_back(burst.truth);
    filtered.push_back(filter->estimate());
  }
  const auto smoothed = filter->smooth();
  EXPECT_EQ(smoothed.size(), filtered.size());
  if (smoothed.size() != filtered.size()) return out;
  for (std::size_t k = 1; k < filtered.size(); ++k) {
    EXPECT_EQ(smoothed[k].t_s, filtered[k].t_s);
    out.filtered += (truths[k] - filtered[k].mean).head<3>().squaredNorm();
    out.smoothed += (truths[k] - smoothed[k].mean).head<3>().squaredNorm();
  }
  out.nees_end = nees(error_of(filtered.back(), truths.back()), filtered.back().covariance).value_or(kNan);
  out.nees_middle = nees(error_of(filtered[20], truths[20]), filtered[20].covariance).value_or(kNan);
  out.smoothed_nees = nees(error_of(smoothed[20], truths[20]), smoothed[20].covariance).value_or(kNan);
  return out;
}

TEST(InertialFilter, IsConsistentAndItsSmootherBetter) {
  constexpr int kRuns = 20;
  InertialRun sum;
  double wrong = 0.0;
  for (int run = 0; run < kRuns; ++run) {
    const RandomStream random = RandomStream(81).substream(static_cast<std::uint64_t>(run));
    const InertialRun one = inertial_run(random);
    sum.nees_end += one.nees_end / kRuns;
    sum.nees_middle += one.nees_middle / kRuns;
    sum.smoothed_nees += one.smoothed_nees / kRuns;
    sum.filtered += one.filtered;
    sum.smoothed += one.smoothed;
    if (run < 4) wrong += inertial_run(random, 8.0).nees_end / 4.0;
  }
  const MeanBounds bounds = mean_nees_bounds(17.0, kRuns, 3e-5);
  for (const double mean : {sum.nees_end, sum.nees_middle, sum.smoothed_nees}) {
    EXPECT_GT(mean, bounds.lower);
    EXPECT_LT(mean, bounds.upper);
  }
  EXPECT_GT(wrong, bounds.upper);  // a unit eight times worse than stated shows
  EXPECT_LT(sum.smoothed, 0.6 * sum.filtered);
  std::printf("nees %.1f %.1f smoothed %.1f, wrong %.1f, rms %.2f -> %.2f m\n", sum.nees_end, sum.nees_middle,
              sum.smoothed_nees, wrong, std::sqrt(sum.filtered / (40.0 * kRuns)),
              std::sqrt(sum.smoothed / (40.0 * kRuns)));
}

TEST(InertialFilter, RefusesAndComesBack) {
  const auto refused = [](auto&& change) {
    auto options = inertial_options();
    change(options);
    EXPECT_THROW(static_cast<void>(inertial_filter(options)), std::invalid_argument);
  };
  refused([](auto& o) { o.tilt_sigma_rad = 0.0; });
  refused([](auto& o) { o.accelerometer_bias_sigma_mps2 = kNan; });
  refused([](auto& o) { o.q_n_b.coeffs() *= 2.0; });
  refused([](auto& o) { o.waiting_samples = 0; });
  refused([](auto& o) { o.smoother_steps = -1; });
  refused([](auto& o) { o.limits.period_s = 0.0; });
  const auto filter = inertial_filter(inertial_options());
  EXPECT_THROW(filter->restart(kNan, world().truth(0.0, {}), sure()), std::invalid_argument);
  filter->restart(0.0, world().truth(0.0, {}), sure());
  EXPECT_EQ(filter->predict(-1.0, nullptr), UpdateStatus::kTimeNotAdvancing);
  for (std::size_t k = 0; k < 200; ++k) {
    static_cast<void>(filter->add_imu(end_of(k), perfect()[k].delta_theta_b, perfect()[k].delta_velocity_b));
  }
  filter->save();
  ASSERT_EQ(filter->predict(1.005, nullptr), UpdateStatus::kAccepted);
  const PairVector once = filter->mean();
  filter->load();
  ASSERT_EQ(filter->predict(1.005, nullptr), UpdateStatus::kAccepted);
  EXPECT_EQ(filter->mean(), once);  // the same samples again
  EXPECT_TRUE(filter->smooth().empty());
}

// ---- None of them allocates

TEST(CooperativeMotion, NothingAllocatesOnceMade) {
  if (!kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  const PairVector x = world().truth(0.0, {});
  auto options = inertial_options();
  options.smoother_steps = 16;
  const auto with_imu = inertial_filter(options);
  const auto modes = manoeuvre_filter(manoeuvre_options());
  with_imu->restart(0.0, x, start_covariance());
  modes->restart(0.0, x, start_covariance());
  const Eigen::Vector2d z = world().measured(0, 1.0, world().truth(1.0, {}));
  const auto observed = world().observed(0, 1.0, z);
  const auto one = perfect()[0];
  const PairModel<> model = model_at(0, 1.0);
  bool good = true;
  EXPECT_EQ(allocations_of([&] {
              for (std::size_t k = 0; k < 120; ++k) {
                good = with_imu->add_imu(end_of(k), one.delta_theta_b, one.delta_velocity_b) == ImuStatus::kOk && good;
              }
              PairSquare cross;
              for (CooperativeFilter* filter :
                   {static_cast<CooperativeFilter*>(with_imu.get()), static_cast<CooperativeFilter*>(modes.get())}) {
                filter->save();
                good = filter->predict(1.0, &cross) == UpdateStatus::kAccepted && good;
                good = filter->update(model, 0, observed, {}).accepted() && good;
                good = filter->update(PlaneDistance<>{}, 1e3, 1e14).accepted() && good;
                good = filter->reopen_clock(1.0, 1.0) == UpdateStatus::kAccepted && good;
                filter->load();
              }
            }),
            0);
  EXPECT_TRUE(good);
}

TEST(CooperativeGroup, NothingAllocatesOnceMade) {
  if (!kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  const PairVector x = world().truth(0.0, {});
  GroupOptions options;
  options.gate_probability = 1e-4;
  CooperativeGroup group(world().beacons, 0.0, options);
  const Eigen::Vector2d z = world().measured(0, 1.0, world().truth(1.0, {}));
  const GroupRow rows[3] = {{0, -1, z[0], z[1], world().R, 2.0, 2.0},
                            {1, -1, z[0], z[1], world().R, 2.0, 2.0},
                            {0, 1, 0.0, 0.0, world().R, 2.0, 2.0}};
  GroupRow late[2] = {rows[0], rows[1]};
  for (GroupRow& row : late) row.tdoa_s += 1e-3;
  GroupStatus status[3];
  GroupStatus jumped[2];
  const GroupBurst burst{1.0, 0, world().carrier_hz, world().anchor_p_e, Eigen::Vector3d::Zero()};
  bool good = true;
  EXPECT_EQ(allocations_of([&] {
              good = group.join(x, start_covariance()) == 0 && group.join(x, start_covariance()) == 1;
              good = group.update(burst, rows, status) && good;
              for (int k = 0; k < 3; ++k) good = group.update(burst, late, jumped) && good;
              good = group.leave(1) && good;
            }),
            0);
  EXPECT_TRUE(good);
  EXPECT_EQ(status[2], GroupStatus::kAccepted);
  EXPECT_EQ(jumped[1], GroupStatus::kClockJump);
}

}  // namespace
}  // namespace soopnav::test
