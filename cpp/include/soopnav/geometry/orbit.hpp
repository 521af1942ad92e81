#pragma once

#include <Eigen/Core>
#include <vector>

#include "soopnav/geometry/sampled_orbit.hpp"

namespace soopnav::geometry {

/// Rate of Greenwich mean sidereal time [rad/s], the derivative of `gmst82_rad` at J2000: that of the Earth's turn and
/// of the equinox it is counted from.
inline constexpr double kSiderealRateRadps = 7.292115855306589e-5;

/// Greenwich mean sidereal time (IAU 1982; Aoki et al. 1982, doc/orbits.md eq. 7) [rad], in [0, 2 pi).
///
/// `jd_ut1` + `fraction`: Julian date of UT1 in two parts (the first as a rule ends in .5), which keeps 1e-11 rad. UTC
/// taken for UT1 errs by up to 0.9 s times 7.3e-5 rad/s, at worst 470 m of a LEO, along the equator. NaN where not
/// finite.
[[nodiscard]] double gmst82_rad(double jd_ut1, double fraction) noexcept;

/// Position and velocity of the true-equator mean-equinox frame (what SGP4 gives) in ECEF (doc/orbits.md eq. 8).
///
/// r_e = Rz(gmst) r, v_e = Rz(gmst) v - rate x r_e, in metres and m/s. Polar motion is left out: up to 0.5'' or 17 m at
/// a LEO's radius, far below SGP4's own kilometre. Does not allocate.
[[nodiscard]] OrbitState teme_to_ecef(double jd_ut1, double fraction, const Eigen::Vector3d& p_teme,
                                      const Eigen::Vector3d& v_teme) noexcept;

/// Mean Kepler elements at an instant, in space: axes of the Earth's equator, x to the equinox.
struct MeanElements {
  double semi_major_axis_m = 0.0;
  double eccentricity = 0.0;
  double inclination_rad = 0.0;
  double node_rad = 0.0;     ///< right ascension of the ascending node
  double perigee_rad = 0.0;  ///< argument of perigee
  double mean_anomaly_rad = 0.0;
};

/// Two-body motion with the secular drifts of J2 (doc/orbits.md eq. 9-12), for simulations: the shape of a real orbit
/// over weeks, without its periodic kilometres and without drag.
class J2Orbit {
 public:
  /// `epoch_s`: time of the elements; `gmst_rad`: Greenwich sidereal time then.
  /// @throws std::invalid_argument when a number is not finite, the eccentricity not in [0, 1) or the perigee below the
  /// equator's radius.
  explicit J2Orbit(const MeanElements& elements, double epoch_s = 0.0, double gmst_rad = 0.0,
                   double j2 = 1.082629821e-3);

  /// State at any time: p and v in ECEF; v is the exact derivative of p. NaN for a time that is not finite. No heap.
  [[nodiscard]] OrbitState at(double t_s) const noexcept;

  /// Samples from `start_s` until at least `start_s + duration_s`.
  /// @throws std::invalid_argument when one is not finite, duration or step not positive, or more than 1e8 samples.
  [[nodiscard]] SampledOrbit sampled(double start_s, double duration_s, double step_s = 10.0) const;

  [[nodiscard]] const MeanElements& elements() const noexcept { return elements_; }
  [[nodiscard]] double node_rate_radps() const noexcept { return node_rate_; }
  [[nodiscard]] double perigee_rate_radps() const noexcept { return perigee_rate_; }
  [[nodiscard]] double anomaly_rate_radps() const noexcept { return anomaly_rate_; }

 private:
  MeanElements elements_;
  double epoch_s_, gmst_rad_;
  double node_rate_, perigee_rate_, anomaly_rate_;
};

/// A constellation of circular orbits: planes evenly spaced, satellites evenly spaced in each.
struct WalkerConstellation {
  int planes = 6;
  int per_plane = 11;
  double altitude_m = 780e3;  ///< above the equator's radius
  double inclination_rad = 0.0;
  double plane_spacing_rad = 0.0;  ///< from one ascending node to the next
  double phase_step_rad = 0.0;     ///< by how much satellite 0 of a plane is ahead of that of the plane before
  double first_node_rad = 0.0;     ///< right ascension of plane 0
  double first_phase_rad = 0.0;    ///< argument of latitude of its satellite 0

  /// i: t/p/f in Walker's notation: nodes over 360 degrees, phase step f 360 / t.
  /// @throws std::invalid_argument when a number is not finite or out of range, or `planes` does not divide `total`.
  [[nodiscard]] static WalkerConstellation delta(int total, int planes, int phasing, double inclination_rad,
                                                 double altitude_m);
  /// The same with nodes over 180 degrees: near-polar planes with a seam.
  [[nodiscard]] static WalkerConstellation star(int total, int planes, int phasing, double inclination_rad,
                                                double altitude_m);
  /// Iridium: 66 satellites in six planes at 86.4 degrees and 780 km; 31.6 degrees between planes that go the same way
  /// (22 at the seam) and 15.1 degrees of phase from plane to plane, as the elements of August 2014 have it.
  [[nodiscard]] static WalkerConstellation iridium();

  /// Satellite s of plane p at index p per_plane + s. `gmst_rad`: Greenwich sidereal time at `epoch_s`.
  /// @throws std::invalid_argument when a number is out of range.
  [[nodiscard]] std::vector<J2Orbit> orbits(double epoch_s = 0.0, double gmst_rad = 0.0) const;
};

}  // namespace soopnav::geometry
