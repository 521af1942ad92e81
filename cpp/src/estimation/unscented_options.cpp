#include <cmath>
#include <stdexcept>
#include <string>

#include "soopnav/estimation/unscented_kalman_filter.hpp"

namespace soopnav {

void UnscentedOptions::check(int dim) const {
  if (!(alpha > 0.0) || std::isinf(alpha)) {
    throw std::invalid_argument("alpha: " + std::to_string(alpha) + ", above zero expected");
  }
  if (!std::isfinite(beta)) throw std::invalid_argument("beta: " + std::to_string(beta) + ", a finite number expected");
  if (!(dim + kappa > 0.0) || std::isinf(kappa)) {
    throw std::invalid_argument("kappa: " + std::to_string(kappa) + ", above -" + std::to_string(dim) + " expected");
  }
}

}  // namespace soopnav
