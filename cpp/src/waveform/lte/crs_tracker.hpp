#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "soopnav/waveform/lte/types.hpp"
#include "waveform/lte/demodulator.hpp"

namespace soopnav::lte {

/// What is known of a link when its reference signals are read: times in samples of the tracker's rate.
struct LinkState {
  double frame_start = 0.0;  ///< first sample (cyclic prefix included) of frame 0; may be negative
  double drift = 0.0;        ///< samples gained per sample: minus the clock error
  double frequency = 0.0;    ///< carrier offset, cycles per sample
};

/// The cell whose reference signals are read.
struct CrsCell {
  int cell_id = 0;
  CyclicPrefix cp = CyclicPrefix::kNormal;
  Duplex duplex = Duplex::kFdd;
  int n_rb = 6;  ///< resource blocks used, at most the cell's
  int n_ports = 1;
};

/// Reads the cell-specific reference signals of one cell out of a capture and averages them frame by frame.
///
/// Both shifts of the comb together put a reference element on every third subcarrier; a port's channel is `elements()`
/// values, lowest first, whose frequencies `frequency(j)` step by 45 kHz except across the skipped carrier (60 kHz).
class CrsTracker {
 public:
  explicit CrsTracker(int fft_size);

  void configure(const CrsCell& cell);
  [[nodiscard]] const CrsCell& cell() const noexcept { return cell_; }

  /// One frame's average.
  struct Frame {
    int index = 0;              // frame number, 0 starts at LinkState::frame_start
    int symbols = 0;            // OFDM symbols that carried reference signals of port 0
    double mean_time = 0.0;     // mean time of those, samples
    double noise_variance = 0;  // of one element, from the spread within the frame; 0 when a single symbol cannot tell
    double noise_weight = 0;    // degrees of freedom of it
  };

  /// Reads every frame that has at least `min_symbols` symbols with reference signals of port 0 in the capture.
  void read(IqSpan iq, const LinkState& state, int min_symbols);

  /// Reads slots `first_slot` ... `first_slot + slots - 1` of `frame` as the only "frame"; false when a port was not
  /// heard on both halves of the comb. A single slot has ports 2 and 3 on one half only: the other is zero then.
  /// Allocates nothing after the first call for a cell.
  [[nodiscard]] bool read_slots(IqSpan iq, const LinkState& state, int frame, int first_slot, int slots);

  [[nodiscard]] const std::vector<Frame>& frames() const noexcept { return frames_; }
  [[nodiscard]] int elements() const noexcept { return 4 * cell_.n_rb; }
  /// In units of 15 kHz.
  [[nodiscard]] const std::vector<int>& element_frequencies() const noexcept { return frequencies_; }
  /// Average channel of `port` in frames()[frame].
  [[nodiscard]] const Cf32* channel(std::size_t frame, int port) const noexcept;
  [[nodiscard]] Cf32* channel(std::size_t frame, int port) noexcept;
  /// Symbols behind an element of parity 0 or 1.
  [[nodiscard]] int symbols(std::size_t frame, int port, int parity) const noexcept;

  /// Noise variance of one resource element over all frames.
  [[nodiscard]] double noise_variance() const noexcept { return noise_variance_; }

  /// TDD: subframes whose reference signals are there, bit s for subframe s. FDD: all.
  void set_subframes(unsigned mask) noexcept { subframes_ = mask; }
  [[nodiscard]] unsigned subframes() const noexcept { return subframes_; }
  /// Marks the TDD subframes beyond 0, 1, 5, 6 in which the cell of the last `read` is heard.
  void find_downlink_subframes(IqSpan iq, const LinkState& state);

  /// Whether symbol `symbol` of `slot` may be read under the duplex mode and the mask.
  [[nodiscard]] bool transmitted(int slot, int symbol) const noexcept;

  [[nodiscard]] Demodulator& demodulator() noexcept { return demodulator_; }
  [[nodiscard]] int fft_size() const noexcept { return fft_size_; }
  /// Start of the useful part of a symbol, samples.
  [[nodiscard]] double useful_start(const LinkState& state, int frame, int slot, int symbol) const noexcept;
  [[nodiscard]] int back() const noexcept { return back_; }

  /// Conjugated reference values of `slot` and reference symbol `which` (0: first, 1: second, 2: ports 2 and 3).
  [[nodiscard]] const Cf32* reference(int slot, int which) const noexcept;
  [[nodiscard]] int reference_symbol(int which) const noexcept;
  /// Parity (which half of the comb) of a port's elements in that symbol.
  [[nodiscard]] int parity(int port, int slot, int which) const noexcept;
  [[nodiscard]] int first_offset() const noexcept { return offset_; }

 private:
  void begin(std::size_t frames_max);
  bool read_frame(IqSpan iq, const LinkState& state, int frame, int first_slot, int slots, int min_symbols);
  bool accumulate(IqSpan iq, const LinkState& state, int frame, int slot, int which, int ports_from, int ports_to);

  int fft_size_, back_;
  Demodulator demodulator_;
  CrsCell cell_{};
  int offset_ = 0;  // lower of the comb's two shifts
  unsigned subframes_ = 0x3ff;
  std::vector<int> frequencies_;
  std::vector<Cf32> references_;  // [slot][which][2 n_rb]
  std::vector<Cf32> pilots_, sums_;
  std::vector<Cf32> channels_;  // [frame][port][elements]
  std::vector<std::array<std::array<int, 2>, kMaxPorts>> counts_;
  std::array<std::array<int, 2>, kMaxPorts> count_{};
  double energy_ = 0.0, time_sum_ = 0.0, noise_sum_ = 0.0, noise_weight_ = 0.0;
  std::vector<Frame> frames_;
  double noise_variance_ = 0.0;
};

}  // namespace soopnav::lte
