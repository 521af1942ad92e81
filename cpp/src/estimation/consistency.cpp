#include "soopnav/estimation/consistency.hpp"

#include <limits>

namespace soopnav {

MeanBounds mean_nees_bounds(double dof, int runs, double failure_probability) noexcept {
  if (!(dof > 0.0) || runs < 1 || !(failure_probability > 0.0 && failure_probability < 1.0)) {
    constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
    return {kNan, kNan};
  }
  const double total = dof * runs;
  return {chi_square_quantile(0.5 * failure_probability, total) / runs,
          chi_square_upper_quantile(0.5 * failure_probability, total) / runs};
}

}  // namespace soopnav
