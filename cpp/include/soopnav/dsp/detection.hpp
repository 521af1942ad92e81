#pragma once

/// Detection of a signal in complex white noise by its energy in M coherent sums: thresholds and probabilities.
///
/// A cell's statistic is T = sum_{k=1}^{M} |y_k|² / σ², y_k the coherent sums and σ² the noise's E|y_k|². Without a
/// signal T is of the gamma distribution of shape M; with one 2 T is non-central chi-square of 2 M degrees of freedom,
/// its non-centrality 2 S, S = sum |s_k|² / σ² (doc/gps_acquisition.md eqs. 5 to 7). Nothing here allocates or throws:
/// an argument outside the stated range gives NaN.
namespace soopnav::dsp {

/// Generalised Marcum Q function Q_M(a, b) = P(X > b²), X of the non-central chi-square distribution of 2 M degrees of
/// freedom and non-centrality a²; Q_1 is Marcum's own (Marcum 1960; Nuttall 1975).
///
/// For 1 <= M <= 1e6, a and b in [0, 1e5], b also infinite (0). The mixture of gamma tails by Poisson weights, summed
/// over the side that is small and away from cancellation (doc/gps_acquisition.md eq. 8): relative error below 1e-11
/// for results above 1e-280, tails included. O(sqrt(a b + M)) terms.
[[nodiscard]] double marcum_q(int m, double a, double b) noexcept;

/// Its complement 1 - Q_M(a, b), of the same relative accuracy where Q rounds to one.
[[nodiscard]] double marcum_q_complement(int m, double a, double b) noexcept;

/// Probability that noise alone leaves a cell of `sums` coherent sums above `threshold` >= 0:
/// exp(-t) sum_{k<M} t^k / k!. 1 <= sums <= 1e6.
[[nodiscard]] double false_alarm_probability(int sums, double threshold) noexcept;

/// The threshold whose false alarm in one cell is `probability` in (0, 1].
[[nodiscard]] double detection_threshold(int sums, double probability) noexcept;

/// Probability that a signal of energy S = sum |s_k|² / σ² >= 0 (SNR after the coherent sums, added over them) lifts
/// its cell above `threshold`: Q_M(sqrt(2 S), sqrt(2 t)).
[[nodiscard]] double detection_probability(int sums, double snr, double threshold) noexcept;

/// The false alarm that one of `cells` cells may have for one of them at all to rise with probability `total`:
/// 1 - (1 - total)^(1/cells).
///
/// Exact for independent cells. For correlated ones (oversampled code or frequency) the total is at most `total`: what
/// each cell stays in is convex and symmetric, and such sets are never less likely together than apart (Royen's
/// Gaussian correlation inequality, 2014). total in (0, 1), cells >= 1, not whole as well.
[[nodiscard]] double cell_false_alarm(double total, double cells) noexcept;

}  // namespace soopnav::dsp
