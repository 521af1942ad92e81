#pragma once

namespace soopnav {

/// The distributions that gates and consistency tests read. None allocates, none throws: an argument outside the
/// stated range gives NaN.

/// Regularised lower incomplete gamma function P(a, x), a > 0, x >= 0 (NIST Digital Library 8.2.4); P(a, inf) = 1.
/// Series 8.11.4 below x = a + 1, continued fraction 8.9.2 above; relative error below 1e-13 for tails
/// above 1e-20 and 1e-11 at 1e-100, for a <= 1e4.
[[nodiscard]] double regularized_gamma_p(double a, double x) noexcept;

/// Its complement Q(a, x) = 1 - P(a, x), accurate in relative terms where P rounds to one.
[[nodiscard]] double regularized_gamma_q(double a, double x) noexcept;

/// Probability that a chi-square variable of `dof` > 0 degrees of freedom (whole or not) is at most `x` >= 0.
[[nodiscard]] double chi_square_cdf(double x, double dof) noexcept;

/// The value a chi-square variable of `dof` > 0 stays below with `probability` in [0, 1]; 1 gives infinity.
[[nodiscard]] double chi_square_quantile(double probability, double dof) noexcept;

/// The value it exceeds with `probability` in [0, 1]: the gate of a test that refuses good data with that probability.
/// Keeps its accuracy down to 1e-300, where 1 - probability would round to one.
[[nodiscard]] double chi_square_upper_quantile(double probability, double dof) noexcept;

/// The k > 0 for which a standard normal variable lies outside +-k with `probability` in (0, 1].
[[nodiscard]] double normal_two_sided_gate(double probability) noexcept;

}  // namespace soopnav
