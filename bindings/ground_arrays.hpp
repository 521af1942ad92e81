#pragma once

#include <Eigen/Core>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "array.hpp"

/// What bindings of the ground, of motion over it and of its rendering share.
namespace soopnav::python {

/// A small matrix as a new array.
template <class Derived>
[[nodiscard]] py::array_t<double> matrix_array(const Eigen::MatrixBase<Derived>& matrix) {
  std::vector<double> values;
  for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
    for (Eigen::Index j = 0; j < matrix.cols(); ++j) values.push_back(matrix(i, j));
  }
  if (matrix.cols() == 1) return to_array(std::move(values));
  return to_array(std::move(values), {matrix.rows(), matrix.cols()});
}

/// `count` numbers of an array, or a sentence about `name`.
template <int Rows, int Columns>
[[nodiscard]] Eigen::Matrix<double, Rows, Columns> small_matrix(std::span<const double> values, const char* name) {
  if (values.size() != static_cast<std::size_t>(Rows * Columns)) {
    throw std::invalid_argument(std::string(name) + ": " + std::to_string(Rows * Columns) + " numbers expected, got " +
                                std::to_string(values.size()));
  }
  Eigen::Matrix<double, Rows, Columns> out;
  for (int i = 0; i < Rows; ++i) {
    for (int j = 0; j < Columns; ++j) out(i, j) = values[static_cast<std::size_t>(i * Columns + j)];
  }
  return out;
}

}  // namespace soopnav::python
