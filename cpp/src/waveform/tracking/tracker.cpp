#include "soopnav/waveform/tracking/tracker.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <stdexcept>
#include <string>
#include <utility>

#include "soopnav/core/constants.hpp"
#include "waveform/tracking/correlator.hpp"

namespace soopnav::tracking {
namespace {

using Complex = std::complex<double>;

constexpr std::size_t kMostEdges = 64;  // code periods of a symbol
constexpr double kLockTimeS = 0.25;     // over which presence of the signal is judged
constexpr double kSmoothS = 1.0;        // over which the C/N0 is smoothed
constexpr double kLockLevel = 20.0;     // signal to noise of an integration is not counted beyond
constexpr double kBlockEnergy = 20.0;   // signal to noise of the block of integrations that is judged for phase
constexpr double kPullInCodeHz = 2.0;   // least bandwidth of the code loop while pulling in
constexpr int kGoodBlocks = 3;          // before phase lock is declared

// Of the carrier: code tables reach 1 % of code Doppler, and what a loop pulls may not leave them.
constexpr double kMostDoppler = 0.009;

void require_tracker(bool holds, const char* name, double value, const char* rule) {
  if (!holds) throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " " + rule);
}

// Written out: std::complex multiplication looks for infinities.
Complex by_conjugate(const Complex& a, const Complex& b) noexcept {
  return {a.real() * b.real() + a.imag() * b.imag(), a.imag() * b.real() - a.real() * b.imag()};
}

double wrapped(double value, double period) noexcept { return value - period * std::round(value / period); }

// What a piece of an integration leaves to the epoch it lies in.
struct Piece {
  Sums sums{};
  double n = 0.0;
  double phase = 0.0;  // sum of the replica's phase over the samples
  double delay = 0.0;  // sum of the replica's delay
  double rate = 0.0;   // sum of the replica's Doppler
  std::uint32_t bad = 0;
};

struct Window {
  Piece sum{};              // sums.prompt: data wiped
  double code_error = 0.0;  // sum of Re((E - L) P*) / n of the integration
  double ratio = 0.0;       // sum over integrations of |P|² / n over the mean power
  double coherent = 0.0;    // sum of Re(P) or Re(P²) ...
  double size = 0.0;        // ... against its size
  double samples = 0.0;     // of whole integrations
  int integrations = 0;
  bool locked = true;
};

// As design_loop, by the option's own name.
void check_loop(const char* name, int order, double bandwidth_hz, double interval_s) {
  constexpr std::array<double, 3> kMost{0.4, 0.9, 1.6};
  require_tracker(bandwidth_hz > 0.0 && std::isfinite(bandwidth_hz), name, bandwidth_hz, "must be positive and finite");
  const double product = bandwidth_hz * interval_s;
  require_tracker(product <= kMost[static_cast<std::size_t>(order - 1)] && product >= 1e-9, name, bandwidth_hz,
                  "times its integration must be at least 1e-9 and at most 0.4, 0.9, 1.6 for orders 1, 2, 3");
}

bool whole_number(double value) noexcept { return std::abs(value - std::round(value)) < 1e-6 * std::max(value, 1.0); }

double pull_in_interval(const Signal& s, const TrackerOptions& o) noexcept {
  if (o.pull_in_integration_s > 0.0) return o.pull_in_integration_s;
  if (s.symbol_s > 0.0) return std::min(static_cast<double>(s.chips.size()) / s.chip_rate_hz, o.integration_s);
  return std::min(5e-3, o.integration_s);
}

void check(const Signal& s, const TrackerOptions& o) {
  require_tracker(!s.chips.empty(), "signal.chips", 0.0, "must not be empty");
  require_tracker(std::all_of(s.chips.begin(), s.chips.end(),
                              [](const Cf32& c) { return std::isfinite(c.real()) && std::isfinite(c.imag()); }),
                  "signal.chips", std::nan(""), "must be finite");
  require_tracker(s.chip_rate_hz > 0.0 && std::isfinite(s.chip_rate_hz), "signal.chip_rate_hz", s.chip_rate_hz,
                  "must be positive and finite");
  require_tracker(s.carrier_hz >= s.chip_rate_hz && std::isfinite(s.carrier_hz), "signal.carrier_hz", s.carrier_hz,
                  "must be finite and at least the chip rate");
  require_tracker(s.code_slope > 0.0 && s.code_slope <= 4.0, "signal.code_slope", s.code_slope, "must be in (0, 4]");
  const double period = static_cast<double>(s.chips.size()) / s.chip_rate_hz;
  require_tracker(s.symbol_s >= 0.0 && std::isfinite(s.symbol_s), "signal.symbol_s", s.symbol_s,
                  "must be finite and not negative");
  const bool data = s.symbol_s > 0.0;
  if (data) {
    require_tracker(whole_number(s.symbol_s / period) && s.symbol_s / period < kMostEdges + 0.5, "signal.symbol_s",
                    s.symbol_s, "must be 1 to 64 whole code periods");
  }
  require_tracker(o.sample_rate_hz >= s.chip_rate_hz && std::isfinite(o.sample_rate_hz), "sample_rate_hz",
                  o.sample_rate_hz, "must be finite and at least the chip rate");
  require_tracker(std::abs(o.intermediate_hz) <= 0.5 * o.sample_rate_hz, "intermediate_hz", o.intermediate_hz,
                  "must be within half the sampling rate");
  require_tracker(std::abs(o.delay_s) < 1e6, "delay_s", o.delay_s, "must be finite, below 1e6");
  require_tracker(std::abs(o.doppler_hz) <= std::min(1e6, kMostDoppler * s.carrier_hz), "doppler_hz", o.doppler_hz,
                  "must be within 1e6 and 0.9 % of the carrier");
  require_tracker(o.integration_s * o.sample_rate_hz >= 16.0 && o.integration_s <= 10.0, "integration_s",
                  o.integration_s, "must be at least 16 samples and at most 10 s");
  if (data) {
    require_tracker(whole_number(s.symbol_s / o.integration_s), "integration_s", o.integration_s,
                    "must divide a data symbol");
  }
  require_tracker(o.pll_order == 2 || o.pll_order == 3, "pll_order", o.pll_order, "must be 2 or 3");
  require_tracker(o.early_late_chips > 0.0 && o.early_late_chips <= 1.0, "early_late_chips", o.early_late_chips,
                  "must be in (0, 1]");
  require_tracker(o.epoch_s >= 2.0 * o.integration_s * (1.0 - 1e-9) && o.epoch_s <= 100.0, "epoch_s", o.epoch_s,
                  "must be at least two integrations and at most 100 s");
  require_tracker(o.pull_in_s >= 0.0 && o.pull_in_s <= 1000.0, "pull_in_s", o.pull_in_s, "must be in [0, 1000]");
  require_tracker(o.pull_in_integration_s >= 0.0 && o.pull_in_integration_s <= o.integration_s * (1.0 + 1e-9),
                  "pull_in_integration_s", o.pull_in_integration_s, "must be in [0, integration_s]");
  if (o.pull_in_integration_s > 0.0) {
    require_tracker(o.pull_in_integration_s * o.sample_rate_hz >= 16.0, "pull_in_integration_s",
                    o.pull_in_integration_s, "must be at least 16 samples");
    if (data) {
      const double ratio = (o.symbol_known ? s.symbol_s : period) / o.pull_in_integration_s;
      require_tracker(o.symbol_known ? whole_number(ratio) : std::abs(ratio - 1.0) < 1e-6, "pull_in_integration_s",
                      o.pull_in_integration_s, "must be a code period, or divide a data symbol whose edge is known");
    }
  }
  require_tracker(o.fll_bandwidth_hz >= 0.0 && std::isfinite(o.fll_bandwidth_hz), "fll_bandwidth_hz",
                  o.fll_bandwidth_hz, "must be finite and not negative");
  require_tracker(o.loss_s > 0.0 && std::isfinite(o.loss_s), "loss_s", o.loss_s, "must be positive and finite");
  require_tracker(o.pull_in_s > 0.0 || !data || o.symbol_known || whole_number(period / o.integration_s), "pull_in_s",
                  o.pull_in_s, "must be positive while the symbols' edges are unknown");
  const double pull_in = pull_in_interval(s, o);
  check_loop("pll_bandwidth_hz", o.pll_order, o.pll_bandwidth_hz, o.integration_s);
  check_loop("dll_bandwidth_hz", 1, o.dll_bandwidth_hz, o.integration_s);
  check_loop("pull_in_bandwidth_hz", 2, o.pull_in_bandwidth_hz, pull_in);
  require_tracker(kPullInCodeHz * pull_in <= 0.4, "pull_in_integration_s", pull_in, "must be at most 0.2 s");
}

}  // namespace

