// Derivation: cpp/doc/lte_synthesis.md
#include "soopnav/waveform/lte/synthesis.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "soopnav/core/random.hpp"
#include "soopnav/dsp/fft.hpp"
#include "waveform/lte/synthesis_grid.hpp"

namespace soopnav::lte {
namespace {

using Cf64 = std::complex<double>;

constexpr double kTicksPerSecond = 30.72e6;  // 1 / T_s of TS 36.211 section 4
constexpr std::int64_t kTicksPerSubframe = 30720;
constexpr double kSubframeS = 1e-3;

// A sample this close (in samples) before a symbol's border belongs to the symbol: rounding must not move whole
// samples.
constexpr double kBorderTolerance = 1e-6;

Cf64 turn(double cycles) noexcept {
  return std::polar(1.0, 2.0 * std::numbers::pi * (cycles - std::nearbyint(cycles)));
}

// Products of finite numbers without the library's checks for infinities.
Cf64 times(Cf64 a, Cf64 b) noexcept {
  return {a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real()};
}
Cf32 times(Cf32 a, Cf32 b) noexcept {
  return {a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real()};
}
Cf32 narrow(Cf64 a) noexcept { return {static_cast<float>(a.real()), static_cast<float>(a.imag())}; }

/// Evaluates y[m] = sum over k of b[k - first] exp(j 2 pi k nu m), m = 0 ... n_samples - 1, `nu` in cycles per sample.
///
/// Where 1/nu is a whole number N that is one inverse transform of N points, repeated; elsewhere a chirp transform
/// (doc eq. 3). Buffers are made by the constructor.
class ToneSum {
 public:
  ToneSum(int first, int last, double nu, int n_samples, bool whole)
      : first_(first),
        n_tones_(static_cast<std::size_t>(last - first + 1)),
        n_samples_(static_cast<std::size_t>(n_samples)) {
    if (whole) {
      period_ = static_cast<std::size_t>(std::lround(1.0 / nu));
      inverse_.emplace(static_cast<int>(period_), dsp::FftDirection::kInverse);
      in_.resize(period_);
      out_.resize(period_);
      return;
    }
    const int size = dsp::fast_fft_size(last - first + n_samples);
    const auto n = static_cast<std::size_t>(size);
    forward_.emplace(size, dsp::FftDirection::kForward);
    inverse_.emplace(size, dsp::FftDirection::kInverse);
    in_.resize(n);
    out_.resize(n);
    // k m = (k^2 + m^2 - (m - k)^2) / 2 with k counted from the first tone.
    const auto chirp = [nu](std::size_t i) { return turn(0.5 * nu * static_cast<double>(i) * static_cast<double>(i)); };
    for (std::size_t i = 0; i < n_samples_; ++i) in_[i] = narrow(std::conj(chirp(i)));
    for (std::size_t i = 1; i < n_tones_; ++i) in_[n - i] = narrow(std::conj(chirp(i)));
    kernel_.resize(n);
    forward_->execute(in_.data(), kernel_.data());
    before_.resize(n_tones_);
    for (std::size_t i = 0; i < n_tones_; ++i) before_[i] = chirp(i);
    after_.resize(n_samples_);
    for (std::size_t m = 0; m < n_samples_; ++m) {
      after_[m] = narrow(times(chirp(m), turn(nu * first * static_cast<double>(m))) / static_cast<double>(n));
    }
  }

