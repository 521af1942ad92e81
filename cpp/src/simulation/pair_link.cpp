#include "soopnav/simulation/pair_link.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <utility>

#include "simulation/require.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::simulation {
namespace {

using geometry::OrbitState;
using geometry::SampledOrbit;
using geometry::SignalPath;

constexpr double kMostDrift = 1e-3;

// ---- Delay plus bias along a recording

/// Delay and bias of what is heard when the receiver's clock shows `reading_s`.
struct Heard {
  double offset_s;  // delay + bias: envelope time is reading - start - offset
  double t_s;
};

bool heard_at(const PairReceiver& receiver, const SampledOrbit& beacon, double reading_s, Heard& heard) noexcept {
  ClockReading clock;
  const double t_s = receiver.clock.time_of(reading_s, clock);
  OrbitState antenna;
  SignalPath path;
  if (!receiver.antenna.at(t_s, antenna) || !geometry::signal_path(beacon, t_s, antenna.p_e, antenna.v_e, path)) {
    return false;
  }
  heard = {path.delay_s + clock.bias_s, t_s};
  return true;
}

constexpr int kNodes = 6;
constexpr double kFitToleranceS = 1e-13;
constexpr std::int64_t kChunk = 256;

/// cos(pi (2 i + 1) / 12), the Chebyshev nodes.
constexpr std::array<double, kNodes> kNode{0.96592582628906829,  0.70710678118654752,  0.25881904510252076,
                                           -0.25881904510252076, -0.70710678118654752, -0.96592582628906829};

/// Polynomial of degree 5 in x of [-1, 1] through values at the nodes (Newton's form, expanded).
std::array<double, kNodes> through(std::array<double, kNodes> y) noexcept {
  for (std::size_t level = 1; level < kNodes; ++level) {
    for (std::size_t i = kNodes - 1; i >= level; --i) y[i] = (y[i] - y[i - 1]) / (kNode[i] - kNode[i - level]);
  }
  std::array<double, kNodes> out{};
  out[0] = y[kNodes - 1];
  for (std::size_t k = kNodes - 1; k-- > 0;) {  // out = out (x - node_k) + y_k
    for (std::size_t i = kNodes - 1; i >= 1; --i) out[i] = out[i - 1] - kNode[k] * out[i];
    out[0] = y[k] - kNode[k] * out[0];
  }
  return out;
}

struct Local {
  double value;
  double slope;
  double curvature;  // half the second derivative
};

Local expand(const std::array<double, kNodes>& p, double x) noexcept {
  double value = 0.0, slope = 0.0, half = 0.0;
  for (std::size_t i = kNodes; i-- > 0;) {
    half = half * x + slope;
    slope = slope * x + value;
    value = value * x + p[i];
  }
  return {value, slope, half};
}

/// Fits the offsets of the samples [first, last]; false when they do not fit within the tolerance.
bool fit_offset(const PairReceiver& receiver, const SampledOrbit& beacon, const SampleGrid& grid, double first,
                double last, std::array<double, kNodes>& fit, bool& known) noexcept {
  const double mid = 0.5 * (first + last), half = 0.5 * (last - first);
  const auto offset = [&](double x) {
    Heard heard{};
    known = known && heard_at(receiver, beacon, grid.start_s + (mid + half * x) / grid.sample_rate_hz, heard);
    return heard.offset_s;
  };
  std::array<double, kNodes> y{};
  for (std::size_t i = 0; i < kNodes; ++i) y[i] = offset(kNode[i]);
  fit = through(y);
  double worst = 0.0;
  for (const double x : {1.0, 0.86, 0.5, 0.0, -0.5, -0.86, -1.0}) {
    worst = std::max(worst, std::abs(offset(x) - expand(fit, x).value));
  }
  return worst <= kFitToleranceS;
}

/// a b less whole turns.
double turns_of(double a, double b) noexcept {
  const double product = a * b;
  return (product - std::rint(product)) + std::fma(a, b, -product);
}

std::complex<double> turned(double turns) noexcept {
  const double angle = kTwoPi * (turns - std::rint(turns));
  return {std::cos(angle), std::sin(angle)};
}

void add_turning(const Cf32* x, std::size_t size, double turns, double step, double quadratic, Cf32* out) noexcept {
  const auto at = turned(turns), by = turned(step + quadratic), turn = turned(2.0 * quadratic);
  double re = at.real(), im = at.imag();
  double step_re = by.real(), step_im = by.imag();
  for (std::size_t k = 0; k < size; ++k) {
    const auto a = static_cast<double>(x[k].real()), b = static_cast<double>(x[k].imag());
    out[k] += Cf32(static_cast<float>(re * a - im * b), static_cast<float>(re * b + im * a));
    const double next = re * step_re - im * step_im;
    im = re * step_im + im * step_re;
    re = next;
    const double next_step = step_re * turn.real() - step_im * turn.imag();
    step_im = step_re * turn.imag() + step_im * turn.real();
    step_re = next_step;
  }
}

}  // namespace

