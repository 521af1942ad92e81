#pragma once

#include <span>

#include "soopnav/estimation/linear_filter.hpp"

/// Refusals of what a whole run is given: each throws std::invalid_argument that starts with the parameter's name.
namespace soopnav::detail {

/// Size, one matrix or one for each step, finite.
void check_series(const MatrixSeries& series, const char* name, int rows, int columns, int steps);

/// The same for symmetric `n` x `n` matrices, positive definite or semi-definite. A matrix equal to the one before it
/// costs a comparison.
void check_covariance_series(const MatrixSeries& series, const char* name, int n, int steps, bool definite);

/// `steps` rows of `columns` finite numbers.
void check_table(std::span<const double> values, const char* name, int steps, int columns);

/// `steps` packed arrays of `size` numbers; their values are not looked at.
void check_size(std::size_t values, const char* name, int steps, std::size_t size);

}  // namespace soopnav::detail
