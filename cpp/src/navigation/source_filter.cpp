#include "navigation/source_filter.hpp"

#include <algorithm>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/error_ellipse.hpp"

namespace soopnav::navigation::detail {
namespace {

constexpr double kMinLevelM = 1e-3;
constexpr double kMaxSigmaRad = 1e3;  // beyond it densities leave what numbers hold

}  // namespace

BearingUse pack(const SourceBearing& b, std::size_t dimensions, Kept& out) noexcept {
  const bool space = dimensions == 3;
  bool finite = std::isfinite(b.t_s) && std::isfinite(b.azimuth_rad) && std::isfinite(b.sigma_azimuth_rad) &&
                std::isfinite(b.heading_sigma_rad);
  if (space) finite = finite && std::isfinite(b.elevation_rad) && std::isfinite(b.sigma_elevation_rad);
  const int n = static_cast<int>(dimensions);
  for (int i = 0; i < n; ++i) {
    finite = finite && std::isfinite(b.position_m[i]);
    for (int j = 0; j < n; ++j) finite = finite && std::isfinite(b.position_covariance_m2(i, j));
  }
  if (!finite) return BearingUse::kNotFinite;
  const auto& C = b.position_covariance_m2;
  const auto usual = [](double sigma) { return sigma >= 1e-9 && sigma <= kMaxSigmaRad; };
  bool good = usual(b.sigma_azimuth_rad) && b.heading_sigma_rad >= 0.0 && b.heading_sigma_rad <= kMaxSigmaRad &&
              (!space || usual(b.sigma_elevation_rad));
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) good = good && C(i, j) * C(i, j) <= C(i, i) * C(j, j) * (1.0 + 1e-9) && C(i, i) >= 0.0;
  }
  if (!good) return BearingUse::kBadSigma;
  out.t_s = b.t_s;
  out.azimuth = wrap_to_pi(b.azimuth_rad);
  out.b = {};
  out.b.x = b.position_m[0];
  out.b.y = b.position_m[1];
  out.b.cos_azimuth = std::cos(out.azimuth);
  out.b.sin_azimuth = std::sin(out.azimuth);
  out.b.variance_azimuth = b.sigma_azimuth_rad * b.sigma_azimuth_rad + b.heading_sigma_rad * b.heading_sigma_rad;
  out.b.xx = C(0, 0);
  out.b.xy = 0.5 * (C(0, 1) + C(1, 0));
  out.b.yy = C(1, 1);
  if (space) {
    out.b.z = b.position_m[2];
    out.b.elevation = b.elevation_rad;
    out.b.variance_elevation = b.sigma_elevation_rad * b.sigma_elevation_rad;
    out.b.xz = 0.5 * (C(0, 2) + C(2, 0));
    out.b.yz = 0.5 * (C(1, 2) + C(2, 1));
    out.b.zz = C(2, 2);
  }
  return BearingUse::kUsed;
}

bool predict(const Layout& layout, const Vector& x, double t_s, const Kept& kept, Angles& out) noexcept {
  const std::size_t d = layout.dimensions;
  const double ahead = layout.moving ? kept.t_s - t_s : 0.0;
  const PackedBearing& b = kept.b;
  const double dx = x[0] - b.x + (layout.moving ? ahead * x[d] : 0.0);
  const double dy = x[1] - b.y + (layout.moving ? ahead * x[d + 1] : 0.0);
  const double square = dx * dx + dy * dy;
  out.level = std::sqrt(square);
  if (!(out.level > kMinLevelM) || !std::isfinite(square)) return false;
  out.gradient = {};
  const double bias = layout.biased ? x[layout.bias()] : 0.0;
  out.residual[0] = wrap_to_pi(kept.azimuth - bias - std::atan2(dy, dx));
  const double ux = -dy / square;
  const double uy = dx / square;
  out.gradient[0][0] = ux;
  out.gradient[0][1] = uy;
  if (layout.biased) out.gradient[0][layout.bias()] = 1.0;
  out.variance[0] = b.variance_azimuth + (ux * ux * b.xx + 2.0 * ux * uy * b.xy + uy * uy * b.yy);
  if (layout.dimensions == 3) {
    const double dz = x[2] - b.z + (layout.moving ? ahead * x[d + 2] : 0.0);
    const double whole = square + dz * dz;
    const double gx = -dx * dz / (whole * out.level);
    const double gy = -dy * dz / (whole * out.level);
    const double gz = out.level / whole;
    out.residual[1] = b.elevation - std::atan2(dz, out.level);
    out.gradient[1][0] = gx;
    out.gradient[1][1] = gy;
    out.gradient[1][2] = gz;
    out.variance[1] = b.variance_elevation + (gx * gx * b.xx + gy * gy * b.yy + gz * gz * b.zz +
                                              2.0 * (gx * gy * b.xy + gx * gz * b.xz + gy * gz * b.yz));
  }
  if (layout.moving) {
    for (std::size_t row = 0; row + 1 < d; ++row) {
      for (std::size_t i = 0; i < d; ++i) out.gradient[row][d + i] = ahead * out.gradient[row][i];
    }
  }
  return true;
}

