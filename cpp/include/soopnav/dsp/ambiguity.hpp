#pragma once

#include <cstddef>
#include <limits>
#include <memory>
#include <span>

#include "soopnav/core/iq.hpp"

namespace soopnav::dsp {

/// How the two recordings are filtered before they are multiplied (doc/ambiguity.md section 4).
enum class AmbiguityPrefilter {
  kNone,                   ///< the decimator's band, about 1.3 times the signal's
  kBox,                    ///< the signal's occupied band, flat
  kRootRaisedCosine,       ///< the stated root raised cosine on each side: matched, but blind to the SNR
  kMaximumLikelihood = 3,  ///< H / sqrt(1 + (g1 + g2) H^2) on each side, H^2 the signal's spectrum
};

/// What came of a pair of recordings.
enum class AmbiguityStatus {
  kOk,              ///< a common signal was found; delay and Doppler hold
  kNotDetected,     ///< no peak above the threshold, or a search too long of a band that does not stand out
  kTone,            ///< what the recordings share is a tone, steady or keyed, whose delay cannot be seen
  kIdentical,       ///< the same samples up to a constant: the delay is zero and says nothing
  kTooShort,        ///< fewer than `CrossAmbiguity::min_samples()` samples, or none
  kTooLong,         ///< more than `max_samples`
  kLengthMismatch,  ///< the recordings are not equally long
  kNotFinite,       ///< a sample is NaN or infinite
  kNoPower,         ///< a recording holds only zeros
};

/// "ok", "not detected", ...: the status in words, as errors and `repr` have it.
[[nodiscard]] const char* to_string(AmbiguityStatus status) noexcept;

/// What is known of a pair of recordings before it is measured.
struct AmbiguityOptions {
  double sample_rate_hz = 0.0;
  std::size_t max_samples = 0;  ///< of either recording, 64 to 2^26

  double max_delay_s = 20e-6;    ///< delays searched to either side of `delay_center_s`; below half the recording
  double max_doppler_hz = 40e3;  ///< frequency differences searched to either side of `doppler_center_hz`
  double delay_center_s = 0.0;
  double doppler_center_hz = 0.0;

  /// Occupied two-sided bandwidth of the signal, 0: found from the spectra (needs more than the band's own SNR, see
  /// doc/ambiguity.md section 2). Up to the sample rate.
  double bandwidth_hz = 0.0;
  /// Where the signal lies in each recording, relative to its centre; NaN: found from the spectra.
  double center_a_hz = std::numeric_limits<double>::quiet_NaN();
  double center_b_hz = std::numeric_limits<double>::quiet_NaN();
  /// Root-raised-cosine symbols: rate (0: not known; the spectrum is then estimated) and roll-off in [0, 1].
  double symbol_rate_hz = 0.0;
  double rolloff = 0.4;

  AmbiguityPrefilter prefilter = AmbiguityPrefilter::kMaximumLikelihood;
  double false_alarm = 1e-3;  ///< probability that noise alone is called a signal, in (0, 0.5]

  /// Carrier frequency on the air. When positive, delay and Doppler are one motion and one oscillator: the delay
  /// changes by -fdoa / carrier_hz seconds per second, and that stretch is taken out.
  double carrier_hz = 0.0;
  /// d tdoa / dt [s/s] that is taken out besides: a's clock faster than b's by this much. |rate| <= 1e-2.
  double tdoa_rate = 0.0;
  /// Estimates what is left of the rate as a third unknown (long recordings).
  bool estimate_rate = false;
  /// Rates searched to either side of `tdoa_rate` when `estimate_rate` is set.
  double max_tdoa_rate = 5e-6;

  bool reject_tones = true;  ///< subtract steady narrow lines of either recording first
};

/// Delay and Doppler between two recordings of one signal.
struct AmbiguityPeak {
  AmbiguityStatus status = AmbiguityStatus::kTooShort;

  double tdoa_s = 0.0;     ///< arrival in a minus arrival in b: positive when a is later
  double fdoa_hz = 0.0;    ///< frequency in a minus frequency in b: positive when a is higher
  double tdoa_rate = 0.0;  ///< d tdoa / dt that was taken out [s/s]
  double phase_rad = 0.0;  ///< of a against b at `epoch_s`, in (-pi, pi]

  double sigma_tdoa_s = std::numeric_limits<double>::infinity();
  double sigma_fdoa_hz = std::numeric_limits<double>::infinity();
  double sigma_tdoa_rate = std::numeric_limits<double>::infinity();  ///< of a rate estimated
  double correlation = 0.0;  ///< of the two errors; covariance = correlation * sigma_tdoa_s * sigma_fdoa_hz

  double epoch_s = 0.0;  ///< instant in b, from its first sample, that tdoa_s and fdoa_hz hold for: the burst's middle
  double start_s = 0.0;  ///< the burst in b, from its first sample
  double duration_s = 0.0;
  double center_a_hz = 0.0;  ///< middle of the signal's band in a, relative to its centre
  double center_b_hz = 0.0;
  double bandwidth_hz = 0.0;  ///< occupied band that was used

  double snr_db = 0.0;        ///< post-correlation: |peak|^2 over the mean of |noise|^2 beside it
  double threshold_db = 0.0;  ///< what snr_db must exceed for `false_alarm` over the region searched
  double snr_a_db = 0.0;      ///< signal over noise within the signal's equivalent band (of its spectrum's square)
  double snr_b_db = 0.0;
  double coherence = 0.0;  ///< |<a, b>| / sqrt(<a, a> <b, b>) at the peak, prefiltered; in [0, 1]
  std::size_t tones = 0;   ///< lines subtracted from the two recordings

