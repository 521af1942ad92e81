#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/core/status.hpp"
#include "soopnav/geometry/sampled_orbit.hpp"
#include "soopnav/navigation/cooperative_filter.hpp"
#include "soopnav/navigation/cooperative_model.hpp"

namespace soopnav::navigation {

/// Shares of the variance of a TDOA or FDOA that come from the noise of its two recordings.
struct PairNoiseShares {
  double first = 0.0;   ///< of the first recording alone: it times the other's signal
  double second = 0.0;  ///< of the second alone
  double both = 0.0;    ///< of the product of both noises: nobody else has it
};

/// Shares from the signal-to-noise ratios in the signal's band, as powers, each > 0 (infinite: no noise).
///
/// Model: Stein's 1 / snr = 1/snr_a + 1/snr_b + 1/(snr_a snr_b), term by term: the first two are the noise of one
///        recording against the signal of the other          (doc/cooperative_motion.md eq. 9-11; Stein 1981 eq. 5-7)
/// NaN for what is not positive.
[[nodiscard]] PairNoiseShares pair_noise_shares(double first_snr, double second_snr) noexcept;

/// Correlation of the errors of two targets' TDOAs (and of their FDOAs) of one burst against one anchor:
/// the geometric mean of the anchor's shares. Arguments as `pair_noise_shares`; 1/3 for all at 0 dB, 1/2 without noise.
[[nodiscard]] double shared_anchor_correlation(double first_snr, double second_snr, double anchor_snr) noexcept;

/// What a `CooperativeGroup` runs on.
struct GroupOptions {
  clock::ClockNoise anchor_clock{};   ///< how the anchor's oscillator wanders: all targets see it
  clock::ClockNoise target_clock{};   ///< and that of each target
  double horizontal_psd_m2ps3 = 0.0;  ///< white acceleration of each target along the ground, >= 0
  double vertical_psd_m2ps3 = 0.0;    ///< and upwards, >= 0
  double gate_probability = 1e-4;     ///< of refusing a good row, in [0, 1); 0: nothing is gated
  int max_targets = 8;                ///< 1 ... 64
  bool shared_anchor_noise = true;    ///< false: rows are taken for independent ones, which they are not
  bool shared_anchor_clock = true;    ///< false: clocks are taken to wander apart, which they do not
  int jump_after = 3;     ///< refused rows of a target that agree on another theta and so reopen it; 0: never
  double mask_rad = 0.0;  ///< least elevation at anchor and target; transmitters below 200 km have no horizon
};

/// One measurement of a burst: of a target against the anchor, or against another target.
struct GroupRow {
  std::int64_t target = 0;                               ///< as `join` named it
  std::int64_t reference = -1;                           ///< another target, or -1: the anchor
  double tdoa_s = 0.0;                                   ///< target less reference, positive when the target is later
  double fdoa_hz = 0.0;                                  ///< positive when the target's is higher
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();  ///< of both [s, Hz]
  double target_snr = 0.0;                               ///< in the signal's band, as a power, > 0
  double reference_snr = 0.0;                            ///< of the reference's recording
};

/// A burst as the anchor and some targets heard it.
struct GroupBurst {
  double t_s = 0.0;  ///< arrival at the anchor by its clock
  int beacon = 0;    ///< number of the beacon
  double carrier_hz = 0.0;
  Eigen::Vector3d anchor_p_e = Eigen::Vector3d::Zero();  ///< ECEF [m]
  Eigen::Vector3d anchor_v_e = Eigen::Vector3d::Zero();  ///< [m/s]
};

/// What became of a row.
enum class GroupStatus : std::uint8_t {
  kAccepted,          ///< it was taken in
  kGated,             ///< implausible
  kNonFinite,         ///< a number of it is not finite, or an SNR or the carrier not positive
  kUnknownTarget,     ///< a target that is not here (any more), or against itself
  kUnknownBeacon,     ///< no such beacon
  kOutsideOrbit,      ///< the beacon is not known at that time
  kRefused,           ///< the covariance is not positive definite, or the update would have made the state unsound
  kTimeNotAdvancing,  ///< the burst is older than the state
  kClockJump,     ///< refused, but with those before it agrees on another theta, which was reopened: the next may fit
  kBelowHorizon,  ///< the satellite cannot be seen by anchor and target
};

/// How often clocks were found to have jumped.
struct GroupJumps {
  long targets = 0;  ///< of a target alone
  long anchor = 0;   ///< of the anchor: all thetas at once
};

/// Several targets, one anchor: positions, velocities and clocks of all of them together.
///
/// Model:   each target moves as `GroundConstantVelocity` with a clock of two states against the anchor's; `PairModel`
///          for each row against the anchor, the difference of two of them between targets
///                                                            (doc/cooperative_motion.md eq. 8-15; mei's future work)
/// Noise:   the recording of the anchor is in every row of a burst and that of a target in all of its own: each
///          recording's share is a state that lives for one burst, so rows are taken in one after the other and are
///          still correlated as they should be. The anchor's clock wanders for all targets alike; likewise.
/// Jumps:   `jump_after` refused rows of a target against the anchor, one after the other, whose TDOAs agree while
/// their
///          FDOAs fit, shift its theta and reopen it by 3 sigmas of the innovation; where no other target contradicts
///          and one agrees it is the anchor's clock, and all thetas are shifted and reopened together (eq. 14). A jump
///          of frequency is not looked for.
/// Not here: a known height, roads, the age of elements and along-track states, which `CooperativeTracker` has.
/// Sequence: targets join and leave at any time; what a leaving one taught the others stays.
/// Nothing throws or allocates behind the constructor but accessors that return matrices. Time of an update: that of an
/// extended filter of 8 states for each target, 3 us a row for three of them.
class CooperativeGroup {
 public:
  /// `beacons` are copied. Throws std::invalid_argument for no beacons and options out of range, naming value and rule.
  CooperativeGroup(std::vector<geometry::SampledOrbit> beacons, double start_s, const GroupOptions& options);
  CooperativeGroup(CooperativeGroup&&) noexcept;
  CooperativeGroup& operator=(CooperativeGroup&&) noexcept;
  ~CooperativeGroup();

  /// Lets a target join at the group's present time, independent of those here: p, v (ECEF), theta, alpha and their
  /// covariance. Its name (0, 1, ... in the order of joining, never used again), or -1: no room, a number is not
  /// finite, a covariance is none.
  std::int64_t join(const PairVector& mean, const PairSquare& covariance) noexcept;
  /// Lets it leave. False when it is not here.
  bool leave(std::int64_t target) noexcept;

  /// Moves all targets to the burst and takes its rows in, one status for each. Rows beyond `out` are left out. False:
  /// the time of the burst is not finite or before the state; nothing changed.
  bool update(const GroupBurst& burst, std::span<const GroupRow> rows, std::span<GroupStatus> out) noexcept;

  [[nodiscard]] double time_s() const noexcept;
  [[nodiscard]] std::size_t beacons() const noexcept;
  [[nodiscard]] GroupJumps jumps() const noexcept;
  /// Names of the targets here, in the order of joining.
  [[nodiscard]] std::span<const std::int64_t> targets() const noexcept;
  /// Of the targets in the order of `targets`, eight each.
  [[nodiscard]] Eigen::VectorXd mean() const;
  [[nodiscard]] Eigen::MatrixXd covariance() const;

 private:
  struct Inside;
  std::unique_ptr<Inside> inside_;
};

}  // namespace soopnav::navigation
