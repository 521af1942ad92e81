#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/iridium/burst.hpp"
#include "soopnav/waveform/iridium/channel_plan.hpp"

namespace soopnav::iridium {
namespace {

using Complex = std::complex<double>;

std::string refusal(const auto& body) {
  try {
    body();
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

/// s(t) by definition: every symbol, the pulse's formula, double precision.
Complex envelope(const Burst& burst, double t_s) {
  Complex sum;
  for (std::size_t k = 0; k < burst.size(); ++k) {
    sum += Complex(burst.symbol(k)) * pulse(t_s * kSymbolRateHz - static_cast<double>(k) - 0.5);
  }
  return sum;
}

TEST(ChannelPlan, NumbersFrequenciesAndUses) {
  EXPECT_NEAR(channel_frequency_hz(1), 1616.020833e6, 1.0);
  EXPECT_NEAR(channel_frequency_hz(9) - channel_frequency_hz(1), 1e6 / 3.0, 1e-6);  // a sub-band further
  EXPECT_NEAR(channel_frequency_hz(240), 1625.979167e6, 1.0);
  EXPECT_NEAR(channel_frequency_hz(kRingAlertChannel), 1626.270833e6, 1.0);
  EXPECT_DOUBLE_EQ(channel_frequency_hz(kRingAlertChannel), kRingAlertHz);
  EXPECT_NEAR(channel_frequency_hz(252) + 0.5 * kChannelSpacingHz, kBandEndHz, 1e-6);
  EXPECT_EQ(channel_use(240), ChannelUse::kDuplex);
  EXPECT_EQ(channel_use(247), ChannelUse::kRingAlert);
  EXPECT_EQ(channel_use(251), ChannelUse::kMessaging);  // 1626.4375 MHz
  EXPECT_EQ(channel_use(252), ChannelUse::kGuard);
  EXPECT_NEAR(kGuardsS, 3.44e-3, 1e-12);
  EXPECT_EQ(refusal([] { static_cast<void>(channel_frequency_hz(0)); }), "channel = 0 must be in 1 ... 252");
  EXPECT_EQ(refusal([] { static_cast<void>(channel_use(253)); }), "channel = 253 must be in 1 ... 252");
}

TEST(ChannelPlan, CandidatesAreWithinTheDopplerNearestFirst) {
  std::array<ChannelCandidate, 4> out;
  // 30 kHz above channel 100: approaching there, or receding from channel 101.
  ASSERT_EQ(channel_candidates(channel_frequency_hz(100) + 30e3, out), 2U);
  EXPECT_EQ(out[0].channel, 101);
  EXPECT_NEAR(out[0].doppler_hz, 30e3 - kChannelSpacingHz, 1e-6);
  EXPECT_EQ(out[1].channel, 100);
  EXPECT_NEAR(out[1].doppler_hz, 30e3, 1e-6);
  ASSERT_EQ(channel_candidates(kRingAlertHz + 1e3, out), 1U);
  EXPECT_EQ(out[0].channel, 247);
  ASSERT_EQ(channel_candidates(kBandStartHz - 10e3, out), 1U);  // below the band, receding
  EXPECT_EQ(out[0].channel, 1);
  EXPECT_EQ(channel_candidates(kBandStartHz - 20e3, out), 0U);
  EXPECT_EQ(channel_candidates(std::nan(""), out), 0U);
  EXPECT_EQ(channel_candidates(1e300, out), 0U);
  EXPECT_EQ(channel_candidates(kRingAlertHz, {}), 0U);
  EXPECT_EQ(channel_candidates(kRingAlertHz, out, 90e3), 4U);  // of five
}

TEST(Pulse, IsARootRaisedCosineOfMeanPowerOne) {
  // Sampled eight times a symbol its autocorrelation is Nyquist's: one at zero, nothing at other symbols.
  constexpr int kRate = 8;
  for (int lag = 0; lag <= 10; ++lag) {
    double sum = 0.0;
    for (int n = -16 * kRate; n <= 16 * kRate; ++n) {
      sum += pulse(static_cast<double>(n) / kRate) * pulse(static_cast<double>(n) / kRate - lag) / kRate;
    }
    EXPECT_NEAR(sum, lag == 0 ? 1.0 : 0.0, 2e-3) << lag;
  }
  // Spectrum: flat to 0.3 and gone beyond 0.7 of the symbol rate.
  const auto spectrum = [](double f) {
    double sum = 0.0;
    for (int n = -16 * kRate; n <= 16 * kRate; ++n)
      sum += pulse(static_cast<double>(n) / kRate) * std::cos(kTwoPi * f * n / kRate) / kRate;
    return sum;
  };
  EXPECT_NEAR(spectrum(0.0), 1.0, 5e-3);
  EXPECT_NEAR(spectrum(0.25), 1.0, 5e-3);
  EXPECT_NEAR(spectrum(0.5), std::sqrt(0.5), 5e-3);
  for (double f = 0.75; f < 3.0; f += 0.013) EXPECT_LT(std::abs(spectrum(f)), 3.2e-3) << f;  // -50 dB
  EXPECT_EQ(pulse(12.0), 0.0);
  EXPECT_EQ(pulse(-30.0), 0.0);
  EXPECT_EQ(pulse(std::nan("")), 0.0);
  EXPECT_NEAR(pulse(0.625), 0.5 * (pulse(0.625 - 1e-3) + pulse(0.625 + 1e-3)), 1e-5);  // 0/0 in the formula
  EXPECT_NEAR(pulse(1e-7), pulse(2e-5), 1e-8);
}

TEST(Burst, IsMadeAsTheAirInterfaceHasIt) {
  const Burst duplex = Burst::make(BurstKind::kDuplex, RandomStream(1));
  EXPECT_NEAR(duplex.duration_s(), kDuplexSlotS, 1e-12);
  EXPECT_EQ(duplex.payload_start(), 28U);
  for (std::size_t k = 0; k < 16; ++k) EXPECT_EQ(duplex.quadrants()[k], 0) << k;
  EXPECT_TRUE(std::ranges::equal(duplex.quadrants().subspan(16, 12), kDownlinkWord));
  const Burst alert = Burst::make(BurstKind::kRingAlert, RandomStream(1));
  EXPECT_NEAR(alert.duration_s(), kSimplexSlotS, 1e-12);
  EXPECT_EQ(alert.payload_start(), 76U);
  const Burst uplink = Burst::make(BurstKind::kDuplex, RandomStream(1), 0.0, BurstDirection::kUplink);
  EXPECT_TRUE(std::ranges::equal(uplink.quadrants().subspan(16, 12), kUplinkWord));
  EXPECT_EQ(uplink.quadrants()[0], 2);
  EXPECT_EQ(uplink.quadrants()[1], 0);
  const Burst own = Burst::make(BurstKind::kLong, RandomStream(1), 32.5e-3);
  EXPECT_EQ(own.size(), 813U);  // 812.5, rounded
  EXPECT_EQ(own.payload_start(), 0U);
  EXPECT_EQ(Burst::make(BurstKind::kLong, RandomStream(1)).size(), 2250U);

  // Payload: by stream alone, all four dibits as often.
  EXPECT_TRUE(std::ranges::equal(duplex.quadrants(), Burst::make(BurstKind::kDuplex, RandomStream(1)).quadrants()));
  EXPECT_FALSE(std::ranges::equal(duplex.quadrants(), Burst::make(BurstKind::kDuplex, RandomStream(2)).quadrants()));
  std::array<int, 4> counts{};
  const Burst many = Burst::make(BurstKind::kLong, RandomStream(3), 1.0);
  for (std::size_t k = 1; k < many.size(); ++k) ++counts[(many.quadrants()[k] + 4U - many.quadrants()[k - 1]) & 3U];
  for (const int count : counts) EXPECT_NEAR(count, 6250, 5 * std::sqrt(6250.0 * 0.75));
  for (std::size_t k = 0; k < many.size(); ++k) {
    EXPECT_NEAR(std::arg(Complex(many.symbol(k)) * std::polar(1.0, -kPi / 4 - many.quadrants()[k] * kPi / 2)), 0.0,
                1e-6);
  }
}

TEST(Burst, RefusesWhatTheKindDoesNotHave) {
  EXPECT_EQ(refusal([] { static_cast<void>(Burst::make(BurstKind::kDuplex, RandomStream(1), 20e-3)); }),
            "duration_s = 0.02 must be 0 or within 0.00588 ... 0.00828 s for this kind of burst");
  EXPECT_NE(refusal([] { static_cast<void>(Burst::make(BurstKind::kSimplex, RandomStream(1), 5e-3)); }), "");
  EXPECT_NE(refusal([] { static_cast<void>(Burst::make(BurstKind::kLong, RandomStream(1), std::nan(""))); }), "");
  EXPECT_NE(refusal([] { static_cast<void>(Burst::make(BurstKind::kLong, RandomStream(1), -1.0)); }), "");
  EXPECT_EQ(refusal([] { Burst({}); }), "symbols.size() = 0 must be in 1 ... 250000");
  const std::array<Cf32, 2> bad{Cf32(1.0F, 0.0F), Cf32(std::nanf(""), 0.0F)};
  EXPECT_EQ(refusal([&] { Burst{bad}; }), "symbols[1] must be finite");
  std::array<Cf32, 3> out;
  const Burst burst = Burst::make(BurstKind::kDuplex, RandomStream(1));
  EXPECT_EQ(refusal([&] { burst.render({.sample_rate_hz = 0.0}, out); }),
            "sample_rate_hz = 0 must be positive and finite");
  EXPECT_NE(refusal([&] { burst.render({.delay_rate = 0.2}, out); }), "");
  EXPECT_NE(refusal([&] { burst.render({.doppler_hz = std::nan("")}, out); }), "");
  EXPECT_NE(refusal([&] { matched_filter({}, 30e3, 0.0, 0.0, out); }), "");
  EXPECT_NE(refusal([&] { matched_filter({}, 50e3, std::nan(""), 0.0, out); }), "");
}

TEST(Burst, EqualsItsDefinitionAtAnyTime) {
  const Burst burst = Burst::make(BurstKind::kDuplex, RandomStream(5));
  std::vector<Cf32> out(700);
  const double t0 = -0.6e-3, dt = 1.0 / 71e3, bend = 3e-9;
  burst.evaluate(t0, dt, bend, out);
  std::vector<double> times(out.size());
  double error = 0.0, power = 0.0;
  for (std::size_t n = 0; n < out.size(); ++n) {
    const double i = static_cast<double>(n);
    times[n] = t0 + dt * i + bend * i * i;
    const Complex truth = envelope(burst, times[n]);
    error = std::max(error, std::abs(Complex(out[n]) - truth));
    power += std::norm(truth);
  }
  EXPECT_GT(power, 400.0);
  EXPECT_LT(error, 3e-5);  // -90 dB
  std::vector<Cf32> again(out.size());
  burst.evaluate(times, again);
  for (std::size_t n = 0; n < out.size(); ++n) EXPECT_LT(std::abs(out[n] - again[n]), 1e-6F);
  // Outside, and where there is no time.
  times = {-1.0, 1.0, std::nan(""), std::numeric_limits<double>::infinity(), 1e300};
  std::vector<Cf32> none(times.size(), Cf32(9.0F, 9.0F));
  burst.evaluate(times, none);
  for (const Cf32 z : none) EXPECT_EQ(z, Cf32());
  burst.evaluate(std::nan(""), 1.0, 0.0, none);
  for (const Cf32 z : none) EXPECT_EQ(z, Cf32());
}

TEST(Burst, HasUnitPower) {
  for (const BurstKind kind : {BurstKind::kRingAlert, BurstKind::kDuplex, BurstKind::kLong}) {
    const Burst burst = Burst::make(kind, RandomStream(6));
    std::vector<Cf32> out(static_cast<std::size_t>(burst.duration_s() * 200e3));
    burst.evaluate(0.0, 5e-6, 0.0, out);
    double power = 0.0;
    for (const Cf32 z : out) power += static_cast<double>(std::norm(z)) / static_cast<double>(out.size());
    EXPECT_NEAR(power, 1.0, 0.03);
  }
}

TEST(Burst, SymbolsReturnFromTheMatchedFilter) {
  for (const double rate : {50e3, 61.7e3, 240e3}) {
    const Burst burst = Burst::make(BurstKind::kDuplex, RandomStream(7));
    Arrival arrival{.sample_rate_hz = rate, .delay_s = 1.2345e-3, .doppler_hz = 4321.0, .phase_rad = 0.7};
    std::vector<Cf32> iq(static_cast<std::size_t>(12e-3 * rate)), symbols(burst.size());
    burst.render(arrival, iq);
    matched_filter(iq, rate, arrival.delay_s, arrival.doppler_hz, symbols);
    double error = 0.0;
    for (std::size_t k = 0; k < symbols.size(); ++k) {
      error += std::norm(Complex(symbols[k]) * std::polar(1.0, -0.7) - Complex(burst.symbol(k)));
    }
    EXPECT_LT(10.0 * std::log10(error / static_cast<double>(symbols.size())), -45.0) << rate;
  }
}

TEST(Burst, ArrivesWithDelayDopplerAndTheirRates) {
  const Burst burst = Burst::make(BurstKind::kDuplex, RandomStream(8));
  const Arrival a{.sample_rate_hz = 400e3,
                  .delay_s = 0.9e-3,
                  .delay_rate = 2e-5,
                  .delay_acceleration = 4e-3,
                  .doppler_hz = 33e3,
                  .doppler_rate_hz_per_s = -5e3,
                  .phase_rad = 1.1,
                  .amplitude = 0.25};
  std::vector<Cf32> out(4000), sum(4000, Cf32(1.0F, -2.0F));
  burst.render(a, out);
  burst.add_to(a, sum);
  double error = 0.0;
  for (std::size_t n = 0; n < out.size(); n += 7) {
    const double t = static_cast<double>(n) / a.sample_rate_hz;
    const double delay = a.delay_s + (a.delay_rate + 0.5 * a.delay_acceleration * t) * t;
    const double phase = a.phase_rad + kTwoPi * (a.doppler_hz + 0.5 * a.doppler_rate_hz_per_s * t) * t;
    error = std::max(error, std::abs(Complex(out[n]) - std::polar(0.25, phase) * envelope(burst, t - delay)));
    EXPECT_LT(std::abs(sum[n] - out[n] - Cf32(1.0F, -2.0F)), 1e-6F);
  }
  EXPECT_LT(error, 0.25 * 4e-5);
  // Without acceleration only the burst's own samples are gone through: the same numbers, zeros around them.
  Arrival b = a;
  b.delay_acceleration = 0.0;
  b.delay_s = 3e-3;
  std::vector<Cf32> whole(8000), later(8000);
  burst.render(b, whole);
  b.delay_acceleration = 1e-300;
  burst.render(b, later);
  for (std::size_t n = 0; n < whole.size(); ++n) ASSERT_LT(std::abs(whole[n] - later[n]), 1e-5F) << n;
  EXPECT_EQ(whole[0], Cf32());
  EXPECT_EQ(whole.back(), Cf32());
  b.delay_s = 1e9;  // never, in these samples
  b.delay_acceleration = 0.0;
  burst.render(b, whole);
  for (const Cf32 z : whole) ASSERT_EQ(z, Cf32());
}

}  // namespace
}  // namespace soopnav::iridium
