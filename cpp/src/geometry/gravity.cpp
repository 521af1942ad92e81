#include "soopnav/geometry/gravity.hpp"

#include <array>
#include <cmath>
#include <cstddef>

#include "soopnav/core/constants.hpp"
#include "soopnav/geometry/rotation.hpp"
#include "soopnav/geometry/wgs84.hpp"

namespace soopnav::geometry {
namespace {

constexpr double kA = wgs84::kSemiMajorAxisM;
constexpr double kB = wgs84::kSemiMinorAxisM;
constexpr double kGm = wgs84::kGravitationalParameterM3ps2;
constexpr double kOmega = wgs84::kEarthRateRadps;
constexpr double kE2 = kA * kA - kB * kB;  // linear eccentricity squared, E²

// q(x) / x³ and q'(x) / x² as series in x² = (E/u)² (doc/strapdown.md eq. 4): the closed forms lose ten digits here.
// Terms fall by x² <= 0.0068 above the ellipsoid.
constexpr std::size_t kTerms = 12;
constexpr std::array<double, kTerms> series(double factor, bool with_k) {
  std::array<double, kTerms> c{};
  for (std::size_t i = 0; i < kTerms; ++i) {
    const auto k = static_cast<double>(i + 1);
    const double sign = i % 2 == 0 ? 1.0 : -1.0;
    c[i] = sign * factor * (with_k ? k : 1.0) / ((2.0 * k + 1.0) * (2.0 * k + 3.0));
  }
  return c;
}
constexpr auto kQ = series(2.0, true);
constexpr auto kQPrime = series(6.0, false);

constexpr double horner(const std::array<double, kTerms>& c, double x2) {
  double sum = 0.0;
  for (std::size_t i = kTerms; i-- > 0;) sum = sum * x2 + c[i];
  return sum;
}

// q0 / x0³ at the surface, u = b.
constexpr double kQ0 = horner(kQ, kE2 / (kB * kB));

// Gravity from the distance to the axis and the height over the equator: its parts away from the axis and north.
struct Meridian {
  double outwards;
  double north;
};
Meridian in_meridian(double rho, double z) noexcept {
  const double r2 = rho * rho + z * z;
  const double half = 0.5 * (r2 - kE2);
  const double u2 = half + std::sqrt(half * half + kE2 * z * z);
  const double u = std::sqrt(u2);
  const double v2 = u2 + kE2;
  const double v = std::sqrt(v2);
  const double cos_beta = rho / v;
  const double sin_beta = z / u;
  const double w = std::sqrt((u2 + kE2 * sin_beta * sin_beta) / v2);
  const double x2 = kE2 / u2;
  // q/q0 and E q'/q0 with the powers of E taken out: (b/u)³ and b³/u².
  const double ratio = kB / u;
  const double q = ratio * ratio * ratio * horner(kQ, x2) / kQ0;
  const double e_q_prime = kB * ratio * ratio * horner(kQPrime, x2) / kQ0;
  const double w2a2 = kOmega * kOmega * kA * kA;
  const double g_u = -(kGm + w2a2 * e_q_prime * (0.5 * sin_beta * sin_beta - 1.0 / 6.0)) / v2 +
                     kOmega * kOmega * u * cos_beta * cos_beta;
  const double g_beta = (w2a2 * q / v - kOmega * kOmega * v) * sin_beta * cos_beta;
  const double slope = u / v;
  const double w2 = w * w;
  return {(g_u * slope * cos_beta - g_beta * sin_beta) / w2, (g_u * sin_beta + g_beta * slope * cos_beta) / w2};
}

}  // namespace

double normal_gravity_surface_mps2(double latitude_rad) noexcept {
  const double s = std::sin(latitude_rad);
  return kNormalGravityEquatorMps2 * (1.0 + kSomiglianaConstant * s * s) /
         std::sqrt(1.0 - wgs84::kEccentricitySquared * s * s);
}

double normal_gravity_mps2(double latitude_rad, double height_m) noexcept {
  constexpr double kM = kOmega * kOmega * kA * kA * kB / kGm;
  const double s = std::sin(latitude_rad);
  const double h = height_m / kA;
  return normal_gravity_surface_mps2(latitude_rad) *
         (1.0 - 2.0 * (1.0 + wgs84::kFlattening + kM - 2.0 * wgs84::kFlattening * s * s) * h + 3.0 * h * h);
}

Eigen::Vector3d normal_gravity_ecef(const Eigen::Vector3d& p_e) noexcept {
  const double rho = std::sqrt(p_e.x() * p_e.x() + p_e.y() * p_e.y());
  const Meridian g = in_meridian(rho, p_e.z());
  const double scale = rho > 0.0 ? g.outwards / rho : 0.0;
  return {scale * p_e.x(), scale * p_e.y(), g.north};
}

Eigen::Vector3d normal_gravity_ned(double latitude_rad, double height_m) noexcept {
  const Eigen::Vector3d p_e = geodetic_to_ecef(latitude_rad, 0.0, height_m);
  const Meridian g = in_meridian(p_e.x(), p_e.z());
  const double s = std::sin(latitude_rad);
  const double c = std::cos(latitude_rad);
  return {c * g.north - s * g.outwards, 0.0, -(c * g.outwards + s * g.north)};
}

Eigen::Vector3d j2_gravitation_ecef(const Eigen::Vector3d& p_e, double j2) noexcept {
  const double r2 = p_e.squaredNorm();
  const double r = std::sqrt(r2);
  const double k = 1.5 * j2 * kA * kA / r2;
  const double s2 = p_e.z() * p_e.z() / r2;
  const double common = -kGm / (r2 * r);
  const double equatorial = common * (1.0 + k * (1.0 - 5.0 * s2));
  return {equatorial * p_e.x(), equatorial * p_e.y(), common * (1.0 + k * (3.0 - 5.0 * s2)) * p_e.z()};
}

Eigen::Vector3d centrifugal_ecef(const Eigen::Vector3d& p_e) noexcept {
  return {kOmega * kOmega * p_e.x(), kOmega * kOmega * p_e.y(), 0.0};
}

Eigen::Matrix3d gravity_gradient(const Eigen::Vector3d& r, const Eigen::Vector3d& omega_ie) noexcept {
  const double r2 = r.squaredNorm();
  const double k = kGm / (r2 * std::sqrt(r2));
  Eigen::Matrix3d gradient = (3.0 * k / r2) * (r * r.transpose()) - omega_ie * omega_ie.transpose();
  gradient.diagonal().array() += omega_ie.squaredNorm() - k;
  return gradient;
}

Eigen::Vector3d earth_rate_ned(double latitude_rad) noexcept {
  return {kOmega * std::cos(latitude_rad), 0.0, -kOmega * std::sin(latitude_rad)};
}

Eigen::Vector3d transport_rate_ned(double latitude_rad, double height_m, const Eigen::Vector3d& v_n_mps) noexcept {
  const double east = v_n_mps.y() / (prime_vertical_radius_m(latitude_rad) + height_m);
  const double north = v_n_mps.x() / (meridian_radius_m(latitude_rad) + height_m);
  return {east, -north, -east * std::tan(latitude_rad)};
}

}  // namespace soopnav::geometry
