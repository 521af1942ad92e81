#pragma once

#include <complex>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/simulation/channel.hpp"

/// Recording channels with a pulse or a stepped tone, and making LTE channels of the record (nielsen section 5).
namespace soopnav::simulation {

/// Transmitter, switch, receiver and converter of nielsen section 5, figures 59, 63 and 64.
struct SounderOptions {
  double pulse_s = 100e-9;           ///< between the half heights; its spectrum has nulls at multiples of 1 / pulse
  double rise_s = 0.0;               ///< of either edge
  double period_s = 10e-6;           ///< 10 us: lines every 100 kHz (figure 62); the text also says 0.1 ms: 10 kHz
  double sample_rate_hz = 100e6;     ///< of the scope, real samples
  double if_hz = 20e6;               ///< the pulse's carrier at the scope
  double filter_hz = 24e6;           ///< -3 dB bandwidth of the receiver's filter (Butterworth, 4 poles about the IF)
  int averages = 1000;               ///< periods added up
  int calibration_averages = 16000;  ///< the same of the cable that replaces the channel once
  double snr_db = 40.0;              ///< strongest line over the noise in a line, one period, channel of reference gain
  double reference_gain = 1.0;       ///< channel amplitude that `snr_db` and the converter's scale are set for
  int adc_bits = 14;                 ///< 2 ... 24; 0: none
  double headroom = 4.0;             ///< converter's full scale over the pulse's peak at the reference gain
  double guard_s = 1e-3;             ///< wait after switching the transmitter's port
  double switch_time_s = 50e-6;      ///< by which the port before fades by e
  double isolation_db = 80.0;        ///< between ports, in the end
  double phase_noise_rad = 0.005;    ///< of the synthesizers, white from period to period
  bool shared_reference = true;      ///< one 10 MHz TCXO for both ends, as nielsen builds it; else they drift apart:
  double clock_rad_per_sqrt_s = 7.5;  ///< ... by this random walk: a TCXO of 6e-10 at 2 GHz
  std::uint64_t seed = 0;
};

/// What a record went through.
struct SoundingReport {
  std::size_t clipped = 0;  ///< samples beyond the converter's scale
  double time_s = 0.0;      ///< when the averages began, since slot 0 was switched on
  bool finite = true;       ///< false: a tap of the active port is NaN or infinite; the lines are then zero
};

/// A pulse transmitter with up to some switched ports, and the receiver that records its lines.
///
/// Model:  r[n] = Re{ sum_m S(f_m) F(f_m) H(f_m) e^{j 2 pi (f_if + f_m) n / f_s + j phi_p} } + noise,   f_m = m /
/// period
///         S = pulse / period sinc(f pulse) sinc(f rise); averaged over periods p; lines by DFT (doc/sounding.md).
///         H holds the active port, the others at the isolation, and what is left of the port before after the guard.
/// Slots follow each other: guard, averages, next port. A slot's numbers depend on (seed, slot) alone.
class ChannelSounder {
 public:
  /// @throws std::invalid_argument naming the option: period * sample rate and period * IF must be whole numbers, the
  /// band about the IF must fit between 0 and half the sample rate, numbers positive.
  explicit ChannelSounder(const SounderOptions& options);

  [[nodiscard]] const SounderOptions& options() const noexcept { return options_; }
  /// Frequencies of the lines against the carrier, rising, from -IF to IF (ends left out) [Hz].
  [[nodiscard]] std::span<const double> line_hz() const noexcept { return line_hz_; }
  /// S F of each line without noise.
  [[nodiscard]] std::span<const std::complex<double>> lines() const noexcept { return lines_; }
  /// E|noise|^2 of a recorded line, converter included.
  [[nodiscard]] double line_noise_variance(int averages) const noexcept;
  /// Duration of a slot: guard and averages [s].
  [[nodiscard]] double slot_s() const noexcept { return options_.guard_s + options_.averages * options_.period_s; }

  /// Lines received in slot `slot` with port `active` on; `ports` are the channels of all of them. Allocates nothing.
  /// `lines` has the size of `line_hz()`.
  /// @throws std::invalid_argument for sizes that do not fit.
  SoundingReport record(std::span<const std::vector<Tap>> ports, std::size_t active, std::uint64_t slot,
                        std::span<std::complex<double>> lines);

