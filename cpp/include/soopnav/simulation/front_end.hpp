#pragma once

#include <complex>
#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/core/random.hpp"

/// Receivers of a few channels, with the faults that a calibration has to find (carter 2.2, 5.1-5.2).
namespace soopnav::simulation {

/// What is wrong with one channel. The defaults are a channel without fault.
struct ChannelErrors {
  std::complex<double> gain{1.0, 0.0};  ///< amplitude and phase of cable, amplifier and filter
  double phase_delay_rad = 0.0;         ///< of a phase shifter: the signal comes later, exp(-j phase)
  double iq_gain_db = 0.0;              ///< of Q over I
  double iq_phase_rad = 0.0;            ///< by which Q leads its right angle to I
  std::complex<double> dc{0.0, 0.0};    ///< offset of I and Q, full scale being 1
};

/// What all channels share.
struct FrontEndOptions {
  double sample_rate_hz = 20e6;  ///< noise bandwidth
  double noise_figure_db = 6.0;  ///< of the receiver behind the attenuator
  double attenuation_db = 0.0;   ///< wanted; whole steps attenuate, the rest is made by noise (carter 5.1)
  double attenuator_step_db = 1.0;
  double phase_step_rad = 0.0;           ///< of the phase shifters; 0 for any phase
  int adc_bits = 0;                      ///< 2 to 24 per part, 0 for no converter
  std::optional<double> full_scale_dbm;  ///< power of the tone that reaches 1.0; none: noise floor + 40 dB
};

/// Receivers in a row: attenuator, phase shifter, gain, thermal noise, quadrature mixer, converter.
///
/// Input: samples in root milliwatts, mean |x|^2 = power [mW] at the antenna. Output: full scale at 1.0.
/// For each sample x of a channel
///   y = gain exp(-j phase) 10^(-step / 20) x + w,   w white, of power noise_floor * 10^(rest / 10)
///   I' = Re y + Re dc,   Q' = g (Im y cos phi + Re y sin phi) + Im dc,   g = 10^(iq_gain_db / 20), phi = iq_phase_rad
/// so y' = (1 + g e^{j phi}) / 2 y + (1 - g e^{-j phi}) / 2 y^*: the second term is the image. The part of the
/// attenuation that the steps leave, `rest`, worsens the SNR as it should, by added noise, not the power. The converter
/// rounds to steps of 2^(1 - bits) and clips to [-1, 1 - 2^(1 - bits)].
class FrontEnd {
 public:
  /// @throws std::invalid_argument for no channel, values that are not finite, a rate or attenuator step that is not
  /// positive, a noise figure, attenuation or phase step below zero, adc_bits other than 0 and 2 to 24, an iq_phase_rad
  /// beyond +-1 rad.
  FrontEnd(std::vector<ChannelErrors> channels, const FrontEndOptions& options);

  /// A block of all channels in place, a row per channel. Substream m of `random` is the noise of channel m: pass
  /// another stream for another block. Returns how many parts were clipped; a NaN becomes 0 and counts, or stays NaN
  /// without a converter. Two normals per sample. Allocates nothing.
  /// @throws std::invalid_argument unless samples has channels * n elements.
  std::size_t apply(std::span<Cf32> samples, const RandomStream& random) const;

  [[nodiscard]] std::size_t channels() const noexcept { return channels_.size(); }
  [[nodiscard]] const FrontEndOptions& options() const noexcept { return options_; }
  /// k T0 F f_s [dBm] (carter 2.4), before the noise that stands for the attenuator's rest.
  [[nodiscard]] double noise_floor_dbm() const noexcept { return noise_floor_dbm_; }
  [[nodiscard]] double full_scale_dbm() const noexcept { return full_scale_dbm_; }
  /// What the attenuator's steps reach, and what is left to noise [dB].
  [[nodiscard]] double stepped_attenuation_db() const noexcept { return stepped_db_; }
  [[nodiscard]] double rest_attenuation_db() const noexcept { return options_.attenuation_db - stepped_db_; }
  /// The phase that the shifter of a channel is set to: the nearest step [rad].
  [[nodiscard]] double phase_delay_rad(std::size_t channel) const;

 private:
  std::vector<ChannelErrors> channels_;
  FrontEndOptions options_;
  double noise_floor_dbm_ = 0.0;
  double full_scale_dbm_ = 0.0;
  double stepped_db_ = 0.0;
};

/// Mixes a real radio-frequency signal to baseband: low-pass of 2 x(t) exp(-j (2 pi lo_hz t + lo_phase_rad)), every
/// `decimation`-th sample (carter 2.5-2.7). A signal at f_RF comes out at f_RF - lo_hz with its own amplitude; the sum
/// frequency is suppressed by 80 dB where it lies beyond 0.6 of the output's sampling rate. The band kept is 0.8 of the
/// output's. (2.7) prints f_LO - f_RF, which turns the spectrum round; (2.6) does not say.
/// Allocates.
/// @throws std::invalid_argument unless the rate is finite and positive, |lo_hz| below half of it, the phase finite and
/// decimation 2 to 1024.
[[nodiscard]] std::vector<Cf32> down_convert(std::span<const float> radio, double sample_rate_hz, double lo_hz,
                                             int decimation, double lo_phase_rad = 0.0);

}  // namespace soopnav::simulation
