#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/core/role.hpp"
#include "soopnav/core/status.hpp"
#include "soopnav/estimation/layout_kalman_filter.hpp"
#include "soopnav/inertial/planar_mechanization.hpp"
#include "soopnav/inertial/unmodelled_motion.hpp"

namespace soopnav::navigation {

/// What is known of a receiver when a run starts. Standard deviations of zero mean "known" (and are kept at 1e-9).
struct PlanarStart {
  double heading_rad = 0.0;
  Eigen::Vector2d velocity_mps = Eigen::Vector2d::Zero();
  Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
  double heading_sigma_rad = 0.0;
  double velocity_sigma_mps = 0.0;
  double position_sigma_m = 0.0;
};

/// A bias of every link, as a first-order Gauss-Markov process: what reflections add to a path.
struct MultipathBias {
  double sigma_m = 0.0;
  double time_constant_s = 1.0;
};

/// What a receiver may do while its inertial sensors are silent, saturated or not finite: accelerate and turn so much,
/// one standard deviation, constantly over an episode (`inertial::UnmodelledEpisode`).
struct UnmodelledMotion {
  double acceleration_mps2 = 2.0;
  double yaw_rate_radps = 0.5;
};

/// Whether the covariance knows that a heading error turns the force.
enum class HeadingCoupling {
  kFull,     ///< the transition has d v / d heading
  kLiteral,  ///< the constant Phi that crosby (3.2) prints, which leaves it out: overconfident, kept to show it
};

/// Set-up of an `OfdmInertialNavigator`.
struct OfdmInertialOptions {
  inertial::PlanarImuNoise imu{};  ///< of one sample
  /// Length of one OFDM symbol, c * M / fs [m]: boundaries are known modulo it. Infinite: no ambiguity.
  double ambiguity_m = std::numeric_limits<double>::infinity();
  Gate gate{};  ///< crosby's residual monitor: {.residual = 45, .residual_sigmas = 3}
  /// Wander of the transmitters' clocks, to be estimated: two states each. Nothing: they are perfect, or a reference
  /// receiver takes them out.
  std::optional<clock::ClockNoise> transmitter_clock{};
  double clock_drift_sigma_mps = 0.0;  ///< of a transmitter's drift at the start, c * (d/dt) [m/s]
  std::optional<MultipathBias> multipath{};
  /// Every epoch also has the boundaries of a receiver that does not move; differences to them free the mobile ones
  /// of the transmitters' clocks (crosby 3.14). Not needed where the clocks are states: there a reference is a
  /// measurement of them.
  bool reference_receiver = false;
  HeadingCoupling coupling = HeadingCoupling::kFull;
  UnmodelledMotion unmodelled{};
  double yaw_rate_range_radps = std::numeric_limits<double>::infinity();       ///< a gyro at it is saturated
  double specific_force_range_mps2 = std::numeric_limits<double>::infinity();  ///< so is an accelerometer
};

/// In `RangeChange::receiver`: the one that stands still.
inline constexpr int kReferenceReceiver = -1;

/// One OFDM block boundary against that at the start: how much farther the transmitter is.
struct RangeChange {
  int receiver = 0;
  int transmitter = 0;
  double range_change_m = 0.0;  ///< |p - q| - |p_0 - q| less c * clock of the transmitter, modulo `ambiguity_m`
  double sigma_m = 1.0;
};

/// What became of one boundary.
struct RangeChangeReport {
  UpdateStatus status = UpdateStatus::kUndefined;
  double innovation_m = std::numeric_limits<double>::quiet_NaN();  ///< wrapped into +-ambiguity / 2
  double variance_m2 = std::numeric_limits<double>::quiet_NaN();   ///< of the innovation
  double nis = std::numeric_limits<double>::quiet_NaN();
};

/// Inertial navigation in a plane, aided by the block boundaries of OFDM transmitters (crosby section 3.5).
///
/// States:  heading, velocity, position of each receiver; where asked for bias and drift of each transmitter's clock
///          and a multipath bias of each link. An extended Kalman filter over a `LayoutState`: the first receiver has
///          the roles, everything else is a block behind it.
/// Model:   z = |p - q| - |p_0 - q| - b_q + m, modulo the length of a symbol (crosby 3.5-3.9 with the sign turned: a
///          longer path is a later boundary). Innovations wrap by prediction.
/// A reference receiver's boundary enters every difference of its epoch: their common error is a state that joins and
/// is marginalised away within the epoch, so R is full without being written down.
///
/// The constructor allocates and throws std::invalid_argument for what is not finite, negative, or too many: at most
/// `kMaxReceivers`, `kMaxTransmitters` and `kMaxStates`. `predict` and `update` neither allocate nor throw; what they
/// refuse leaves the state as it was.
class OfdmInertialNavigator {
 public:
  using State = LayoutState<PlanarFrame, Role<1, HeadingTag>, Role<2, VelocityTag>, Role<2, PositionTag>>;
  static constexpr int kReceiverStates = 5;  ///< heading, velocity, position
  static constexpr int kMaxReceivers = 16;
  static constexpr int kMaxTransmitters = 64;
  static constexpr int kMaxStates = 256;