  /// Calls `sink(m, y[m])` for m in [from, to).
  template <class Sink>
  void evaluate(std::span<const Cf64> b, std::size_t from, std::size_t to, Sink&& sink) {
    std::fill(in_.begin(), in_.end(), Cf32{});
    if (kernel_.empty()) {
      for (std::size_t i = 0; i < n_tones_; ++i) {
        const auto k = static_cast<std::ptrdiff_t>(i) + first_;
        in_[static_cast<std::size_t>(k < 0 ? k + static_cast<std::ptrdiff_t>(period_) : k)] = narrow(b[i]);
      }
      inverse_->execute(in_.data(), out_.data());
      std::size_t i = from % period_;
      for (std::size_t m = from; m < to; ++m) {
        sink(m, out_[i]);
        if (++i == period_) i = 0;
      }
      return;
    }
    for (std::size_t i = 0; i < n_tones_; ++i) in_[i] = narrow(times(b[i], before_[i]));
    forward_->execute(in_.data(), out_.data());
    for (std::size_t i = 0; i < out_.size(); ++i) out_[i] = times(out_[i], kernel_[i]);
    inverse_->execute(out_.data(), in_.data());
    for (std::size_t m = from; m < to; ++m) sink(m, times(in_[m], after_[m]));
  }

 private:
  std::ptrdiff_t first_;
  std::size_t n_tones_;
  std::size_t n_samples_;
  std::size_t period_ = 0;
  std::optional<dsp::Fft> forward_, inverse_;
  std::vector<Cf32> in_, out_, kernel_, after_;
  std::vector<Cf64> before_;
};

/// One cell at one sample rate.
class CellSource {
 public:
  CellSource(const CellParameters& cell, double rate_hz, std::uint64_t seed)
      : cell_(cell), rate_hz_(rate_hz), seed_(seed), stretch_(1.0 + 1e-6 * cell.clock_error_ppm), tones_(make_tones()) {
    gain_ = std::sqrt(kSubcarrierSpacingHz / rate_hz) * std::pow(10.0, cell.power_db / 20.0);
    rotation_.resize(max_samples());
    for (std::size_t m = 0; m < rotation_.size(); ++m) {
      rotation_[m] = narrow(turn(cell.cfo_hz / rate_hz * static_cast<double>(m)));
    }
    grid_.resize(detail::grid_size(cell));
    amplitudes_.resize(static_cast<std::size_t>(last_ - first_ + 1));
    turned_.resize(amplitudes_.size());
    for (const PathTap& tap : cell.taps) {
      earliest_ = std::min(earliest_, tap.delay_s);
      latest_ = std::max(latest_, tap.delay_s);
    }
  }

  /// Adds samples [begin, begin + out.size()).
  void add(std::int64_t begin, std::span<Cf32> out) {
    if (cell_.taps.empty() || out.empty() || first_ > last_) return;
    const std::int64_t end = begin + static_cast<std::int64_t>(out.size());
    const auto subframe_at = [&](std::int64_t n, double tap_s) {
      return static_cast<std::int64_t>(std::floor(cell_time(n, tap_s) / kSubframeS));
    };
    // One more on either side for the tolerance of borders.
    const std::int64_t first = subframe_at(begin, latest_) - 1, last = subframe_at(end - 1, earliest_) + 1;
    for (std::int64_t q = first; q <= last; ++q) add_subframe(q, begin, end, out);
  }

 private:
  [[nodiscard]] double cell_time(std::int64_t n, double tap_s) const noexcept {
    return (static_cast<double>(n) / rate_hz_ - cell_.delay_s - tap_s) * stretch_;
  }

  /// First sample at or after the cell's time `ticks`.
  [[nodiscard]] std::int64_t first_sample(std::int64_t ticks, double tap_s) const noexcept {
    const double time_s = static_cast<double>(ticks) / kTicksPerSecond / stretch_ + cell_.delay_s + tap_s;
    return static_cast<std::int64_t>(std::ceil(time_s * rate_hz_ - kBorderTolerance));
  }

  [[nodiscard]] std::size_t max_samples() const noexcept {
    return static_cast<std::size_t>(std::ceil(2560.0 / kTicksPerSecond / stretch_ * rate_hz_)) + 1;
  }

