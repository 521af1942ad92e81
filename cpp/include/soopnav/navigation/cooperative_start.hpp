#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/geometry/sampled_orbit.hpp"
#include "soopnav/navigation/cooperative_filter.hpp"

namespace soopnav::navigation {

/// How a start from a batch of bursts ended.
enum class PairStartStatus : std::uint8_t {
  kFound,         ///< one place fits
  kAmbiguous,     ///< so does another: see `alternatives`
  kVague,         ///< the bursts leave the place open by more than `max_sigma_m`: more of them are needed
  kPoorFit,       ///< the best place does not explain the bursts within their covariances
  kNotConverged,  ///< no candidate came to rest
  kNoView,        ///< no place searched sees the beacons
  kTooFew,        ///< fewer than `min_bursts` usable bursts
};
[[nodiscard]] std::string_view to_string(PairStartStatus status) noexcept;

/// Where a search for an unknown position looks, and what it may assume.
struct PairStartOptions {
  clock::ClockNoise clock_noise{};             ///< of both clocks together
  double acceleration_psd_m2ps3 = 0.0;         ///< 0: the target stands
  double velocity_sigma_mps = 1e-3;            ///< prior of each axis of the velocity about rest, > 0
  double height_m = 0.0;                       ///< above the ellipsoid, known within `height_sigma_m`
  double height_sigma_m = 10.0;                ///< > 0; infinite: nothing is known of the height
  std::optional<Eigen::Vector3d> guess_p_e{};  ///< middle of the search; without one it is the anchor
  double search_radius_m = 3e6;                ///< 0: from the guess alone, no grid
  double cell_m = 2e5;                         ///< of the grid, > 0
  int candidates = 8;                          ///< best cells that are followed, 1 ... 64
  int min_bursts = 10;                         ///< >= 3
  double ambiguous_chi_square = 12.0;          ///< another place whose chi-square is no more than this above the best's
  double max_sigma_m = 3e3;      ///< of the place, beyond which it is vague: no filter could be linearised there, > 0
  double mask_rad = 0.0;         ///< satellites below are not used
  double alpha_sigma_mps = 3e3;  ///< prior of alpha about what the FDOA says, > 0 (3e3: 10 ppm)

  double anchor_drift_mps = 0.0;        ///< c times the anchor's own skew where it is known
  std::vector<double> orbit_sigma_m{};  ///< along-track error of each beacon, a state; empty: orbits are exact

  /// Throws std::invalid_argument naming the option that breaks its rule.
  void check() const;
};

/// A place that fits a batch of bursts: mean and covariance at the last one.
struct PairSolution {
  PairVector mean = PairVector::Constant(std::numeric_limits<double>::quiet_NaN());
  PairSquare covariance = PairSquare::Constant(std::numeric_limits<double>::quiet_NaN());
  double chi_square = std::numeric_limits<double>::quiet_NaN();  ///< sum of the NIS of the bursts used
};

/// What `start_pair` found.
struct PairStart {
  PairStartStatus status = PairStartStatus::kTooFew;
  double t_s = std::numeric_limits<double>::quiet_NaN();  ///< of the last burst: the solution's time
  PairSolution best;
  std::vector<PairSolution> alternatives;  ///< other places that fit as well, best first
  int degrees_of_freedom = 0;              ///< of the chi-squares: rows less directions determined
  int cells = 0;                           ///< of the grid that see the beacons
  int iterations = 0;                      ///< linearisations of the best
  std::vector<std::uint8_t> used;          ///< of each measurement: 1 when it is in the solution
  std::vector<int> along_track;            ///< beacons whose error along the orbit was estimated, last heard first
  Eigen::VectorXd along_track_m;           ///< those errors at the best place
  Eigen::MatrixXd joint_covariance;        ///< of the best's mean, and of them behind it
  [[nodiscard]] bool ok() const noexcept { return status == PairStartStatus::kFound; }
};

/// Finds a pair's target from bursts alone (doc/cooperative.md, section 5).
///
/// Cells of a grid on the ellipsoid are ranked by the misfit left when theta and alpha are fitted. The best ones, and
/// the guess, are followed by damped Gauss-Newton steps, each a Kalman filter over all bursts linearised at the trial
/// place: clocks wander as their noise says, so nothing need be inflated, and mean and covariance at the last burst are
/// those a filter would have that had known where to linearise. Restart the filter there: the bursts are used up.
/// A satellite's error along its orbit is one number for the whole batch: a state, of which the place's covariance
/// knows (of the 64 satellites heard last; of others it is noise, of a variance multiplied by their bursts).
/// Bursts that contradict the solution (probability 1e-6) are left out, at most a fifth of them.
///
/// `beacons` are the orbits that `PairMeasurement::beacon` numbers; measurements in order of time. What is not finite,
/// out of order, outside an ephemeris or of an unknown beacon is left out. Throws std::invalid_argument for options out
/// of range. Allocates. About 10 ms for the grid of 700 cells and 90 bursts and 5 ms for each candidate.
[[nodiscard]] PairStart start_pair(std::span<const geometry::SampledOrbit> beacons,
                                   std::span<const PairMeasurement> measurements, const PairStartOptions& options);

}  // namespace soopnav::navigation
