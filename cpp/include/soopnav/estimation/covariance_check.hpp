#pragma once

#include <Eigen/Core>

namespace soopnav {

/// Throws std::invalid_argument, naming `name` and what is wrong, unless `P` is square, finite, symmetric to 1e-9 of
/// its diagonal, and positive semi-definite to rounding (positive definite when `definite`). For set-up; allocates.
void check_covariance(const Eigen::Ref<const Eigen::MatrixXd>& P, const char* name, bool definite = false);

namespace detail {

/// Throws std::invalid_argument naming `name` and the component unless every number is finite.
void check_state(const Eigen::Ref<const Eigen::VectorXd>& x, const char* name);
/// Throws std::invalid_argument naming the component unless every variance is finite and not negative.
void check_floor(const Eigen::Ref<const Eigen::VectorXd>& variance);

}  // namespace detail
}  // namespace soopnav
