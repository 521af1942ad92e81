#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <limits>
#include <optional>
#include <string_view>

#include "soopnav/geometry/wgs84.hpp"

namespace soopnav::inertial {

/// What became of an alignment; the attitude is usable when it is `kAligned`.
enum class AlignmentStatus : std::uint8_t {
  kAligned,    ///< attitude and covariance are there
  kNoHeading,  ///< level is found, the gyros are too poor for a heading, and none was given
  /// The mean specific force is not gravity's within 5 %, or the mean rate is not the Earth's within six deviations of
  /// the gyros and 2 mrad/s.
  kNotAtRest,
  kNearPole,   ///< the Earth's rate has no horizontal part to find north by, and no heading was given
  kNonFinite,  ///< NaN or infinity among the numbers
};

/// A lower-case phrase for reports; "unknown" for a value that is no enumerator.
[[nodiscard]] constexpr std::string_view to_string(AlignmentStatus status) noexcept {
  switch (status) {
    case AlignmentStatus::kAligned:
      return "aligned";
    case AlignmentStatus::kNoHeading:
      return "no heading";
    case AlignmentStatus::kNotAtRest:
      return "not at rest";
    case AlignmentStatus::kNearPole:
      return "near a pole";
    case AlignmentStatus::kNonFinite:
      return "not finite";
  }
  return "unknown";
}

/// A heading from elsewhere (a compass, two antennas).
struct GivenHeading {
  double heading_rad = 0.0;  ///< of the body's first axis, clockwise from true north
  double sigma_rad = 0.0;    ///< its standard deviation
};

/// What the unit's own errors are, the same in each axis.
struct AlignmentErrors {
  double gyro_bias_sigma_radps = 0.0;
  double accelerometer_bias_sigma_mps2 = 0.0;
  double gyro_density = 0.0;           ///< [rad/s/sqrt(Hz)]
  double accelerometer_density = 0.0;  ///< [m/s²/sqrt(Hz)]
  /// A gyrocompass heading less certain than this is not used.
  double max_heading_sigma_rad = 0.0872664625997165;
};

/// Attitude of a body at rest.
///
/// Errors are in the body's axes, truth = q_n_b exp(d), as a `StrapdownState` has them. Biases are taken as zero: a
/// filter that begins with zero biases and these covariances knows that tilt and accelerometer bias belong together.
struct Alignment {
  AlignmentStatus status = AlignmentStatus::kNonFinite;
  Eigen::Quaterniond q_n_b = Eigen::Quaterniond::Identity();           ///< body to north-east-down
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();                ///< of d [rad²]
  Eigen::Matrix3d cross_gyro_bias = Eigen::Matrix3d::Zero();           ///< E[d b_gᵀ] [rad²/s]
  Eigen::Matrix3d cross_accelerometer_bias = Eigen::Matrix3d::Zero();  ///< E[d b_aᵀ] [rad m/s²]
  bool gyrocompass = false;                                            ///< the heading is the gyros' own
  double heading_sigma_rad = std::numeric_limits<double>::infinity();
};

/// Level from the mean specific force, heading from the mean rate (gyrocompass) or from `heading`.
///
/// Model:   f_b = -C_b_n g_n + b_a + n,  w_b = C_b_n w_ie_n + b_g + n, means over `duration_s`; tilt errors are b / g,
///          heading errors b_E / (w_ie cos(lat)) + tan(lat) tilt_N                          (doc/strapdown.md eq.
///          35-38)
/// Of the gyros' heading and a given one the surer is used. Body axes may lie any way but with the first one upright,
/// where a given heading means nothing (kNoHeading). Throws std::invalid_argument for a duration that is not positive,
/// errors that are negative or not finite, a place that is not finite. No allocation.
[[nodiscard]] Alignment static_alignment(const Eigen::Vector3d& mean_force_b_mps2,
                                         const Eigen::Vector3d& mean_rate_b_radps, double duration_s,
                                         const geometry::Geodetic& place, const AlignmentErrors& errors,
                                         const std::optional<GivenHeading>& heading = std::nullopt);

}  // namespace soopnav::inertial
