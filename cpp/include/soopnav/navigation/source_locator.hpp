#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>

/// Where a source is, from bearings that a moving platform takes (carter 5.4; doc/source_location.md).
///
/// Frame: local planar metres, first axis x (east), second y (north), third up. Azimuths count from x towards y (carter
/// 5.4: atan2(dy, dx)), elevations up from the horizontal (5.7). Radians throughout.
namespace soopnav::navigation {

/// How the bearings become a position.
enum class SourceMethod : std::uint8_t {
  kCentroid,           ///< running mean of the centroids of triangles of bearings (carter 5.2)
  kIncenter,           ///< running mean of their incentres (carter 5.3)
  kLinear,             ///< pseudo-linear least squares as printed (carter 5.8): no weights, biased by far bearings
  kStansfield,         ///< the same weighted by 1 / (range² sigma²), the ranges iterated: as good as the likelihood
  kLeastSquares,       ///< weighted non-linear least squares on the angles
  kMaximumLikelihood,  ///< wrapped normal plus an outlier floor: adaptive grid, then Newton
  kExtendedKalman,     ///< one extended Kalman filter (carter 5.9 to 5.13); it diverges in a few per cent of starts
  kEkfBank,            ///< filters that share one bearing and differ in range
  kParticle,           ///< particle filter (carter Algorithm 1 with the weight w p(e), an outlier floor, regularised)
};

/// What the source does between bearings.
enum class SourceMotion : std::uint8_t { kStatic, kConstantVelocity };

/// What became of a bearing.
enum class BearingUse : std::uint8_t {
  kUsed,
  kNotFinite,   ///< a number of it is NaN or infinite
  kBadSigma,    ///< a standard deviation is not positive or above 1000 rad, or a variance is negative
  kOutOfOrder,  ///< earlier than the one before (filters and moving sources only)
  kWaiting,     ///< the bank starts at the first bearing that is good enough; this came before
  kUndefined,   ///< every estimate lies on the platform, from where there is no direction to it
};

/// How a fix ended.
enum class SourceStatus : std::uint8_t {
  kConverged,
  kTooFewBearings,  ///< no position yet
  kUnobservable,    ///< parallel bearings, or all from one place: see `line`; a position is the start's or the prior's
  kInconsistent,    ///< no position explains the bearings: chi-square, or too many outliers
  kOnPlatform,      ///< the estimate is not told from a place where the platform was
  kNotConverged,    ///< no minimum found; `position_m` is the best point seen
  kDiverged,        ///< no particle, filter or number explains the bearings any more
};

[[nodiscard]] std::string_view to_string(SourceMethod method) noexcept;
[[nodiscard]] std::string_view to_string(BearingUse use) noexcept;
[[nodiscard]] std::string_view to_string(SourceStatus status) noexcept;

/// A bearing, where it was taken and what it is worth.
struct SourceBearing {
  double t_s = 0.0;
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();  ///< of the platform
  double azimuth_rad = 0.0;
  double elevation_rad = 0.0;  ///< read in three dimensions only
  double sigma_azimuth_rad = 0.0;
  double sigma_elevation_rad = 0.0;                                  ///< read in three dimensions only
  Eigen::Matrix3d position_covariance_m2 = Eigen::Matrix3d::Zero();  ///< of `position_m`
  double heading_sigma_rad = 0.0;                                    ///< of the heading, added to the azimuth's
};

/// What a locator may assume.
struct SourceOptions {
  SourceMethod method = SourceMethod::kMaximumLikelihood;
  int dimensions = 2;  ///< 2: azimuths. 3: azimuths and elevations
  SourceMotion motion = SourceMotion::kStatic;

  std::optional<Eigen::Vector3d> start_m = std::nullopt;  ///< a first guess; filters start from the bearings without
  double start_sigma_m = 1000.0;                          ///< 1-sigma of each coordinate of it, > 0
  double start_speed_sigma_mps = 10.0;                    ///< of each component of a moving source's velocity, > 0
  double acceleration_psd = 0.0;  ///< white acceleration of a moving source [m²/s³]; filters only

  double min_range_m = 30.0;            ///< nearest source a bank without a start looks for, > 0
  double max_range_m = 3000.0;          ///< farthest source that bank, grid and particles look for, > min_range_m
  double outlier_probability = 0.02;    ///< of a bearing from anywhere (likelihood, bank, particles), in [0, 1)
  double heading_bias_sigma_rad = 0.0;  ///< > 0: a constant error of all azimuths is estimated, of this 1-sigma

  double min_crossing_rad = 0.17453292519943295;  ///< of the bearings of a triangle, modulo half a turn (10 degrees)
  int triple_spacing = 10;                        ///< triangles of epochs k - 2 s, k - s, k

  int grid_size = 64;       ///< cells along a side of the first grid, 8 ... 512
  int max_iterations = 50;  ///< of each Newton search, at least 1

