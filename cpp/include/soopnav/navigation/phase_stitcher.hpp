#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <string_view>
#include <vector>

#include "soopnav/clock/clock_noise.hpp"

/// Positions from observations, and the navigators.
namespace soopnav::navigation {

/// What a burst's receiver measured. NaN in `frequency_hz`: no frequency.
struct PhaseBurst {
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  double t_s = 0.0;                    ///< middle of the burst, system time, later than the burst before
  double phase_cycles = kNan;          ///< carrier phase in the middle, grows with range; any whole cycles
  double phase_sigma_cycles = kNan;    ///< of it, > 0
  double frequency_hz = kNan;          ///< rate of the phase within the burst: minus the Doppler shift
  double frequency_sigma_hz = kNan;    ///< of it, > 0; not looked at without `frequency_hz`
  double predicted_cycles = 0.0;       ///< what orbit, place and the aided receiver's clock say of the phase
  double predicted_rate_cyclesps = 0;  ///< time derivative of `predicted_cycles`
};

/// What a stitcher assumes.
struct StitcherOptions {
  int fractions = 4;                ///< M: a burst begins with a random multiple of 1/M cycle, in [1, 64]
  double wavelength_m = 0.18434;    ///< of the carrier, > 0
  clock::ClockNoise clock{};        ///< of all that runs between bursts: satellite plus what aiding leaves of ours
  double frequency_sigma_hz = 5.0;  ///< how well `predicted_rate_cyclesps` is known, constant part, > 0
  double rate_sigma_hzps = 0.3;     ///< how well its slope is known, >= 0
  double rate_walk_hz2ps3 = 0.0;    ///< how the slope's error wanders, power density, >= 0
  int decision_bursts = 60;         ///< bursts after which an integer is decided, in [2, 512]
  double posterior = 0.999;         ///< least probability of a step that is called fixed, in (0.5, 1)
  int hypotheses = 128;             ///< most that are kept, in [2, 4096]
  double gate_sigma = 6.0;          ///< integers further than this from the prediction are not looked at, in [3, 10]
  int outliers = 5;                 ///< after so many bursts in a row that fit no hypothesis all begins anew, >= 1

  /// Throws std::invalid_argument naming the option, its value and the rule.
  void check() const;
};

/// What became of a burst.
enum class BurstStatus : std::uint8_t {
  kAccepted,    ///< in the window
  kStarted,     ///< the first one, of all or after a restart
  kNotFinite,   ///< NaN or infinity where a number is needed, or a sigma that is not positive; nothing changed
  kNotLater,    ///< not after the burst before it; nothing changed
  kOutlier,     ///< fits no hypothesis, or is 1e15 / M cycles and more from the prediction; nothing changed
  kGapTooLong,  ///< the prediction is too wide to tell integers apart: all undecided are left float, it starts anew
  kLost,        ///< the last of `outliers` bursts in a row that fit nothing: it starts anew
};

/// A lower-case phrase: "accepted", "not finite", ...
[[nodiscard]] std::string_view to_string(BurstStatus status) noexcept;

/// A burst whose integer has been decided.
struct StitchedBurst {
  std::uint64_t burst = 0;  ///< number of the `push` that brought it, from 0; refused ones count
  double t_s = 0.0;
  /// The phase with the random fraction taken out [cycles]: within an arc it is continuous, and differs from
  /// |p - q| / lambda + clocks by one constant (pesyna eq. 6 without eta, gamma kept).
  double phase_cycles = 0.0;
  double sigma_cycles = 0.0;  ///< of it: the measurement's and, in a float step, the spread over the hypotheses
  std::int64_t integer = 0;   ///< n: phase_cycles = measured - n / M; 0 at the start. n mod M is eta less a constant
  std::int64_t step = 0;      ///< n minus that of the burst before; 0 at the start
  double posterior = 1.0;     ///< probability of `step`
  bool fixed = false;         ///< whether it reached the asked posterior (the start of an arc has no step: true)
  std::uint32_t arc = 0;      ///< phases of one arc share their constant; a float step begins another arc
};

/// Makes one continuous carrier phase of bursts that each begin with a random multiple of 1/M cycle (Iridium).
///
/// Model (doc/phase_stitching.md eq. 1 to 3; pesyna eq. 6): measured - predicted = x + n/M + noise, n an integer free
/// in each burst; x, its frequency and the frequency's rate: two-state clock noise plus what is not known of the
/// prediction, N(0, frequency_sigma²) and N(0, rate_sigma²). All integers n that the prediction leaves possible are
/// followed, each with its own Kalman filter and weight (eq. 4, 5): with the first gap these are the frequencies
/// that look alike, 1 / (M gap) apart, over gate_sigma standard deviations of the prior; only the frequency within
/// the bursts tells them apart, and each burst adds to that. What is dropped of the weights is remembered and counted
/// against the posterior.
///
/// Decisions: a burst leaves the window with its step fixed when at least `decision_bursts` bursts have come since the
/// start and the step's posterior, summed over all hypotheses that have it (partial fixing), is above the limit; when
/// it gets `decision_bursts` old without that it leaves float, and a new arc begins. A fixed step drops the
/// hypotheses that contradict it. Signs: phases grow with range, frequencies are their rates.
///
/// Construction allocates; nothing else does, and nothing throws. 2 us for a burst once the frequency is clear, some
/// tens while it is not.
class PhaseStitcher {
 public:
  /// @throws std::invalid_argument as `StitcherOptions::check`.
  explicit PhaseStitcher(const StitcherOptions& options = {});

