#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "soopnav/navigation/source_likelihood.hpp"
#include "soopnav/navigation/source_locator.hpp"

/// What the locators share: bearings as they keep them, predicted angles, and a small Gaussian state.
namespace soopnav::navigation::detail {

/// Position (2 or 3), velocity (0, 2 or 3), heading bias (0 or 1).
inline constexpr std::size_t kMaxState = 7;
using Vector = std::array<double, kMaxState>;
using Matrix = std::array<Vector, kMaxState>;

/// A bearing as it is kept.
struct Kept {
  PackedBearing b;
  double azimuth = 0.0;
  double t_s = 0.0;
};

/// Checks a bearing and brings it into the form that is kept: `kUsed`, or why it is refused.
[[nodiscard]] BearingUse pack(const SourceBearing& b, std::size_t dimensions, Kept& out) noexcept;

/// Which component of a state is what.
struct Layout {
  std::size_t dimensions = 2;
  bool moving = false;
  bool biased = false;

  [[nodiscard]] std::size_t size() const noexcept { return (moving ? 2 : 1) * dimensions + (biased ? 1 : 0); }
  [[nodiscard]] std::size_t bias() const noexcept { return (moving ? 2 : 1) * dimensions; }
};

/// Residuals of a bearing, gradients of the predictions, variances. Row 1 only in space.
struct Angles {
  std::array<double, 2> residual{};
  std::array<Vector, 2> gradient{};
  std::array<double, 2> variance{};
  double level = 0.0;  ///< horizontal distance
};

/// Predicts `kept` from a state of time `t_s` (doc/source_location.md eq. 1 to 3). False within a millimetre of the
/// platform's plumb line, where there is no azimuth.
[[nodiscard]] bool predict(const Layout& layout, const Vector& x, double t_s, const Kept& kept, Angles& out) noexcept;

/// A Gaussian state.
struct Gaussian {
  Vector x{};
  Matrix P{};
};

/// Moves a state by `dt_s`: constant velocity with white acceleration of spectral density `psd` [m²/s³].
void propagate(const Layout& layout, double dt_s, double psd, Gaussian& g) noexcept;

/// Extended Kalman update with all angles of a bearing (carter 5.10 to 5.13, in Joseph's form). Writes ln of the
/// innovation's density and, where asked, its normalised square. False, and nothing changed, when the prediction is
/// undefined or a number is not finite.
[[nodiscard]] bool update(const Layout& layout, double t_s, const Kept& kept, Gaussian& g, double& log_density,
                          double* nis = nullptr) noexcept;

/// Position, velocity, heading bias and their covariances into `fix`, with the horizontal CEP.
void write_state(const Layout& layout, const Vector& x, const Matrix& P, SourceFix& fix) noexcept;

/// Cholesky factor of the leading n x n of `A` into the lower triangle of `L`. False unless positive definite.
[[nodiscard]] bool factor(std::size_t n, const Matrix& A, Matrix& L) noexcept;
/// Solves L L' x = b.
void solve(std::size_t n, const Matrix& L, const Vector& b, Vector& x) noexcept;
/// Inverse of L L'.
void invert(std::size_t n, const Matrix& L, Matrix& inverse) noexcept;

}  // namespace soopnav::navigation::detail
