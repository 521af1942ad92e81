#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/core/status.hpp"
#include "soopnav/geometry/sampled_orbit.hpp"

namespace soopnav::navigation {

/// What an `OpportunisticNavigator` is told of a signal of opportunity when it joins (pesyna eq. 2). What is known is
/// left out of the state: a GPS satellite adds only its ambiguity, a cellular basestation its clock and ambiguity, a
/// transmitter nobody has surveyed its position as well.
struct OpportunisticSource {
  std::string name;         ///< unique among the sources present; 1 ... 20 characters name its states in reports
  double carrier_hz = 0.0;  ///< > 0

  /// Where it is: on an orbit, or at rest at `position_e_m`, or (neither) as each observation says.
  std::shared_ptr<const geometry::SampledOrbit> orbit;
  std::optional<Eigen::Vector3d> position_e_m;            ///< ECEF
  std::optional<Eigen::Matrix3d> position_covariance_m2;  ///< estimated when given, positive definite; else known

  /// Its clock. Known: `clock_bias_m` + `clock_drift_mps` * (t - `clock_epoch_s`), or as each observation says.
  /// Estimated: these are the prior's mean, at the time of joining.
  bool clock_estimated = false;
  clock::ClockNoise clock_noise{};
  double clock_bias_m = 0.0;                                   ///< c * (source clock - system time)
  double clock_drift_mps = 0.0;                                ///< its time derivative
  double clock_epoch_s = 0.0;                                  ///< of a known clock
  Eigen::Matrix2d clock_covariance = Eigen::Matrix2d::Zero();  ///< of bias [m] and drift [m/s]; positive definite

  /// The phase's constant gamma. Known: 0 in the state, `ambiguity_cycles` in the model.
  bool ambiguity_estimated = true;
  double ambiguity_cycles = 0.0;
  double ambiguity_sigma_cycles = 1e4;
  double ambiguity_walk_cycles2ps = 0.0;  ///< random walk, for what the model leaves out (wind-up, multipath)

  /// Moves a source at rest whose position is estimated, m² per second and axis; 0 for one that stands.
  double position_walk_m2ps = 0.0;
};

enum class ObservableKind : std::uint8_t {
  kPhase,        ///< accumulated carrier phase [cycles], grows with range
  kPseudorange,  ///< [m]
};

/// One observable of one epoch.
struct OpportunisticObservation {
  int source = -1;  ///< what `add_source` returned
  ObservableKind kind = ObservableKind::kPhase;
  double value = std::numeric_limits<double>::quiet_NaN();
  double sigma = std::numeric_limits<double>::quiet_NaN();  ///< white, cycles or metres; > 0
  double correction_m = 0.0;                                ///< added to the model (atmosphere, wind-up ...)
  /// Of a source that has no orbit and no position: its antenna at transmission, in the ECEF axes of reception
  /// (`SignalPath::source_p_e`); light time is then solved by whoever gives it.
  Eigen::Vector3d source_position_e_m = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  /// Its known clock's bias at transmission [m], instead of the source's own numbers when not NaN.
  double source_clock_m = std::numeric_limits<double>::quiet_NaN();
};

/// What became of an observable.
enum class ObservableUse : std::uint8_t {
  kMissing,              ///< NaN value in a batch: not observed
  kAccepted,             ///< used
  kSlip,                 ///< a cycle slip, or a first phase beyond its prior: used after the ambiguity was opened again
  kGated,                ///< an outlier: not used
  kSuspended,            ///< its source contradicts its model too often and is not listened to
  kUnknownSource,        ///< no such source (any more)
  kNonFinite,            ///< NaN or infinity in value, sigma or what comes with it, sigma (or its square) not positive,
                         ///< or more than 1e15 cycles or metres off the prediction, where doubles have no digits left
  kUndefined,            ///< no position known, outside the orbit's samples, or coincident points
  kNotPositiveDefinite,  ///< the update would have lost the covariance's sign
  kTooMany,              ///< more observables in one step than the navigator was made for
};

/// A lower-case phrase for reports; "unknown" for a value that is no enumerator.
[[nodiscard]] std::string_view to_string(ObservableUse use) noexcept;

/// What a step said of one observable.
struct ObservableReport {
  ObservableUse use = ObservableUse::kMissing;
  double innovation = std::numeric_limits<double>::quiet_NaN();  ///< z - h at the prediction [cycles or m]
  double sigma = std::numeric_limits<double>::quiet_NaN();       ///< its standard deviation by the prediction
  /// Standardised residual against all other observables of the step (Baarda's w): standard normal when all is well.
  /// NaN where it was not tested.
  double w = std::numeric_limits<double>::quiet_NaN();
};

/// What a step did.
struct OpportunisticReport {
  UpdateStatus status = UpdateStatus::kAccepted;  ///< kTimeNotAdvancing, kNonFinite: nothing changed
  int accepted = 0;                               ///< observables used; 0: the navigator coasts
  int rejected = 0;                               ///< finite but not used
  int slips = 0;                                  ///< ambiguities opened again
  int source_jumps = 0;                           ///< sources whose clock was opened again
  bool receiver_jump = false;                     ///< the receiver's clock was opened again
  double nis = 0.0;                               ///< of the tested observables, after the remedies
  int dof = 0;                                    ///< how many they are; 0: not tested
  [[nodiscard]] bool coasted() const noexcept { return accepted == 0; }
};

/// What is known of a source that is present. Components that are not estimated have their known values and NaN or
/// zero covariance.
struct OpportunisticSourceState {
  bool suspended = false;
  double slip_rate = 0.0;  ///< share of recent epochs in which it contradicted the prediction, 0 ... 1
  int slips = 0;           ///< ambiguities opened again since it joined
  int jumps = 0;           ///< clock jumps since it joined
  double clock_bias_m = 0.0;
  double clock_drift_mps = 0.0;
  Eigen::Matrix2d clock_covariance = Eigen::Matrix2d::Zero();
  double ambiguity_cycles = 0.0;
  double ambiguity_sigma_cycles = 0.0;
  Eigen::Vector3d position_e_m = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  Eigen::Matrix3d position_covariance_m2 = Eigen::Matrix3d::Zero();
};

}  // namespace soopnav::navigation
