#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/vision/camera.hpp"
#include "soopnav/vision/ground_plane.hpp"
#include "soopnav/vision/planar_motion.hpp"

namespace soopnav::vision {

struct RigidMotionOptions {
  double min_sigma_px = 0.01;      ///< the covariance never stands for less
  double inlier_px = 1.0;          ///< a track that misses the motion by less agrees with it [pixel]
  int min_tracks = 8;              ///< that agree
  double min_share = 0.25;         ///< of the tracks on the ground that must agree
  int max_hypotheses = 200;        ///< fewer where many agree
  double confidence = 0.9999;      ///< that one hypothesis was free of outliers
  double height_sigmas = 6.0;      ///< gate of the height check, in sigma of the difference
  double height_tolerance = 0.01;  ///< added to that gate: what calibration leaves
  double track_inflation = 1.0;    ///< of the tracks' covariance, for what neighbouring tracks share
  std::uint64_t seed = 0;
};

/// {dx, dy, da_z} from feature tracks over the ground.
///
/// Model: f' = R(da_z) f + [dx dy], f' and f the ground points of a track in the previous and the present body
///        (doc/ego_motion.md eq. 12; nielsen 4.2.2 has the inverse). Two-point hypotheses from the object's own random
///        stream in metres, residuals compared in pixels through the projection; Gauss-Newton on those that agree,
///        weighted by (J J^T)^-1, J metres on the ground per pixel, so that far points count less.
/// Covariance: the tracks' from the residuals (not below `min_sigma_px`), plus both planes' (eq. 15-17).
/// Height: the four-number fit C, S, dx, dy of nielsen as a check against the planes (eq. 18-20).
///
/// Cost: 300 tracks about 0.1 ms. Memory grows with the largest set seen; nothing is allocated for one that is not
/// larger. One object serves one thread at a time; the same sequence of calls gives the same bits.
class RigidMotionEstimator {
 public:
  /// @throws std::invalid_argument for a sigma, gate, share, number or confidence out of range.
  explicit RigidMotionEstimator(const RigidMotionOptions& options = {});

  /// Room for that many tracks, so that the first call allocates nothing either.
  void reserve(std::size_t tracks);

  /// Pixels of the same features in the previous and in the present frame, and the ground of both frames in axes of
  /// this camera. `inliers`: empty, or one flag per track that is set to 1 where it agrees with the motion. A pair with
  /// a number that is not finite is not used. Spans of different lengths: the shorter one counts. Never throws but for
  /// lack of memory.
  [[nodiscard]] PlanarMotion estimate(const Camera& camera, std::span<const Eigen::Vector2d> previous_px,
                                      std::span<const Eigen::Vector2d> present_px, const GroundPlane& previous,
                                      const GroundPlane& present, std::span<std::uint8_t> inliers = {});

  [[nodiscard]] const RigidMotionOptions& options() const noexcept { return options_; }

 private:
  struct Track {
    Eigen::Vector2d from;                    // ground point in the previous body [m]
    Eigen::Vector2d to;                      // in the present body [m]
    Eigen::Matrix2d per_px;                  // of `to` by its pixel [m]
    Eigen::Matrix2d pixels;                  // inverse of per_px
    Eigen::Matrix<double, 2, 3> from_plane;  // by the previous plane
    Eigen::Matrix<double, 2, 3> to_plane;    // by the present plane
    std::size_t index;
    bool inlier;
  };
  [[nodiscard]] int count(const Eigen::Vector3d& motion, double scale, double gate_px, bool mark) noexcept;
  [[nodiscard]] int search(bool any_scale, Eigen::Vector3d& motion, double& scale) noexcept;
  [[nodiscard]] MotionStatus why_none(double ratio_plane, PlanarMotion& out) noexcept;
  [[nodiscard]] bool refine(Eigen::Vector3d& motion, Eigen::Matrix3d& information, double& square_px) const noexcept;
  void add_planes(const Eigen::Matrix3d& information, const GroundPlane& previous, const GroundPlane& present,
                  PlanarMotion& out) const noexcept;
  void check_height(const GroundPlane& previous, const GroundPlane& present, PlanarMotion& out) const noexcept;

  RigidMotionOptions options_;
  RandomStream random_;
  std::vector<Track> tracks_;
};

}  // namespace soopnav::vision
