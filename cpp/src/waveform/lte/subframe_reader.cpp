#include "waveform/lte/subframe_reader.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "waveform/lte/kernels.hpp"

namespace soopnav::lte {

int fft_size_for(double sample_rate_hz) noexcept {
  return 128 * static_cast<int>(std::ceil(sample_rate_hz / kBaseRateHz - 1e-9));
}

int usable_rb(int n_rb, double sample_rate_hz) noexcept {
  constexpr double kRbHz = 180e3;
  if (n_rb * kRbHz <= 0.96 * sample_rate_hz) return n_rb;
  return std::clamp(static_cast<int>(0.8 * sample_rate_hz / kRbHz), 6, n_rb);
}

bool is_cell(const Detection& cell) noexcept {
  const int n_rb = cell.n_rb.value_or(6), n_ports = cell.n_ports.value_or(1);
  return cell.cell_id >= 0 && cell.cell_id < kCells &&
         std::find(kBandwidthsRb.begin(), kBandwidthsRb.end(), n_rb) != kBandwidthsRb.end() &&
         (n_ports == 1 || n_ports == 2 || n_ports == 4) && std::isfinite(cell.frame_start_s) &&
         std::isfinite(cell.cfo_hz) && std::abs(cell.clock_error_ppm) < 1e5;
}

void require_receivable(double sample_rate_hz, const Detection& cell) {
  if (!(sample_rate_hz >= 1.4e6 && sample_rate_hz <= 100e6)) {
    throw std::invalid_argument("sample_rate_hz: " + std::to_string(sample_rate_hz) + "; 1.4e6 ... 100e6 expected");
  }
  if (!is_cell(cell)) {
    throw std::invalid_argument(
        "cell: identity " + std::to_string(cell.cell_id) + ", " + std::to_string(cell.n_rb.value_or(6)) + " blocks, " +
        std::to_string(cell.n_ports.value_or(1)) +
        " ports; identity 0 ... 503, 6, 15, 25, 50, 75 or 100 blocks, 1, 2 or 4 ports expected");
  }
  const double multiple = sample_rate_hz / kBaseRateHz;
  if (std::abs(multiple - std::round(multiple)) > 1e-9) {
    throw std::invalid_argument("sample_rate_hz: " + std::to_string(sample_rate_hz) +
                                "; a multiple of 1.92e6 expected");
  }
}

SubframeReader::SubframeReader(double sample_rate_hz, const Detection& cell)
    : rate_hz_(sample_rate_hz), ports_(cell.n_ports.value_or(1)), tracker_(fft_size_for(sample_rate_hz)) {
  tracker_.configure({cell.cell_id, cell.cp, cell.duplex, usable_rb(cell.n_rb.value_or(6), sample_rate_hz), ports_});
  channel_.resize(static_cast<std::size_t>(tracker_.elements() * ports_));
}

double SubframeReader::mean_time_s() const noexcept {
  const CyclicPrefix cp = tracker_.cell().cp;
  const double second = symbol_start_samples(cp, tracker_.reference_symbol(1), 128) +
                        cyclic_prefix_samples(cp, tracker_.reference_symbol(1), 128) -
                        cyclic_prefix_samples(cp, 0, 128);
  return (480.0 + 0.5 * second + cyclic_prefix_samples(cp, 0, 128) + 64.0) / kBaseRateHz;
}

bool SubframeReader::read(IqSpan iq, int subframe, double start, double frequency, bool take_turn_out) {
  energy_ = 0.0;
  LinkState state;
  state.frame_start = start - subframe * 1e-3 * rate_hz_;
  state.frequency = frequency;

  // Each slot holds the whole comb of ports 0 and 1. What turns the second against the first is the offset that is
  // left.
  const auto elements = static_cast<std::size_t>(tracker_.elements());
  if (!tracker_.read_slots(iq, state, 0, 2 * subframe, 1)) return false;
  for (int p = 0; p < ports_; ++p) {
    std::copy_n(tracker_.channel(0, p), elements, channel_.begin() + static_cast<std::ptrdiff_t>(elements) * p);
  }
  if (!tracker_.read_slots(iq, state, 0, 2 * subframe + 1, 1)) return false;
  const int pairs = std::min(ports_, 2);  // ports whose whole comb is in each slot
  Cf32 turn{};
  for (int p = 0; p < pairs; ++p) {
    turn +=
        kernels::dot_conj(tracker_.channel(0, p), channel_.data() + elements * static_cast<std::size_t>(p), elements);
  }
  turn_rad_ = static_cast<double>(std::arg(turn));
  const double phase = take_turn_out ? turn_rad_ : 0.0;
  const auto cis = [](double x) { return Cf32(static_cast<float>(std::cos(x)), static_cast<float>(std::sin(x))); };
  // The second reference symbol of a slot lies four of seven (three of six) symbols later, that of ports 2 and 3 one.
  const bool normal = tracker_.cell().cp == CyclicPrefix::kNormal;
  const double share = normal ? 549.0 / 960.0 : 0.5, share_of_second = normal ? 137.0 / 960.0 : 1.0 / 6.0;
  double noise = 0.0;
  for (int p = 0; p < ports_; ++p) {
    Cf32* a = channel_.data() + elements * static_cast<std::size_t>(p);
    const Cf32* b = tracker_.channel(0, p);
    const int early = tracker_.parity(p, 2 * subframe, p < 2 ? 0 : 2);  // elements of the first slot's earlier symbol
    for (int half = 0; half < 2; ++half) {
      if (p < 2) {
        const Cf32 back = cis(half == early ? 0.0 : -phase * share);
        const Cf32 back_second = kernels::multiply(back, cis(-phase));
        for (std::size_t j = static_cast<std::size_t>(half); j < elements; j += 2) {
          const Cf32 x = kernels::multiply(a[j], back);
          const Cf32 z = kernels::multiply(b[j], back_second);
          noise += static_cast<double>(std::norm(x - z));
          a[j] = 0.5F * (x + z);
        }
      } else {
        // Each element once, in one of the slots: scaled to the noise of a mean of two.
        const Cf32* from = half == early ? a : b;
        const Cf32 back = cis(-phase * (share_of_second + (half == early ? 0.0 : 1.0))) * std::sqrt(0.5F);
        for (std::size_t j = static_cast<std::size_t>(half); j < elements; j += 2) {
          a[j] = kernels::multiply(from[j], back);
        }
      }
    }
    energy_ += kernels::energy(a, elements);
  }
  noise_variance_ = noise / (2.0 * static_cast<double>(elements) * pairs);
  return std::isfinite(energy_) && energy_ > 0.0;
}

}  // namespace soopnav::lte
