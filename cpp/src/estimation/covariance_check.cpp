#include "soopnav/estimation/covariance_check.hpp"

#include <Eigen/Eigenvalues>
#include <cmath>
#include <cstdio>
#include <stdexcept>
#include <string>

namespace soopnav {

namespace {

[[noreturn]] void refuse(const char* name, const char* format, double value) {
  char text[96];
  std::snprintf(text, sizeof text, format, value);
  throw std::invalid_argument(std::string(name) + ": " + text);
}

}  // namespace

void check_covariance(const Eigen::Ref<const Eigen::MatrixXd>& P, const char* name, bool definite) {
  if (P.rows() != P.cols() || P.rows() == 0) {
    throw std::invalid_argument(std::string(name) + ": " + std::to_string(P.rows()) + " x " + std::to_string(P.cols()) +
                                ", a square matrix expected");
  }
  if (!P.allFinite()) throw std::invalid_argument(std::string(name) + ": not finite");
  for (Eigen::Index i = 0; i < P.rows(); ++i) {
    for (Eigen::Index j = 0; j < i; ++j) {
      const double difference = std::abs(P(i, j) - P(j, i));
      if (difference > 1e-9 * std::sqrt(std::abs(P(i, i) * P(j, j)))) {
        refuse(name, "not symmetric (elements that should be equal differ by %.2g)", difference);
      }
    }
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(P, Eigen::EigenvaluesOnly);
  const double smallest = solver.eigenvalues()[0];
  const double rounding = 1e-13 * static_cast<double>(P.rows()) * solver.eigenvalues().cwiseAbs().maxCoeff();
  if (definite && !(smallest > 0.0)) refuse(name, "not positive definite (smallest eigenvalue %.2g)", smallest);
  if (smallest < -rounding) refuse(name, "not positive semi-definite (smallest eigenvalue %.2g)", smallest);
}

namespace detail {

void check_state(const Eigen::Ref<const Eigen::VectorXd>& x, const char* name) {
  for (Eigen::Index i = 0; i < x.size(); ++i) {
    if (!std::isfinite(x[i])) {
      throw std::invalid_argument(std::string(name) + "[" + std::to_string(i) + "]: " + std::to_string(x[i]) +
                                  ", a finite number expected");
    }
  }
}

void check_floor(const Eigen::Ref<const Eigen::VectorXd>& variance) {
  for (Eigen::Index i = 0; i < variance.size(); ++i) {
    if (!(variance[i] >= 0.0) || std::isinf(variance[i])) {
      throw std::invalid_argument("variance[" + std::to_string(i) + "]: " + std::to_string(variance[i]) +
                                  ", at least zero expected");
    }
  }
}

}  // namespace detail
}  // namespace soopnav
