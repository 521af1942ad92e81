#include "waveform/lte/crs_tracker.hpp"

#include <algorithm>
#include <cmath>

#include "soopnav/waveform/lte/sequences.hpp"
#include "waveform/lte/kernels.hpp"

namespace soopnav::lte {

namespace {
constexpr int kSlots = 20;
constexpr int kReferenceSymbols = 3;
constexpr unsigned kTddCertain = (1U << 0) | (1U << 5);  // subframes that are downlink in every configuration
constexpr unsigned kTddSpecial = (1U << 1) | (1U << 6);  // downlink at least in their first three symbols
}  // namespace

CrsTracker::CrsTracker(int fft_size) : fft_size_(fft_size), back_(3 * (fft_size / 128)), demodulator_(fft_size) {}

void CrsTracker::configure(const CrsCell& cell) {
  cell_ = cell;
  const int v_shift = cell.cell_id % 6;
  offset_ = v_shift % 3;
  const auto count = static_cast<std::size_t>(2 * cell.n_rb);
  references_.resize(static_cast<std::size_t>(kSlots * kReferenceSymbols) * count);
  for (int slot = 0; slot < kSlots; ++slot) {
    for (int which = 0; which < (cell.n_ports > 2 ? 3 : 2); ++which) {
      Cf32* out = references_.data() + static_cast<std::size_t>(slot * kReferenceSymbols + which) * count;
      crs_values(cell.cell_id, slot, reference_symbol(which), cell.cp, cell.n_rb, {out, count});
      for (std::size_t i = 0; i < count; ++i) out[i] = std::conj(out[i]);
    }
  }
  frequencies_.resize(static_cast<std::size_t>(elements()));
  for (int j = 0; j < elements(); ++j) {
    const int centred = 3 * j + offset_ - 6 * cell.n_rb;
    frequencies_[static_cast<std::size_t>(j)] = centred < 0 ? centred : centred + 1;
  }
  pilots_.resize(count);
  sums_.resize(2 * count * static_cast<std::size_t>(cell.n_ports));
  subframes_ = cell.duplex == Duplex::kFdd ? 0x3ffU : (kTddCertain | kTddSpecial);
  frames_.clear();
}

const Cf32* CrsTracker::reference(int slot, int which) const noexcept {
  return references_.data() + static_cast<std::size_t>((slot * kReferenceSymbols + which) * 2 * cell_.n_rb);
}

int CrsTracker::reference_symbol(int which) const noexcept {
  return which == 0 ? 0 : which == 1 ? symbols_per_slot(cell_.cp) - 3 : 1;
}

int CrsTracker::parity(int port, int slot, int which) const noexcept {
  const int first = crs_first_subcarrier(cell_.cell_id, slot, reference_symbol(which), port);
  return first == offset_ ? 0 : 1;
}

const Cf32* CrsTracker::channel(std::size_t frame, int port) const noexcept {
  return channels_.data() + (frame * static_cast<std::size_t>(cell_.n_ports) + static_cast<std::size_t>(port)) *
                                static_cast<std::size_t>(elements());
}

Cf32* CrsTracker::channel(std::size_t frame, int port) noexcept {
  return channels_.data() + (frame * static_cast<std::size_t>(cell_.n_ports) + static_cast<std::size_t>(port)) *
                                static_cast<std::size_t>(elements());
}

int CrsTracker::symbols(std::size_t frame, int port, int parity) const noexcept {
  return counts_[frame][static_cast<std::size_t>(port)][static_cast<std::size_t>(parity)];
}

bool CrsTracker::transmitted(int slot, int symbol) const noexcept {
  if (cell_.duplex == Duplex::kFdd) return true;
  const unsigned bit = 1U << (slot / 2);
  if ((subframes_ & bit) == 0) return false;
  return (kTddSpecial & bit) == 0 || (slot % 2 == 0 && symbol < 3);  // a special subframe holds three symbols for sure
}

double CrsTracker::useful_start(const LinkState& state, int frame, int slot, int symbol) const noexcept {
  const int unit = fft_size_ / 128;
  const int in_slot =
      symbol_start_samples(cell_.cp, symbol, fft_size_) + cyclic_prefix_samples(cell_.cp, symbol, fft_size_);
  const double nominal = (static_cast<double>(frame) * kSlots + slot) * 960.0 * unit + in_slot;
  return state.frame_start + nominal * (1.0 + state.drift);
}

bool CrsTracker::accumulate(IqSpan iq, const LinkState& state, int frame, int slot, int which, int ports_from,
                            int ports_to) {
  const double start = useful_start(state, frame, slot, reference_symbol(which));
  if (!demodulator_.transform(iq, start, back_)) return false;
  const auto count = static_cast<std::size_t>(2 * cell_.n_rb);
  for (int port = ports_from; port < ports_to; ++port) {
    const int half = parity(port, slot, which);
    const int first = offset_ + 3 * half - 6 * cell_.n_rb;
    demodulator_.pilots(first, 2 * cell_.n_rb, reference(slot, which), pilots_.data());
    Cf32* sum = sums_.data() + (static_cast<std::size_t>(port) * 2 + static_cast<std::size_t>(half)) * count;
    for (std::size_t i = 0; i < count; ++i) sum[i] += pilots_[i];
    energy_ += kernels::energy(pilots_.data(), count);
    ++count_[static_cast<std::size_t>(port)][static_cast<std::size_t>(half)];
  }
  if (ports_from == 0) time_sum_ += start;
  return true;
}

void CrsTracker::begin(std::size_t frames_max) {
  frames_.clear();
  counts_.clear();
  frames_.reserve(frames_max);
  counts_.reserve(frames_max);
  channels_.resize(frames_max * static_cast<std::size_t>(cell_.n_ports) * static_cast<std::size_t>(elements()));
  noise_sum_ = 0.0;
  noise_weight_ = 0.0;
  noise_variance_ = 0.0;
}

bool CrsTracker::read_frame(IqSpan iq, const LinkState& state, int frame, int first_slot, int slots, int min_symbols) {
  std::fill(sums_.begin(), sums_.end(), Cf32{});
  count_ = {};
  energy_ = 0.0;
  time_sum_ = 0.0;
  int symbols = 0;
  for (int slot = first_slot; slot < first_slot + slots; ++slot) {
    for (int which = 0; which < (cell_.n_ports > 2 ? 3 : 2); ++which) {
      if (!transmitted(slot, reference_symbol(which))) continue;
      const bool low = which < 2;
      const int from = low ? 0 : 2, to = low ? std::min(cell_.n_ports, 2) : cell_.n_ports;
      if (accumulate(iq, state, frame, slot, which, from, to) && low) ++symbols;
    }
  }
  if (symbols < std::max(1, min_symbols)) return false;
  for (int port = 0; port < (slots == 1 ? std::min(cell_.n_ports, 2) : cell_.n_ports); ++port) {
    for (const int c : count_[static_cast<std::size_t>(port)]) {
      if (c == 0) return false;  // a port not heard on both halves of the comb
    }
  }
  Frame out;
  out.index = frame;
  out.symbols = symbols;
  out.mean_time = time_sum_ / symbols;
  double explained = 0.0, freedom = 0.0;
  const auto count = static_cast<std::size_t>(2 * cell_.n_rb);
  for (int port = 0; port < cell_.n_ports; ++port) {
    Cf32* to = channel(frames_.size(), port);
    for (int half = 0; half < 2; ++half) {
      const int n = count_[static_cast<std::size_t>(port)][static_cast<std::size_t>(half)];
      const Cf32* sum = sums_.data() + (static_cast<std::size_t>(port) * 2 + static_cast<std::size_t>(half)) * count;
      if (n == 0) {
        for (std::size_t i = 0; i < count; ++i) to[2 * i + static_cast<std::size_t>(half)] = Cf32{};
        continue;
      }
      explained += kernels::energy(sum, count) / n;
      freedom += static_cast<double>(n - 1) * static_cast<double>(count);
      const float scale = 1.0F / static_cast<float>(n);
      for (std::size_t i = 0; i < count; ++i) to[2 * i + static_cast<std::size_t>(half)] = sum[i] * scale;
    }
  }
  if (freedom > 0.0) out.noise_variance = std::max(0.0, energy_ - explained) / freedom;
  out.noise_weight = freedom;
  noise_sum_ += out.noise_variance * freedom;
  noise_weight_ += freedom;
  noise_variance_ = noise_weight_ > 0.0 ? noise_sum_ / noise_weight_ : 0.0;
  frames_.push_back(out);
  counts_.push_back(count_);
  return true;
}

bool CrsTracker::read_slots(IqSpan iq, const LinkState& state, int frame, int first_slot, int slots) {
  begin(1);
  demodulator_.set_frequency(state.frequency);
  return read_frame(iq, state, frame, first_slot, slots, 1);
}

void CrsTracker::read(IqSpan iq, const LinkState& state, int min_symbols) {
  demodulator_.set_frequency(state.frequency);
  const double frame_samples = 19200.0 * (fft_size_ / 128) * (1.0 + state.drift);
  const int first = static_cast<int>(std::floor(-state.frame_start / frame_samples));
  const int last = static_cast<int>(std::floor((static_cast<double>(iq.size()) - state.frame_start) / frame_samples));
  begin(static_cast<std::size_t>(std::max(0, last - first + 1)));
  for (int frame = first; frame <= last; ++frame) read_frame(iq, state, frame, 0, kSlots, min_symbols);
}

void CrsTracker::find_downlink_subframes(IqSpan iq, const LinkState& state) {
  if (cell_.duplex == Duplex::kFdd || frames_.empty()) return;
  const auto count = static_cast<std::size_t>(2 * cell_.n_rb);
  unsigned mask = kTddCertain | kTddSpecial;
  for (int subframe : {3, 4, 7, 8, 9}) {  // 2 is uplink in every configuration
    double projected = 0.0, reference_energy = 0.0;
    for (std::size_t f = 0; f < frames_.size(); ++f) {
      for (int slot = 2 * subframe; slot < 2 * subframe + 2; ++slot) {
        const double start = useful_start(state, frames_[f].index, slot, 0);
        if (!demodulator_.transform(iq, start, back_)) continue;
        const int half = parity(0, slot, 0);
        demodulator_.pilots(offset_ + 3 * half - 6 * cell_.n_rb, 2 * cell_.n_rb, reference(slot, 0), pilots_.data());
        const Cf32* known = channel(f, 0);
        double p = 0.0, e = 0.0;
        for (std::size_t i = 0; i < count; ++i) {
          const Cf32 k = known[2 * i + static_cast<std::size_t>(half)];
          p += static_cast<double>(kernels::multiply_conj(pilots_[i], k).real());
          e += static_cast<double>(std::norm(k));
        }
        projected += p;
        reference_energy += e;
      }
    }
    if (reference_energy > 0.0 && projected > 0.5 * reference_energy) mask |= 1U << subframe;
  }
  subframes_ = mask;
}

}  // namespace soopnav::lte