struct Tracker::Impl {
  TrackerOptions options;
  double chip_rate_hz, carrier_hz, symbol_s, slope;
  bool data;
  CodeTable code;
  Loop settled, pulling, code_settled, code_pulling;
  double fll_gain;

  std::array<Cf32, kRun> waiting{};
  std::size_t held = 0;
  std::array<Epoch, kMaxEpochs> out{};
  std::size_t out_count = 0;

  // The replica at sample `origin`, where the present integration began.
  std::uint64_t taken = 0;  // samples of finished runs
  std::uint64_t origin = 0, end = 0, epoch_end = 0, epoch_number = 0;
  double phase = 0.0, rate = 0.0, ramp = 0.0;  // cycles, Hz, Hz/s
  double chip = 0.0;
  double symbol_origin = 0.0;  // chips
  bool partial = false;
  Piece head{}, tail{};
  bool split = false;
  Window window{};

  TrackerState state = TrackerState::kTracking;
  std::uint64_t since = 0;  // sample at which the state began
  std::size_t updates = 0;  // integrations since then
  double lock_mean = 0.0, lock_weight = 0.0;
  double cn0 = 0.0;
  std::size_t cn0_count = 0;
  bool code_locked = false, phase_locked = false;
  Complex block{};
  double block_size = 0.0;
  int block_count = 0, good_blocks = 0;
  std::uint32_t arc = 0;
  bool had_lock = false;
  Complex last_prompt{};
  double last_middle = 0.0;
  bool has_last = false;
  std::size_t edges = 1, edge_at = 0;
  std::array<Complex, kMostEdges> edge_sum{};
  std::array<double, kMostEdges> edge_energy{};

