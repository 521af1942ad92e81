#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "soopnav/estimation/detail/small_matrix.hpp"

namespace soopnav::gnss {

/// Normal equations by Cholesky of the matrix scaled to a unit diagonal, in plain loops: its unknowns are metres,
/// metres a second and constants that only a wide prior holds.
class PhaseNormal {
 public:
  /// All zero, `size` unknowns.
  void reset(std::size_t size) {
    size_ = size;
    lower_.assign(size * size, 0.0);
  }
  [[nodiscard]] std::size_t size() const noexcept { return size_; }
  /// Of the lower triangle, row >= column.
  [[nodiscard]] double& at(std::size_t row, std::size_t column) noexcept { return lower_[row + column * size_]; }
  /// Fixes an unknown at zero.
  void fix(std::size_t k) noexcept {
    for (std::size_t i = 0; i < size_; ++i) at(std::max(i, k), std::min(i, k)) = i == k ? 1.0 : 0.0;
  }
  /// False when it is not positive definite.
  [[nodiscard]] bool factor() {
    root_ = lower_;
    scale_.resize(size_);
    for (std::size_t i = 0; i < size_; ++i) {
      const double d = at(i, i);
      if (!(d > 0.0) || !std::isfinite(d)) return false;
      scale_[i] = 1.0 / std::sqrt(d);
    }
    for (std::size_t j = 0; j < size_; ++j) {
      for (std::size_t i = j; i < size_; ++i) {
        root_[i + j * size_] *= scale_[i] * scale_[j];
      }
    }
    return detail::cholesky_in_place(root_.data(), static_cast<Eigen::Index>(size_));
  }
  /// The solution of one right side.
  [[nodiscard]] std::vector<double> solve(std::vector<double> right) const {
    for (std::size_t i = 0; i < right.size(); ++i) right[i] *= scale_[i];
    detail::solve_lower(root_.data(), static_cast<Eigen::Index>(size_), right.data());
    detail::solve_lower_transposed(root_.data(), static_cast<Eigen::Index>(size_), right.data());
    for (std::size_t i = 0; i < right.size(); ++i) right[i] *= scale_[i];
    return right;
  }
  /// The first `columns` columns of the covariance, each of `size` numbers.
  [[nodiscard]] std::vector<std::vector<double>> covariance(std::size_t columns) const {
    std::vector<std::vector<double>> out;
    for (std::size_t k = 0; k < columns; ++k) {
      std::vector<double> unit(size_, 0.0);
      unit[k] = 1.0;
      out.push_back(solve(std::move(unit)));
    }
    return out;
  }

 private:
  std::size_t size_ = 0;
  std::vector<double> lower_, root_, scale_;
};

}  // namespace soopnav::gnss
