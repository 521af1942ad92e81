#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/random.hpp"

namespace soopnav::vision {

/// What became of a plane fit.
enum class PlaneStatus : std::uint8_t {
  kNone,       ///< nothing was fitted
  kFitted,     ///< the only one whose numbers are the ground's
  kTooFew,     ///< fewer finite points than `PlaneOptions::min_points`
  kNoPlane,    ///< no plane holds `PlaneOptions::min_share` of the points
  kWall,       ///< the plane found leans more than `max_tilt_rad` against the optical axis
  kHeight,     ///< the plane found is nearer or farther than `min_height_m` ... `max_height_m`
  kDegenerate  ///< the points lie on a line or in one place
};

/// "fitted", "too few points" and so on.
[[nodiscard]] const char* name(PlaneStatus status) noexcept;

/// The ground as a camera sees it:  n . p = d  (doc/ego_motion.md eq. 1; nielsen 4.1).
///
/// Frame: OpenCV's camera frame c, right-handed: x right, y down the image, z along the optical axis [m]. n points from
///        the camera into the ground, so n_z > 0, and d > 0 is the camera's height above it. nielsen's [A B C D] is
///        [n_x, -n_y, n_z, -d]: its y runs up the image.
struct GroundPlane {
  PlaneStatus status = PlaneStatus::kNone;
  Eigen::Vector3d normal_c = Eigen::Vector3d::UnitZ();  ///< n, a unit vector
  double distance_m = 0.0;                              ///< d
  /// Of [eta_1, eta_2, d], [rad, rad, m]: n turns by eta_1 b_1 + eta_2 b_2, where b_1, b_2 are the body's first two
  /// axes (`body_axes`). Zero: a plane that is known.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  int points = 0;      ///< finite ones
  int inliers = 0;     ///< those the numbers come from
  double rms_m = 0.0;  ///< of the inliers' distances from the plane

  [[nodiscard]] bool ok() const noexcept { return status == PlaneStatus::kFitted; }

  /// A known plane, without uncertainty. @throws std::invalid_argument unless 0 < n_z, 0 < d and all are finite; n is
  /// normalised.
  [[nodiscard]] static GroundPlane known(const Eigen::Vector3d& normal_c, double distance_m,
                                         const Eigen::Matrix3d& covariance = Eigen::Matrix3d::Zero());

  /// The same ground seen from another camera at `camera_p_c` of this one [m], whose axes are the rows of `turn` here:
  /// p' = turn (p - camera_p_c). Covariance included (doc/ego_motion.md eq. 6). nielsen's D -> D + A D_cam is
  /// `seen_from({D_cam, 0, 0})`. A plane that is not ok comes back as it is; where n'_z or d' would not be positive the
  /// status is kWall or kHeight.
  [[nodiscard]] GroundPlane seen_from(const Eigen::Vector3d& camera_p_c,
                                      const Eigen::Matrix3d& turn = Eigen::Matrix3d::Identity()) const noexcept;
};

/// Axes of the body on the ground as rows, in camera axes (doc/ego_motion.md eq. 2): b_1 the camera's x axis projected
/// on the ground, b_2 = b_3 x b_1 (minus camera y, up the image), b_3 = -n up. Takes a unit n with n_z > 0.
[[nodiscard]] Eigen::Matrix3d body_axes(const Eigen::Vector3d& normal_c) noexcept;

enum class PlaneMethod : std::uint8_t {
  kRansac,  ///< robust: seeded hypotheses, then refits to the points inside the sensor's band
  kSvd      ///< nielsen 4.1: right singular vector of [x y z 1] over all points; one outlier pulls it
};

struct PlaneOptions {
  PlaneMethod method = PlaneMethod::kRansac;
  /// Standard deviation of the sensor's depth, sigma(z) = a + b z^2: structured light.
  double sigma_m = 0.0005;      ///< a [m]
  double sigma_per_m = 0.0014;  ///< b [1/m]
  double band_sigmas = 3.0;     ///< points nearer to the plane than this many sigma(z) are on it
  double band_m = 0.0;  ///< positive: a fixed band in its place, for surfaces that are flat to less than sigma(z) says
  double min_share = 0.2;        ///< of the finite points that must be on the ground
  int min_points = 50;           ///< finite ones
  double max_tilt_rad = 0.7854;  ///< of the normal against the optical axis; more is a wall
  double min_height_m = 0.05;    ///< of the camera above the plane
  double max_height_m = 10.0;    ///< likewise
  int max_hypotheses = 400;      ///< fewer where many points agree
  double confidence = 0.9999;    ///< that one hypothesis was free of outliers
  double noise_cluster = 1.0;    ///< neighbouring points that share one error: the covariance grows by this factor
  std::uint64_t seed = 0;
};

/// Plane of the ground from a depth cloud.
///
/// kRansac: three-point hypotheses from the object's own random stream are scored on a subset of 512 points, the better
/// ones refitted there, and the best is refitted to all points inside the band: smallest eigenvector of their weighted
/// 3 x 3 covariance, weight (z / sigma(z))^2 at the depth z where the ray meets the plane, iterated. Of planes that
/// lean or are too far to be the ground none is taken while another holds `min_share` (doc/ego_motion.md eq. 3-5).
///
/// Covariance: from the normal equations of the final refit, scaled by the residuals, times `noise_cluster`. It knows
/// nothing of errors that a sensor makes alike everywhere (scale, calibration).
///
/// Cost: 30 000 points below 1.5 ms on one core. Memory grows with the largest cloud seen; nothing is allocated for
/// one that is not larger. One object serves one thread at a time; the same sequence of clouds gives the same bits.
class PlaneFitter {
 public:
  /// @throws std::invalid_argument for a sigma, band, share, tilt, height, number or confidence out of range.
  explicit PlaneFitter(const PlaneOptions& options = {});

  /// Room for clouds of `points`, so that the first fit allocates nothing either.
  void reserve(std::size_t points);

  /// `xyz`: points one after the other, in camera axes [m]. Points that are not finite or not in front (z <= 0) are
  /// skipped; a rest of fewer than three numbers at the end is ignored. Never throws but for lack of memory.
  [[nodiscard]] GroundPlane fit(std::span<const float> xyz);

  [[nodiscard]] const PlaneOptions& options() const noexcept { return options_; }

 private:
  struct Moments;
  struct Rows;
  [[nodiscard]] std::size_t load(std::span<const float> xyz);
  [[nodiscard]] Rows draw_subset(std::size_t points);
  [[nodiscard]] PlaneStatus search(const Rows& subset, GroundPlane& plane);
  void solve(const Moments& moments, GroundPlane& plane) const noexcept;
  void solve_svd(const Rows& all, GroundPlane& plane) const noexcept;
  void state_covariance(const Moments& moments, GroundPlane& plane) const noexcept;
  [[nodiscard]] PlaneStatus plausible(const GroundPlane& plane) const noexcept;

  PlaneOptions options_;
  RandomStream random_;
  std::vector<float> cloud_;   // rows x, y, z, z / sigma(z), each padded to whole packets
  std::vector<float> subset_;  // likewise, of a few points
  std::size_t row_ = 0;        // floats in a row of cloud_
};

}  // namespace soopnav::vision
