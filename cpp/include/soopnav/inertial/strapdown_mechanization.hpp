#pragma once

#include <Eigen/Core>
#include <cmath>
#include <concepts>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <type_traits>

#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/geometry/gravity.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/geometry/rotation.hpp"
#include "soopnav/inertial/coning_sculling.hpp"
#include "soopnav/inertial/imu_increment.hpp"
#include "soopnav/inertial/strapdown_state.hpp"

namespace soopnav::inertial {

/// Random errors of an inertial measurement unit, the same in each axis. A data sheet's 1 deg/sqrt(h) is 2.909e-4
/// rad/s/sqrt(Hz); 1 ug/sqrt(Hz) is 9.807e-6 m/s²/sqrt(Hz).
struct ImuNoise {
  double gyro_density = 0.0;             ///< white noise of the rates, square root of its density [rad/s/sqrt(Hz)]
  double accelerometer_density = 0.0;    ///< and of the forces [m/s²/sqrt(Hz)]
  double gyro_bias_walk = 0.0;           ///< random walk of the gyro biases [rad/s/sqrt(s)]
  double accelerometer_bias_walk = 0.0;  ///< and of the others [m/s²/sqrt(s)]
  double gyro_bias_time_s = std::numeric_limits<double>::infinity();           ///< their correlation time ...
  double accelerometer_bias_time_s = std::numeric_limits<double>::infinity();  ///< ... infinite: a random walk

  /// Throws std::invalid_argument naming the parameter, its value and the rule.
  void check() const {
    const auto require = [](bool holds, const char* name, double value, const char* rule) {
      if (holds) return;
      std::ostringstream text;
      text << name << ": " << value << "; " << rule;
      throw std::invalid_argument(text.str());
    };
    const auto density = [&](double value, const char* name) {
      require(value >= 0.0 && std::isfinite(value), name, value, "it must be finite and not negative");
    };
    density(gyro_density, "gyro_density");
    density(accelerometer_density, "accelerometer_density");
    density(gyro_bias_walk, "gyro_bias_walk");
    density(accelerometer_bias_walk, "accelerometer_bias_walk");
    require(gyro_bias_time_s > 0.0, "gyro_bias_time_s", gyro_bias_time_s, "it must be positive");
    require(accelerometer_bias_time_s > 0.0, "accelerometer_bias_time_s", accelerometer_bias_time_s,
            "it must be positive");
  }
};

/// A first-order Gauss-Markov step: x+ = decay x + sigma w. For an infinite time the random walk.
struct GaussMarkovStep {
  double decay;
  double sigma;
  GaussMarkovStep(double walk, double time_s, double dt_s) noexcept {
    if (std::isinf(time_s)) {
      decay = 1.0;
      sigma = walk * std::sqrt(dt_s);
    } else {
      decay = std::exp(-dt_s / time_s);
      sigma = walk * std::sqrt(-0.5 * time_s * std::expm1(-2.0 * dt_s / time_s));
    }
  }
};

/// Inertial navigation in a frame fixed to the Earth, driven by increments; with `StrapdownState` and an extended
/// Kalman filter it is the classical filter of 15 error states.
///
/// Model:   q <- exp(-w_ie dt) q exp(phi),  v += A - dt w_ie x A / 2 + dt (g(p) - 2 w_ie x v),  p by the trapezoid,
///          phi = dtheta - dt b_g - n_g,  A = C_n_b J(phi) (dv - dt b_a - n_a)             (doc/strapdown.md eq. 20-26)
/// Frames:  n is `FrameTag`: NedFrame or EnuFrame at the origin given, or EcefFrame, whose origin is the Earth's
/// centre;
///          all are fixed to the Earth: w_ie is constant in them, and gravity is evaluated at p with its size and its
///          direction. b is the body; the increments are along its axes.
/// Noise:   12 normals: gyros, accelerometers, and the walks of their biases.
/// Roles:   attitude, velocity, position, gyro bias, accelerometer bias. Increments after `ConingSculling`.
/// Refused: `propagate` answers false when the step's length is not that of its increment (to 1e-9 of it).
/// No allocation.
template <class FrameTag = NedFrame>
class StrapdownMechanization {
  static constexpr bool kCentred = std::same_as<FrameTag, EcefFrame>;
  static_assert(std::same_as<FrameTag, NedFrame> || std::same_as<FrameTag, EnuFrame> || kCentred,
                "a frame fixed to the Earth");

 public:
  using Frame = FrameTag;
  using Input = ImuIncrement;
  static constexpr int kNoise = 12;

