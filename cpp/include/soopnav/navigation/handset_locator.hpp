#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "soopnav/clock/clock_noise.hpp"

/// Where a handset is indoors, from ranges to radio nodes and the steps of a camera that looks at the ground
/// (nielsen 4.2.3; doc/handset.md).
///
/// Frame: planar, right-handed, z up, metres. Headings count from x towards y. The body's first axis is the image's
/// right, its second the image's up (vision/planar_motion.hpp).
namespace soopnav::navigation {

inline constexpr int kMaxHandsetNodes = 12;

/// The two filters of nielsen 4.2.3.
enum class HandsetFilter : std::uint8_t {
  kControl,      ///< type 1, [x y b a_z]: the camera's increments move the particles
  kMeasurement,  ///< type 2, [x y b a_z v_x v_y]: they are measurements of a walk of nearly constant velocity
};

/// Whose clock the ranges carry.
enum class HandsetClock : std::uint8_t {
  kCommon,    ///< one receiver bias b for all nodes
  kSeparate,  ///< a bias for each node, all of the same noise: nodes that share no time
};

/// What became of an observation.
enum class HandsetUse : std::uint8_t {
  kUsed,
  kNotFinite,       ///< a time or an increment is NaN or infinite, or a covariance is no covariance: nothing done
  kOutOfOrder,      ///< earlier than the observation of its kind before it: nothing done
  kClocksDisagree,  ///< camera's and radio's times differ by more than `max_disagreement_s`: nothing done
  kNothingHeard,    ///< no range (bearing) of it is a number with a positive sigma; time goes on
  kCoasted,         ///< a frame without an increment: the pose becomes less certain
  kOutliers,        ///< used, but most of the links fitted neither with nor without excess delay
  kRecovered,       ///< so for `recover_after` epochs: the cloud was spread out again, then used; or no particle was a
                    ///< number any more: all began anew as at the start
  kWalls,           ///< all particles left the room: walls ignored at this step
  kTooFast,         ///< a step beyond `max_speed_mps` or of more than a whole turn: coasted instead
};

/// What the estimate rests on.
enum class HandsetStatus : std::uint8_t {
  kStarting,    ///< nothing observed yet: the prior
  kTracking,    ///< radio and camera
  kCoasting,    ///< radio, no camera for `coast_after_s`
  kCameraOnly,  ///< camera, no radio for `coast_after_s` or longer
  kDeadTime,    ///< neither
};

[[nodiscard]] std::string_view to_string(HandsetFilter filter) noexcept;
[[nodiscard]] std::string_view to_string(HandsetClock clock) noexcept;
[[nodiscard]] std::string_view to_string(HandsetUse use) noexcept;
[[nodiscard]] std::string_view to_string(HandsetStatus status) noexcept;

/// What a locator may assume.
struct HandsetOptions {
  HandsetFilter filter = HandsetFilter::kControl;
  std::size_t particles = 2000;  ///< 1 ... 1 000 000
  std::uint64_t seed = 0;
  double ess_threshold = 0.5;  ///< resampled when the effective share of particles is less, in (0, 1]

  std::vector<Eigen::Vector3d> nodes_m;  ///< antennas, 1 ... kMaxHandsetNodes
  /// Empty: all known. Else 1-sigma of each horizontal coordinate of each node; above zero it is estimated as well, by
  /// an extended Kalman filter in each particle from `nodes_m` on. That start has to be nearer than the ranges are
  /// long.
  std::vector<double> node_sigma_m;
  double height_m = 0.0;  ///< of the handset's antenna, z of the same frame

  Eigen::Vector2d start_m = Eigen::Vector2d::Zero();
  double start_sigma_m = 10.0;           ///< of each coordinate, > 0
  double start_heading_rad = 0.0;        ///< a_z
  double start_heading_sigma_rad = 3.2;  ///< > 0; from pi on the heading is uniform
  /// Each particle stands for a Gaussian of its own: this share of the start's sigmas, at most `kernel_m` and
  /// `kernel_rad`. In (0, 1]; 1 with a single particle makes an extended Kalman filter.
  double kernel = 0.35;
  double kernel_m = 2.0;
  double kernel_rad = 0.12;

