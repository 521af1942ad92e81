#include "soopnav/estimation/interacting_multiple_model.hpp"

#include <cmath>
#include <stdexcept>
#include <string>

namespace soopnav::detail {

namespace {

// Sums of probabilities are taken for one within this.
constexpr double kSumTolerance = 1e-9;

void check_probability(double p, const std::string& name) {
  if (!(p >= 0.0 && p <= 1.0)) {
    throw std::invalid_argument(name + ": " + std::to_string(p) + ", a probability expected");
  }
}

void check_sum(double sum, const std::string& name) {
  if (!(std::abs(sum - 1.0) <= kSumTolerance)) {
    throw std::invalid_argument(name + ": sums to " + std::to_string(sum) + ", one expected");
  }
}

}  // namespace

void check_mode_transition(const Eigen::Ref<const Eigen::MatrixXd>& transition) {
  for (Eigen::Index i = 0; i < transition.rows(); ++i) {
    for (Eigen::Index j = 0; j < transition.cols(); ++j) {
      check_probability(transition(i, j), "transition(" + std::to_string(i) + ", " + std::to_string(j) + ")");
    }
    check_sum(transition.row(i).sum(), "transition, row " + std::to_string(i));
  }
}

void check_mode_probabilities(const Eigen::Ref<const Eigen::VectorXd>& probabilities) {
  for (Eigen::Index i = 0; i < probabilities.size(); ++i) {
    check_probability(probabilities[i], "probabilities[" + std::to_string(i) + "]");
  }
  check_sum(probabilities.sum(), "probabilities");
}

}  // namespace soopnav::detail
