#include "soopnav/geometry/wgs84.hpp"

#include <algorithm>
#include <cmath>

#include "soopnav/core/constants.hpp"

namespace soopnav::geometry {
namespace {

constexpr double kA = wgs84::kSemiMajorAxisM;
constexpr double kB = wgs84::kSemiMinorAxisM;
constexpr double kE2 = wgs84::kEccentricitySquared;

// 1 - e^2 sin^2(lat), the square of a / N.
double curvature_factor(double sin_latitude) { return 1.0 - kE2 * sin_latitude * sin_latitude; }

}  // namespace

Eigen::Vector3d geodetic_to_ecef(double latitude_rad, double longitude_rad, double height_m) noexcept {
  const double sin_lat = std::sin(latitude_rad);
  const double cos_lat = std::cos(latitude_rad);
  const double n = kA / std::sqrt(curvature_factor(sin_lat));
  const double from_axis = (n + height_m) * cos_lat;
  return {from_axis * std::cos(longitude_rad), from_axis * std::sin(longitude_rad),
          (n * (1.0 - kE2) + height_m) * sin_lat};
}

Eigen::Vector3d geodetic_to_ecef(const Geodetic& place) noexcept {
  return geodetic_to_ecef(place.latitude_rad, place.longitude_rad, place.height_m);
}

std::optional<Geodetic> ecef_to_geodetic(const Eigen::Vector3d& p_e) noexcept {
  constexpr double kMaxCentreDistanceM = 1e15;
  const double p = std::hypot(p_e.x(), p_e.y());
  const double z = p_e.z();
  const double distance = std::hypot(p, z);
  if (!(distance >= kMinCentreDistanceM) || !(distance <= kMaxCentreDistanceM)) return std::nullopt;

  // Reduced latitude beta of the foot point, as a unit vector; at first of the point on the scaled sphere.
  double u = p * kB;
  double v = z * kA;
  double scale = 1.0 / std::hypot(u, v);
  double cos_beta = u * scale;
  double sin_beta = v * scale;
  double numerator = 0.0;
  double denominator = 1.0;
  // One step divides the error by a thousand or more, also down at `kMinCentreDistanceM`.
  constexpr int kMaxSteps = 12;
  for (int step = 0; step < kMaxSteps; ++step) {
    numerator = z + wgs84::kSecondEccentricitySquared * kB * sin_beta * sin_beta * sin_beta;
    denominator = p - kE2 * kA * cos_beta * cos_beta * cos_beta;
    u = denominator * kA;  // tan(beta) = (b / a) tan(lat)
    v = numerator * kB;
    scale = 1.0 / std::hypot(u, v);
    const double change = std::abs(u * scale - cos_beta) + std::abs(v * scale - sin_beta);
    cos_beta = u * scale;
    sin_beta = v * scale;
    if (change < 1e-13) break;  // and the step just made has cut that by a further thousand
  }
  const double norm = std::hypot(numerator, denominator);
  const double sin_lat = numerator / norm;
  const double cos_lat = denominator / norm;
  // Projection on the normal: an error of the latitude enters squared only.
  const double height = p * cos_lat + z * sin_lat - kA * std::sqrt(curvature_factor(sin_lat));
  return Geodetic{std::atan2(numerator, denominator), std::atan2(p_e.y(), p_e.x()), height};
}

double meridian_radius_m(double latitude_rad) noexcept {
  const double factor = curvature_factor(std::sin(latitude_rad));
  return kA * (1.0 - kE2) / (factor * std::sqrt(factor));
}

double prime_vertical_radius_m(double latitude_rad) noexcept {
  return kA / std::sqrt(curvature_factor(std::sin(latitude_rad)));
}

}  // namespace soopnav::geometry
