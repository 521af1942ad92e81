#pragma once

#include <concepts>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "soopnav/clock/clock_simulator.hpp"
#include "soopnav/core/iq.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/geometry/sampled_orbit.hpp"
#include "soopnav/simulation/channel.hpp"

/// One transmission through two channels into two receivers whose clocks are their own.
///
/// Signs: a clock's bias is its reading minus system time, its drift the rate of the bias; a fast clock (drift > 0)
/// stamps later, and as one reference drives sample clock and local oscillator, it sees carriers lower by f drift.
/// Derivation: doc/pair_link.md.
namespace soopnav::simulation {

// ---- Clocks

struct ClockReading {
  double bias_s = 0.0;  ///< reading minus system time
  double drift = 0.0;   ///< d bias / d system time
};

/// A receiver's clock over system time: bias and drift at instants, joined by cubic Hermite polynomials, so that the
/// bias is smooth and both are met at each instant. Before the first and after the last it runs at the drift it has
/// there. At an instant the frequency bends: two of them, on a line before and after a burst, keep it straight. The
/// white frequency noise of a two-state clock is in the biases from instant to instant.
class ClockTrack {
 public:
  ClockTrack();  ///< of a clock that shows system time

  /// Instants rise. @throws std::invalid_argument when there are none, sizes differ, a number is not finite, an instant
  /// does not follow the last, or a drift (a slope between two instants likewise) reaches 1e-3.
  ClockTrack(std::span<const double> time_s, std::span<const double> bias_s, std::span<const double> drift);

  /// bias = bias_s + drift (t - epoch_s). @throws as the other.
  [[nodiscard]] static ClockTrack steady(double bias_s, double drift, double epoch_s = 0.0);

  /// A two-state clock as it runs along `time_s` (clock::simulate). @throws as that and the constructor.
  [[nodiscard]] static ClockTrack simulated(const clock::ClockNoise& noise, const clock::ClockState& start,
                                            std::span<const double> time_s, const RandomStream& random);

  [[nodiscard]] ClockReading at(double t_s) const noexcept;
  /// System time at which it shows `reading_s`, and what it is off then.
  [[nodiscard]] double time_of(double reading_s, ClockReading& clock) const noexcept;
  [[nodiscard]] double time_of(double reading_s) const noexcept;

  [[nodiscard]] std::span<const double> times_s() const noexcept { return time_s_; }

 private:
  std::vector<double> time_s_;
  std::vector<ClockReading> knots_;
};

// ---- Waveforms

/// A complex envelope that can be asked for any instant: a reference to an object with
/// `evaluate(t0_s, dt_s, quadratic, out)`, which writes the envelope at t0_s + dt_s n + quadratic n². The object
/// outlives it.
class EnvelopeView {
 public:
  /// Outside [begin_s, end_s], seconds of the waveform's own time, the envelope is zero and not asked for.
  template <class Waveform>
  requires requires(const Waveform& waveform, std::span<Cf32> out) { waveform.evaluate(0.0, 0.0, 0.0, out); }
  EnvelopeView(const Waveform& waveform, double begin_s, double end_s) noexcept
      : object_(std::addressof(waveform)),
        evaluate_([](const void* object, double t0_s, double dt_s, double quadratic, std::span<Cf32> out) {
          static_cast<const Waveform*>(object)->evaluate(t0_s, dt_s, quadratic, out);
        }),
        begin_s_(begin_s),
        end_s_(end_s) {}

  void evaluate(double t0_s, double dt_s, double quadratic, std::span<Cf32> out) const {
    evaluate_(object_, t0_s, dt_s, quadratic, out);
  }
  [[nodiscard]] double begin_s() const noexcept { return begin_s_; }
  [[nodiscard]] double end_s() const noexcept { return end_s_; }

 private:
  const void* object_;
  void (*evaluate_)(const void*, double, double, double, std::span<Cf32>);
  double begin_s_;
  double end_s_;
};

/// Samples of any waveform as a continuous envelope, sample n at n / rate: Kaiser-windowed sinc over 32 samples from a
/// table of 512 phases interpolated linearly. Within 80 dB of the band-limited waveform to 0.8 of half the rate; zero
/// beyond 16 samples before the first and after the last.
class SampledEnvelope {
 public:
  /// @throws std::invalid_argument when there are no samples, one is not finite, or the rate is not finite and
  /// positive.
  SampledEnvelope(IqSpan samples, double sample_rate_hz);

  /// The envelope at t0_s + dt_s n + quadratic n². About 40 ns a sample; no heap.
  void evaluate(double t0_s, double dt_s, double quadratic, std::span<Cf32> out) const noexcept;

  [[nodiscard]] double begin_s() const noexcept;
  [[nodiscard]] double end_s() const noexcept;
  [[nodiscard]] EnvelopeView view() const noexcept { return {*this, begin_s(), end_s()}; }

 private:
  std::vector<Cf32> samples_;  // with a window of zeros on either side
  double rate_hz_;
};

// ---- Reception

/// One of the two: where its antenna is, what its clock shows and which echoes it hears.
struct PairReceiver {
  geometry::SampledOrbit antenna;  ///< `fixed` or moving, over system time
  ClockTrack clock{};
  std::vector<Tap> taps{};  ///< echoes and their gains relative to the path of `signal_path`; none: that path, gain 1

