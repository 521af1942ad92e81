#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "soopnav/geometry/rotation.hpp"

namespace soopnav::gnss {

/// Most baselines, and most satellites, of one attitude.
inline constexpr int kMaxAttitudeBaselines = 8;
inline constexpr int kMaxAttitudeSatellites = 64;

/// Angle between a baseline and the direction to a source (carter eq. 3.17), acos(path / baseline) in [0, pi]: 0 ahead
/// of the baseline. `path_m` is how much shorter the way to the baseline's end is than that to its start; noise that
/// takes |path| beyond the baseline is clipped. NaN when `path_m` is not finite or `baseline_m` is not positive.
[[nodiscard]] double arrival_angle(double path_m, double baseline_m) noexcept;

/// First-order standard deviation of `arrival_angle`, sigma / (baseline sin(angle)) [rad] (doc/attitude.md eq. 14):
/// infinite along the baseline, where the clipped error is smaller. NaN for a sigma that is negative or a baseline that
/// is not positive.
[[nodiscard]] double arrival_angle_sigma(double angle_rad, double baseline_m, double path_sigma_m) noexcept;

/// Antennas on a body and the differences of carrier phase between them.
///
/// Model (carter eq. 3.19; doc/attitude.md eq. 15): path_is = b_i . (T_b_n u_s) + noise, metres: how much nearer
/// antenna i is to satellite s than antenna 0, that is -wavelength (phase_i - phase_0) with phases that grow with range
/// and integers known. b_i in the body's axes, u_s a unit vector towards the satellite in the reference's (NED or ENU).
struct AttitudeModel {
  std::vector<Eigen::Vector3d> baselines_m;  ///< b_i: antenna i minus antenna 0, body axes; 1 ... 8 of them
  double sigma_m = 0.005;                    ///< of each path difference, > 0
  /// All antennas on one oscillator (the paper's case). Otherwise each baseline has an unknown clock term of its own,
  /// and one satellite more is needed.
  bool common_clock = true;
  /// Noise of antenna 0 is in all baselines: correlation 1/2 between the baselines of a satellite. The paper takes them
  /// as independent. Only with a common clock.
  bool shared_reference = false;

  /// Throws std::invalid_argument naming the field, its value and the rule.
  void check() const;
};

/// How an attitude ended.
enum class AttitudeStatus : std::uint8_t {
  kSolved,
  kTooFewSatellites,   ///< too few finite path differences for three angles; the filter's state is untouched
  kSatellitesInPlane,  ///< without a start the mirror image in that plane fits as well
  kUnobservable,       ///< one baseline, or parallel ones: the turn about `unobservable_b` is one of many
  kNotConverged,
  kNonFinite,   ///< a step or rate that is not finite; the state is untouched
  kGated,       ///< the filter found the epoch implausible; the state is untouched
  kGimbalLock,  ///< Euler angles near pitch +-90 deg: no update, take the quaternion
  kAmbiguous,   ///< `acquire_attitude`: other integers fit nearly as well
};

/// A lower-case phrase: "solved", "too few satellites", ...
[[nodiscard]] std::string_view to_string(AttitudeStatus status) noexcept;

/// Numbers of one epoch: row i baseline, column s satellite, row after row. NaN: not measured.
using PathMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using PathDifferences = Eigen::Ref<const PathMatrix, 0, Eigen::OuterStride<>>;

/// An attitude from one epoch. What does not exist is NaN.
struct AttitudeFix {
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

  AttitudeStatus status = AttitudeStatus::kTooFewSatellites;
  Eigen::Quaterniond q_n_b{kNan, kNan, kNan, kNan};  ///< body to reference
  geometry::Euler euler{kNan, kNan, kNan};
  /// Of the rotation vector d about the body's axes, truth = q exp(d) [rad^2].
  Eigen::Matrix3d covariance_rad2 = Eigen::Matrix3d::Constant(kNan);
  /// Of yaw, pitch, roll; NaN within 0.6 deg of pitch +-90 deg.
  Eigen::Matrix3d euler_covariance_rad2 = Eigen::Matrix3d::Constant(kNan);
  double chi_square = kNan;  ///< squared residuals over their variance
  int degrees_of_freedom = 0;
  int iterations = 0;
  Eigen::Vector3d unobservable_b = Eigen::Vector3d::Constant(kNan);  ///< kUnobservable: axis of the free turn
  double ratio = kNan;  ///< `acquire_attitude`: second-best chi-square over the best