  /// Throws std::invalid_argument for an origin that `geometry::LocalFrame` refuses or noise that makes no sense.
  explicit StrapdownMechanization(const geometry::Geodetic& origin, const ImuNoise& noise = {}) requires(!kCentred)
      : frame_(origin, std::same_as<FrameTag, NedFrame> ? geometry::LocalAxes::kNed : geometry::LocalAxes::kEnu),
        noise_(noise),
        omega_ie_(frame_.velocity_from_ecef({0.0, 0.0, wgs84::kEarthRateRadps})),
        origin_(frame_.rotation_from_ecef() * frame_.origin_ecef()) {
    noise_.check();
  }
  /// The same in the Earth's own axes.
  explicit StrapdownMechanization(const ImuNoise& noise = {}) requires kCentred
      : noise_(noise),
        omega_ie_(0.0, 0.0, wgs84::kEarthRateRadps),
        origin_(0.0, 0.0, 0.0) {
    noise_.check();
  }

  [[nodiscard]] const geometry::LocalFrame& frame() const noexcept requires(!kCentred) { return frame_; }
  [[nodiscard]] const ImuNoise& noise() const noexcept { return noise_; }
  /// The Earth's rate w_ie_n [rad/s].
  [[nodiscard]] const Eigen::Vector3d& earth_rate() const noexcept { return omega_ie_; }
  /// Normal gravity at p_n, along the axes of n [m/s²].
  [[nodiscard]] Eigen::Vector3d gravity(const Eigen::Vector3d& p_n) const noexcept {
    if constexpr (kCentred) {
      return geometry::normal_gravity_ecef(p_n);
    } else {
      return frame_.velocity_from_ecef(geometry::normal_gravity_ecef(frame_.position_to_ecef(p_n)));
    }
  }

  /// `x`: a state of doubles.
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, const ImuIncrement& u, double dt_s, const W& w, Y& y) const {
    using Eigen::Matrix3d;
    using Eigen::Vector3d;
    if (!(std::abs(u.dt_s - dt_s) <= 1e-9 * dt_s)) return false;
    const double root_dt = std::sqrt(dt_s);
    const double gyro = root_dt * noise_.gyro_density;
    const double force = root_dt * noise_.accelerometer_density;
    const GaussMarkovStep gyro_bias(noise_.gyro_bias_walk, noise_.gyro_bias_time_s, dt_s);
    const GaussMarkovStep force_bias(noise_.accelerometer_bias_walk, noise_.accelerometer_bias_time_s, dt_s);
    const Vector3d b_g = x(kGyroBias);
    const Vector3d b_a = x(kAccelerometerBias);
    const Vector3d phi = u.delta_theta_b - dt_s * b_g - gyro * Vector3d(w[0], w[1], w[2]);
    const Vector3d d = u.delta_velocity_b - dt_s * b_a - force * Vector3d(w[3], w[4], w[5]);

    const detail::Quaternion4 q = x(kAttitude);
    const Matrix3d C = Eigen::Quaterniond(q[0], q[1], q[2], q[3]).toRotationMatrix();
    const IncrementRotation rotation(phi);
    const Matrix3d J = rotation.matrix(phi);
    const Vector3d s = J * d;
    const Vector3d A = C * s;
    const Vector3d v = x(kVelocity);
    const Vector3d p = x(kPosition);
    const Vector3d p_mid = p + 0.5 * dt_s * v;
    const Vector3d g = gravity(p_mid);
    const Vector3d v_mid = v + 0.5 * (A + dt_s * (g - 2.0 * omega_ie_.cross(v)));
    const Vector3d dv = A - 0.5 * dt_s * omega_ie_.cross(A) + dt_s * (g - 2.0 * omega_ie_.cross(v_mid));

    y.next(kAttitude) = detail::quaternion_product(detail::rotation_exp(-dt_s * omega_ie_),
                                                   detail::quaternion_product(q, detail::rotation_exp(phi)));
    y.next(kVelocity) = v + dv;
    y.next(kPosition) = p + dt_s * v + 0.5 * dt_s * dv;
    y.next(kGyroBias) = gyro_bias.decay * b_g + gyro_bias.sigma * Vector3d(w[6], w[7], w[8]);
    y.next(kAccelerometerBias) = force_bias.decay * b_a + force_bias.sigma * Vector3d(w[9], w[10], w[11]);

    if constexpr (Y::kJacobian) {
      // doc/strapdown.md eq. 27-32
      const Matrix3d I = Matrix3d::Identity();
      const Matrix3d wx = geometry::skew(omega_ie_);
      const Matrix3d gradient = geometry::gravity_gradient(origin_ + p_mid, omega_ie_);
      const Matrix3d LC = C - 1.5 * dt_s * (wx * C);
      const Matrix3d v_q = -LC * geometry::skew(s);
      const Matrix3d v_force = -LC * J;
      const Matrix3d v_gyro = -LC * rotation.slope(phi, d);
      const Matrix3d half_g = 0.5 * dt_s * gradient;
      const Matrix3d v_v = dt_s * half_g - 2.0 * dt_s * wx * (I + 0.5 * dt_s * (half_g - 2.0 * wx));
      const Matrix3d v_p = dt_s * (gradient - dt_s * wx * gradient);
      const double half = 0.5 * dt_s;
      // exp(-phi) and the right Jacobian of phi, which is J transposed.
      y.transition(kAttitude, kAttitude) = I - J.transpose() * geometry::skew(phi);
      y.transition(kAttitude, kGyroBias) = -dt_s * J.transpose();
      y.transition(kVelocity, kAttitude) = v_q;
      y.transition(kVelocity, kVelocity) = I + v_v;
      y.transition(kVelocity, kPosition) = v_p;
      y.transition(kVelocity, kGyroBias) = dt_s * v_gyro;
      y.transition(kVelocity, kAccelerometerBias) = dt_s * v_force;
      y.transition(kPosition, kAttitude) = half * v_q;
      y.transition(kPosition, kVelocity) = dt_s * I + half * v_v;
      y.transition(kPosition, kPosition) = I + half * v_p;
      y.transition(kPosition, kGyroBias) = half * dt_s * v_gyro;
      y.transition(kPosition, kAccelerometerBias) = half * dt_s * v_force;
      y.transition(kGyroBias, kGyroBias) = gyro_bias.decay * I;
      y.transition(kAccelerometerBias, kAccelerometerBias) = force_bias.decay * I;
      y.template noise<0, 3>(kAttitude) = -gyro * J.transpose();
      y.template noise<0, 3>(kVelocity) = gyro * v_gyro;
      y.template noise<0, 3>(kPosition) = half * gyro * v_gyro;
      y.template noise<3, 3>(kVelocity) = force * v_force;
      y.template noise<3, 3>(kPosition) = half * force * v_force;
      y.template noise<6, 3>(kGyroBias) = gyro_bias.sigma * I;
      y.template noise<9, 3>(kAccelerometerBias) = force_bias.sigma * I;
    }
    return true;
  }

