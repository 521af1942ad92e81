#include "soopnav/gnss/attitude.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>

#include "attitude_information.hpp"
#include "eigen.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::gnss {

namespace {

constexpr double kFlat = 1e-6;           // smallest over largest eigenvalue of directions that span space
constexpr double kUnturned = 1e-9;       // the same of the information about a rotation
constexpr double kConvergedRad = 1e-10;  // of a Gauss-Newton step
constexpr int kMaxIterations = 30;

bool all_finite(const std::vector<Eigen::Vector3d>& vectors) {
  return std::ranges::all_of(vectors, [](const Eigen::Vector3d& v) { return v.allFinite(); });
}

}  // namespace

double arrival_angle(double path_m, double baseline_m) noexcept {
  if (!std::isfinite(path_m) || !(baseline_m > 0.0)) return AttitudeFix::kNan;
  return std::acos(std::clamp(path_m / baseline_m, -1.0, 1.0));
}

double arrival_angle_sigma(double angle_rad, double baseline_m, double path_sigma_m) noexcept {
  if (!(path_sigma_m >= 0.0) || !(baseline_m > 0.0)) return AttitudeFix::kNan;
  return path_sigma_m / (baseline_m * std::abs(std::sin(angle_rad)));
}

void AttitudeModel::check() const {
  if (baselines_m.empty() || baselines_m.size() > kMaxAttitudeBaselines) {
    throw std::invalid_argument("baselines_m: " + std::to_string(baselines_m.size()) + " baselines; 1 ... 8 expected");
  }
  if (!all_finite(baselines_m)) throw std::invalid_argument("baselines_m: finite coordinates expected");
  for (std::size_t i = 0; i < baselines_m.size(); ++i) {
    if (!(baselines_m[i].norm() > 1e-6)) {
      throw std::invalid_argument("baselines_m[" + std::to_string(i) + "]: longer than 1e-6 m expected");
    }
  }
  if (!(sigma_m > 0.0) || std::isinf(sigma_m)) {
    throw std::invalid_argument("sigma_m = " + std::to_string(sigma_m) + ": a positive number expected");
  }
  if (shared_reference && !common_clock) {
    throw std::invalid_argument("shared_reference = true: only with common_clock = true");
  }
}

std::string_view to_string(AttitudeStatus status) noexcept {
  switch (status) {
    case AttitudeStatus::kSolved:
      return "solved";
    case AttitudeStatus::kTooFewSatellites:
      return "too few satellites";
    case AttitudeStatus::kSatellitesInPlane:
      return "satellites in one plane";
    case AttitudeStatus::kUnobservable:
      return "unobservable";
    case AttitudeStatus::kNotConverged:
      return "not converged";
    case AttitudeStatus::kNonFinite:
      return "not finite";
    case AttitudeStatus::kGated:
      return "gated";
    case AttitudeStatus::kGimbalLock:
      return "gimbal lock";
    case AttitudeStatus::kAmbiguous:
      return "ambiguous";
  }
  return "unknown";
}

Eigen::Matrix3d rotation_from_euler_change(const geometry::Euler& euler) noexcept {
  const double sp = std::sin(euler.pitch_rad), cp = std::cos(euler.pitch_rad);
  const double sr = std::sin(euler.roll_rad), cr = std::cos(euler.roll_rad);
  Eigen::Matrix3d E;
  E << -sp, 0.0, 1.0,  //
      cp * sr, cr, 0.0, cp * cr, -sr, 0.0;
  return E;
}

