#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <vector>

/// Deviations of a clock's frequency from recorded phase or frequency (NIST SP 1065; doc/clocks.md eqs. 6 to 12).
///
/// Everything here is analysis of a record: it allocates, and what cannot be analysed throws std::invalid_argument that
/// names the parameter, its value and the rule.
namespace soopnav::clock {

/// Which deviation.
enum class DeviationKind {
  kAllan,                ///< every second difference once: no two share a sample interval but for their ends
  kOverlappingAllan,     ///< every second difference; the same expectation with less spread
  kModifiedAllan,        ///< phase averaged over tau first: tells white from flicker phase noise
  kTime,                 ///< tau / sqrt(3) times the modified Allan deviation [s]
  kHadamard,             ///< third differences: blind to a linear drift of frequency
  kOverlappingHadamard,  ///< every third difference
};

/// Noise by the exponent of its density of fractional frequency, S_y(f) ~ f^alpha.
enum class PowerLaw {
  kRandomWalkFrequency = -2,
  kFlickerFrequency = -1,
  kWhiteFrequency = 0,
  kFlickerPhase = 1,
  kWhitePhase = 2,
};

/// Which averaging times.
enum class TauSpacing {
  kOctave,  ///< 1, 2, 4, 8, 16 ...
  kDecade,  ///< 1, 2, 4, 10, 20, 40, 100 ...
  kAll,     ///< every one
};

/// A deviation at one averaging time.
struct Deviation {
  double tau_s = 0.0;
  double deviation = 0.0;                      ///< dimensionless; seconds for the time deviation
  double lower = 0.0;                          ///< the true one lies between these with the asked confidence ...
  double upper = 0.0;                          ///< ... (doc/clocks.md eq. 11)
  double dof = 0.0;                            ///< equivalent degrees of freedom of the estimate
  std::size_t count = 0;                       ///< terms averaged
  PowerLaw noise = PowerLaw::kWhiteFrequency;  ///< that the interval supposes: given, or found from the record
};

struct DeviationOptions {
  double confidence = 0.683;        ///< of the interval, in (0, 1)
  std::optional<PowerLaw> noise{};  ///< of the interval; found for each tau by its lag-1 autocorrelation when not given
};

/// Averaging factors m = tau / dt of a record of `phases` phases: those with at least one term without gaps.
[[nodiscard]] std::vector<std::size_t> averaging_factors(std::size_t phases, DeviationKind kind, TauSpacing spacing);

/// Deviations of a record of phase: the clock's time error `phase_s` every `dt_s` seconds.
///
/// A NaN is a gap: the differences that touch it are left out, and `count` says how many are in. Factors without a term
/// are left out of the result, which so may be empty. Invariant to an offset of phase or frequency, which are worth
/// removing from long records all the same, for digits. O(phases) for each factor.
/// @throws std::invalid_argument unless dt_s is positive and finite, no phase is infinite, every factor is at least 1
/// and confidence is in (0, 1).
[[nodiscard]] std::vector<Deviation> phase_deviations(std::span<const double> phase_s, double dt_s, DeviationKind kind,
                                                      std::span<const std::size_t> factors,
                                                      const DeviationOptions& options = {});

/// Deviations of a record of fractional frequency, each value the mean over `dt_s` seconds.
///
/// A NaN is a gap across which the phase is unknown: the stretches between gaps are analysed each by itself and their
/// terms pooled. Otherwise as `phase_deviations` of the summed frequency, which has one more phase than there are
/// values.
[[nodiscard]] std::vector<Deviation> frequency_deviations(std::span<const double> frequency, double dt_s,
                                                          DeviationKind kind, std::span<const std::size_t> factors,
                                                          const DeviationOptions& options = {});

/// Equivalent degrees of freedom of a deviation squared of `count` terms at averaging factor `factor` under `noise`:
/// 2 E² / Var, from the autocovariance of the differences (doc/clocks.md eqs. 9, 10). Terms in one row, without gaps.
/// Above factor 64 computed at 64 for as long a record: within 2 %. Allocates.
/// @throws std::invalid_argument unless factor and count are at least 1.
[[nodiscard]] double equivalent_dof(DeviationKind kind, PowerLaw noise, std::size_t factor, std::size_t count);

/// The power law that a record looks like at an averaging factor: differenced until its lag-1 autocorrelation r of
/// every factor-th phase (of the first 32768 such) tells a stationary process, with alpha = 2 - 2 (r / (1 + r) +
/// differences) (Riley and Greenhall 2004; doc/clocks.md eq. 12). None when fewer than 30 such phases are left.
[[nodiscard]] std::optional<PowerLaw> identify_noise(std::span<const double> phase_s, std::size_t factor,
                                                     DeviationKind kind);

}  // namespace soopnav::clock
