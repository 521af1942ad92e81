#pragma once

#include <Eigen/Core>
#include <span>

#include "soopnav/array/direction_finder.hpp"

namespace soopnav::array {

/// Unit tangents of the sphere at u: growing azimuth, growing elevation. At the zenith azimuth counts as 0.
struct Tangents {
  explicit Tangents(const Eigen::Vector3d& u) noexcept;
  Eigen::Vector3d azimuth, elevation;
};

/// Covariance of the tangent coordinates as one of [azimuth, elevation].
Eigen::Matrix2d in_angles(const Eigen::Matrix2d& tangent, const Eigen::Vector3d& u) noexcept;

/// sigma^2 times the inverse of a 2 x 2 (or, by `active`, 1 x 1) information matrix, no eigenvalue below that of a
/// standard deviation of pi/2; inactive axes get an infinite variance.
Eigen::Matrix2d bounded_inverse(const Eigen::Matrix2d& information, int active) noexcept;

/// Refines the directions `u` of K sources together: minimises tr(P_A^perp B), B = Es W Es^H with W = (L - s I)^2 L^-1
/// (subspace fitting) or B = R (maximum likelihood), by Levenberg's method on the sphere (doc/array.md eq. 11 to 13).
/// Writes each source's 2 x 2 tangent covariance. False when the steering vectors become dependent.
bool fit_directions(const Manifold& manifold, double frequency_hz, int active, const ComplexMatrix& R,
                    const HermitianEigen& eigen, double noise, double n_snapshots, bool subspace,
                    std::span<Eigen::Vector3d> u, std::span<Eigen::Matrix2d> covariance) noexcept;

/// Start of the fit: sources one after the other where the grid's a^H P^perp R P^perp a / a^H P^perp a is largest, then
/// each once more against the others.
void alternating_projections(const SteeringTable& table, const ComplexMatrix& R, std::span<Eigen::Vector3d> u) noexcept;

/// Diagonal of (A^H A)^-1 A^H (R - s I) A (A^H A)^-1: the sources' powers, not below 0. `A` is M x K.
void source_powers(const ComplexMatrix& A, const ComplexMatrix& R, double noise, std::span<double> out) noexcept;

}  // namespace soopnav::array