namespace detail {

bool is_direction(const Eigen::Vector3d& u) noexcept { return u.allFinite() && std::abs(u.squaredNorm() - 1.0) < 1e-6; }

AttitudeInformation linearise(const AttitudeModel& model, const Eigen::Matrix3d& T_n_b,
                              std::span<const Eigen::Vector3d> directions, const PathDifferences& path) noexcept {
  const auto baselines = static_cast<Eigen::Index>(model.baselines_m.size());
  const auto satellites = std::min(static_cast<Eigen::Index>(directions.size()), path.cols());
  AttitudeInformation out;
  // With a shared reference the variance of a difference is that of two antennas: W = 2 (I - 1 1' / (k + 1)).
  const double weight = (model.shared_reference ? 2.0 : 1.0) / (model.sigma_m * model.sigma_m);
  // Sums that are taken off: per baseline for its clock, per satellite for the shared antenna.
  struct Sums {
    Eigen::Vector3d row = Eigen::Vector3d::Zero();
    double residual = 0.0;
    int count = 0;
  };
  std::array<Sums, kMaxAttitudeBaselines> clocks;
  const auto take_off = [&](const Sums& sums, double share) {
    out.information -= share * sums.row * sums.row.transpose();
    out.gradient -= share * sums.residual * sums.row;
    out.chi_square -= share * sums.residual * sums.residual;
  };
  for (Eigen::Index s = 0; s < satellites; ++s) {
    const Eigen::Vector3d& u = directions[static_cast<std::size_t>(s)];
    if (!is_direction(u)) continue;
    const Eigen::Vector3d u_b = T_n_b.transpose() * u;
    Sums shared;
    for (Eigen::Index i = 0; i < std::min(baselines, path.rows()); ++i) {
      const auto k = static_cast<std::size_t>(i);
      const double residual = path(i, s) - model.baselines_m[k].dot(u_b);
      if (!std::isfinite(residual)) continue;
      const Eigen::Vector3d row = model.baselines_m[k].cross(u_b);  // of b . (T exp(d))' u by d
      out.information += row * row.transpose();
      out.gradient += residual * row;
      out.chi_square += residual * residual;
      ++out.rows;
      for (Sums* sums : {&shared, &clocks[k]}) {
        sums->row += row;
        sums->residual += residual;
        ++sums->count;
      }
    }
    if (model.shared_reference && shared.count > 0) take_off(shared, 1.0 / (shared.count + 1));
  }
  if (!model.common_clock) {
    for (const Sums& clock : clocks) {
      if (clock.count == 0) continue;
      take_off(clock, 1.0 / clock.count);
      --out.rows;
    }
  }
  out.information *= weight;
  out.gradient *= weight;
  out.chi_square = std::max(0.0, out.chi_square * weight);
  return out;
}

}  // namespace detail

namespace {

using Solver3 = detail::SymmetricEigen<3>;

// The vector of the reference that each baseline is, by least squares over the satellites (eq. 16), then the rotation
// that carries the body's baselines there (Wahba's problem; Davenport's matrix). None without three directions.
std::optional<Eigen::Quaterniond> closed_form(const AttitudeModel& model, std::span<const Eigen::Vector3d> directions,
                                              const PathDifferences& path, bool& flat) noexcept {
  Eigen::Matrix3d B = Eigen::Matrix3d::Zero();
  const auto satellites = std::min(static_cast<Eigen::Index>(directions.size()), path.cols());
  int vectors = 0;
  for (std::size_t k = 0; k < model.baselines_m.size() && static_cast<Eigen::Index>(k) < path.rows(); ++k) {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero(), sum = Eigen::Vector3d::Zero();
    double total = 0.0;
    int count = 0;
    for (Eigen::Index s = 0; s < satellites; ++s) {
      const Eigen::Vector3d& u = directions[static_cast<std::size_t>(s)];
      const double y = path(static_cast<Eigen::Index>(k), s);
      if (!detail::is_direction(u) || !std::isfinite(y)) continue;
      normal += u * u.transpose();
      right += y * u;
      sum += u;
      total += y;
      ++count;
    }
    if (count < (model.common_clock ? 3 : 4)) continue;
    if (!model.common_clock) {
      normal -= sum * sum.transpose() / count;
      right -= sum * total / count;
    }
    const Solver3 eigen(normal);
    if (!(eigen.values[0] > kFlat * eigen.values[2])) {
      flat = true;
      continue;
    }
    const Eigen::Vector3d w = eigen.vectors * (eigen.vectors.transpose() * right).cwiseQuotient(eigen.values);
    B += w * model.baselines_m[k].transpose();
    ++vectors;
  }
  if (vectors == 0) return std::nullopt;
  // Largest eigenvector of K maximises tr(B' T): K = [tr B, z'; z, B + B' - tr B I], T maps body to reference.
  const Eigen::Vector3d z(B(2, 1) - B(1, 2), B(0, 2) - B(2, 0), B(1, 0) - B(0, 1));
  Eigen::Matrix4d K;
  K(0, 0) = B.trace();
  K.block<3, 1>(1, 0) = z;
  K.block<1, 3>(0, 1) = z.transpose();
  K.block<3, 3>(1, 1) = B + B.transpose() - B.trace() * Eigen::Matrix3d::Identity();
  const detail::SymmetricEigen<4> eigen(K);
  const Eigen::Vector4d q = eigen.vectors.col(3);
  return Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized();
}

void finish(const detail::AttitudeInformation& at, AttitudeFix& fix) noexcept {
  const Eigen::Matrix3d T = fix.q_n_b.toRotationMatrix();
  fix.euler = geometry::euler_from_rotation(T);
  fix.chi_square = at.chi_square;
  fix.degrees_of_freedom = at.rows - 3;
  const Eigen::Matrix3d inverse = at.information.llt().solve(Eigen::Matrix3d::Identity());
  fix.covariance_rad2 = 0.5 * (inverse + inverse.transpose());
  if (std::abs(std::cos(fix.euler.pitch_rad)) > 0.01) {
    const Eigen::Matrix3d E = rotation_from_euler_change(fix.euler).inverse();
    fix.euler_covariance_rad2 = E * fix.covariance_rad2 * E.transpose();
  }
}

}  // namespace

