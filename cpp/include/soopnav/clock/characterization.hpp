#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <span>
#include <vector>

#include "soopnav/clock/oscillator.hpp"

namespace soopnav::clock {

/// What phase records see of clocks.
///
/// Model: y_m(k) = sum over clocks a_mc b_c(k) + constant + v_m(k),  v ~ N(0, R) white     (doc/characterization.md 1)
///        b_c: the time error of clock c [s], a two-state clock; what a record does not know, a constant and a steady
///        drift, is left free.
/// Signs: as the house's carrier phase. A receiver's clock estimated from satellites less a source's phase has a = 1
///        for the source: (clock - phase) = b_source. A source's phase [s] alone has +1 for the receiver's clock and -1
///        for the source's.
struct PhaseModel {
  static constexpr std::size_t kMaxChannels = 3;
  static constexpr std::size_t kMaxClocks = 4;

  std::size_t channels = 1;
  std::size_t clocks = 1;
  std::array<double, kMaxChannels * kMaxClocks> mixing{1.0};        ///< a, channels x clocks, row by row
  std::array<double, kMaxChannels * kMaxChannels> covariance_s2{};  ///< R, channels x channels [s²]
  double dt_s = 0.1;                                                ///< step of the records [s]
};

/// Phases reach up to this many standard deviations of their noise: beyond, squares of their sums overflow.
inline constexpr double kLargestPhase = 1e60;

/// Refuses a model that does not fit.
/// @throws std::invalid_argument unless its sizes fit, dt_s is within 1e-12 ... 1e12 s, R is positive definite of
/// variances within 1e-80 ... 1e40 s² and every channel sees a clock.
void check_model(const PhaseModel& model);

/// Refuses a phase that is infinite or not below `kLargestPhase` times `unit_s`; NaN passes, it is a gap.
/// @throws std::invalid_argument naming the epoch and the phase.
void check_phase(double phase_s, std::size_t epoch, double unit_s);

/// Log-likelihood at given clocks, and its derivatives by theta = (ln h0, ln h-2 of each estimated clock in turn).
struct PhaseScore {
  double log_likelihood = 0.0;      ///< of the innovations, phases in seconds
  std::vector<double> score;        ///< its gradient
  std::vector<double> information;  ///< Fisher's, expected: of this model, not of this record; square, row by row
  double mean_nis = 0.0;            ///< of the innovations, per channel: 1 when the clocks are right
  double largest_nis = 0.0;         ///< of one epoch, chi-square of `channels` degrees of freedom
  std::size_t largest_at = 0;       ///< the epoch
};

/// Likelihood of clocks' noise in phase records: a Kalman filter of one bias and one drift for each channel, whose
/// innovations are white under the right noise (doc/characterization.md eqs. 3 to 12).
///
/// It starts exactly from the first two whole epochs, which is the limit of an unknown constant and drift. An epoch
/// where a phase is NaN is skipped and predicted across. Cost of an evaluation: O(epochs), about 20 ns an epoch for one
/// channel once the gains have settled; it allocates its results only.
class PhaseLikelihood {
 public:
  /// `phase_s`: epochs x channels, row by row [s].
  /// @throws std::invalid_argument as check_model, and unless all phases are below `kLargestPhase` times their noise
  /// and at least 8 epochs are whole.
  PhaseLikelihood(std::span<const double> phase_s, const PhaseModel& model);

  [[nodiscard]] const PhaseModel& model() const noexcept { return model_; }
  [[nodiscard]] std::size_t epochs() const noexcept { return epochs_; }    ///< of the record
  [[nodiscard]] std::size_t skipped() const noexcept { return skipped_; }  ///< epochs with a NaN
  /// Number of innovations: whole epochs less the two that start the filter.
  [[nodiscard]] std::size_t innovations() const noexcept { return epochs_ - skipped_ - 2; }