  /// Subcarriers that the rate holds, in `first_` ... `last_` (15 kHz units, 0 between them unused), and their
  /// evaluator.
  [[nodiscard]] ToneSum make_tones() {
    const int edge = 6 * cell_.n_rb;
    first_ = -edge;
    last_ = edge;
    const double half_band_hz = kSubcarrierSpacingHz * edge * stretch_ + std::abs(cell_.cfo_hz);
    if (!(half_band_hz < 0.5 * rate_hz_)) {
      const auto outside = [&](int k) {
        return std::abs(kSubcarrierSpacingHz * stretch_ * k + cell_.cfo_hz) > 0.45 * rate_hz_;
      };
      while (first_ <= last_ && outside(first_)) ++first_;
      while (first_ <= last_ && outside(last_)) --last_;
    }
    const double size = rate_hz_ / kSubcarrierSpacingHz;
    const bool whole = stretch_ == 1.0 && size == std::floor(size);
    return ToneSum(first_, std::max(first_, last_), stretch_ * kSubcarrierSpacingHz / rate_hz_,
                   static_cast<int>(max_samples()), whole);
  }

  void add_subframe(std::int64_t q, std::int64_t begin, std::int64_t end, std::span<Cf32> out) {
    const auto subframe = static_cast<int>((q % 10 + 10) % 10);
    const std::int64_t frame = (q - subframe) / 10 + cell_.start_sfn;
    const auto sfn = static_cast<int>((frame % 1024 + 1024) % 1024);
    const int n_downlink = downlink_symbols(cell_, subframe);
    if (n_downlink == 0) return;
    bool filled = false;
    for (int symbol = 0; symbol < n_downlink; ++symbol) {
      const int per_slot = symbols_per_slot(cell_.cp);
      const int l = symbol % per_slot;
      const std::int64_t slot_start = q * kTicksPerSubframe + (symbol / per_slot) * (kTicksPerSubframe / 2);
      const std::int64_t start = slot_start + symbol_start_samples(cell_.cp, l, 2048);
      const std::int64_t useful = start + cyclic_prefix_samples(cell_.cp, l, 2048);
      const std::int64_t stop = useful + 2048;
      bool combined = false;
      for (const PathTap& tap : cell_.taps) {
        const std::int64_t n0 = first_sample(start, tap.delay_s), n1 = first_sample(stop, tap.delay_s);
        const std::int64_t from = std::max(n0, begin), to = std::min(n1, end);
        if (from >= to) continue;
        if (!filled) {
          detail::fill_grid(cell_, sfn, subframe, seed_, grid_);
          filled = true;
        }
        if (!combined) {
          combine_ports(symbol);
          combined = true;
        }
        turn_tones(n0, useful, tap);
        tones_.evaluate(turned_, static_cast<std::size_t>(from - n0), static_cast<std::size_t>(to - n0),
                        [&, shift = n0 - begin](std::size_t m, Cf32 y) {
                          out[static_cast<std::size_t>(static_cast<std::int64_t>(m) + shift)] += times(rotation_[m], y);
                        });
      }
    }
  }

  /// Sum of the ports' elements of one symbol, each by its gain.
  void combine_ports(int symbol) noexcept {
    std::fill(amplitudes_.begin(), amplitudes_.end(), Cf64{});
    const int n_subcarriers = 12 * cell_.n_rb;
    const int n_symbols = 2 * symbols_per_slot(cell_.cp);
    for (int port = 0; port < cell_.n_ports; ++port) {
      const Cf64 gain = gain_ * cell_.port_gain[static_cast<std::size_t>(port)];
      const auto row = static_cast<std::size_t>((port * n_symbols + symbol) * n_subcarriers);
      for (int i = 0; i < n_subcarriers; ++i) {
        const int k = subcarrier_index(i, cell_.n_rb);
        if (k < first_ || k > last_) continue;
        const Cf32 value = grid_[row + static_cast<std::size_t>(i)];
        amplitudes_[static_cast<std::size_t>(k - first_)] += times(gain, Cf64(value));
      }
    }
  }