  std::size_t particles = 10000;  ///< 16 ... 10 000 000
  double ess_threshold = 0.5;     ///< resampled when the effective share of particles is less, in (0, 1]
  std::uint64_t seed = 0;

  int filters = 10;                             // ranges of the bank, geometric from min to max, 2 ... 64
  double bank_sigma_rad = 0.17453292519943295;  ///< of each angle that starts it; later ones need not be better
  int bank_azimuths = 0;  ///< > 0: no waiting, this many directions times `filters` at the first bearing, at most 36

  std::size_t max_bearings = 4096;        ///< kept by the methods that solve for all at once; older ones are dropped
  double false_alarm_probability = 1e-4;  ///< of the test for contradictory bearings, in (0, 0.5)

  /// Throws std::invalid_argument naming the option, its value and the rule.
  void check() const;
};

/// The line on which the source lies when its range is not determined.
struct SourceLine {
  Eigen::Vector3d point_m = Eigen::Vector3d::Zero();     ///< a place of the platform
  Eigen::Vector3d direction = Eigen::Vector3d::UnitX();  ///< unit vector towards the source
  double sigma_rad = 0.0;                                ///< of the direction's azimuth
};

/// A source's position and what it is worth. Values that do not exist are NaN.
struct SourceFix {
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  SourceStatus status = SourceStatus::kTooFewBearings;
  BearingUse last = BearingUse::kUsed;  ///< what became of the last bearing
  int dimensions = 2;
  Eigen::Vector3d position_m = Eigen::Vector3d::Constant(kNan);     ///< at the last bearing; third zero in the plane
  Eigen::Matrix3d covariance_m2 = Eigen::Matrix3d::Constant(kNan);  ///< third row and column zero in the plane
  Eigen::Vector3d velocity_mps = Eigen::Vector3d::Constant(kNan);   ///< of a moving source
  Eigen::Matrix3d velocity_covariance = Eigen::Matrix3d::Constant(kNan);  ///< [m²/s²]
  double heading_bias_rad = kNan;
  double heading_bias_sigma_rad = kNan;
  double cep_m = kNan;  ///< radius that holds the horizontal error with probability one half
  /// Of the residuals of bearings that are no outliers (methods that keep the bearings); of the last twelve innovations
  /// (EKF).
  double chi_square = kNan;
  int degrees_of_freedom = 0;  ///< of `chi_square`
  std::size_t used = 0;        ///< bearings
  std::size_t rejected = 0;    ///< bearings left out: not finite, bad sigma, out of order, waiting
  std::size_t outliers = 0;    ///< of those used: more likely from the floor than from the source
  std::optional<SourceLine> line = std::nullopt;

  /// One sentence. Allocates.
  [[nodiscard]] std::string message() const;
};

/// Bearings in, a position out; one bearing at a time or all before the first question.
///
/// Model: azimuth = atan2(dy, dx) + heading bias, elevation = atan2(dz, hypot(dx, dy)) for the vector d from platform
/// to source (carter 5.4, 5.7), with normal errors of variance sigma² + heading sigma² + what the platform's position
/// covariance leaves across the line of sight (doc/source_location.md eq. 3). For a moving source d is that of the
/// bearing's time. Each method's own equations are in doc/source_location.md.
///
/// Moving sources: kLeastSquares, kMaximumLikelihood, kExtendedKalman and kEkfBank. Heading bias: the same four.
/// Cost of a step: filters O(1) each; kLinear and the geometric means O(1) each; the others solve for all bearings
/// kept. Nothing allocates after construction. Same options and bearings, same bits. Move-only.
class SourceLocator {
 public:
  /// Throws std::invalid_argument for the options.
  explicit SourceLocator(const SourceOptions& options);
  SourceLocator(SourceLocator&&) noexcept;
  SourceLocator& operator=(SourceLocator&&) noexcept;
  ~SourceLocator();

  /// Takes a bearing without solving. One that is refused changes nothing but the counts.
  BearingUse observe(const SourceBearing& bearing) noexcept;
  /// The source as of all bearings so far.
  [[nodiscard]] SourceFix fix() noexcept;
  /// `observe`, then `fix`.
  SourceFix step(const SourceBearing& bearing) noexcept;
  /// As new, with another start and seed.
  void reset(const std::optional<Eigen::Vector3d>& start_m, std::uint64_t seed) noexcept;

  [[nodiscard]] const SourceOptions& options() const noexcept;
  /// Of kParticle: coordinates along `axis` (0 ... dimensions - 1), and weights that sum to one after `fix`. Empty
  /// otherwise.
  [[nodiscard]] std::span<const double> particles(int axis) const noexcept;
  [[nodiscard]] std::span<const double> weights() const noexcept;
  /// Of kEkfBank: its members' positions and weights. Number of members.
  [[nodiscard]] std::size_t members() const noexcept;
  [[nodiscard]] Eigen::Vector3d member_position_m(std::size_t i) const noexcept;
  [[nodiscard]] double member_weight(std::size_t i) const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::navigation
