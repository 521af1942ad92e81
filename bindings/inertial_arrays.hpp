#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "array.hpp"
#include "soopnav/inertial/imu_increment.hpp"

/// What bindings of the inertial parts share.
namespace soopnav::python {

[[nodiscard]] inline Eigen::Vector3d vector_of(std::span<const double> row) { return {row[0], row[1], row[2]}; }

inline void require_columns(const TableBase& table, std::size_t columns, const char* name) {
  if (table.columns() == columns) return;
  throw std::invalid_argument(std::string(name) + ": rows of " + std::to_string(columns) + " numbers expected, got " +
                              std::to_string(table.columns()));
}

[[nodiscard]] inline Eigen::Vector3d vector_of(const RealArrayBase& values, const char* name) {
  if (values.size() != 3) {
    throw std::invalid_argument(std::string(name) + ": three numbers expected, got " + std::to_string(values.size()));
  }
  return vector_of(values.span());
}

/// Rows of two tables as increments of one length.
[[nodiscard]] inline std::vector<inertial::ImuIncrement> increments_of(const TableBase& delta_theta,
                                                                       const TableBase& delta_velocity, double dt_s) {
  require_columns(delta_theta, 3, "delta_theta_b");
  require_columns(delta_velocity, 3, "delta_velocity_b");
  if (delta_theta.rows() != delta_velocity.rows()) {
    throw std::invalid_argument("delta_velocity_b: " + std::to_string(delta_theta.rows()) +
                                " rows expected, as delta_theta_b has, got " + std::to_string(delta_velocity.rows()));
  }
  if (!(dt_s > 0.0) || std::isinf(dt_s)) throw std::invalid_argument("dt_s: not a positive finite number");
  std::vector<inertial::ImuIncrement> out(delta_theta.rows());
  for (std::size_t i = 0; i < out.size(); ++i) {
    out[i] = {vector_of(delta_theta.row(i)), vector_of(delta_velocity.row(i)), dt_s};
  }
  return out;
}

inline void append(std::vector<double>& out, const Eigen::Ref<const Eigen::VectorXd>& values) {
  out.insert(out.end(), values.data(), values.data() + values.size());
}

/// Increments as two arrays of shape (n, 3).
[[nodiscard]] inline py::tuple arrays_of(std::span<const inertial::ImuIncrement> increments) {
  std::vector<double> theta, velocity;
  theta.reserve(3 * increments.size());
  velocity.reserve(3 * increments.size());
  for (const auto& u : increments) {
    append(theta, u.delta_theta_b);
    append(velocity, u.delta_velocity_b);
  }
  const auto n = static_cast<py::ssize_t>(increments.size());
  return py::make_tuple(to_array(std::move(theta), {n, 3}), to_array(std::move(velocity), {n, 3}));
}

}  // namespace soopnav::python
