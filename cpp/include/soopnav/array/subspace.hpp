#pragma once

#include <cstdint>
#include <span>

#include "soopnav/array/types.hpp"

namespace soopnav::array {

/// Eigenvalues, largest first, and eigenvectors (columns) of a Hermitian matrix.
struct HermitianEigen {
  RealVector values;
  ComplexMatrix vectors;
};

/// Cyclic Jacobi: every eigenvalue to the rounding of the largest, vectors orthonormal. Does not allocate; 4 x 4: 2 us.
/// False, with `out` untouched, unless R is square, not empty, and finite. Reads the lower triangle.
[[nodiscard]] bool hermitian_eigen(const ComplexMatrix& R, HermitianEigen& out) noexcept;

/// R has rank `rank` at least: its rank-th eigenvalue is above M eps times the largest, which is above 0.
[[nodiscard]] bool has_rank(const HermitianEigen& eigen, int rank) noexcept;

/// Mean of the noise eigenvalues, those after the first `n_sources`; not below 0.
[[nodiscard]] double noise_variance(const HermitianEigen& eigen, int n_sources) noexcept;

enum class Spectrum : std::uint8_t {
  kBartlett,  ///< a^H R a: carter (4.13) without its a^H a; the paper calls it MUSIC
  kCapon,     ///< 1 / (a^H R^-1 a)
  kMusic,     ///< 1 / (a^H En En^H a), Schmidt 1986
};

/// Spectrum over steering vectors, in double precision. `steering` is M rows by G columns, row-major: element m of
/// direction g at steering[m G + g]; `out` has G values. Capon adds `loading` times the mean power to R's diagonal.
/// kSingular: Capon of a singular R, MUSIC of one whose rank is below n_sources, nothing is written. Does not allocate.
/// @throws std::invalid_argument for sizes that do not fit, MUSIC with n_sources outside 1 .. M-1, or loading < 0.
[[nodiscard]] ArrayStatus spectrum(Spectrum kind, const HermitianEigen& eigen, std::span<const Cf64> steering,
                                   int n_sources, double loading, std::span<double> out);

/// Roots of a polynomial, coefficients from the highest power (not 0) down: Aberth's iteration, all roots at once; a
/// double root comes out to half the digits. `roots` has one place less than `coefficients` (at most 63). False when
/// they do not settle. Does not allocate.
[[nodiscard]] bool polynomial_roots(std::span<const Cf64> coefficients, std::span<Cf64> roots) noexcept;

/// root-MUSIC (Barabell 1983) of a ULA: angles from broadside, ascending, in `out` (n_sources of them) [rad]. The roots
/// nearest to the unit circle from inside count; phase 2 pi spacing sin(theta), an angle that this spacing cannot give
/// is clamped to +- pi/2. kSingular as MUSIC; kUnresolved when the roots do not settle. Does not allocate.
/// @throws std::invalid_argument for n_sources outside 1 .. M-1, sizes, or a spacing that is not positive.
[[nodiscard]] ArrayStatus root_music(const HermitianEigen& eigen, double spacing_wavelengths, std::span<double> out);

/// ESPRIT (Roy and Kailath 1989) of a ULA with two subarrays of M - 1 elements, by total or plain least squares. Rows
/// are weighted by sqrt(min(m, M - m)), m = 1 .. M-1: the middle elements are in both subarrays.
/// As `root_music` otherwise.
[[nodiscard]] ArrayStatus esprit(const HermitianEigen& eigen, double spacing_wavelengths, bool total_least_squares,
                                 std::span<double> out);

enum class SourceCount : std::uint8_t {
  kAic,    ///< Akaike; over-counts by one in several per cent of the cases for any number of snapshots
  kMdl,    ///< Wax and Kailath 1985, minimum description length: consistent
  kSorte,  ///< He, Cichocki et al. 2010, gaps of the eigenvalues: no snapshots, no white noise needed; 1 .. M-2 only
};

/// Number of sources from the eigenvalues (any order is sorted) of a covariance of `n_snapshots`. Non-positive
/// eigenvalues count as eps times the largest. -1 when one is not finite or all are 0. Does not allocate.
/// @throws std::invalid_argument for fewer than 2 (SORTE: 4) or more than 32 eigenvalues, or n_snapshots < 1.
[[nodiscard]] int source_count(SourceCount kind, std::span<const double> eigenvalues, double n_snapshots);

}  // namespace soopnav::array
