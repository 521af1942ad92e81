#include "soopnav/simulation/opportunity_link.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <stdexcept>
#include <string>
#include <utility>

#include "soopnav/core/constants.hpp"
#include "soopnav/waveform/gps/ca_code.hpp"

namespace soopnav::simulation {
namespace {

constexpr std::size_t kLinkRun = 256;  // samples between exact phases

void require_link(bool holds, const std::string& name, double value, const char* rule) {
  if (!holds) throw std::invalid_argument(name + " = " + std::to_string(value) + " " + rule);
}

std::string part_of(const char* list, std::size_t i, const char* field) {
  std::string name(list);
  name += '[';
  name += std::to_string(i);
  name += "].";
  name += field;
  return name;
}

std::complex<double> link_turn(double cycles) noexcept {
  return std::polar(1.0, kTwoPi * (cycles - std::floor(cycles)));
}

bool within(const clock::ClockState& state) noexcept {
  return std::abs(state.bias_m) < kSpeedOfLightMps && std::abs(state.drift_mps) < 1e-3 * kSpeedOfLightMps;
}

void check_source(const OpportunitySource& s, std::size_t i, std::size_t bands) {
  const auto name = [i](const char* field) { return part_of("sources", i, field); };
  require_link(s.band < bands, name("band"), static_cast<double>(s.band), "must be one of the bands");
  require_link(!s.chips.empty(), name("chips"), 0.0, "must not be empty");
  for (const Cf32& chip : s.chips) {
    require_link(std::isfinite(chip.real()) && std::isfinite(chip.imag()), name("chips"),
                 static_cast<double>(chip.real()), "must be finite");
  }
  require_link(s.chip_rate_hz > 0.0 && s.chip_rate_hz < 1e9, name("chip_rate_hz"), s.chip_rate_hz,
               "must be positive and below 1 GHz");
  for (const std::int8_t bit : s.bits) require_link(bit == 1 || bit == -1, name("bits"), bit, "must be +1 or -1");
  if (!s.bits.empty()) {
    const double codes = s.symbol_s * s.chip_rate_hz / static_cast<double>(s.chips.size());
    require_link(codes >= 0.5 && std::abs(codes - std::round(codes)) < 1e-6, name("symbol_s"), s.symbol_s,
                 "must be a whole number of code periods");
  }
  require_link(std::abs(s.cn0_dbhz) < 200.0, name("cn0_dbhz"), s.cn0_dbhz, "must be within 200");
  require_link(within(s.clock_start), name("clock_start"), s.clock_start.bias_m,
               "must be below 1 s and its drift below 1e-3");
}

// Adds one source's samples; `code_phase` of a sample is chip0 + n chips_per_sample.
struct Rendering {
  std::span<const Cf32> chips;
  std::span<const std::int8_t> bits;
  double codes_per_bit;
  float amplitude;

  // `skip` samples of the run are made and thrown away, so that blocks do not change the rotation's bits.
  void add(std::complex<double> rotor, std::complex<double> step, double chip0, double chip_step, std::size_t skip,
           std::span<Cf32> out) const noexcept {
    const auto length = static_cast<double>(chips.size());
    for (std::size_t n = 0; n < skip; ++n) advance(rotor, step);
    double code = std::floor(chip0 / length);
    double base = chip0 - code * length;
    float sign = amplitude * sign_of(code);
    for (std::size_t n = 0; n < out.size(); ++n) {
      double at = base + chip_step * static_cast<double>(skip + n);
      while (at >= length) {
        base -= length;
        at -= length;
        code += 1.0;
        sign = amplitude * sign_of(code);
      }
      const Cf32 chip = chips[static_cast<std::size_t>(at)];
      const float re = sign * static_cast<float>(rotor.real()), im = sign * static_cast<float>(rotor.imag());
      out[n] += Cf32(chip.real() * re - chip.imag() * im, chip.real() * im + chip.imag() * re);
      advance(rotor, step);
    }
  }

  static void advance(std::complex<double>& rotor, std::complex<double> step) noexcept {
    rotor = {rotor.real() * step.real() - rotor.imag() * step.imag(),
             rotor.real() * step.imag() + rotor.imag() * step.real()};
  }

