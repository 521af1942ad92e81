#include "soopnav/estimation/error_ellipse.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "soopnav/estimation/chi_square.hpp"

namespace soopnav {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// P(|x| < r) for standard deviations `major` >= `minor` >= 0, major > 0. In the whitened plane the direction is
// uniform and the length Rayleigh, so P = 1 - mean over the direction of exp(-r² / 2 s²), s² the variance along it
// (doc/position_fix.md eq. 15). The integrand is smooth and of period pi, so equal steps converge faster than any power
// of their number. Where the ellipse is thin or the circle small it changes fast about the short axis; the variable
// phi, tan(direction) = k tan(phi), spreads it out and keeps the period.
double probability_of_axes(double major, double minor, double radius) {
  constexpr int kSteps = 256;
  const double q = 0.5 * radius * radius;
  const double k = std::max(1.0, major / std::max(minor, radius));
  double sum = 0.0;
  for (int i = 0; i < kSteps; ++i) {
    const double phi = std::numbers::pi * (i + 0.5) / kSteps;
    const double c = std::cos(phi);
    const double s = k * std::sin(phi);
    const double c2 = c * c;
    const double s2 = s * s;
    const double variance = (major * major * c2 + minor * minor * s2) / (c2 + s2);
    sum += -std::expm1(-q / variance) * k / (c2 + s2);
  }
  return sum / kSteps;
}

}  // namespace

std::optional<ErrorEllipse> error_ellipse(const Eigen::Matrix2d& covariance_m2) noexcept {
  if (!covariance_m2.allFinite()) return std::nullopt;
  const double xx = covariance_m2(0, 0);
  const double yy = covariance_m2(1, 1);
  const double trace = xx + yy;
  if (!(std::abs(covariance_m2(0, 1) - covariance_m2(1, 0)) <= 1e-9 * std::abs(trace))) return std::nullopt;
  const double xy = 0.5 * (covariance_m2(0, 1) + covariance_m2(1, 0));
  const double half_difference = 0.5 * (xx - yy);
  const double radius = std::hypot(half_difference, xy);
  const double large = 0.5 * trace + radius;
  // The small eigenvalue from the determinant keeps the digits that trace/2 - radius would lose.
  const double small = large > 0.0 ? (xx * yy - xy * xy) / large : 0.0;
  if (!(large >= 0.0) || small < -1e-12 * large) return std::nullopt;
  ErrorEllipse ellipse;
  ellipse.semi_major_m = std::sqrt(large);
  ellipse.semi_minor_m = std::sqrt(std::max(small, 0.0));
  ellipse.angle_rad = 0.5 * std::atan2(2.0 * xy, xx - yy);
  if (ellipse.angle_rad <= -0.5 * std::numbers::pi) ellipse.angle_rad += std::numbers::pi;
  return ellipse;
}

std::optional<ErrorEllipse> error_ellipse(const Eigen::Matrix2d& covariance_m2, double probability) noexcept {
  if (!(probability > 0.0 && probability < 1.0)) return std::nullopt;
  auto ellipse = error_ellipse(covariance_m2);
  if (!ellipse) return std::nullopt;
  const double scale = std::sqrt(chi_square_quantile(probability, 2.0));
  ellipse->semi_major_m *= scale;
  ellipse->semi_minor_m *= scale;
  return ellipse;
}

double probability_within(const Eigen::Matrix2d& covariance_m2, double radius_m) noexcept {
  const auto axes = error_ellipse(covariance_m2);
  if (!axes || !(radius_m >= 0.0)) return kNan;
  if (radius_m == 0.0) return axes->semi_major_m > 0.0 ? 0.0 : 1.0;
  if (!(axes->semi_major_m > 0.0)) return 1.0;
  return probability_of_axes(axes->semi_major_m, axes->semi_minor_m, radius_m);
}

std::optional<double> circular_error_m(const Eigen::Matrix2d& covariance_m2, double probability) noexcept {
  if (!(probability > 0.0 && probability < 1.0)) return std::nullopt;
  const auto axes = error_ellipse(covariance_m2);
  if (!axes) return std::nullopt;
  if (!(axes->semi_major_m > 0.0)) return 0.0;
  // Between the circles of a one-dimensional error and of two equal axes.
  double low = 0.0;
  double high = axes->semi_major_m * std::sqrt(chi_square_quantile(probability, 2.0)) * (1.0 + 1e-9);
  // Regula falsi with bisection when it stalls (Illinois).
  const auto excess = [&](double r) {
    return probability_of_axes(axes->semi_major_m, axes->semi_minor_m, r) - probability;
  };
  double f_low = -probability;
  double f_high = excess(high);
  for (int i = 0; i < 200 && high - low > 1e-11 * high; ++i) {
    double middle = (f_high * low - f_low * high) / (f_high - f_low);
    if (!(middle > low && middle < high)) middle = 0.5 * (low + high);
    const double f = excess(middle);
    if (f == 0.0) return middle;
    if (f < 0.0) {
      low = middle;
      f_low = f;
      f_high *= 0.5;
    } else {
      high = middle;
      f_high = f;
      f_low *= 0.5;
    }
  }
  return 0.5 * (low + high);
}

}  // namespace soopnav
