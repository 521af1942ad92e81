#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "soopnav/core/epoch.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/gnss/atmosphere.hpp"
#include "soopnav/gnss/ephemeris.hpp"
#include "soopnav/waveform/gps/tracking_noise.hpp"

namespace soopnav::simulation {

/// What a simulated GNSS receiver is like. L1 throughout.
struct GnssObservableOptions {
  double elevation_mask_rad = 0.08726646259971647;  ///< satellites below are not seen, in [-pi/2, pi/2)
  double cn0_zenith_dbhz = 47.0;                    ///< carrier to noise density of a satellite overhead, finite
  double cn0_drop_db = 8.0;             ///< less by this at the horizon, in proportion to 1 - sin(elevation), >= 0
  bool noise = true;                    ///< thermal noise of code, phase and Doppler
  gps::CodeLoop code_loop{};            ///< gives the code's noise by C/N0
  gps::PhaseLoop phase_loop{};          ///< gives the phase's noise by C/N0 (carter eq. 2.23, 2.24)
  std::optional<double> code_sigma_m;   ///< instead of the loop: one for all, >= 0
  std::optional<double> phase_sigma_m;  ///< instead of the loop: one for all, >= 0
  double doppler_sigma_hz = 0.05;       ///< >= 0
  double multipath_sigma_m = 0.0;       ///< of the code, times cos(elevation): first-order Gauss-Markov, >= 0
  double multipath_time_s = 30.0;       ///< its time constant, > 0
  double multipath_phase_ratio = 0.01;  ///< the phase has this part of the code's, in [0, 1]
  std::optional<gnss::Klobuchar> ionosphere;  ///< delays code and advances phase by this model's amount
  bool troposphere = false;                   ///< delay by Saastamoinen's model
  double relative_humidity = 0.7;             ///< in [0, 1]
  bool integers = true;    ///< a whole number of cycles, within 1e6, to each antenna's phase of each satellite
  double max_age_s = 0.0;  ///< of ephemerides; 0: half their fit interval

  /// Throws std::invalid_argument naming the option, its value and the rule.
  void check() const;
};

/// What an antenna receives of a satellite; NaN, and not visible, below the mask or without ephemeris.
struct GnssObservable {
  bool visible = false;
  double code_m = 0.0;        ///< pseudorange
  double phase_cycles = 0.0;  ///< grows with the range
  double doppler_hz = 0.0;    ///< positive when approaching
  double cn0_dbhz = 0.0;
  double range_m = 0.0;  ///< true geometric range
  double range_rate_mps = 0.0;
  double azimuth_rad = 0.0;  ///< from north towards east
  double elevation_rad = 0.0;
};

/// Pseudorange, carrier phase and Doppler of a constellation at one or more antennas.
///
/// Model (carter eq. 2.11, 2.21; signs of doc/gnss.md eq. 1 and 5):
///   P = ρ + b - c dt + I + T + M + v,   λ φ = ρ + b - c dt - I + T + λ N + μ M + w,   D = -(ρ' + b' - c dt') / λ + n.
/// ρ and ρ' are exact (`gnss::Sight`); atmospheric rates are left out of D. Noise of one antenna and satellite comes
/// from the stream's substream of that pair at the position of the epoch's number: it does not depend on which others
/// are in view.
class GnssObservables {
 public:
  /// `antennas`: how many, at least 1. Throws std::invalid_argument for `options`. Allocates.
  GnssObservables(gnss::EphemerisTable ephemerides, const GnssObservableOptions& options, std::size_t antennas,
                  const RandomStream& stream);

  /// The satellites' numbers, ascending: the order of the observables.
  [[nodiscard]] std::span<const int> prns() const noexcept { return prns_; }
  [[nodiscard]] const GnssObservableOptions& options() const noexcept { return options_; }
  /// Whole cycles of an antenna's phases, by satellite.
  [[nodiscard]] std::span<const double> integers(std::size_t antenna) const noexcept;

  /// Observables of antenna `antenna` when the receiver's clock, `clock_bias_m` / c ahead of GPS time, shows
  /// `receive_clock`. `p_e`, `v_e` at that moment, ECEF. `epoch`: number of the epoch, names the
  /// noise; ascending for each antenna, as multipath is correlated. `out`: one for each of `prns()`. No allocation.
  void observe(std::size_t antenna, std::uint64_t epoch, const Epoch& receive_clock, const Eigen::Vector3d& p_e,
               const Eigen::Vector3d& v_e, double clock_bias_m, double clock_drift_mps,
               std::span<GnssObservable> out) noexcept;

 private:
  struct Multipath {
    double value = 0.0;
    Epoch at;
    bool started = false;
  };
  gnss::EphemerisTable table_;
  GnssObservableOptions options_;
  RandomStream stream_;
  std::vector<int> prns_;
  std::vector<double> integers_;      // by antenna, then satellite
  std::vector<Multipath> multipath_;  // likewise
};

}  // namespace soopnav::simulation