  [[nodiscard]] bool detected() const noexcept { return status == AmbiguityStatus::kOk; }
  [[nodiscard]] bool identical() const noexcept { return status == AmbiguityStatus::kIdentical; }
};

/// Cross-ambiguity of two recordings of one unknown signal: delay (TDOA) and Doppler (FDOA) of a against b.
///
/// Model (Stein 1981, Algorithms for ambiguity function processing; mei slides 9-11):
///   b(t) = s(t) + noise,   a(t) = A s(t - tdoa(t)) exp(j 2 pi fdoa t) + noise,   tdoa(t) = tdoa_s + tdoa_rate (t -
///   epoch)
/// both with the same sample rate and start; doc/ambiguity.md has the derivations.
///
/// Method. The band is found in each spectrum, each side is mixed from its own centre to zero and decimated, steady
/// lines are subtracted, noise around the burst is cut away; the search is few lags x FFT over Doppler, or FFT over
/// delay x Doppler bins, whichever costs less; the peak is then refined off the grid by Newton steps on the likelihood,
/// with the prefilter weighted by the SNR that the data show. The covariance is the stochastic bound at the coherence
/// measured (doc/ambiguity.md eq. 9), which is Stein's at high SNR, and larger near the threshold (eq. 10).
///
/// Cost: about 0.8 ms for 90 ms at 250 ksps and +-20 us x +-40 kHz. The constructor allocates, `measure` does not (see
/// `Fft` for transforms above 2^18 points). One object serves one thread at a time.
class CrossAmbiguity {
 public:
  /// @throws std::invalid_argument for an option outside its range, naming it.
  explicit CrossAmbiguity(const AmbiguityOptions& options);
  ~CrossAmbiguity();
  CrossAmbiguity(CrossAmbiguity&&) noexcept;
  CrossAmbiguity& operator=(CrossAmbiguity&&) noexcept;
  CrossAmbiguity(const CrossAmbiguity&) = delete;
  CrossAmbiguity& operator=(const CrossAmbiguity&) = delete;

  /// Measures a pair of recordings. Anything wrong with them gives a status; the numbers are finite, and sigma is
  /// infinite unless the status is kOk. At kNotDetected tdoa_s and fdoa_hz are the best candidate: not a measurement.
  [[nodiscard]] AmbiguityPeak measure(IqSpan a, IqSpan b) noexcept;

  /// |C(tau, f)|^2 / (<a, a> <b, b>) of the recordings measured last, with the coarse prefilter and the rate taken out,
  /// for drawing: out[i * doppler.size() + k] at delays_s[i], doppler_hz[k]. False, and nothing written, when nothing
  /// was measured (a status from kTooShort on) or `out` has another size. Cost: one pass per cell.
  [[nodiscard]] bool surface(std::span<const double> delays_s, std::span<const double> doppler_hz,
                             std::span<double> out) noexcept;

  [[nodiscard]] const AmbiguityOptions& options() const noexcept;
  [[nodiscard]] std::size_t min_samples() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Bounds of TDOA and FDOA.
struct TdoaFdoaBound {
  double sigma_tdoa_s;
  double sigma_fdoa_hz;
};

/// Shape of a spectrum of unit noise bandwidth, for its root-mean-square width.
enum class SpectrumShape {
  kFlat,          ///< beta_rms = pi B / sqrt(3)
  kRaisedCosine,  ///< the power spectrum of root-raised-cosine symbols at rate B, with a roll-off
};

/// Stein's bound (IEEE ASSP-29, 1981, pp. 588-599) for a burst of duration T and constant envelope:
///   sigma_tdoa = 1 / (beta sqrt(B T g)),  sigma_fdoa = 1 / (T_e sqrt(B T g)),  1/g = (1/g1 + 1/g2 + 1/(g1 g2)) / 2
/// with beta = 2 pi rms bandwidth and T_e = pi T / sqrt(3).
/// @param bandwidth_hz  noise bandwidth B the SNRs refer to (symbol rate for kRaisedCosine)
/// @param duration_s    T
/// @param snr_a, snr_b  power ratios g1, g2
/// @throws std::invalid_argument unless all are finite and positive and the roll-off lies in [0, 1].
[[nodiscard]] TdoaFdoaBound stein_bound(double bandwidth_hz, double duration_s, double snr_a, double snr_b,
                                        SpectrumShape shape = SpectrumShape::kFlat, double rolloff = 0.4);

/// The bound when the signal is Gaussian and unknown (Knapp & Carter 1976 in form, doc/ambiguity.md eq. 9):
///   sigma_tdoa^-2 = 2 T int (2 pi f)^2 L(f) df,  L = g1 g2 S^2 / (1 + (g1 + g2) S),  S the shape with peak 1
/// and for FDOA the same with (2 pi t)^2. It is what can be reached at low SNR: above Stein's by 9 % at 0 dB and 13 %
/// at -5 dB for a roll-off of 0.4, equal at high SNR.
/// @throws std::invalid_argument as `stein_bound`.
[[nodiscard]] TdoaFdoaBound stochastic_bound(double bandwidth_hz, double duration_s, double snr_a, double snr_b,
                                             SpectrumShape shape = SpectrumShape::kFlat, double rolloff = 0.4);

/// 2 pi times the root-mean-square width of a shape [rad/s].
/// @throws std::invalid_argument as `stein_bound`.
[[nodiscard]] double rms_bandwidth_rad(double bandwidth_hz, SpectrumShape shape = SpectrumShape::kFlat,
                                       double rolloff = 0.4);

}  // namespace soopnav::dsp
