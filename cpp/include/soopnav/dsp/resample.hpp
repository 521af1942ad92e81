#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"

namespace soopnav::dsp {

/// Accuracy of a resampler. Frequencies are fractions of half the lower of the two sampling rates.
struct ResampleDesign {
  /// Kept exact up to here; in (0, 1).
  double passband = 0.8;
  /// Suppressed from here on; above `passband`, at most 2 - passband so that nothing folds into the passband.
  /// Between the two a signal may fold.
  double stopband = 1.2;
  /// In the passband the error, and in the stopband what is left, in dB below a tone; 20 to 110.
  double attenuation_db = 80.0;
};

/// Changes the sampling rate by a rational factor or by any factor.
///
/// Time. Output m is the input's band-limited interpolation at input time start_samples + m * step_samples(), in input
/// samples from the capture's first one: with the default start the first output lies on the first input sample, and
/// the filter's delay is taken out. The input is zero outside the capture.
///
/// Method. Each output is one inner product with a Kaiser-windowed sinc (doc/resampling.md eqs. 2-4). A rational factor
/// has one filter per phase, and the outputs' times are exact. An arbitrary factor interpolates linearly between
/// the filters of a grid fine enough for the design (eq. 6), and keeps time in steps of 2^-64 samples.
///
/// Cost: about 36 / (stopband - passband) * max(1, step_samples()) multiply-adds per output at 80 dB, twice that for an
/// arbitrary factor. The constructor allocates, nothing else does. One object serves one thread at a time.
class Resampler {
 public:
  /// Output rate = input rate * up / down, exactly. The factor is reduced; up is at most 1024 afterwards.
  /// @throws std::invalid_argument for a factor or a design outside its range, a start not finite or above 2^50, or a
  ///         filter above 2^24 coefficients.
  [[nodiscard]] static Resampler rational(int up, int down, const ResampleDesign& design = {},
                                          double start_samples = 0.0);
  /// Output m lies at start_samples + m * step_samples, for any step in [1/1024, 1024]. For a capture whose clock ran
  /// fast by e (its samples are closer together), step_samples = 1 + e gives the samples of a true clock.
  /// @throws std::invalid_argument as `rational`.
  [[nodiscard]] static Resampler arbitrary(double step_samples, const ResampleDesign& design = {},
                                           double start_samples = 0.0);
  /// From one rate to another: rational where the rates stand in a ratio with a small numerator, else arbitrary.
  /// @throws std::invalid_argument for rates that are not finite and positive, and as `arbitrary`.
  [[nodiscard]] static Resampler between(double in_rate_hz, double out_rate_hz, const ResampleDesign& design = {},
                                         double start_samples = 0.0);

  /// out[i] = output number first + i, for any range; see `output_size` for those inside the capture.
  /// `out` may not overlap `in`. Allocates nothing; leaves a stream in progress alone.
  void apply(IqSpan in, std::int64_t first, std::span<Cf32> out);

  /// Outputs whose time lies before the end of a capture of n_in samples: those m >= 0 with
  /// start_samples + m * step_samples() < n_in.
  [[nodiscard]] std::size_t output_size(std::size_t n_in) const noexcept;

  /// Takes the next samples of a stream and writes the outputs that are complete, number 0 first; returns how many.
  /// The bits are those of `apply` on the whole. An output waits for tap_count() / 2 inputs after its time.
  /// Allocates nothing.
  /// @throws std::invalid_argument when `out` is shorter than `push_size(in.size())`; the stream is then as it was.
  std::size_t push(IqSpan in, std::span<Cf32> out);
  /// Ends the stream: writes the outputs left up to `output_size(n)` and starts afresh. Allocates nothing.
  /// @throws std::invalid_argument when `out` is shorter than `flush_size()`; the stream is then as it was.
  std::size_t flush(std::span<Cf32> out);
  /// Forgets the stream so far.
  void reset() noexcept;

  /// Outputs the next `push` of `n_in` samples will write.
  [[nodiscard]] std::size_t push_size(std::size_t n_in) const noexcept;
  /// Outputs `flush` would write now.
  [[nodiscard]] std::size_t flush_size() const noexcept;

  [[nodiscard]] double start_samples() const noexcept { return start_; }
  [[nodiscard]] double step_samples() const noexcept { return step_; }  ///< input rate / output rate
  [[nodiscard]] bool is_rational() const noexcept { return up_ != 0; }
  [[nodiscard]] std::size_t tap_count() const noexcept { return taps_; }  ///< inputs that one output is made of
  [[nodiscard]] std::size_t phase_count() const noexcept { return phases_; }

 private:
  // Of an output: the last input sample at or before it, and how far behind that it lies: in phases of the table for a
  // rational factor, in 2^-64 samples for an arbitrary one.
  struct Position {
    std::int64_t sample = 0;
    std::uint64_t fraction = 0;
  };

  Resampler(std::uint64_t up, std::uint64_t down, double step, const ResampleDesign& design, double start);

  [[nodiscard]] Position position(std::int64_t output) const noexcept;
  [[nodiscard]] Position after(Position p) const noexcept;
  [[nodiscard]] std::uint64_t outputs_before(std::int64_t sample) const noexcept;
  [[nodiscard]] std::int64_t window_begin(Position p) const noexcept;
  [[nodiscard]] Cf32 output(Position p, const Cf32* window) const noexcept;
  std::size_t feed(const Cf32* in, std::uint64_t n_in, std::int64_t index, std::uint64_t limit, Cf32* out);

  double start_ = 0.0;
  double step_ = 1.0;
  std::uint64_t up_ = 0;  // 0 for an arbitrary factor
  Position origin_;       // of output 0
  Position advance_;      // from one output to the next
  std::size_t taps_ = 0;
  std::size_t phases_ = 0;
  unsigned phase_bits_ = 0;
  std::vector<float> table_;  // a row of doubled taps per phase
  std::vector<Cf32> edge_;    // a window that reaches over the capture's edge
  // The stream.
  std::vector<Cf32> buffer_;
  std::int64_t buffer_begin_ = 0;  // input index of buffer_[0]
  std::size_t filled_ = 0;
  std::uint64_t seen_ = 0;
  std::uint64_t written_ = 0;
  Position next_;
};

/// A capture at another rate: output m at input time m * in_rate_hz / out_rate_hz samples, one for every such time
/// inside the capture.
/// @throws std::invalid_argument as `Resampler::between`.
[[nodiscard]] std::vector<Cf32> resample(IqSpan in, double in_rate_hz, double out_rate_hz,
                                         const ResampleDesign& design = {});

}  // namespace soopnav::dsp