AttitudeFix attitude_fix(const AttitudeModel& model, std::span<const Eigen::Vector3d> directions,
                         const PathDifferences& path, const std::optional<Eigen::Quaterniond>& start) noexcept {
  AttitudeFix fix;
  if (detail::linearise(model, Eigen::Matrix3d::Identity(), directions, path).rows < 3) return fix;
  bool flat = false;
  const auto first = start ? start : closed_form(model, directions, path, flat);
  if (!first || (flat && !start)) {
    if (flat) fix.status = AttitudeStatus::kSatellitesInPlane;
    return fix;
  }
  if (!first->coeffs().allFinite() || !(first->norm() > 0.0)) {
    fix.status = AttitudeStatus::kNonFinite;
    return fix;
  }
  fix.q_n_b = first->normalized();
  for (fix.iterations = 1; fix.iterations <= kMaxIterations; ++fix.iterations) {
    const auto at = detail::linearise(model, fix.q_n_b.toRotationMatrix(), directions, path);
    const Solver3 eigen(at.information);
    if (!(eigen.values[0] > kUnturned * eigen.values[2])) {
      fix.status = AttitudeStatus::kUnobservable;
      fix.unobservable_b = eigen.vectors.col(0);
      fix.euler = geometry::euler_from_rotation(fix.q_n_b.toRotationMatrix());
      fix.chi_square = at.chi_square;
      fix.degrees_of_freedom = at.rows - 2;
      return fix;
    }
    Eigen::Vector3d step = eigen.vectors * (eigen.vectors.transpose() * at.gradient).cwiseQuotient(eigen.values);
    const double angle = step.norm();
    if (angle > 0.5) step *= 0.5 / angle;
    fix.q_n_b = (fix.q_n_b * geometry::quaternion_from_rotation_vector(step)).normalized();
    if (angle <= kConvergedRad * (1.0 + std::sqrt(at.chi_square))) {
      fix.status = AttitudeStatus::kSolved;
      finish(detail::linearise(model, fix.q_n_b.toRotationMatrix(), directions, path), fix);
      return fix;
    }
  }
  fix.status = AttitudeStatus::kNotConverged;
  finish(detail::linearise(model, fix.q_n_b.toRotationMatrix(), directions, path), fix);
  return fix;
}

}  // namespace soopnav::gnss
