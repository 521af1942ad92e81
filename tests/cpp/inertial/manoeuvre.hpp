#pragma once

#include <Eigen/Core>
#include <vector>

#include "soopnav/core/angle.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/simulation/spatial_trajectory.hpp"

namespace soopnav::test {

inline const geometry::Geodetic kHome{radians(48.1), radians(11.6), 520.0};

/// A minute and more of corners, climbs and rolling at 15 m/s, through the origin's surroundings.
inline simulation::SpatialTrajectory manoeuvre(geometry::LocalAxes axes = geometry::LocalAxes::kNed) {
  std::vector<Eigen::Vector3d> waypoints{{0, 0, 0},    {150, 20, -5},  {230, 140, -12},  {140, 260, 0}, {-20, 240, 10},
                                         {-60, 80, 0}, {80, -60, -20}, {240, -120, -10}, {400, 0, 0}};
  if (axes == geometry::LocalAxes::kEnu) {
    for (Eigen::Vector3d& w : waypoints) w = geometry::swap_enu_ned(w);
  }
  return simulation::SpatialTrajectory::through(geometry::LocalFrame(kHome, axes), waypoints,
                                                {.speed_mps = 15.0, .max_acceleration_mps2 = 4.0},
                                                {.roll = {0.05, 0.7, 0.2}, .pitch = {0.03, 1.1, 1.0}});
}

}  // namespace soopnav::test