// ---- ClockTrack

ClockTrack::ClockTrack() : time_s_{0.0}, knots_{ClockReading{}} {}

ClockTrack::ClockTrack(std::span<const double> time_s, std::span<const double> bias_s, std::span<const double> drift)
    : time_s_(time_s.begin(), time_s.end()), knots_(time_s.size()) {
  require(!time_s.empty(), "time_s.size()", 0.0, "at least one instant is needed");
  require(bias_s.size() == time_s.size(), "bias_s.size()", static_cast<double>(bias_s.size()),
          "it must be that of time_s");
  require(drift.size() == time_s.size(), "drift.size()", static_cast<double>(drift.size()),
          "it must be that of time_s");
  for (std::size_t i = 0; i < knots_.size(); ++i) {
    require(std::isfinite(time_s[i]), "time_s", time_s[i], "it must be finite");
    require(std::isfinite(bias_s[i]), "bias_s", bias_s[i], "it must be finite");
    require(std::abs(drift[i]) < kMostDrift, "drift", drift[i], "it must lie between -1e-3 and 1e-3");
    if (i > 0) {
      require(time_s[i] > time_s[i - 1], "time_s", time_s[i], "each instant must follow the last");
      const double slope = (bias_s[i] - bias_s[i - 1]) / (time_s[i] - time_s[i - 1]);
      require(std::abs(slope) < kMostDrift, "bias_s", bias_s[i],
              "it must be within 1e-3 of the time that passed of the last");
    }
    knots_[i] = {bias_s[i], drift[i]};
  }
}

ClockTrack ClockTrack::steady(double bias_s, double drift, double epoch_s) {
  return ClockTrack({&epoch_s, 1}, {&bias_s, 1}, {&drift, 1});
}

ClockTrack ClockTrack::simulated(const clock::ClockNoise& noise, const clock::ClockState& start,
                                 std::span<const double> time_s, const RandomStream& random) {
  std::vector<clock::ClockState> states(time_s.size());
  clock::simulate(noise, start, time_s, random, states);
  std::vector<double> bias_s, drift;
  bias_s.reserve(states.size());
  drift.reserve(states.size());
  for (const clock::ClockState& state : states) {
    bias_s.push_back(state.bias_m / kSpeedOfLightMps);
    drift.push_back(state.drift_mps / kSpeedOfLightMps);
  }
  return ClockTrack(time_s, bias_s, drift);
}

ClockReading ClockTrack::at(double t_s) const noexcept {
  if (!(t_s > time_s_.front())) {
    return {knots_.front().bias_s + knots_.front().drift * (t_s - time_s_.front()), knots_.front().drift};
  }
  if (t_s >= time_s_.back()) {
    return {knots_.back().bias_s + knots_.back().drift * (t_s - time_s_.back()), knots_.back().drift};
  }
  const auto after = std::upper_bound(time_s_.begin(), time_s_.end(), t_s);
  const auto i = static_cast<std::size_t>(after - time_s_.begin()) - 1;
  const double step = time_s_[i + 1] - time_s_[i];
  const double u = (t_s - time_s_[i]) / step;
  const double change = knots_[i + 1].bias_s - knots_[i].bias_s;
  const double from = knots_[i].drift * step, to = knots_[i + 1].drift * step;
  // bias = b0 + from u + (3 change - 2 from - to) u² + (from + to - 2 change) u³
  const double square = 3.0 * change - 2.0 * from - to, cube = from + to - 2.0 * change;
  return {knots_[i].bias_s + u * (from + u * (square + u * cube)), (from + u * (2.0 * square + u * 3.0 * cube)) / step};
}

double ClockTrack::time_of(double reading_s, ClockReading& clock) const noexcept {
  // A step shortens the error by the drift, which is below a few times 1e-3.
  double t_s = reading_s;
  for (int i = 0; i < 8; ++i) {
    clock = at(t_s);
    const double next = reading_s - clock.bias_s;
    if (next == t_s) break;
    t_s = next;
  }
  return t_s;
}