  [[nodiscard]] float sign_of(double code) const noexcept {
    if (bits.empty()) return 1.0F;
    const double bit = std::floor((code + 0.5) / codes_per_bit);
    const auto count = static_cast<double>(bits.size());
    return static_cast<float>(bits[static_cast<std::size_t>(bit - count * std::floor(bit / count))]);
  }
};

}  // namespace

OpportunitySource OpportunitySource::gps(int prn) {
  OpportunitySource source;
  const gps::CaCode code = gps::ca_code(prn);
  for (const std::int8_t chip : code) source.chips.emplace_back(static_cast<float>(chip), 0.0F);
  source.chip_rate_hz = gps::kChipRateHz;
  source.symbol_s = gps::kBitPeriodS;
  return source;
}

OpportunityLink::OpportunityLink(std::vector<OpportunityBand> bands, std::vector<OpportunitySource> sources,
                                 const OpportunityLinkOptions& options, const RandomStream& random)
    : bands_(std::move(bands)), sources_(std::move(sources)), options_(options), random_(random) {
  for (std::size_t i = 0; i < bands_.size(); ++i) {
    const OpportunityBand& b = bands_[i];
    require_link(b.carrier_hz > 0.0 && b.carrier_hz < 1e12, part_of("bands", i, "carrier_hz"), b.carrier_hz,
                 "must be positive and below 1 THz");
    require_link(b.sample_rate_hz > 0.0 && b.sample_rate_hz < 1e9, part_of("bands", i, "sample_rate_hz"),
                 b.sample_rate_hz, "must be positive and below 1 GHz");
    require_link(std::abs(b.intermediate_hz) <= 0.5 * b.sample_rate_hz, part_of("bands", i, "intermediate_hz"),
                 b.intermediate_hz, "must be within half the sampling rate");
  }
  for (std::size_t i = 0; i < sources_.size(); ++i) check_source(sources_[i], i, bands_.size());
  require_link(options.position_e.allFinite(), "position_e", options.position_e.norm(), "must be finite");
  require_link(options.velocity_e.norm() < 1e5, "velocity_e", options.velocity_e.norm(), "must be below 100 km/s");
  require_link(std::abs(options.start_s) < 1e8, "start_s", options.start_s, "must be within 1e8");
  require_link(options.step_s >= 1e-5 && options.step_s <= 0.1, "step_s", options.step_s, "must be from 1e-5 to 0.1");
  require_link(options.duration_s > 0.0 && options.duration_s / options.step_s < 1e8, "duration_s", options.duration_s,
               "must be positive and below 1e8 steps");
  require_link(within(options.clock_start), "clock_start", options.clock_start.bias_m,
               "must be below 1 s and its drift below 1e-3");
  const auto nodes = static_cast<std::size_t>(std::ceil(options.duration_s / options.step_s)) + 2;
  if (options.clock_bias_s.empty()) {
    clock::ClockSimulator receiver(options.clock, random.substream(1), options.clock_start);
    for (std::size_t i = 0; i < nodes; ++i) {
      receiver_.push_back(receiver.state().bias_m / kSpeedOfLightMps);
      static_cast<void>(receiver.advance(options.step_s));
    }
  } else {
    require_link(options.clock_bias_s.size() == nodes, "clock_bias_s", static_cast<double>(options.clock_bias_s.size()),
                 ("must have one number for each of " + std::to_string(nodes) + " nodes").c_str());
    for (const double bias : options.clock_bias_s) {
      require_link(std::abs(bias) < 1.0, "clock_bias_s", bias, "must be below 1 s");
    }
    receiver_ = options.clock_bias_s;
  }
  for (std::size_t k = 0; k < sources_.size(); ++k) {
    const OpportunitySource& s = sources_[k];
    clock::ClockSimulator sender(s.clock, random.substream(2).substream(k), s.clock_start);
    std::vector<double> delay, bias;
    delay.reserve(nodes);
    bias.reserve(nodes);
    for (std::size_t i = 0; i < nodes; ++i) {
      const double elapsed = static_cast<double>(i) * options.step_s - receiver_[i];
      const Eigen::Vector3d p_e = options.position_e + elapsed * options.velocity_e;
      geometry::SignalPath path;
      require_link(geometry::signal_path(s.orbit, options.start_s + elapsed, p_e, options.velocity_e, path),
                   part_of("sources", k, "orbit"), options.start_s + elapsed,
                   "s: must be known then, a light time before, and not at the receiver");
      bias.push_back(sender.state().bias_m / kSpeedOfLightMps);
      delay.push_back(path.delay_s + receiver_[i] - bias.back());
      static_cast<void>(sender.advance(options.step_s));
    }
    delay_.push_back(std::move(delay));
    source_.push_back(std::move(bias));
    check_slopes(k);
  }
}

// Samples of a node step take their chips forwards: no delay may change by half of it.
void OpportunityLink::check_slopes(std::size_t k) const {
  for (std::size_t i = 1; i < receiver_.size(); ++i) {
    if (std::abs(delay_[k][i] - delay_[k][i - 1]) < 0.5 * options_.step_s) continue;
    const double receiver = receiver_[i] - receiver_[i - 1], sender = source_[k][i] - source_[k][i - 1];
    const char* const rule = "changes the delay by half a step_s or more";
    require_link(std::abs(receiver) < 0.25 * options_.step_s,
                 options_.clock_bias_s.empty() ? "clock" : "clock_bias_s[" + std::to_string(i) + "]", receiver_[i],
                 rule);
    require_link(std::abs(sender) < 0.25 * options_.step_s, part_of("sources", k, "clock"), source_[k][i], rule);
    require_link(false, part_of("sources", k, "orbit"), delay_[k][i], rule);
  }
}

std::uint64_t OpportunityLink::samples(std::size_t band) const noexcept {
  if (band >= bands_.size()) return 0;
  return static_cast<std::uint64_t>(std::floor(options_.duration_s * bands_[band].sample_rate_hz));
}

std::span<const double> OpportunityLink::delay_s(std::size_t source) const {
  require_link(source < delay_.size(), "source", static_cast<double>(source), "must be one of the sources");
  return delay_[source];
}

std::span<const double> OpportunityLink::source_bias_s(std::size_t source) const {
  require_link(source < source_.size(), "source", static_cast<double>(source), "must be one of the sources");
  return source_[source];
}

bool OpportunityLink::render_clean(std::size_t band, std::uint64_t first, std::span<Cf32> out) const noexcept {
  if (band >= bands_.size() || first > samples(band) || out.size() > samples(band) - first) return false;
  std::fill(out.begin(), out.end(), Cf32{});
  const OpportunityBand& b = bands_[band];
  const double per_node = options_.step_s * b.sample_rate_hz;
  for (std::size_t k = 0; k < sources_.size(); ++k) {
    const OpportunitySource& s = sources_[k];
    if (s.band != band) continue;
    const Rendering rendering{
        s.chips, s.bits,
        s.bits.empty() ? 1.0 : std::round(s.symbol_s * s.chip_rate_hz / static_cast<double>(s.chips.size())),
        static_cast<float>(std::sqrt(std::pow(10.0, s.cn0_dbhz / 10.0) / b.sample_rate_hz))};
    // Code time is counted from a whole second, in chips modulo the period of the bits, so that it keeps its digits at
    // any start: fma gives what the product's rounding lost.
    const double whole = std::floor(options_.start_s);
    const double period = static_cast<double>(s.chips.size()) * rendering.codes_per_bit *
                          static_cast<double>(std::max<std::size_t>(s.bits.size(), 1));
    const double chips_then = whole * s.chip_rate_hz;
    const double start_chips = std::fmod(chips_then, period) + std::fma(whole, s.chip_rate_hz, -chips_then);
    const double part = options_.start_s - whole;
    std::size_t done = 0;
    while (done < out.size()) {
      const std::uint64_t sample = first + done;
      auto node = static_cast<std::size_t>(static_cast<double>(sample) / per_node);
      // Samples of a node: from the first at or after it to the last before the next.
      const auto begin_of = [per_node](std::size_t i) {
        return static_cast<std::uint64_t>(std::ceil(static_cast<double>(i) * per_node));
      };
      if (sample < begin_of(node)) --node;
      if (sample >= begin_of(node + 1)) ++node;
      const std::uint64_t node_begin = begin_of(node);
      const std::uint64_t run_begin = sample - (sample - node_begin) % kLinkRun;
      const std::uint64_t run_end = std::min(begin_of(node + 1), run_begin + kLinkRun);
      const std::size_t count = std::min(out.size() - done, static_cast<std::size_t>(run_end - sample));
      const double t = static_cast<double>(run_begin) / b.sample_rate_hz;
      const double slope = (delay_[k][node + 1] - delay_[k][node]) / options_.step_s;
      const double delay = delay_[k][node] + slope * (t - static_cast<double>(node) * options_.step_s);
      const double if_cycles = b.intermediate_hz / b.sample_rate_hz * static_cast<double>(run_begin);
      const double cycles = (if_cycles - std::floor(if_cycles)) - b.carrier_hz * delay;
      const double step = (b.intermediate_hz - b.carrier_hz * slope) / b.sample_rate_hz;
      const double chip0 = start_chips + s.chip_rate_hz * (part + t - delay);
      rendering.add(link_turn(cycles), link_turn(step), chip0, s.chip_rate_hz * (1.0 - slope) / b.sample_rate_hz,
                    static_cast<std::size_t>(sample - run_begin), out.subspan(done, count));
      done += count;
    }
  }
  return true;
}

bool OpportunityLink::render(std::size_t band, std::uint64_t first, std::span<Cf32> out) const noexcept {
  if (!render_clean(band, first, out)) return false;
  RandomStream noise = random_.substream(3).substream(band);
  noise.seek(2 * first);
  noise.add_complex_normal(out, 1.0);
  return true;
}

}  // namespace soopnav::simulation
