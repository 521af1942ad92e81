#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/iridium/channel_plan.hpp"

namespace soopnav::iridium {

/// What a burst is made of. Lengths in symbols of 40 us.
enum class BurstKind {
  kRingAlert,  ///< preamble 64, unique word 12, payload; 80 ... 444 after the preamble, 20.32 ms at most
  kSimplex,    ///< the same on the other simplex channels
  kDuplex,     ///< preamble 16, unique word 12, payload; 131 ... 191 after the preamble, 8.28 ms at most
  kLong,       ///< payload only, any length: for simulation, where random symbols throughout have the pulse's spectrum
};

/// Downlink and uplink bursts have different preambles and unique words; kLong has neither.
enum class BurstDirection { kDownlink, kUplink };

inline constexpr std::size_t kUniqueWordSymbols = 12;

/// Quadrants (see Burst::quadrants) of the words that follow the preamble: 0 and 2 only, so BPSK (gr-iridium).
inline constexpr std::array<std::uint8_t, kUniqueWordSymbols> kDownlinkWord{0, 2, 2, 2, 2, 0, 0, 0, 2, 0, 0, 2};
inline constexpr std::array<std::uint8_t, kUniqueWordSymbols> kUplinkWord{2, 2, 0, 0, 0, 2, 0, 0, 2, 0, 2, 2};

/// How a burst arrives at a receiver, for Burst::render.
struct Arrival {
  double sample_rate_hz = 50e3;
  double delay_s = 0.0;     ///< when the burst starts, after the first sample; any sign
  double delay_rate = 0.0;  ///< its change by the receiver's time, s/s: positive when receding (burst stretched)
  double delay_acceleration = 0.0;     ///< change of that, s/s^2
  double doppler_hz = 0.0;             ///< carrier in the samples at the first sample
  double doppler_rate_hz_per_s = 0.0;  ///< its change
  double phase_rad = 0.0;              ///< of the carrier at the first sample
  double amplitude = 1.0;              ///< root of the power

  /// Throws std::invalid_argument naming the field that breaks its rule: all finite, a rate above zero, |delay_rate|
  /// below 0.1.
  void check() const;
};

/// A burst as a function of continuous time: its complex envelope
///
///   s(t) = sum_k a_k g(t - (k + 1/2) T),   T = 40 us,   0 <= t <= duration_s()             (doc/iridium.md eq. 1)
///
/// a_k of modulus one, g the root-raised cosine of roll-off 0.4 with mean power one, so E|s|^2 = 1 inside the burst.
/// g reaches 12 symbols either way, its last two faded out by a raised cosine: the spectrum is below -48 dB from
/// +-18.5 kHz on, symbols behind a matched filter are right to -45 dB, and s(t) outlasts the burst by at most 11.5
/// symbols (460 us) on either side, nearly all of it by one. g comes from a table of 256 phases, interpolated linearly:
/// error below -90 dB. Immutable: threads may share one.
class Burst {
 public:
  /// Symbols that g reaches to either side.
  static constexpr int kReach = 12;

  /// A burst of the kind with random payload: dibits drawn from `stream` (one u32 each, from its position), DQPSK.
  ///
  /// @param duration_s 0: the longest of the kind (kLong: 90 ms). Otherwise rounded to whole symbols, and within the
  ///        kind's limits; kLong 1 symbol to 10 s.
  /// @throws std::invalid_argument naming duration_s otherwise. Allocates.
  [[nodiscard]] static Burst make(BurstKind kind, RandomStream stream, double duration_s = 0.0,
                                  BurstDirection direction = BurstDirection::kDownlink);

  /// A burst of given symbols, any complex values.
  /// @throws std::invalid_argument when there are none, above 250 000 or one is not finite. Allocates.
  explicit Burst(std::span<const Cf32> symbols);

  /// out[n] = s(t0 + dt n + quadratic n^2), zero where that is outside the burst or not finite. Allocates nothing;
  /// about 10 ns a sample within the burst (AVX2), the same bits on every processor.
  void evaluate(double t0_s, double dt_s, double quadratic_s, std::span<Cf32> out) const noexcept;

  /// out[i] = s(t_s[i]); `out` is at least as long as `t_s` (the rest is left as it is; missing ones are not written).
  void evaluate(std::span<const double> t_s, std::span<Cf32> out) const noexcept;

  /// out[n] = amplitude s(t - delay(t)) exp(j (phase + 2 pi (doppler t + rate t^2 / 2))), t = n / sample_rate_hz and
  /// delay(t) = delay_s + delay_rate t + delay_acceleration t^2 / 2. No allocation.
  /// @throws std::invalid_argument by Arrival::check.
  void render(const Arrival& arrival, std::span<Cf32> out) const;
  /// Adds what `render` would have written: several bursts in one recording.
  void add_to(const Arrival& arrival, std::span<Cf32> out) const;

  [[nodiscard]] std::size_t size() const noexcept { return symbols_; }  ///< symbols
  [[nodiscard]] double duration_s() const noexcept { return static_cast<double>(symbols_) / kSymbolRateHz; }
  /// Where the payload begins.
  [[nodiscard]] std::size_t payload_start() const noexcept { return payload_start_; }
  /// Symbol k.
  [[nodiscard]] Cf32 symbol(std::size_t k) const noexcept { return {re_[k + 2 * kReach], im_[k + 2 * kReach]}; }
  /// Quadrants q of the symbols a = exp(j (pi/4 + q pi/2)), 0 ... 3; empty for a burst of given symbols.
  /// The payload's dibits are differences: d_k = (q_k - q_{k-1}) mod 4.
  [[nodiscard]] std::span<const std::uint8_t> quadrants() const noexcept { return quadrants_; }

 private:
  template <bool kAdd>
  void render_all(const Arrival& arrival, std::span<Cf32> out) const noexcept;

  std::size_t symbols_ = 0;
  std::size_t payload_start_ = 0;
  std::vector<std::uint8_t> quadrants_;
  std::vector<float> re_, im_;  // symbols between 2 kReach zeros on either side
};

/// The pulse g(t) at t [symbols of 40 us]: exact formula, cut and faded as Burst has it; zero beyond 12. No allocation.
[[nodiscard]] double pulse(double t_symbols) noexcept;

/// Symbols of a burst that starts at `start_s` in samples, by the matched filter:
/// out[k] = sum_n x[n] g(t_n - start_s - (k + 1/2) T) exp(-j 2 pi frequency_hz t_n) / (f_s T), t_n = n / f_s.
/// The carrier's phase stays in; samples beyond the capture count as zero. 24 f_s T terms a symbol; no allocation.
/// @throws std::invalid_argument for a rate below 35 kHz or numbers that are not finite.
void matched_filter(IqSpan samples, double sample_rate_hz, double start_s, double frequency_hz, std::span<Cf32> out);

}  // namespace soopnav::iridium
