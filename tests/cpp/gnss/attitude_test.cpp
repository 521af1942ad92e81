// Attitude from path differences: exactness, covariances, the filters against the printed gain form, and their NEES.

#include "soopnav/gnss/attitude.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/consistency.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::gnss {
namespace {

using geometry::Euler;

constexpr double kWavelengthM = 0.19029367;
constexpr double kDeg = kPi / 180.0;
const double kNan = AttitudeFix::kNan;

// Eight satellites, 15 to 75 deg high, north-east-down.
std::vector<Eigen::Vector3d> sky(std::size_t count = 8) {
  std::vector<Eigen::Vector3d> out;
  for (std::size_t i = 0; i < count; ++i) {
    const double az = 2.4 * static_cast<double>(i), el = kDeg * (15.0 + 60.0 * static_cast<double>(i % 5) / 4.0);
    out.emplace_back(std::cos(el) * std::cos(az), std::cos(el) * std::sin(az), -std::sin(el));
  }
  return out;
}

AttitudeModel two_antennas(double sigma_m = 0.005) {
  AttitudeModel model;
  model.baselines_m = {{0.9 * kWavelengthM, 0.0, 0.0}, {0.0, 0.9 * kWavelengthM, 0.0}};
  model.sigma_m = sigma_m;
  return model;
}

PathMatrix paths(const AttitudeModel& model, const Eigen::Matrix3d& T_n_b, const std::vector<Eigen::Vector3d>& u) {
  PathMatrix y(model.baselines_m.size(), u.size());
  for (Eigen::Index i = 0; i < y.rows(); ++i) {
    for (Eigen::Index s = 0; s < y.cols(); ++s) {
      y(i, s) = (T_n_b * model.baselines_m[static_cast<std::size_t>(i)]).dot(u[static_cast<std::size_t>(s)]);
    }
  }
  return y;
}

void add_noise(PathMatrix& y, double sigma, RandomStream& random) {
  for (double& x : y.reshaped()) x += sigma * random.normal();
}

double angle_between(const Eigen::Quaterniond& a, const Eigen::Matrix3d& T) {
  return geometry::rotation_vector_from_quaternion(a.conjugate() * geometry::quaternion_from_rotation(T)).norm();
}

Euler random_euler(RandomStream& random) {
  return {random.uniform(-3.1, 3.1), random.uniform(-1.5, 1.5), random.uniform(-3.1, 3.1)};
}

TEST(ArrivalAngle, TheFormulaAndItsEdges) {
  EXPECT_NEAR(arrival_angle(0.5, 1.0), kPi / 3.0, 1e-15);
  EXPECT_EQ(arrival_angle(1.2, 1.0), 0.0);
  EXPECT_NEAR(arrival_angle(-1.2, 1.0), kPi, 1e-15);
  EXPECT_TRUE(std::isnan(arrival_angle(kNan, 1.0)));
  EXPECT_TRUE(std::isnan(arrival_angle(0.1, 0.0)));
  EXPECT_NEAR(arrival_angle_sigma(kPi / 2.0, 0.5, 0.01), 0.02, 1e-15);
  EXPECT_TRUE(std::isinf(arrival_angle_sigma(0.0, 0.5, 0.01)));
  EXPECT_TRUE(std::isnan(arrival_angle_sigma(1.0, -0.5, 0.01)));
  EXPECT_TRUE(std::isnan(arrival_angle_sigma(1.0, 0.5, -0.01)));
}

TEST(AttitudeFix, ExactForExactPhasesAtAnyAttitude) {
  RandomStream random(21);
  const auto u = sky();
  for (int trial = 0; trial < 50; ++trial) {
    AttitudeModel model = two_antennas();
    if (trial % 2 == 1) model.baselines_m.emplace_back(0.3, -0.2, 0.4);
    model.common_clock = trial % 3 != 0;
    const Eigen::Matrix3d T = geometry::rotation_from_euler(random_euler(random));
    PathMatrix y = paths(model, T, u);
    if (!model.common_clock) {
      for (Eigen::Index i = 0; i < y.rows(); ++i) y.row(i).array() += random.uniform(-1.0, 1.0);
    }
    const AttitudeFix fix = attitude_fix(model, u, y);
    ASSERT_TRUE(fix.solved()) << to_string(fix.status);
    EXPECT_LT(angle_between(fix.q_n_b, T), 1e-7);
    EXPECT_LT(fix.chi_square, 1e-9);
  }
}

TEST(AttitudeFix, SignsOfTheAngles) {
  // Antenna 1 ahead: nosing up brings it nearer to a satellite overhead. Antenna 2 to the right: rolling right lowers
  // it.
  const AttitudeModel model = two_antennas();
  const std::vector<Eigen::Vector3d> overhead{{0.0, 0.0, -1.0}};
  EXPECT_GT(paths(model, geometry::rotation_from_euler({0.0, 0.2, 0.0}), overhead)(0, 0), 0.0);
  EXPECT_LT(paths(model, geometry::rotation_from_euler({0.0, 0.0, 0.2}), overhead)(1, 0), 0.0);
  // Turning east brings the nose towards a satellite in the east.
  const std::vector<Eigen::Vector3d> east{{0.0, 1.0, 0.0}};
  EXPECT_GT(paths(model, geometry::rotation_from_euler({0.2, 0.0, 0.0}), east)(0, 0), 0.0);
}

TEST(AttitudeFix, CovarianceIsThatOfTheErrors) {
  RandomStream random(22);
  const auto u = sky();
  for (const bool shared : {false, true}) {
    AttitudeModel model = two_antennas(0.002);
    model.shared_reference = shared;
    const Eigen::Matrix3d T = geometry::rotation_from_euler({0.7, 0.3, -0.4});
    const PathMatrix clean = paths(model, T, u);
    double nees = 0.0, euler_nees = 0.0, chi_square = 0.0;
    constexpr int kRuns = 1500;
    int dof = 0;
    for (int run = 0; run < kRuns; ++run) {
      PathMatrix y = clean;
      if (shared) {
        for (Eigen::Index s = 0; s < y.cols(); ++s) {
          y.col(s).array() += random.normal() * model.sigma_m / std::sqrt(2.0);
        }
        add_noise(y, model.sigma_m / std::sqrt(2.0), random);
      } else {
        add_noise(y, model.sigma_m, random);
      }
      const AttitudeFix fix = attitude_fix(model, u, y);
      ASSERT_TRUE(fix.solved());
      const Eigen::Vector3d d =
          geometry::rotation_vector_from_quaternion(fix.q_n_b.conjugate() * geometry::quaternion_from_rotation(T));
      nees += d.dot(fix.covariance_rad2.llt().solve(d)) / kRuns;
      const Eigen::Vector3d e(0.7 - fix.euler.yaw_rad, 0.3 - fix.euler.pitch_rad, -0.4 - fix.euler.roll_rad);
      euler_nees += e.dot(fix.euler_covariance_rad2.llt().solve(e)) / kRuns;
      chi_square += fix.chi_square / kRuns;
      dof = fix.degrees_of_freedom;
    }
    const auto bounds = mean_nees_bounds(3, kRuns, 1e-6);
    EXPECT_GT(nees, bounds.lower) << shared;
    EXPECT_LT(nees, bounds.upper) << shared;
    EXPECT_GT(euler_nees, 0.99 * bounds.lower) << shared;  // second order in the angles
    EXPECT_LT(euler_nees, 1.01 * bounds.upper) << shared;
    ASSERT_EQ(dof, 13);
    const auto residual = mean_nees_bounds(13, kRuns, 1e-6);
    EXPECT_GT(chi_square, 0.99 * residual.lower) << shared;
    EXPECT_LT(chi_square, 1.01 * residual.upper) << shared;
  }
}

TEST(AttitudeFix, BadInputGivesAStatus) {
  const AttitudeModel model = two_antennas();
  const auto u = sky();
  const Eigen::Matrix3d T = geometry::rotation_from_euler({0.3, 0.1, 0.2});
  const PathMatrix y = paths(model, T, u);
  const auto status = [&](const AttitudeModel& m, const std::vector<Eigen::Vector3d>& sats, const PathMatrix& path) {
    return attitude_fix(m, sats, path).status;
  };
  EXPECT_EQ(status(model, {}, PathMatrix(2, 0)), AttitudeStatus::kTooFewSatellites);
  EXPECT_EQ(status(model, {u[0]}, y.leftCols(1)), AttitudeStatus::kTooFewSatellites);
  EXPECT_EQ(status(model, {u[0], u[1]}, y.leftCols(2)), AttitudeStatus::kTooFewSatellites);
  EXPECT_EQ(status(model, u, PathMatrix::Constant(2, 8, kNan)), AttitudeStatus::kTooFewSatellites);

  // Satellites in one vertical plane: without a start the mirror image is as good.
  std::vector<Eigen::Vector3d> plane;
  for (int i = 0; i < 6; ++i) plane.emplace_back(std::cos(0.4 * i), 0.0, -std::sin(0.4 * i));
  const PathMatrix flat = paths(model, T, plane);
  EXPECT_EQ(status(model, plane, flat), AttitudeStatus::kSatellitesInPlane);
  const AttitudeFix near = attitude_fix(model, plane, flat, geometry::quaternion_from_rotation(T));
  EXPECT_TRUE(near.solved());
  EXPECT_LT(angle_between(near.q_n_b, T), 1e-6);

  // One baseline: the turn about it is free, and named.
  AttitudeModel one = model;
  one.baselines_m.pop_back();
  const AttitudeFix free = attitude_fix(one, u, y.topRows(1));
  EXPECT_EQ(free.status, AttitudeStatus::kUnobservable);
  EXPECT_NEAR(std::abs(free.unobservable_b.x()), 1.0, 1e-6);
  EXPECT_NEAR((free.q_n_b * Eigen::Vector3d::UnitX()).dot(T.col(0)), 1.0, 1e-9);

  // A NaN is one measurement less, and a direction that is none takes its column with it.
  PathMatrix holes = y;
  holes(0, 3) = kNan;
  EXPECT_EQ(attitude_fix(model, u, holes).degrees_of_freedom, 12);
  auto broken = u;
  broken[2] *= 2.0;
  const AttitudeFix without = attitude_fix(model, broken, y);
  EXPECT_TRUE(without.solved());
  EXPECT_EQ(without.degrees_of_freedom, 11);
  EXPECT_EQ(attitude_fix(model, u, y, Eigen::Quaterniond(kNan, 0, 0, 0)).status, AttitudeStatus::kNonFinite);

  // At gimbal lock there is an attitude, but no covariance of Euler angles.
  const Eigen::Matrix3d up = geometry::rotation_from_euler({0.3, kPi / 2.0, 0.0});
  const AttitudeFix lock = attitude_fix(model, u, paths(model, up, u));
  EXPECT_TRUE(lock.solved());
  EXPECT_LT(angle_between(lock.q_n_b, up), 1e-7);
  EXPECT_TRUE(std::isnan(lock.euler_covariance_rad2(0, 0)));
  EXPECT_TRUE(lock.covariance_rad2.allFinite());
}

TEST(AttitudeModel, RefusesByName) {
  AttitudeModel model = two_antennas();
  EXPECT_NO_THROW(model.check());
  const auto refused = [](AttitudeModel m) { EXPECT_THROW(m.check(), std::invalid_argument); };
  AttitudeModel bad = model;
  bad.baselines_m.clear();
  refused(bad);
  bad.baselines_m.assign(9, {1.0, 0.0, 0.0});
  refused(bad);
  bad.baselines_m = {{0.0, 0.0, 0.0}};
  refused(bad);
  bad.baselines_m = {{kNan, 0.0, 0.0}};
  refused(bad);
  bad = model;
  bad.sigma_m = 0.0;
  refused(bad);
  bad = model;
  bad.shared_reference = true;
  bad.common_clock = false;
  refused(bad);
  const Eigen::Quaterniond q = Eigen::Quaterniond::Identity();
  const Eigen::Matrix3d P = Eigen::Matrix3d::Identity();
  EXPECT_NO_THROW(AttitudeFilter(model, {}, q, Eigen::Matrix3d::Zero()));
  EXPECT_THROW(AttitudeFilter(model, {}, Eigen::Quaterniond(2, 0, 0, 0), P), std::invalid_argument);
  EXPECT_THROW(AttitudeFilter(model, {}, q, -P), std::invalid_argument);
  EXPECT_THROW(AttitudeFilter(model, {}, q, P * kNan), std::invalid_argument);
  Eigen::Matrix3d skewed = P;
  skewed(0, 1) = 0.1;
  EXPECT_THROW(AttitudeFilter(model, {}, q, skewed), std::invalid_argument);
  EXPECT_THROW(AttitudeFilter(model, {.rate_noise_rad_rts = -1.0}, q, P), std::invalid_argument);
  EXPECT_THROW(AttitudeFilter(model, {.false_alarm_probability = 0.5}, q, P), std::invalid_argument);
}

TEST(RotationFromEulerChange, IsTheDerivativeOfTheRotation) {
  RandomStream random(23);
  for (int trial = 0; trial < 20; ++trial) {
    const Euler e = random_euler(random);
    const Eigen::Matrix3d T = geometry::rotation_from_euler(e);
    const Eigen::Matrix3d E = rotation_from_euler_change(e);
    for (int i = 0; i < 3; ++i) {
      constexpr double kStep = 1e-5;
      const auto moved = [&](double h) {
        Euler x = e;
        (i == 0 ? x.yaw_rad : i == 1 ? x.pitch_rad : x.roll_rad) += h;
        return geometry::rotation_vector_from_quaternion(
            geometry::quaternion_from_rotation(T.transpose() * geometry::rotation_from_euler(x)));
      };
      const Eigen::Vector3d numeric = (moved(kStep) - moved(-kStep)) / (2.0 * kStep);
      EXPECT_LT((numeric - E.col(i)).norm(), 1e-8);
    }
  }
}

// Carter (3.22) to (3.26) as they are written, with the predicted P in the last and numeric derivatives for (3.21).
TEST(AttitudeFilter, EulerFormIsThePapersGainForm) {
  RandomStream random(24);
  const AttitudeModel model = two_antennas(0.01);
  const auto u = sky();
  const auto h = [&](const Eigen::Vector3d& e) {
    const PathMatrix y = paths(model, geometry::rotation_from_euler({e[0], e[1], e[2]}), u);
    return Eigen::VectorXd(y.reshaped<Eigen::RowMajor>());
  };
  Eigen::Vector3d x(0.4, -0.2, 0.3);
  Eigen::Matrix3d P = Eigen::Vector3d(0.01, 0.02, 0.03).asDiagonal();
  AttitudeFilter filter(model, {.parameters = AttitudeParameters::kEuler, .rate_noise_rad_rts = 0.05},
                        geometry::quaternion_from_rotation(geometry::rotation_from_euler({x[0], x[1], x[2]})), P);
  for (int epoch = 0; epoch < 5; ++epoch) {
    PathMatrix y = paths(model, geometry::rotation_from_euler({0.45, -0.15, 0.25}), u);
    add_noise(y, 0.01, random);
    ASSERT_EQ(filter.predict(0.1), AttitudeStatus::kSolved);
    const AttitudeUpdate report = filter.update(u, y);
    ASSERT_EQ(report.status, AttitudeStatus::kSolved);
    P += 0.05 * 0.05 * 0.1 * Eigen::Matrix3d::Identity();
    Eigen::MatrixXd H(16, 3);
    for (int i = 0; i < 3; ++i) {
      const Eigen::Vector3d step = 1e-5 * Eigen::Vector3d::Unit(i);
      H.col(i) = (h(x + step) - h(x - step)) / 2e-5;
    }
    const Eigen::MatrixXd S = H * P * H.transpose() + 1e-4 * Eigen::MatrixXd::Identity(16, 16);
    const Eigen::MatrixXd K = P * H.transpose() * S.inverse();
    const Eigen::VectorXd innovation = y.reshaped<Eigen::RowMajor>() - h(x);
    x += K * innovation;
    P = (Eigen::Matrix3d::Identity() - K * H) * P;
    EXPECT_EQ(report.rows, 16);
    EXPECT_NEAR(report.nis, innovation.dot(S.ldlt().solve(innovation)), 1e-6 * (1.0 + report.nis));
    EXPECT_NEAR(filter.euler().yaw_rad, x[0], 1e-8);
    EXPECT_NEAR(filter.euler().pitch_rad, x[1], 1e-8);
    EXPECT_NEAR(filter.euler().roll_rad, x[2], 1e-8);
    EXPECT_LT((filter.covariance_rad2() - P).norm(), 1e-7 * P.norm());
  }
}

TEST(AttitudeFilter, RatesMoveBothFormsAlike) {
  const AttitudeModel model = two_antennas();
  const Eigen::Quaterniond q = geometry::quaternion_from_rotation(geometry::rotation_from_euler({0.3, 0.4, -0.5}));
  const Eigen::Matrix3d P = 1e-4 * Eigen::Matrix3d::Identity();
  const Eigen::Matrix3d E = rotation_from_euler_change({0.3, 0.4, -0.5});
  AttitudeFilter quaternion(model, {.rate_noise_rad_rts = 0.0}, q, E * P * E.transpose());
  AttitudeFilter euler(model, {.parameters = AttitudeParameters::kEuler, .rate_noise_rad_rts = 0.0}, q, P);
  const Eigen::Vector3d rate(0.2, -0.1, 0.3);
  for (int i = 0; i < 2000; ++i) {
    ASSERT_EQ(quaternion.predict(1e-3, rate), AttitudeStatus::kSolved);
    ASSERT_EQ(euler.predict(1e-3, rate), AttitudeStatus::kSolved);
  }
  EXPECT_LT(quaternion.attitude().angularDistance(euler.attitude()), 1e-3);
  const Eigen::Matrix3d now = rotation_from_euler_change(euler.euler());
  const Eigen::Matrix3d moved = now * euler.covariance_rad2() * now.transpose();
  EXPECT_LT((moved - quaternion.covariance_rad2()).norm(), 2e-3 * moved.norm());
  EXPECT_GT((euler.covariance_rad2() - P).norm(), 0.05 * P.norm());  // so the transition matters
  EXPECT_EQ(quaternion.predict(-1.0), AttitudeStatus::kNonFinite);
  EXPECT_EQ(quaternion.predict(0.1, Eigen::Vector3d::Constant(kNan)), AttitudeStatus::kNonFinite);
}

// NEES over runs in which truth walks as the filter believes, started with errors drawn from P0.
double mean_nees(AttitudeParameters parameters, int runs, bool rates) {
  const AttitudeModel model = two_antennas(0.01);
  const auto u = sky();
  double total = 0.0;
  for (int run = 0; run < runs; ++run) {
    RandomStream random(31, static_cast<std::uint64_t>(run));
    const auto draw = [&](double sigma) -> Eigen::Vector3d {
      const double x = random.normal(), y = random.normal(), z = random.normal();
      return sigma * Eigen::Vector3d(x, y, z);
    };
    Eigen::Quaterniond truth = geometry::quaternion_from_rotation(geometry::rotation_from_euler({0.5, 0.2, -0.3}));
    const bool as_quaternion = parameters == AttitudeParameters::kQuaternion;
    Eigen::Quaterniond start = truth;
    if (as_quaternion) {
      start = truth * geometry::quaternion_from_rotation_vector(-draw(0.05));
    } else {
      const Eigen::Vector3d d = draw(0.05);
      start = geometry::quaternion_from_rotation(geometry::rotation_from_euler({0.5 + d[0], 0.2 + d[1], -0.3 + d[2]}));
    }
    AttitudeFilter filter(model, {.parameters = parameters, .rate_noise_rad_rts = 0.02}, start,
                          0.05 * 0.05 * Eigen::Matrix3d::Identity());
    for (int epoch = 1; epoch <= 60; ++epoch) {
      const Eigen::Vector3d rate = rates ? Eigen::Vector3d(0.1, -0.2, 0.5) : Eigen::Vector3d::Zero();
      const Eigen::Vector3d walk = draw(0.02 * std::sqrt(0.1));
      if (as_quaternion) {
        truth = truth * geometry::quaternion_from_rotation_vector(rate * 0.1) *
                geometry::quaternion_from_rotation_vector(walk);
      } else {
        const Euler e = geometry::euler_from_rotation(truth.toRotationMatrix());
        truth = geometry::quaternion_from_rotation(
            geometry::rotation_from_euler({e.yaw_rad + walk[0], e.pitch_rad + walk[1], e.roll_rad + walk[2]}));
      }
      PathMatrix y = paths(model, truth.toRotationMatrix(), u);
      add_noise(y, model.sigma_m, random);
      if (filter.predict(0.1, rate) != AttitudeStatus::kSolved) return kNan;
      if (filter.update(u, y).status != AttitudeStatus::kSolved) return kNan;
    }
    Eigen::Vector3d e;
    if (as_quaternion) {
      e = geometry::rotation_vector_from_quaternion(filter.attitude().conjugate() * truth);
    } else {
      const Euler t = geometry::euler_from_rotation(truth.toRotationMatrix());
      e << t.yaw_rad - filter.euler().yaw_rad, t.pitch_rad - filter.euler().pitch_rad,
          t.roll_rad - filter.euler().roll_rad;
    }
    total += e.dot(filter.covariance_rad2().llt().solve(e)) / runs;
  }
  return total;
}

TEST(AttitudeFilter, IsConsistent) {
  constexpr int kRuns = 250;
  const auto bounds = mean_nees_bounds(3, kRuns, 1e-5);
  for (const double nees :
       {mean_nees(AttitudeParameters::kQuaternion, kRuns, false),
        mean_nees(AttitudeParameters::kQuaternion, kRuns, true), mean_nees(AttitudeParameters::kEuler, kRuns, false)}) {
    EXPECT_GT(nees, bounds.lower);
    EXPECT_LT(nees, bounds.upper);
  }
}

TEST(AttitudeFilter, RefusalsLeaveTheStateAlone) {
  const AttitudeModel model = two_antennas();
  const auto u = sky();
  const Eigen::Quaterniond q = geometry::quaternion_from_rotation(geometry::rotation_from_euler({0.3, 0.1, 0.2}));
  AttitudeFilter filter(model, {.false_alarm_probability = 1e-4}, q, 1e-4 * Eigen::Matrix3d::Identity());
  const PathMatrix y = paths(model, q.toRotationMatrix(), u);
  const auto untouched = [&] {
    return filter.attitude().coeffs() == q.normalized().coeffs() && filter.covariance_rad2()(0, 0) == 1e-4;
  };
  EXPECT_EQ(filter.update(u, PathMatrix::Constant(2, 8, kNan)).status, AttitudeStatus::kTooFewSatellites);
  EXPECT_TRUE(untouched());
  PathMatrix jump = y;
  jump(0, 0) += kWavelengthM;  // a cycle slip
  const AttitudeUpdate gated = filter.update(u, jump);
  EXPECT_EQ(gated.status, AttitudeStatus::kGated);
  EXPECT_GT(gated.nis, 100.0);
  EXPECT_TRUE(untouched());
  EXPECT_EQ(filter.update(u, y).status, AttitudeStatus::kSolved);

  const Eigen::Quaterniond up = geometry::quaternion_from_rotation(geometry::rotation_from_euler({0.3, 1.565, 0.2}));
  AttitudeFilter euler(model, {.parameters = AttitudeParameters::kEuler}, up, 1e-4 * Eigen::Matrix3d::Identity());
  EXPECT_EQ(euler.update(u, paths(model, up.toRotationMatrix(), u)).status, AttitudeStatus::kGimbalLock);
  EXPECT_EQ(euler.predict(0.1, Eigen::Vector3d::UnitX()), AttitudeStatus::kGimbalLock);
  EXPECT_EQ(euler.predict(0.1), AttitudeStatus::kSolved);
  AttitudeFilter quaternion(model, {}, up, 1e-4 * Eigen::Matrix3d::Identity());
  EXPECT_EQ(quaternion.update(u, paths(model, up.toRotationMatrix(), u)).status, AttitudeStatus::kSolved);
}

TEST(Integers, ResolvedAboutAPredictionNotDropped) {
  RandomStream random(25);
  const auto u = sky();
  int beyond = 0, all = 0;
  for (int trial = 0; trial < 200; ++trial) {
    AttitudeModel model = two_antennas();
    model.common_clock = trial % 2 == 0;
    const Euler e = random_euler(random);
    const Eigen::Matrix3d T = geometry::rotation_from_euler(e);
    const PathMatrix y = paths(model, T, u);
    PathMatrix wrapped(2, 8), path(2, 8);
    for (Eigen::Index i = 0; i < 2; ++i) {
      const double clock = model.common_clock ? 0.0 : random.uniform(-5.0, 5.0);
      for (Eigen::Index s = 0; s < 8; ++s) {
        const double cycles = -y(i, s) / kWavelengthM + clock;
        wrapped(i, s) = cycles - std::round(cycles);
        beyond += std::abs(y(i, s)) > 0.5 * kWavelengthM ? 1 : 0;
        ++all;
      }
    }
    const auto near = geometry::quaternion_from_rotation(T) *
                      geometry::quaternion_from_rotation_vector(0.1 * Eigen::Vector3d::UnitZ());
    const double farthest = resolve_cycles(model, near, u, wrapped, kWavelengthM, path);
    EXPECT_LT(farthest, 0.3);
    const AttitudeFix fix = attitude_fix(model, u, path);
    ASSERT_TRUE(fix.solved());
    EXPECT_LT(angle_between(fix.q_n_b, T), 1e-6);
    if (model.common_clock) {
      EXPECT_LT((path - y).cwiseAbs().maxCoeff(), 1e-9);
    }
  }
  EXPECT_GT(beyond, all / 3);  // so (2.26), without N, is wrong for more than a third
  PathMatrix path(2, 8);
  EXPECT_TRUE(std::isnan(resolve_cycles(two_antennas(), Eigen::Quaterniond::Identity(), u,
                                        PathMatrix::Constant(2, 8, kNan), kWavelengthM, path)));
  EXPECT_TRUE(std::isnan(path(0, 0)));
}

TEST(Integers, AcquiredWithoutAStart) {
  RandomStream random(26);
  const auto u = sky();
  AttitudeModel model = two_antennas(0.003);
  int solved = 0;
  for (int trial = 0; trial < 25; ++trial) {
    const Eigen::Matrix3d T = geometry::rotation_from_euler(random_euler(random));
    PathMatrix y = paths(model, T, u);
    add_noise(y, model.sigma_m, random);
    const PathMatrix cycles = -y / kWavelengthM;
    const PathMatrix wrapped = cycles.array() - cycles.array().round();
    const AttitudeFix fix = acquire_attitude(model, u, wrapped, kWavelengthM);
    if (!fix.solved()) continue;
    ++solved;
    EXPECT_LT(angle_between(fix.q_n_b, T), 0.1) << trial;
    EXPECT_GE(fix.ratio, 3.0);
  }
  EXPECT_GE(solved, 24);
  const PathMatrix zero = PathMatrix::Zero(2, 8);
  AttitudeModel parallel = model;
  parallel.baselines_m[1] = -model.baselines_m[0];
  EXPECT_EQ(acquire_attitude(parallel, u, zero, kWavelengthM).status, AttitudeStatus::kUnobservable);
  AttitudeModel clocks = model;
  clocks.common_clock = false;
  EXPECT_EQ(acquire_attitude(clocks, u, zero, kWavelengthM).status, AttitudeStatus::kUnobservable);
  EXPECT_FALSE(acquire_attitude(model, u, PathMatrix::Constant(2, 8, kNan), kWavelengthM).solved());
}

TEST(HeadingError, ClosedFormAgainstDraws) {
  RandomStream random(27);
  for (const double kappa : {0.0, 0.5, 2.0, 5.0, 40.0}) {
    const double sigma = 0.5, baseline = kappa * std::sqrt(2.0) * sigma;
    const HeadingError error = heading_error(baseline, sigma);
    constexpr int kDraws = 60'000;
    double squares = 0.0, fourths = 0.0;
    int inverted = 0;
    for (int i = 0; i < kDraws; ++i) {
      const double x0 = random.normal(), y0 = random.normal(), x1 = random.normal(), y1 = random.normal();
      const double off = std::atan2(sigma * (x1 - x0), baseline + sigma * (y1 - y0));
      squares += off * off / kDraws;
      fourths += off * off * off * off / kDraws;
      inverted += std::abs(off) > kPi / 2.0 ? 1 : 0;
    }
    const double slack = 4.5 * std::sqrt((fourths - squares * squares) / kDraws);
    EXPECT_NEAR(error.rms_rad * error.rms_rad, squares, slack) << kappa;
    const double p = error.inversion_probability;
    EXPECT_NEAR(p, inverted / static_cast<double>(kDraws), 4.5 * std::sqrt(p * (1.0 - p) / kDraws) + 1e-9) << kappa;
  }
  EXPECT_NEAR(heading_error(0.0, 1.0).rms_rad, kPi / std::sqrt(3.0), 1e-9);
  EXPECT_NEAR(heading_error(100.0, 0.1).rms_rad / heading_error(100.0, 0.1).linear_sigma_rad, 1.0, 1e-5);
  EXPECT_TRUE(std::isnan(heading_error(-1.0, 1.0).rms_rad));
  EXPECT_TRUE(std::isnan(heading_error(1.0, 0.0).rms_rad));
}

TEST(NoAllocation, Attitude) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "this allocator cannot be counted";
  const AttitudeModel model = two_antennas();
  const auto u = sky();
  const PathMatrix y = paths(model, geometry::rotation_from_euler({0.3, 0.1, 0.2}), u);
  const PathMatrix wrapped = -y / kWavelengthM;
  PathMatrix path(2, 8);
  AttitudeFilter filter(model, {.false_alarm_probability = 1e-3}, Eigen::Quaterniond::Identity(),
                        Eigen::Matrix3d::Identity());
  AttitudeStatus status{};
  EXPECT_EQ(test::allocations_of([&] {
              status = attitude_fix(model, u, y).status;
              static_cast<void>(resolve_cycles(model, Eigen::Quaterniond::Identity(), u, wrapped, kWavelengthM, path));
              static_cast<void>(acquire_attitude(model, u, wrapped, kWavelengthM));
              static_cast<void>(filter.predict(0.1, Eigen::Vector3d::UnitX()));
              static_cast<void>(filter.update(u, y));
              static_cast<void>(heading_error(1.0, 0.1));
            }),
            0);
  EXPECT_EQ(status, AttitudeStatus::kSolved);
}

}  // namespace
}  // namespace soopnav::gnss
