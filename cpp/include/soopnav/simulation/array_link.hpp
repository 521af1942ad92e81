#pragma once

#include <complex>
#include <cstddef>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/dsp/fft.hpp"

/// What an array of antennas hears of radio emitters: powers, samples, sample covariances.
namespace soopnav::simulation {

/// The power of one emitter between its transmitter and the array's receivers (carter 5.1, figs. 5.4 and 5.8).
///
/// P_r = P_t + G_t + G_r - splitter - delay system - path loss - excess, path loss being free space. SNR is that of one
/// element over the whole front-end band: P_r over k T0 F f_s.
struct LinkBudget {
  double frequency_hz = 1575.42e6;    ///< carrier
  double sample_rate_hz = 20e6;       ///< of the front end; its noise bandwidth
  double noise_figure_db = 6.0;       ///< F
  double transmit_power_dbm = 10.0;   ///< P_t
  double transmit_gain_dbi = 0.0;     ///< G_t
  double receive_gain_dbi = 0.0;      ///< G_r
  double splitter_loss_db = 0.0;      ///< of a simulator's four-way splitter (carter 5.1)
  double delay_system_loss_db = 0.0;  ///< of a simulator's phase shifters (carter 5.1)
  double excess_loss_db = 0.0;        ///< polarisation, bodies, anything beyond free space

  /// @throws std::invalid_argument for a frequency or rate that is not finite and positive, a noise figure or a loss
  /// that is not finite and >= 0, a power or gain that is not finite.
  void check() const;
  /// P_r [dBm] at a distance [m]. @throws std::invalid_argument unless distance_m is finite and positive.
  [[nodiscard]] double received_power_dbm(double distance_m) const;
  /// k T0 F f_s [dBm] (carter 2.4).
  [[nodiscard]] double noise_floor_dbm() const;
  /// received_power_dbm - noise_floor_dbm.
  [[nodiscard]] double snr_db(double distance_m) const;
};

/// The distance beyond which waves are flat across an aperture D: the largest of 1.6 lambda, 2 D^2 / lambda and 5 D
/// (carter 4.1-4.3) [m]. (4.1) and (4.3) read "much greater": nearer than this the plane-wave model is wrong, a few
/// times as far it is right.
/// @throws std::invalid_argument unless aperture_m is finite and >= 0 and frequency_hz finite and positive.
[[nodiscard]] double far_field_limit_m(double aperture_m, double frequency_hz);

/// What an emitter sends, seen at baseband with unit mean power.
enum class Waveform {
  kNoise,  ///< circular Gaussian, white over `bandwidth_ratio` of the sampled band and nothing outside, about 0 Hz
  kTone,   ///< exp(j (2 pi tone_hz n / f_s + phase)), the phase drawn anew each time
};

/// One wave as the elements see it.
struct ArrivingWave {
  std::span<const std::complex<double>> steering;  ///< per element, at the carrier
  double amplitude = 1.0;                          ///< root of its mean power per sample at an element of unit steering
  /// Delay of the envelope per element [s], negative where the wave is early; empty when narrow-band. A noise wave is
  /// periodic in the block, and so is its delay.
  std::span<const double> delay_s = {};
};

/// Samples of an array, block by block: x_m[n] = sum_k amplitude_k a_km s_k[n - delay_km] + w_m[n] (carter 4.4-4.7).
///
/// The waves s_k are independent, the noise w is circular, white and independent between elements. A band-limited wave
/// is the sum of the round(bandwidth_ratio * samples) discrete tones nearest to 0 Hz with independent Gaussian
/// amplitudes: nothing outside the band, no start-up, power 1 in the mean. Cost: one normal per real number and an
/// inverse transform per band-limited wave (per element with delays). Allocates in the constructor only.
class ArrayRenderer {
 public:
  /// @throws std::invalid_argument unless elements is 1 to 1024, samples 1 to 2^24, bandwidth_ratio in (0, 1],
  /// tone_hz finite and sample_rate_hz finite and positive.
  ArrayRenderer(std::size_t elements, std::size_t samples, double sample_rate_hz, Waveform waveform = Waveform::kNoise,
                double bandwidth_ratio = 1.0, double tone_hz = 0.0);

  /// Writes elements x samples, a row per element. Substream 0 of `random` is the noise, substream k + 1 wave k: a wave
  /// does not change when others come or go.
  /// @throws std::invalid_argument for spans of another size, a noise variance that is not finite and >= 0.
  void render(std::span<const ArrivingWave> waves, double noise_variance, const RandomStream& random,
              std::span<Cf32> out);

  [[nodiscard]] std::size_t elements() const noexcept { return elements_; }
  [[nodiscard]] std::size_t samples() const noexcept { return samples_; }

 private:
  void draw_wave(RandomStream random);
  void delay_wave(double delay_s);

  std::size_t elements_;
  std::size_t samples_;
  double sample_rate_hz_;
  Waveform waveform_;
  double tone_hz_;
  std::size_t bins_;  // tones of a band-limited wave
  dsp::Fft inverse_;
  std::vector<Cf32> spectrum_;
  std::vector<Cf32> delayed_;
  std::vector<Cf32> wave_;
};

/// Draws sample covariances from their exact law: (1/N) sum_n x_n x_n^H of circular Gaussian snapshots with covariance
/// R has N times a complex Wishart law, drawn by Bartlett's decomposition L A A^H L^H, R = L L^H, A lower triangular
/// with A_ii^2 ~ Gamma(N - i) (i from 0) and standard complex normals below (Goodman 1963, Kshirsagar 1959); with
/// N < elements the snapshots themselves are drawn. elements^2 numbers in place of elements N. Allocates in the
/// constructor only.
class CovarianceSampler {
 public:
  /// @throws std::invalid_argument unless elements is 1 to 1024 and snapshots >= 1.
  CovarianceSampler(std::size_t elements, std::size_t snapshots);

  /// `covariance` and `out`: elements x elements, row by row; they may be the same. Positions of `random` are used up
  /// without a fixed number: give each draw a substream.
  /// False when the covariance is not positive definite (NaN included); `out` is then left alone.
  [[nodiscard]] bool draw(std::span<const std::complex<double>> covariance, RandomStream random,
                          std::span<std::complex<double>> out);

  /// The same for waves in unit noise: R = I + sum_k amplitude_k^2 a_k a_k^H (carter 4.11). Delays are left out.
  [[nodiscard]] bool draw(std::span<const ArrivingWave> waves, RandomStream random,
                          std::span<std::complex<double>> out);

  [[nodiscard]] std::size_t elements() const noexcept { return elements_; }
  [[nodiscard]] std::size_t snapshots() const noexcept { return snapshots_; }

 private:
  std::size_t elements_;
  std::size_t snapshots_;
  std::vector<std::complex<double>> factor_;   // L
  std::vector<std::complex<double>> product_;  // one column of A
  std::vector<std::complex<double>> column_;   // the same of L A
  std::vector<std::complex<double>> truth_;    // R of waves in noise
};

/// A draw from the Gamma law of a shape >= 1 and scale 1 (Marsaglia and Tsang 2000, exact).
[[nodiscard]] double gamma_variate(double shape, RandomStream& random) noexcept;

}  // namespace soopnav::simulation
