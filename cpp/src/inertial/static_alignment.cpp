#include "soopnav/inertial/static_alignment.hpp"

#include <cmath>
#include <sstream>
#include <stdexcept>

#include "soopnav/core/constants.hpp"
#include "soopnav/geometry/gravity.hpp"
#include "soopnav/geometry/rotation.hpp"

namespace soopnav::inertial {
namespace {

// A body at rest turns with the Earth: more than the unit's errors and a slow sway beside it is a turn.
constexpr double kRestSigmas = 6.0;
constexpr double kRestRateRadps = 2e-3;

void require(bool holds, const char* name, double value, const char* rule) {
  if (holds) return;
  std::ostringstream text;
  text << name << ": " << value << "; " << rule;
  throw std::invalid_argument(text.str());
}

void check(double duration_s, const geometry::Geodetic& place, const AlignmentErrors& errors,
           const std::optional<GivenHeading>& heading) {
  require(duration_s > 0.0 && std::isfinite(duration_s), "duration_s", duration_s, "it must be positive and finite");
  require(std::abs(place.latitude_rad) <= kPi / 2.0, "place.latitude_rad", place.latitude_rad,
          "it must lie between -pi/2 and pi/2");
  require(std::isfinite(place.height_m), "place.height_m", place.height_m, "it must be finite");
  const auto positive = [](double value, const char* name) {
    require(value >= 0.0 && std::isfinite(value), name, value, "it must be finite and not negative");
  };
  positive(errors.gyro_bias_sigma_radps, "gyro_bias_sigma_radps");
  positive(errors.accelerometer_bias_sigma_mps2, "accelerometer_bias_sigma_mps2");
  positive(errors.gyro_density, "gyro_density");
  positive(errors.accelerometer_density, "accelerometer_density");
  require(errors.max_heading_sigma_rad > 0.0, "max_heading_sigma_rad", errors.max_heading_sigma_rad,
          "it must be positive");
  if (heading) {
    require(std::isfinite(heading->heading_rad), "heading_rad", heading->heading_rad, "it must be finite");
    positive(heading->sigma_rad, "sigma_rad");
  }
}

}  // namespace

Alignment static_alignment(const Eigen::Vector3d& mean_force_b_mps2, const Eigen::Vector3d& mean_rate_b_radps,
                           double duration_s, const geometry::Geodetic& place, const AlignmentErrors& errors,
                           const std::optional<GivenHeading>& heading) {
  check(duration_s, place, errors, heading);
  Alignment out;
  if (!mean_force_b_mps2.allFinite() || !mean_rate_b_radps.allFinite()) return out;
  const Eigen::Vector3d gravity = geometry::normal_gravity_ned(place.latitude_rad, place.height_m);
  const double g = gravity.norm();
  const double force = mean_force_b_mps2.norm();
  if (std::abs(force - g) > 0.05 * g) {
    out.status = AlignmentStatus::kNotAtRest;
    return out;
  }
  const Eigen::Vector3d down_b = -mean_force_b_mps2 / force;

  // Deviations of a mean: the bias, and the white part.
  const double rate_white = errors.gyro_density / std::sqrt(duration_s);
  const double force_white = errors.accelerometer_density / std::sqrt(duration_s);
  const double rate_sigma = std::hypot(errors.gyro_bias_sigma_radps, rate_white);
  const double force_sigma = std::hypot(errors.accelerometer_bias_sigma_mps2, force_white);
  const Eigen::Vector3d omega = geometry::earth_rate_ned(place.latitude_rad);
  if (std::abs(mean_rate_b_radps.norm() - omega.norm()) > kRestSigmas * rate_sigma + kRestRateRadps) {
    out.status = AlignmentStatus::kNotAtRest;
    return out;
  }
  const double tan_lat = -omega.z() / omega.x();
  const bool has_north = std::abs(place.latitude_rad) < kPi / 2.0 - 1.745e-4;
  const double compass_sigma = has_north ? std::hypot(rate_sigma / omega.x(), tan_lat * force_sigma / g)
                                         : std::numeric_limits<double>::infinity();

  // Errors psi_n of the attitude from those of the means, e_n and eps_n (doc/strapdown.md eq. 36, 37).
  Eigen::Matrix3d by_force = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d by_rate = Eigen::Matrix3d::Zero();
  by_force(0, 1) = 1.0 / g;
  by_force(1, 0) = -1.0 / g;
  double given_variance = 0.0;

  out.gyrocompass = compass_sigma <= errors.max_heading_sigma_rad && !(heading && heading->sigma_rad < compass_sigma);
  Eigen::Matrix3d T_n_b;
  if (out.gyrocompass) {
    const Eigen::Vector3d east = down_b.cross(mean_rate_b_radps);
    const double size = east.norm();
    if (!(size > 0.0)) {  // rates along the plumb line: no horizontal part was seen at all
      out.gyrocompass = false;
      out.status = AlignmentStatus::kNoHeading;
      return out;
    }
    T_n_b.row(1) = (east / size).transpose();
    T_n_b.row(0) = (east / size).cross(down_b).transpose();
    T_n_b.row(2) = down_b.transpose();
    by_force(2, 1) = -tan_lat / g;
    by_rate(2, 1) = 1.0 / omega.x();
    out.heading_sigma_rad = compass_sigma;
  } else if (heading) {
    const double level = std::hypot(down_b.y(), down_b.z());
    if (level < 1e-6) {
      out.status = AlignmentStatus::kNoHeading;
      return out;
    }
    T_n_b = geometry::rotation_from_euler(
        {heading->heading_rad, std::atan2(-down_b.x(), level), std::atan2(down_b.y(), down_b.z())});
    given_variance = heading->sigma_rad * heading->sigma_rad;
    out.heading_sigma_rad = heading->sigma_rad;
    // A rotation about level axes that leaves the heading of the first axis as it was given.
    const double slope = std::tan(std::atan2(-down_b.x(), level));
    const double c = std::cos(heading->heading_rad);
    const double s = std::sin(heading->heading_rad);
    by_force.row(2) = -slope * (c * by_force.row(0) + s * by_force.row(1));
  } else {
    out.status = has_north ? AlignmentStatus::kNoHeading : AlignmentStatus::kNearPole;
    return out;
  }
  // What was levelled is the plumb line, which above the ellipsoid leans from its normal.
  T_n_b = geometry::rotation_from_euler({0.0, std::atan2(gravity.x(), gravity.z()), 0.0}) * T_n_b;
  out.q_n_b = geometry::quaternion_from_rotation(T_n_b);
  Eigen::Matrix3d P = force_sigma * force_sigma * by_force * by_force.transpose() +
                      rate_sigma * rate_sigma * by_rate * by_rate.transpose();
  P(2, 2) += given_variance;
  const Eigen::Matrix3d turned = T_n_b.transpose() * P * T_n_b;
  out.covariance = 0.5 * (turned + turned.transpose());
  const double b_a = errors.accelerometer_bias_sigma_mps2;
  const double b_g = errors.gyro_bias_sigma_radps;
  out.cross_accelerometer_bias = b_a * b_a * T_n_b.transpose() * by_force * T_n_b;
  out.cross_gyro_bias = b_g * b_g * T_n_b.transpose() * by_rate * T_n_b;
  out.status = AlignmentStatus::kAligned;
  return out;
}

}  // namespace soopnav::inertial
