#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"

namespace soopnav::dsp {

/// Accuracy of a windowed-sinc interpolator.
struct SincDesign {
  /// Highest frequency to be kept exact, as a fraction of half the sampling rate, in (0, 0.99].
  double passband = 0.8;
  /// Error at every frequency up to `passband`, in dB below the signal, 20 to 110.
  double attenuation_db = 80.0;
};

/// Taps of a windowed-sinc interpolator of this design: the smallest even number that meets it (Kaiser window,
/// doc/resampling.md eq. 4). The default design has 30.
/// @throws std::invalid_argument when a field is outside its range.
[[nodiscard]] int sinc_tap_count(const SincDesign& design);

/// Coefficients of the windowed-sinc delay by `fraction` in [0, 1) samples beyond taps.size() / 2 - 1 whole ones:
/// sum_k taps[k] x[n - k] = x(n - (taps.size() / 2 - 1) - fraction) within the design's error.
/// `taps` has `sinc_tap_count(design)` elements. Allocates nothing.
/// @throws std::invalid_argument for another length, a fraction outside [0, 1) or a bad design.
void sinc_delay_taps(double fraction, const SincDesign& design, std::span<double> taps);

/// Coefficients of the Lagrange interpolator of order N = taps.size() - 1 in 1 .. 9 for a delay of `delay_samples`
/// counted from the first tap: sum_k taps[k] x[n - k] ~ x(n - delay_samples), exact for polynomials of degree N
/// (Laakso et al., Splitting the unit delay, 1996, eq. 42).
///
/// The error at angular frequency w [rad/sample] is at most w^(N+1) prod_k |delay_samples - k| / (N+1)!, relative to
/// the tone, and least when delay_samples lies within half a sample of N / 2. Half-way between samples order 3 errs by
/// -73 dB at a tenth of half the sampling rate and by -19 dB at half of it; order 9 by -95 dB at a quarter of it and
/// by -40 dB at half.
/// Allocates nothing.
/// @throws std::invalid_argument for another length or a delay that is not finite.
void lagrange_delay_taps(double delay_samples, std::span<double> taps);

/// A delay by any real number of samples: y[n] = x(n - delay_samples), x interpolated between its samples and zero
/// outside the capture.
///
/// `set_delay` changes the delay without allocating, for delays that drift. Whole-sample delays copy exactly.
/// Errors, relative to a tone at a fraction f of half the sampling rate:
/// - windowed sinc: at most 10^(-attenuation_db / 20) for f <= passband; it grows to 0 dB at f = 1;
/// - Lagrange of order N: at most (pi f)^(N+1) prod_k |d - k| / (N+1)!, d within half a sample of N / 2.
class FractionalDelay {
 public:
  /// @throws std::invalid_argument when the design is out of range or the delay is not finite or above 2^50.
  [[nodiscard]] static FractionalDelay windowed_sinc(double delay_samples, const SincDesign& design = {});
  /// @param order 1 (linear) to 9.
  /// @throws std::invalid_argument when the order is out of range or the delay is not finite or above 2^50.
  [[nodiscard]] static FractionalDelay lagrange(double delay_samples, int order);

  /// Changes the delay. False, and no change, when it is not finite or its magnitude is above 2^50.
  [[nodiscard]] bool set_delay(double delay_samples) noexcept;

  /// out[i] = y[first + i] = x(first + i - delay_samples), any range. Allocates nothing and is const: threads may share
  /// the object. `out` may not overlap `in`.
  void apply(IqSpan in, std::int64_t first, std::span<Cf32> out) const noexcept;

  [[nodiscard]] double delay_samples() const noexcept { return delay_; }
  /// y[n] = sum_k taps()[k] x[n - first_tap() - k].
  [[nodiscard]] std::span<const double> taps() const noexcept { return taps_; }
  [[nodiscard]] std::int64_t first_tap() const noexcept { return first_tap_; }

 private:
  FractionalDelay(std::size_t taps, bool lagrange, const SincDesign& design);

  SincDesign design_;
  bool lagrange_;
  double delay_ = 0.0;
  std::int64_t first_tap_ = 0;
  std::vector<double> taps_;
  std::vector<float> reversed_;  // the taps by ascending input time, as the kernel takes them
};

/// The capture delayed by `delay_samples`, as many samples as `in` has: y[n] = x(n - delay_samples).
/// @throws std::invalid_argument as `FractionalDelay::windowed_sinc`.
[[nodiscard]] std::vector<Cf32> delayed(IqSpan in, double delay_samples, const SincDesign& design = {});

}  // namespace soopnav::dsp