  HandsetClock clock = HandsetClock::kCommon;
  double clock_start_m = 0.0;
  double clock_sigma_m = 1000.0;             ///< > 0
  clock::ClockNoise clock_noise{0.04, 0.0};  ///< of the bias: 0.2 m/sqrt(s), a TCXO over the seconds that matter
  double clock_drift_sigma_mps = 0.0;        ///< > 0: the drift is estimated; needed for a frequency walk
  double node_offset_sigma_m = 0.0;          ///< > 0: each node's time is off by so much, on top of the common clock
  double node_offset_walk_m2ps = 0.0;        ///< and wanders

  bool nlos = true;                 ///< a Boolean per link: with or without excess delay
  double mean_los_s = 10.0;         ///< mean time a link stays without it, > 0
  double mean_nlos_s = 5.0;         ///< and with it, > 0
  double excess_min_m = 4.0;        ///< >= 0
  double excess_max_m = 20.0;       ///< > excess_min_m; entered as the normal of a uniform's moments
  double excess_walk_m2ps = 0.025;  ///< 0.05 m per sample at 10 Hz
  /// > 0: each link's range is off by something that changes as the handset walks, of this deviation, with line of
  /// sight and without: paths too near to the first to be told apart (doc/handset.md eq. 8). One more number per link.
  double multipath_sigma_m = 0.0;
  double multipath_length_m = 1.0;    ///< walked until its correlation is 1/e, > 0
  double outlier_probability = 1e-3;  ///< of a range or bearing from anywhere, in [0, 0.5); 0: beyond 37 sigmas only
  double outlier_span_m = 200.0;      ///< over which such ranges spread, > 0
  int recover_after = 10;             ///< epochs with most links outliers until the cloud is spread out again, >= 1

  double acceleration_psd_m2ps3 = 0.5;  ///< of type 2's velocity
  double start_speed_sigma_mps = 1.0;   ///< of each component of it; both types: how fast one walks without a camera
  double turn_psd_rad2ps = 0.5;         ///< of type 2's heading between frames
  double coast_psd_m2ps = 0.5;          ///< of the position while the camera is missing (type 1)
  double coast_turn_psd_rad2ps = 0.1;   ///< of the heading
  double coast_after_s = 0.25;          ///< without a frame, > 0; up to then the last step's velocity is taken on
  double max_speed_mps = 100.0;         ///< no step is faster, > 0; the first one is taken to last a second
  double max_disagreement_s = 2.0;      ///< a radio epoch may be so much older than the last frame, >= 0

  std::vector<Eigen::Vector2d> room_m;   ///< a polygon that is not left; empty: none
  std::vector<Eigen::Vector4d> walls_m;  ///< x0 y0 x1 y1 of walls that are not walked through

  /// LTE alone: an extended Kalman filter of nearly constant velocity with one clock and no Booleans.
  [[nodiscard]] static HandsetOptions lte_alone(std::vector<Eigen::Vector3d> nodes_m);
  /// Throws std::invalid_argument naming the option, its value and the rule.
  void check() const;
};

/// A step of the camera, as vision::PlanarMotion has it.
struct HandsetMotion {
  Eigen::Vector3d increment = Eigen::Vector3d::Zero();         ///< dx, dy [m] in the axes of the previous body, da_z
  Eigen::Matrix3d track_covariance = Eigen::Matrix3d::Zero();  ///< of what is independent from step to step
  Eigen::Matrix2d foot_covariance_previous = Eigen::Matrix2d::Zero();  ///< of the foot points, each in its body's axes
  Eigen::Matrix2d foot_covariance = Eigen::Matrix2d::Zero();

