#pragma once

// Every kernel on one problem of `n` rows, all results one behind another. Included once for each set of instructions,
// with the kernels' namespace under another name (row_kernels_variant_*.cpp).

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <vector>

#include "estimation/row_kernels.hpp"

namespace {

inline std::vector<double> exercise(int n, std::uint64_t seed) {
  using namespace soopnav::detail;
  const auto size = static_cast<std::size_t>(n);
  const int stride = padded(n);
  std::uint64_t state = seed;
  const auto next = [&state] {  // any numbers will do
    state = state * 6364136223846793005U + 1442695040888963407U;
    return static_cast<double>(state >> 40U) / 8388608.0 - 1.0;
  };
  std::vector<double> packed(size * size);
  for (double& value : packed) value = next() > 0.3 ? next() : 0.0;
  SparseRows sparse(n, n);
  sparse.assign(packed.data(), n, n);

  RowArena arena(10 * size * static_cast<std::size_t>(stride) + 4 * static_cast<std::size_t>(stride));
  double *A, *B, *P, *DU, *U, *X, *Y, *Z, *T, *C;
  for (double** square : {&A, &B, &P, &DU, &U, &X, &Y, &Z, &T, &C}) *square = arena.take(n, stride);
  double* const d = arena.take(1, stride);
  double* const inverse_d = arena.take(1, stride);
  double* const row = arena.take(1, stride);
  std::vector<double> out;
  const auto keep = [&](const double* M, int rows) {
    std::vector<double> values(static_cast<std::size_t>(rows) * size);
    store_rows(M, rows, n, stride, values.data());
    out.insert(out.end(), values.begin(), values.end());
  };

  load_rows(packed.data(), n, n, stride, A);
  for (double& value : packed) value = next();
  load_rows(packed.data(), n, n, stride, B);
  multiply(sparse, B, n, stride, false, X);
  keep(X, n);
  multiply(A, B, n, stride, Y);
  keep(Y, n);
  subtract(X, B, n * stride, Z);
  keep(Z, n);
  // A positive definite matrix: Aᵀ A + I, its lower triangle mirrored.
  for (int i = 0; i < n; ++i) T[i * stride + i] = 1.0;
  add_product(T, A, A, n, n, stride, true, P);
  mirror(P, n, stride);
  keep(P, n);
  subtract_product(P, B, A, n, n, stride, C);
  symmetrize(C, n, stride);
  keep(C, n);
  transpose(C, n, stride, Z);
  keep(Z, n);
  const bool definite = factorize(P, n, stride, 1e-15, DU, U, d, inverse_d, X, stride);
  keep(X, n);
  keep(d, 1);
  solve_upper(U, inverse_d, n, stride, X, stride);
  keep(X, n);
  combine_rows(d, B, A, n, stride, row);
  keep(row, 1);
  for (const bool flag : {definite, all_finite(P, n, stride), is_symmetric(P, n, stride, 1e-9)}) {
    out.push_back(flag ? 1.0 : 0.0);
  }
  return out;
}

}  // namespace
