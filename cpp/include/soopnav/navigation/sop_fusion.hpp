#pragma once

#include <Eigen/Core>
#include <span>

#include "soopnav/clock/oscillator.hpp"

/// What many receivers say about one source, brought to one time and made one (doc/signal_database.md).
namespace soopnav::navigation {

/// Estimate of N constant or slowly moving numbers at a time.
template <int N>
struct SopEstimate {
  double t_s = 0.0;                                                                  ///< any reference, one for all
  Eigen::Matrix<double, N, 1> value = Eigen::Matrix<double, N, 1>::Zero();           ///< N numbers
  Eigen::Matrix<double, N, N> covariance = Eigen::Matrix<double, N, N>::Identity();  ///< of their errors
  /// The errors are independent of those of every other estimate. Otherwise nothing is supposed about them.
  bool independent = true;
};

/// Offset [s] and drift [s/s] of a source's clock from system time, positive when ahead.
using SopClock = SopEstimate<2>;
/// ECEF position p_e [m].
using SopPosition = SopEstimate<3>;

/// Noise of a source's clock as known: ln(h0 / s) and ln(h-2 / Hz) with the covariance of their errors.
struct SopNoise {
  Eigen::Vector2d ln_h = Eigen::Vector2d::Zero();
  Eigen::Matrix2d ln_covariance = Eigen::Matrix2d::Zero();

  /// E[h] of log-normal coefficients, exp(ln h + variance / 2): what the covariance of a prediction grows by, exactly,
  /// for it is linear in h (doc/signal_database.md eq. 3). No allocation.
  [[nodiscard]] clock::Oscillator mean() const noexcept;
  /// Coefficients `sigmas` standard deviations above (negative: below) the stated. No allocation.
  [[nodiscard]] clock::Oscillator at_sigmas(double sigmas) const noexcept;
};

/// Brings a clock to another time, forwards or backwards (doc/signal_database.md eqs. 1, 2; pesyna eqs. 7 to 11):
/// value by offset + drift dt, covariance by the two-state clock of these coefficients. Backwards the error of the
/// estimate is that of readings about its time, not of a prediction. No allocation.
/// @returns false, and nothing has changed, unless dt and the result are finite and the coefficients finite and >= 0.
[[nodiscard]] bool move_clock(SopClock& clock, const clock::Oscillator& noise, double t_s) noexcept;

/// Ages something constant by a random walk of `variance_per_s` in each number, whichever way time goes. Instantiated
/// for N = 2, 3. No allocation.
/// @returns false, and nothing has changed, unless all is finite and the walk >= 0.
template <int N>
[[nodiscard]] bool age(SopEstimate<N>& estimate, double variance_per_s, double t_s) noexcept;

/// Squared Mahalanobis distance of two estimates of the same time, chi-square of N degrees of freedom when both are
/// honest (doc/signal_database.md eq. 9). With errors that may be correlated the sum of covariances is doubled, which
/// bounds that of the difference whatever the correlation. N = 2, 3. No allocation.
/// @returns infinity when the covariances' sum is not positive definite or something is not finite.
template <int N>
[[nodiscard]] double disagreement(const SopEstimate<N>& a, const SopEstimate<N>& b) noexcept;

/// Fuses two estimates of one time whose errors are independent: a += K (b - a), K = A (A + B)^-1, covariance in
/// Joseph form, which is the information form A^-1 + B^-1 without an inverse (eq. 5). N = 2, 3. No allocation.
/// @returns false, and `a` has not changed, unless A + B is positive definite and all is finite.
template <int N>
[[nodiscard]] bool fuse_independent(SopEstimate<N>& a, const SopEstimate<N>& b) noexcept;

/// Covariance intersection of two estimates of one time, whatever the correlation of their errors: the independent
/// fusion of A / w and B / (1 - w), with the w in [0, 1] of the least determinant (Julier and Uhlmann, American Control
/// Conference 1997; eqs. 7, 8). Never claims more than is true when A and B do not. N = 2, 3. No allocation.
/// @returns w, the weight of `a`; NaN, and `a` has not changed, as `fuse_independent`.
template <int N>
double intersect(SopEstimate<N>& a, const SopEstimate<N>& b) noexcept;

/// What became of a fusion.
enum class SopFusionStatus {
  kOk,
  kEmpty,      ///< no estimates
  kUnordered,  ///< times that do not rise or stand
  kUndefined,  ///< a covariance that is not positive definite, or numbers that are not finite
};

/// Fuses estimates of a clock, ordered by time, at `t_s` (doc/signal_database.md eqs. 4 to 8).
///
/// The independent ones by a Kalman filter forwards up to t_s and one backwards down to it: noise between two
/// contributions is common to all older ones, so that moving each to t_s by itself would count it once for each. Then
/// the others, each moved to t_s, by covariance intersection. A covariance is taken 1e-9 of its diagonal larger, so
/// that a semi-definite one does. O(n). No allocation.
[[nodiscard]] SopFusionStatus fuse_clocks(std::span<const SopClock> clocks, const clock::Oscillator& noise, double t_s,
                                          SopClock& out) noexcept;

/// Fuses estimates of something constant that ages by a random walk, as `fuse_clocks` does. N = 2 (ln h), 3
/// (position). No allocation.
template <int N>
[[nodiscard]] SopFusionStatus fuse_constants(std::span<const SopEstimate<N>> estimates, double variance_per_s,
                                             double t_s, SopEstimate<N>& out) noexcept;

/// Least variance of the drift that a clock with these coefficients lets anybody know at the end of a record of
/// `duration_s`, offset read without error: sqrt(S_f S_g) coth(T sqrt(S_g / S_f)) (doc/signal_database.md eq. 10).
/// Infinite duration gives what years of records give. No allocation; NaN unless h0 > 0, h-2 > 0 and the duration > 0.
[[nodiscard]] double least_drift_variance(const clock::Oscillator& noise, double duration_s) noexcept;

/// Least variance of ln h-2 from a record of `duration_s`, offset read without error: 4 / (pi T f0),
/// f0 = sqrt(h-2 / h0) (Whittle's likelihood; doc/signal_database.md eq. 11). No allocation; NaN as above.
[[nodiscard]] double least_ln_walk_variance(const clock::Oscillator& noise, double duration_s) noexcept;

}  // namespace soopnav::navigation
