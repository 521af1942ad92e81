#pragma once

#include <Eigen/Core>

#include "soopnav/estimation/detail/symmetric_eigen.hpp"

namespace soopnav::gnss::detail {

/// Eigenvalues, ascending, and unit eigenvectors of a symmetric matrix. Compiled once, elsewhere.
template <int N>
struct SymmetricEigen {
  explicit SymmetricEigen(const Eigen::Matrix<double, N, N>& matrix) noexcept {
    soopnav::detail::symmetric_eigen(matrix.data(), N, values.data(), vectors.data());
  }
  Eigen::Matrix<double, N, 1> values;
  Eigen::Matrix<double, N, N> vectors;
};

}  // namespace soopnav::gnss::detail
