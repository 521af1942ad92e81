#include "soopnav/simulation/opportunity_link.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/clock/oscillator.hpp"
#include "soopnav/core/constants.hpp"
#include "support/allocation_count.hpp"
#include "support/nan.hpp"

namespace soopnav::simulation {
namespace {

using ::soopnav::test::kNan;
const Eigen::Vector3d kHere(6378137.0, 0.0, 0.0);

OpportunitySource mast(std::size_t band, const Eigen::Vector3d& at) {
  OpportunitySource source = OpportunitySource::gps(7);
  source.band = band;
  source.orbit = geometry::SampledOrbit::fixed(at);
  source.cn0_dbhz = 60.0;
  return source;
}

OpportunityLinkOptions options_of(double duration_s) {
  OpportunityLinkOptions options;
  options.position_e = kHere;
  options.duration_s = duration_s;
  return options;
}

// What the model says of a sample, from the delay alone.
std::complex<double> sample_of(const OpportunityLink& link, std::size_t source, std::uint64_t n) {
  const OpportunitySource& s = link.sources()[source];
  const OpportunityBand& b = link.bands()[s.band];
  const double t = static_cast<double>(n) / b.sample_rate_hz;
  const double at = t / link.options().step_s;
  const auto node = static_cast<std::size_t>(at);
  const auto d = link.delay_s(source);
  const double delay = d[node] + (at - static_cast<double>(node)) * (d[node + 1] - d[node]);
  const double chips = s.chip_rate_hz * (link.options().start_s + t - delay);
  const auto length = static_cast<double>(s.chips.size());
  const double code = std::floor(chips / length);
  double sign = 1.0;
  if (!s.bits.empty()) {
    const double bit = std::floor(code / 20.0), count = static_cast<double>(s.bits.size());
    sign = s.bits[static_cast<std::size_t>(bit - count * std::floor(bit / count))];
  }
  const Cf32 chip = s.chips[static_cast<std::size_t>(chips - code * length)];
  const double turns = b.intermediate_hz * t - std::fmod(b.carrier_hz * delay, 1.0);
  return sign * std::sqrt(std::pow(10.0, s.cn0_dbhz / 10.0) / b.sample_rate_hz) * std::complex<double>(chip) *
         std::polar(1.0, kTwoPi * (turns - std::floor(turns)));
}

TEST(OpportunityLink, SamplesAreTheModels) {
  OpportunityLinkOptions options = options_of(0.05);
  options.start_s = 1234.5;
  options.velocity_e = {3.0, -200.0, 10.0};
  options.clock = clock::Oscillator::tcxo().noise();
  options.clock_start = {300.0, 150.0};
  auto source = mast(1, kHere + Eigen::Vector3d(2000.0, -7000.0, 300.0));
  source.bits = {1, -1, -1};
  source.clock = clock::Oscillator::ocxo().noise();
  source.clock_start = {-90.0, 3.0};
  const OpportunityLink link({{1575.42e6, 2.048e6, 0.0}, {1.93e9, 2.4576e6, 100e3}}, {source}, options,
                             RandomStream(5));
  std::vector<Cf32> out(link.samples(1));
  ASSERT_TRUE(link.render_clean(1, 0, out));
  int differ = 0;
  for (std::uint64_t n = 0; n < out.size(); n += 7) {
    const auto expected = sample_of(link, 0, n);
    if (std::abs(std::complex<double>(out[n]) - expected) > 1e-3 * std::abs(expected)) ++differ;
  }
  EXPECT_LE(differ, 2);  // a sample on a chip's edge may fall to either side
  // Range, the receiver's clock and the source's make the delay.
  const double clocks = link.receiver_bias_s()[20] - link.source_bias_s(0)[20];
  const Eigen::Vector3d p = kHere + (0.02 - link.receiver_bias_s()[20]) * options.velocity_e;
  const double range = (kHere + Eigen::Vector3d(2000.0, -7000.0, 300.0) - p).norm();
  EXPECT_NEAR(link.delay_s(0)[20] - clocks, range / kSpeedOfLightMps, 1e-10);  // the Earth turns 7 m * 1e-9 meanwhile
}

// A fast receiver clock delays codes and lowers carriers, those of all bands by the same fraction.
TEST(OpportunityLink, OneOscillatorDrivesEveryBand) {
  OpportunityLinkOptions options = options_of(0.1);
  options.clock_start = {0.0, 1e-6 * kSpeedOfLightMps};
  const Eigen::Vector3d at = kHere + Eigen::Vector3d(0.0, 5000.0, 0.0);
  const OpportunityLink link({{1575.42e6, 2.048e6, 0.0}, {1.93e9, 2.048e6, 0.0}}, {mast(0, at), mast(1, at)}, options,
                             RandomStream(1));
  for (std::size_t band = 0; band < 2; ++band) {
    std::vector<Cf32> out(link.samples(band));
    ASSERT_TRUE(link.render_clean(band, 0, out));
    // 50 ms later the phase has turned backwards by carrier * 1e-6 * 0.05 s.
    const std::complex<double> first(out[100]), later(out[100 + 102400]);
    const double turns = std::arg(later * std::conj(first)) / kTwoPi;
    const double carrier = link.bands()[band].carrier_hz;
    const double expected = -carrier * 1e-6 * 0.05;
    // Chips may differ in sign: modulo half a cycle.
    const double off = 2.0 * (turns - expected);
    EXPECT_NEAR(off, std::round(off), 2e-3);
    const auto d = link.delay_s(band);
    EXPECT_NEAR((d[100] - d[0]) / 0.1, 1e-6, 1e-12);
  }
  EXPECT_EQ(link.delay_s(0)[50], link.delay_s(1)[50]);
}

TEST(OpportunityLink, BlocksAndBandsDoNotChangeBits) {
  OpportunityLinkOptions options = options_of(0.02);
  options.clock = clock::Oscillator::tcxo().noise();
  const Eigen::Vector3d at = kHere + Eigen::Vector3d(0.0, 5000.0, 0.0);
  const std::vector<OpportunityBand> bands{{1575.42e6, 2.046e6, 0.0}, {1.93e9, 2.4576e6, 100e3}};
  const OpportunityLink link(bands, {mast(0, at), mast(1, at)}, options, RandomStream(1));
  std::vector<Cf32> whole(link.samples(1)), parts(link.samples(1));
  ASSERT_TRUE(link.render(1, 0, whole));
  const OpportunityLink again(bands, {mast(0, at), mast(1, at)}, options, RandomStream(1));
  for (std::size_t first = 0; first < parts.size();) {
    const std::size_t count = std::min<std::size_t>(parts.size() - first, 1 + first % 777);
    ASSERT_TRUE(again.render(1, first, std::span(parts).subspan(first, count)));
    first += count;
  }
  EXPECT_EQ(whole, parts);
  const OpportunityLink other(bands, {mast(0, at), mast(1, at)}, options, RandomStream(2));
  ASSERT_TRUE(other.render(1, 0, parts));
  EXPECT_NE(whole, parts);
  EXPECT_FALSE(link.render(2, 0, parts));
  EXPECT_FALSE(link.render(1, 1, parts));
  if (::soopnav::test::kAllocationsCounted) {
    EXPECT_EQ(::soopnav::test::allocations_of([&] { static_cast<void>(link.render(1, 0, whole)); }), 0);
  }
}

// Whole seconds are whole code periods: the start changes no chip, however far away it lies.
TEST(OpportunityLink, ADistantStartKeepsItsDigits) {
  const Eigen::Vector3d at = kHere + Eigen::Vector3d(2000.0, -7000.0, 300.0);
  const auto rendered = [&](double start_s) {
    OpportunityLinkOptions options = options_of(0.02);
    options.start_s = start_s;
    auto source = mast(0, at);
    source.bits = {1, -1, -1, 1, -1, 1, 1};  // 7 bits of 20 ms: whole seconds of 7 are whole periods
    const OpportunityLink link({{1575.42e6, 2.048e6, 0.0}}, {source}, options, RandomStream(1));
    std::vector<Cf32> out(link.samples(0));
    EXPECT_TRUE(link.render_clean(0, 0, out));
    return out;
  };
  const auto near = rendered(0.0);
  EXPECT_EQ(rendered(7.0 * 14'000'000.0), near);
  EXPECT_EQ(rendered(-7.0 * 14'000'000.0), near);
}

// A delay that runs faster than time would take chips backwards, out of their array.
TEST(OpportunityLink, RefusesClocksThatJump) {
  const Eigen::Vector3d at = kHere + Eigen::Vector3d(0.0, 5000.0, 0.0);
  const auto message = [&](const std::function<void(OpportunitySource&, OpportunityLinkOptions&)>& spoil) {
    OpportunitySource source = mast(0, at);
    OpportunityLinkOptions options = options_of(0.01);
    options.step_s = 1e-3;
    spoil(source, options);
    try {
      const OpportunityLink link({{1575.42e6, 2.048e6, 0.0}}, {source}, options, RandomStream(1));
    } catch (const std::invalid_argument& error) {
      return std::string(error.what());
    }
    return std::string("nothing");
  };
  for (const double jump : {2e-3, -2e-3}) {
    EXPECT_EQ(message([&](auto&, auto& o) {
                o.clock_bias_s.assign(12, 0.0);
                for (std::size_t i = 5; i < 12; ++i) o.clock_bias_s[i] = jump;
              }).substr(0, 15),
              "clock_bias_s[5]");
  }
  EXPECT_EQ(message([](auto&, auto& o) { o.clock.white_frequency_m2ps = 1e18; }).substr(0, 8), "clock = ");
  EXPECT_EQ(message([](auto& s, auto&) { s.clock.white_frequency_m2ps = 1e18; }).substr(0, 16), "sources[0].clock");
  EXPECT_EQ(message([](auto&, auto& o) { o.clock_bias_s.assign(12, 0.3); }), "nothing");
}

TEST(OpportunityLink, Refuses) {
  const Eigen::Vector3d at = kHere + Eigen::Vector3d(0.0, 5000.0, 0.0);
  const std::vector<OpportunityBand> bands{{1575.42e6, 2.048e6, 0.0}};
  const auto refused = [&](const std::function<void(OpportunitySource&, OpportunityLinkOptions&)>& spoil) {
    OpportunitySource source = mast(0, at);
    OpportunityLinkOptions options = options_of(0.01);
    spoil(source, options);
    EXPECT_THROW(OpportunityLink(bands, {source}, options, RandomStream(1)), std::invalid_argument);
  };
  refused([](auto& s, auto&) { s.band = 1; });
  refused([](auto& s, auto&) { s.chips.clear(); });
  refused([](auto& s, auto&) { s.chip_rate_hz = 0.0; });
  refused([](auto& s, auto&) { s.bits = {1, 0}; });
  refused([](auto& s, auto&) { s.bits = {1}, s.symbol_s = 1.5e-3; });
  refused([](auto& s, auto&) { s.cn0_dbhz = kNan; });
  refused([](auto& s, auto&) { s.clock.white_frequency_m2ps = -1.0; });
  refused([](auto& s, auto&) { s.clock_start.drift_mps = kNan; });
  refused([](auto& s, auto&) { s.orbit = geometry::SampledOrbit::fixed(kHere); });
  refused([](auto&, auto& o) { o.step_s = 0.5; });
  refused([](auto&, auto& o) { o.duration_s = 0.0; });
  refused([](auto&, auto& o) { o.position_e.x() = kNan; });
  refused([](auto&, auto& o) { o.clock_bias_s = {0.0}; });
  refused([](auto&, auto& o) { o.start_s = kNan; });
  EXPECT_THROW(OpportunityLink({{0.0, 1e6, 0.0}}, {}, options_of(0.01), RandomStream(1)), std::invalid_argument);
  EXPECT_THROW(OpportunityLink({{1e9, 1e6, 1e6}}, {}, options_of(0.01), RandomStream(1)), std::invalid_argument);
  const OpportunityLink empty({}, {}, options_of(0.01), RandomStream(1));
  EXPECT_EQ(empty.samples(0), 0U);
  EXPECT_THROW(static_cast<void>(empty.delay_s(0)), std::invalid_argument);
}

}  // namespace
}  // namespace soopnav::simulation
