#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "soopnav/array/manifold.hpp"
#include "soopnav/array/types.hpp"

namespace soopnav::array {

enum class CrlbKind : std::uint8_t {
  kStochastic,     ///< Gaussian signals: s / 2N {Re[(D^H P D) o (S A^H R^-1 A S)^T]}^-1 (Stoica and Nehorai 1990)
  kDeterministic,  ///< unknown signals: s / 2N {Re[(D^H P D) o S^T]}^-1 (1989); never above the stochastic one
};

/// Cramer-Rao bound of the directions of K sources in white noise, everything else unknown: doc/array.md eq. 14, 15.
///
/// @param directions K, fewer than the elements.
/// @param powers     K x K covariance of the signals at an ideal element (a diagonal for uncorrelated ones).
/// @param noise      variance per element.
/// @return 2K x 2K [rad^2], ordered azimuth 1, elevation 1, azimuth 2, ...
/// @throws std::invalid_argument for sizes that do not fit, noise or n_snapshots that are not positive, powers that are
///         not Hermitian with a positive diagonal, or directions that the array does not determine (singular).
[[nodiscard]] Eigen::MatrixXd crlb(const Manifold& manifold, std::span<const Direction> directions,
                                   const ComplexMatrix& powers, double noise, double n_snapshots, CrlbKind kind);

/// The same for one angle each: azimuth at the given elevation. K x K.
[[nodiscard]] Eigen::MatrixXd azimuth_crlb(const Manifold& manifold, std::span<const Direction> directions,
                                           const ComplexMatrix& powers, double noise, double n_snapshots,
                                           CrlbKind kind);

}  // namespace soopnav::array
