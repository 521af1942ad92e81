#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "iridium_scene.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/iridium/burst.hpp"
#include "soopnav/waveform/iridium/burst_detector.hpp"
#include "support/allocation_count.hpp"
#include "waveform/iridium/gamma_tail.hpp"

namespace soopnav::iridium {
namespace {

using scene::found_in;
using scene::Scene;

TEST(GammaTail, IsThatOfTheChiSquareTables) {
  // Upper quantiles of chi-square with 10 and 100 degrees of freedom (Abramowitz and Stegun, table 26.8).
  EXPECT_NEAR(gamma_tail_quantile(5.0, 0.01), 23.2093 / 10.0, 1e-5);
  EXPECT_NEAR(gamma_tail_quantile(5.0, 0.001), 29.588 / 10.0, 1e-4);
  EXPECT_NEAR(gamma_tail_quantile(50.0, 0.01), 135.807 / 100.0, 1e-5);
  // Shape 1 is the exponential distribution's border; near it -ln p.
  EXPECT_NEAR(gamma_tail_quantile(1.0 + 1e-9, 1e-9), -std::log(1e-9), 1e-6);
}

TEST(BurstDetector, FindsWhenWhereAndHowStrong) {
  // Bursts of all kinds at 10 dB: begins within 0.15 ms, carrier within 20 Hz (5 sigma and more of what is measured).
  Scene heard(500e3, 1.0, 1);
  struct Truth {
    double start_s, frequency_hz, duration_s;
  };
  std::vector<Truth> truths;
  constexpr std::array kKinds{BurstKind::kDuplex, BurstKind::kRingAlert, BurstKind::kLong};
  RandomStream draws(7);
  for (int i = 0; i < 9; ++i) {
    const Burst burst =
        Burst::make(kKinds[static_cast<std::size_t>(i % 3)], RandomStream(1).substream(static_cast<std::uint64_t>(i)));
    const double start = 0.02 + 0.105 * i + draws.uniform(0.0, 5e-3), carrier = draws.uniform(-220e3, 220e3);
    heard.add(burst, start, carrier, 10.0);
    truths.push_back({start, carrier, burst.duration_s()});
  }
  const auto found = found_in(heard.iq, {.sample_rate_hz = 500e3, .center_frequency_hz = 1.6e9});
  ASSERT_EQ(found.size(), truths.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    EXPECT_EQ(found[i].kind, SignalClass::kBurst);
    EXPECT_NEAR(found[i].start_s, truths[i].start_s, 0.15e-3);
    EXPECT_NEAR(found[i].duration_s, truths[i].duration_s, 0.25e-3);
    EXPECT_NEAR(found[i].frequency_hz - 1.6e9, truths[i].frequency_hz, 20.0);
    EXPECT_TRUE(found[i].fine_frequency);
    EXPECT_LT(found[i].frequency_sigma_hz, 5.0);
    EXPECT_NEAR(found[i].snr_db, 10.0, 1.3);
    EXPECT_NEAR(found[i].bandwidth_hz, 23.8e3, 6e3);
    EXPECT_FALSE(found[i].cut_start);
    EXPECT_FALSE(found[i].cut_end);
  }
}

TEST(BurstDetector, TellsNeighbouringChannelsAndSlotsApart) {
  Scene heard(500e3, 0.3, 2);
  const auto burst = [](std::uint64_t i) { return Burst::make(BurstKind::kDuplex, RandomStream(2).substream(i)); };
  heard.add(burst(0), 0.1, 0.0, 10.0);
  heard.add(burst(1), 0.1005, kChannelSpacingHz, 30.0);  // at the same time, 20 dB stronger
  heard.add(burst(2), 0.2, -100e3, 25.0);
  heard.add(burst(3), 0.2 + kDuplexSlotS + 0.6e-3, -100e3, 15.0);  // 0.6 ms later in the same channel
  const auto found = found_in(heard.iq, {.sample_rate_hz = 500e3});
  ASSERT_EQ(found.size(), 4U);
  EXPECT_NEAR(found[0].frequency_hz, 0.0, 100.0);
  EXPECT_NEAR(found[1].frequency_hz, kChannelSpacingHz, 20.0);
  EXPECT_NEAR(found[2].start_s, 0.2, 0.1e-3);
  EXPECT_NEAR(found[2].duration_s, kDuplexSlotS, 0.25e-3);
  EXPECT_NEAR(found[3].start_s, 0.2 + kDuplexSlotS + 0.6e-3, 0.2e-3);
  EXPECT_NEAR(found[3].snr_db, 15.0, 1.5);
}

TEST(BurstDetector, IsNotDrawnToAStrongerNeighbour) {
  // Doppler brings channels nearer than their spacing; the neighbour begins while the test still remembers the first.
  for (const double apart_hz : {33e3, 36e3, 42e3}) {
    for (std::uint64_t seed = 0; seed < 4; ++seed) {
      Scene heard(500e3, 0.2, 60 + seed);
      heard.add(Burst::make(BurstKind::kDuplex, RandomStream(61).substream(seed)), 0.1, 50e3, 6.0);
      heard.add(Burst::make(BurstKind::kDuplex, RandomStream(62).substream(seed)), 0.1090, 50e3 - apart_hz, 20.0);
      const auto found = found_in(heard.iq, {.sample_rate_hz = 500e3});
      ASSERT_EQ(found.size(), 2U) << apart_hz << ' ' << seed;
      EXPECT_NEAR(found[0].start_s, 0.1, 0.5e-3);
      EXPECT_NEAR(found[0].frequency_hz, 50e3, 3e3);
      EXPECT_NEAR(found[1].start_s, 0.1090, 0.15e-3);
      EXPECT_NEAR(found[1].duration_s, kDuplexSlotS, 0.25e-3);
      EXPECT_NEAR(found[1].frequency_hz, 50e3 - apart_hz, 20.0);
    }
  }
}

TEST(BurstDetector, FlagsTonesAndWhatDoesNotEnd) {
  Scene heard(500e3, 0.6, 3);
  heard.tone(0.2, 0.015, -50e3, 10.0);
  heard.tone(0.0, 0.6, 100e3, 12.0);  // stays
  heard.add(Burst::make(BurstKind::kLong, RandomStream(3), 0.4), 0.15, 40e3, 10.0);
  // Beside the tone that stays, once that counts as noise, bursts are found.
  heard.add(Burst::make(BurstKind::kDuplex, RandomStream(4)), 0.4, 145e3, 10.0);
  const auto found = found_in(heard.iq, {.sample_rate_hz = 500e3});
  ASSERT_EQ(found.size(), 4U);
  EXPECT_EQ(found[0].kind, SignalClass::kTone);
  EXPECT_TRUE(found[0].cut_start);
  EXPECT_TRUE(found[0].cut_end);
  EXPECT_GT(found[0].duration_s, 0.1);
  EXPECT_NEAR(found[0].frequency_hz, 100e3, 20.0);
  EXPECT_EQ(found[1].kind, SignalClass::kContinuous);
  EXPECT_NEAR(found[1].start_s, 0.15, 0.2e-3);
  EXPECT_TRUE(found[1].cut_end);
  EXPECT_EQ(found[2].kind, SignalClass::kTone);
  EXPECT_LT(found[2].bandwidth_hz, 6e3);
  EXPECT_NEAR(found[2].start_s, 0.2, 0.3e-3);
  EXPECT_NEAR(found[2].duration_s, 0.015, 0.5e-3);
  EXPECT_FALSE(found[2].cut_end);
  EXPECT_EQ(found[3].kind, SignalClass::kBurst);
  EXPECT_NEAR(found[3].start_s, 0.4, 0.15e-3);
}

TEST(BurstDetector, GivesTonesTheirWholeTimeWhereverTheyLie) {
  // A tone's test is as high anywhere in 25 kHz, and noise decides where: it is one signal all the same.
  for (std::uint64_t seed = 0; seed < 12; ++seed) {
    Scene heard(500e3, 0.25, 40 + seed);
    heard.tone(0.1, 0.05, -150e3 + 211.0 * static_cast<double>(seed), 18.0);
    const auto found = found_in(heard.iq, {.sample_rate_hz = 500e3});
    ASSERT_EQ(found.size(), 1U) << seed;
    EXPECT_NEAR(found[0].start_s, 0.1, 0.1e-3) << seed;
    EXPECT_NEAR(found[0].duration_s, 0.05, 0.2e-3) << seed;
    EXPECT_EQ(found[0].kind, SignalClass::kTone);
  }
}

TEST(BurstDetector, FlagsBurstsCutByTheRecordingsEnds) {
  Scene heard(250e3, 0.2, 4);
  heard.add(Burst::make(BurstKind::kDuplex, RandomStream(5)), -4e-3, 30e3, 12.0);
  heard.add(Burst::make(BurstKind::kRingAlert, RandomStream(6)), 0.19, -30e3, 12.0);
  const auto found = found_in(heard.iq, {.sample_rate_hz = 250e3});
  ASSERT_EQ(found.size(), 2U);
  EXPECT_TRUE(found[0].cut_start);
  EXPECT_FALSE(found[0].cut_end);
  EXPECT_NEAR(found[0].duration_s, 4.28e-3, 0.3e-3);
  EXPECT_FALSE(found[1].cut_start);
  EXPECT_TRUE(found[1].cut_end);
  EXPECT_NEAR(found[1].start_s, 0.19, 0.15e-3);
  EXPECT_NEAR(found[1].duration_s, 0.01, 0.3e-3);
}

TEST(BurstDetector, FindsABurstThatFillsAShortRecording) {
  // Most of what the noise is learnt from is the burst itself: the bins around it tell.
  Scene heard(500e3, 0.028, 5);
  heard.add(Burst::make(BurstKind::kRingAlert, RandomStream(7)), 4e-3, -80e3, 10.0);
  const auto found = found_in(heard.iq, {.sample_rate_hz = 500e3});
  ASSERT_EQ(found.size(), 1U);
  EXPECT_NEAR(found[0].start_s, 4e-3, 0.15e-3);
  EXPECT_NEAR(found[0].frequency_hz, -80e3, 20.0);
}

TEST(BurstDetector, DoesNotDependOnHowTheSamplesAreCut) {
  Scene heard(250e3, 0.5, 6);
  for (int i = 0; i < 4; ++i) {
    heard.add(Burst::make(BurstKind::kDuplex, RandomStream(8).substream(static_cast<std::uint64_t>(i))), 0.05 + 0.1 * i,
              20e3 * i, 6.0);
  }
  const DetectorOptions options{.sample_rate_hz = 250e3};
  const auto whole = found_in(heard.iq, options);
  BurstDetector detector(options);
  std::vector<DetectedBurst> pieces;
  IqSpan rest = heard.iq;
  for (std::size_t size = 1; !rest.empty(); size = size % 1777 + 13) {
    const IqSpan piece = rest.first(std::min(size, rest.size()));
    const auto some = detector.push(piece);
    pieces.insert(pieces.end(), some.begin(), some.end());
    rest = rest.subspan(piece.size());
  }
  EXPECT_EQ(detector.samples(), heard.iq.size());
  const auto some = detector.flush();
  pieces.insert(pieces.end(), some.begin(), some.end());
  EXPECT_EQ(detector.samples(), 0U);
  ASSERT_EQ(pieces.size(), 4U);
  ASSERT_EQ(whole.size(), 4U);
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_EQ(pieces[i].start_s, whole[i].start_s);
    EXPECT_EQ(pieces[i].frequency_hz, whole[i].frequency_hz);
    EXPECT_EQ(pieces[i].snr_db, whole[i].snr_db);
  }
  // After flush and reset it starts afresh.
  detector.push(IqSpan(heard.iq).first(40'000));
  detector.reset();
  const auto again = detector.push(heard.iq);
  ASSERT_GE(again.size(), 3U);
  EXPECT_EQ(again[0].start_s, whole[0].start_s);
}

TEST(BurstDetector, SurvivesBadSamples) {
  Scene heard(250e3, 0.3, 9);
  heard.add(Burst::make(BurstKind::kDuplex, RandomStream(9)), 0.15, 0.0, 15.0);
  heard.iq[1000] = {std::nanf(""), 0.0F};
  heard.iq[40'000] = {0.0F, std::numeric_limits<float>::infinity()};
  BurstDetector detector({.sample_rate_hz = 250e3});
  std::vector<DetectedBurst> found;
  for (const auto& b : detector.push(heard.iq)) found.push_back(b);
  EXPECT_EQ(detector.rejected_samples(), 2U);
  ASSERT_EQ(found.size(), 1U);
  EXPECT_NEAR(found[0].start_s, 0.15, 0.2e-3);

  // Nothing, too little, silence, a constant, numbers at the edge of single precision: nothing is found, nothing
  // breaks.
  detector.reset();
  EXPECT_TRUE(detector.push({}).empty());
  EXPECT_TRUE(detector.flush().empty());
  EXPECT_TRUE(detector.push(IqSpan(heard.iq).first(900)).empty());
  EXPECT_TRUE(detector.flush().empty());
  EXPECT_EQ(detector.threshold(), 0.0);
  for (const Cf32 value : {Cf32(), Cf32(1e30F, 1e30F), Cf32(1e-30F, 0.0F)}) {
    const std::vector<Cf32> same(100'000, value);
    detector.push(same);
    for (const DetectedBurst& b : detector.flush()) EXPECT_NE(b.kind, SignalClass::kBurst);
  }
  // Silence, then noise: a receiver that starts. The noise becomes noise, and is no flood of bursts.
  std::vector<Cf32> starting(100'000);
  starting.insert(starting.end(), heard.iq.begin(), heard.iq.end());
  detector.push(starting);
  EXPECT_LT(detector.flush().size(), 40U);
}

TEST(BurstDetector, HoldsItsFalseAlarmRate) {
  // At most the rate asked for: cells overlap, and only what begins and ends in them is reported. Not idle either.
  const Scene heard(250e3, 16.0, 10);
  const auto found = found_in(heard.iq, {.sample_rate_hz = 250e3, .false_alarms_per_s = 10.0});
  EXPECT_LE(found.size(), 160U);
  EXPECT_GE(found.size(), 1U);
  EXPECT_LE(found_in(heard.iq, {.sample_rate_hz = 250e3, .false_alarms_per_s = 1e-4}).size(), 1U);
}

TEST(BurstDetector, FindsWeakBurstsAndNotWhatIsFarBelow) {
  for (const double snr_db : {3.0, -12.0}) {
    Scene heard(250e3, 2.1, 11);
    for (int i = 0; i < 20; ++i) {
      heard.add(Burst::make(BurstKind::kDuplex, RandomStream(11).substream(static_cast<std::uint64_t>(i))),
                0.08 + 0.1 * i, -90e3 + 9e3 * i, snr_db);
    }
    const auto found = found_in(heard.iq, {.sample_rate_hz = 250e3});
    EXPECT_EQ(found.size(), snr_db > 0.0 ? 20U : 0U);
    for (const DetectedBurst& b : found) EXPECT_NEAR(b.snr_db, snr_db, 3.0);
  }
}

TEST(BurstDetector, RefusesBadOptions) {
  const auto refusal = [](const DetectorOptions& options) -> std::string {
    try {
      BurstDetector detector(options);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_EQ(refusal({.sample_rate_hz = 10e3}), "sample_rate_hz = 10000 must be in 50e3 ... 100e6");
  EXPECT_NE(refusal({.sample_rate_hz = std::nan("")}), "");
  EXPECT_NE(refusal({.center_frequency_hz = std::nan("")}), "");
  EXPECT_EQ(refusal({.false_alarms_per_s = 0.0}), "false_alarms_per_s = 0 must be in 1e-9 ... 100");
  EXPECT_NE(refusal({.max_burst_s = 2.0}), "");
  EXPECT_EQ(refusal({.sample_rate_hz = 100e6, .max_burst_s = 0.5}),
            "max_burst_s = 0.5 must be at most 20e6 samples at this sample_rate_hz");
  EXPECT_EQ(refusal({.sample_rate_hz = 50e3}), "");
  EXPECT_EQ(refusal({.sample_rate_hz = 1.234567e6}), "");
}

TEST(Burst, SamplingAllocatesNothing) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  const Burst burst = Burst::make(BurstKind::kLong, RandomStream(9));
  std::vector<Cf32> out(5000), symbols(100);
  const std::vector<double> times(100, 1e-3);
  EXPECT_EQ(test::allocations_of([&] {
              burst.evaluate(0.0, 2e-5, 1e-13, out);
              burst.evaluate(times, out);
              burst.render({.doppler_hz = 100.0}, out);
              burst.add_to({.doppler_hz = 100.0}, out);
              matched_filter(out, 50e3, 0.0, 100.0, symbols);
            }),
            0);
}

TEST(BurstDetector, PushAllocatesNothing) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  Scene heard(250e3, 0.4, 12);
  for (int i = 0; i < 3; ++i) {
    heard.add(Burst::make(BurstKind::kDuplex, RandomStream(12).substream(static_cast<std::uint64_t>(i))),
              0.03 + 0.12 * i, 20e3, 10.0);
  }
  heard.tone(0.0, 0.4, -60e3, 10.0);
  BurstDetector detector({.sample_rate_hz = 250e3});
  std::size_t found = 0;
  EXPECT_EQ(test::allocations_of([&] {
              found += detector.push(heard.iq).size();
              found += detector.flush().size();
            }),
            0);
  EXPECT_EQ(found, 4U);
}

}  // namespace
}  // namespace soopnav::iridium
