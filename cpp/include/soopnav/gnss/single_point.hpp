#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "soopnav/core/epoch.hpp"
#include "soopnav/core/static_vector.hpp"
#include "soopnav/estimation/dop.hpp"
#include "soopnav/gnss/atmosphere.hpp"
#include "soopnav/gnss/ephemeris.hpp"

namespace soopnav::gnss {

/// Most satellites one fix takes.
inline constexpr std::size_t kMaxSatellites = 64;

/// What a receiver measured of one satellite. NaN: not measured.
struct PointMeasurement {
  int prn = 0;
  double pseudorange_m = std::numeric_limits<double>::quiet_NaN();
  double range_rate_mps = std::numeric_limits<double>::quiet_NaN();  ///< receding positive: -wavelength * Doppler
  /// Standard deviation of the pseudorange; NaN: `PointOptions::sigma_m` by elevation.
  double sigma_m = std::numeric_limits<double>::quiet_NaN();
};

/// What a fix assumes.
struct PointOptions {
  double elevation_mask_rad = 0.17453292519943295;  ///< satellites below are not used, in [-pi/2, pi/2)
  double sigma_m = 1.0;             ///< of a pseudorange from the zenith, > 0; 1 / sin(elevation) times it lower down
  double sigma_rate_mps = 0.05;     ///< of a range rate from the zenith, > 0, likewise
  bool weight_by_elevation = true;  ///< false: the same for all
  bool ionosphere = true;           ///< take off the broadcast model, when there are coefficients
  bool troposphere = true;          ///< take off Saastamoinen's model
  double relative_humidity = 0.7;   ///< in [0, 1]
  bool reject_outliers = true;      ///< leave out what contradicts the others
  double false_alarm_probability = 1e-4;  ///< of the test for contradiction, in (0, 0.5)
  double max_age_s = 0.0;                 ///< of ephemerides; 0: half their fit interval
  int max_iterations = 10;                ///< of corrections; each holds a least-squares solution, at least 3

  /// Throws std::invalid_argument naming the option, its value and the rule.
  void check() const;
};

/// How a fix ended.
enum class PointStatus : std::uint8_t {
  kConverged,
  kInconsistent,      ///< the residuals are too large and no satellite at fault could be told; the fit to all of them
  kTooFewSatellites,  ///< fewer usable ones than four; no position
  kRankDeficient,     ///< the geometry leaves a direction open (all lines of sight on one cone): see `unobservable`
  kNotConverged,      ///< no position explains the measurements near the Earth
};

/// The name of a status in words.
[[nodiscard]] std::string_view to_string(PointStatus status) noexcept;

/// What a fix did with a satellite.
enum class SatelliteUse : std::uint8_t {
  kUsed,
  kNotFinite,    ///< no pseudorange, or a standard deviation that is not positive
  kNoEphemeris,  ///< none of this satellite
  kStale,        ///< only ephemerides too far from the epoch
  kUnhealthy,    ///< the satellite says so
  kLow,          ///< below the mask
  kRejected,     ///< contradicts the others
};

/// Position, velocity and clock from one epoch. Holds its arrays itself: no heap. Values that do not exist are NaN.
struct PointFix {
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

  PointStatus status = PointStatus::kTooFewSatellites;
  Eigen::Vector3d position_e = Eigen::Vector3d::Constant(kNan);         ///< ECEF [m]
  Eigen::Matrix3d covariance_m2 = Eigen::Matrix3d::Constant(kNan);      ///< of it, from the stated sigmas, ECEF
  Eigen::Matrix3d covariance_enu_m2 = Eigen::Matrix3d::Constant(kNan);  ///< the same, east, north, up
  double clock_bias_m = kNan;                                           ///< c * (receiver clock - GPS time)
  double clock_sigma_m = kNan;
  Dop dop;                   ///< (HᵀH)⁻¹ of the satellites used, east, north, up and clock (carter eq. 2.17)
  double chi_square = kNan;  ///< sum of squared residuals in their standard deviations
  int degrees_of_freedom = 0;
  int iterations = 0;  ///< of the corrections

  bool has_velocity = false;                                              ///< from at least four range rates
  Eigen::Vector3d velocity_e = Eigen::Vector3d::Constant(kNan);           ///< ECEF [m/s]
  Eigen::Matrix3d velocity_covariance = Eigen::Matrix3d::Constant(kNan);  ///< [m²/s²]
  double clock_drift_mps = kNan;                                          ///< c * rate of the receiver's clock

  /// Columns: directions (x, y, z, c * clock) that the satellites do not determine.
  Eigen::Matrix<double, 4, Eigen::Dynamic, 0, 4, 4> unobservable{4, 0};

  // One entry for each measurement, in the order given.
  StaticVector<SatelliteUse, kMaxSatellites> use;
  StaticVector<double, kMaxSatellites> residuals_m;   ///< measured minus predicted, of the satellites used
  StaticVector<double, kMaxSatellites> azimuths_rad;  ///< from north towards east
  StaticVector<double, kMaxSatellites> elevations_rad;

  [[nodiscard]] std::size_t used_count() const noexcept;
  /// One sentence: what the fix is, or why there is none. Allocates.
  [[nodiscard]] std::string message() const;
};

/// Positions from pseudoranges of one frequency by iterated weighted least squares.
///
/// Model (carter eq. 2.11 and 2.12; doc/gnss.md eq. 1):
///   P_i = |R(τ_i) s_i(t - τ_i) - p| + b - c dt_i + I_i + T_i,
/// s_i, dt_i orbit and clock at the transmission, R(τ) the Earth's turn during the flight, b = c * receiver clock,
/// I and T the models of ionosphere and troposphere at the place found so far. Corrections and the least-squares
/// solution (2.13) to (2.16), with the normal equations (HᵀWH)⁻¹HᵀW that the print has wrong, are repeated until the
/// position stays within 1e-6 m; no start is needed. One satellite after the other is left out while the sum of
/// squares exceeds its chi-square limit and two are to spare: the one with the largest normalized residual.
/// Velocity and clock drift follow from range rates by linear least squares with exact rates (see `Sight`).
class SinglePoint {
 public:
  /// Throws std::invalid_argument for `options` and coefficients that are not finite.
  explicit SinglePoint(EphemerisTable ephemerides, const std::optional<Klobuchar>& klobuchar = std::nullopt,
                       const PointOptions& options = {});

  [[nodiscard]] const PointOptions& options() const noexcept { return options_; }
  [[nodiscard]] const EphemerisTable& ephemerides() const noexcept { return table_; }

  /// The fix of one epoch; `receive_clock`: what the receiver's clock showed, in GPS time. Measurements beyond
  /// `kMaxSatellites` are not looked at. Never throws; no allocation; 20 us for 10 satellites.
  [[nodiscard]] PointFix fix(const Epoch& receive_clock, std::span<const PointMeasurement> measurements) const noexcept;

 private:
  EphemerisTable table_;
  std::optional<Klobuchar> klobuchar_;
  PointOptions options_;
};

}  // namespace soopnav::gnss
