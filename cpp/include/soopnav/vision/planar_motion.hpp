#pragma once

#include <Eigen/Core>
#include <cstdint>

namespace soopnav::vision {

/// What became of an increment of the camera's motion.
enum class MotionStatus : std::uint8_t {
  kMeasured,            ///< the only one whose increment holds
  kFirst,               ///< nothing to compare with yet
  kBadImage,            ///< black, flat or saturated: nothing can be tracked in it
  kBadTime,             ///< the time stamp does not come after the previous one
  kNoPlane,             ///< no ground in one of the two frames
  kTooFewTracks,        ///< fewer tracks that hit the ground than are needed
  kNoConsensus,         ///< no motion that enough tracks agree with
  kDegenerate,          ///< the tracks lie in one place: the turn is not determined
  kHeightDisagreement,  ///< tracks and planes tell different changes of height
  kRepeated,            ///< the previous frame once more: no information, no interval
  kCoasted              ///< nothing measured for long: `increment` is what the last velocity leads to expect
};

/// "measured", "too few tracks" and so on.
[[nodiscard]] const char* name(MotionStatus status) noexcept;

/// Motion of a camera over the ground between two frames, as it enters a filter.
struct PlanarMotion {
  MotionStatus status = MotionStatus::kFirst;
  /// {dx, dy, da_z} [m, m, rad]: displacement in axes of the PREVIOUS body, turn counterclockwise seen from above; what
  /// measurement::PlanarIncrement predicts. Zero unless measured.
  Eigen::Vector3d increment = Eigen::Vector3d::Zero();
  /// Of this increment alone, everything included: `track_covariance` + what the planes of both frames add.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  /// The part that is independent from increment to increment: the tracks'.
  Eigen::Matrix3d track_covariance = Eigen::Matrix3d::Zero();
  /// Noise of the point below the camera (its foot) from the plane of the previous frame and from that of this one
  /// [m^2], each in the axes of its own body; d^2 C_normal and a little more (doc/ego_motion.md eq. 17). The foot error
  /// of a frame enters two increments with opposite signs: over a walk all but the first and the last cancel.
  Eigen::Matrix2d foot_covariance_previous = Eigen::Matrix2d::Zero();
  Eigen::Matrix2d foot_covariance = Eigen::Matrix2d::Zero();
  double height_m = 0.0;            ///< of the camera above the ground in this frame: the plane's
  double height_ratio = 1.0;        ///< h_t / h_(t-1) by the tracks alone (doc/ego_motion.md eq. 20)
  double height_ratio_plane = 1.0;  ///< the same by the planes
  double height_ratio_sigma = 0.0;  ///< of the difference of the two
  int tracks = 0;                   ///< pairs offered
  int used = 0;                     ///< of them, those whose two rays hit the ground
  int inliers = 0;                  ///< of those, the ones that agree with the motion
  double sigma_px = 0.0;            ///< noise of a track in this frame that the covariance stands for [pixel]
  double rms_px = 0.0;              ///< of the inliers' residuals, per axis [pixel]
  double t_s = 0.0;                 ///< time of this frame
  /// Interval that `increment` covers, ending at t_s [s]; 0 where it covers none, and then a later increment covers
  /// more. Those of all steps follow one another without gap.
  double dt_s = 0.0;
  int skipped = 0;           ///< frames within dt_s that gave no increment
  double rival_share = 0.0;  ///< of the tracks used, those that agree with another motion than the one given

  [[nodiscard]] bool ok() const noexcept { return status == MotionStatus::kMeasured; }
};

}  // namespace soopnav::vision
