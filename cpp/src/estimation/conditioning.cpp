#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>

#include "soopnav/estimation/detail/small_matrix.hpp"
#include "soopnav/estimation/detail/symmetric_eigen.hpp"
#include "soopnav/estimation/least_squares.hpp"

namespace soopnav::detail {
namespace {

// Sizes up to this need no heap.
constexpr int kBounded = 32;
template <int Max>
using Square = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, Max, Max>;
template <int Max>
using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, Max, 1>;

template <int Max>
bool invert(const double* information, int n, double* covariance_data) noexcept {
  constexpr double kSafePivot = 1e-5;
  const Eigen::Map<const Square<Max>> A(information, n, n);
  Vector<Max> scale(n);
  for (int i = 0; i < n; ++i) scale[i] = std::sqrt(A(i, i));
  if (!(scale.minCoeff() > 1e-3 * scale.maxCoeff())) return false;
  Square<Max> L(n, n);
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) L(i, j) = A(i, j) / scale[i] / scale[j];
  }
  if (!cholesky_in_place(L.data(), n)) return false;
  for (int i = 0; i < n; ++i) {
    if (!(L(i, i) > std::sqrt(kSafePivot))) return false;
  }
  Eigen::Map<Square<Max>> covariance(covariance_data, n, n);
  covariance.setIdentity();
  solve_lower(L.data(), n, covariance_data, n);
  solve_lower_transposed(L.data(), n, covariance_data, n);
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i <= j; ++i) {
      covariance(i, j) = covariance(j, i) = 0.5 * (covariance(i, j) + covariance(j, i)) / scale[i] / scale[j];
    }
  }
  return true;
}

// Eq. 7 and 8 of doc/position_fix.md.
template <int Max>
int condition(const double* root, int n, double tolerance, double* covariance_data,
              double* unobservable_data) noexcept {
  const Eigen::Map<const Square<Max>> r(root, n, n);
  Vector<Max> scale(n);
  for (int j = 0; j < n; ++j) scale[j] = r.col(j).norm();
  const double largest = scale.maxCoeff();
  Square<Max> scaled = r;
  for (int j = 0; j < n; ++j) {
    // A column of rounding errors must stay small, not be blown up to length one.
    if (!(scale[j] > tolerance * largest)) scale[j] = largest > 0.0 ? largest : 1.0;
    scaled.col(j) /= scale[j];
  }
  Vector<Max> s(n);
  Square<Max> V(n, n);
  int rank = 0;
  if (!square_svd(scaled.data(), n, s.data(), nullptr, V.data())) {
    s.setZero();
    V.setIdentity();
  }
  while (rank < n && s[rank] > tolerance * s[0]) ++rank;
  Eigen::Map<Square<Max>> covariance(covariance_data, n, n);
  if (rank == n) {
    for (int k = 0; k < n; ++k) {
      for (int i = 0; i < n; ++i) V(i, k) /= scale[i] * s[k];
    }
    covariance.setZero();
    accumulate_product_transposed<1>(V, V, covariance);
    return rank;
  }
  covariance.setConstant(std::numeric_limits<double>::quiet_NaN());
  Eigen::Map<Square<Max>> unobservable(unobservable_data, n, n);
  for (int k = rank; k < n; ++k) {
    // Back to unscaled components, then at right angles to those before (modified Gram-Schmidt).
    Vector<Max> v = V.col(k).cwiseQuotient(scale) * scale.minCoeff();
    v.normalize();
    for (int j = 0; j < k - rank; ++j) {
      const double along = unobservable.col(j).dot(v);
      v -= along * unobservable.col(j);
    }
    unobservable.col(k - rank) = v.normalized();
  }
  return rank;
}

}  // namespace

bool invert_well_conditioned(const double* information, int n, double* covariance) noexcept {
  return n <= kBounded ? invert<kBounded>(information, n, covariance)
                       : invert<Eigen::Dynamic>(information, n, covariance);
}

int condition_root(const double* root, int n, double tolerance, double* covariance, double* unobservable) noexcept {
  return n <= kBounded ? condition<kBounded>(root, n, tolerance, covariance, unobservable)
                       : condition<Eigen::Dynamic>(root, n, tolerance, covariance, unobservable);
}

}  // namespace soopnav::detail