double ClockTrack::time_of(double reading_s) const noexcept {
  ClockReading clock;
  return time_of(reading_s, clock);
}

// ---- Checks

void PairReceiver::check() const {
  for (const Tap& tap : taps) {
    require(std::isfinite(tap.delay_s), "delay_s", tap.delay_s, "it must be finite");
    require(std::isfinite(tap.gain.real()) && std::isfinite(tap.gain.imag()), "gain", std::abs(tap.gain),
            "it must be finite");
  }
}

void SampleGrid::check() const {
  require(std::isfinite(start_s), "start_s", start_s, "it must be finite");
  require(std::isfinite(sample_rate_hz) && sample_rate_hz > 0.0, "sample_rate_hz", sample_rate_hz,
          "it must be finite and positive");
  require(std::isfinite(center_hz), "center_hz", center_hz, "it must be finite");
}

// ---- Reception

bool arrival_of(const PairReceiver& receiver, const SampledOrbit& beacon, double sent_s, double carrier_hz,
                Arrival& arrival) noexcept {
  OrbitState antenna, source;
  SignalPath path;
  if (!receiver.antenna.at(sent_s, antenna) || !beacon.at(sent_s, source)) return false;
  double t_s = sent_s;
  double delay_s = (source.p_e - antenna.p_e).norm() / kSpeedOfLightMps;
  // Each turn shortens the error by the delay's rate, 3e-5 of a satellite.
  for (int i = 0; i < 8; ++i) {
    t_s = sent_s + delay_s;
    if (!receiver.antenna.at(t_s, antenna) || !geometry::signal_path(beacon, t_s, antenna.p_e, antenna.v_e, path)) {
      return false;
    }
    const double change = path.delay_s - delay_s;
    delay_s = path.delay_s;
    if (std::abs(change) < 1e-15) break;
  }
  const ClockReading clock = receiver.clock.at(t_s);
  arrival = {t_s, t_s + clock.bias_s, carrier_hz * (1.0 - path.delay_rate) / (1.0 + clock.drift), clock, path};
  return true;
}

bool sent_time(const PairReceiver& receiver, const SampledOrbit& beacon, double reading_s, double& sent_s) noexcept {
  Heard heard{};
  if (!heard_at(receiver, beacon, reading_s, heard)) return false;
  sent_s = reading_s - heard.offset_s;
  return true;
}