  Impl(const Signal& signal, const TrackerOptions& o)
      : options(o),
        chip_rate_hz(signal.chip_rate_hz),
        carrier_hz(signal.carrier_hz),
        symbol_s(signal.symbol_s),
        slope(signal.code_slope),
        data(signal.symbol_s > 0.0),
        code(signal.chips, 1.01 * signal.chip_rate_hz / o.sample_rate_hz),
        settled(design_loop(o.pll_order, o.pll_bandwidth_hz, o.integration_s)),
        pulling(design_loop(2, o.pull_in_bandwidth_hz, pull_in_interval(signal, o))),
        code_settled(design_loop(1, o.dll_bandwidth_hz, o.integration_s)),
        code_pulling(design_loop(1, std::max(o.dll_bandwidth_hz, kPullInCodeHz), pulling.interval_s)),
        fll_gain(4.0 * o.fll_bandwidth_hz * pulling.interval_s),
        rate(o.doppler_hz),
        chip(-o.delay_s * signal.chip_rate_hz) {
    require_tracker(fll_gain <= 1.0, "fll_bandwidth_hz", o.fll_bandwidth_hz,
                    "times four pull-in integrations must be at most 1");
    if (data) edges = static_cast<std::size_t>(std::round(symbol_s * chip_rate_hz / code.length()));
    epoch_end = epoch_start(1);
    enter(o.pull_in_s > 0.0 ? TrackerState::kPullIn : TrackerState::kTracking);
    begin();
  }

  [[nodiscard]] std::uint64_t epoch_start(std::uint64_t number) const noexcept {
    return static_cast<std::uint64_t>(
        std::llround(static_cast<double>(number) * options.epoch_s * options.sample_rate_hz));
  }

  [[nodiscard]] const Loop& carrier_loop() const noexcept { return state == TrackerState::kPullIn ? pulling : settled; }

  [[nodiscard]] double chips_per_sample() const noexcept {
    return chip_rate_hz * (1.0 + rate / carrier_hz) / options.sample_rate_hz;
  }

