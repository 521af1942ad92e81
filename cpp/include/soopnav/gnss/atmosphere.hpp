#pragma once

#include <array>

#include "soopnav/geometry/wgs84.hpp"

namespace soopnav::gnss {

/// Coefficients of the broadcast ionosphere (IS-GPS-200N table 20-X): amplitude and period of its daily cosine as
/// cubics of the geomagnetic latitude in semicircles.
struct Klobuchar {
  std::array<double, 4> alpha{};  ///< [s, s/semicircle, ...]
  std::array<double, 4> beta{};   ///< [s, s/semicircle, ...]

  /// Throws std::invalid_argument when a coefficient is not finite.
  void check() const;
};

/// Delay of L1 code in the ionosphere [m], positive; the carrier is advanced by as much. It takes away about half of
/// the true delay's rms (IS-GPS-200N figure 20-4). Azimuth from north towards east; `time_of_week_s` GPS time of the
/// reception. Elevations below 0 are taken as 0. No allocation.
[[nodiscard]] double ionosphere_delay_m(const Klobuchar& coefficients, const geometry::Geodetic& place,
                                        double azimuth_rad, double elevation_rad, double time_of_week_s) noexcept;

/// Delay of code and carrier in the troposphere [m], positive: Saastamoinen's zenith delays
/// 0.0022768 p / (1 - 0.00266 cos 2φ - 0.00028 h/km) and 0.0022768 (1255/T + 0.05) e, with pressure, temperature and
/// vapour of the standard atmosphere (15 °C and 1013.25 hPa at sea level, -6.5 K/km) at `relative_humidity` in [0, 1],
/// times Black and Eisner's mapping 1.001 / sqrt(0.002001 + sin² el). Zero above 40 km; heights below -1 km are taken
/// as -1 km, elevations below 0 as 0. No allocation.
[[nodiscard]] double troposphere_delay_m(const geometry::Geodetic& place, double elevation_rad,
                                         double relative_humidity = 0.7) noexcept;

}  // namespace soopnav::gnss
