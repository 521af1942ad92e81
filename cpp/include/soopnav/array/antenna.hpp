#pragma once

#include <complex>
#include <cstdint>

#include "soopnav/array/types.hpp"

namespace soopnav::array {

/// A polarisation on the Poincare sphere [rad].
struct Polarization {
  double tilt_rad = 0.0;  ///< psi of the ellipse's major axis; longitude is 2 psi
  double ellipticity_rad =
      0.0;  ///< chi, -pi/4 (right circular) .. 0 (linear) .. pi/4 (left circular); latitude is 2 chi
};

/// p of carter (4.8): the share of the power that an antenna polarised as `b` takes from a wave polarised as `a`.
///
/// Model: p = cos^2(gamma / 2), gamma the angle between the two points of the Poincare sphere. 1 for equal, 0 for
/// opposite ones, 1/2 for linear against circular. NaN in gives NaN.
[[nodiscard]] double polarization_factor(const Polarization& a, const Polarization& b) noexcept;

/// q of carter (4.8): 1 - |Gamma|^2 with Gamma = (Z_load - conj Z_antenna) / (Z_load + Z_antenna) [ohm].
/// @throws std::invalid_argument for a negative or non-finite resistance, or when both resistances are 0.
[[nodiscard]] double impedance_factor(Cf64 antenna_ohm, Cf64 load_ohm);

/// Received power, carter (4.8): p q P_T G_T G_R (c / (4 pi d f))^2 [dBm].
/// @throws std::invalid_argument for a distance or frequency that is not positive, or a factor outside 0 .. 1.
[[nodiscard]] double received_power_dbm(double transmit_power_dbm, double transmit_gain_db, double receive_gain_db,
                                        double distance_m, double frequency_hz, double polarization = 1.0,
                                        double impedance = 1.0);

enum class FieldRegion : std::uint8_t {
  kNear,      ///< below one of the limits: waves are not plane, bearings are wrong
  kMarginal,  ///< beyond all three but not far beyond those that (4.1) and (4.3) write with ">>"
  kFar,       ///< beyond (4.2), and ten times beyond the others
};

/// carter (4.1) to (4.3): beyond which distance of the source its waves are plane for an array.
struct FarField {
  double radiating_m = 0.0;                                            ///< (4.1): r >> 1.6 lambda
  double phase_m = 0.0;                                                ///< (4.2): r > 2 D^2 / lambda
  double amplitude_m = 0.0;                                            ///< (4.3): r >> 5 D
  [[nodiscard]] double limit_m() const noexcept;                       ///< the greatest of the three
  [[nodiscard]] FieldRegion region(double distance_m) const noexcept;  ///< NaN is near
};

/// @param aperture_m D, greatest distance of two elements. @throws std::invalid_argument unless both are positive.
[[nodiscard]] FarField far_field(double aperture_m, double wavelength_m);

}  // namespace soopnav::array