  /// Lines over a cable in the channel's place: reference gain, no delay. What a record is divided by. As `record`.
  SoundingReport calibrate(std::span<std::complex<double>> lines);

 private:
  SoundingReport receive(int averages, RandomStream random, std::span<std::complex<double>> lines);
  SounderOptions options_;
  std::size_t samples_ = 0;  // per period
  std::size_t if_bin_ = 0;
  double noise_sigma_ = 0.0;
  double full_scale_ = 0.0;
  std::vector<double> line_hz_;
  std::vector<std::complex<double>> lines_, sent_, turns_, analytic_;
  std::vector<double> sum_, noise_;
};

/// A tone that steps through frequencies (nielsen 5.1, first mode).
struct SweepOptions {
  int averages = 64;     ///< samples per tone and place
  double snr_db = 40.0;  ///< of one sample at the reference gain
  double reference_gain = 1.0;
  int adc_bits = 14;               ///< of each part; 0: none
  double headroom = 4.0;           ///< full scale over the reference gain
  bool reference_channel = false;  ///< a cable of gain 1 is measured under each lock: then phases are known
};

/// Measures `channel`, places x tones row by row, into `gain`. Both synthesizers lose their phase at each retune, so
/// column f carries one unknown phase: coherent from place to place, meaningless from tone to tone, unless a reference
/// channel is measured under the same lock and divided by. Draws from (seed, tone). Allocates nothing. A channel that
/// is not finite gives 0.
/// @throws std::invalid_argument for sizes that do not fit and options out of range.
void step_sweep(std::span<const std::complex<double>> channel, std::size_t tones, const SweepOptions& options,
                std::uint64_t seed, std::span<std::complex<double>> gain);

struct EmulatorOptions {
  double bandwidth_hz = 18e6;    ///< the channel that is wanted, 1 ... 20 MHz: twice its highest frequency
  double delay_low_s = -100e-9;  ///< taps lie between these
  double delay_high_s = 1.4e-6;
  double null_db = -35.0;         ///< weaker lines of the reference than the strongest by more are not used
  double noise_to_signal = 1e-8;  ///< line's noise over the strongest line's power at the channel's mean gain
};

/// Channels of any bandwidth from recorded lines: the regularised division by the pulse's spectrum (doc/sounding.md).
///
///     y_m = S_m sum_d h_d e^{-j 2 pi f_m t_d} + noise   ->   h = (A^H A + D noise_to_signal max|S|^2 I)^-1 A^H y
///
/// over the lines in the band and 3 MHz (or a tenth) beyond it, so that the wanted band's edges are no edges of the
/// fit. The taps lie 1.25 times closer than the width of those lines resolves: paths between them are met. Lines in a
/// null are named, not divided by.
class ChannelEmulator {
 public:
  /// @throws std::invalid_argument naming the option, when lines and reference differ in size or are not finite, when
  /// the delays do not fit into a period of the lines, or when fewer than three lines are left.
  ChannelEmulator(std::span<const double> line_hz, std::span<const std::complex<double>> reference,
                  const EmulatorOptions& options);
  ~ChannelEmulator();
  ChannelEmulator(ChannelEmulator&&) noexcept;
  ChannelEmulator& operator=(ChannelEmulator&&) noexcept;

  [[nodiscard]] std::span<const double> delays_s() const noexcept;  ///< of the taps
  [[nodiscard]] std::span<const double> nulls_hz() const noexcept;  ///< lines below `null_db`, wherever they lie
  [[nodiscard]] std::size_t lines_used() const noexcept;
  /// The usable lines reach both ends of the band. Otherwise what lies beyond them is guessed, as `sigma` says.
  [[nodiscard]] bool covered() const noexcept;
  /// Relative 1-sigma of the emulated channel at a frequency, from the lines' noise and the taps' prior; near 1 where
  /// nothing is known. Allocates nothing.
  [[nodiscard]] double sigma(double frequency_hz) const noexcept;
  /// Gains of the taps from recorded lines. False, and zeros, for lines that are not finite. Allocates nothing.
  /// @throws std::invalid_argument for sizes that do not fit.
  [[nodiscard]] bool taps(std::span<const std::complex<double>> lines, std::span<std::complex<double>> gain) const;

 private:
  struct Solver;
  std::unique_ptr<Solver> solver_;
};

}  // namespace soopnav::simulation
