#include "soopnav/inertial/coning_sculling.hpp"

#include <Eigen/Geometry>
#include <cmath>
#include <stdexcept>
#include <string>

#include "soopnav/geometry/rotation.hpp"

namespace soopnav::inertial {
namespace {

// doc/strapdown.md eq. 11: c_j for 1 ... 4 earlier samples; sum j c_j = 1/12 in each row.
constexpr double kC[5][4] = {{0.0, 0.0, 0.0, 0.0},
                             {1.0 / 12.0, 0.0, 0.0, 0.0},
                             {7.0 / 60.0, -1.0 / 60.0, 0.0, 0.0},
                             {113.0 / 840.0, -13.0 / 420.0, 1.0 / 280.0, 0.0},
                             {367.0 / 2520.0, -53.0 / 1260.0, 1.0 / 120.0, -1.0 / 1260.0}};

int checked(int previous) {
  if (previous < 0 || previous > ConingSculling::kMaxPrevious) {
    throw std::invalid_argument("previous: " + std::to_string(previous) + "; 0 ... 4 earlier samples can be used");
  }
  return previous;
}

// Adds the corrections for the weighted sums D, S of neighbours; `sign` -1 when they are later ones.
ImuIncrement corrected(const ImuIncrement& u, const Eigen::Vector3d& D, const Eigen::Vector3d& S, double sign) {
  return {u.delta_theta_b + sign * D.cross(u.delta_theta_b),
          u.delta_velocity_b + sign * (D.cross(u.delta_velocity_b) + S.cross(u.delta_theta_b)), u.dt_s};
}

}  // namespace

ConingSculling::ConingSculling(int previous) : previous_(checked(previous)) {}

ImuIncrement ConingSculling::correct(const ImuIncrement& increment) noexcept {
  if (!increment.all_finite()) {
    reset();
    return increment;
  }
  if (seen_ > 0 && !(std::abs(increment.dt_s - last_[0].dt_s) <= 0.1 * last_[0].dt_s)) reset();
  Eigen::Vector3d D = Eigen::Vector3d::Zero();
  Eigen::Vector3d S = Eigen::Vector3d::Zero();
  for (int j = 0; j < seen_; ++j) {
    const auto i = static_cast<std::size_t>(j);
    D += kC[seen_][i] * last_[i].delta_theta_b;
    S += kC[seen_][i] * last_[i].delta_velocity_b;
  }
  for (std::size_t i = kMaxPrevious - 1; i > 0; --i) last_[i] = last_[i - 1];
  last_[0] = increment;
  if (seen_ < previous_) ++seen_;
  return corrected(increment, D, S, 1.0);
}

ImuIncrement ConingSculling::two_sample(const ImuIncrement& first, const ImuIncrement& second) noexcept {
  const Eigen::Vector3d& a = first.delta_theta_b;
  const Eigen::Vector3d& b = second.delta_theta_b;
  constexpr double k = 2.0 / 3.0;
  return {a + b + k * a.cross(b),
          first.delta_velocity_b + second.delta_velocity_b +
              k * (a.cross(second.delta_velocity_b) + first.delta_velocity_b.cross(b)),
          first.dt_s + second.dt_s};
}

void ConingSculling::correct_all(std::span<ImuIncrement> increments, int previous) {
  ConingSculling corrector(previous);
  const auto n = static_cast<std::size_t>(previous);
  // Looking ahead is for starts that are whole.
  const bool whole = increments.size() > 2 * n && [&] {
    for (const ImuIncrement& u : increments.first(2 * n)) {
      if (!u.all_finite()) return false;
    }
    return true;
  }();
  if (!whole) {
    for (ImuIncrement& u : increments) u = corrector.correct(u);
    return;
  }
  // The first samples look ahead; the corrector still sees them as they were.
  std::array<ImuIncrement, kMaxPrevious> first{};
  for (std::size_t k = 0; k < n; ++k) {
    Eigen::Vector3d D = Eigen::Vector3d::Zero();
    Eigen::Vector3d S = Eigen::Vector3d::Zero();
    for (std::size_t j = 1; j <= n; ++j) {
      D += kC[previous][j - 1] * increments[k + j].delta_theta_b;
      S += kC[previous][j - 1] * increments[k + j].delta_velocity_b;
    }
    first[k] = corrected(increments[k], D, S, -1.0);
  }
  for (std::size_t k = 0; k < increments.size(); ++k) {
    const ImuIncrement u = corrector.correct(increments[k]);
    increments[k] = k < n ? first[k] : u;
  }
}

IncrementRotation::IncrementRotation(const Eigen::Vector3d& phi_rad) noexcept {
  const double t2 = phi_rad.squaredNorm();
  if (t2 < 0.04) {  // series: the quotients lose digits
    a = 1.0 / 2.0 - t2 * (1.0 / 24.0 - t2 * (1.0 / 720.0 - t2 * (1.0 / 40320.0 - t2 / 3628800.0)));
    b = 1.0 / 6.0 - t2 * (1.0 / 120.0 - t2 * (1.0 / 5040.0 - t2 * (1.0 / 362880.0 - t2 / 39916800.0)));
    a_slope = -1.0 / 12.0 + t2 * (1.0 / 180.0 - t2 * (1.0 / 6720.0 - t2 / 453600.0));
    b_slope = -1.0 / 60.0 + t2 * (1.0 / 1260.0 - t2 * (1.0 / 60480.0 - t2 / 4989600.0));
    return;
  }
  const double t = std::sqrt(t2);
  const double s = std::sin(t);
  const double half = std::sin(0.5 * t);
  a = 2.0 * half * half / t2;
  b = (t - s) / (t2 * t);
  a_slope = (s / t - 2.0 * a) / t2;
  b_slope = (a - 3.0 * b) / t2;
}

Eigen::Matrix3d IncrementRotation::matrix(const Eigen::Vector3d& phi_rad) const noexcept {
  Eigen::Matrix3d J = a * geometry::skew(phi_rad) + b * (phi_rad * phi_rad.transpose());
  J.diagonal().array() += 1.0 - b * phi_rad.squaredNorm();
  return J;
}

Eigen::Matrix3d IncrementRotation::slope(const Eigen::Vector3d& phi_rad, const Eigen::Vector3d& d) const noexcept {
  const Eigen::Vector3d once = phi_rad.cross(d);
  const Eigen::Vector3d twice = phi_rad.cross(once);
  Eigen::Matrix3d D = -a * geometry::skew(d) + (a_slope * once + b_slope * twice) * phi_rad.transpose() +
                      b * (phi_rad * d.transpose() - 2.0 * d * phi_rad.transpose());
  D.diagonal().array() += b * phi_rad.dot(d);
  return D;
}

Eigen::Vector3d rotated_increment(const Eigen::Vector3d& phi_rad, const Eigen::Vector3d& d) noexcept {
  const IncrementRotation J(phi_rad);
  const Eigen::Vector3d once = phi_rad.cross(d);
  return d + J.a * once + J.b * phi_rad.cross(once);
}

}  // namespace soopnav::inertial
