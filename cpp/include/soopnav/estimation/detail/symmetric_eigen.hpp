#pragma once

namespace soopnav::detail {

/// Eigenvalues (ascending) and eigenvectors (columns) of a symmetric `n` x `n` matrix, column-major and dense; only the
/// lower triangle is read. Compiled once: a decomposition in a header costs every filter's users seconds. No heap up to
/// 32 rows. NaN in, NaN out.
void symmetric_eigen(const double* matrix, int n, double* values, double* vectors) noexcept;

/// Singular values (descending) and, where a pointer is given, left and right singular vectors (columns) of an `n` x
/// `n` matrix, likewise. False when they do not converge or are not finite.
[[nodiscard]] bool square_svd(const double* matrix, int n, double* values, double* left, double* right) noexcept;

}  // namespace soopnav::detail