  OfdmInertialNavigator(std::span<const Eigen::Vector2d> transmitters_m, std::span<const PlanarStart> starts,
                        const OfdmInertialOptions& options);

  [[nodiscard]] int receivers() const noexcept { return static_cast<int>(receivers_.size()); }
  [[nodiscard]] int transmitters() const noexcept { return static_cast<int>(transmitters_.size()); }
  [[nodiscard]] const State& state() const noexcept { return filter_.state(); }
  [[nodiscard]] auto covariance() const noexcept { return filter_.covariance(); }
  [[nodiscard]] const OfdmInertialOptions& options() const noexcept { return options_; }

  /// First component of a receiver's five states, of a transmitter's clock (bias, drift) and of a link's multipath
  /// bias; -1 where it is no state.
  [[nodiscard]] int receiver_at(int receiver) const noexcept;
  [[nodiscard]] int clock_at(int transmitter) const noexcept;
  [[nodiscard]] int multipath_at(int receiver, int transmitter) const noexcept;

  /// What a boundary should be: the model's value at the present state (not wrapped) and its standard deviation, from
  /// the state's covariance alone. NaN for a link that is not there or a transmitter at the receiver. What a timing
  /// estimator starts from. No allocation.
  [[nodiscard]] RangeChange predicted(int receiver, int transmitter) const;

  /// Carries a receiver through `dt_s` [s] on one sample of its sensors. A sample that is not finite, or too large for
  /// the state to stay finite, says nothing: the receiver coasts. One at the end of its range is used. Both put
  /// `UnmodelledMotion` into the covariance.
  UpdateStatus predict(int receiver, const inertial::PlanarImuSample& sample, double dt_s);
  /// Carries a receiver through `dt_s` without a sample.
  UpdateStatus coast(int receiver, double dt_s);
  /// Carries clocks and multipath biases.
  UpdateStatus predict_links(double dt_s);

  /// Takes the boundaries of one epoch, in their order, those of the reference receiver first where there is one.
  /// `reports` has one place for each. A transmitter whose reference is missing or not finite cannot be used in this
  /// epoch: kNonFinite.
  void update(std::span<const RangeChange> epoch, std::span<RangeChangeReport> reports);

 private:
  struct Receiver {
    Block<1> heading{};
    Block<2> velocity{};
    Block<2> position{};
    Eigen::Vector2d start_m = Eigen::Vector2d::Zero();
    inertial::UnmodelledEpisode episode{};
  };
  struct Transmitter {
    Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
    Block<1> bias{};
    Block<1> drift{};
    // Of the epoch's reference boundary.
    Block<1> reference_error{};
    double reference_m = std::numeric_limits<double>::quiet_NaN();
  };
  [[nodiscard]] UpdateStatus move(int receiver, const inertial::PlanarImuSample& sample,
                                  const inertial::PlanarImuNoise& noise, double dt_s);
  [[nodiscard]] UpdateStatus move_unmodelled(int receiver, const inertial::PlanarImuSample& sample, double dt_s);
  [[nodiscard]] RangeChangeReport take(const RangeChange& row);
  [[nodiscard]] RangeChangeReport take_reference(const RangeChange& row);

  OfdmInertialOptions options_;
  std::vector<Receiver> receivers_;
  std::vector<Transmitter> transmitters_;
  std::vector<Block<1>> multipath_;  // receiver-major
  ExtendedKalmanFilter<State> filter_;
};

}  // namespace soopnav::navigation
