#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/role.hpp"
#include "soopnav/geometry/sampled_orbit.hpp"
#include "soopnav/measurement/arithmetic.hpp"

namespace soopnav::navigation {

/// What the cross-ambiguity of one burst says about a pair of receivers: a the target, b the anchor.
///
/// Signs: `tdoa_s` is the arrival by the target's clock less the arrival of the same wavefront by the anchor's,
/// positive when the target is later; `fdoa_hz` the frequency in the target's recording less that in the anchor's.
struct PairMeasurement {
  double t_s = 0.0;  ///< arrival at the anchor by its clock, seconds of the system time that the beacons' orbits have
  int beacon = 0;    ///< number of the beacon in the tracker's list
  double tdoa_s = 0.0;
  double fdoa_hz = 0.0;
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();  ///< of tdoa [s] and fdoa [Hz]
  double carrier_hz = 0.0;                               ///< as sent, > 0
  Eigen::Vector3d anchor_p_e = Eigen::Vector3d::Zero();  ///< at `t_s`, ECEF [m]
  Eigen::Vector3d anchor_v_e = Eigen::Vector3d::Zero();  ///< [m/s]
};

/// A pair's measurement as the filters take it: metres, and metres per second (mei's tau and xi).
struct PairObservation {
  Eigen::Vector2d z;  ///< c tdoa [m], -c fdoa / f [m/s]
  Eigen::Matrix2d R;
};
/// False when a number is not finite or the carrier is not positive. `R` is scaled only: a filter judges it.
[[nodiscard]] bool pair_observation(const PairMeasurement& measurement, PairObservation& out) noexcept;

/// Where a receiver is when the wavefront reaches the anchor.
struct PairReceiver {
  Eigen::Vector3d p_e = Eigen::Vector3d::Zero();  ///< ECEF [m]
  Eigen::Vector3d v_e = Eigen::Vector3d::Zero();  ///< [m/s]
};

/// What `pair_geometry` finds: both rows, and how they change.
struct PairGeometry {
  using Row3 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
  Eigen::Vector2d value;  ///< c tdoa [m], range-rate difference [m/s]
  Row3 target_p, target_v, anchor_p, anchor_v;
  Eigen::Vector2d theta, alpha, along_track;  ///< d value / d theta, alpha, along-track metre
  double later_s = 0.0;                       ///< true arrival at the target less that at the anchor [s]
};

/// The two rows of a pair and their derivatives (doc/cooperative.md eqs. 3 to 8; mei 1a, 1b without approximations).
///
/// `t_s` is the arrival at the anchor. The target's arrival is solved for: it is where the wavefront that left the
/// beacon at the same instant is met, so light time, the Earth's turn, the beacon's and the target's motion meanwhile
/// are in. `theta_m` and `alpha_mps` are c (b_target - b_anchor) and its rate at `t_s`; the skew acts on theta between
/// the two arrivals, and beside the Doppler shift it multiplies. `anchor_drift_mps` is the anchor's own, c d_anchor,
/// where known. `along_track_m` moves the beacon ahead along its orbit. False when the instant of sending is outside
/// the orbit, a number is not finite, or a receiver coincides with the beacon. No heap, about 0.5 us.
[[nodiscard]] bool pair_geometry(const geometry::SampledOrbit& beacon, double t_s, const PairReceiver& target,
                                 const PairReceiver& anchor, double theta_m, double alpha_mps, double anchor_drift_mps,
                                 double along_track_m, PairGeometry& out) noexcept;

/// One burst of a beacon, heard by a target and an anchor.
///
/// Model:   z0 = c (t_a - t_b) + theta + (alpha + d_b) (t_a - t_b)                                          [m]
///          z1 = c ((1 - r_b) / (1 + d_b / c) - (1 - r_a) / (1 + (alpha + d_b) / c))                        [m/s]
///          with r = d delay / dt of reception at each receiver's own arrival t    (doc/cooperative.md eqs. 3 to 6)
/// Frames:  ECEF [m, m/s].
/// Signs:   z0 positive when the target is later, z1 when the target recedes faster: z0 = c tdoa_s,
///          z1 = -c fdoa_hz / carrier_hz. A fast target clock (theta, alpha > 0) adds to both.
/// Roles:   position and velocity of the target, clock bias (theta) and drift (alpha); the anchor's position and
///          velocity `Known`, or a role or `Block`; the beacon's along-track error [m] `Known` (0) or a `Block<1>`. All
///          but these are of `t_s`, the arrival at the anchor.
/// Refused: `predict` answers false as `pair_geometry`. The orbit must outlive the model. No allocation.
template <PartOf<3> Anchor = Known<3>, PartOf<3> AnchorVelocity = Known<3>, PartOf<1> AlongTrack = Known<1>,
          PartOf<3> Target = Role<3, PositionTag>, PartOf<3> TargetVelocity = Role<3, VelocityTag>,
          PartOf<1> Theta = Role<1, ClockBiasTag>, PartOf<1> Alpha = Role<1, ClockDriftTag>>
struct PairModel {
  using Frame = EcefFrame;
  static constexpr int kDim = 2;
  const geometry::SampledOrbit* beacon = nullptr;
  double t_s = 0.0;               ///< arrival at the anchor
  Anchor anchor_p{};              ///< [m]
  AnchorVelocity anchor_v{};      ///< [m/s]
  AlongTrack along_track{};       ///< [m]
  double anchor_drift_mps = 0.0;  ///< c d_anchor, where known
  Target target_p{};
  TargetVelocity target_v{};
  Theta theta{};
  Alpha alpha{};

