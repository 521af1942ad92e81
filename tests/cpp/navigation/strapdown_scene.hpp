#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <vector>

#include "inertial/manoeuvre.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/navigation/strapdown_navigator.hpp"

namespace soopnav::test {

using Navigator = navigation::StrapdownNavigator;

/// One run: a manoeuvring path, its increments with errors, four transmitters, and a filter that begins wrong as its P0
/// says. Truth is scaled by `wrong` where a test wants a filter that does not know its sensors.
struct StrapdownScene {
  double rate_hz = 100.0;
  double duration_s = 40.0;
  double range_sigma_m = 0.5;
  std::vector<Eigen::Vector3d> transmitters{
      {2800, 500, -40}, {-900, 2900, -300}, {-2700, -1200, -120}, {700, -3000, -220}};
  navigation::StrapdownOptions options = [] {
    navigation::StrapdownOptions o;
    o.noise = {.gyro_density = 4.4e-5,
               .accelerometer_density = 5.9e-4,
               .gyro_bias_walk = 2e-6,
               .accelerometer_bias_walk = 2e-4,
               .gyro_bias_time_s = 200.0};
    o.limits.period_s = 0.01;
    o.range_sigma_m = 0.5;
    return o;
  }();
  Eigen::Matrix<double, 15, 1> sigma0 = (Eigen::Matrix<double, 15, 1>() << 2e-3, 2e-3, 1e-2, 0.1, 0.1, 0.1, 0.3, 0.3,
                                         0.3, 2.4e-5, 2.4e-5, 2.4e-5, 4.9e-3, 4.9e-3, 4.9e-3)
                                            .finished();
};

struct StrapdownTruth {
  std::vector<double> t_s, delta_theta, delta_velocity, epochs_s, range_changes_m;
  std::vector<Navigator::State> states;  // at each epoch
  Navigator::State start;                // what the filter begins with
};

/// Increments and truth without errors, made once for all runs.
struct PerfectRun {
  simulation::SpatialTrajectory path = manoeuvre();
  std::vector<inertial::ImuIncrement> increments;
  explicit PerfectRun(const StrapdownScene& scene)
      : increments(path.imu_increments(scene.rate_hz, 0.0, scene.duration_s)) {}
};

inline Navigator::State state_of(const simulation::SpatialMotion& m, const Eigen::Vector3d& b_g,
                                 const Eigen::Vector3d& b_a) {
  Navigator::State x;
  x(kAttitude) << m.q_n_b.w(), m.q_n_b.vec();
  x(kVelocity) = m.v_n_mps;
  x(kPosition) = m.p_n_m;
  x(inertial::kGyroBias) = b_g;
  x(inertial::kAccelerometerBias) = b_a;
  return x;
}

inline StrapdownTruth simulate(const StrapdownScene& scene, const PerfectRun& perfect, RandomStream random,
                               double wrong = 1.0) {
  const auto draw = [&](double sigma) {
    return Eigen::Vector3d(sigma * Eigen::Vector3d(random.normal(), random.normal(), random.normal()));
  };
  const auto& noise = scene.options.noise;
  const double dt = 1.0 / scene.rate_hz;
  const double root = std::sqrt(dt);
  const inertial::GaussMarkovStep gyro_step(noise.gyro_bias_walk, noise.gyro_bias_time_s, dt);
  const inertial::GaussMarkovStep force_step(noise.accelerometer_bias_walk, noise.accelerometer_bias_time_s, dt);
  Eigen::Vector3d b_g = draw(scene.sigma0[9]);
  Eigen::Vector3d b_a = draw(scene.sigma0[12]);
  StrapdownTruth out;
  const auto first = state_of(perfect.path.at(0.0), b_g, b_a);
  Eigen::Matrix<double, 15, 1> error;
  for (int i = 0; i < 9; ++i) error[i] = scene.sigma0[i] * random.normal();
  error.segment<3>(9) = b_g;
  error.segment<3>(12) = b_a;
  out.start = first.retract(-error);  // biases zero; the attitude's error is about the truth's own axes
  const Eigen::Vector3d reference = perfect.path.at(0.0).p_n_m;
  const auto per_epoch = static_cast<std::size_t>(scene.rate_hz);
  for (std::size_t k = 0; k < perfect.increments.size(); ++k) {
    const auto& u = perfect.increments[k];
    const Eigen::Vector3d dtheta = u.delta_theta_b + dt * b_g + draw(wrong * noise.gyro_density * root);
    const Eigen::Vector3d dv = u.delta_velocity_b + dt * b_a + draw(wrong * noise.accelerometer_density * root);
    for (int i = 0; i < 3; ++i) {
      out.delta_theta.push_back(dtheta[i]);
      out.delta_velocity.push_back(dv[i]);
    }
    b_g = gyro_step.decay * b_g + draw(gyro_step.sigma);
    b_a = force_step.decay * b_a + draw(force_step.sigma);
    const double t = static_cast<double>(k + 1) * dt;
    out.t_s.push_back(t);
    if ((k + 1) % per_epoch != 0) continue;
    const auto m = perfect.path.at(t);
    out.epochs_s.push_back(t);
    out.states.push_back(state_of(m, b_g, b_a));
    for (const Eigen::Vector3d& q : scene.transmitters) {
      out.range_changes_m.push_back((m.p_n_m - q).norm() - (reference - q).norm() +
                                    wrong * scene.range_sigma_m * random.normal());
    }
  }
  return out;
}

inline Navigator make_navigator(const StrapdownScene& scene, const PerfectRun& perfect, const StrapdownTruth& truth) {
  const Navigator::Filter::Square P0 = scene.sigma0.cwiseAbs2().asDiagonal();
  return {kHome, scene.transmitters, perfect.path.at(0.0).p_n_m, 0.0, truth.start, P0, scene.options};
}

inline navigation::StrapdownData data_of(const StrapdownTruth& truth, std::size_t record_every = 100) {
  return {truth.t_s, truth.delta_theta, truth.delta_velocity, truth.epochs_s, truth.range_changes_m, record_every,
          true};
}

/// The recorded state number `r` of a run.
inline Navigator::State recorded(const navigation::StrapdownRun& run, std::size_t r) {
  Navigator::State x;
  const auto take = [&x](auto role, const std::vector<double>& from, std::size_t at, int count) {
    for (int i = 0; i < count; ++i) x.x[Navigator::State::stored_at(role) + i] = from[at + static_cast<std::size_t>(i)];
  };
  take(kAttitude, run.quaternion, 4 * r, 4);
  take(kVelocity, run.velocity_mps, 3 * r, 3);
  take(kPosition, run.position_m, 3 * r, 3);
  take(inertial::kGyroBias, run.gyro_bias_radps, 3 * r, 3);
  take(inertial::kAccelerometerBias, run.accelerometer_bias_mps2, 3 * r, 3);
  return x;
}
inline Navigator::Filter::Square recorded_covariance(const navigation::StrapdownRun& run, std::size_t r) {
  return Eigen::Map<const Navigator::Filter::Square>(run.covariance.data() + 225 * r);
}

}  // namespace soopnav::test
