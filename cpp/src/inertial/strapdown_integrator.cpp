#include "soopnav/inertial/strapdown_integrator.hpp"

#include <cmath>
#include <sstream>
#include <stdexcept>

#include "soopnav/core/angle.hpp"
#include "soopnav/geometry/gravity.hpp"
#include "soopnav/geometry/rotation.hpp"
#include "soopnav/inertial/coning_sculling.hpp"

namespace soopnav::inertial {
namespace {

constexpr double kPoleRad = kPi / 2.0 - 1.745e-4;

void require(bool holds, const char* name, double value, const char* rule) {
  if (holds) return;
  std::ostringstream text;
  text << "start." << name << ": " << value << "; " << rule;
  throw std::invalid_argument(text.str());
}

// Rates and gravity of the local level frame at a place and velocity.
struct Surroundings {
  Eigen::Vector3d omega_ie, omega_en, gravity;
  Surroundings(double latitude_rad, double height_m, const Eigen::Vector3d& v_n) noexcept
      : omega_ie(geometry::earth_rate_ned(latitude_rad)),
        omega_en(geometry::transport_rate_ned(latitude_rad, height_m, v_n)),
        gravity(geometry::normal_gravity_ned(latitude_rad, height_m)) {}
  // Acceleration but for the specific force.
  [[nodiscard]] Eigen::Vector3d free_acceleration(const Eigen::Vector3d& v_n) const noexcept {
    return gravity - (2.0 * omega_ie + omega_en).cross(v_n);
  }
};

}  // namespace

StrapdownIntegrator::StrapdownIntegrator(const NavigationState& start) : state_(start) {
  require(std::abs(start.place.latitude_rad) <= kPi / 2.0, "place.latitude_rad", start.place.latitude_rad,
          "it must lie between -pi/2 and pi/2");
  require(std::isfinite(start.place.longitude_rad), "place.longitude_rad", start.place.longitude_rad,
          "it must be finite");
  require(start.place.height_m >= -1e4 && start.place.height_m <= 1e6, "place.height_m", start.place.height_m,
          "it must lie between -10 km and 1000 km");
  for (int i = 0; i < 3; ++i) {
    require(std::isfinite(start.v_n_mps[i]), "v_n_mps", start.v_n_mps[i], "it must be finite");
  }
  require(std::abs(start.q_n_b.norm() - 1.0) <= 1e-6, "q_n_b", start.q_n_b.norm(), "its norm must be 1");
  state_.q_n_b.normalize();
}

IntegrationStatus StrapdownIntegrator::step(const ImuIncrement& increment) noexcept {
  if (!increment.all_finite()) return IntegrationStatus::kNonFinite;
  const double dt = increment.dt_s;
  if (!(dt > 0.0)) return IntegrationStatus::kTimeNotAdvancing;
  const auto& [latitude, longitude, height] = state_.place;
  if (!(std::abs(latitude) < kPoleRad)) return IntegrationStatus::kNearPole;
  const Eigen::Vector3d v = state_.v_n_mps;
  const Eigen::Vector3d push = state_.q_n_b * rotated_increment(increment.delta_theta_b, increment.delta_velocity_b);

  // The middle of the step, from the rates at its beginning (doc/strapdown.md eq. 17).
  const Surroundings now(latitude, height, v);
  const Eigen::Vector3d v_mid = v + 0.5 * (push + dt * now.free_acceleration(v));
  const double height_mid = height - 0.25 * dt * (v.z() + v_mid.z());
  const double latitude_mid =
      latitude + 0.25 * dt * (v.x() + v_mid.x()) / (geometry::meridian_radius_m(latitude) + height_mid);
  if (!(std::abs(latitude_mid) < kPoleRad)) return IntegrationStatus::kNearPole;
  const Surroundings mid(latitude_mid, height_mid, v_mid);

  const Eigen::Vector3d zeta = dt * (mid.omega_ie + mid.omega_en);
  NavigationState next;
  next.v_n_mps = v + push - 0.5 * zeta.cross(push) + dt * mid.free_acceleration(v_mid);
  next.q_n_b = geometry::quaternion_from_rotation_vector(-zeta) * state_.q_n_b *
               geometry::quaternion_from_rotation_vector(increment.delta_theta_b);
  next.q_n_b.normalize();
  const Eigen::Vector3d moved = 0.5 * dt * (v + next.v_n_mps);
  next.place.height_m = height - moved.z();
  next.place.latitude_rad = latitude + moved.x() / (geometry::meridian_radius_m(latitude_mid) + height_mid);
  next.place.longitude_rad =
      wrap_to_pi(longitude +
                 moved.y() / ((geometry::prime_vertical_radius_m(latitude_mid) + height_mid) * std::cos(latitude_mid)));
  if (!next.v_n_mps.allFinite() || !std::isfinite(next.place.latitude_rad) || !next.q_n_b.coeffs().allFinite()) {
    return IntegrationStatus::kNonFinite;
  }
  if (!(std::abs(next.place.latitude_rad) < kPoleRad)) return IntegrationStatus::kNearPole;
  state_ = next;
  return IntegrationStatus::kIntegrated;
}

}  // namespace soopnav::inertial
