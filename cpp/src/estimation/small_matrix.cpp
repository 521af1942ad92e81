#include "soopnav/estimation/detail/small_matrix.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace soopnav::detail {

bool solve_square(double* a, int n, double* b, int columns) noexcept {
  constexpr double kRounding = 1e-14;
  const auto at = [n](int i, int j) {
    return static_cast<std::size_t>(i) + static_cast<std::size_t>(n) * static_cast<std::size_t>(j);
  };
  double least = 0.0;
  double largest = 0.0;
  for (int k = 0; k < n; ++k) {
    int pivot = k;
    for (int i = k + 1; i < n; ++i) {
      if (std::abs(a[at(i, k)]) > std::abs(a[at(pivot, k)])) pivot = i;
    }
    const double size = std::abs(a[at(pivot, k)]);
    least = k == 0 ? size : std::min(least, size);
    largest = std::max(largest, size);
    if (!(size > 0.0)) return false;
    if (pivot != k) {
      for (int j = k; j < n; ++j) std::swap(a[at(k, j)], a[at(pivot, j)]);
      for (int j = 0; j < columns; ++j) std::swap(b[at(k, j)], b[at(pivot, j)]);
    }
    for (int i = k + 1; i < n; ++i) a[at(i, k)] /= a[at(k, k)];
    for (int j = k + 1; j < n; ++j) {
      for (int i = k + 1; i < n; ++i) a[at(i, j)] -= a[at(i, k)] * a[at(k, j)];
    }
    for (int j = 0; j < columns; ++j) {
      for (int i = k + 1; i < n; ++i) b[at(i, j)] -= a[at(i, k)] * b[at(k, j)];
    }
  }
  if (!(least > kRounding * largest)) return false;
  for (int j = 0; j < columns; ++j) {
    for (int k = n - 1; k >= 0; --k) {
      b[at(k, j)] /= a[at(k, k)];
      for (int i = 0; i < k; ++i) b[at(i, j)] -= a[at(i, k)] * b[at(k, j)];
    }
  }
  return true;
}

}  // namespace soopnav::detail
