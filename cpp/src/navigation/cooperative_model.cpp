#include "soopnav/navigation/cooperative_model.hpp"

#include "soopnav/core/constants.hpp"

namespace soopnav::navigation {

bool pair_observation(const PairMeasurement& m, PairObservation& out) noexcept {
  if (!(m.carrier_hz > 0.0) || !std::isfinite(m.carrier_hz) || !std::isfinite(m.tdoa_s) || !std::isfinite(m.fdoa_hz) ||
      !std::isfinite(m.t_s) || !m.covariance.allFinite() || !m.anchor_p_e.allFinite() || !m.anchor_v_e.allFinite()) {
    return false;
  }
  const Eigen::Vector2d scale(kSpeedOfLightMps, -kSpeedOfLightMps / m.carrier_hz);
  out.z = scale.cwiseProduct(Eigen::Vector2d(m.tdoa_s, m.fdoa_hz));
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) out.R(i, j) = scale[i] * m.covariance(i, j) * scale[j];
  }
  return true;
}

bool pair_geometry(const geometry::SampledOrbit& beacon, double t_s, const PairReceiver& target,
                   const PairReceiver& anchor, double theta_m, double alpha_mps, double anchor_drift_mps,
                   double along_track_m, PairGeometry& out) noexcept {
  using Eigen::Vector3d;
  constexpr double kC = kSpeedOfLightMps;
  geometry::SignalPath near, far;
  geometry::PathGradient to_near, to_far;
  // An error along the track is one in time: ahead by its length over the speed in space.
  const auto slowness_of = [&beacon](const geometry::SignalPath& path) {
    const Vector3d& q = path.source_p_e;
    return beacon.is_fixed() ? 0.0
                             : 1.0 / (path.source_v_e + wgs84::kEarthRateRadps * Vector3d(-q[1], q[0], 0.0)).norm();
  };
  double ahead_s = 0.0;
  if (along_track_m != 0.0) {
    if (!geometry::signal_path(beacon, t_s, anchor.p_e, anchor.v_e, near)) return false;
    ahead_s = along_track_m * slowness_of(near);
  }
  if (!geometry::signal_path(beacon, t_s, anchor.p_e, anchor.v_e, near, to_near, ahead_s)) return false;
  const double slowness = slowness_of(near);
  // The wavefront left at t_b - delay_b = t_a - delay_a. One step of Newton meets it to 1e-13 s.
  if (!geometry::signal_path(beacon, t_s, target.p_e, target.v_e, far, ahead_s)) return false;
  double later = (far.delay_s - near.delay_s) / (1.0 - far.delay_rate);
  const Vector3d there = target.p_e + later * target.v_e;
  if (!geometry::signal_path(beacon, t_s + later, there, target.v_e, far, to_far, ahead_s)) return false;
  later += (far.delay_s - near.delay_s - later) / (1.0 - far.delay_rate);

  const double drift_mps = alpha_mps + anchor_drift_mps;
  const double slow_near = 1.0 / (1.0 + anchor_drift_mps / kC);
  const double slow_far = 1.0 / (1.0 + drift_mps / kC);
  out.later_s = later;
  out.value[0] = kC * later + theta_m + drift_mps * later;
  // c ((1 - r_b) slow_b - (1 - r_a) slow_a), without taking nearly equal numbers of 3e8 apart.
  out.value[1] = kC * (far.delay_rate * slow_far - near.delay_rate * slow_near) + alpha_mps * slow_near * slow_far;

  const double to_range = (kC + drift_mps) / (1.0 - far.delay_rate);
  out.target_p.row(0) = to_range * to_far.delay_p.transpose();
  out.target_v.row(0) = later * out.target_p.row(0);
  out.anchor_p.row(0) = -to_range * to_near.delay_p.transpose();
  out.anchor_v.row(0).setZero();
  out.target_p.row(1) = kC * slow_far * to_far.rate_p.transpose();
  out.target_v.row(1) = kC * slow_far * to_far.rate_v.transpose() + later * out.target_p.row(1);
  out.anchor_p.row(1) = -kC * slow_near * to_near.rate_p.transpose();
  out.anchor_v.row(1) = -kC * slow_near * to_near.rate_v.transpose();
  out.theta << 1.0, 0.0;
  out.alpha << later, (1.0 - far.delay_rate) * slow_far * slow_far;
  out.along_track << to_range * slowness * (to_far.delay_ahead - to_near.delay_ahead),
      kC * slowness * (slow_far * to_far.rate_ahead - slow_near * to_near.rate_ahead);
  return out.value.allFinite() && out.target_p.allFinite() && out.target_v.allFinite();
}

}  // namespace soopnav::navigation
