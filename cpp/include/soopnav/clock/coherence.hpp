#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "soopnav/clock/clock_noise.hpp"

/// How long a phase stays coherent, and what that is worth to a receiver (pesyna eqs. 13 to 16; doc/coherence.md).
///
/// Records are of carrier phase in cycles, of either sign: coherence does not see which. Those of a clock's error δt̃
/// [s] are f_c δt̃ (pesyna eq. 14). Everything here is analysis: it allocates, and what cannot be analysed throws
/// std::invalid_argument that names the parameter, its value and the rule.
namespace soopnav::clock {

/// C_coh = |mean of exp(j 2 pi φ)| over all phases [cycles], 0 ... 1 (pesyna eq. 15, each sample for its own interval).
/// NaN when one is NaN or there are none. No allocation.
[[nodiscard]] double coherence(std::span<const double> phase_cycles) noexcept;

/// C_coh of every window of `samples` phases, by the number of its first: as many as phases less samples plus 1, none
/// when the record is shorter. A window that holds a NaN gives NaN. O(phases) whatever the window.
/// @throws std::invalid_argument unless samples >= 1 and no phase is infinite.
[[nodiscard]] std::vector<double> coherences(std::span<const double> phase_cycles, std::size_t samples);

/// Takes the straight line of least squares out of a record, once, NaN being gaps. Per window would hide a frequency
/// error that a receiver has to search for. A record of fewer than two phases loses its mean. No allocation.
/// @throws std::invalid_argument for an infinite phase.
void remove_trend(std::span<double> phase_cycles);

/// Mean-squared coherence ⟨C²(τ)⟩ at one integration time.
struct Coherence {
  double tau_s = 0.0;
  double mean_squared = 0.0;  ///< over every window, each record's and those that overlap
  double lower = 0.0;         ///< the expectation lies between these with the asked confidence ...
  double upper = 0.0;         ///< ... (doc/coherence.md eq. 6)
  double least = 0.0;         ///< C² of the worst window
  double effective = 0.0;     ///< degrees of freedom of the band
  std::size_t count = 0;      ///< windows averaged
};

struct CoherenceOptions {
  double confidence = 0.95;  ///< of the band, in (0, 1)
  bool detrend = true;       ///< take a straight line out of each record, once
};

/// ⟨C²(τ)⟩ of records of phase every `dt_s`, overlapping windows of `samples` phases each (τ = samples dt).
///
/// Band: the smaller of C² and 1 - C² is taken for chi-square, of as many degrees of freedom as the scatter of the mean
/// says and never more than windows that do not overlap (doc/coherence.md eqs. 4 to 6); cut to [0, 1]. The scatter is
/// that of the records' means from eight records on, otherwise that within each one, which a wander longer than the
/// record escapes: one record of few τ has a wide band, and of a wandering frequency still too narrow a one. Windows
/// with NaN are left out, and so are times that no window of any record fits.
/// `runs` records of one length lie one after the other in `phase_cycles`. O(phases) for each time.
/// @throws std::invalid_argument unless dt_s is positive and finite, runs >= 1 divides the phases, no phase is
/// infinite, every number of samples is at least 1 and confidence is in (0, 1).
[[nodiscard]] std::vector<Coherence> mean_squared_coherence(std::span<const double> phase_cycles, std::size_t runs,
                                                            double dt_s, std::span<const std::size_t> samples,
                                                            const CoherenceOptions& options = {});

/// Numbers of samples 1, 2, 3 ... about `per_decade` a decade up to `phases`, none twice. 1 <= per_decade <= 1000.
[[nodiscard]] std::vector<std::size_t> coherence_samples(std::size_t phases, std::size_t per_decade = 10);

/// When a coherence falls.
struct CoherenceTime {
  double tau_s = 0.0;   ///< when ⟨C²⟩ first drops below the level; the longest time looked at when it does not
  bool beyond = false;  ///< it does not: the coherence time lies beyond the record
};

/// The first time at which ⟨C²⟩ is below `level` (pesyna section V-D: 0.5), between two by a straight line; `tau_s`
/// rises. Already below at the first: that one's time.
/// @throws std::invalid_argument unless there are as many means as times, at least one, all finite, times rising and
/// level in (0, 1).
[[nodiscard]] CoherenceTime coherence_time(std::span<const double> tau_s, std::span<const double> mean_squared,
                                           double level = 0.5);

/// ⟨C²(τ)⟩ expected of a two-state clock at a carrier, its drift known at the start of each window to `drift_sigma`
/// (dimensionless; 0: exactly), nothing else removed (doc/coherence.md eqs. 7 to 9).
///
/// White frequency noise alone: 2 (a τ - 1 + exp(-a τ)) / (a τ)², a = pi² f² h0, the closed form; with a random walk
/// one integral, to 1e-10. A detrended record is more coherent: the line takes part of the noise with it.
/// @throws std::invalid_argument unless the densities and drift_sigma are finite and >= 0, carrier_hz and tau_s
/// positive and finite.
[[nodiscard]] double expected_coherence(const ClockNoise& noise, double carrier_hz, double tau_s,
                                        double drift_sigma = 0.0);

/// SNR after coherent integration [dB]: ⟨C²⟩ τ C/N0 (pesyna eq. 16).
/// @throws std::invalid_argument unless tau_s is positive, mean_squared in (0, 1] and all are finite.
[[nodiscard]] double predetection_snr_db(double cn0_dbhz, double tau_s, double mean_squared);

/// The C/N0 [dB-Hz] that gives it: what a receiver needs (pesyna section V-D: 100 s, 0.8 and 11 dB give -8 dB-Hz).
/// @throws std::invalid_argument as `predetection_snr_db`.
[[nodiscard]] double required_cn0_dbhz(double tau_s, double mean_squared, double snr_db = 11.0);

}  // namespace soopnav::clock
