#pragma once

#include <cstddef>
#include <optional>

#include "soopnav/core/iq.hpp"
#include "soopnav/dsp/fractional_delay.hpp"

namespace soopnav::dsp {

/// A maximum between samples.
struct Peak {
  double offset_samples;  ///< from the centre sample, positive towards later ones
  double magnitude;       ///< |r| at the maximum
};

/// Which function of the magnitude a parabola is laid through.
enum class PeakScale {
  kMagnitude,  ///< |r|
  kPower,      ///< |r|^2
  kLog,        ///< ln |r|: exact for a Gaussian
};

/// What lies beyond the ends of a correlation.
enum class PeakBoundary {
  kZero,      ///< zeros
  kCircular,  ///< the other end: a correlation made by one FFT
};

/// Vertex of the parabola through three magnitudes at offsets -1, 0, +1, laid on the given scale.
///
/// Bias. For the correlation peak |sinc(b t)| of a signal that fills a fraction b of the sampling rate evenly, the
/// offset errs, at the worst true offset, by (samples)
///
/// | b    | kMagnitude | kPower | kLog  |
/// |------|------------|--------|-------|
/// | 0.25 | 0.0060     | 0.0162 | 0.0042 |
/// | 0.5  | 0.0251     | 0.0692 | 0.0208 |
/// | 0.9  | 0.1696     | 0.2398 | -      |
///
/// towards the centre sample on the first two scales, away from it on kLog, and zero by symmetry at offsets 0 and +-0.5
/// (doc/peak.md eq. 2). kLog fails where a neighbour can fall on a zero of the peak, b > 2/3. `refine_peak` has no such
/// bias.
///
/// Empty when a magnitude is negative or not finite, when the centre is below a neighbour, when all three are equal,
/// or on kLog when one is zero. Allocates nothing.
[[nodiscard]] std::optional<Peak> parabolic_peak(double left, double centre, double right,
                                                 PeakScale scale = PeakScale::kMagnitude) noexcept;

/// The same for the samples around `correlation[index]`. Empty also when `index` is outside the correlation.
[[nodiscard]] std::optional<Peak> parabolic_peak(IqSpan correlation, std::size_t index,
                                                 PeakScale scale = PeakScale::kMagnitude,
                                                 PeakBoundary boundary = PeakBoundary::kZero) noexcept;

/// Finds the maximum of |r(t)| near a sampled peak, r(t) being the band-limited interpolation of the complex samples.
///
/// The bias is that of the interpolation: for a correlation whose spectrum ends below `design.passband` it is below
/// 1e-4 samples with the default design while the signal fills at least a fifth of the rate (a flatter peak moves
/// more). Allocates nothing; const, so threads may share it.
class PeakRefiner {
 public:
  /// @throws std::invalid_argument when the design is out of range.
  explicit PeakRefiner(const SincDesign& design = {});

  /// `index`: a sample at least as large as its neighbours; the maximum is sought within one sample of it.
  /// Empty when `parabolic_peak` would be, or when the maximum leaves that interval.
  [[nodiscard]] std::optional<Peak> refine(IqSpan correlation, std::size_t index,
                                           PeakBoundary boundary = PeakBoundary::kZero) const noexcept;

  /// Samples on either side of the peak that are used.
  [[nodiscard]] std::size_t reach() const noexcept { return taps_ / 2; }

 private:
  std::size_t taps_;
  double attenuation_db_;
};

/// The index of the sample of largest magnitude, the first of equals; empty for no samples or when none is a number.
/// Samples that are not finite are passed over.
[[nodiscard]] std::optional<std::size_t> largest_sample(IqSpan samples) noexcept;

}  // namespace soopnav::dsp
