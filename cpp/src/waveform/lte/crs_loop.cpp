#include "soopnav/waveform/lte/crs_loop.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <numbers>
#include <stdexcept>
#include <string>
#include <vector>

#include "waveform/lte/kernels.hpp"
#include "waveform/lte/link_tracker.hpp"
#include "waveform/lte/noise_level.hpp"
#include "waveform/lte/subframe_reader.hpp"

namespace soopnav::lte {

namespace {
using Complex = std::complex<double>;
constexpr double kTwoPi = 2.0 * std::numbers::pi;
constexpr double kSubframeS = 1e-3;
constexpr double kGapS = 20e-3;       // beyond it the phase is not carried on
constexpr double kSlipCycles = 0.3;   // phase errors beyond are slips
constexpr int kPulling = 3;           // updates of an arc that look for delay and offset anew
constexpr double kSettledLock = 0.8;  // mean cosine at which pulling in ends
constexpr double kLostLock = 0.3;
constexpr double kLeastSnr = 4.0;    // of a subframe's prompt sum, for an update that counts
constexpr double kSmoothS = 0.1;     // of C/N0, lock and offset
constexpr double kPortsS = 0.5;      // of the phases between ports
constexpr double kFalseLock = 1e-6;  // of one subframe of noise, when the cell is lost

double wrapped(double cycles) { return cycles - std::round(cycles); }

/// Mean with a memory that grows up to `limit` values.
template <class T>
struct Smooth {
  T value{};
  double count = 0.0;
  void add(const T& x, double limit) {
    count = std::min(count + 1.0, std::max(limit, 1.0));
    value += (x - value) / count;
  }
  void clear() { *this = {}; }
};

void require(bool good, const char* name, double value, const char* rule) {
  if (!good) throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; " + rule);
}
}  // namespace

struct CrsLoop::Impl {
  Impl(const CrsLoopOptions& o, const Detection& c) : options(o), cell(c), reader(o.sample_rate_hz, c) {
    tdd = c.duplex == Duplex::kTdd;
    subframes = tdd ? 0x21U : 0x3ffU;
    reader.tracker().set_subframes(0x3ffU & ~(tdd ? 0x42U : 0U));  // special ones never hold both slots
    buffer.reserve(static_cast<std::size_t>(4e-3 * o.sample_rate_hz));
    phasor.resize(static_cast<std::size_t>(reader.elements()));
    toa_s = c.frame_start_s;
    toa_time_s = c.frame_start_s;
    cfo_hz = c.cfo_hz;
    rate_ppm = 0.0;
    // The first subframe wholly in the samples; its predecessor's number is where counting begins.
    next = static_cast<std::int64_t>(std::ceil((4e-6 - c.frame_start_s) / kSubframeS));
    last.status = LoopStatus::kPullIn;
    last.toa_s = toa_s;
    last.cfo_hz = cfo_hz;
  }

  CrsLoopOptions options;
  Detection cell;
  SubframeReader reader;
  CoarseDelay coarse;
  std::vector<Cf32> buffer;
  std::int64_t begin = 0;  // sample number of buffer[0]
  std::vector<LoopUpdate> updates;
  LoopUpdate last;

  bool tdd = false;
  unsigned subframes = 0x3ff;
  std::array<int, 10> heard{};
  std::int64_t next = 0;  // subframe after frame 0's start

  // State at phase_time_s: phase received (cycles), its rate and the rate's. Frame 0's start at toa_time_s.
  double phase = 0.0, cfo_hz = 0.0, cfo_rate = 0.0, phase_time_s = 0.0;
  double toa_s = 0.0, toa_time_s = 0.0, rate_ppm = 0.0;  // rate of toa_s beyond what the carrier says, 1e-6
  int age = 0;                                           // updates since the arc began
  int delay_age = 0;
  bool started = false, lost = false;
  double bad_since_s = -1.0;
  int arc = 0, found_in_row = 0;
  double found_delay_s = 0.0;
  int missed_in_row = 0;
  std::vector<Cf32> phasor;