  [[nodiscard]] bool solved() const noexcept { return status == AttitudeStatus::kSolved; }
};

/// Attitude of one epoch by non-linear least squares: Gauss-Newton on the rotation vector, from `start` or from a
/// closed form (the baselines as vectors of the reference, then Wahba's problem by its quaternion; doc/attitude.md
/// eq. 16 to 18). `directions`: u_s, as many as `path` has columns; one that is no unit vector is left out. The minimum
/// is that of the paper's Euler angles (3.19 to 3.21). Does not allocate; 5 us for 2 baselines and 8 satellites.
[[nodiscard]] AttitudeFix attitude_fix(const AttitudeModel& model, std::span<const Eigen::Vector3d> directions,
                                       const PathDifferences& path,
                                       const std::optional<Eigen::Quaterniond>& start = std::nullopt) noexcept;

/// Path differences from phase differences known up to whole cycles, about a predicted attitude: -wavelength (phase +
/// N) with N such that it lies nearest to the prediction (with a clock per baseline: after the mean fraction is
/// removed). A baseline beyond half a wavelength needs this: dropping N, as carter (2.26), is wrong for more than a
/// third of the differences at 0.9 wavelengths.
///
/// `wrapped_cycles`: antenna i minus antenna 0, growing with range, any whole cycles. Writes to `path`, same shape;
/// returns the greatest distance from the prediction, in cycles: near 1/2 the integers are not to be trusted. NaN
/// when nothing is finite. Does not allocate.
double resolve_cycles(const AttitudeModel& model, const Eigen::Quaterniond& q_n_b,
                      std::span<const Eigen::Vector3d> directions, const PathDifferences& wrapped_cycles,
                      double wavelength_m, Eigen::Ref<PathMatrix, 0, Eigen::OuterStride<>> path) noexcept;

/// Attitude of one epoch without a start from phase differences known up to whole cycles, baselines up to 3
/// wavelengths: the first baseline is searched over the sphere, the turn about it over the circle, 0.15 wavelengths
/// apart, integers rounded at each point; the best are refined. `ratio` is the second-best chi-square (another
/// attitude) over the best, `kAmbiguous` below `min_ratio`. Needs a common clock and two baselines that are not
/// parallel: `kUnobservable` otherwise. Does not allocate; 1 ms for 0.9 wavelengths.
[[nodiscard]] AttitudeFix acquire_attitude(const AttitudeModel& model, std::span<const Eigen::Vector3d> directions,
                                           const PathDifferences& wrapped_cycles, double wavelength_m,
                                           double min_ratio = 3.0) noexcept;

/// What the state of an `AttitudeFilter` is.
enum class AttitudeParameters : std::uint8_t {
  kQuaternion,  ///< quaternion with a rotation-vector error: works at any attitude
  kEuler,       ///< yaw, pitch, roll, as carter's: not near pitch +-90 deg
};

struct AttitudeFilterOptions {
  AttitudeParameters parameters = AttitudeParameters::kQuaternion;
  double rate_noise_rad_rts = 5e-3;  ///< random walk of each angle [rad/sqrt(s)], >= 0 (Q of carter 3.23, A = I)
  /// Probability with which a good epoch is refused by its NIS; 0: nothing is refused. In [0, 0.5).
  double false_alarm_probability = 0.0;