void propagate(const Layout& layout, double dt_s, double psd, Gaussian& g) noexcept {
  if (!layout.moving || dt_s == 0.0) return;
  const std::size_t d = layout.dimensions;
  const std::size_t n = layout.size();
  for (std::size_t i = 0; i < d; ++i) g.x[i] += dt_s * g.x[d + i];
  for (std::size_t i = 0; i < d; ++i) {  // F P F'
    for (std::size_t j = 0; j < n; ++j) g.P[i][j] += dt_s * g.P[d + i][j];
  }
  for (std::size_t i = 0; i < d; ++i) {
    for (std::size_t j = 0; j < n; ++j) g.P[j][i] += dt_s * g.P[j][d + i];
  }
  const double t = std::abs(dt_s);
  for (std::size_t i = 0; i < d; ++i) {
    g.P[i][i] += psd * t * t * t / 3.0;
    g.P[i][d + i] += psd * t * t / 2.0;
    g.P[d + i][i] += psd * t * t / 2.0;
    g.P[d + i][d + i] += psd * t;
  }
}

bool update(const Layout& layout, double t_s, const Kept& kept, Gaussian& g, double& log_density,
            double* nis) noexcept {
  Angles angles;
  if (!predict(layout, g.x, t_s, kept, angles)) return false;
  const std::size_t n = layout.size();
  Gaussian next = g;
  log_density = 0.0;
  double squares = 0.0;
  for (std::size_t row = 0; row + 1 < layout.dimensions; ++row) {
    const Vector& h = angles.gradient[row];
    Vector ph{};
    double s = angles.variance[row];
    double innovation = angles.residual[row];  // both angles are linearised where the update began
    for (std::size_t i = 0; i < n; ++i) {
      innovation -= h[i] * (next.x[i] - g.x[i]);
      for (std::size_t j = 0; j < n; ++j) ph[i] += next.P[i][j] * h[j];
    }
    for (std::size_t i = 0; i < n; ++i) s += h[i] * ph[i];
    if (!(s > 0.0) || !std::isfinite(s)) return false;
    log_density -= 0.5 * (innovation * innovation / s + std::log(kTwoPi * s));
    squares += innovation * innovation / s;
    Vector k{};
    for (std::size_t i = 0; i < n; ++i) {
      k[i] = ph[i] / s;
      next.x[i] += k[i] * innovation;
    }
    // (I - k h') P (I - k h')' + k r k' = P - k ph' - ph k' + s k k'
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t j = 0; j <= i; ++j) {
        next.P[i][j] += (s * k[i] * k[j] - k[i] * ph[j]) - ph[i] * k[j];
        next.P[j][i] = next.P[i][j];
      }
      if (!(next.P[i][i] >= 0.0) || !std::isfinite(next.x[i])) return false;
    }
  }
  g = next;
  if (nis != nullptr) *nis = squares;
  return true;
}

bool factor(std::size_t n, const Matrix& A, Matrix& L) noexcept {
  for (std::size_t j = 0; j < n; ++j) {
    double d = A[j][j];
    for (std::size_t k = 0; k < j; ++k) d -= L[j][k] * L[j][k];
    if (!(d > 1e-14 * A[j][j]) || !std::isfinite(d)) return false;
    L[j][j] = std::sqrt(d);
    for (std::size_t i = j + 1; i < n; ++i) {
      double s = A[i][j];
      for (std::size_t k = 0; k < j; ++k) s -= L[i][k] * L[j][k];
      L[i][j] = s / L[j][j];
    }
  }
  return true;
}

void solve(std::size_t n, const Matrix& L, const Vector& b, Vector& x) noexcept {
  Vector y{};
  for (std::size_t i = 0; i < n; ++i) {
    y[i] = b[i];
    for (std::size_t k = 0; k < i; ++k) y[i] -= L[i][k] * y[k];
    y[i] /= L[i][i];
  }
  for (std::size_t i = n; i-- > 0;) {
    x[i] = y[i];
    for (std::size_t k = i + 1; k < n; ++k) x[i] -= L[k][i] * x[k];
    x[i] /= L[i][i];
  }
}

void invert(std::size_t n, const Matrix& L, Matrix& inverse) noexcept {
  for (std::size_t j = 0; j < n; ++j) {
    Vector unit{};
    unit[j] = 1.0;
    Vector column{};
    solve(n, L, unit, column);
    for (std::size_t i = 0; i < n; ++i) inverse[i][j] = column[i];
  }
}

void write_state(const Layout& layout, const Vector& x, const Matrix& P, SourceFix& fix) noexcept {
  const auto d = static_cast<Eigen::Index>(layout.dimensions);
  fix.position_m.setZero();
  fix.covariance_m2.setZero();
  for (Eigen::Index i = 0; i < d; ++i) {
    fix.position_m[i] = x[static_cast<std::size_t>(i)];
    for (Eigen::Index j = 0; j < d; ++j) {
      fix.covariance_m2(i, j) = P[static_cast<std::size_t>(i)][static_cast<std::size_t>(j)];
    }
  }
  if (layout.moving) {
    fix.velocity_mps.setZero();
    fix.velocity_covariance.setZero();
    for (Eigen::Index i = 0; i < d; ++i) {
      fix.velocity_mps[i] = x[static_cast<std::size_t>(d + i)];
      for (Eigen::Index j = 0; j < d; ++j) {
        fix.velocity_covariance(i, j) = P[static_cast<std::size_t>(d + i)][static_cast<std::size_t>(d + j)];
      }
    }
  }
  if (layout.biased) {
    fix.heading_bias_rad = x[layout.bias()];
    fix.heading_bias_sigma_rad = std::sqrt(P[layout.bias()][layout.bias()]);
  }
  fix.cep_m = circular_error_m(fix.covariance_m2.topLeftCorner<2, 2>()).value_or(SourceFix::kNan);
}

}  // namespace soopnav::navigation::detail