  [[nodiscard]] double held_rate(double wanted) const noexcept {
    const double most = std::min(1e6, kMostDoppler * carrier_hz);
    return std::clamp(wanted, -most, most);
  }

  void enter(TrackerState next) noexcept {
    state = next;
    since = taken;
    updates = 0;
    has_last = false;
    block = {};
    block_size = 0.0;
    block_count = good_blocks = 0;
    if (next == TrackerState::kPullIn) {
      edge_sum.fill({});
      edge_energy.fill(0.0);
      edge_at = 0;
    }
  }

  // Where the integration that begins at `taken` ends: with data at a whole number of integrations of the code, else
  // of receiver time.
  void begin() noexcept {
    origin = taken;
    const double interval = carrier_loop().interval_s;
    double length = 0.0;
    if (data) {
      const double unit = interval * chip_rate_hz;
      const double start = chip - symbol_origin;
      const double per = chips_per_sample();
      double boundary = (std::floor(start / unit + 1e-9) + 1.0) * unit;
      length = std::ceil((boundary - start) / per - 1e-6);
      if (length < 8.0) {  // what the last rounding left over
        boundary += unit;
        length = std::ceil((boundary - start) / per - 1e-6);
      }
      end = origin + static_cast<std::uint64_t>(length);
    } else {
      const double unit = interval * options.sample_rate_hz;
      const double number = std::floor((static_cast<double>(origin) + 8.0) / unit) + 1.0;
      end = static_cast<std::uint64_t>(std::llround(number * unit));
      length = static_cast<double>(end - origin);
    }
    const double nominal = interval * options.sample_rate_hz;
    partial = length < 0.9 * nominal || length > 1.1 * nominal;
    head = {};
    tail = {};
    split = false;
  }

  [[nodiscard]] std::size_t next_run() const noexcept {
    std::uint64_t to = std::min<std::uint64_t>(end, taken + kRun);
    if (epoch_end > taken) to = std::min(to, epoch_end);
    return static_cast<std::size_t>(to - taken);
  }

  void run(const Cf32* x, std::size_t n) noexcept {
    const auto offset = static_cast<double>(taken - origin);
    const double sample_s = 1.0 / options.sample_rate_hz;
    const double slow = options.intermediate_hz * sample_s * static_cast<double>(taken);
    const double here = phase + rate * sample_s * offset;
    const double chips = chips_per_sample();
    const double chip_here = chip + chips * offset;
    std::uint32_t bad = 0;
    tail.sums +=
        correlate(x, n, code, (slow - std::floor(slow)) + (here - std::floor(here)),
                  (options.intermediate_hz + rate) * sample_s, chip_here, chips, 0.5 * options.early_late_chips, bad);
    tail.bad += bad;
    const auto count = static_cast<double>(n);
    const double middle = 0.5 * (count - 1.0);
    tail.n += count;
    tail.phase += count * (here + rate * sample_s * middle);
    tail.delay +=
        count * ((static_cast<double>(taken) + middle) * sample_s - (chip_here + chips * middle) / chip_rate_hz);
    tail.rate += count * rate;
    taken += n;
    if (taken == epoch_end && taken != end) {
      head = tail;
      tail = {};
      split = true;
    }
    if (taken == end) finish();
  }

  void add(const Piece& piece, const Complex& early_late_of, double sign, double n_whole) noexcept {
    Piece& sum = window.sum;
    sum.n += piece.n;
    sum.phase += piece.phase;
    sum.delay += piece.delay;
    sum.rate += piece.rate;
    sum.bad += piece.bad;
    sum.sums.power += piece.sums.power;
    sum.sums.prompt += sign * piece.sums.prompt;
    const Complex difference = piece.sums.early - piece.sums.late;
    window.code_error += by_conjugate(difference, early_late_of).real() / n_whole;
  }