  void check() const;  ///< Throws std::invalid_argument naming the option, its value and the rule.
};

/// What an update did.
struct AttitudeUpdate {
  AttitudeStatus status = AttitudeStatus::kTooFewSatellites;
  int rows = 0;  ///< path differences used, less one for each clock that was eliminated: degrees of freedom of `nis`
  double nis = std::numeric_limits<double>::quiet_NaN();  ///< innovation' S^-1 innovation
};

/// Extended Kalman filter of an attitude (carter eq. 3.22 to 3.26, with the predicted P in the last): a random walk,
/// moved by measured rates when there are any, and updated by path differences. The update is written with the
/// information of the epoch, P = (P^-1 + H'R^-1 H)^-1 (doc/attitude.md eq. 19 to 22): the same numbers as with the
/// gain, at the cost of a 3 x 3 matrix, and clocks are eliminated on the way. After construction nothing allocates.
class AttitudeFilter {
 public:
  /// `covariance_rad2`: of the rotation vector about the body's axes, or of yaw, pitch, roll.
  /// @throws std::invalid_argument for a model or an option out of range, a start that is not a unit quaternion, and
  /// a covariance that is not symmetric positive semi-definite.
  AttitudeFilter(AttitudeModel model, const AttitudeFilterOptions& options, const Eigen::Quaterniond& start_q_n_b,
                 const Eigen::Matrix3d& covariance_rad2);

  /// Over `dt_s` >= 0; `rate_radps`: of the body against the reference, body axes. The state is untouched unless
  /// `kSolved` is returned.
  AttitudeStatus predict(double dt_s, const Eigen::Vector3d& rate_radps = Eigen::Vector3d::Zero()) noexcept;
  AttitudeUpdate update(std::span<const Eigen::Vector3d> directions, const PathDifferences& path) noexcept;

  [[nodiscard]] const AttitudeModel& model() const noexcept { return model_; }
  [[nodiscard]] const AttitudeFilterOptions& options() const noexcept { return options_; }
  [[nodiscard]] Eigen::Quaterniond attitude() const noexcept { return q_n_b_; }
  [[nodiscard]] geometry::Euler euler() const noexcept { return euler_; }
  /// Of the rotation vector about the body's axes (quaternion), or of yaw, pitch, roll (Euler).
  [[nodiscard]] const Eigen::Matrix3d& covariance_rad2() const noexcept { return P_; }

 private:
  void set_euler(const Eigen::Vector3d& yaw_pitch_roll) noexcept;

  AttitudeModel model_;
  AttitudeFilterOptions options_;
  Eigen::Quaterniond q_n_b_;
  geometry::Euler euler_;
  Eigen::Matrix3d P_;
};

/// E with d = E (yaw, pitch, roll)': the small rotation about the body's axes that small changes of the Euler angles
/// make, T(e + de) = T(e) exp([d x]). Singular at pitch +-90 deg.
[[nodiscard]] Eigen::Matrix3d rotation_from_euler_change(const geometry::Euler& euler) noexcept;

/// The error of a heading that is the direction between two positions (carter section 3.3, figs. 3.12 to 3.14).
struct HeadingError {
  double linear_sigma_rad = 0.0;       ///< sqrt(2) sigma / baseline: what holds for long baselines
  double rms_rad = 0.0;                ///< exact; pi / sqrt(3) without a baseline
  double inversion_probability = 0.0;  ///< that the error exceeds 90 deg (fig. 3.14)
};

/// Error of the heading between two antennas `baseline_m` apart in the plane, each position with independent normal
/// errors of `position_sigma_m` per axis (doc/attitude.md eq. 23 to 25; quadrature, no allocation). NaN for a baseline
/// that is negative, a sigma that is not positive, and either when infinite.
[[nodiscard]] HeadingError heading_error(double baseline_m, double position_sigma_m) noexcept;

/// Probability density of that error at `error_rad` in [-pi, pi] [1/rad], for `kappa` = baseline / (sqrt(2) sigma).
[[nodiscard]] double heading_error_density(double error_rad, double kappa) noexcept;

}  // namespace soopnav::gnss