  /// @throws std::invalid_argument for a tap that is not finite.
  void check() const;
};

/// What a transmitter sends: the envelope's time 0 leaves it at system time `start_s`, on a carrier of `carrier_hz`.
struct Transmission {
  double start_s = 0.0;
  double carrier_hz = 0.0;
  double amplitude = 1.0;
  double phase_rad = 0.0;  ///< of the carrier at system time 0
};

/// Sample n of a recording is taken when the receiver's clock shows start_s + (first_sample + n) / sample_rate_hz, its
/// local oscillator having turned `center_hz` times for each second that the clock shows.
struct SampleGrid {
  double start_s = 0.0;
  double sample_rate_hz = 0.0;
  double center_hz = 0.0;
  std::int64_t first_sample = 0;

  /// @throws std::invalid_argument unless all are finite and the rate is positive.
  void check() const;
};

/// The arrival of one wavefront at a receiver.
struct Arrival {
  double t_s = 0.0;           ///< system time
  double reading_s = 0.0;     ///< of the receiver's clock
  double frequency_hz = 0.0;  ///< of the carrier as the receiver's clock counts it: f (1 - delay_rate) / (1 + drift)
  ClockReading clock{};
  geometry::SignalPath path{};
};

/// When and how a wavefront that the transmitter sent at `sent_s` reaches a receiver. False, `arrival` untouched, when
/// a needed instant lies outside the transmitter's or the antenna's samples. No heap.
[[nodiscard]] bool arrival_of(const PairReceiver& receiver, const geometry::SampledOrbit& beacon, double sent_s,
                              double carrier_hz, Arrival& arrival) noexcept;

/// System time at which what a receiver hears when its clock shows `reading_s` was sent. False as `arrival_of`.
[[nodiscard]] bool sent_time(const PairReceiver& receiver, const geometry::SampledOrbit& beacon, double reading_s,
                             double& sent_s) noexcept;

/// Adds what a receiver hears of a transmission to samples of its recording.
///
/// Model: with t the system time at which the clock shows the sample's reading r, D(t) of `signal_path` and b the
/// clock's bias (doc/pair_link.md eq. 3), each tap adds amplitude gain s(t - D - delay - start) exp(j 2 pi ((f_tx -
/// f_lo) r - f_tx (b + D))). Delay and clock are fitted by polynomials of degree 5 over stretches that are halved until
/// the fit is within 1e-13 s at points between its nodes, or are of 256 samples; phases are in double, differences of
/// large numbers taken before they are rounded.
///
/// False, the samples untouched, when the transmission needs an instant outside the transmitter's or the antenna's
/// samples; true, and nothing added, when it does not meet the samples. About 15 ns a sample beside the waveform's
/// own cost; no heap.
[[nodiscard]] bool add_reception(const PairReceiver& receiver, const EnvelopeView& envelope,
                                 const geometry::SampledOrbit& beacon, const Transmission& sent, const SampleGrid& grid,
                                 std::span<Cf32> samples) noexcept;

// ---- Two receivers

/// What the two recordings of one wavefront say of each other, without noise.
struct PairTruth {
  double tdoa_s = 0.0;   ///< reading of the target minus reading of the anchor: positive when the target is later
  double fdoa_hz = 0.0;  ///< frequency at the target minus that at the anchor: positive when higher
  Arrival target{};
  Arrival anchor{};
};

/// Target and anchor (receiver a and b) of one transmitter after the other.
class PairLink {
 public:
  /// @throws std::invalid_argument as `PairReceiver::check`, and unless the rate is positive and both are finite.
  PairLink(PairReceiver target, PairReceiver anchor, double sample_rate_hz, double center_hz);

  [[nodiscard]] const PairReceiver& target() const noexcept { return target_; }
  [[nodiscard]] const PairReceiver& anchor() const noexcept { return anchor_; }
  [[nodiscard]] double sample_rate_hz() const noexcept { return sample_rate_hz_; }
  [[nodiscard]] double center_hz() const noexcept { return center_hz_; }

  /// Of the wavefront that the transmitter sent at `sent_s`; for a burst take its middle. False, `truth` untouched, as
  /// `arrival_of`. About 2 us; no heap.
  [[nodiscard]] bool truth(const geometry::SampledOrbit& beacon, double sent_s, double carrier_hz,
                           PairTruth& truth) const noexcept;

  /// Adds the transmission to a snippet of each receiver; the first samples are taken when each one's own clock shows
  /// `target_start_s` and `anchor_start_s`. False, nothing added, as `add_reception`. No heap.
  [[nodiscard]] bool render(const EnvelopeView& envelope, const geometry::SampledOrbit& beacon,
                            const Transmission& sent, double target_start_s, std::span<Cf32> target,
                            double anchor_start_s, std::span<Cf32> anchor) const noexcept;

 private:
  PairReceiver target_;
  PairReceiver anchor_;
  double sample_rate_hz_;
  double center_hz_;
};

}  // namespace soopnav::simulation
