#pragma once

#include <complex>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/waveform/tracking/loop.hpp"

namespace soopnav::tracking {

/// A spread signal as a tracker has to know it.
struct Signal {
  std::vector<Cf32> chips{};  ///< one code period, real or complex, of unit power on average
  double chip_rate_hz = 0.0;  ///< > 0
  double carrier_hz = 0.0;    ///< at least the chip rate
  double symbol_s = 0.0;      ///< of the data's signs, a whole number of code periods; 0: none, a pilot
  double code_slope = 1.0;    ///< of the correlation's fall per chip beside its peak, 1 for rectangular chips

  /// GPS L1 C/A: 1023 chips, data bits of 20 ms. Throws as gps::ca_code.
  [[nodiscard]] static Signal gps_l1(int prn);
  /// A cdma2000 pilot, as it has left the base station of that offset. Throws as cdma::pilot_code.
  [[nodiscard]] static Signal cdma_pilot(double carrier_hz, int pn_offset = 0);
};

/// How to track.
struct TrackerOptions {
  double sample_rate_hz = 0.0;   ///< > 0, at least the chip rate
  double intermediate_hz = 0.0;  ///< where the carrier without Doppler lies in the samples
  double delay_s = 0.0;          ///< start: when the code (with data: a symbol, see `symbol_known`) begins
  double doppler_hz = 0.0;       ///< start: positive when approaching; as all rates within 1 MHz, 0.9 % of the carrier
  double integration_s = 20e-3;  ///< coherent, settled; with data at most a symbol and a divisor of it
  double pll_bandwidth_hz = 10.0;
  int pll_order = 2;                 ///< 2 or 3
  double dll_bandwidth_hz = 0.5;     ///< of the carrier-aided code loop, first order
  double early_late_chips = 0.5;     ///< d, between early and late, in (0, 1]
  double epoch_s = 0.1;              ///< of one observable, at least two integrations
  double pull_in_s = 1.0;            ///< at the start and after a loss, with frequency assist; 0: settled at once
  double pull_in_integration_s = 0;  ///< 0: one code period with data, else 5 ms or integration_s, the lesser
  double pull_in_bandwidth_hz = 20.0;
  double fll_bandwidth_hz = 8.0;  ///< of the frequency assist while pulling in; 0: none
  bool symbol_known = false;      ///< delay_s says when a symbol begins: no search for its edge
  double loss_s = 2.0;            ///< without code lock for so long: pulling in starts again from where it was
};

/// What the tracker is doing.
enum class TrackerState : std::uint8_t {
  kPullIn,    ///< wide loops, frequency assist, search for the symbols' edges
  kTracking,  ///< the loops asked for
  kCoasting,  ///< no signal: the loops stand still on their last rates
};

/// Observables of one window of `epoch_s`.
///
/// Phase and delay are those of the window alone: what the loop's replica had on average plus what was left to measure,
/// so that noise is white from epoch to epoch and the loop's lag does not enter (doc/cdma_tracking.md eq. 15). Windows
/// begin at whole multiples of the epoch in receiver time, the same for every signal: the wander of a common oscillator
/// within them is common too. `t_s` is the middle of the window's samples, by the receiver's clock from its first
/// sample.
struct Epoch {
  double t_s = 0.0;
  double carrier_phase_cycles = 0.0;        ///< grows with range; counts from the start; with data modulo half a cycle
  double carrier_phase_sigma_cycles = 0.0;  ///< thermal
  double delay_s = 0.0;        ///< of the code, grows with range, from the start's value on; t_s - delay_s is sent time
  double delay_sigma_s = 0.0;  ///< thermal
  double doppler_hz = 0.0;     ///< mean of the loop's rate: positive when approaching
  double doppler_sigma_hz = 0.0;
  double cn0_hz = 0.0;             ///< of the window, unbiased: in noise alone it is negative half of the time
  double cn0_sigma_hz = 0.0;       ///< 1 σ of it
  double cn0_dbhz = 0.0;           ///< smoothed over a second, at least 0
  double loop_t_s = 0.0;           ///< end of the last integration
  double loop_phase_cycles = 0.0;  ///< the loop's own phase then: smoother, correlated over 1 / B
  double phase_lock = 0.0;         ///< mean cosine of (twice, with data) the remaining phase, 1: locked
  std::complex<double> prompt{};   ///< mean of the prompt, data wiped, in units of the noise of a sample
  std::uint32_t arc = 0;           ///< phases of one arc have one ambiguity; grows when cycles may have been lost
  std::uint32_t bad_samples = 0;   ///< not finite: left out
  TrackerState state = TrackerState::kPullIn;
  bool phase_locked = false;  ///< over the whole window
  bool code_locked = false;
};

/// Tracks one signal through a stream of samples.
///
/// Carrier: PLL of second or third order, discriminator atan2 for a pilot, atan (Costas) for data, with frequency
/// assist while pulling in. Code: first order, carrier-aided, early-late times prompt over the measured power. Each
/// run of 512 samples or fewer is mixed, correlated and added in a fixed order, so that blocks of any sizes give the
/// same bits. Samples that are not finite, or beyond 1e15, count as zeros and are reported.
class Tracker {
 public:
  /// Throws std::invalid_argument naming the field that breaks its rule. Allocates the code and the buffers.
  Tracker(const Signal& signal, const TrackerOptions& options);
  ~Tracker();
  Tracker(Tracker&&) noexcept;
  Tracker& operator=(Tracker&&) noexcept;

  static constexpr std::size_t kMaxEpochs = 64;  ///< that one push can return

  /// Takes samples until they end or kMaxEpochs epochs are complete; returns how many it took. `epochs()` are then
  /// those completed by this call. No allocation; about 3 ns a sample for a real code, 4 ns for a complex one.
  std::size_t push(IqSpan samples) noexcept;
  [[nodiscard]] std::span<const Epoch> epochs() const noexcept;

  /// Takes all samples and hands each epoch to `sink`.
  template <class Sink>
  void push(IqSpan samples, Sink&& sink) {
    while (!samples.empty()) {
      samples = samples.subspan(push(samples));
      for (const Epoch& epoch : epochs()) sink(epoch);
    }
  }

  [[nodiscard]] const TrackerOptions& options() const noexcept;
  [[nodiscard]] TrackerState state() const noexcept;
  [[nodiscard]] std::uint64_t samples() const noexcept;  ///< taken so far
  [[nodiscard]] const Loop& loop() const noexcept;       ///< the carrier loop as it is when settled

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::tracking
