#include "soopnav/gnss/receiver_differences.hpp"

#include <cmath>

#include "soopnav/core/constants.hpp"

namespace soopnav::gnss {

namespace {

// A satellite as the base antenna would see what a receiver read: direction and modelled pseudorange.
struct View {
  Eigen::Vector3d to_e = Eigen::Vector3d::Zero();
  double modelled_m = 0.0;
};

std::optional<View> view(const Ephemeris& ephemeris, const Epoch& clock, double code_m,
                         const Eigen::Vector3d& base_e) noexcept {
  const auto state = state_at_transmission(ephemeris, clock, code_m);
  if (!state) return std::nullopt;
  View out;
  out.to_e = state->position_e - base_e;
  // Twice: the Earth turns by 30 m under the first guess of the flight time, by nothing under the second.
  for (int i = 0; i < 2; ++i) {
    out.to_e = rotated_for_flight(state->position_e, out.to_e.norm() / kSpeedOfLightMps) - base_e;
  }
  out.modelled_m = out.to_e.norm() - kSpeedOfLightMps * state->clock_s;
  return out;
}

}  // namespace

std::optional<BaselineSatellite> difference_receivers(const EphemerisTable& ephemerides, const Epoch& base_clock,
                                                      const Epoch& rover_clock, const geometry::LocalFrame& base,
                                                      const ReceiverPair& pair, double wavelength_m) noexcept {
  const double sum = pair.base_code_m + pair.rover_code_m + pair.base_phase_cycles + pair.rover_phase_cycles;
  if (!std::isfinite(sum) || !(wavelength_m > 0.0)) return std::nullopt;
  const Ephemeris* ephemeris = ephemerides.find(pair.prn, base_clock);
  if (ephemeris == nullptr || ephemeris->health != 0) return std::nullopt;
  const auto at_base = view(*ephemeris, base_clock, pair.base_code_m, base.origin_ecef());
  const auto at_rover = view(*ephemeris, rover_clock, pair.rover_code_m, base.origin_ecef());
  if (!at_base || !at_rover) return std::nullopt;
  const double motion_m = at_rover->modelled_m - at_base->modelled_m;
  BaselineSatellite out;
  out.id = pair.prn;
  out.direction = base.velocity_from_ecef(at_base->to_e.normalized());
  out.code_m = pair.rover_code_m - pair.base_code_m - motion_m;
  out.phase_cycles = pair.rover_phase_cycles - pair.base_phase_cycles - motion_m / wavelength_m;
  out.lost_lock = pair.lost_lock;
  return out;
}

}  // namespace soopnav::gnss