 private:
  struct EarthItself {};
  [[no_unique_address]] std::conditional_t<kCentred, EarthItself, geometry::LocalFrame> frame_;
  ImuNoise noise_;
  Eigen::Vector3d omega_ie_;
  Eigen::Vector3d origin_;  // from the Earth's centre, along the axes of n
};

/// What may have happened while no sample told: rate and acceleration unknown and constant, the same deviation in each
/// axis.
struct GapMotion {
  double rate_sigma_radps = 0.2;
  double acceleration_sigma_mps2 = 1.0;
};

/// Strapdown state over time without samples: on at constant velocity and attitude, uncertain by a stated motion.
///
/// Model:   q <- q exp(T n_w),  v += T n_a,  p += T v + T² n_a / 2,  n_w and n_a constant over the whole gap, of the
///          deviations in `motion`; biases as in `StrapdownMechanization`                   (doc/strapdown.md eq.
///          33-34)
/// Cut into shorter steps it grows less: one call for one gap.
/// Roles:   those of `StrapdownMechanization`; 12 normals; no input; any Cartesian frame. No allocation.
struct StrapdownGap {
  static constexpr int kNoise = 12;
  GapMotion motion{};
  ImuNoise noise{};

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    using Eigen::Vector3d;
    const double turn = dt_s * motion.rate_sigma_radps;
    const double push = dt_s * motion.acceleration_sigma_mps2;
    const GaussMarkovStep gyro_bias(noise.gyro_bias_walk, noise.gyro_bias_time_s, dt_s);
    const GaussMarkovStep force_bias(noise.accelerometer_bias_walk, noise.accelerometer_bias_time_s, dt_s);
    const detail::Quaternion4 q = x(kAttitude);
    const Vector3d v = x(kVelocity);
    const Vector3d p = x(kPosition);
    const Vector3d b_g = x(kGyroBias);
    const Vector3d b_a = x(kAccelerometerBias);
    const Vector3d dv = push * Vector3d(w[3], w[4], w[5]);
    y.next(kAttitude) = detail::quaternion_product(q, detail::rotation_exp(turn * Vector3d(w[0], w[1], w[2])));
    y.next(kVelocity) = v + dv;
    y.next(kPosition) = p + dt_s * v + 0.5 * dt_s * dv;
    y.next(kGyroBias) = gyro_bias.decay * b_g + gyro_bias.sigma * Vector3d(w[6], w[7], w[8]);
    y.next(kAccelerometerBias) = force_bias.decay * b_a + force_bias.sigma * Vector3d(w[9], w[10], w[11]);
    if constexpr (Y::kJacobian) {
      const auto I = Eigen::Matrix3d::Identity();
      y.transition(kPosition, kVelocity) = dt_s * I;
      y.transition(kGyroBias, kGyroBias) = gyro_bias.decay * I;
      y.transition(kAccelerometerBias, kAccelerometerBias) = force_bias.decay * I;
      y.template noise<0, 3>(kAttitude) = turn * I;
      y.template noise<3, 3>(kVelocity) = push * I;
      y.template noise<3, 3>(kPosition) = 0.5 * dt_s * push * I;
      y.template noise<6, 3>(kGyroBias) = gyro_bias.sigma * I;
      y.template noise<9, 3>(kAccelerometerBias) = force_bias.sigma * I;
    }
    return true;
  }
};

}  // namespace soopnav::inertial