  [[nodiscard]] const StitcherOptions& options() const noexcept { return options_; }

  /// Takes a burst. What it decides is in `decided` until the next call.
  [[nodiscard]] BurstStatus push(const PhaseBurst& burst) noexcept;

  /// Decides all that are still in the window, as if they were old enough, and begins anew. A posterior above the limit
  /// is fixed also before `decision_bursts` bursts when `early`; otherwise such are left float.
  void finish(bool early = false) noexcept;

  /// What the last call decided, in order of time.
  [[nodiscard]] std::span<const StitchedBurst> decided() const noexcept { return decided_; }

  [[nodiscard]] int hypotheses() const noexcept { return static_cast<int>(now_.size()); }  ///< followed
  [[nodiscard]] std::size_t waiting() const noexcept { return pending_; }                  ///< bursts in the window
  [[nodiscard]] double posterior() const noexcept;  ///< of the likeliest hypothesis; 0 at first
  /// What the likeliest hypothesis says the prediction's frequency is off by, and its standard deviation [Hz]. NaN at
  /// first.
  [[nodiscard]] double frequency_error_hz() const noexcept;
  [[nodiscard]] double frequency_error_sigma_hz() const noexcept;

 private:
  // Phase, frequency, rate and the lower triangle of their covariance: 00 10 11 20 21 22.
  struct Hypothesis {
    double x[3];
    double P[6];
    double log_weight;     // normalised: the sum over all is 1
    std::int64_t integer;  // n of the latest burst
  };
  struct Candidate {
    int parent;
    std::int64_t integer;
    double log_weight;
  };
  struct Waiting {
    std::uint64_t burst;
    double t_s, measured, sigma;
  };

  void start(const PhaseBurst& burst) noexcept;
  void restart() noexcept;
  void predict(Hypothesis& h, double dt) const noexcept;
  [[nodiscard]] BurstStatus branch(const PhaseBurst& burst, double dt) noexcept;
  void emit(bool flush, bool early) noexcept;
  [[nodiscard]] std::size_t best() const noexcept;
  [[nodiscard]] std::int64_t* steps(std::vector<std::int64_t>& of, std::size_t row) const noexcept {
    return of.data() + row * window_;
  }

  StitcherOptions options_;
  std::size_t window_;
  std::vector<Hypothesis> now_, next_;
  std::vector<std::int64_t> steps_now_, steps_next_;  // a row of `window_` steps for each hypothesis, a ring
  std::vector<Candidate> candidates_;
  std::vector<Waiting> ring_;
  std::vector<StitchedBurst> decided_;
  std::size_t first_ = 0, pending_ = 0;  // of the rings
  std::uint64_t pushed_ = 0;
  std::int64_t since_start_ = 0;  // bursts taken since the start
  int misses_ = 0;
  double last_t_s_ = 0.0;
  double dropped_ = 0.0;      // weight given up
  std::int64_t integer_ = 0;  // n of the latest burst decided
  std::uint32_t arc_ = 0;
};

}  // namespace soopnav::navigation