bool add_reception(const PairReceiver& receiver, const EnvelopeView& envelope, const SampledOrbit& beacon,
                   const Transmission& sent, const SampleGrid& grid, std::span<Cf32> samples) noexcept {
  // Numbers of the first and last sample that the envelope and its echoes meet, by their arrivals.
  double earliest = 0.0, latest = 0.0;
  for (const Tap& tap : receiver.taps) {
    earliest = std::min(earliest, tap.delay_s);
    latest = std::max(latest, tap.delay_s);
  }
  Arrival begin, end;
  if (!arrival_of(receiver, beacon, sent.start_s + envelope.begin_s() + earliest, sent.carrier_hz, begin) ||
      !arrival_of(receiver, beacon, sent.start_s + envelope.end_s() + latest, sent.carrier_hz, end)) {
    return false;
  }
  const double rate = grid.sample_rate_hz;
  const auto base = static_cast<double>(grid.first_sample);
  const double low = std::ceil((begin.reading_s - grid.start_s) * rate - base);
  const double high = std::floor((end.reading_s - grid.start_s) * rate - base);
  const auto size = static_cast<double>(samples.size());
  if (!(low < size && high >= 0.0)) return std::isfinite(low) && std::isfinite(high);
  const auto first = static_cast<std::int64_t>(std::max(low, 0.0));
  const auto last = static_cast<std::int64_t>(std::min(high, size - 1.0));

  SampleGrid counted = grid;
  counted.first_sample = 0;  // what follows counts from the recording's sample 0
  const double intermediate_hz = sent.carrier_hz - grid.center_hz;
  const double step = intermediate_hz / rate;
  // Of the carrier at the recording's sample 0 but for delay and clock.
  const double start_turns = turns_of(intermediate_hz, grid.start_s) + turns_of(1.0 / kTwoPi, sent.phase_rad);
  const double since_s = grid.start_s - sent.start_s;
  std::array<Cf32, kChunk> piece, sum;
  std::int64_t from = first;
  while (from <= last) {
    std::int64_t to = std::min(last, from + (std::int64_t{1} << 16));
    std::array<double, kNodes> fit{};
    for (;;) {
      bool known = true;
      const bool fits = fit_offset(receiver, beacon, counted, base + static_cast<double>(from),
                                   base + static_cast<double>(to), fit, known);
      if (!known) return false;  // not reached: both ends are inside, and so is what lies between them
      if (fits || to - from <= kChunk) break;
      to = from + (to - from) / 2;
    }
    const double half = std::max(0.5 * static_cast<double>(to - from), 0.5);
    for (std::int64_t n = from; n <= to; n += kChunk) {
      const auto count = static_cast<std::size_t>(std::min(kChunk, to - n + 1));
      const double x = static_cast<double>(n - from) / half - 1.0;
      Local offset = expand(fit, x);
      offset.slope /= half;
      offset.curvature /= half * half;
      const double number = base + static_cast<double>(n);
      const double u = since_s + (number / rate - offset.value);
      const std::span<Cf32> out(piece.data(), count);
      const Cf32* heard = piece.data();
      if (receiver.taps.empty()) {
        envelope.evaluate(u, 1.0 / rate - offset.slope, -offset.curvature, out);
        if (sent.amplitude != 1.0) {
          for (Cf32& value : out) value *= static_cast<float>(sent.amplitude);
        }
      } else {
        std::fill_n(sum.begin(), count, Cf32{});
        for (const Tap& tap : receiver.taps) {
          envelope.evaluate(u - tap.delay_s, 1.0 / rate - offset.slope, -offset.curvature, out);
          const auto gain_re = static_cast<float>(sent.amplitude * tap.gain.real());
          const auto gain_im = static_cast<float>(sent.amplitude * tap.gain.imag());
          for (std::size_t k = 0; k < count; ++k) {
            const float re = piece[k].real(), im = piece[k].imag();
            sum[k] += Cf32(gain_re * re - gain_im * im, gain_re * im + gain_im * re);
          }
        }
        heard = sum.data();
      }
      const double turns = start_turns + turns_of(number, step) - turns_of(sent.carrier_hz, offset.value);
      add_turning(heard, count, turns, step - sent.carrier_hz * offset.slope, -sent.carrier_hz * offset.curvature,
                  samples.data() + n);
    }
    from = to + 1;
  }
  return true;
}

// ---- PairLink

PairLink::PairLink(PairReceiver target, PairReceiver anchor, double sample_rate_hz, double center_hz)
    : target_(std::move(target)), anchor_(std::move(anchor)), sample_rate_hz_(sample_rate_hz), center_hz_(center_hz) {
  target_.check();
  anchor_.check();
  SampleGrid{0.0, sample_rate_hz, center_hz, 0}.check();
}

bool PairLink::truth(const SampledOrbit& beacon, double sent_s, double carrier_hz, PairTruth& truth) const noexcept {
  PairTruth found;
  if (!arrival_of(target_, beacon, sent_s, carrier_hz, found.target) ||
      !arrival_of(anchor_, beacon, sent_s, carrier_hz, found.anchor)) {
    return false;
  }
  // Delays and biases apart: what is left of readings a day after the reference has 1e-11 s.
  found.tdoa_s =
      (found.target.path.delay_s - found.anchor.path.delay_s) + (found.target.clock.bias_s - found.anchor.clock.bias_s);
  // f (1 - D') / (1 + d) of both, f taken away first.
  const auto shift = [](const Arrival& at) { return -(at.path.delay_rate + at.clock.drift) / (1.0 + at.clock.drift); };
  found.fdoa_hz = carrier_hz * (shift(found.target) - shift(found.anchor));
  truth = found;
  return true;
}

bool PairLink::render(const EnvelopeView& envelope, const SampledOrbit& beacon, const Transmission& sent,
                      double target_start_s, std::span<Cf32> target, double anchor_start_s,
                      std::span<Cf32> anchor) const noexcept {
  PairTruth begin, end;  // both or none
  if (!truth(beacon, sent.start_s + envelope.begin_s(), sent.carrier_hz, begin) ||
      !truth(beacon, sent.start_s + envelope.end_s(), sent.carrier_hz, end)) {
    return false;
  }
  return add_reception(target_, envelope, beacon, sent, {target_start_s, sample_rate_hz_, center_hz_, 0}, target) &&
         add_reception(anchor_, envelope, beacon, sent, {anchor_start_s, sample_rate_hz_, center_hz_, 0}, anchor);
}

}  // namespace soopnav::simulation
