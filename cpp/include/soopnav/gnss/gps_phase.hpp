#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "soopnav/core/epoch.hpp"
#include "soopnav/gnss/atmosphere.hpp"
#include "soopnav/gnss/ephemeris.hpp"

namespace soopnav::gnss {

/// Carrier of L2 [Hz] (IS-GPS-200N section 3.3.1.1).
inline constexpr double kL2Hz = 120.0 * 10.23e6;

/// The combination of two ranges or phases in metres that the ionosphere leaves alone to first order:
/// (f1² first - f2² second) / (f1² - f2²)  (doc/gps_phase.md eq. 1). Noise grows 3.0 times, delays that both have stay.
[[nodiscard]] double ionosphere_free_m(double first_m, double second_m, double f1_hz = kL1Hz,
                                       double f2_hz = kL2Hz) noexcept;

/// Melbourne and Wübbena's combination [wide-lane cycles of 0.862 m]: N1 - N2 plus the noise of the codes, free of
/// range, clocks, troposphere and ionosphere (doc/gps_phase.md eq. 3). Phases in cycles, codes in metres.
[[nodiscard]] double wide_lane_cycles(double phase1_cycles, double phase2_cycles, double code1_m, double code2_m,
                                      double f1_hz = kL1Hz, double f2_hz = kL2Hz) noexcept;

/// Unit vector from the Earth's centre to the Sun, ECEF, to 0.1 degree between 1950 and 2050 (Astronomical Almanac, low
/// precision formulas). NaN for an epoch that is not valid or not GPS time.
[[nodiscard]] Eigen::Vector3d sun_direction_e(const Epoch& t) noexcept;

/// Phase wind-up [cycles], to be added to a predicted phase: the turn of a satellite's antenna, whose axis points down
/// and whose panels face the Sun, against a receiver's that stands with its axes north and west (Wu, Wu, Hajj,
/// Bertiger and Lichten 1993; doc/gps_phase.md eq. 5). Of the values a cycle apart that nearest to `before`. None when
/// positions coincide or a number is not finite.
[[nodiscard]] std::optional<double> phase_wind_up_cycles(const Eigen::Vector3d& satellite_e,
                                                         const Eigen::Vector3d& sun_direction,
                                                         const Eigen::Vector3d& receiver_e,
                                                         double before = 0.0) noexcept;

/// Most satellites and arcs (stretches of unbroken phase) of one solution.
inline constexpr std::size_t kMaxPhaseSatellites = 32;
inline constexpr std::size_t kMaxPhaseArcs = 512;

/// What a standing antenna's solution assumes.
struct StaticPhaseOptions {
  bool dual = true;                  ///< ionosphere-free L1 and L2; false: L1 with the broadcast ionosphere
  double elevation_mask_rad = 0.26;  ///< in [0, pi/2)
  double code_sigma_m = 1.0;         ///< of the code used, white, from the zenith; over sin(elevation) lower down; > 0
  double phase_sigma_m = 0.01;       ///< of the phase used, likewise, > 0
  /// How long phase errors last (multipath, the troposphere's weather): a phase counts as if its variance were
  /// 1 + 2 correlation / interval times that of the noise. Without it curvatures of a centimetre move the position by
  /// metres. >= 0.
  double phase_correlation_s = 100.0;
  /// Of the error of each satellite's broadcast range (orbit, clock, code biases), constant over the recording, > 0.
  double range_error_sigma_m = 1.0;
  /// Of the rate of that error: an orbit error comes round twice a day, sigma 2 pi / 12 h, > 0.
  double range_error_rate_mps = 1.5e-4;
  double zenith_sigma_m = 0.1;     ///< of what Saastamoinen's zenith delay is off by, >= 0; 0: not estimated
  double relative_humidity = 0.7;  ///< in [0, 1]
  double max_gap_s = 5.0;          ///< longest gap of an unbroken phase, > 0
  double slip_m = 0.08;            ///< change of a phase against the other satellites' that is a slip, > 0
  int min_arc_epochs = 30;         ///< shorter stretches of phase are not used, >= 2
  bool wind_up = true;             ///< takes phase wind-up into account
  double max_age_s = 0.0;          ///< of ephemerides; 0: half their fit interval

