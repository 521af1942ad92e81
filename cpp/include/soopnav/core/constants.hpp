#pragma once

#include <numbers>

/// Physical and geodetic constants, each with its source. SI units.
namespace soopnav {

/// Speed of light in vacuum [m/s], exact (SI; CGPM 1983 resolution 1).
inline constexpr double kSpeedOfLightMps = 299'792'458.0;

/// Boltzmann constant [J/K], exact (SI 2019).
inline constexpr double kBoltzmannJpk = 1.380649e-23;

/// Standard noise temperature T0 [K] (IEEE Std 100, noise figure reference).
inline constexpr double kStandardNoiseTemperatureK = 290.0;

/// Standard gravity g0 [m/s^2], exact (CGPM 1901); an IMU's "g", not the local gravity.
inline constexpr double kStandardGravityMps2 = 9.80665;

inline constexpr double kPi = std::numbers::pi;
inline constexpr double kTwoPi = 2.0 * std::numbers::pi;

/// WGS 84 ellipsoid and Earth model (NGA.STND.0036_1.0.0_WGS84, tables 3.1, 3.3 and 3.4).
namespace wgs84 {

inline constexpr double kSemiMajorAxisM = 6'378'137.0;                             ///< a, defining
inline constexpr double kFlattening = 1.0 / 298.257223563;                         ///< f, defining
inline constexpr double kGravitationalParameterM3ps2 = 3.986004418e14;             ///< GM, defining
inline constexpr double kEarthRateRadps = 7.292115e-5;                             ///< omega, defining
inline constexpr double kSemiMinorAxisM = kSemiMajorAxisM * (1.0 - kFlattening);   ///< b = a (1 - f)
inline constexpr double kEccentricitySquared = kFlattening * (2.0 - kFlattening);  ///< e^2 = f (2 - f)
inline constexpr double kSecondEccentricitySquared =                               ///< e'^2 = e^2 / (1 - e^2)
    kEccentricitySquared / ((1.0 - kFlattening) * (1.0 - kFlattening));

}  // namespace wgs84

}  // namespace soopnav