  /// Of a motion that has these fields, as vision::PlanarMotion.
  template <class Motion>
  [[nodiscard]] static HandsetMotion of(const Motion& m) {
    return {m.increment, m.track_covariance, m.foot_covariance_previous, m.foot_covariance};
  }
};

/// What came of an observation.
struct HandsetReport {
  HandsetUse use = HandsetUse::kUsed;
  int heard = 0;              ///< links
  double outliers = 0.0;      ///< share of particles and links that took an observation for an outlier
  double ess = 0.0;           ///< effective number of particles
  double log_evidence = 0.0;  ///< of this observation given those before it
};

/// Where the handset is. Values that do not exist are NaN.
struct HandsetEstimate {
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  HandsetStatus status = HandsetStatus::kStarting;
  double t_s = kNan;                                                ///< of the last observation
  Eigen::Vector2d position_m = Eigen::Vector2d::Constant(kNan);     ///< mean
  Eigen::Matrix2d covariance_m2 = Eigen::Matrix2d::Constant(kNan);  ///< of the whole mixture
  double heading_rad = kNan;                                        ///< circular mean
  double heading_sigma_rad = kNan;                                  ///< circular: sqrt(-2 ln R)
  Eigen::Vector2d velocity_mps = Eigen::Vector2d::Constant(kNan);   ///< type 2's state; type 1: of the last step
  double clock_m = kNan;                                            ///< common clock, or the first node's
  double clock_sigma_m = kNan;
  Eigen::Vector2d mode_m = Eigen::Vector2d::Constant(kNan);  ///< of the heaviest group of particles
  double mode_share = kNan;  ///< weight within 3 of that group's sigmas (at least 0.3 m); below 0.9: `multimodal`
  bool multimodal = false;
  double ess = kNan;
  int nodes = 0;
  std::array<double, kMaxHandsetNodes> p_los{};            ///< probability that the link has no excess delay
  std::array<double, kMaxHandsetNodes> excess_m{};         ///< its mean where it has; NaN where no particle says so
  std::array<double, kMaxHandsetNodes> offset_m{};         ///< a node's own time, or clock where they are separate
  std::array<Eigen::Vector2d, kMaxHandsetNodes> node_m{};  ///< places, estimated or given
  std::array<double, kMaxHandsetNodes> node_sigma_m{};     ///< root of half the trace of their covariance
};

/// Fuses ranges, bearings and a camera's steps.
///
/// Model: range z_l = |p - q_l| + b (+ o_l) + s_l e_l + n, s_l a Boolean that switches as a Markov chain, e_l its
/// excess delay; camera f_k = f_(k-1) + R(a) (d + n), a_k = a_(k-1) + d_a + n, where f = p + R(a) eps is the foot point
/// that the fitted plane leads to: eps is of one frame and does not accumulate (doc/handset.md eq. 1 to 9). Each
/// particle samples the Booleans, from their distribution given the present range, and carries one joint Gaussian of
/// all else (Rao-Blackwellised): pose, clock, excess delays, offsets, unknown places.
///
/// Cost: 2000 particles, 6 links at 10 Hz, 20 frames and 10 estimates a second: 1 % of a core, type 2: 2 to 3 %. An
/// estimate reads all particles (0.1 ms) and uses scratch of the object. Nothing allocates after construction. One
/// thread: the same options and observations give the same bits. Move-only.
class HandsetLocator {
 public:
  /// Throws std::invalid_argument for the options.
  explicit HandsetLocator(const HandsetOptions& options);
  HandsetLocator(HandsetLocator&&) noexcept;
  HandsetLocator& operator=(HandsetLocator&&) noexcept;
  ~HandsetLocator();

  /// The step that ends at `t_s`, since the frame before. It may come after ranges of a later time: type 2 goes back to
  /// it with its velocity, and forth again.
  HandsetReport move(const HandsetMotion& motion, double t_s) noexcept;
  /// No step is known up to `t_s` (too few tracks, dropped frames): the pose becomes less certain.
  HandsetReport coast(double t_s) noexcept;
  /// Ranges to all nodes at `t_s` [m], of standard deviations `sigma_m`, of which those below 0.1 mm count as that; NaN
  /// where a node is not heard.
  /// Spans of another length than the nodes are kNotFinite.
  HandsetReport update_ranges(std::span<const double> range_m, std::span<const double> sigma_m, double t_s) noexcept;
  /// Bearings to the nodes [rad], from the body's first axis (`of_body`) or from the frame's x, towards y. `mirror_rad`
  /// are the second answers of a straight synthetic array, equally likely; empty or NaN: none. A bearing tells of links
  /// without excess delay only.
  HandsetReport update_bearings(std::span<const double> bearing_rad, std::span<const double> sigma_rad, double t_s,
                                bool of_body = true, std::span<const double> mirror_rad = {}) noexcept;

  [[nodiscard]] HandsetEstimate estimate() const noexcept;
  /// Writes each particle's x, y, heading and weight: the means of their Gaussians, or draws from these (for plots; the
  /// same ones when asked again). Spans of `options().particles` numbers, or empty.
  void particles(std::span<double> x_m, std::span<double> y_m, std::span<double> heading_rad, std::span<double> weight,
                 bool draw = false) const noexcept;
  /// As new, with another seed.
  void reset(std::uint64_t seed) noexcept;
  [[nodiscard]] const HandsetOptions& options() const noexcept;
  /// Numbers that each particle's Gaussian has.
  [[nodiscard]] int dimension() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::navigation