  Smooth<double> signal, noise, lock, turn_hz, interval;
  Smooth<double> power0;
  std::array<Smooth<Complex>, kMaxPorts> between;

  [[nodiscard]] double phase_at(double time_s) const {
    const double dt = time_s - phase_time_s;
    return phase + dt * (cfo_hz + 0.5 * dt * cfo_rate);
  }
  [[nodiscard]] double toa_rate() const {
    return rate_ppm * 1e-6 - (options.carrier_hz > 0.0 ? cfo_hz / options.carrier_hz : 0.0);
  }
  [[nodiscard]] double toa_at(double time_s) const { return toa_s + (time_s - toa_time_s) * toa_rate(); }

  void start_arc(bool slipped) {
    if (started) {
      ++arc;
      last.slip = slipped;
    }
    age = 0;
    lock.clear();
    turn_hz.clear();
    for (auto& b : between) b.clear();
    power0.clear();
  }
  bool step();
  void track(double time_s, double taken_hz, int subframe, bool pulling);
  void missed(double time_s, int subframe);
  bool look_for();
  void emit(double time_s, LoopStatus status, int subframe);
  bool probe(int subframe, bool there);
};

void CrsLoop::Impl::emit(double time_s, LoopStatus status, int subframe) {
  last.status = status;
  last.time_s = time_s;
  last.toa_s = toa_at(time_s);
  last.carrier_phase_cycles = -phase_at(time_s);
  last.cfo_hz = cfo_hz + (time_s - phase_time_s) * cfo_rate;
  last.cfo_rate_hz_per_s = cfo_rate;
  last.lock = lock.value;
  last.subframe = subframe;
  last.arc = arc;
  updates.push_back(last);
  last.slip = false;
}

void CrsLoop::Impl::missed(double time_s, int subframe) {
  if (bad_since_s < 0.0) bad_since_s = time_s;
  if (!lost && time_s - bad_since_s >= options.lost_after_s) {
    lost = true;
    found_in_row = 0;
    cfo_rate = 0.0;
  }
  if (!lost && started && age < 10 && ++missed_in_row >= 2) {  // begun on something else: begin again
    started = false;
    cfo_hz = cell.cfo_hz;
    cfo_rate = 0.0;
    delay_age = age = 0;
    signal.clear();
    noise.clear();
    lock.clear();
    turn_hz.clear();
    power0.clear();
    for (auto& b : between) b.clear();
  }
  last.phase_error_cycles = last.delay_error_s = 0.0;
  emit(time_s, lost ? LoopStatus::kLost : LoopStatus::kCoasting, subframe);
}

// The cell somewhere within a prefix of the prediction, three times in a row at the same place.
bool CrsLoop::Impl::look_for() {
  std::array<const Cf32*, kMaxPorts> y{};
  for (int p = 0; p < reader.ports(); ++p) y[static_cast<std::size_t>(p)] = reader.channel(p);
  const double at_s =
      coarse.estimate(y.data(), reader.ports(), reader.elements(), reader.fft_size()) / reader.rate_hz();
  const auto& profile = coarse.profile();
  const auto top = static_cast<double>(*std::max_element(profile.begin(), profile.end()));
  const double level = noise_level(reader.ports(), 2.0 * reader.elements(), kFalseLock);
  const double unit = std::max(0.5 * reader.noise_variance(), 1e-30) * reader.elements();
  if (top < level * unit || std::abs(at_s) > 6e-6) {
    found_in_row = 0;
    return false;
  }
  found_in_row = found_in_row > 0 && std::abs(at_s - found_delay_s) < 0.2e-6 ? found_in_row + 1 : 1;
  found_delay_s = at_s;
  return found_in_row >= 3;
}

// TDD: a subframe counts as downlink after three frames that say so.
bool CrsLoop::Impl::probe(int subframe, bool there) {
  int& count = heard[static_cast<std::size_t>(subframe)];
  count = std::clamp(count + (there ? 1 : -1), -3, 3);
  const unsigned bit = 1U << subframe;
  if (count >= 3) subframes |= bit;
  if (count <= -3) subframes &= ~bit;
  return there && (subframes & bit) != 0;
}

void CrsLoop::Impl::track(double time_s, double taken_hz, int subframe, bool pulling) {
  const int ports = reader.ports(), elements = reader.elements();
  const double rate = reader.rate_hz();
  const double unit = 0.5 * std::max(reader.noise_variance(), 1e-14 * reader.energy());  // of one channel value

  // Delay: the comb's maximum-likelihood one about the prediction; at the start wherever it is.
  std::array<const Cf32*, kMaxPorts> y{};
  for (int p = 0; p < ports; ++p) y[static_cast<std::size_t>(p)] = reader.channel(p);
  const bool anywhere = lost || delay_age < 1;
  const DelayFit fit = refine_delay(y.data(), nullptr, ports, reader.frequencies().data(), elements, reader.fft_size(),
                                    anywhere ? coarse.estimate(y.data(), ports, elements, reader.fft_size()) : 0.0);
  const bool delayed = fit.converged && std::abs(fit.tau) < 6e-6 * rate;

  // Sums over the comb at the predicted delay (pulling in: at the measured one), each port's phase brought to port 0's
  // by their mean product.
  const double turns = pulling && delayed ? fit.tau / reader.fft_size() : 0.0;
  const auto half = static_cast<std::size_t>(elements / 2);
  kernels::phasors(turns * reader.frequencies()[0], 3.0 * turns, phasor.data(), half);
  kernels::phasors(turns * reader.frequencies()[half], 3.0 * turns, phasor.data() + half, half);
  std::array<Complex, kMaxPorts> prompt{};
  double power = 0.0;
  for (int p = 0; p < ports; ++p) {
    const auto u = static_cast<std::size_t>(p);
    Complex sum = 0.0;
    for (std::size_t j = 0; j < 2 * half; ++j) sum += Complex(kernels::multiply(y[u][j], phasor[j]));
    prompt[u] = sum;
    power += std::norm(sum);
  }
  const double snr = power / (elements * unit) - ports;

  // Carrier: without phase modulation the whole circle counts.
  const double mean_interval = std::max(interval.value, kSubframeS);
  const auto memory = [&](double seconds) { return seconds / mean_interval; };
  auto between_now = between;
  auto power_now = power0;
  power_now.add(std::norm(prompt[0]), memory(kPortsS));
  Complex combined = prompt[0] * power_now.value;
  for (std::size_t p = 1; p < static_cast<std::size_t>(ports); ++p) {
    between_now[p].add(prompt[p] * std::conj(prompt[0]), memory(kPortsS));
    combined += prompt[p] * std::conj(between_now[p].value);
  }
  // The reading took this frequency out, phase zero at the buffer's first sample.
  const double taken_out = taken_hz * (time_s - static_cast<double>(begin) / rate);
  const double offset_hz = reader.turn_rad() / (kTwoPi * 0.5e-3);
  // With the slots' turn taken out the phase is that of the first reference symbol.
  const double since_first_s = reader.mean_time_s() - (cyclic_prefix_samples(cell.cp, 0, 128) + 64.0) / kBaseRateHz;
  const double measured = std::arg(combined) / kTwoPi + taken_out + (pulling ? offset_hz * since_first_s : 0.0);
  // What is followed may fade into the noise for an update; what was strong and is gone says nothing.
  const bool gone = signal.value > 12.0 && snr < 0.15 * signal.value;
  const bool usable = started ? !gone : snr > noise_level(ports, 10.0, 1e-3);

  if (tdd && subframe % 5 != 0 && (lost || !probe(subframe, snr > std::max(kLeastSnr, 0.4 * signal.value)))) return;
  if (lost) {
    if (!look_for()) {
      missed(time_s, subframe);
      return;
    }
    toa_s = toa_at(time_s) + found_delay_s;
    toa_time_s = time_s;
    lost = false;
    bad_since_s = -1.0;
    delay_age = 0;
    signal.clear();
    noise.clear();
    cfo_hz += offset_hz;
    cfo_rate = 0.0;
    start_arc(true);
    phase = measured;
    phase_time_s = time_s;
    found_in_row = 0;
    emit(time_s, LoopStatus::kPullIn, subframe);
    return;
  }
  if (!usable) {
    missed(time_s, subframe);
    return;
  }
  missed_in_row = 0;
  signal.add(snr, memory(kSmoothS));
  noise.add(unit, memory(kSmoothS));
  const double steady = std::max(signal.value, 1.0);

  double dt = time_s - phase_time_s;
  if (!started) {
    cfo_hz += offset_hz;
    phase = measured;
    phase_time_s = time_s;
    started = true;
    dt = kSubframeS;
  } else {
    const double predicted = phase_at(time_s);
    double error = wrapped(measured - predicted);
    last.phase_error_cycles = error;
    turn_hz.add(offset_hz, memory(kSmoothS));
    const double turn_sigma_hz =
        std::sqrt(2.0 / (snr * 0.5)) / (kTwoPi * 0.5e-3) / std::sqrt(std::max(turn_hz.count, 1.0));
    const double alias_hz = 1.0 / dt;
    const bool aliased = turn_hz.count >= 10.0 && std::abs(turn_hz.value) > 0.5 * alias_hz &&
                         std::abs(turn_hz.value) > 6.0 * turn_sigma_hz;
    const bool jumped = age > 3 && std::abs(error) > kSlipCycles && snr > 8.0;
    if (aliased || dt > kGapS || jumped) {
      // A new arc: the phase begins where it is, the frequency where the slots say.
      if (aliased) cfo_hz += turn_hz.value;
      if (!aliased && (jumped || dt > kGapS) && std::abs(offset_hz) > 4.0 * std::sqrt(4.0 / snr) / (kTwoPi * 0.5e-3)) {
        cfo_hz += offset_hz;
      }
      start_arc(true);
      cfo_rate = 0.0;
      phase = measured;
      phase_time_s = time_s;
      error = 0.0;
    } else {
      // Growing memory of a straight line first, then the gains of the bandwidth (eq. 5, 6).
      ++age;
      const double n = age, t = mean_interval;
      double alpha = 2.0 * (2.0 * n + 1.0) / ((n + 1.0) * (n + 2.0));
      double beta = 6.0 / ((n + 1.0) * (n + 2.0)) / dt, gamma = 0.0;
      const double bandwidth = std::min(options.pll_bandwidth_hz, 0.05 / t);
      const double omega = bandwidth / (options.pll_order == 3 ? 5.0 / 6.0 : 0.53);
      const double a = options.pll_order == 3 ? 2.0 * omega * t : std::numbers::sqrt2 * omega * t;
      double variance = alpha;  // of the phase, in units of one measurement's
      if (alpha <= a || n * t * bandwidth > 2.0) {
        variance = 2.0 * bandwidth * t;
        alpha = a;
        beta = (options.pll_order == 3 ? 2.0 : 1.0) * omega * omega * t;
        gamma = options.pll_order == 3 ? omega * omega * omega * t : 0.0;
      }
      alpha = std::min(alpha, 1.0);
      phase = predicted + alpha * error;
      cfo_hz += dt * cfo_rate + beta * error;
      cfo_rate += gamma * error;
      phase_time_s = time_s;
      last.phase_sigma_cycles = std::sqrt(std::min(variance, 1.0) / (2.0 * steady)) / kTwoPi;
    }
    lock.add(std::cos(kTwoPi * error), memory(kSmoothS));
  }
  interval.add(std::clamp(dt, kSubframeS, kGapS), 100.0);
  between = between_now;
  power0 = power_now;

  const double predicted_toa = toa_at(time_s), delay_dt = std::max(time_s - toa_time_s, 1e-6);
  if (delayed) {
    const double error = fit.tau / rate;
    last.delay_error_s = error;
    ++delay_age;
    const double n = delay_age - 1.0;
    double alpha = n > 0.0 ? 2.0 * (2.0 * n + 1.0) / ((n + 1.0) * (n + 2.0)) : 1.0;
    double beta = n > 0.0 ? 6.0 / ((n + 1.0) * (n + 2.0)) / delay_dt : 0.0;
    if (options.carrier_hz > 0.0) {  // the carrier knows the rate: a growing mean, and slowly what it does not know
      alpha = 1.0 / (n + 1.0);
      beta = 0.0;
    }
    const double bandwidth = std::min(options.dll_bandwidth_hz, 0.05 / mean_interval);
    const double omega = bandwidth / 0.53, a = std::numbers::sqrt2 * omega * mean_interval;
    double variance = alpha;
    if (alpha <= a || n * mean_interval * bandwidth > 2.0) {
      variance = 2.0 * bandwidth * mean_interval;
      alpha = a;
      beta = omega * omega * mean_interval;
    }
    toa_s = predicted_toa + alpha * error;
    rate_ppm += 1e6 * beta * error;
    toa_time_s = time_s;
    const double one = 1.0 / std::sqrt(2.0 * steady * std::max(fit.curvature, 1e-300)) / rate;
    last.toa_sigma_s = one * std::sqrt(std::min(1.0, variance));
  } else {
    last.delay_error_s = 0.0;
  }
  last.cn0_dbhz = 10.0 * std::log10(steady / kSubframeS);
  // Loss: noise alone passes the test on one subframe, not the mean cosine.
  const bool good =
      (age < 10 || lock.value > kLostLock) && (bad_since_s < 0.0 || std::abs(last.phase_error_cycles) < 0.15);
  if (good) {
    bad_since_s = -1.0;
  } else if (bad_since_s < 0.0) {
    bad_since_s = time_s;
  } else if (time_s - bad_since_s >= options.lost_after_s) {
    lost = true;
    found_in_row = 0;
    cfo_rate = 0.0;
  }
  const bool settled = age >= 10 && lock.value > kSettledLock;
  emit(time_s, lost ? LoopStatus::kLost : settled ? LoopStatus::kTracking : LoopStatus::kPullIn, subframe);
}

// Reads the next subframe when the buffer holds it.
bool CrsLoop::Impl::step() {
  const double rate = reader.rate_hz();
  const int subframe = static_cast<int>(((next % 10) + 10) % 10);
  const double nominal_s = static_cast<double>(next) * kSubframeS;
  const double start_s = toa_at(nominal_s + toa_s) + nominal_s;
  const double end = (start_s + kSubframeS) * rate + 4.0;
  const std::int64_t have = begin + static_cast<std::int64_t>(buffer.size());
  if (static_cast<double>(have) < end) return false;
  const double middle_s = start_s + reader.mean_time_s();
  const bool sent = !tdd || ((0x42U >> subframe) & 1U) == 0;
  const bool within = start_s * rate - static_cast<double>(begin) >= reader.tracker().back() + 1.0;
  if (sent && within) {
    const double start = start_s * rate - static_cast<double>(begin);
    const double taken_hz = cfo_hz + (started ? (middle_s - phase_time_s) * cfo_rate : 0.0);
    const bool pulling = !started || lost || age < kPulling;
    if (reader.read(buffer, subframe, start, taken_hz / rate, pulling)) {
      track(middle_s, taken_hz, subframe, pulling);
    } else if (!tdd || subframe % 5 == 0) {
      missed(middle_s, subframe);
    }
  } else if (!within && sent && (!tdd || subframe % 5 == 0)) {
    missed(middle_s, subframe);
  }
  ++next;
  // What lies before the next subframe is not needed any more.
  const double keep = (start_s + kSubframeS) * rate - reader.tracker().back() - 64.0;
  const auto drop =
      std::clamp<std::int64_t>(static_cast<std::int64_t>(keep) - begin, 0, static_cast<std::int64_t>(buffer.size()));
  buffer.erase(buffer.begin(), buffer.begin() + static_cast<std::ptrdiff_t>(drop));
  begin += drop;
  return true;
}

CrsLoop::CrsLoop(const CrsLoopOptions& o, const Detection& cell) {
  require_receivable(o.sample_rate_hz, cell);
  require(o.carrier_hz == 0.0 || (o.carrier_hz >= 1e8 && o.carrier_hz <= 1e11), "carrier_hz", o.carrier_hz,
          "0 or 1e8 ... 1e11 expected");
  require(o.pll_bandwidth_hz >= 0.5 && o.pll_bandwidth_hz <= 100.0, "pll_bandwidth_hz", o.pll_bandwidth_hz,
          "0.5 ... 100 expected");
  require(o.pll_order == 2 || o.pll_order == 3, "pll_order", o.pll_order, "2 or 3 expected");
  require(o.dll_bandwidth_hz >= 0.05 && o.dll_bandwidth_hz <= 50.0, "dll_bandwidth_hz", o.dll_bandwidth_hz,
          "0.05 ... 50 expected");
  require(o.lost_after_s >= 5e-3 && o.lost_after_s <= 10.0, "lost_after_s", o.lost_after_s, "5e-3 ... 10 expected");
  impl_ = std::make_unique<Impl>(o, cell);
}
CrsLoop::~CrsLoop() = default;
CrsLoop::CrsLoop(CrsLoop&&) noexcept = default;
CrsLoop& CrsLoop::operator=(CrsLoop&&) noexcept = default;

std::span<const LoopUpdate> CrsLoop::push(IqSpan block) {
  Impl& m = *impl_;
  m.updates.clear();
  const std::size_t capacity = m.buffer.capacity();
  while (!block.empty()) {
    const std::size_t take = std::min(block.size(), capacity - m.buffer.size());
    m.buffer.insert(m.buffer.end(), block.begin(), block.begin() + static_cast<std::ptrdiff_t>(take));
    block = block.subspan(take);
    bool moved = take > 0;
    while (m.step()) moved = true;
    if (!moved) break;  // cannot be: four milliseconds hold a subframe
  }
  return m.updates;
}

void CrsLoop::skip(std::int64_t samples) {
  Impl& m = *impl_;
  if (samples <= 0) return;
  constexpr std::int64_t kMost = std::int64_t{1} << 53;  // a double still counts them
  require(samples <= kMost - position(), "samples", static_cast<double>(samples),
          "at most 2^53 samples pushed and skipped expected");
  m.begin += static_cast<std::int64_t>(m.buffer.size()) + samples;
  m.buffer.clear();
  const double now_s = static_cast<double>(m.begin) / m.reader.rate_hz();
  m.next = std::max(m.next, static_cast<std::int64_t>(std::ceil((now_s + 4e-6 - m.toa_at(now_s)) / kSubframeS)));
}

std::int64_t CrsLoop::position() const noexcept {
  return impl_->begin + static_cast<std::int64_t>(impl_->buffer.size());
}
const LoopUpdate& CrsLoop::last() const noexcept { return impl_->last; }
const Detection& CrsLoop::cell() const noexcept { return impl_->cell; }
unsigned CrsLoop::subframes() const noexcept { return impl_->subframes; }
double CrsLoop::phase_at(double time_s) const noexcept { return -impl_->phase_at(time_s); }
double CrsLoop::toa_at(double time_s) const noexcept { return impl_->toa_at(time_s); }

}  // namespace soopnav::lte
