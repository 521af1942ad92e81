#pragma once

#include <Eigen/Core>
#include <array>
#include <span>

/// Cameras and the ground they look at.
///
/// Camera frame c: right-handed, x to the right and y down the image, z along the optical axis, origin at the centre of
/// projection. (nielsen's camera frame e is this one with y negated: left-handed.) Pixels: (u, v) right and down, whole
/// numbers at the centres of pixels, so that an image reaches from -0.5 to width - 0.5.
namespace soopnav::vision {

/// How a lens bends rays. The models and the order of their coefficients are OpenCV's.
enum class Lens {
  kPinhole,           ///< no coefficients
  kRadialTangential,  ///< k1, k2, p1, p2, k3 (Brown-Conrady)
  kFisheye,           ///< k1, k2, k3, k4 (Kannala-Brandt, equidistant)
};

/// A calibrated camera: from points to pixels and back.
///
/// Model: u = fx * x_d + cx, v = fy * y_d + cy, (x_d, y_d) from the ray (a, b, 1) = p_c / z with r^2 = a^2 + b^2:
///   pinhole            (a, b)
///   radial-tangential  (a, b) (1 + k1 r^2 + k2 r^4 + k3 r^6) + (2 p1 a b + p2 (r^2 + 2 a^2), p1 (r^2 + 2 b^2) + 2 p2 a
///   b) fisheye            (a, b) / r * t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8), t = atan r
/// A polynomial of a lens grows only up to some angle from the optical axis; beyond it several rays share a pixel. The
/// camera knows that angle (`max_angle_rad`, at most 89 degrees) and maps nothing beyond it.
///
/// Immutable; no function allocates or throws.
class Camera {
 public:
  using Vector2 = Eigen::Vector2d;
  using Vector3 = Eigen::Vector3d;
  using ProjectionJacobian = Eigen::Matrix<double, 2, 3>;    ///< of the pixel, by the point [px/m]
  using UnprojectionJacobian = Eigen::Matrix<double, 3, 2>;  ///< of the ray, by the pixel [1/px]

  /// `distortion`: none or as many numbers as the lens has; fewer of a radial-tangential lens (4) leave k3 = 0.
  /// Throws std::invalid_argument for a size outside 1 to 65535, a focal length that is not positive, a number that is
  /// not finite, another count of coefficients, and a lens that bends the ray to no pixel of the image's border
  /// (max_angle_rad below 0.01).
  Camera(int width, int height, double fx, double fy, double cx, double cy, Lens lens = Lens::kPinhole,
         std::span<const double> distortion = {});

  [[nodiscard]] int width() const noexcept { return width_; }    ///< [px]
  [[nodiscard]] int height() const noexcept { return height_; }  ///< [px]
  [[nodiscard]] double fx() const noexcept { return fx_; }       ///< focal length along u [px]
  [[nodiscard]] double fy() const noexcept { return fy_; }       ///< focal length along v [px]
  [[nodiscard]] double cx() const noexcept { return cx_; }       ///< u of the optical axis [px]
  [[nodiscard]] double cy() const noexcept { return cy_; }       ///< v of the optical axis [px]
  [[nodiscard]] Lens lens() const noexcept { return lens_; }
  /// The lens's coefficients: none, five or four.
  [[nodiscard]] std::span<const double> distortion() const noexcept;
  /// Largest angle between the optical axis and a ray that the camera maps.
  [[nodiscard]] double max_angle_rad() const noexcept { return max_angle_rad_; }

  /// The pixel of a point (camera frame, any length unit), also outside the image. False, and `pixel` untouched, for a
  /// point that is not finite, not in front of the camera or beyond `max_angle_rad`.
  [[nodiscard]] bool project(const Vector3& p_c, Vector2& pixel) const noexcept;
  [[nodiscard]] bool project(const Vector3& p_c, Vector2& pixel, ProjectionJacobian& jacobian) const noexcept;

  /// The ray (a, b, 1) of a pixel, also of one outside the image. False, and `ray` untouched, for a pixel that is not
  /// finite or that no ray within `max_angle_rad` is mapped to. Inverse of `project` to 1e-9 px.
  [[nodiscard]] bool unproject(const Vector2& pixel, Vector3& ray) const noexcept;
  [[nodiscard]] bool unproject(const Vector2& pixel, Vector3& ray, UnprojectionJacobian& jacobian) const noexcept;

  /// Whether a pixel lies in the image, `border_px` away from its edges.
  [[nodiscard]] bool contains(const Vector2& pixel, double border_px = 0.0) const noexcept {
    return pixel.x() >= border_px - 0.5 && pixel.y() >= border_px - 0.5 && pixel.x() <= width_ - 0.5 - border_px &&
           pixel.y() <= height_ - 0.5 - border_px;
  }

  /// The same camera whose images are brought to another size. Throws std::invalid_argument as the constructor does.
  [[nodiscard]] Camera resized(int width, int height) const;

 private:
  bool bend(double a, double b, Vector2& pixel, Eigen::Matrix2d* jacobian) const noexcept;
  bool straighten(const Vector2& pixel, Vector2& ab, Eigen::Matrix2d& jacobian) const noexcept;

  int width_, height_;
  double fx_, fy_, cx_, cy_;
  Lens lens_;
  std::array<double, 5> k_{};
  double max_angle_rad_ = 0.0;
  double max_radius_ = 0.0;  // tan of it
  double max_bent_ = 0.0;    // distorted radius there
};

}  // namespace soopnav::vision
