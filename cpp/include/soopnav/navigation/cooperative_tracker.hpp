#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "soopnav/estimation/rts_smoother.hpp"
#include "soopnav/geometry/sampled_orbit.hpp"
#include "soopnav/navigation/cooperative_filter.hpp"
#include "soopnav/navigation/cooperative_start.hpp"

namespace soopnav::navigation {

/// Which of the built-in engines.
enum class PairForm : std::uint8_t {
  kJoseph,       ///< covariance, Joseph's form
  kInformation,  ///< information matrix (mei 6c)
};

/// What became of a burst. Anything but `kAccepted`, `kClockJump` and `kFrequencyJump` changed no state but time.
enum class PairUse : std::uint8_t {
  kAccepted,
  kGated,             ///< contradicts the prediction
  kBelowHorizon,      ///< the satellite cannot be seen by both
  kOutsideEphemeris,  ///< nothing is known of the beacon at that time
  kNotFinite,         ///< NaN, infinity, a carrier that is not positive, or what no clock shows: 1e6 s, 1e-3 of it
  kNotAdvancing,      ///< before the last one
  kUnknownBeacon,     ///< a number that no beacon has
  kBadCovariance,     ///< the burst's: not positive definite
  kNotStarted,        ///< there is no estimate yet
  kClockJump,         ///< accepted after theta was reopened: bursts agreed on another one
  kFrequencyJump,     ///< accepted after theta and alpha were
  kBadState,          ///< the estimate's own covariance is no longer sound: start anew
};
inline constexpr int kPairUses = 12;
[[nodiscard]] std::string_view to_string(PairUse use) noexcept;

/// A transmitter: where it is, and how old that knowledge is.
struct PairBeacon {
  geometry::SampledOrbit orbit;
  double epoch_s = std::numeric_limits<double>::quiet_NaN();  ///< of its elements, for their age; NaN: always fresh
};

/// What a tracker runs on.
struct CooperativeOptions {
  clock::ClockNoise target_clock{};
  clock::ClockNoise anchor_clock{};
  double acceleration_psd_m2ps3 = 0.0;  ///< of a target that moves; 0: it stands
  double velocity_sigma_mps = 1e-3;     ///< prior of each axis at a batch start; standing still is knowledge: 1 mm/s
  PairForm form = PairForm::kJoseph;
  int iterations = 1;              ///< linearisations of each update
  double gate_probability = 1e-6;  ///< of a good burst to be refused; 0: no gate
  double mask_rad = 0.0;           ///< least elevation at both receivers; transmitters below 200 km have no horizon
  double anchor_drift_mps = 0.0;   ///< c times the anchor's own skew where it is known

  double height_m = 0.0;                                            ///< above the ellipsoid ...
  double height_sigma_m = std::numeric_limits<double>::infinity();  ///< ... known so well; infinite: not at all
  std::vector<Eigen::Vector3d> road_p_e{};                          ///< polyline the target keeps to; empty: none
  double road_sigma_m = 10.0;                                       ///< across it

  double orbit_sigma_m = 0.0;     ///< 1-sigma along-track error of fresh elements; 0: orbits are exact
  double orbit_sigma_mps = 0.0;   ///< its growth with age: a kilometre or two per day, 0.02
  int along_track_states = 0;     ///< room for estimating it, per beacon; 0: noise, so much that it is no optimist
  double forget_after_s = 900.0;  ///< a beacon's along-track state leaves when it was not heard for so long

  /// Refused bursts that agree on another theta (or alpha) and so reopen it, as do accepted ones that lean to one side;
  /// 0: never.
  int jump_after = 3;
  int smoother_capacity = 0;  ///< updates kept for `smooth`; 0: none

  /// Throws std::invalid_argument naming the option that breaks its rule.
  void check() const;
  [[nodiscard]] PairFilterOptions filter() const noexcept;
};

/// What came of a burst.
struct PairReport {
  PairUse use = PairUse::kNotStarted;
  Eigen::Vector2d innovation = Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());  ///< [m], [m/s]
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Constant(std::numeric_limits<double>::quiet_NaN());  ///< of it
  double nis = std::numeric_limits<double>::quiet_NaN();
  [[nodiscard]] bool accepted() const noexcept {
    return use == PairUse::kAccepted || use == PairUse::kClockJump || use == PairUse::kFrequencyJump;
  }
};

/// Where the target is and how far its clock is off.
struct PairEstimate {
  double t_s = std::numeric_limits<double>::quiet_NaN();
  PairVector mean = PairVector::Constant(std::numeric_limits<double>::quiet_NaN());  ///< p, v (ECEF), theta, alpha
  PairSquare covariance = PairSquare::Constant(std::numeric_limits<double>::quiet_NaN());
  double silent_s = std::numeric_limits<double>::quiet_NaN();  ///< since a burst was last accepted
};

/// Two receivers, one unknown: position, velocity and clock of a target from bursts that an anchor heard as well (mei).
///
/// State [p v theta alpha] in ECEF; theta = c (b_target - b_anchor), alpha its rate. Bursts come one by one, each of
/// one beacon, and each is validated, predicted to, innovated, gated, taken and counted. doc/cooperative.md has the
/// model, the constraints, the jumps of clocks and the start. After construction `update` and `coast` do not allocate,
/// 3 us.
class CooperativeTracker {
 public:
  /// @throws std::invalid_argument for no beacons or an option out of range.
  CooperativeTracker(std::vector<PairBeacon> beacons, const CooperativeOptions& options);
  /// With an engine of one's own (several modes, an IMU); the options' `form`, `iterations` and motion are then its.
  CooperativeTracker(std::vector<PairBeacon> beacons, const CooperativeOptions& options,
                     std::unique_ptr<CooperativeFilter> engine);

