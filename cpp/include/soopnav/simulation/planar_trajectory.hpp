#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/inertial/imu_errors.hpp"
#include "soopnav/inertial/planar_mechanization.hpp"

namespace soopnav::simulation {

/// Where something in a plane is and how it moves. Headings count from the plane's first axis towards the second and
/// are not wrapped; body axes: first forward, second to the left.
struct PlanarMotion {
  double t_s = 0.0;
  double heading_rad = 0.0;
  Eigen::Vector2d velocity_mps = Eigen::Vector2d::Zero();
  Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
  double yaw_rate_radps = 0.0;
  Eigen::Vector2d specific_force_b_mps2 =
      Eigen::Vector2d::Zero();  ///< acceleration in the body's axes: no gravity here
};

/// Start of a trajectory.
struct PlanarStart {
  double heading_rad = 0.0;
  Eigen::Vector2d velocity_mps = Eigen::Vector2d::Zero();
  Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
};

/// From rest into a turn that never settles: speed by a quintic ramp, heading rate turn_rate + turn_amplitude
/// sin(2 pi t / turn_period) (doc/clocks.md eqs. 18, 19).
struct ContinuousTurn {
  double duration_s = 120.0;
  double speed_mps = 8.0;
  double ramp_s = 10.0;
  double turn_rate_radps = 0.035;
  double turn_amplitude_radps = 0.10;
  double turn_period_s = 40.0;
  double heading_rad = 0.0;
  Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
};

/// Limits of a drive through waypoints.
struct DriveLimits {
  double speed_mps = 8.0;
  double acceleration_mps2 = 1.0;          ///< along the way, either direction
  double lateral_acceleration_mps2 = 2.0;  ///< speed² times curvature
  double smoothing_s = 1.0;                ///< the speed is a mean over so long: jerk <= 2 acceleration / smoothing
};

/// How an inertial unit samples a trajectory.
enum class PlanarSampling {
  kMean,    ///< the exact increments of heading and velocity over the interval, velocity in the axes at its beginning:
            ///< what an integrating unit gives after its sculling correction
  kCentre,  ///< values in the middle of the interval
  kLeft,    ///< values at its beginning
};

/// A planar trajectory on a grid, and between its points by Hermite's polynomials: truth for simulations.
///
/// Between points the heading is the cubic of both ends' headings and rates, the velocity the cubic of velocities and
/// accelerations, the position the quintic of positions, velocities and accelerations; yaw rate and specific force are
/// the derivatives, so that the whole is consistent and smooth. At 1000 Hz this reproduces an analytic motion to
/// rounding (doc/clocks.md).
class PlanarTrajectory {
 public:
  /// @throws std::invalid_argument unless durations, ramp, period and rate are positive, all is finite, and the ramp is
  /// not longer than the drive.
  [[nodiscard]] static PlanarTrajectory continuous_turn(const ContinuousTurn& turn = {}, double rate_hz = 1000.0);

  /// From rest at the first of `waypoints_m` to rest at the last: along the natural cubic spline through them over
  /// their distances, as fast as the limits allow. The heading follows the way.
  /// @throws std::invalid_argument unless there are at least two, finite, each apart from the one before it, the way
  /// never turns back on the spot, and the limits are positive (smoothing_s: >= 0) and finite.
  [[nodiscard]] static PlanarTrajectory through(std::span<const Eigen::Vector2d> waypoints_m,
                                                const DriveLimits& limits = {}, double rate_hz = 1000.0);

  /// Profiles of yaw rate and body-frame force, `rate_hz` apart, integrated by the trapezoid rule: heading, then
  /// velocity, then position (crosby section 4.1).
  /// @throws std::invalid_argument unless there are at least two samples, as many of both, all finite.
  [[nodiscard]] static PlanarTrajectory from_profiles(std::span<const double> yaw_rate_radps,
                                                      std::span<const Eigen::Vector2d> force_b_mps2, double rate_hz,
                                                      const PlanarStart& start = {});

  [[nodiscard]] const std::vector<PlanarMotion>& points() const noexcept { return points_; }
  [[nodiscard]] double rate_hz() const noexcept { return rate_hz_; }
  [[nodiscard]] double duration_s() const noexcept { return points_.back().t_s; }

  /// The motion at `t_s`; none outside 0 ... duration or for NaN. No allocation.
  [[nodiscard]] std::optional<PlanarMotion> at(double t_s) const noexcept;

 private:
  PlanarTrajectory(std::vector<PlanarMotion> points, double rate_hz) : points_(std::move(points)), rate_hz_(rate_hz) {}

  std::vector<PlanarMotion> points_;
  double rate_hz_;
};

/// One reading of a simulated planar unit.
struct PlanarImuReading {
  double t_s = 0.0;  ///< end of its interval
  inertial::PlanarImuSample sample;
  inertial::ReadingStatus status = inertial::ReadingStatus::kValid;
};

/// What a unit of `rate_hz` says along a trajectory: as many readings as whole intervals fit, errors from `random`.
/// @throws std::invalid_argument unless rate_hz is positive and finite and one interval fits, and as
/// inertial::PlanarImuErrors.
[[nodiscard]] std::vector<PlanarImuReading> planar_imu(const PlanarTrajectory& trajectory, double rate_hz,
                                                       const inertial::ImuErrorModel& errors,
                                                       const RandomStream& random,
                                                       PlanarSampling sampling = PlanarSampling::kMean);

}  // namespace soopnav::simulation
