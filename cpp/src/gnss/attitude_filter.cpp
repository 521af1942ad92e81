#include <Eigen/LU>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

#include "attitude_information.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/gnss/attitude.hpp"

namespace soopnav::gnss {

namespace {

constexpr double kMinCosPitch = 0.02;  // 1.1 deg from pitch +-90 deg

Eigen::Vector3d vector_of(const geometry::Euler& euler) { return {euler.yaw_rad, euler.pitch_rad, euler.roll_rad}; }

}  // namespace

void AttitudeFilterOptions::check() const {
  if (!(rate_noise_rad_rts >= 0.0) || std::isinf(rate_noise_rad_rts)) {
    throw std::invalid_argument("rate_noise_rad_rts = " + std::to_string(rate_noise_rad_rts) +
                                ": a number of at least 0 expected");
  }
  if (!(false_alarm_probability >= 0.0 && false_alarm_probability < 0.5)) {
    throw std::invalid_argument("false_alarm_probability = " + std::to_string(false_alarm_probability) +
                                ": 0 (no gate) ... 0.5 expected");
  }
}

AttitudeFilter::AttitudeFilter(AttitudeModel model, const AttitudeFilterOptions& options,
                               const Eigen::Quaterniond& start_q_n_b, const Eigen::Matrix3d& covariance_rad2)
    : model_(std::move(model)), options_(options), q_n_b_(start_q_n_b), P_(covariance_rad2) {
  model_.check();
  options_.check();
  if (!start_q_n_b.coeffs().allFinite() || std::abs(start_q_n_b.norm() - 1.0) > 1e-6) {
    throw std::invalid_argument("start: a unit quaternion expected, its length is " +
                                std::to_string(start_q_n_b.norm()));
  }
  const double scale = covariance_rad2.cwiseAbs().maxCoeff();
  const bool symmetric = covariance_rad2.allFinite() &&
                         (covariance_rad2 - covariance_rad2.transpose()).cwiseAbs().maxCoeff() <= 1e-9 * scale;
  // Principal minors of a 3 x 3 matrix, to rounding.
  const auto& C = covariance_rad2;
  const auto minor = [&](int i, int j) { return C(i, i) * C(j, j) - C(i, j) * C(j, i); };
  const double slack = 1e-12 * scale;
  if (!symmetric || C.diagonal().minCoeff() < -slack || minor(0, 1) < -slack * scale || minor(0, 2) < -slack * scale ||
      minor(1, 2) < -slack * scale || C.determinant() < -slack * scale * scale) {
    throw std::invalid_argument("covariance_rad2: symmetric positive semi-definite expected");
  }
  q_n_b_.normalize();
  euler_ = geometry::euler_from_rotation(q_n_b_.toRotationMatrix());
}

void AttitudeFilter::set_euler(const Eigen::Vector3d& e) noexcept {
  const Eigen::Matrix3d T = geometry::rotation_from_euler({e[0], e[1], e[2]});
  euler_ = geometry::euler_from_rotation(T);
  q_n_b_ = geometry::quaternion_from_rotation(T);
}

AttitudeStatus AttitudeFilter::predict(double dt_s, const Eigen::Vector3d& rate_radps) noexcept {
  if (!(dt_s >= 0.0) || std::isinf(dt_s) || !rate_radps.allFinite()) return AttitudeStatus::kNonFinite;
  const Eigen::Vector3d turn = rate_radps * dt_s;
  Eigen::Matrix3d F = Eigen::Matrix3d::Identity();
  const bool turning = !turn.isZero(0.0);
  if (options_.parameters == AttitudeParameters::kQuaternion) {
    if (turning) {
      const Eigen::Quaterniond dq = geometry::quaternion_from_rotation_vector(turn);
      q_n_b_ = (q_n_b_ * dq).normalized();
      F = dq.toRotationMatrix().transpose();
      euler_ = geometry::euler_from_rotation(q_n_b_.toRotationMatrix());
    }
  } else if (turning) {
    if (std::abs(std::cos(euler_.pitch_rad)) < kMinCosPitch) return AttitudeStatus::kGimbalLock;
    // d(e)/dt = E^-1 w: yaw and pitch do not depend on yaw.
    const double sp = std::sin(euler_.pitch_rad), cp = std::cos(euler_.pitch_rad);
    const double sr = std::sin(euler_.roll_rad), cr = std::cos(euler_.roll_rad);
    const double along = sr * turn[1] + cr * turn[2];   // of the turn about the horizontal-yaw plane's normal
    const double across = cr * turn[1] - sr * turn[2];  // its derivative by roll
    const Eigen::Vector3d change(along / cp, across, turn[0] + along * sp / cp);
    F(0, 1) += along * sp / (cp * cp);
    F(0, 2) += across / cp;
    F(1, 2) -= along;
    F(2, 1) += along / (cp * cp);
    F(2, 2) += across * sp / cp;
    set_euler(vector_of(euler_) + change);
  }
  P_ = F * P_ * F.transpose();
  P_.diagonal().array() += options_.rate_noise_rad_rts * options_.rate_noise_rad_rts * dt_s;
  return AttitudeStatus::kSolved;
}

AttitudeUpdate AttitudeFilter::update(std::span<const Eigen::Vector3d> directions,
                                      const PathDifferences& path) noexcept {
  AttitudeUpdate report;
  auto at = detail::linearise(model_, q_n_b_.toRotationMatrix(), directions, path);
  report.rows = at.rows;
  if (at.rows < 1) return report;
  if (options_.parameters == AttitudeParameters::kEuler) {
    if (std::abs(std::cos(euler_.pitch_rad)) < kMinCosPitch) {
      report.status = AttitudeStatus::kGimbalLock;
      return report;
    }
    const Eigen::Matrix3d E = rotation_from_euler_change(euler_);
    at.information = E.transpose() * at.information * E;
    at.gradient = E.transpose() * at.gradient;
  }
  // (P^-1 + Lambda)^-1 = (I + P Lambda)^-1 P, which a singular P does not trouble.
  const Eigen::Matrix3d pulled = Eigen::Matrix3d::Identity() + P_ * at.information;
  const Eigen::Matrix3d updated = pulled.partialPivLu().solve(P_);
  const Eigen::Matrix3d posterior = 0.5 * (updated + updated.transpose());
  const Eigen::Vector3d step = posterior * at.gradient;
  report.nis = at.chi_square - at.gradient.dot(step);
  if (!posterior.allFinite() || !step.allFinite()) {
    report.status = AttitudeStatus::kNonFinite;
    return report;
  }
  if (options_.false_alarm_probability > 0.0 &&
      report.nis > chi_square_upper_quantile(options_.false_alarm_probability, at.rows)) {
    report.status = AttitudeStatus::kGated;
    return report;
  }
  P_ = posterior;
  if (options_.parameters == AttitudeParameters::kQuaternion) {
    q_n_b_ = (q_n_b_ * geometry::quaternion_from_rotation_vector(step)).normalized();
    euler_ = geometry::euler_from_rotation(q_n_b_.toRotationMatrix());
  } else {
    set_euler(vector_of(euler_) + step);
  }
  report.status = AttitudeStatus::kSolved;
  return report;
}

double heading_error_density(double error_rad, double kappa) noexcept {
  // Polar angle of a plane normal vector, kappa standard deviations off the origin (eq. 23).
  const double c = kappa * std::cos(error_rad), s = kappa * std::sin(error_rad);
  return std::exp(-0.5 * kappa * kappa) / kTwoPi +
         c / std::sqrt(kTwoPi) * 0.5 * std::erfc(-c / std::sqrt(2.0)) * std::exp(-0.5 * s * s);
}

HeadingError heading_error(double baseline_m, double position_sigma_m) noexcept {
  HeadingError out;
  if (!(baseline_m >= 0.0) || !(position_sigma_m > 0.0) || std::isinf(baseline_m) || std::isinf(position_sigma_m)) {
    out.linear_sigma_rad = out.rms_rad = out.inversion_probability = AttitudeFix::kNan;
    return out;
  }
  const double kappa = baseline_m / (std::sqrt(2.0) * position_sigma_m);
  out.linear_sigma_rad = 1.0 / kappa;
  out.inversion_probability = 0.5 * std::erfc(kappa / std::sqrt(2.0));
  // Here the two differ by 1 / (2 kappa^2), and further on the peak is too narrow and too high for quadrature.
  if (kappa > 1e8) {
    out.rms_rad = out.linear_sigma_rad;
    return out;
  }
  // Simpson over the peak and over the rest (eq. 24).
  const auto integral = [&](double from, double to) {
    constexpr int kSteps = 400;
    const double h = (to - from) / kSteps;
    double sum = 0.0;
    for (int i = 0; i <= kSteps; ++i) {
      const double x = from + h * i;
      sum += (i == 0 || i == kSteps ? 1.0 : i % 2 == 1 ? 4.0 : 2.0) * x * x * heading_error_density(x, kappa);
    }
    return sum * h / 3.0;
  };
  const double edge = kappa > 4.0 ? 12.0 / kappa : 0.5 * kPi;
  out.rms_rad = std::sqrt(2.0 * (integral(0.0, std::min(edge, kPi)) + (edge < kPi ? integral(edge, kPi) : 0.0)));
  return out;
}

}  // namespace soopnav::gnss
