#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>

#include "iridium_scene.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/iridium/burst.hpp"
#include "soopnav/waveform/iridium/burst_detector.hpp"

namespace soopnav::iridium {
namespace {

using scene::found_in;
using scene::Scene;

TEST(BurstDetectorSlow, DetectionProbabilityAndAccuracyAgainstSnr) {
  // 2 Msps, 8.28 ms bursts at random times and carriers, default false-alarm rate; 300 of each SNR.
  struct Row {
    double snr_db, least, most, start_us, carrier_hz;  // probability between, rms of start and carrier at most
  };
  // Binomial error of 300 trials is below 0.03: bounds lie five of them beside what was measured.
  constexpr std::array<Row, 7> kRows{{{-6.0, 0.0, 0.1, 1e9, 1e9},
                                      {-4.0, 0.0, 0.4, 1e9, 1e9},
                                      {-2.0, 0.3, 0.95, 1e9, 1e9},
                                      {0.0, 0.97, 1.0, 800.0, 3000.0},
                                      {2.0, 0.99, 1.0, 400.0, 2000.0},
                                      {10.0, 0.99, 1.0, 60.0, 5.0},
                                      {20.0, 0.99, 1.0, 15.0, 3.0}}};
  for (const Row& row : kRows) {
    int hits = 0, trials = 0, others = 0;
    double start = 0.0, carrier = 0.0;
    for (std::uint64_t run = 0; run < 3; ++run) {
      Scene heard(2e6, 2.6, 100 + run);
      RandomStream draws(5, run);
      std::array<std::array<double, 2>, 100> truth;
      for (std::size_t i = 0; i < truth.size(); ++i) {
        truth[i] = {0.08 + 0.025 * static_cast<double>(i) + draws.uniform(0.0, 5e-3), draws.uniform(-950e3, 950e3)};
        heard.add(Burst::make(BurstKind::kDuplex, RandomStream(6, run).substream(i)), truth[i][0], truth[i][1],
                  row.snr_db);
      }
      const auto found = found_in(heard.iq, {});
      others += static_cast<int>(found.size());
      for (const auto& t : truth) {
        ++trials;
        for (const DetectedBurst& b : found) {
          if (std::abs(b.start_s - t[0]) > 5e-3 || std::abs(b.frequency_hz - t[1]) > 8e3) continue;
          ++hits;
          --others;
          start += (b.start_s - t[0]) * (b.start_s - t[0]);
          carrier += (b.frequency_hz - t[1]) * (b.frequency_hz - t[1]);
          break;
        }
      }
    }
    const double probability = static_cast<double>(hits) / trials;
    const double start_us = 1e6 * std::sqrt(start / std::max(hits, 1)),
                 carrier_hz = std::sqrt(carrier / std::max(hits, 1));
    std::printf("%5.1f dB: found %.3f, others %d, start %.0f us rms, carrier %.1f Hz rms\n", row.snr_db, probability,
                others, start_us, carrier_hz);
    EXPECT_GE(probability, row.least) << row.snr_db;
    EXPECT_LE(probability, row.most) << row.snr_db;
    EXPECT_LE(start_us, row.start_us) << row.snr_db;
    EXPECT_LE(carrier_hz, row.carrier_hz) << row.snr_db;
    EXPECT_LE(others, 6) << row.snr_db;
  }
}

TEST(BurstDetectorSlow, FalseAlarmsStayBelowTheirRateAtAllRates) {
  struct Row {
    double sample_rate_hz, seconds, asked;
  };
  for (const Row& row : {Row{2e6, 20.0, 10.0}, Row{2e6, 20.0, 0.1}, Row{250e3, 160.0, 10.0}, Row{250e3, 160.0, 0.1}}) {
    const Scene heard(row.sample_rate_hz, row.seconds, 200);
    const auto found = found_in(heard.iq, {.sample_rate_hz = row.sample_rate_hz, .false_alarms_per_s = row.asked});
    const double expected = row.asked * row.seconds;
    std::printf("%.0f Hz: %.3g a second of %.3g asked for\n", row.sample_rate_hz,
                static_cast<double>(found.size()) / row.seconds, row.asked);
    EXPECT_LE(static_cast<double>(found.size()), expected + 4.0 * std::sqrt(expected) + 1.0);
    EXPECT_GE(static_cast<double>(found.size()), expected > 100.0 ? expected / 100.0 : 0.0);
  }
}

}  // namespace
}  // namespace soopnav::iridium
