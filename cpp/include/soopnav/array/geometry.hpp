#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace soopnav::array {

/// A direction in array axes: azimuth from axis 1 towards axis 2, elevation from plane 1-2 towards axis 3 [rad].
struct Direction {
  double azimuth_rad = 0.0;
  double elevation_rad = 0.0;
};

/// [cos el cos az, cos el sin az, sin el]: the unit vector towards the source.
[[nodiscard]] Eigen::Vector3d unit_vector(const Direction& direction) noexcept;

/// The direction of a vector that is not zero; azimuth in (-pi, pi], 0 at the zenith.
[[nodiscard]] Direction direction_of(const Eigen::Vector3d& u) noexcept;

/// Where the elements of an array are, and the frequency it is for.
///
/// Model: carter (4.14) with the sign of a source that an element nearer to it hears earlier: the steering vector is
/// a_m = exp(+j 2 pi r_m . u / lambda).
/// Frames: array axes 1, 2, 3, any origin: it only turns the common phase.
///
/// What the elements span decides what can be told: a line (rank 1) gives a cone, which is reported in the half plane
/// at elevation 0 (azimuth for a horizontal line, elevation for a vertical one); a plane (rank 2) cannot tell a
/// direction from its image behind the plane; rank 3 tells all. An immutable value.
class ArrayGeometry {
 public:
  /// @param positions_m 2 to 32 elements, array axes [m].
  /// @throws std::invalid_argument for fewer or more elements, one that is not finite, two on one point (nearer than
  ///         1e-6 wavelengths), or a frequency that is not positive and finite.
  ArrayGeometry(std::vector<Eigen::Vector3d> positions_m, double frequency_hz, std::string name = {});

  /// `count` elements on axis 1, the first at the origin. Throws as the constructor, and for a spacing <= 0.
  [[nodiscard]] static ArrayGeometry ula(int count, double spacing_wavelengths = 0.5, double frequency_hz = 1575.42e6);
  /// `count` elements on a circle round the origin in plane 1-2, the first on axis 1, then towards axis 2.
  [[nodiscard]] static ArrayGeometry uca(int count, double radius_wavelengths, double frequency_hz = 1575.42e6);
  /// `columns` x `rows` elements in plane 1-2, the first at the origin, axis 1 running faster.
  [[nodiscard]] static ArrayGeometry planar(int columns, int rows, double spacing_wavelengths = 0.5,
                                            double frequency_hz = 1575.42e6);

  [[nodiscard]] int size() const noexcept { return static_cast<int>(positions_m_.size()); }
  [[nodiscard]] const std::vector<Eigen::Vector3d>& positions_m() const noexcept { return positions_m_; }
  [[nodiscard]] double frequency_hz() const noexcept { return frequency_hz_; }
  [[nodiscard]] double wavelength_m() const noexcept { return wavelength_m_; }
  [[nodiscard]] const std::string& name() const noexcept { return name_; }
  [[nodiscard]] double aperture_m() const noexcept { return aperture_m_; }  ///< greatest distance of two elements
  /// Smallest distance of two elements [m].
  [[nodiscard]] double smallest_spacing_m() const noexcept { return smallest_spacing_m_; }
  [[nodiscard]] int rank() const noexcept { return rank_; }  ///< 1 line, 2 plane, 3 space
  /// Rank 1: along the line. Rank 2: normal of the plane, the side that is reported. Rank 3: zero.
  [[nodiscard]] const Eigen::Vector3d& axis() const noexcept { return axis_; }

  /// Differences u - u' of directions that the array cannot tell apart although their mirror images are no reason:
  /// every baseline changes by whole cycles (doc/array.md eq. 3). Empty for spacings below half a wavelength. A
  /// difference of length 2 concerns opposite ends only. In the span of the elements, both signs.
  [[nodiscard]] const std::vector<Eigen::Vector3d>& ambiguities() const noexcept { return ambiguities_; }
  /// Whether some difference is shorter than 2: then whole regions of directions have doubles.
  [[nodiscard]] bool ambiguous() const noexcept;

  /// Directions with the same steering vector up to its common phase, the mirror image and the direction itself left
  /// out, on the side that is reported. Exact for whole cycles within 1e-6. Allocates.
  /// @throws std::invalid_argument when the direction is not finite.
  [[nodiscard]] std::vector<Direction> ambiguous_directions(const Direction& direction) const;

  /// The direction or its mirror image: that on the side which is reported. Rank 1: the half plane at elevation 0.
  [[nodiscard]] Eigen::Vector3d reported_side(const Eigen::Vector3d& u) const noexcept;

 private:
  void find_span();
  void find_ambiguities();

  std::vector<Eigen::Vector3d> positions_m_;
  double frequency_hz_;
  double wavelength_m_;
  std::string name_;
  double aperture_m_ = 0.0;
  double smallest_spacing_m_ = 0.0;
  int rank_ = 0;
  Eigen::Vector3d axis_ = Eigen::Vector3d::Zero();
  Eigen::Matrix3d span_ = Eigen::Matrix3d::Zero();  // first `rank` columns: orthonormal, spanning the elements
  std::vector<Eigen::Vector3d> ambiguities_;
};

}  // namespace soopnav::array
