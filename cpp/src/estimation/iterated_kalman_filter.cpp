#include "soopnav/estimation/iterated_kalman_filter.hpp"

#include <cmath>
#include <stdexcept>
#include <string>

namespace soopnav {

void IterationOptions::check() const {
  if (max_iterations < 1) {
    throw std::invalid_argument("max_iterations: " + std::to_string(max_iterations) + ", at least one expected");
  }
  if (!(tolerance > 0.0) || std::isinf(tolerance)) {
    throw std::invalid_argument("tolerance: " + std::to_string(tolerance) + ", above zero expected");
  }
}

}  // namespace soopnav
