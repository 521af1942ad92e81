#include "waveform/lte/canceller.hpp"

#include <algorithm>
#include <cmath>

#include "soopnav/waveform/lte/sequences.hpp"
#include "waveform/lte/frame_layout.hpp"
#include "waveform/lte/kernels.hpp"
#include "waveform/lte/synthesis_grid.hpp"

namespace soopnav::lte {

namespace {
constexpr double kEarliestS = -1.2e-6;  // of a path about the tracked delay
constexpr double kLatestS = 4.7e-6;     // a normal cyclic prefix
constexpr double kFloor = 1e-3;
constexpr int kBack = 3;
constexpr int kElements = 24;  // reference elements of a port in six resource blocks

Eigen::VectorXd comb_frequencies(int offset) {
  Eigen::VectorXd f(kElements);
  for (int j = 0; j < kElements; ++j) {
    const int centred = 3 * j + offset - 36;
    f(j) = centred < 0 ? centred : centred + 1;
  }
  return f;
}
}  // namespace

Eigen::VectorXd sync_frequencies() {
  Eigen::VectorXd f(kSyncSubcarriers);
  for (int k = 0; k < kSyncSubcarriers; ++k) f(k) = k < 31 ? k - 31 : k - 30;
  return f;
}

Canceller::Canceller()
    : demodulator_(kSearchFft),
      inverse_(kSearchFft, dsp::FftDirection::kInverse),
      sync_(sync_frequencies(), kEarliestS, kLatestS, kFloor),
      bins_(kSearchFft),
      symbol_(kSearchFft),
      rotator_(kSearchFft + 32) {
  Eigen::VectorXd all(kCentral);
  for (int k = 0; k < kCentral; ++k) all(k) = k < kCentral / 2 ? k - kCentral / 2 : k - kCentral / 2 + 1;
  for (int offset = 0; offset < 3; ++offset) {
    comb_.emplace_back(comb_frequencies(offset), kEarliestS, kLatestS, kFloor);
    comb_.back().set_targets(all);
  }
}

// Takes the symbol whose subcarriers lie in bins_ (a unitary transform's, phases referred to the useful part's start)
// out of the capture, cyclic prefix included.
void Canceller::subtract_symbol(double useful_start, int prefix, double frequency, std::span<Cf32> iq) {
  const double first = std::ceil(useful_start - prefix);
  const int length = kSearchFft + prefix;
  if (first < 0.0 || first + length > static_cast<double>(iq.size())) return;
  const double step = (first - useful_start) / kSearchFft;
  std::array<Cf32, kSearchFft / 2> ramp;
  const float scale = 1.0F / std::sqrt(static_cast<float>(kSearchFft));
  kernels::phasors(0.0, step, ramp.data(), ramp.size());
  for (std::size_t k = 1; k < ramp.size(); ++k) bins_[k] = kernels::multiply(bins_[k], ramp[k] * scale);
  for (std::size_t k = 1; k < ramp.size(); ++k) {
    bins_[kSearchFft - k] = kernels::multiply(bins_[kSearchFft - k], std::conj(ramp[k]) * scale);
  }
  bins_[0] = Cf32{};
  bins_[kSearchFft / 2] = Cf32{};
  inverse_.execute(bins_.data(), symbol_.data());
  const auto count = static_cast<std::size_t>(length);
  kernels::phasors(frequency * first, frequency, rotator_.data(), count);
  Cf32* to = iq.data() + static_cast<std::size_t>(first);
  for (std::size_t n = 0; n < count; ++n) to[n] -= kernels::multiply(symbol_[n % kSearchFft], rotator_[n]);
}

void Canceller::subtract(const LinkState& state, const CrsTracker& tracker, std::span<Cf32> iq) {
  const CrsCell& cell = tracker.cell();
  const double half_frame = kHalfFrameSamples * (1.0 + state.drift);
  const int first = static_cast<int>(std::floor(-state.frame_start / half_frame));
  const int last = static_cast<int>(std::ceil((static_cast<double>(iq.size()) - state.frame_start) / half_frame));
  const int pss_at = pss_in_half_frame(cell.duplex, cell.cp);
  const int sss_at = pss_at - sss_before_pss(cell.duplex, cell.cp);
  // Both symbols are short in the prefix that they do not share with a slot's start.
  const int prefix = cell.cp == CyclicPrefix::kExtended ? 32 : 9;
  const auto& sequence = pss(cell.cell_id % 3);
  demodulator_.set_frequency(state.frequency);
  std::array<Cf32, kSyncSubcarriers> sum, channel, other;
  const auto fill_bins = [&](const auto& sequence_of) {
    std::fill(bins_.begin(), bins_.end(), Cf32{});
    for (std::size_t k = 0; k < kSyncSubcarriers; ++k) {
      bins_[k < 31 ? kSearchFft - 31 + k : k - 30] = kernels::multiply(channel[k], sequence_of(k));
    }
  };
  for (int h = first; h < last; ++h) {
    const int subframe = ((h % 2) + 2) % 2 == 0 ? 0 : 5;
    const auto secondary = sss(cell.cell_id, subframe);
    const double start = state.frame_start + h * half_frame;
    const double pss_start = start + pss_at * (1.0 + state.drift), sss_start = start + sss_at * (1.0 + state.drift);
    sum.fill({});
    int heard = 0;
    if (demodulator_.transform(iq, pss_start, kBack)) {
      demodulator_.subcarriers(31, other.data());
      for (std::size_t k = 0; k < kSyncSubcarriers; ++k) sum[k] += kernels::multiply_conj(other[k], sequence[k]);
      ++heard;
    }
    if (demodulator_.transform(iq, sss_start, kBack)) {
      demodulator_.subcarriers(31, other.data());
      for (std::size_t k = 0; k < kSyncSubcarriers; ++k) sum[k] += other[k] * secondary[k];
      ++heard;
    }
    if (heard == 0) continue;
    for (Cf32& x : sum) x /= static_cast<float>(heard);
    sync_.project(sum.data(), channel.data());
    fill_bins([&](std::size_t k) { return sequence[k]; });
    subtract_symbol(pss_start, prefix, state.frequency, iq);
    fill_bins([&](std::size_t k) { return Cf32(secondary[k], 0.0F); });
    subtract_symbol(sss_start, prefix, state.frequency, iq);
  }

  const DelaySubspace& subspace = comb_[static_cast<std::size_t>(tracker.first_offset())];
  const auto& frequencies = tracker.element_frequencies();
  std::array<std::array<Cf32, kElements>, kMaxPorts> smoothed;
  for (std::size_t f = 0; f < tracker.frames().size(); ++f) {
    const int frame = tracker.frames()[f].index;
    for (int port = 0; port < cell.n_ports; ++port) {
      subspace.project(tracker.channel(f, port), smoothed[static_cast<std::size_t>(port)].data());
    }
    for (int slot = 0; slot < 20; ++slot) {
      for (int which = 0; which < (cell.n_ports > 2 ? 3 : 2); ++which) {
        const int symbol = tracker.reference_symbol(which);
        if (!tracker.transmitted(slot, symbol)) continue;
        const Cf32* reference = tracker.reference(slot, which);
        std::fill(bins_.begin(), bins_.end(), Cf32{});
        const int from = which == 2 ? 2 : 0, to = which == 2 ? 4 : std::min(cell.n_ports, 2);
        for (int port = from; port < to; ++port) {
          const int half = tracker.parity(port, slot, which);
          for (int m = 0; m < kElements / 2; ++m) {
            const auto j = static_cast<std::size_t>(2 * m + half);
            const auto bin = static_cast<std::size_t>((frequencies[j] + kSearchFft) % kSearchFft);
            bins_[bin] = kernels::multiply_conj(smoothed[static_cast<std::size_t>(port)][j], reference[m]);
          }
        }
        subtract_symbol(tracker.useful_start(state, frame, slot, symbol),
                        cyclic_prefix_samples(cell.cp, symbol, kSearchFft), state.frequency, iq);
      }
    }
  }
}

void Canceller::subtract_pbch(const LinkState& state, const CrsTracker& tracker, const MasterInformationBlock& mib,
                              std::span<Cf32> iq) {
  const CrsCell& cell = tracker.cell();
  CellParameters& sent = sent_;
  sent.cell_id = cell.cell_id;
  sent.n_rb = mib.n_rb;
  sent.n_ports = cell.n_ports;
  sent.cp = cell.cp;
  sent.extended_phich = mib.extended_phich;
  sent.phich_resource = mib.phich_resource;
  sent.data_load = 0.0;
  grid_.resize(detail::grid_size(sent));
  const int symbols = 2 * symbols_per_slot(cell.cp), width = 12 * mib.n_rb, first = 6 * mib.n_rb - kCentral / 2;
  const DelaySubspace& subspace = comb_[static_cast<std::size_t>(tracker.first_offset())];
  std::array<std::array<Cf32, kCentral>, kMaxPorts> channel;
  std::array<std::array<Cf32, kCentral>, 4> predicted;
  std::array<Cf32, kCentral> received;
  demodulator_.set_frequency(state.frequency);
  for (std::size_t f = 0; f < tracker.frames().size(); ++f) {
    const int frame = tracker.frames()[f].index;
    detail::fill_grid(sent, (((mib.sfn + frame) % 1024) + 1024) % 1024, 0, 0, grid_);
    for (int port = 0; port < cell.n_ports; ++port) {
      subspace.interpolate(tracker.channel(f, port), channel[static_cast<std::size_t>(port)].data());
    }
    // The PBCH's power beside that of the reference signals is the operator's choice: one factor for the frame.
    double cross = 0.0, power = 0.0;
    for (int symbol = 0; symbol < 4; ++symbol) {
      auto& x = predicted[static_cast<std::size_t>(symbol)];
      x.fill({});
      for (int port = 0; port < cell.n_ports; ++port) {
        const int row = (port * symbols + symbols / 2 + symbol) * width + first;
        for (int k = 0; k < kCentral; ++k) {
          if ((k - tracker.first_offset()) % 3 == 0 && symbol < 2) continue;  // reference elements have gone already
          x[static_cast<std::size_t>(k)] +=
              kernels::multiply(channel[static_cast<std::size_t>(port)][static_cast<std::size_t>(k)],
                                grid_[static_cast<std::size_t>(row + k)]);
        }
      }
      if (!demodulator_.transform(iq, tracker.useful_start(state, frame, 1, symbol), kBack)) continue;
      demodulator_.subcarriers(kCentral / 2, received.data());
      cross += static_cast<double>(kernels::dot_conj(received.data(), x.data(), kCentral).real());
      power += kernels::energy(x.data(), kCentral);
    }
    if (!(power > 0.0)) continue;
    const auto factor = static_cast<float>(std::clamp(cross / power, 0.0, 2.0));
    for (int symbol = 0; symbol < 4; ++symbol) {
      std::fill(bins_.begin(), bins_.end(), Cf32{});
      for (int k = 0; k < kCentral; ++k) {
        const int bin = k < kCentral / 2 ? kSearchFft - kCentral / 2 + k : k - kCentral / 2 + 1;
        bins_[static_cast<std::size_t>(bin)] =
            factor * predicted[static_cast<std::size_t>(symbol)][static_cast<std::size_t>(k)];
      }
      subtract_symbol(tracker.useful_start(state, frame, 1, symbol), cyclic_prefix_samples(cell.cp, symbol, kSearchFft),
                      state.frequency, iq);
    }
  }
}

}  // namespace soopnav::lte
