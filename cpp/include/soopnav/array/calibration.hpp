#pragma once

#include <complex>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "soopnav/core/iq.hpp"

/// What the channels of a front end do to a tone that reaches them all alike, and how it is undone (carter 5.2).
namespace soopnav::array {

/// What one channel makes of the true samples x = I + jQ:
///   y = (I + Re dc) + j (g (Q cos phi + I sin phi) + Im dc),   I + jQ = gain x.
struct ChannelCorrection {
  double iq_gain = 1.0;                 ///< g: amplitude of Q over that of I
  double iq_phase_rad = 0.0;            ///< phi: by which Q leads its right angle to I
  std::complex<double> dc{0.0, 0.0};    ///< offsets, in units of the samples
  std::complex<double> gain{1.0, 0.0};  ///< amplitude and phase relative to the reference channel

  /// Image over signal, (1 - g e^{-j phi}) / (1 + g e^{-j phi}): a tone gets an image this much smaller.
  [[nodiscard]] std::complex<double> image() const noexcept;
  /// Finite, g > 0, |phi| < 1.4 rad and a gain that is not 0: it can be undone.
  [[nodiscard]] bool valid() const noexcept;
};

/// Undoes a channel's faults in place: x from y, NaN staying NaN. Allocates nothing; about 0.3 ns per sample.
void apply_correction(const ChannelCorrection& correction, std::span<Cf32> samples) noexcept;

enum class CalibrationStatus : std::uint8_t {
  kOk,
  kTooFewSamples,  ///< fewer than 64, or fewer than four turns of the tone, or of its distance to half the sampling
                   ///< rate
  kNonFinite,      ///< NaN or infinity
  kDeadChannel,    ///< nothing but a constant, or 60 dB below the strongest
  kWeakTone,       ///< less than 10 dB over the rest of the channel
  kSaturated,      ///< the tone is cut off: its fundamental is higher than the largest sample
  kNoQuadrature,   ///< image within 6 dB of the tone: real samples, or channels of another tone
};

/// A lower-case phrase for reports.
[[nodiscard]] std::string_view to_string(CalibrationStatus status) noexcept;

/// What the tone said about one channel.
struct ChannelReport {
  ChannelCorrection correction;
  double tone_amplitude = 0.0;   ///< with the faults of I and Q undone, in units of the samples
  double tone_snr_db = 0.0;      ///< of the tone's power over what the fit leaves, per sample
  double residual_rms = 0.0;     ///< what the fit leaves, in units of the samples
  double image_sigma = 0.0;      ///< standard deviation of `image()`, for white noise
  double phase_sigma_rad = 0.0;  ///< of the phase of `gain`, the reference's included
};

struct CalibrationOptions {
  std::size_t reference = 0;  ///< the channel whose gain is 1
  double tolerance_hz = 0.0;  ///< how far the tone may lie off; 0: four turns per capture
};

struct CalibrationReport {
  CalibrationStatus status = CalibrationStatus::kTooFewSamples;
  int channel = -1;      ///< at fault, where one is
  double value = 0.0;    ///< of what was at fault: sample, samples, dB
  double tone_hz = 0.0;  ///< as found
  double tone_sigma_hz = 0.0;
  std::vector<ChannelReport> channels;  ///< empty unless kOk
};

/// Faults of `channels` channels from a tone that reaches them at once with the same phase (carter 5.2, fig. 5.7).
///
/// Least squares of the ellipse y_m[n] = a_m e^{j w n} + b_m e^{-j w n} + d_m over all samples, with one frequency w
/// for all channels, found near tone_hz by its spectrum and then by Gauss-Newton: maximum likelihood in white noise,
/// without the bias that moments of noisy ellipses have. With kappa = b / a^* the imbalance is g e^{-j phi} = (1 -
/// kappa) / (1 + kappa); I is left as it is, so the tone's own amplitude is a + b^*, and its ratios are the channels'
/// gains. Standard deviations for noise of variance s^2 per sample: s / (|a| sqrt n) of the image, s / (|a| sqrt n) of
/// a phase.
///
/// @param iq channels rows of n samples, one after the other.
/// @return a status; data at fault never throw. Cost: eight passes. Allocates.
/// @throws std::invalid_argument unless channels >= 1 divides the samples, reference < channels, sample_rate_hz is
/// finite and positive, 0 < |tone_hz| < sample_rate_hz / 2, tolerance_hz finite and >= 0.
[[nodiscard]] CalibrationReport calibrate(IqSpan iq, std::size_t channels, double sample_rate_hz, double tone_hz,
                                          const CalibrationOptions& options = {});

}  // namespace soopnav::array
