#include "soopnav/estimation/least_squares.hpp"

#include <stdexcept>
#include <string>

namespace soopnav {

std::string_view to_string(SolveStatus status) noexcept {
  switch (status) {
    case SolveStatus::kConverged:
      return "converged";
    case SolveStatus::kAmbiguous:
      return "ambiguous";
    case SolveStatus::kTooFewMeasurements:
      return "too few measurements";
    case SolveStatus::kTooManyMeasurements:
      return "too many measurements";
    case SolveStatus::kRankDeficient:
      return "rank deficient";
    case SolveStatus::kNotConverged:
      return "not converged";
    case SolveStatus::kUndefined:
      return "undefined at the start";
    case SolveStatus::kNonFinite:
      return "not finite";
    case SolveStatus::kNotPositiveDefinite:
      return "covariance not positive definite";
  }
  return "unknown";
}

void LeastSquaresOptions::check() const {
  if (max_iterations < 1) {
    throw std::invalid_argument("max_iterations: " + std::to_string(max_iterations) + "; it must be at least 1");
  }
  if (!(step_tolerance > 0.0) || !std::isfinite(step_tolerance)) {
    throw std::invalid_argument("step_tolerance: " + std::to_string(step_tolerance) + "; it must be positive");
  }
  if (!(rank_tolerance > 0.0 && rank_tolerance < 1.0)) {
    throw std::invalid_argument("rank_tolerance: " + std::to_string(rank_tolerance) + "; it must lie between 0 and 1");
  }
  if (!(distinct_sigmas > 0.0) || !std::isfinite(distinct_sigmas)) {
    throw std::invalid_argument("distinct_sigmas: " + std::to_string(distinct_sigmas) + "; it must be positive");
  }
}

}  // namespace soopnav
