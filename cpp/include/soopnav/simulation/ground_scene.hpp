#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/vision/camera.hpp"
#include "soopnav/vision/ground_plane.hpp"
#include "soopnav/vision/ground_projection.hpp"

namespace soopnav::simulation {

/// Where a camera is above the ground and how it leans.
struct CameraView {
  vision::GroundPose pose;  ///< of the body: foot below the camera, heading of its first axis
  double height_m = 1.0;
  vision::TiltAngles tilt;
};

/// The ground as the camera at `view` sees it, known exactly.
[[nodiscard]] vision::GroundPlane true_plane(const CameraView& view);

/// A flat textured rectangle that is not part of the ground: a box's top, a sheet that slides, somebody's shoulders.
struct GroundObject {
  vision::GroundPose pose;  ///< its centre and axes in the ground frame
  double length_m = 0.5;    ///< along its first axis
  double width_m = 0.5;
  double height_m = 0.0;  ///< above the ground; must be below the camera to be seen
  double brightness = 1.0;
  double texture_shift_m = 0.37;  ///< its texture is the ground's from elsewhere
};

/// A vertical wall through (x, y) that runs across `heading_rad`; both sides are seen.
struct GroundWall {
  double x_m = 0.0;
  double y_m = 0.0;
  double heading_rad = 0.0;  ///< of its normal
};

struct GroundTextureOptions {
  int size = 2048;         ///< texels along a side, a power of two in 64 ... 8192; the texture repeats
  double texel_m = 0.001;  ///< one texel on the ground [m]
  int finest_texels = 4;   ///< spacing of the finest detail: a power of two; below 4 images alias
  double roughness = 1.0;  ///< amplitude of each finer octave against the coarser one, (0, 2]
  double contrast = 0.22;  ///< standard deviation of the brightness about 0.5
};

/// What the light, the lens and the sensor do to one image.
struct ShotOptions {
  double gain = 1.0;        ///< exposure and flicker: of the whole image
  double offset = 0.0;      ///< added brightness, 1 is white
  double gradient_x = 0.0;  ///< gain changes by so much from the left edge to the right one
  double gradient_y = 0.0;  ///< likewise from top to bottom
  double defocus_px = 0.0;  ///< standard deviation of a Gaussian blur [pixel]
  double noise = 0.0;       ///< standard deviation of each pixel [grey levels of 255]
  std::uint64_t frame = 0;  ///< which noise: the same number gives the same bits
};

/// What a depth sensor of structured light does to a cloud.
struct CloudOptions {
  std::size_t points = 30000;                            ///< on a jittered grid over the image
  double sigma_m = 0.0005;                               ///< sigma(z) = a + b z^2: a
  double sigma_per_m = 0.0014;                           ///< b
  double quantum_per_m = 0.0;                            ///< step of 1/z; 0: none
  double hole_share = 0.0;                               ///< of the points that do not come back: NaN
  double outlier_share = 0.0;                            ///< of the points at a uniform 30 ... 99 % of their depth
  Eigen::Vector3d sensor_p_c = Eigen::Vector3d::Zero();  ///< the sensor in axes of the camera at `view` [m]
  std::uint64_t frame = 0;                               ///< which noise
};

/// Ground to look down on, rendered so that the truth of every pixel is exact (doc/ego_motion.md eq. 21-23).
///
/// The texture is a fixed, periodic, band-limited function of the ground's coordinates (octaves of B-spline noise from
/// the seed, with mip levels against aliasing); every pixel's ray meets the ground, objects and a wall in closed form.
/// Frames, tilt and signs are those of vision/ground_projection.hpp.
///
/// One object serves one thread at a time: rays of the last camera and buffers are kept, nothing is allocated for a
/// camera and a size seen before. 640 x 480: about 3 ms, each further view of a blur the same.
class GroundScene {
 public:
  /// Builds the texture: about 60 ms for 2048 x 2048. @throws std::invalid_argument for sizes, texels, a contrast or a
  /// roughness out of range.
  explicit GroundScene(std::uint64_t seed, const GroundTextureOptions& options = {});

  [[nodiscard]] const GroundTextureOptions& options() const noexcept { return options_; }

  /// An image of `camera.width()` x `camera.height()` grey levels, row after row, averaged over `views`: one, or
  /// several during an exposure (motion blur). Pixels that see no ground are grey. Objects cover each other in their
  /// order.
  /// @throws std::invalid_argument for an image of another size, no view, or a view that is not above the ground.
  void render(const vision::Camera& camera, std::span<const CameraView> views, const ShotOptions& shot,
              std::span<const GroundObject> objects, const GroundWall* wall, std::span<std::uint8_t> image);

  /// Points that a depth sensor with the field of view of `camera` sees, x y z each, in the sensor's axes (those of the
  /// camera) [m]; `xyz` holds 3 `options.points` numbers, NaN where nothing came back.
  /// @throws std::invalid_argument as `render`, for a share outside [0, 1] and negative noise.
  void depth_cloud(const vision::Camera& camera, const CameraView& view, const CloudOptions& options,
                   std::span<const GroundObject> objects, const GroundWall* wall, std::span<float> xyz);

  /// Brightness of the ground there, 0 black, 1 white: what an image samples without light, lens and noise.
  [[nodiscard]] double brightness(double x_m, double y_m) const noexcept;

 private:
  struct Level {
    std::size_t start;  // in texels_
    int size;
  };
  struct Ground;  // of one view: from rays to texels
  void build(std::uint64_t seed);
  void take_camera(const vision::Camera& camera);
  [[nodiscard]] float sample(const Level& level, float u, float v) const noexcept;
  void add_row(const Ground& ground, int row, std::span<float> out);
  void add_objects(const CameraView& view, std::span<const GroundObject> objects, int row, std::span<float> out);
  void add_wall(const CameraView& view, const GroundWall& wall, int row, std::span<float> out);
  void defocus(double sigma_px);

  GroundTextureOptions options_;
  RandomStream random_;
  std::vector<float> texels_;
  std::vector<Level> levels_;
  std::vector<double> camera_;  // what rays_ belongs to
  int width_ = 0;
  int height_ = 0;
  double focal_px_ = 1.0;
  std::vector<float> rays_;  // a of every pixel, then b; a ray is (a, b, 1)
  std::vector<std::uint8_t> seen_;
  bool all_seen_ = true;
  std::vector<float> image_, row_, kernel_, normals_;
  std::vector<double> draws_;
};

}  // namespace soopnav::simulation
