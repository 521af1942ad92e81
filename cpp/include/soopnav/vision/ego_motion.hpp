#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "soopnav/vision/camera.hpp"
#include "soopnav/vision/feature_tracker.hpp"
#include "soopnav/vision/ground_plane.hpp"
#include "soopnav/vision/planar_motion.hpp"
#include "soopnav/vision/rigid_motion.hpp"

namespace soopnav::vision {

struct EgoMotionOptions {
  FeatureTrackerOptions tracker;
  PlaneOptions plane;  ///< of the ground from depth points
  /// Of the motion from tracks. Patches that overlap, and what lighting leaves, share errors: their covariance is
  /// inflated 1.3 times, which holds the NEES per number between 0.7 and 1.5 (doc/feature_tracks.md).
  RigidMotionOptions rigid = inflated();
  /// Origin of the depth camera in axes of the image's camera [m], whose axes it shares: nielsen's IR beside RGB.
  Eigen::Vector3d depth_offset_m = Eigen::Vector3d::Zero();
  int min_age = 2;         ///< frames a track must have lived before it counts, where enough have (nielsen §4.2.2)
  int outlier_frames = 3;  ///< disagreements in a row after which a track is given up
  double max_gap_s = 0.5;  ///< without an increment; longer and it coasts
  double acceleration_mps2 = 2.0;  ///< 1 sigma while coasting
  double speed_mps = 1.5;          ///< 1 sigma of the speed after long
  double turn_rate_radps = 1.0;    ///< likewise of the turn
  double coast_s = 1.0;            ///< the last velocity is forgotten with this time constant
  /// A motion that a large minority of tracks agrees with is taken instead of the majority's, where it differs from the
  /// expected one by less than `surprise_mps` (over the interval) and the majority's by more: a floor that starts to
  /// move.
  double surprise_mps = 0.5;
  double rival_share = 0.2;  ///< of the tracks, from which on a second motion is looked for

  [[nodiscard]] static RigidMotionOptions inflated() {
    RigidMotionOptions options;
    options.track_inflation = 1.3;
    return options;
  }
};

/// Motion of a camera over the ground from its images and the ground plane (nielsen §4.1-4.2): corners followed, rays
/// met with the tilted ground of both frames, {dx, dy, da_z} with a covariance.
///
/// Each step: plane (from depth points, or given), places where the tracks are expected by the last velocity and both
/// planes, tracks, rigid motion between the last frame that had an increment (the anchor) and this one. A frame without
/// one - dark, saturated, no ground, no consensus, heights that disagree - says why, with dt_s = 0; the next increment
/// then covers the whole interval from the anchor, and is flagged by `skipped`. After `max_gap_s` it coasts: what the
/// last velocity leads to expect, which decays, with a covariance that grows (doc/feature_tracks.md eq. 7-8). The
/// increments of all steps with dt_s > 0 follow one another without gap.
///
/// What cannot be told: a floor that moves as one with most of the tracks on it is taken for the ground, unless a
/// minority still moves as expected; then `rival_share` says so. Its height change is checked against the planes.
///
/// The same frames give the same bits. Data never throw. Cost: 640 x 480, 300 tracks, 30 000 points about 10 ms.
class EgoMotion {
 public:
  /// Throws std::invalid_argument for an option out of its range, naming it, and std::runtime_error without OpenCV.
  explicit EgoMotion(const Camera& camera, const EgoMotionOptions& options = {});

  /// The next frame: grey image of the camera's size, its time, and the ground in axes of this camera. An image of
  /// another size is kBadImage; a time that is not finite or before the last one kBadTime; the last one's time
  /// kRepeated. A time more than 100 `max_gap_s` before or after the last one is kBadTime as well, and is forgotten,
  /// unless it is the third such in a row and they rise: then the clock was set. After a set-back all starts anew
  /// (kFirst), else the interval is coasted over.
  PlanarMotion step(const ImageView& image, double t_s, const GroundPlane& plane) noexcept;

  /// With the ground from points of the depth camera (x, y, z one after the other, its axes, `depth_offset_m`) [m].
  PlanarMotion step(const ImageView& image, double t_s, std::span<const float> points) noexcept;

  /// Forgets every frame.
  void reset() noexcept;

  [[nodiscard]] const Camera& camera() const noexcept { return camera_; }
  [[nodiscard]] const EgoMotionOptions& options() const noexcept { return options_; }
  /// What the tracker said of the last frame.
  [[nodiscard]] const TrackedFrame& frame() const noexcept { return frame_; }
  /// Ground of the last frame, in axes of this camera.
  [[nodiscard]] const GroundPlane& plane() const noexcept { return plane_; }
  /// Tracks on the last frame, and which of them the increment was fitted to; valid until the next step.
  [[nodiscard]] std::span<const FeatureTrack> tracks() const noexcept { return tracker_.tracks(); }
  [[nodiscard]] std::span<const std::uint8_t> inliers() const noexcept { return agrees_; }

 private:
  struct Named {
    std::uint64_t id;
    Eigen::Vector2d pixel;
    int outlier;  // disagreements in a row
  };
  [[nodiscard]] bool believe(double t_s) noexcept;
  [[nodiscard]] Eigen::Vector3d expected(double dt_s) const noexcept;
  void predict(double dt_s);
  void pair_up();
  [[nodiscard]] PlanarMotion measure();
  [[nodiscard]] PlanarMotion prefer(const PlanarMotion& majority);
  void mark_tracks();
  void anchor();
  [[nodiscard]] PlanarMotion coast();
  [[nodiscard]] PlanarMotion without(MotionStatus why);

  Camera camera_;
  EgoMotionOptions options_;
  FeatureTracker tracker_;
  PlaneFitter fitter_;
  RigidMotionEstimator rigid_;
  TrackedFrame frame_;
  GroundPlane plane_;

  double t_s_ = 0.0;
  bool started_ = false;
  int doubted_ = 0;             // frames in a row whose times are far away and rise
  double doubted_t_s_ = 0.0;    // of the last of them
  double reference_t_s_ = 0.0;  // of the frame the tracker compares with
  GroundPlane reference_plane_;
  bool anchored_ = false;
  double anchor_t_s_ = 0.0;
  GroundPlane anchor_plane_;
  std::vector<Named> anchor_tracks_;
  int skipped_ = 0;
  bool moving_ = false;  // velocity_ is known
  Eigen::Vector3d velocity_ = Eigen::Vector3d::Zero();
  double measured_t_s_ = 0.0;  // of the last measured increment

  std::vector<Eigen::Vector2d> predicted_;
  std::vector<Eigen::Vector2d> from_, to_;
  std::vector<std::size_t> which_;  // track of each pair
  std::vector<std::uint8_t> fits_, fits_rival_, agrees_, keep_;
  std::vector<Eigen::Vector2d> from_rival_, to_rival_;
  std::vector<std::size_t> which_rival_;
};

}  // namespace soopnav::vision
