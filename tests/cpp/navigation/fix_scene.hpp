#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/navigation/position_fix.hpp"

namespace soopnav::test {

/// Base stations, a receiver and its clock, and the times of arrival they make.
struct Scene {
  std::vector<navigation::Node> nodes;
  Eigen::Vector3d receiver_m = Eigen::Vector3d(100.0, -50.0, 1.5);
  double clock_bias_s = -412.7e-9;
  double period_s = 10e-3;
  double sigma_s = 10e-9;

  Scene() = default;
  explicit Scene(const std::vector<Eigen::Vector3d>& positions) {
    for (const auto& p : positions) nodes.push_back({.position_m = p});
  }

  [[nodiscard]] std::vector<double> toas_s() const {
    std::vector<double> out;
    for (const auto& node : nodes) {
      const double t = (node.position_m - receiver_m).norm() / kSpeedOfLightMps + clock_bias_s + node.clock_offset_s;
      out.push_back(std::isfinite(period_s) ? t - period_s * std::floor(t / period_s) : t);
    }
    return out;
  }
  [[nodiscard]] std::vector<double> sigmas_s() const { return std::vector<double>(nodes.size(), sigma_s); }

  [[nodiscard]] navigation::PositionFix fix(const navigation::PositionFixOptions& options = {}) const {
    return navigation::position_fix(nodes, toas_s(), sigmas_s(), options);
  }
};

/// Five masts of a town, two to four kilometres across, 20 to 120 m high.
inline std::vector<Eigen::Vector3d> town() {
  return {{1000, 0, 30}, {-800, 900, 120}, {-500, -900, 40}, {300, 1500, 20}, {0, -2000, 90}};
}

inline navigation::PositionFixOptions planar(double height_m) {
  return {.dimension = navigation::FixDimension::kPlanar, .height_m = height_m};
}

}  // namespace soopnav::test