  // The end of an integration: the loops move, and what it brought goes to its epochs.
  void finish() noexcept {
    Sums sums = head.sums;
    sums += tail.sums;
    const double n = head.n + tail.n;
    const double sign = data && sums.prompt.real() < 0.0 ? -1.0 : 1.0;
    const double interval = carrier_loop().interval_s;
    double error = 0.0, code_error = 0.0;
    if (!partial) measure(sums, n, interval, error, code_error);

    if (split) {
      add(head, sums.prompt, sign, n);
      emit();
    }
    add(tail, sums.prompt, sign, n);
    const double length_s = n / options.sample_rate_hz;
    phase += rate * length_s;
    chip += chips_per_sample() * n;
    if (!partial) {
      ++updates;
      if (state != TrackerState::kCoasting) {
        const Loop& loop = carrier_loop();
        const bool third = state == TrackerState::kTracking && loop.order == 3;
        if (third) error += ramp * interval * interval / 12.0;  // the parabola's mean, eq. 11
        double slow = third ? rate - 0.5 * ramp * interval : rate;
        phase += loop.gain[0] * error;
        slow += (third ? ramp * interval : 0.0) + loop.gain[1] * error / interval;
        if (third) ramp += loop.gain[2] * error / (interval * interval);
        rate = slow + (third ? 0.5 * ramp * interval : 0.0);
        rate = held_rate(rate);
        const Loop& code_loop = state == TrackerState::kPullIn ? code_pulling : code_settled;
        chip += code_loop.gain[0] * code_error;
      }
      decide();
    }
    if (taken == epoch_end) emit();
    begin();
  }

  void measure(const Sums& sums, double n, double interval, double& error, double& code_error) noexcept {
    const double energy = std::norm(sums.prompt);
    const double mean_power = sums.power / n;
    double snr = 0.0;
    if (mean_power > 0.0) {
      const double ratio = energy / n / mean_power;
      snr = (ratio - 1.0) / std::max(1.0 - ratio / n, 0.01);
      window.ratio += ratio;
      window.samples += n;
      ++window.integrations;
    }
    // Presence of the signal, and its C/N0.
    const double share = std::clamp(interval / kLockTimeS, 1.0 / (lock_weight + 1.0), 1.0);
    lock_weight = std::min(lock_weight + 1.0, 1e9);
    lock_mean += share * (std::min(snr, kLockLevel) - lock_mean);
    const double most = 1.0 / share;
    const double level = std::min(5.0 / std::sqrt(2.0 * most), 0.5 * kLockLevel);
    const bool enough = lock_weight >= 4.0;
    code_locked = enough && lock_mean > (code_locked ? 0.6 : 1.0) * level;
    ++cn0_count;
    cn0 += std::clamp(interval / kSmoothS, 1.0 / static_cast<double>(cn0_count), 1.0) * (snr / interval - cn0);
    const double strength = std::max(cn0 * interval, 0.1);  // of an integration

    // Discriminators.
    const Complex p = sums.prompt;
    error = energy > 0.0 ? (data ? (p.real() != 0.0 ? std::atan(p.imag() / p.real()) : 0.5 * kPi)
                                 : std::atan2(p.imag(), p.real())) /
                               kTwoPi
                         : 0.0;
    const double noise = mean_power / (1.0 + strength / n);
    const double signal_energy = cn0_count < 5 ? energy : n * noise * strength;
    if (signal_energy > 0.0) {
      code_error = by_conjugate(sums.early - sums.late, p).real() / (2.0 * slope * signal_energy);
      code_error = std::clamp(code_error, -1.0, 1.0);
    }
    // Frequency assist: the change of the whole phase since the last integration, against the replica's.
    if (state == TrackerState::kPullIn) {
      const double middle = phase + 0.5 * rate * n / options.sample_rate_hz;
      if (has_last && fll_gain > 0.0) {
        const Complex turn = by_conjugate(p, last_prompt);
        double change = middle - last_middle - rate * interval;
        if (std::norm(turn) > 0.0) change += std::arg(turn) / kTwoPi;
        const double off = wrapped(change, data ? 0.5 : 1.0);
        fll_step = fll_gain * off / interval;
      } else {
        fll_step = 0.0;
      }
      last_prompt = p;
      last_middle = middle;
      has_last = true;
      if (data && !options.symbol_known) edge(p);
    } else {
      fll_step = 0.0;
    }

    // Phase: blocks of integrations, judged together.
    const double scale = energy > 0.0 ? 1.0 / std::sqrt(n * noise) : 0.0;
    const Complex q = p * scale;
    const double cosine = data ? q.real() * q.real() - q.imag() * q.imag() : q.real();
    window.coherent += cosine;
    window.size += data ? std::norm(q) - 1.0 : std::sqrt(strength);
    block += data ? Complex(cosine, 2.0 * q.real() * q.imag()) : q;
    block_size += 1.0;
    const double needed = std::clamp(std::ceil((data ? 4.0 : 1.0) * kBlockEnergy / strength), 1.0, 100.0);
    if (block_size >= needed) {
      const bool good = code_locked && block.real() > 0.5 * std::abs(block);
      good_blocks = good ? std::min(good_blocks + 1, 1000) : 0;
      block = {};
      block_size = 0.0;
      if (!good && phase_locked) lose_phase();
      if (good && good_blocks >= kGoodBlocks && state == TrackerState::kTracking) {
        phase_locked = true;
        had_lock = true;
      }
    }
    if (!code_locked && phase_locked) lose_phase();
    if (!phase_locked) window.locked = false;
  }

