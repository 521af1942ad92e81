#include "estimation/series_check.hpp"

#include <Eigen/Cholesky>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <stdexcept>
#include <string>

#include "soopnav/estimation/covariance_check.hpp"

namespace soopnav::detail {

namespace {

std::string size_text(int rows, int columns) {
  std::string text = "(";
  return text.append(std::to_string(rows)).append(", ").append(std::to_string(columns)).append(")");
}

std::size_t size_of(int rows, int columns) {
  return static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns);
}

// The name of one matrix of a series.
std::string element_name(const char* name, const MatrixSeries& series, int k) {
  std::string text = name;
  if (series.count > 1) text.append("[").append(std::to_string(k)).append("]");
  return text;
}

// Quick to see in the usual case; the other cases are left to check_covariance, which says what is wrong.
bool plainly_definite(const Eigen::Map<const RowMajorMatrix>& P, Eigen::LLT<Eigen::MatrixXd>& llt) {
  for (Eigen::Index i = 0; i < P.rows(); ++i) {
    for (Eigen::Index j = 0; j < i; ++j) {
      if (!(std::abs(P(i, j) - P(j, i)) <= 1e-9 * std::sqrt(std::abs(P(i, i) * P(j, j))))) return false;
    }
  }
  llt.compute(P);
  return P.allFinite() && llt.info() == Eigen::Success;
}

}  // namespace

void check_series(const MatrixSeries& series, const char* name, int rows, int columns, int steps) {
  if (series.rows != rows || series.columns != columns) {
    throw std::invalid_argument(std::string(name) + ": shape " + size_text(series.rows, series.columns) +
                                ", expected " + size_text(rows, columns));
  }
  if (series.count != 1 && series.count != steps) {
    throw std::invalid_argument(std::string(name) + ": " + std::to_string(series.count) + " matrices for " +
                                std::to_string(steps) + " steps; one, or one for each step, is expected");
  }
  const std::size_t one = size_of(rows, columns);
  check_size(series.values.size(), name, series.count, one);
  for (std::size_t i = 0; i < series.values.size(); ++i) {
    if (!std::isfinite(series.values[i])) {
      throw std::invalid_argument(element_name(name, series, static_cast<int>(i / one)) + ": not finite");
    }
  }
}

void check_covariance_series(const MatrixSeries& series, const char* name, int n, int steps, bool definite) {
  check_series(series, name, n, n, steps);
  Eigen::LLT<Eigen::MatrixXd> llt(n);
  for (int k = 0; k < series.count; ++k) {
    if (k > 0 && std::memcmp(series.at(k), series.at(k - 1), size_of(n, n) * sizeof(double)) == 0) continue;
    const Eigen::Map<const RowMajorMatrix> P(series.at(k), n, n);
    if (!plainly_definite(P, llt)) check_covariance(P, element_name(name, series, k).c_str(), definite);
  }
}

void check_table(std::span<const double> values, const char* name, int steps, int columns) {
  check_size(values.size(), name, steps, static_cast<std::size_t>(columns));
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!std::isfinite(values[i])) {
      throw std::invalid_argument(std::string(name) + ": step " +
                                  std::to_string(i / static_cast<std::size_t>(columns)) + " is not finite");
    }
  }
}

void check_size(std::size_t values, const char* name, int steps, std::size_t size) {
  const std::size_t expected = static_cast<std::size_t>(steps) * size;
  if (values != expected) {
    throw std::invalid_argument(std::string(name) + ": " + std::to_string(values) + " numbers, expected " +
                                std::to_string(steps) + " x " + std::to_string(size));
  }
}

}  // namespace soopnav::detail
