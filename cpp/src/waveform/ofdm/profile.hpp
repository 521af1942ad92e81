#pragma once

#include <cstddef>

#include "soopnav/waveform/ofdm/numerology.hpp"

namespace soopnav::ofdm {

/// Correlation b(i; delta) = E[y(i) y*(i + N)] of a band-limited CP-OFDM stream of power 1 whose symbols start at
/// delta + k M, for any real delta (doc/ofdm.md eq. 7, 8): the prefix's indicator for whole delta, with tails that fall
/// as one over the distance squared else.
[[nodiscard]] double prefix_correlation(const Numerology& numerology, double i_minus_delta) noexcept;

/// Derivative of `prefix_correlation` by delta, a central difference.
[[nodiscard]] double prefix_correlation_slope(const Numerology& numerology, double i_minus_delta) noexcept;

/// Fisher information of the delay [1/samples^2] in the folded pairs of one symbol, taken as independent, at signal
/// share rho = SNR / (1 + SNR) (doc/ofdm.md eq. 12).
[[nodiscard]] double pair_information(const Numerology& numerology, double fraction, double rho) noexcept;

/// What the variance of the delay exceeds 1 / information by, because neighbouring pairs are not independent: J / H of
/// doc/ofdm.md eq. 14. Takes milliseconds; allocates.
void score_inflation(const Numerology& numerology, double fraction, const double* rho, std::size_t count,
                     double* inflation);

}  // namespace soopnav::ofdm