  double fll_step = 0.0;

  void lose_phase() noexcept {
    phase_locked = false;
    good_blocks = 0;
    window.locked = false;
    if (had_lock) ++arc;
    had_lock = false;
  }

  // Energy of symbols for every place where their edges can be.
  void edge(const Complex& prompt) noexcept {
    for (std::size_t k = 0; k < edges; ++k) edge_sum[k] += prompt;
    // A code period has ended: a symbol that begins with the next one would be preceded by a complete one.
    const std::size_t next = (edge_at + 1) % edges;
    edge_energy[next] += std::norm(edge_sum[next]);
    edge_sum[next] = {};
    edge_at = next;
  }

  // States: from pulling in to tracking, to coasting, and back.
  void decide() noexcept {
    if (state == TrackerState::kPullIn) {
      rate = held_rate(rate + fll_step);
      if (updates == 1 && data && !options.symbol_known) {
        // The number of the code period that has just ended.
        const double number = std::round((chip - symbol_origin) / code.length()) - 1.0;
        base = number;
      }
    }
    const double age = static_cast<double>(taken - since) / options.sample_rate_hz;
    switch (state) {
      case TrackerState::kPullIn:
        if (age < options.pull_in_s) return;
        if (data && !options.symbol_known) {
          // edge_energy[k]: symbols that begin k code periods after the first integration's.
          const auto best = static_cast<double>(
              std::max_element(edge_energy.begin(), edge_energy.begin() + static_cast<std::ptrdiff_t>(edges)) -
              edge_energy.begin());
          symbol_origin += (base + best) * code.length();
        }
        ramp = 0.0;
        enter(code_locked ? TrackerState::kTracking : TrackerState::kCoasting);
        break;
      case TrackerState::kTracking:
        if (code_locked || age < 2.0 * kLockTimeS) return;
        ramp = 0.0;
        enter(TrackerState::kCoasting);
        break;
      case TrackerState::kCoasting:
        if (code_locked) {
          enter(TrackerState::kTracking);
        } else if (age >= options.loss_s && options.pull_in_s > 0.0) {
          enter(TrackerState::kPullIn);
        }
        break;
    }
    lock_weight = std::min(lock_weight, kLockTimeS / carrier_loop().interval_s);
  }

  double base = 0.0;

