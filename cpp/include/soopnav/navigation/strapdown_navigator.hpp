#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "soopnav/core/role.hpp"
#include "soopnav/core/status.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/geometry/wgs84.hpp"
#include "soopnav/inertial/coning_sculling.hpp"
#include "soopnav/inertial/imu_guard.hpp"
#include "soopnav/inertial/strapdown_mechanization.hpp"
#include "soopnav/inertial/unmodelled_motion.hpp"
#include "soopnav/inertial/zero_velocity.hpp"
#include "soopnav/measurement/range_difference.hpp"

namespace soopnav::navigation {

/// A range difference that is known but for multiples of `ambiguity_m`: a signal that repeats. The innovation is the
/// one nearest to zero, so the prediction chooses the multiple (doc/strapdown.md eq. 46). Infinite: not ambiguous.
struct AmbiguousRangeDifference {
  using Frame = NedFrame;
  static constexpr int kDim = 1;
  RangeDifference<NedFrame, Known<3>, Known<3>> model{};
  double ambiguity_m = std::numeric_limits<double>::infinity();

  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    return model.predict(x, y);
  }
  [[nodiscard]] double residual(int /*row*/, double z, double predicted) const noexcept {
    return std::remainder(z - predicted, ambiguity_m);
  }
};

/// What a `StrapdownNavigator` is told beforehand.
struct StrapdownOptions {
  inertial::ImuNoise noise{};                                    ///< of the inertial unit, white parts and bias walks
  inertial::ImuLimits limits{};                                  ///< its period and ranges
  inertial::GapMotion gap{};                                     ///< what may happen while no sample tells
  int coning_samples = inertial::ConingSculling::kMaxPrevious;   ///< earlier samples used against coning, 0 ... 4
  double range_sigma_m = 1.0;                                    ///< of a range change
  double ambiguity_m = std::numeric_limits<double>::infinity();  ///< range changes are known modulo this
  double gate_sigmas = std::numeric_limits<double>::infinity();  ///< an innovation above so many of its deviations ...
  double gate_floor_m = 0.0;                                     ///< ... and above this is refused
  std::optional<inertial::ZeroVelocityOptions> zero_velocity{};  ///< tells rest; without it no zero-velocity updates
  double zero_velocity_sigma_mps = 0.01;                         ///< what "at rest" allows, for the mean of a window
  bool hold_heading = false;            ///< at rest the mean rate is gyro bias and Earth rate as well
  double zero_rate_sigma_radps = 1e-4;  ///< what "at rest" allows of turning, beside the gyros' white noise
};

/// A whole run's inputs. Lengths must agree; `range_changes_m` is row by row, a row for each epoch.
struct StrapdownData {
  std::span<const double> t_s;                ///< n times, each at the end of its increment
  std::span<const double> delta_theta_b;      ///< (n, 3) [rad]
  std::span<const double> delta_velocity_b;   ///< (n, 3) [m/s]
  std::span<const double> epochs_s{};         ///< e times, in order
  std::span<const double> range_changes_m{};  ///< (e, transmitters); NaN: absent
  std::size_t record_every = 1;               ///< samples from one record to the next
  bool covariance = false;                    ///< whole covariances are recorded
};

/// What came of a run: records (r of them), epochs (e), samples (n).
struct StrapdownRun {
  std::vector<double> t_s;                      ///< (r)
  std::vector<double> position_m;               ///< (r, 3) north, east, down of the origin
  std::vector<double> velocity_mps;             ///< (r, 3)
  std::vector<double> quaternion;               ///< (r, 4) w, x, y, z, body to north-east-down of the origin
  std::vector<double> gyro_bias_radps;          ///< (r, 3)
  std::vector<double> accelerometer_bias_mps2;  ///< (r, 3)
  std::vector<double> sigma;                    ///< (r, 15) deviations of the error states
  std::vector<double> covariance;               ///< (r, 15, 15), or empty
  std::vector<double> innovation_m;             ///< (e, transmitters); NaN where there was none
  std::vector<double> innovation_sigma_m;       ///< (e, transmitters)
  std::vector<double> nis;                      ///< (e, transmitters)
  std::vector<std::uint8_t> update_status;      ///< (e, transmitters) `UpdateStatus`; absent ones are kNonFinite
  std::vector<std::uint8_t> imu_status;         ///< (n) `inertial::ImuStatus`
  std::size_t zero_velocity_updates = 0;        ///< taken in
};

