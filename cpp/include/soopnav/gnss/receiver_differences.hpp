#pragma once

#include <limits>
#include <optional>

#include "soopnav/core/epoch.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/gnss/baseline.hpp"
#include "soopnav/gnss/ephemeris.hpp"

namespace soopnav::gnss {

/// What two receivers read of one GPS satellite at the same epoch. NaN: nothing.
struct ReceiverPair {
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  int prn = 0;
  double base_code_m = kNan, rover_code_m = kNan;              ///< pseudoranges
  double base_phase_cycles = kNan, rover_phase_cycles = kNan;  ///< carrier phases, growing with range
  bool lost_lock = false;                                      ///< of either
};

/// Rover minus base of one satellite, as `BaselineSolver` wants it (doc/attitude.md eq. 7).
///
/// The receivers' clocks differ, so they read the satellite at two instants: what its motion adds, up to 0.8 m for
/// each millisecond, is computed from its orbit as seen from the base and taken off, as is its own clock's drift.
/// `base_clock`, `rover_clock`: what their clocks show, GPS time. `base`: east-north-up at the base antenna, which a
/// few metres of error do not harm. None when a reading is missing or not finite, without an ephemeris in time, or when
/// the satellite is unhealthy. No allocation, 1 us.
[[nodiscard]] std::optional<BaselineSatellite> difference_receivers(const EphemerisTable& ephemerides,
                                                                    const Epoch& base_clock, const Epoch& rover_clock,
                                                                    const geometry::LocalFrame& base,
                                                                    const ReceiverPair& pair,
                                                                    double wavelength_m) noexcept;

}  // namespace soopnav::gnss