  void emit() noexcept {
    Epoch& e = out[out_count < kMaxEpochs ? out_count++ : kMaxEpochs - 1];
    e = {};
    const std::uint64_t first = epoch_start(epoch_number);
    const Piece& sum = window.sum;
    const double sample_s = 1.0 / options.sample_rate_hz;
    e.t_s = 0.5 * static_cast<double>(first + epoch_end - 1) * sample_s;
    const double window_s = static_cast<double>(epoch_end - first) * sample_s;
    const Loop& loop = carrier_loop();
    const double interval = loop.interval_s;
    const double strength = std::max(cn0, 1.0);
    const Complex p = sum.sums.prompt;
    const double rest = std::norm(p) > 0.0 ? std::arg(p) / kTwoPi : 0.0;
    e.carrier_phase_cycles = -(sum.phase / sum.n + rest);
    e.carrier_phase_sigma_cycles = std::sqrt(phase_variance(strength, window_s));
    const double mean_power = sum.sums.power / sum.n;
    const double signal_power = mean_power * strength * sample_s / (1.0 + strength * sample_s);
    double late = sum.delay / sum.n;
    if (signal_power > 0.0) {
      const double code_error = window.code_error / (2.0 * slope * signal_power * sum.n);
      late -= std::clamp(code_error, -1.0, 1.0) / chip_rate_hz;
    }
    e.delay_s = late;
    e.delay_sigma_s =
        std::sqrt(code_variance(strength, window_s, interval, options.early_late_chips)) / (slope * chip_rate_hz);
    e.doppler_hz = sum.rate / sum.n;
    const double mean_variance =
        data ? costas_phase_variance(strength, interval, interval) : phase_variance(strength, interval);
    e.doppler_sigma_hz = std::sqrt(noise_rate(mean_variance));
    const double m = std::max(window.integrations, 1);
    if (window.integrations > 0) {
      const double ratio = window.ratio / m;
      const double n = window.samples / m;
      e.cn0_hz = (ratio - 1.0) / std::max(1.0 - ratio / n, 0.01) / interval;
    }
    e.cn0_sigma_hz = std::sqrt((1.0 + 2.0 * strength * interval) / m) / interval;
    e.cn0_dbhz = 10.0 * std::log10(strength);
    e.loop_t_s = static_cast<double>(split ? origin : taken) * sample_s;
    e.loop_phase_cycles = -phase;
    e.phase_lock = window.size > 0.0 ? std::clamp(window.coherent / window.size, -1.0, 1.0) : 0.0;
    e.prompt = mean_power > 0.0 ? p / (sum.n * std::sqrt(mean_power)) : Complex{};
    e.arc = arc;
    e.bad_samples = sum.bad;
    e.state = state;
    e.code_locked = code_locked && state != TrackerState::kCoasting;
    e.phase_locked = window.locked && phase_locked && window.integrations > 0 && e.code_locked;
    window = {};
    ++epoch_number;
    epoch_end = epoch_start(epoch_number + 1);
  }

  // The settled loop's noise is computed once, for variance 1.
  [[nodiscard]] double noise_rate(double mean_variance) const noexcept {
    return mean_variance * (state == TrackerState::kPullIn ? pulling_rate : settled_rate);
  }

  double settled_rate = 0.0, pulling_rate = 0.0;
};

Tracker::Tracker(const Signal& signal, const TrackerOptions& options) {
  check(signal, options);
  impl_ = std::make_unique<Impl>(signal, options);
  impl_->settled_rate = noise_variance(impl_->settled, 1.0).rate;
  impl_->pulling_rate = noise_variance(impl_->pulling, 1.0).rate;
}

Tracker::~Tracker() = default;
Tracker::Tracker(Tracker&&) noexcept = default;
Tracker& Tracker::operator=(Tracker&&) noexcept = default;

std::size_t Tracker::push(IqSpan samples) noexcept {
  Impl& t = *impl_;
  t.out_count = 0;
  std::size_t used = 0;
  while (used < samples.size() && t.out_count + 1 < kMaxEpochs) {
    const std::size_t run = t.next_run();
    if (t.held == 0 && samples.size() - used >= run) {
      t.run(samples.data() + used, run);
      used += run;
      continue;
    }
    const std::size_t more = std::min(run - t.held, samples.size() - used);
    std::copy_n(samples.begin() + static_cast<std::ptrdiff_t>(used), more,
                t.waiting.begin() + static_cast<std::ptrdiff_t>(t.held));
    t.held += more;
    used += more;
    if (t.held == run) {
      t.held = 0;
      t.run(t.waiting.data(), run);
    }
  }
  return used;
}

std::span<const Epoch> Tracker::epochs() const noexcept { return {impl_->out.data(), impl_->out_count}; }
const TrackerOptions& Tracker::options() const noexcept { return impl_->options; }
TrackerState Tracker::state() const noexcept { return impl_->state; }
std::uint64_t Tracker::samples() const noexcept { return impl_->taken + impl_->held; }
const Loop& Tracker::loop() const noexcept { return impl_->settled; }

}  // namespace soopnav::tracking