  /// Amplitudes as they stand at sample `n0`, given the cell's time of the symbol after its prefix (doc eq. 2).
  void turn_tones(std::int64_t n0, std::int64_t useful_ticks, const PathTap& tap) noexcept {
    const double since_s = cell_time(n0, tap.delay_s) - static_cast<double>(useful_ticks) / kTicksPerSecond;
    const double cycles = kSubcarrierSpacingHz * since_s;
    const double carrier_cycles = cell_.cfo_hz * (static_cast<double>(n0) / rate_hz_);
    const Cf64 step = turn(cycles);
    Cf64 phase = times(tap.gain, times(turn(carrier_cycles), std::polar(1.0, cell_.carrier_phase_rad)));
    phase = times(phase, turn(cycles * first_));
    for (std::size_t i = 0; i < amplitudes_.size(); ++i) {
      turned_[i] = times(amplitudes_[i], phase);
      phase = times(phase, step);
    }
  }

  CellParameters cell_;
  double rate_hz_;
  std::uint64_t seed_;
  double stretch_;
  double gain_ = 1.0;
  double earliest_ = 0.0, latest_ = 0.0;
  int first_ = 0, last_ = 0;
  ToneSum tones_;
  std::vector<Cf32> rotation_, grid_;
  std::vector<Cf64> amplitudes_, turned_;
};

}  // namespace

struct Synthesizer::Impl {
  std::vector<CellSource> cells;
  double noise_variance;
  RandomStream noise;
  std::int64_t position = 0;
};

Synthesizer::Synthesizer(std::span<const CellParameters> cells, double sample_rate_hz, double noise_variance,
                         std::uint64_t seed)
    : impl_(std::make_unique<Impl>()) {
  const auto refuse = [](const char* name, double value, const char* rule) {
    std::ostringstream text;
    text << name << ": " << value << ", must be " << rule;
    throw std::invalid_argument(text.str());
  };
  if (!(sample_rate_hz >= 1.4e6 && sample_rate_hz <= 100e6)) {
    refuse("sample_rate_hz", sample_rate_hz, "1.4e6 ... 100e6");
  }
  if (!(noise_variance >= 0.0 && std::isfinite(noise_variance))) {
    refuse("noise_variance", noise_variance, "finite and not negative");
  }
  for (std::size_t i = 0; i < cells.size(); ++i) detail::check_cell(cells[i], static_cast<int>(i));
  impl_->cells.reserve(cells.size());
  for (const CellParameters& cell : cells) impl_->cells.emplace_back(cell, sample_rate_hz, seed);
  impl_->noise_variance = noise_variance;
  impl_->noise = RandomStream(seed, detail::kNoiseStream);
}

Synthesizer::~Synthesizer() = default;
Synthesizer::Synthesizer(Synthesizer&&) noexcept = default;
Synthesizer& Synthesizer::operator=(Synthesizer&&) noexcept = default;

void Synthesizer::generate(std::span<Cf32> out) {
  std::fill(out.begin(), out.end(), Cf32{});
  for (CellSource& cell : impl_->cells) cell.add(impl_->position, out);
  if (impl_->noise_variance > 0.0) {
    constexpr std::uint64_t kOrigin = std::uint64_t{1} << 61;  // of positions, so that samples before 0 have noise too
    impl_->noise.seek(2 * (kOrigin + static_cast<std::uint64_t>(impl_->position)));
    impl_->noise.add_complex_normal(out, impl_->noise_variance);
  }
  impl_->position += static_cast<std::int64_t>(out.size());
}

std::int64_t Synthesizer::position() const noexcept { return impl_->position; }
void Synthesizer::seek(std::int64_t sample) noexcept { impl_->position = sample; }

std::vector<Cf32> synthesize(std::span<const CellParameters> cells, double sample_rate_hz, std::size_t n_samples,
                             double noise_variance, std::uint64_t seed) {
  std::vector<Cf32> out(n_samples);
  Synthesizer(cells, sample_rate_hz, noise_variance, seed).generate(out);
  return out;
}

}  // namespace soopnav::lte
