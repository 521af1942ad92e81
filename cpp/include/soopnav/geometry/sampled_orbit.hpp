#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "soopnav/geometry/local_frame.hpp"

namespace soopnav::geometry {

/// Position [m] and velocity relative to the turning Earth [m/s], both ECEF.
struct OrbitState {
  Eigen::Vector3d p_e = Eigen::Vector3d::Zero();
  Eigen::Vector3d v_e = Eigen::Vector3d::Zero();
};

/// Where a transmitter is over time: a satellite, an aircraft, or a mast.
///
/// Samples of ECEF position and velocity at even steps, joined by cubic Hermite polynomials (doc/orbits.md eq. 1):
/// position and velocity are continuous, and those of a sample are met exactly. Between them a circular low orbit is
/// met within step^4 w^4 r / 384: at 780 km 0.3 mm and 0.1 mm/s for steps of 10 s, 0.3 m and 20 mm/s for 60 s.
///
/// Times are seconds of one system time from a reference of the caller's choice. Double precision resolves 1e-10 s,
/// that is 1 um of a satellite's way, up to 1e6 s; choose a reference within days.
class SampledOrbit {
 public:
  /// Samples at start_s + i step_s. `p_e` and `v_e` hold n rows x, y, z [m], [m/s].
  /// @throws std::invalid_argument when there are fewer than two rows, as many numbers are not in both, the step is not
  /// positive or a number is not finite.
  SampledOrbit(double start_s, double step_s, std::span<const double> p_e, std::span<const double> v_e);

  /// A transmitter at rest on the Earth, known at any time. @throws std::invalid_argument when not finite.
  [[nodiscard]] static SampledOrbit fixed(const Eigen::Vector3d& p_e);

  /// The state at `t_s`; false, `state` untouched, outside the samples or when the time is NaN. About 15 ns; no heap.
  [[nodiscard]] bool at(double t_s, OrbitState& state) const noexcept;

  [[nodiscard]] bool is_fixed() const noexcept { return step_s_ == 0.0; }
  /// Time of the first and last sample [s]; minus and plus infinity at rest.
  [[nodiscard]] double start_s() const noexcept { return start_s_; }
  [[nodiscard]] double end_s() const noexcept;
  [[nodiscard]] double step_s() const noexcept { return step_s_; }  ///< 0 at rest
  [[nodiscard]] std::span<const OrbitState> samples() const noexcept { return samples_; }

  /// State and acceleration [m/s²] at `since_s` after the first sample, by the polynomial of the nearest interval where
  /// it lies outside them. Times relative to the start lose no digits to a far reference.
  void interpolate(double since_s, OrbitState& state, Eigen::Vector3d& acceleration_e) const noexcept;

 private:
  SampledOrbit() = default;

  double start_s_ = 0.0;
  double step_s_ = 0.0;
  std::vector<OrbitState> samples_;
};

/// The way of a signal from a transmitter to a receiver.
struct SignalPath {
  double delay_s = 0.0;  ///< t_receive - t_send
  /// d delay / d t_receive [s/s]: positive when receding. A carrier f is received as f (1 - delay_rate).
  double delay_rate = 0.0;
  /// The transmitter at the instant of sending, in the ECEF axes of the instant of reception [m], [m/s].
  Eigen::Vector3d source_p_e = Eigen::Vector3d::Zero();
  Eigen::Vector3d source_v_e = Eigen::Vector3d::Zero();
  double range_m = 0.0;                                   ///< |source_p_e - p_e| = c delay_s
  Eigen::Vector3d direction_e = Eigen::Vector3d::Zero();  ///< unit vector from the receiver to `source_p_e`
};

/// Derivatives of a `SignalPath`, exact for the sampled orbit (doc/orbits.md eq. 6).
struct PathGradient {
  Eigen::Vector3d delay_p = Eigen::Vector3d::Zero();  ///< d delay / d p_e [s/m]; -direction / c within 3e-5
  Eigen::Vector3d rate_p = Eigen::Vector3d::Zero();   ///< d delay_rate / d p_e [1/m]
  Eigen::Vector3d rate_v = Eigen::Vector3d::Zero();   ///< d delay_rate / d v_e [s/m]; equal to delay_p
  double delay_ahead = 0.0;                           ///< d delay / d ahead_s [s/s]
  double rate_ahead = 0.0;                            ///< d delay_rate / d ahead_s [1/s]
};

/// Delay and delay rate of what a receiver at p_e with velocity v_e hears at `t_receive_s`.
///
/// Model (doc/orbits.md eq. 2-5): c delay = |R(w delay) s(t - delay) - p|, R the Earth's turn during the flight, solved
/// by fixed point to below 1e-9 m; the rate follows from the implicit derivative, so light time and the Earth's
/// rotation are in it. No relativity and no atmosphere (a common 2.4e-10 of a LEO's frequency; both cancel between
/// receivers).
///
/// `ahead_s`: the transmitter runs so much ahead of its samples along its orbit in space, the along-track error of an
/// orbit over its speed. Without meaning, and left out, for a transmitter at rest.
///
/// False, `path` untouched, when the instant of sending lies outside the samples, the two coincide or a number is not
/// finite. About 100 ns; no heap.
[[nodiscard]] bool signal_path(const SampledOrbit& orbit, double t_receive_s, const Eigen::Vector3d& p_e,
                               const Eigen::Vector3d& v_e, SignalPath& path, double ahead_s = 0.0) noexcept;

/// The same with the derivatives that filters need.
[[nodiscard]] bool signal_path(const SampledOrbit& orbit, double t_receive_s, const Eigen::Vector3d& p_e,
                               const Eigen::Vector3d& v_e, SignalPath& path, PathGradient& gradient,
                               double ahead_s = 0.0) noexcept;

/// Azimuth, elevation (above the plane normal to the ellipsoid, without refraction) and range at which a frame's origin
/// sees a transmitter at `t_s`, light time solved. False as for `signal_path`. A satellite below the horizon has a
/// negative elevation; its signal path is computed all the same. No heap.
[[nodiscard]] bool look_at(const SampledOrbit& orbit, double t_s, const LocalFrame& from, Direction& seen) noexcept;

}  // namespace soopnav::geometry