  /// Starts from a known mean and positive definite covariance (std::invalid_argument otherwise) at `t_s`.
  void start_at(double t_s, const PairVector& mean, const PairSquare& P);
  /// Starts from bursts alone (`start_pair`; clocks, height, mask and motion are the tracker's) and restarts the engine
  /// at the last of them, where a place fits: kFound, or kAmbiguous, the best of several. Else nothing changes. Bursts
  /// of the start come back as kNotAdvancing.
  PairStart start(std::span<const PairMeasurement> measurements, PairStartOptions search = {});

  /// Takes a burst in. A negative step of time is refused, none is not: two beacons may be heard at once.
  PairReport update(const PairMeasurement& measurement) noexcept;
  /// Moves to `t_s` without a burst. False when that is not after the present time.
  bool coast(double t_s) noexcept;

  [[nodiscard]] bool started() const noexcept { return started_; }
  [[nodiscard]] PairEstimate estimate() const noexcept;
  /// How often each `PairUse` occurred.
  [[nodiscard]] const std::array<long, kPairUses>& counts() const noexcept { return counts_; }
  /// Along-track error of beacon `number` [m]: false when it is not estimated now.
  [[nodiscard]] bool along_track(int number, double& mean_m, double& sigma_m) const noexcept {
    return engine_->along_track(number, mean_m, sigma_m);
  }
  [[nodiscard]] const CooperativeOptions& options() const noexcept { return options_; }
  [[nodiscard]] std::span<const PairBeacon> beacons() const noexcept { return beacons_; }
  [[nodiscard]] CooperativeFilter& engine() noexcept { return *engine_; }

  /// Fixed-interval smoothing over all updates since the start (kFull when there were more than there is room for: the
  /// first `smoother_capacity` are smoothed). Times beside the states.
  SmoothStatus smooth() noexcept;
  [[nodiscard]] std::span<const SmoothedState<PositionVelocityClock<EcefFrame, 3>>> smoothed() const noexcept;
  [[nodiscard]] std::span<const double> smoothed_t_s() const noexcept { return record_t_s_; }

 private:
  struct Suspect {  // refused bursts that agree with each other
    int run = 0;
    Eigen::Vector2d innovation = Eigen::Vector2d::Zero();
    Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
    bool rate_fits = false;
    int beacon = -1;
    bool two_beacons = false;
  };
  struct Taken {  // an accepted burst: what remained of it, in metres and in sigmas
    Eigen::Vector2d innovation = Eigen::Vector2d::Zero();
    Eigen::Vector2d sigmas = Eigen::Vector2d::Zero();
    int beacon = -1;
  };
  struct Opening {  // what a jump of a clock asks for
    PairUse use = PairUse::kGated;
    double theta_m = 0.0, alpha_mps = 0.0;     // the means move by
    double theta_m2 = 0.0, alpha_m2ps2 = 0.0;  // the variances grow by
  };
  using Step = StepRecord<PositionVelocityClock<EcefFrame, 3>>;
  static constexpr std::size_t kWindow = 20;  // accepted bursts looked at together

  [[nodiscard]] PairUse check(const PairMeasurement& m, PairObservation& observed) const noexcept;
  [[nodiscard]] double orbit_sigma_m(const PairBeacon& beacon, double t_s) const noexcept;
  bool move_to(double t_s) noexcept;
  void constrain() noexcept;
  void hold_to(const Eigen::Vector3d& normal, const Eigen::Vector3d& point, double sigma_m) noexcept;
  void note_orbit_error(const PairMeasurement& m, const PairModel<>& model, PairObservation& observed) noexcept;
  Opening look_for_jump(const PairMeasurement& m, const PairReport& report) noexcept;
  void look_for_lean(int beacon, const PairReport& report) noexcept;
  bool open_clock(const Opening& opening) noexcept;
  PairUse open_waiting() noexcept;
  void open_step() noexcept;
  void close_step() noexcept;
  void record(bool spare = false) noexcept;

  std::vector<PairBeacon> beacons_;
  CooperativeOptions options_;
  std::unique_ptr<CooperativeFilter> engine_;
  Gate gate_;
  double single_gate_ = 0.0;  // of one row
  bool started_ = false;
  double t_s_ = std::numeric_limits<double>::quiet_NaN();
  double accepted_t_s_ = std::numeric_limits<double>::quiet_NaN();
  std::array<long, kPairUses> counts_{};
  std::vector<double> heard_t_s_;  // of each beacon
  std::vector<long> orbit_uses_;   // of each beacon: bursts taken since the start
  bool from_batch_ = false;
  double batch_t_s_ = std::numeric_limits<double>::quiet_NaN();  // of the start, and the beacons it heard then
  std::vector<int> batch_beacons_;
  Suspect suspect_;
  Opening waiting_;  // with the next prediction
  std::array<Taken, kWindow> window_{};
  std::size_t taken_ = 0;  // since the clock was last reopened
  std::unique_ptr<RtsSmoother<PositionVelocityClock<EcefFrame, 3>>> smoother_;
  Step step_;
  std::vector<double> record_t_s_;
  bool smoother_full_ = false;
  int spare_used_ = 0;
};

}  // namespace soopnav::navigation
