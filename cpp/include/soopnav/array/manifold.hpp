#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "soopnav/array/geometry.hpp"
#include "soopnav/array/types.hpp"

namespace soopnav::array {

/// Measured responses over what the positions alone give, on a regular grid.
///
/// `correction` holds, for frequency f, elevation e, azimuth a, element m (m running fastest), the complex factor of
/// element m's response over exp(+j 2 pi r_m . u f / c): with the geometry taken out it changes slowly, and linear
/// interpolation of real and imaginary parts is right. Azimuths that go round (first + 360 degrees one step after the
/// last) are periodic.
struct ResponseGrid {
  std::vector<double> frequency_hz;   ///< ascending, at least 1; between them linear, beyond the ends the end's value
  std::vector<double> azimuth_rad;    ///< ascending, evenly spaced, at least 2, less than one turn
  std::vector<double> elevation_rad;  ///< ascending, evenly spaced, at least 2, within +- 90 degrees
  std::vector<Cf64> correction;       ///< F E A M
};

/// A steering vector with its derivatives along two unit tangents of the sphere.
struct SteeringJet {
  ComplexVector value;
  ComplexVector first[2];   ///< along tangent 0 (growing azimuth) and 1 (growing elevation), per radian
  ComplexVector second[3];  ///< 00, 01, 11, along great circles
};

/// How the elements of an array answer a plane wave: doc/array.md eq. 1 and 4.
///
/// Model: a(u, f) = C diag(g_m) diag(h_m(u, f)) exp(+j 2 pi r_m . u f / c), with g element errors (gain and phase), h
/// measured responses, C mutual coupling; ideal: all one. An immutable value: `with_...` return another.
class Manifold {
 public:
  /// Ideal: isotropic elements.
  explicit Manifold(ArrayGeometry geometry);
  /// Measured. @throws std::invalid_argument for a grid that is not regular, sizes that do not fit, or holes (values
  ///         that are not finite): how many, and element, azimuth, elevation and frequency of the first.
  Manifold(ArrayGeometry geometry, ResponseGrid grid);

  /// Times 10^(gain_db / 20) exp(j phase_rad), one each per element, besides what is there.
  /// @throws std::invalid_argument for another number or one that is not finite.
  [[nodiscard]] Manifold with_errors(std::span<const double> gain_db, std::span<const double> phase_rad) const;
  /// Times a coupling matrix from the left: M x M. @throws std::invalid_argument for another size, or not finite.
  [[nodiscard]] Manifold with_coupling(const ComplexMatrix& coupling) const;

  [[nodiscard]] const ArrayGeometry& geometry() const noexcept { return geometry_; }
  [[nodiscard]] int size() const noexcept { return geometry_.size(); }
  [[nodiscard]] bool ideal() const noexcept { return !grid_ && !coupling_ && !errors_; }
  [[nodiscard]] const std::optional<ResponseGrid>& grid() const noexcept { return grid_; }
  [[nodiscard]] const std::optional<ComplexMatrix>& coupling() const noexcept { return coupling_; }
  [[nodiscard]] const ComplexVector& element_factors() const noexcept { return factors_; }

  /// The steering vector towards the unit vector `u` at `frequency_hz`. False, with `out` untouched, where the grid
  /// does not reach. Does not allocate.
  [[nodiscard]] bool steering(const Eigen::Vector3d& u, double frequency_hz, ComplexVector& out) const noexcept;
  /// The same with derivatives along the unit tangents `t0` and `t1`. Exact but for measured responses, whose slope is
  /// taken over 2e-3 rad and whose curvature is left out. Does not allocate.
  [[nodiscard]] bool steering(const Eigen::Vector3d& u, const Eigen::Vector3d& t0, const Eigen::Vector3d& t1,
                              double frequency_hz, SteeringJet& out) const noexcept;

 private:
  [[nodiscard]] bool response(const Eigen::Vector3d& u, double frequency_hz, ComplexVector& out) const noexcept;

  ArrayGeometry geometry_;
  std::optional<ResponseGrid> grid_;
  bool periodic_ = false;
  bool errors_ = false;
  ComplexVector factors_;
  std::optional<ComplexMatrix> coupling_;
};

}  // namespace soopnav::array
