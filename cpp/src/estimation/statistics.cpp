#include "soopnav/estimation/statistics.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/estimation/chi_square.hpp"

namespace soopnav {
namespace {

void check_rows(const Eigen::Ref<const Eigen::MatrixXd>& errors, const char* name) {
  if (errors.rows() < 1 || errors.cols() < 1) {
    throw std::invalid_argument(std::string(name) + ": shape (" + std::to_string(errors.rows()) + ", " +
                                std::to_string(errors.cols()) + "); at least one row and one column expected");
  }
}

void check_probability(double probability, bool one_allowed) {
  if (probability > 0.0 && (probability < 1.0 || (one_allowed && probability == 1.0))) return;
  throw std::invalid_argument("probability: " + std::to_string(probability) + "; it must lie between 0 and 1");
}

}  // namespace

Eigen::VectorXd nees_series(const Eigen::Ref<const Eigen::MatrixXd>& errors,
                            const Eigen::Ref<const Eigen::MatrixXd>& covariances) {
  check_rows(errors, "errors");
  const Eigen::Index n = errors.cols();
  if (covariances.cols() != n || covariances.rows() != errors.rows() * n) {
    throw std::invalid_argument("covariances: shape (" + std::to_string(covariances.rows()) + ", " +
                                std::to_string(covariances.cols()) + "); (" + std::to_string(errors.rows() * n) + ", " +
                                std::to_string(n) + ") expected, a square for each row of errors");
  }
  Eigen::VectorXd values(errors.rows());
  for (Eigen::Index i = 0; i < errors.rows(); ++i) {
    const Eigen::VectorXd error = errors.row(i).transpose();
    const Eigen::MatrixXd P = covariances.middleRows(i * n, n);
    values[i] = nees(error, P).value_or(std::numeric_limits<double>::quiet_NaN());
  }
  return values;
}

Eigen::VectorXd rmse(const Eigen::Ref<const Eigen::MatrixXd>& errors) {
  check_rows(errors, "errors");
  return (errors.colwise().squaredNorm().transpose() / static_cast<double>(errors.rows())).cwiseSqrt();
}

double coverage(const Eigen::Ref<const Eigen::MatrixXd>& errors, const Eigen::Ref<const Eigen::MatrixXd>& covariances,
                double probability) {
  check_probability(probability, false);
  const Eigen::VectorXd values = nees_series(errors, covariances);
  const double limit = chi_square_quantile(probability, static_cast<double>(errors.cols()));
  return static_cast<double>((values.array() <= limit).count()) / static_cast<double>(values.size());
}

MeanBounds coverage_bounds(double probability, int runs, double failure_probability) noexcept {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  if (!(probability > 0.0 && probability < 1.0) || runs < 1 ||
      !(failure_probability > 0.0 && failure_probability < 1.0)) {
    return {kNan, kNan};
  }
  const double side = 0.5 * failure_probability;
  const double success = std::log(probability);
  const double failure = std::log1p(-probability);
  const auto mass = [&](int k) {
    return std::exp(std::lgamma(runs + 1.0) - std::lgamma(k + 1.0) - std::lgamma(runs - k + 1.0) + k * success +
                    (runs - k) * failure);
  };
  // From each end inwards while the tail outside stays within its half.
  int low = 0;
  for (double tail = mass(0); tail <= side && low < runs; tail += mass(++low)) {
  }
  int high = runs;
  for (double tail = mass(runs); tail <= side && high > 0; tail += mass(--high)) {
  }
  return {static_cast<double>(low) / runs, static_cast<double>(high) / runs};
}

double sample_circular_error_m(const Eigen::Ref<const Eigen::MatrixXd>& errors_m, double probability) {
  check_rows(errors_m, "errors_m");
  if (errors_m.cols() != 2) {
    throw std::invalid_argument("errors_m: " + std::to_string(errors_m.cols()) + " columns; two expected");
  }
  check_probability(probability, true);
  std::vector<double> radii(static_cast<std::size_t>(errors_m.rows()));
  for (std::size_t i = 0; i < radii.size(); ++i) {
    radii[i] = errors_m.row(static_cast<Eigen::Index>(i)).norm();
    if (!std::isfinite(radii[i])) return std::numeric_limits<double>::quiet_NaN();
  }
  const auto count = static_cast<double>(radii.size());
  const auto nth = static_cast<std::ptrdiff_t>(std::clamp(std::ceil(probability * count - 1e-9), 1.0, count)) - 1;
  std::nth_element(radii.begin(), radii.begin() + nth, radii.end());
  return radii[static_cast<std::size_t>(nth)];
}

}  // namespace soopnav
