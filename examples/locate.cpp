// A position from the times of arrival at five base stations, one of which is heard only round a corner.
#include <array>
#include <cstdio>

#include "soopnav/navigation/position_fix.hpp"

namespace navigation = soopnav::navigation;

int main() {
  constexpr double kSpeedOfLightMps = 299'792'458.0;
  const Eigen::Vector3d receiver_m(180.0, -120.0, 1.5);  // east, north, up
  constexpr double kClockBiasS = -3.2e-3;
  constexpr double kSigmaS = 10e-9;

  std::array<navigation::Node, 5> nodes;
  nodes[0].position_m = {150.0, 620.0, 35.0};
  nodes[1].position_m = {900.0, -250.0, 28.0};
  nodes[2].position_m = {-700.0, 500.0, 42.0};
  nodes[3].position_m = {-450.0, -900.0, 30.0};
  nodes[4].position_m = {1100.0, 900.0, 38.0};

  std::array<double, 5> toas_s{}, sigmas_s{};
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const double late_s = i == 4 ? 153e-9 : 0.0;  // 46 m round the corner
    toas_s[i] = (nodes[i].position_m - receiver_m).norm() / kSpeedOfLightMps + kClockBiasS + late_s;
    sigmas_s[i] = kSigmaS;
  }

  const auto fix = navigation::position_fix(
      nodes, toas_s, sigmas_s, {.dimension = navigation::FixDimension::kPlanar, .height_m = receiver_m.z()});
  std::printf("%s\n%.2f m east, %.2f m north, clock %.1f ns, HDOP %.2f\n", fix.message().c_str(), fix.position_m.x(),
              fix.position_m.y(), fix.clock_bias_s * 1e9, fix.dop.hdop);
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    if (!fix.used(i))
      std::printf("rejected: node %zu (residual %.0f m, gate %.0f m)\n", i, fix.residuals_m[i], fix.gates_m[i]);
  }
  const bool right = fix.status == navigation::FixStatus::kConverged && fix.used_count() == 4 && !fix.used(4) &&
                     (fix.position_m - receiver_m).norm() < 1e-3;
  return right ? 0 : 1;
}