  /// The log-likelihood; minus infinity when an innovation has no positive variance. `clocks`: one for each of the
  /// model.
  /// @throws std::invalid_argument for another number of clocks or a coefficient that is negative or not finite.
  [[nodiscard]] double operator()(std::span<const Oscillator> clocks) const;

  /// With derivatives by the logarithms of the coefficients of the clocks listed in `estimated`.
  /// @throws std::invalid_argument as above, and for an index beyond the clocks.
  [[nodiscard]] PhaseScore evaluate(std::span<const Oscillator> clocks, std::span<const std::size_t> estimated) const;

  /// The least and the greatest value of h0 and h-2 that a search looks at: below, a clock adds a hundredth of a
  /// phase's variance over the whole record; above, a thousand times what the records' second differences allow.
  [[nodiscard]] std::array<Oscillator, 2> range() const noexcept { return {low_, high_}; }

 private:
  template <std::size_t M>
  PhaseScore run(std::span<const Oscillator> clocks, std::span<const std::size_t> estimated, bool derivatives) const;
  PhaseScore dispatch(std::span<const Oscillator> clocks, std::span<const std::size_t> estimated,
                      bool derivatives) const;

  PhaseModel model_;
  std::vector<double> phase_;  // in units of unit_s_, less a straight line; NaN in all channels of a skipped epoch
  double unit_s_ = 1.0;
  std::size_t epochs_ = 0;
  std::size_t skipped_ = 0;
  std::array<std::size_t, 2> first_{};
  Oscillator low_{};
  Oscillator high_{};
};

struct CharacterizationOptions {
  int max_iterations = 200;
  /// A parameter is identifiable when its logarithm's standard deviation is at most this, a factor of two, and, with
  /// several clocks, when the likelihood maximised over the others falls by two over two of it downwards.
  double identifiable_sigma = 0.6931471805599453;
  /// Other maxima within so much of the greatest log-likelihood are kept: two degrees of freedom at about 5 %.
  double alternative_drop = 3.0;
};

/// One maximum of the likelihood.
struct NoiseMaximum {
  std::vector<Oscillator> clocks;
  double log_likelihood = -std::numeric_limits<double>::infinity();
  int iterations = 0;
  bool converged = false;
};

/// Noise of clocks by maximum likelihood.
struct CharacterizationResult {
  NoiseMaximum best;
  std::vector<NoiseMaximum> alternatives;  ///< other maxima hardly less likely: the record does not tell them apart
  std::vector<double> information;         ///< Fisher's by theta at the maximum; square, row by row
  std::vector<double> ln_covariance;       ///< of theta: (information + prior)^-1, prior a factor of 1000 at 1 sigma
  std::vector<bool> identifiable;          ///< one for each of theta
  std::vector<double> directions;          ///< eigenvectors of ln_covariance, row by row, the least known first
  std::vector<double> direction_sigma;     ///< standard deviations along them
  double mean_nis = 0.0;
  double largest_nis = 0.0;
  std::size_t largest_at = 0;
  /// The largest innovation is one that a right model exceeds in a millionth of records: a clock jumped or a cycle
  /// slipped, and the noise is that of the jump.
  bool jumped = false;
};

/// Maximises the likelihood over ln h0 and ln h-2 of the clocks in `estimated`, the others known, by Fisher scoring in
/// a trust region (doc/characterization.md eq. 13).
///
/// `clocks` gives the known ones, and the start for the estimated unless `search`, which starts from several splits of
/// the records' noise among them and reports the distinct maxima. 10 to 40 evaluations with derivatives each.
/// @throws std::invalid_argument as PhaseLikelihood::evaluate, and for none estimated or one named twice.
[[nodiscard]] CharacterizationResult characterize(const PhaseLikelihood& likelihood, std::span<const Oscillator> clocks,
                                                  std::span<const std::size_t> estimated, bool search = true,
                                                  const CharacterizationOptions& options = {});

}  // namespace soopnav::clock
