#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "soopnav/core/epoch.hpp"

/// Satellite navigation: orbits, positions, attitude.
namespace soopnav::gnss {

/// Angular rate of the Earth in broadcast orbits [rad/s] (IS-GPS-200N table 20-IV).
inline constexpr double kEarthRateRadps = 7.2921151467e-5;
/// Gravitational parameter in broadcast orbits [m³/s²] (IS-GPS-200N table 20-IV).
inline constexpr double kGravitationalParameterM3ps2 = 3.986005e14;
/// Carrier of L1 [Hz] (carter eq. 2.2).
inline constexpr double kL1Hz = 154.0 * 10.23e6;
/// Length of a GPS week [s].
inline constexpr double kWeekS = 604'800.0;

/// The epoch `time_of_week_s` into GPS week `week` (counted from 1980-01-06, without rollover); any finite second is
/// taken, also beyond the week. Invalid when the second is not finite.
[[nodiscard]] Epoch gps_epoch(std::int64_t week, double time_of_week_s) noexcept;

/// Week and second of week, in [0, 604800), of an epoch in GPS time. None for another scale or an invalid epoch.
[[nodiscard]] std::optional<std::pair<std::int64_t, double>> week_and_second(const Epoch& epoch) noexcept;

/// A satellite's broadcast orbit and clock: the Keplerian set of the GPS legacy message (IS-GPS-200N tables 20-I and
/// 20-III), angles in radians. Galileo, QZSS and BeiDou MEO broadcast the same set.
struct Ephemeris {
  int prn = 0;                      ///< the satellite's number, > 0
  std::int64_t week = 0;            ///< GPS week of `toe_s`, without rollover
  double toe_s = 0.0;               ///< reference time of the orbit, second of `week`
  double toc_s = 0.0;               ///< reference time of the clock, second of `week`
  double af0_s = 0.0;               ///< clock offset: what the clock is ahead of GPS time
  double af1 = 0.0;                 ///< [s/s]
  double af2_ps = 0.0;              ///< [1/s]
  double tgd_s = 0.0;               ///< group delay of L1 against the clock's ionosphere-free reference
  double sqrt_a = 0.0;              ///< root of the semi-major axis [√m], > 0
  double eccentricity = 0.0;        ///< in [0, 1)
  double m0_rad = 0.0;              ///< mean anomaly at `toe_s`
  double delta_n_radps = 0.0;       ///< mean motion minus its Keplerian value
  double omega_rad = 0.0;           ///< argument of perigee
  double omega0_rad = 0.0;          ///< longitude of the ascending node at the start of the week
  double omega_dot_radps = 0.0;     ///< its inertial rate
  double i0_rad = 0.0;              ///< inclination at `toe_s`
  double i_dot_radps = 0.0;         ///< its rate
  double cuc_rad = 0.0;             ///< harmonic corrections: argument of latitude, cosine
  double cus_rad = 0.0;             ///< sine
  double crc_m = 0.0;               ///< radius, cosine
  double crs_m = 0.0;               ///< sine
  double cic_rad = 0.0;             ///< inclination, cosine
  double cis_rad = 0.0;             ///< sine
  int health = 0;                   ///< 0: healthy
  int iode = 0;                     ///< issue of the data
  double fit_interval_s = 14400.0;  ///< how long the orbit is good, centred on `toe_s`, > 0

