#pragma once

#include <array>
#include <vector>

#include "waveform/lte/crs_tracker.hpp"

namespace soopnav::lte {

/// Transform size whose rate is the nearest multiple of 1.92 Msps not below `sample_rate_hz`.
[[nodiscard]] int fft_size_for(double sample_rate_hz) noexcept;

/// Resource blocks of `n_rb` that a capture of this rate holds: all, if its filters were made for it, else what lies
/// well inside the band.
[[nodiscard]] int usable_rb(int n_rb, double sample_rate_hz) noexcept;

/// Whether identity, bandwidth, ports and times are such as a cell can have.
[[nodiscard]] bool is_cell(const Detection& cell) noexcept;

/// @throws std::invalid_argument naming `sample_rate_hz` or `cell`: the rate a multiple of 1.92e6 in 1.92e6 ... 100e6,
/// the cell as `is_cell` has it.
void require_receivable(double sample_rate_hz, const Detection& cell);

/// The channel of each port from the two slots of one subframe, both shifts of the comb, with what turns the second
/// slot against the first (cpp/doc/lte_time_of_arrival.md section 2).
///
/// Allocates nothing after the first `read`.
class SubframeReader {
 public:
  SubframeReader(double sample_rate_hz, const Detection& cell);

  /// Reads the subframe 0 ... 9 whose first sample (cyclic prefix included) is `start` of `iq`, carrier at `frequency`
  /// cycles per sample. With `take_turn_out` each symbol is turned back by its share of the offset that is left, to the
  /// subframe's first reference symbol; without, the channel is the mean of the two slots as they are. False when
  /// samples are missing, not finite or silent, or the subframe has not all reference signals of both slots.
  [[nodiscard]] bool read(IqSpan iq, int subframe, double start, double frequency, bool take_turn_out);

  [[nodiscard]] int ports() const noexcept { return ports_; }
  [[nodiscard]] int elements() const noexcept { return tracker_.elements(); }
  [[nodiscard]] const std::vector<int>& frequencies() const noexcept { return tracker_.element_frequencies(); }
  [[nodiscard]] int fft_size() const noexcept { return tracker_.fft_size(); }
  [[nodiscard]] double rate_hz() const noexcept { return rate_hz_; }
  /// Channel of `port`, elements of variance noise_variance() / 2; ports 2 and 3 scaled to that.
  [[nodiscard]] const Cf32* channel(int port) const noexcept {
    return channel_.data() + static_cast<std::size_t>(port) * static_cast<std::size_t>(elements());
  }
  /// All ports' channels one after the other.
  [[nodiscard]] std::span<const Cf32> channels() const noexcept { return channel_; }
  /// Of one resource element, from the difference of the slots.
  [[nodiscard]] double noise_variance() const noexcept { return noise_variance_; }
  /// By which the second slot is turned against the first [rad].
  [[nodiscard]] double turn_rad() const noexcept { return turn_rad_; }
  /// Sum over ports and elements of |channel|^2.
  [[nodiscard]] double energy() const noexcept { return energy_; }
  /// Sum over ports of a port's share of reference elements: 1, 2, or 3 for four ports.
  [[nodiscard]] double port_weight() const noexcept { return ports_ > 2 ? 3.0 : ports_; }
  /// Mean time of the reference symbols of ports 0 and 1 after the subframe's start, their useful parts' middles [s].
  [[nodiscard]] double mean_time_s() const noexcept;
  [[nodiscard]] CrsTracker& tracker() noexcept { return tracker_; }
  [[nodiscard]] const CrsTracker& tracker() const noexcept { return tracker_; }

 private:
  double rate_hz_;
  int ports_;
  CrsTracker tracker_;
  std::vector<Cf32> channel_;
  double noise_variance_ = 0.0, turn_rad_ = 0.0, energy_ = 0.0;
};

}  // namespace soopnav::lte
