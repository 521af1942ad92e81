#pragma once

#include <Eigen/Core>
#include <cmath>
#include <complex>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/simulation/ofdm_link.hpp"

namespace soopnav::simulation {

/// Something that reflects, each time with another strength: a water tower (crosby section 3.7).
///
/// Model:   gain = X1 + j X2 relative to the line of sight, X1 normal about `mean`, X2 about 0, both of `variance`: its
///          magnitude is Ricean (crosby 3.13), its phase random.
struct RiceanReflector {
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
  double mean = 0.33;
  double variance = 0.0625;

  /// The second ray from `transmitter_m` to each of the places by way of the reflector: |p - r| + |r - q| - |p - q|
  /// longer, its gain drawn from `random`. Allocates the result.
  /// @throws std::invalid_argument for a mean or variance that is not finite, or a negative variance.
  [[nodiscard]] std::vector<Reflection> reflections(std::span<const Eigen::Vector3d> receivers_m,
                                                    const Eigen::Vector3d& transmitter_m, RandomStream random) const {
    if (!std::isfinite(mean)) throw std::invalid_argument("mean = " + std::to_string(mean) + ": a number expected");
    if (!(variance >= 0.0) || std::isinf(variance)) {
      throw std::invalid_argument("variance = " + std::to_string(variance) + ": zero or more expected");
    }
    const double sigma = std::sqrt(variance);
    const double from_source = (position_m - transmitter_m).norm();
    std::vector<Reflection> out;
    out.reserve(receivers_m.size());
    for (const Eigen::Vector3d& p : receivers_m) {
      const double in_phase = random.normal(mean, sigma);
      const double quadrature = random.normal(0.0, sigma);
      out.push_back({(p - position_m).norm() + from_source - (p - transmitter_m).norm(), {in_phase, quadrature}});
    }
    return out;
  }
};

}  // namespace soopnav::simulation
