#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "soopnav/geometry/wgs84.hpp"

namespace soopnav::navigation {

/// Most satellites a Doppler fix takes.
inline constexpr std::size_t kMaxDopplerSatellites = 64;

/// The Doppler of one burst of one satellite.
struct DopplerRow {
  double t_s = 0.0;         ///< of reception
  int satellite = 0;        ///< any number that names it
  double doppler_hz = 0.0;  ///< received minus nominal frequency; positive when approaching
  double sigma_hz = 1.0;    ///< 1-sigma of the measurement alone, > 0
  Eigen::Vector3d source_p_e = Eigen::Vector3d::Zero();  ///< satellite, ECEF [m]: see `SourceInstant`
  Eigen::Vector3d source_v_e = Eigen::Vector3d::Zero();  ///< relative to the turning Earth, ECEF [m/s]
  double along_track_sigma_m = 0.0;  ///< 1-sigma of its orbit along its way; the first row of a satellite tells
  double age_s = 0.0;                ///< of its elements
};

/// What instant a row's satellite state is of.
enum class SourceInstant : std::uint8_t {
  kReception,  ///< of `t_s`, as an ephemeris gives it: light time is solved and the state brought back by it
  kSending,    ///< of the instant of sending, in the axes of reception, as `geometry::SignalPath` gives it
};

/// What a Doppler fix may assume.
struct DopplerFixOptions {
  static constexpr double kFree = std::numeric_limits<double>::infinity();

  double carrier_hz = 1626.270833e6;  ///< nominal
  SourceInstant source_instant = SourceInstant::kReception;
  Eigen::Vector3d velocity_e = Eigen::Vector3d::Zero();  ///< the receiver's, known [m/s]

  std::optional<double> height_m = std::nullopt;  ///< over the ellipsoid; none: estimated freely
  double height_sigma_m = 0.0;                    ///< of `height_m`; 0: known, and not estimated

  double frequency_bias_sigma_hz = kFree;       ///< prior of the receiver's frequency error, > 0
  double frequency_drift_sigma_hz_per_s = 0.0;  ///< prior of its drift; 0: no drift, infinity: free
  double satellite_bias_sigma_hz = 0.0;         ///< prior of a constant of each satellite; 0: none
  bool estimate_sigma = false;  ///< scale all `sigma_hz` by one factor so that the fit has unit variance
  double max_age_s = kFree;     ///< rows with older elements are left out

  std::optional<Eigen::Vector3d> start_p_e = std::nullopt;  ///< tried beside the grid
  bool search = true;            ///< starts from a grid over the places that see the satellites
  double mask_rad = 0.0;         ///< of elevation, for the grid, less 3 degrees
  double ambiguity_gate = 16.0;  ///< another minimum whose chi-square is at most this above the best is reported
  int max_iterations = 60;       ///< of each start

  /// Throws std::invalid_argument naming the option, its value and the rule.
  void check() const;
};

enum class DopplerStatus : std::uint8_t {
  kConverged,
  kAmbiguous,          ///< `position_e` and each of `alternatives` explain the Dopplers
  kTooFewRows,         ///< fewer than four usable rows, or than unknowns
  kTooFewSatellites,   ///< one satellite: its other side fits as well
  kTooManySatellites,  ///< more than `kMaxDopplerSatellites`
  kRankDeficient,      ///< the rows leave a direction free
  kNotConverged,
};
[[nodiscard]] std::string_view to_string(DopplerStatus status) noexcept;

/// What a fix did with a row.
enum class DopplerUse : std::uint8_t {
  kUsed,
  kNotFinite,  ///< a number of it is NaN or infinite, or its satellite within 1000 km of the Earth's centre
  kBadSigma,   ///< a standard deviation is not positive, or that along the track negative
  kStale,      ///< its elements are older than `max_age_s`
};

/// What was found about one satellite.
struct DopplerSatellite {
  int satellite = 0;
  std::size_t rows = 0;
  double bias_hz = 0.0;  ///< 0 without such a state
  double bias_sigma_hz = 0.0;
  double along_track_m = 0.0;  ///< how far ahead of its ephemeris it is; 0 without such a state
  double along_track_sigma_m = 0.0;
};

/// Another place that fits.
struct DopplerAlternative {
  Eigen::Vector3d position_e;
  double chi_square_excess = 0.0;  ///< over the best
};

/// A place, what it is worth, and what became of each row. NaN where there is no value.
struct DopplerFix {
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

  DopplerStatus status = DopplerStatus::kTooFewRows;
  Eigen::Vector3d position_e = Eigen::Vector3d::Constant(kNan);
  geometry::Geodetic place{kNan, kNan, kNan};
  /// Of the position along east, north, up there [m²], biases and drift marginalised; zero for a known height.
  Eigen::Matrix3d covariance_enu = Eigen::Matrix3d::Constant(kNan);
  double sigma_2d_m = kNan;         ///< sqrt(east² + north²) of it
  double frequency_bias_hz = kNan;  ///< of the receiver at `reference_s`: added to every Doppler
  double frequency_bias_sigma_hz = kNan;
  double frequency_drift_hz_per_s = kNan;
  double frequency_drift_sigma_hz_per_s = kNan;
  double reference_s = kNan;                 ///< mean time of the rows used
  double sigma_scale = 1.0;                  ///< what `estimate_sigma` multiplied the sigmas by
  double chi_square = kNan;                  ///< of residuals and priors, in their standard deviations
  int degrees_of_freedom = 0;                ///< of it
  std::vector<DopplerSatellite> satellites;  ///< by number
  std::vector<double> residuals_hz;          ///< for each row: measured minus fitted
  std::vector<DopplerUse> use;               ///< for each row
  std::vector<DopplerAlternative> alternatives;
  /// Do biases of the satellites belong? Chi-square of the residuals without such states, less that with free ones
  /// (both with the sigmas of the fit with free ones where they are estimated); its degrees of freedom, satellites less
  /// one, and the probability of as much by chance.
  double bias_chi_square = kNan;
  int bias_degrees_of_freedom = 0;
  double bias_probability = kNan;
  int iterations = 0;  ///< of the best start
};

/// Position of a receiver from one-way Dopplers of several satellites, in one batch.
///
/// Model (doc/doppler_fix.md eq. 1): doppler = -carrier d(delay)/dt + bias + drift (t - reference) + bias of the
/// satellite, light time and the Earth's turn in the delay. Weighted least squares with Gaussian priors, Levenberg's
/// damping, from a grid over all places that see the satellites: no start is needed, and any start ends in the same
/// place. Gaussian models only, and no rejection: data sets are often cut to small residuals at the truth, and a norm
/// that weighs large residuals more than their square then finds the cut, not the place.
///
/// A measurement never throws; throws std::invalid_argument for `options`. Allocates; 436 rows of 9 satellites take
/// about 20 ms.
[[nodiscard]] DopplerFix doppler_fix(std::span<const DopplerRow> rows, const DopplerFixOptions& options = {});

/// The Doppler of a row's satellite at a place without biases [Hz], and its derivatives with respect to the receiver's
/// ECEF position [Hz/m] and to the satellite's way ahead [Hz/m]. False when it is not defined. No heap.
[[nodiscard]] bool predict_doppler(const DopplerRow& row, const DopplerFixOptions& options, const Eigen::Vector3d& p_e,
                                   double along_track_m, double& doppler_hz, Eigen::Vector3d& by_position,
                                   double& by_along_track) noexcept;

}  // namespace soopnav::navigation
