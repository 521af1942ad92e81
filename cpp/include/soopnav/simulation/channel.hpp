#pragma once

#include <complex>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/dsp/fractional_delay.hpp"
#include "soopnav/dsp/resample.hpp"

/// What happens to a signal between transmitter and file. Never linked by a receiver.
///
/// Every parameter here is set-up: one out of range throws std::invalid_argument that names it, its value and the rule.
namespace soopnav::simulation {

// ---- Power and noise

/// The power ratio 10^(decibels / 10).
[[nodiscard]] double power_ratio(double decibels) noexcept;

/// 10 log10(ratio); -infinity for 0, NaN below.
[[nodiscard]] double decibels(double ratio) noexcept;

/// Mean of |x|^2 over the samples, summed in double; 0 for none.
[[nodiscard]] double mean_power(IqSpan samples) noexcept;

/// Noise variance E|n|^2 per complex sample that stands `snr_db` below a signal of `signal_power` = E|x|^2 per sample.
/// @throws std::invalid_argument unless signal_power >= 0 and both are finite.
[[nodiscard]] double noise_variance_for_snr(double signal_power, double snr_db);

/// Noise variance per complex sample that gives `snr_db` in each OFDM resource element of power `element_power`.
///
/// With X = sqrt(g / N) sum_n x[n] exp(-j 2 pi k n / N), white noise of variance s^2 per sample has g s^2 per element.
/// `transform_gain` is that g: 1 for the unitary transform, N for the unscaled one, 1 / N for the one divided by N.
/// `element_power` is measured behind the same transform. With LTE cells of `synthesize` (unitary, |X| = 1 at CRS
/// elements for 0 dB) both defaults apply. It holds for noise white over the sampled band; resampling afterwards from
/// rate a to rate b keeps the density, so the variance per sample changes by b / a.
/// @throws std::invalid_argument unless element_power >= 0, transform_gain > 0 and all are finite.
[[nodiscard]] double noise_variance_for_element_snr(double snr_db, double element_power = 1.0,
                                                    double transform_gain = 1.0);

/// Adds circular white Gaussian noise of variance E|n|^2 = `variance` per sample (half in each part). Draws two numbers
/// per sample from `random` whatever the variance. Allocates nothing.
/// @throws std::invalid_argument unless variance is finite and >= 0.
void add_awgn(std::span<Cf32> samples, double variance, RandomStream& random);

// ---- Frequency and clocks

/// Moves the carrier: samples[n] *= exp(j (2 pi cfo_hz (first_sample + n) / sample_rate_hz + phase_rad)).
///
/// A positive `cfo_hz` moves the spectrum up. The phase is kept in double and without accumulation, so a long capture
/// may be done in parts that give the bits of the whole to single precision. Allocates nothing.
/// @throws std::invalid_argument unless the rate is positive and all are finite.
void apply_cfo(std::span<Cf32> samples, double cfo_hz, double sample_rate_hz, double phase_rad = 0.0,
               std::int64_t first_sample = 0);

/// What a receiver samples of a transmitter whose clock is off: y[m] = x(m (1 + 1e-6 clock_error_ppm)), x being the
/// samples of a true transmitter, zero outside.
///
/// Positive when the transmitter's clock runs fast relative to the receiver's: it sends its frames in less time, so
/// they are short in samples, and delays counted from sample 0 shrink. The carrier is not moved (`apply_cfo` does
/// that): a transmitter with one crystal for both adds cfo_hz = 1e-6 clock_error_ppm carrier_hz. `start_samples` is the
/// input time of output 0. One output for every time before the input's end. Allocates.
/// @throws std::invalid_argument unless |clock_error_ppm| <= 1000, and as `dsp::Resampler::arbitrary`.
[[nodiscard]] std::vector<Cf32> apply_clock_error(IqSpan samples, double clock_error_ppm,
                                                  const dsp::ResampleDesign& design = {}, double start_samples = 0.0);

// ---- Multipath

/// One path of a channel.
struct Tap {
  double delay_s = 0.0;                 ///< later by this much; any real, negative is earlier
  std::complex<double> gain{1.0, 0.0};  ///< at baseband, the carrier's phase -2 pi f delay included
};

/// The sum over paths of gain * x(t - delay): as many samples as came in, zero before the first and after the last.
///
/// Delays are exact to the design's error (80 dB below the signal up to 0.8 of half the sampling rate by default);
/// whole samples are exact copies. No taps give silence. Allocates.
/// @throws std::invalid_argument unless the rate is positive and every delay and gain is finite, and as
/// `dsp::FractionalDelay::windowed_sinc`.
[[nodiscard]] std::vector<Cf32> apply_taps(IqSpan samples, double sample_rate_hz, std::span<const Tap> taps,
                                           const dsp::SincDesign& design = {});

// ---- The converter

/// Multiplies so that the samples' root mean square |x| is `rms`; silence stays silence. Returns the factor (1 then).
/// @throws std::invalid_argument unless rms is finite and > 0.
double scale_to_rms(std::span<Cf32> samples, double rms);

/// Rounds to signed 8-bit pairs as `ci8` files hold them: round(x * 127 / full_scale), halves to even, real part first.
///
/// Beyond full scale clips to +-127 (-128 is not used, so the converter is symmetric); a NaN becomes 0 and counts as
/// clipped. `out` has 2 * samples.size() elements. Returns how many parts were clipped. Allocates nothing. The rounding
/// adds noise of (full_scale / 127)^2 / 6 per complex sample.
/// @throws std::invalid_argument unless full_scale is finite and > 0 and `out` has that size.
std::size_t quantize_ci8(IqSpan samples, double full_scale, std::span<std::int8_t> out);

/// The samples that `quantize_ci8` stands for: value * full_scale / 127. Allocates.
/// @throws std::invalid_argument unless full_scale is finite and > 0 and `pairs` has an even size.
[[nodiscard]] std::vector<Cf32> dequantize_ci8(std::span<const std::int8_t> pairs, double full_scale);

}  // namespace soopnav::simulation
