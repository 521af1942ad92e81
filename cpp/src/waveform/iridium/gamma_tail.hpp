#pragma once

namespace soopnav::iridium {

/// x with P(X > x) = `probability` for X of a gamma distribution with mean 1 and this shape (> 1), probability in
/// (0, 0.1]: by bisection on the continued fraction of the incomplete gamma function (Abramowitz and Stegun 6.5.31), to
/// 1e-9. No allocation.
[[nodiscard]] double gamma_tail_quantile(double shape, double probability) noexcept;

}  // namespace soopnav::iridium