  template <class X, class Y>
  requires Provides<X, PairModel, Anchor, AnchorVelocity, AlongTrack, Target, TargetVelocity, Theta, Alpha>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto vector = [](const auto& v) { return Eigen::Vector3d(v[0], v[1], v[2]); };
    PairGeometry g;
    if (beacon == nullptr || !pair_geometry(*beacon, t_s, {vector(x(target_p)), vector(x(target_v))},
                                            {vector(x(anchor_p)), vector(x(anchor_v))}, x(theta)[0], x(alpha)[0],
                                            anchor_drift_mps, x(along_track)[0], g)) {
      return false;
    }
    y.value(0) = g.value[0];
    y.value(1) = g.value[1];
    if constexpr (Y::kJacobian) {
      write(y.jacobian(target_p), g.target_p);
      write(y.jacobian(target_v), g.target_v);
      write(y.jacobian(anchor_p), g.anchor_p);
      write(y.jacobian(anchor_v), g.anchor_v);
      write(y.jacobian(theta), g.theta);
      write(y.jacobian(alpha), g.alpha);
      write(y.jacobian(along_track), g.along_track);
    }
    return true;
  }

 private:
  template <class To, class From>
  static void write(To&& to, const From& from) {
    for (int i = 0; i < 2; ++i) {
      for (int j = 0; j < static_cast<int>(From::ColsAtCompileTime); ++j) to(i, j) += from(i, j);
    }
  }
};

/// Distance from a plane, for what is known of a position besides: a height, a road.
///
/// Model:   z = n.(p - q) [m], n a unit vector. Frame: that of the state. Roles: position. Never refused.
template <class FrameTag = EcefFrame, PartOf<3> Position = Role<3, PositionTag>>
struct PlaneDistance {
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< n
  Eigen::Vector3d point = Eigen::Vector3d::Zero();    ///< q [m]
  Position position{};

  template <class X, class Y>
  requires Provides<X, PlaneDistance, Position>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto p = x(position);
    y.value(0) = normal[0] * (p[0] - point[0]) + normal[1] * (p[1] - point[1]) + normal[2] * (p[2] - point[2]);
    if constexpr (Y::kJacobian) {
      auto&& to_p = y.jacobian(position);
      for (int i = 0; i < 3; ++i) to_p(0, i) += normal[i];
    }
    return true;
  }
};

}  // namespace soopnav::navigation
