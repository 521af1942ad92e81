#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <memory>
#include <vector>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/inertial/imu_guard.hpp"
#include "soopnav/inertial/strapdown_mechanization.hpp"
#include "soopnav/navigation/cooperative_filter.hpp"

namespace soopnav::navigation {

/// What an `InertialFilter` begins with and runs on.
struct InertialPairOptions {
  clock::ClockNoise clock_noise{};                            ///< of target and anchor together (their sum)
  inertial::ImuNoise noise{};                                 ///< of the inertial unit, white parts and bias walks
  inertial::ImuLimits limits{};                               ///< its period and ranges
  inertial::GapMotion gap{};                                  ///< what may happen while no sample tells
  int coning_samples = 4;                                     ///< earlier samples used against coning, 0 ... 4
  Eigen::Quaterniond q_n_b = Eigen::Quaterniond::Identity();  ///< at the start, body to north-east-down there; unit
  double tilt_sigma_rad = 0.01;                               ///< of the start, about north and east, > 0
  double heading_sigma_rad = 0.02;                            ///< and about down, > 0
  double gyro_bias_sigma_radps = 1e-4;                        ///< of biases taken as zero at the start, each axis, > 0
  double accelerometer_bias_sigma_mps2 = 0.02;                ///< > 0
  std::size_t waiting_samples = 16384;  ///< room for samples later than the last prediction, 1 ... 2^20; a gap is one
  int smoother_steps = 0;               ///< predictions that `smooth` can go back over, 0 ... 10^6
};

/// Everything an `InertialFilter` estimates at a time.
struct InertialPairEstimate {
  static constexpr int kDim = 17;
  double t_s = 0.0;
  PairVector mean;                     ///< p, v (ECEF) [m, m/s], theta [m], alpha [m/s]
  Eigen::Quaterniond q_e_b;            ///< body to ECEF
  Eigen::Vector3d gyro_bias;           ///< [rad/s]
  Eigen::Vector3d accelerometer_bias;  ///< [m/s²]
  /// Of p, v, theta, alpha, attitude (a rotation about the body's axes, truth = q exp(d)) [rad], gyro and accelerometer
  /// biases.
  Eigen::Matrix<double, kDim, kDim> covariance;
};

/// Engine for a target with an inertial unit: strapdown navigation in ECEF, aided by bursts; an extended Kalman filter
/// of 17 error states.
///
/// Model:   `StrapdownMechanization` in ECEF and `clock::TwoState`       (doc/cooperative_motion.md eq. 6-7)
/// Samples: `add_imu` judges them (`ImuGuard`) and keeps them until a prediction reaches them; a prediction that ends
///          within a sample takes part of it and leaves the rest. Give samples up to and including the one a burst
///          falls into before the burst: time no sample speaks for (missing, saturated, not finite, not there yet) is
///          coasted at constant velocity and attitude, its covariance growing by `gap`, one episode as a whole.
/// Smoother: `smooth`, over all 17 states; so not `smoothable` by eight of them. A clock reopened after an update cuts
///          its step in two of the same time, for which there is room eight times beyond `smoother_steps`.
/// Restart: attitude and biases begin as the options say, and later as they are, without their correlations.
/// Nothing throws or allocates behind the constructor but `restart` (bad input) and `smooth`. About 10 us for a sample.
class InertialFilter : public CooperativeFilter {
 public:
  /// The increment that ends at `t_s`: integrals of rate [rad] and specific force [m/s] along the body's axes. Left out
  /// ones (kDuplicate, kReversed, kFarAhead) change nothing. Beyond `waiting_samples` the oldest is integrated at once.
  virtual inertial::ImuStatus add_imu(double t_s, const Eigen::Vector3d& delta_theta_b,
                                      const Eigen::Vector3d& delta_velocity_b) noexcept = 0;
  [[nodiscard]] virtual InertialPairEstimate estimate() const noexcept = 0;
  /// Rauch-Tung-Striebel over the predictions since `restart`, each with what was updated before the next, and twice,
  /// before and after, where a clock was reopened in between; the last is the filter's own. For the end of a run. Empty
  /// when `smoother_steps` were too few or a number overflowed.
  [[nodiscard]] virtual std::vector<InertialPairEstimate> smooth() = 0;
};

/// Throws std::invalid_argument naming the option, its value and the rule. Call `restart` before anything else.
[[nodiscard]] std::unique_ptr<InertialFilter> inertial_filter(const InertialPairOptions& options);

}  // namespace soopnav::navigation