/// Inertial navigation in three dimensions, aided by the change of range to transmitters that stand still: an extended
/// Kalman filter over attitude, velocity, position and the biases of gyros and accelerometers.
///
/// Model:   `StrapdownMechanization` in north-east-down of the origin; range changes |p - q| - |r - q| since the
/// receiver
///          was at `reference` (crosby's self-TDOA in three dimensions, positive when receding)  (doc/strapdown.md eq.
///          46)
/// Samples: each passes an `ImuGuard`. Over missing, saturated and not finite ones the state coasts and its covariance
///          grows by `GapMotion`; duplicates and older ones are left out. Epochs between samples split the increment.
/// Updates: validated, innovated, gated and recorded one transmitter after the other; a refused one leaves the state
///          untouched. Nothing throws or allocates behind the constructor but `run`, which returns arrays.
class StrapdownNavigator {
 public:
  using State = inertial::StrapdownState<NedFrame>;
  using Filter = ExtendedKalmanFilter<State>;

  /// Throws std::invalid_argument for transmitters or a reference that are not finite, options outside their ranges, a
  /// start that is not finite and a covariance that is none.
  StrapdownNavigator(const geometry::Geodetic& origin, const std::vector<Eigen::Vector3d>& transmitters_m,
                     const Eigen::Vector3d& reference_m, double start_s, const State& x0, const Filter::Square& P0,
                     const StrapdownOptions& options);

  [[nodiscard]] const State& state() const noexcept { return filter_.state(); }
  [[nodiscard]] const Filter::Square& covariance() const noexcept { return filter_.covariance(); }
  [[nodiscard]] double time_s() const noexcept { return time_s_; }
  [[nodiscard]] std::size_t transmitters() const noexcept { return models_.size(); }

  /// Takes the increment that ends at `t_s` and moves the state there (or nowhere: see the status).
  inertial::ImuStatus add_imu(double t_s, const Eigen::Vector3d& delta_theta_b,
                              const Eigen::Vector3d& delta_velocity_b) noexcept;

  /// Takes the present range change of a transmitter in; an index too large is kUndefined.
  UpdateReport<1> update_range_change(std::size_t transmitter, double range_change_m) noexcept;

  /// A whole run from this navigator's present state, which stays as it is. Throws std::invalid_argument where lengths
  /// do not agree; what the data hold gives statuses. Epochs older than the state are kTooLate, those behind the last
  /// sample kTimeNotAdvancing.
  [[nodiscard]] StrapdownRun run(const StrapdownData& data) const;

 private:
  // A sample in two parts: time nobody knows of, then its increment.
  struct Sample {
    inertial::ImuStatus status = inertial::ImuStatus::kFirst;
    bool counts = false;
    double gap_s = 0.0;
    double end_s = 0.0;
    inertial::ImuIncrement increment{};
    bool at_rest = false;
  };
  [[nodiscard]] Sample take(double t_s, const Eigen::Vector3d& delta_theta_b,
                            const Eigen::Vector3d& delta_velocity_b) noexcept;
  void advance(Sample& sample, double to_s) noexcept;
  bool rest(const Sample& sample) noexcept;

  StrapdownOptions options_;
  inertial::StrapdownMechanization<NedFrame> process_;
  inertial::StrapdownGap gap_;
  inertial::UnmodelledEpisode episode_;
  std::vector<AmbiguousRangeDifference> models_;
  Gate gate_;
  Filter filter_;
  inertial::ImuGuard guard_;
  inertial::ConingSculling coning_;
  std::optional<inertial::ZeroVelocityDetector> detector_;
  int since_rest_ = 0;
  double time_s_;
};

}  // namespace soopnav::navigation