  /// Throws std::invalid_argument naming the field that breaks its rule, its value and the satellite.
  void check() const;
  [[nodiscard]] Epoch toe() const noexcept { return gps_epoch(week, toe_s); }
};

/// Where a satellite is, how fast it is, and what its clock shows.
struct SatelliteState {
  Eigen::Vector3d position_e = Eigen::Vector3d::Zero();  ///< antenna, ECEF of that instant [m]
  Eigen::Vector3d velocity_e = Eigen::Vector3d::Zero();  ///< relative to the rotating Earth [m/s]
  /// What its clock is ahead of GPS time for a user of L1 C/A: polynomial, relativity (eccentricity) and -TGD [s].
  double clock_s = 0.0;
  double clock_rate = 0.0;  ///< time derivative of `clock_s`
};

/// Orbit and clock at GPS time `t` (IS-GPS-200N table 20-IV, sections 20.3.3.3.3.1 and 20.3.3.3.3.2; velocity: the
/// derivative of the same formulas). None when `t` is no valid GPS epoch; the age is not looked at, see
/// `EphemerisTable`. No allocation, 0.3 us.
[[nodiscard]] std::optional<SatelliteState> satellite_state(const Ephemeris& ephemeris, const Epoch& t) noexcept;

/// ECEF coordinates in the axes of `flight_time_s` later: the Earth turns under the signal (Sagnac).
[[nodiscard]] Eigen::Vector3d rotated_for_flight(const Eigen::Vector3d& p_e, double flight_time_s) noexcept;

/// A satellite as its signal shows it to a receiver.
struct Sight {
  SatelliteState at_transmission;  ///< in the ECEF axes of the transmission
  /// Position and velocity turned into the ECEF axes of the reception: distances and directions are taken from these.
  Eigen::Vector3d position_e = Eigen::Vector3d::Zero();
  Eigen::Vector3d velocity_e = Eigen::Vector3d::Zero();
  double range_m = 0.0;         ///< |position_e - receiver|, c times the flight time
  double range_rate_mps = 0.0;  ///< its time derivative at the receiver, positive when receding
  Eigen::Vector3d direction_e = Eigen::Vector3d::Zero();  ///< unit vector from receiver to satellite
};

/// What a receiver at `receiver_p_e` [m, ECEF], moving with `receiver_v_e` [m/s], receives at GPS time `t`: the flight
/// time is iterated to 1e-13 s. Exact range rate, including that of the flight time:
/// ρ' = u·(R v_s - v) / (1 + u·(R v_s - ω (Rs)_y e_x + ω (Rs)_x e_y) / c), R the rotation during the flight.
/// None for an invalid epoch or a position that is not finite or at the satellite. No allocation.
[[nodiscard]] std::optional<Sight> sight(const Ephemeris& ephemeris, const Epoch& t,
                                         const Eigen::Vector3d& receiver_p_e,
                                         const Eigen::Vector3d& receiver_v_e = Eigen::Vector3d::Zero()) noexcept;

/// The state at transmission of a signal whose pseudorange was read when the receiver's clock showed `receive_clock`.
///
/// The satellite's clock showed `receive_clock` - pseudorange / c then, whatever the receiver's clock bias; its own
/// offset is taken off. None for an invalid epoch or a pseudorange that is not finite. No allocation.
[[nodiscard]] std::optional<SatelliteState> state_at_transmission(const Ephemeris& ephemeris,
                                                                  const Epoch& receive_clock,
                                                                  double pseudorange_m) noexcept;

/// Ephemerides of many satellites, ready to be looked up.
class EphemerisTable {
 public:
  EphemerisTable() = default;
  /// Any order; several of one satellite are kept. Throws std::invalid_argument for one that breaks a rule.
  explicit EphemerisTable(std::vector<Ephemeris> ephemerides);

  /// The one of satellite `prn` with the reference time nearest to `t`, whatever its health; null when none is
  /// within half its fit interval (`max_age_s` > 0: within that instead) or `t` is no GPS epoch. No allocation.
  [[nodiscard]] const Ephemeris* find(int prn, const Epoch& t, double max_age_s = 0.0) const noexcept;
  /// Whether there is any of satellite `prn`, however old.
  [[nodiscard]] bool has(int prn) const noexcept;
  /// Sorted by satellite, then by reference time.
  [[nodiscard]] std::span<const Ephemeris> all() const noexcept { return all_; }
  /// The satellites' numbers, ascending, each once. Allocates.
  [[nodiscard]] std::vector<int> prns() const;

 private:
  [[nodiscard]] std::span<const Ephemeris> of(int prn) const noexcept;
  std::vector<Ephemeris> all_;
};

/// A Walker constellation i: total/planes/phasing on circular orbits, with perfect clocks.
struct WalkerOptions {
  int satellites = 24;  ///< in all, a multiple of `planes`, at most 64
  int planes = 6;       ///< > 0
  int phasing = 1;      ///< in [0, planes): shift between neighbouring planes in units of 2 pi / satellites
  double inclination_rad = 0.9599310885968813;  ///< 55 degrees, in [0, pi]
  double radius_m = 26'559'710.0;               ///< > 6.4e6; GPS: half a sidereal day
  std::int64_t week = 2200;                     ///< of the reference time
  double toe_s = 0.0;                           ///< reference time of all orbits, second of the week
  double first_node_rad = 0.0;                  ///< longitude of the ascending node of the first plane at `toe_s`
  double fit_interval_s = 86400.0;              ///< how long they may be used, > 0

  /// Throws std::invalid_argument naming the option that breaks its rule.
  void check() const;
};

/// Its ephemerides, satellites numbered from 1 plane by plane. Throws as `WalkerOptions::check`.
[[nodiscard]] std::vector<Ephemeris> walker_constellation(const WalkerOptions& options = {});

}  // namespace soopnav::gnss
