#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "soopnav/waveform/ofdm/correlator.hpp"

namespace soopnav::ofdm {

/// Line of sight beside one reflection.
struct TwoRayBoundary {
  BoundaryStatus status = BoundaryStatus::kNoBoundary;
  double range_m = 0.0;  ///< line of sight: c boundary / f_s, within the reach of the prediction, not wrapped
  double sigma_m = 0.0;  ///< its standard deviation
  double extra_m =
      0.0;  ///< what the reflected path is longer by, modulo the ambiguity, in 0 .. ambiguity; 0 with one ray
  double strength = 0.0;  ///< amplitude of the reflection over the line of sight's; 0 with one ray
  double likelihood_ratio =
      0.0;                ///< log-likelihood of two rays minus that of the best single one, dependent pairs discounted
  bool two_rays = false;  ///< whether a second ray is wanted
};

struct TwoRayOptions {
  double reach_samples = 3.0;  ///< the line of sight lies so close to its prediction; 0.25 to 8
  double snr_db = 30.0;        ///< per sample; 0 to 40. Noise far above it makes reflections of noise
  double sigma_floor_m = 1.5;  ///< of two rays: what templates without the rays' common phase miss
};

/// Times of two rays from the folded differences of an epoch (doc/ofdm.md eq. 15 to 17).
///
/// Model:  E e(i) = 2 K (1 - rho R(i)),
///         R = [(1 - w) b(i - delta) + w b(i - tau) + q x(i; delta, tau)] / (1 + q sinc(delta - tau)),
///         w = A^2 / (1 + A^2), q = 2 A cos(phase) / (1 + A^2), A the reflection's amplitude over the line of sight's.
/// delta is sought within `reach_samples` of the prediction, tau about the correlator's top and about the top beside
/// the predicted ray, A^2 from 1/8 to 6, first without the cross-term x; then all four in turn, to 1/16 sample. The
/// range is the mean, sigma the spread, of the likelihood over delta with the others profiled, flattened for dependent
/// pairs, and a floor. The prediction picks the window and nothing more: the range does not lean on it. Rays N or 2 N
/// samples apart (959 m, 1919 m by default) also correlate with each other's prefix, which the model leaves out: within
/// about half a sample of that the range may err up to the reach. One call takes some thousand sums over M; it
/// allocates nothing. One object serves one thread at a time.
class TwoRayTiming {
 public:
  /// @throws std::invalid_argument for a bad numerology, symbols outside 1 .. 2^20, more than 256 samples per symbol,
  /// or an
  ///         option outside its range.
  TwoRayTiming(const Numerology& numerology, int symbols, const TwoRayOptions& options = {});

  /// `folded`: M numbers as of `BoundaryEstimator::folded_differences`. `predicted_m`: of the line of sight, any real;
  /// `sigma_m` widens the reach to 3 sigma, up to 8 samples. kNonFinite for numbers that are not finite or negative,
  /// kTooShort for another length than M, kNoSignal for all zero; kNoBoundary when the best fit is a single ray outside
  /// the reach, its `range_m` then 0.
  [[nodiscard]] TwoRayBoundary estimate(std::span<const double> folded, double predicted_m, double sigma_m) noexcept;

  [[nodiscard]] const Numerology& numerology() const noexcept { return numerology_; }
  [[nodiscard]] const TwoRayOptions& options() const noexcept { return options_; }

 private:
  [[nodiscard]] const float* row(int sixteenths) const noexcept;
  [[nodiscard]] double cost(int delta, int tau, double share) const noexcept;
  [[nodiscard]] double cost(int delta, int tau, double share, double cos_phase) noexcept;
  void set_cross(int delta, int tau) noexcept;

  Numerology numerology_;
  double symbols_;
  TwoRayOptions options_;
  std::size_t period_;
  float floor_;
  std::vector<float> gap_;                // [16 fractions][2 M], 2 rho (1 - b)
  std::vector<double> sine_, cotangent_;  // sin(pi t) and sin(pi t) cot(pi t / M) at sixteenths, 0 <= t < 2 M
  std::vector<float> e_;
  std::vector<double> window_;
  std::vector<double> cross_;  // sinc(delta - tau) - x(i)
  std::vector<float> mixed_;
  double rays_sinc_ = 0.0;
  int cross_delta_ = -1, cross_tau_ = -1;
};

}  // namespace soopnav::ofdm