  /// Throws std::invalid_argument naming the option, its value and the rule.
  void check() const;
};

/// Rows of measurements; columns are satellites. Row-major, n x s; NaN: not measured. Second-frequency spans may be
/// empty when `dual` is false.
struct PhaseTable {
  std::span<const int> prn;                ///< s
  std::span<const double> week;            ///< n, whole GPS weeks of the receiver's clock
  std::span<const double> time_of_week_s;  ///< n, rising
  std::span<const double> code1_m, code2_m;
  std::span<const double> phase1_cycles, phase2_cycles;
  std::span<const std::uint8_t> lost_lock;  ///< n x s or empty; not 0: the receiver says it lost count
};

/// What became of a satellite's phase in an epoch.
enum class PhaseUse : std::uint8_t {
  kUsed,
  kMissing,      ///< nothing measured
  kPartial,      ///< not all of code and phase on the frequencies that are needed
  kNoEphemeris,  ///< none of this satellite in time
  kUnhealthy,
  kLow,       ///< below the mask
  kShortArc,  ///< of a stretch with fewer epochs than `min_arc_epochs`
  kRejected,  ///< contradicts the others
  kNoClock,   ///< an epoch without position and clock by code
};

enum class StaticPhaseStatus : std::uint8_t {
  kSolved,
  kTooFewSatellites,  ///< no epoch with four satellites by code
  kTooShort,          ///< no stretch of phase as long as `min_arc_epochs`
  kRankDeficient,     ///< the geometry leaves the position open
  kTooManyArcs,       ///< more than `kMaxPhaseArcs`: the phase breaks all the time
};

/// A lower-case phrase.
[[nodiscard]] std::string_view to_string(StaticPhaseStatus status) noexcept;

/// A position from code and carrier phase, and all that a navigator needs of each measurement. NaN where there is
/// nothing. Matrices are row-major, n x s.
struct StaticPhaseFix {
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  StaticPhaseStatus status = StaticPhaseStatus::kTooFewSatellites;
  Eigen::Vector3d position_e = Eigen::Vector3d::Constant(kNan);     ///< ECEF [m]
  Eigen::Matrix3d covariance_m2 = Eigen::Matrix3d::Constant(kNan);  ///< with the satellites' errors in it
  Eigen::Matrix3d formal_m2 = Eigen::Matrix3d::Constant(kNan);      ///< as if the broadcast were exact: far too small
  double zenith_m = kNan, zenith_sigma_m = kNan;                    ///< delay beyond Saastamoinen's
  double phase_rms_m = kNan, code_rms_m = kNan;                     ///< of the residuals used
  std::size_t phases = 0, codes = 0, rejected = 0, arcs = 0, slips = 0;
  std::vector<double> clock_m, clock_sigma_m;              ///< n: c * (receiver clock - GPS time), each epoch's own
  std::vector<double> range_error_m, range_error_sigma_m;  ///< s: in the middle of the recording
  std::vector<double> range_error_rate_mps;                ///< s
  std::vector<double> phase_residual_m, code_residual_m;
  std::vector<double> elevation_rad, azimuth_rad;
  std::vector<std::uint8_t> use;                              ///< `PhaseUse`
  std::vector<int> arc;                                       ///< number of the unbroken stretch; -1: none
  std::vector<double> phase_m, code_m;                        ///< the combination that was used
  std::vector<double> phase_correction_m, code_correction_m;  ///< troposphere with `zenith_m`, wind-up, ionosphere
  std::vector<double> satellite_clock_m;                      ///< c * satellite clock, of the same combination
  std::vector<double> satellite_e;  ///< n x s x 3: at transmission, in the ECEF axes of the reception
};

/// Position of a standing antenna from its code and carrier phase, all epochs together (doc/gps_phase.md).
///
/// Model (pesyna eq. 4, metres; doc/gps_phase.md eq. 2):
///   code  = |p - R s| + b - c dt + T + m(el) z + e_s(t)
///   phase = |p - R s| + b - c dt + T + m(el) z + e_s(t) + wind-up + N_arc
/// with orbit and clock of the broadcast (relativity of the eccentricity in it; Shapiro's delay, 2 cm and the same for
/// all within some mm, is not), the Earth's turn in the flight, Saastamoinen's troposphere T with an estimated zenith
/// residual z, one clock b for each epoch, eliminated, and e_s(t) = e0 + e1 (t - t_mid) of each satellite with the
/// stated sigmas: the error of the broadcast, about a metre, hardly changes in a quarter of an hour, does not average
/// out, and makes the covariance honest. Weighted least squares on normal equations by Cholesky, relinearised
/// until it stands. Slips: the receiver's word, gaps, jumps of phase against the other satellites', of the
/// geometry-free and of the wide-lane combination; each begins a new constant N.
///
/// A batch: allocates. 900 epochs of 11 satellites: 0.1 s. Never throws for data: see `status`.
/// @throws std::invalid_argument for options, spans whose sizes do not fit, and more than `kMaxPhaseSatellites`.
[[nodiscard]] StaticPhaseFix solve_static_phase(const EphemerisTable& ephemerides,
                                                const std::optional<Klobuchar>& klobuchar, const PhaseTable& table,
                                                const StaticPhaseOptions& options = {});

}  // namespace soopnav::gnss
