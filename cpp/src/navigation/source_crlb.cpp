#include "soopnav/navigation/source_crlb.hpp"

#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "navigation/source_filter.hpp"
#include "soopnav/estimation/posterior_crlb.hpp"

namespace soopnav::navigation {

std::vector<Eigen::MatrixXd> source_crlb(std::span<const SourceBearing> bearings, const Eigen::Vector3d& source_m,
                                         const Eigen::Vector3d& velocity_mps, const SourceBoundOptions& options) {
  const auto require = [](bool holds, const char* name, double value, const char* rule) {
    if (!holds) throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + ": " + rule);
  };
  require(options.dimensions == 2 || options.dimensions == 3, "dimensions", options.dimensions, "2 or 3 expected");
  for (const auto& [value, name] : {std::pair(options.acceleration_psd, "acceleration_psd"),
                                    std::pair(options.heading_bias_sigma_rad, "heading_bias_sigma_rad"),
                                    std::pair(options.start_sigma_m, "start_sigma_m"),
                                    std::pair(options.start_speed_sigma_mps, "start_speed_sigma_mps")}) {
    require(value >= 0.0 && std::isfinite(value), name, value, "zero or a positive number expected");
  }
  const bool moving = options.motion == SourceMotion::kConstantVelocity;
  const bool biased = options.heading_bias_sigma_rad > 0.0;
  const auto dims = static_cast<Eigen::Index>(options.dimensions);
  const detail::Layout layout{static_cast<std::size_t>(options.dimensions), moving, biased};
  const auto n = static_cast<Eigen::Index>(layout.size());
  const Eigen::Index out_size = moving ? 2 * dims : dims;
  for (Eigen::Index i = 0; i < dims; ++i) {
    if (!std::isfinite(source_m[i]) || !std::isfinite(velocity_mps[i])) {
      throw std::invalid_argument("emitter: finite numbers expected");
    }
  }

  Eigen::MatrixXd prior = Eigen::MatrixXd::Zero(n, n);
  const auto known = [](double sigma) { return sigma > 0.0 ? 1.0 / (sigma * sigma) : 0.0; };
  for (Eigen::Index i = 0; i < dims; ++i) {
    prior(i, i) = known(options.start_sigma_m);
    if (moving) prior(dims + i, dims + i) = known(options.start_speed_sigma_mps);
  }
  if (biased) prior(n - 1, n - 1) = known(options.heading_bias_sigma_rad);
  auto bound = PosteriorCrlb<Eigen::Dynamic>::from_information(prior);

  detail::Vector x{};
  for (Eigen::Index i = 0; i < dims; ++i) {
    x[static_cast<std::size_t>(i)] = source_m[i];
    if (moving) x[static_cast<std::size_t>(dims + i)] = velocity_mps[i];
  }
  std::vector<Eigen::MatrixXd> out;
  out.reserve(bearings.size());
  double t_s = bearings.empty() ? 0.0 : bearings.front().t_s;
  for (const SourceBearing& bearing : bearings) {
    const double dt = bearing.t_s - t_s;
    if (!(dt >= 0.0) || !std::isfinite(dt)) throw std::invalid_argument("times_s: they must be finite and not fall");
    t_s = bearing.t_s;
    if (moving && dt > 0.0) {
      Eigen::MatrixXd F = Eigen::MatrixXd::Identity(n, n);
      Eigen::MatrixXd G = Eigen::MatrixXd::Zero(n, out_size);
      const double root = std::sqrt(options.acceleration_psd * dt);
      for (Eigen::Index i = 0; i < dims; ++i) {
        const auto at = static_cast<std::size_t>(i);
        F(i, dims + i) = dt;
        x[at] += dt * x[static_cast<std::size_t>(dims + i)];
        // G G' = psd [[dt³/3, dt²/2], [dt²/2, dt]]
        G(i, i) = root * dt / std::sqrt(3.0);
        G(dims + i, i) = root * std::sqrt(0.75);
        G(dims + i, dims + i) = 0.5 * root;
      }
      if (!bound.predict(F, G)) throw std::invalid_argument("times_s: the bound cannot be carried over a step");
    }
    detail::Kept kept;
    kept.t_s = t_s;
    const Eigen::Matrix3d& C = bearing.position_covariance_m2;
    const double az =
        bearing.sigma_azimuth_rad * bearing.sigma_azimuth_rad + bearing.heading_sigma_rad * bearing.heading_sigma_rad;
    kept.b.x = bearing.position_m[0];
    kept.b.y = bearing.position_m[1];
    kept.b.variance_azimuth = az;
    kept.b.xx = C(0, 0);
    kept.b.xy = C(0, 1);
    kept.b.yy = C(1, 1);
    if (dims == 3) {
      kept.b.z = bearing.position_m[2];
      kept.b.variance_elevation = bearing.sigma_elevation_rad * bearing.sigma_elevation_rad;
      kept.b.xz = C(0, 2);
      kept.b.yz = C(1, 2);
      kept.b.zz = C(2, 2);
    }
    // A locator leaves such a bearing out.
    bool good = bearing.sigma_azimuth_rad > 0.0 && bearing.heading_sigma_rad >= 0.0 &&
                (dims == 2 || bearing.sigma_elevation_rad > 0.0);
    for (Eigen::Index i = 0; i < dims; ++i) {
      for (Eigen::Index j = 0; j < dims; ++j) {
        good = good && C(i, i) >= 0.0 && C(i, j) * C(i, j) <= C(i, i) * C(j, j) * (1.0 + 1e-9);
      }
    }
    detail::Angles angles;
    if (good && detail::predict(layout, x, t_s, kept, angles)) {
      for (std::size_t row = 0; row + 1 < layout.dimensions; ++row) {
        if (!(angles.variance[row] > 0.0) || !std::isfinite(angles.variance[row])) continue;
        Eigen::MatrixXd H(1, n);
        for (Eigen::Index i = 0; i < n; ++i) H(0, i) = angles.gradient[row][static_cast<std::size_t>(i)];
        const Eigen::MatrixXd R = Eigen::MatrixXd::Constant(1, 1, angles.variance[row]);
        static_cast<void>(bound.update(H, R));
      }
    }
    out.push_back(bound.bound(1e-10).covariance.topLeftCorner(out_size, out_size));
  }
  return out;
}

}  // namespace soopnav::navigation
