#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace soopnav {

/// Least variances a filter may come to believe, per tangent component; zero where there is none.
///
/// A filter whose model is better than the world stops listening. The floor is added to the diagonal where the variance
/// fell below it (which keeps the covariance positive), and counted, so that one sees how much it was needed.
template <int Dim>
struct CovarianceFloor {
  using Vector = Eigen::Matrix<double, Dim, 1>;
  Vector variance = Vector::Zero();                                   ///< [units of the component squared]
  std::array<std::uint64_t, static_cast<std::size_t>(Dim)> counts{};  ///< how often each floor was applied
  bool active = false;

  template <class Square>
  void apply(Square& P) noexcept {
    if (!active) return;
    for (int i = 0; i < Dim; ++i) {
      if (P(i, i) < variance[i]) {
        P(i, i) = variance[i];
        ++counts[static_cast<std::size_t>(i)];
      }
    }
  }

  /// The square roots of what `variances` lack to the floor, for filters that keep no covariance: noise of these
  /// standard deviations is to be added. Counts each; true when there is any.
  [[nodiscard]] bool missing(const Vector& variances, Vector& sigma) noexcept {
    sigma.setZero();
    if (!active) return false;
    bool any = false;
    for (int i = 0; i < Dim; ++i) {
      if (!(variances[i] < variance[i] * (1.0 - 1e-12))) continue;  // beyond rounding
      sigma[i] = std::sqrt(variance[i] - variances[i]);
      ++counts[static_cast<std::size_t>(i)];
      any = true;
    }
    return any;
  }
};

}  // namespace soopnav
