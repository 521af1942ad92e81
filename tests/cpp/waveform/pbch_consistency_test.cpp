// Monte-Carlo rates of the PBCH decoder, fixed seeds.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>

#include "soopnav/waveform/lte/pbch.hpp"
#include "waveform/pbch_signal.hpp"

namespace soopnav::lte {
namespace {

struct Rates {
  int right = 0;
  int wrong = 0;
};

Rates run(int runs, double snr_db, std::size_t frames, int n_ports, CyclicPrefix cp, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> phase(0.0, 6.28);
  PbchDecoder decoder;
  Rates rates;
  for (int i = 0; i < runs; ++i) {
    test::PbchSender from{static_cast<int>(random() % 504), n_ports, cp, {}, std::pow(10.0, -snr_db / 10.0), 1.0};
    for (auto& h : from.channel) h = std::polar(1.0, phase(random));
    const MasterInformationBlock mib{kBandwidthsRb[random() % 6], static_cast<int>(random() % 1024), false, 2, 0};
    const auto result = decoder.decode(from.soft_bits(mib, frames, random), from.cell_id, cp, n_ports);
    if (!result) continue;
    ++(result->mib.sfn == mib.sfn && result->mib.n_rb == mib.n_rb ? rates.right : rates.wrong);
  }
  return rates;
}

// SNR per resource element of one port's reference signals; a known channel.
TEST(PbchSensitivity, SixFramesAtMinusTenDecibels) {
  for (const int n_ports : {1, 2, 4}) {
    const Rates rates = run(150, -10.0, 6, n_ports, CyclicPrefix::kNormal, 10);
    EXPECT_EQ(rates.right, 150) << n_ports;
    EXPECT_EQ(rates.wrong, 0) << n_ports;
  }
}

TEST(PbchSensitivity, SixFramesAtMinusFourteenDecibels) {
  const Rates rates = run(300, -14.0, 6, 2, CyclicPrefix::kNormal, 11);
  EXPECT_GE(rates.right, 290);  // 0.998 over 500 runs; 0.97 is ten standard deviations below
  EXPECT_EQ(rates.wrong, 0);
}

TEST(PbchSensitivity, SixFramesNeedTheBorder) {
  // Four frames, of which at most four share a period, against the six that straddle it: what combining buys.
  const Rates four = run(200, -15.0, 4, 2, CyclicPrefix::kNormal, 12);
  const Rates six = run(200, -15.0, 6, 2, CyclicPrefix::kNormal, 12);
  EXPECT_LT(four.right, 120);
  EXPECT_GE(six.right, 180);
  EXPECT_EQ(four.wrong + six.wrong, 0);
}

TEST(PbchSensitivity, LongerCapturesReachFurther) {
  EXPECT_GE(run(60, -18.0, 16, 2, CyclicPrefix::kNormal, 13).right, 57);
  EXPECT_GE(run(40, -20.0, 32, 2, CyclicPrefix::kExtended, 14).right, 38);
}

TEST(PbchFalseAlarm, AnotherNumberOfPortsGivesNoWord) {
  // Cells of every number of ports, equalised and decoded for each other one, from weak to strong. Without the tests
  // beyond the margin a tenth of these gave a word.
  std::mt19937_64 random(16);
  std::uniform_real_distribution<double> phase(0.0, 6.28);
  PbchDecoder decoder;
  int wrong = 0;
  for (int i = 0; i < 100; ++i) {
    for (const int sent : {1, 2, 4}) {
      const double snr_db = -12.0 + i % 9 * 4.0;
      test::PbchSender from{static_cast<int>(random() % 504), sent, CyclicPrefix::kNormal, {},
                            std::pow(10.0, -snr_db / 10.0),   1.0};
      for (auto& h : from.channel) h = std::polar(1.0, phase(random));
      MasterInformationBlock mib{50, static_cast<int>(random() % 1024), false, 2, 0};
      std::array<PbchObservation, 6> observed;
      for (auto& frame : observed) {
        frame = from.frame(mib, random);
        mib.sfn = (mib.sfn + 1) % 1024;
      }
      for (const int assumed : {1, 2, 4}) {
        if (assumed == sent) continue;
        for (const int equalised : {sent, assumed}) {
          std::array<PbchSoftBits, 6> soft;
          for (std::size_t f = 0; f < soft.size(); ++f) {
            demodulate_pbch(observed[f], from.cell_id, from.cp, equalised, soft[f]);
          }
          if (decoder.decode(soft, from.cell_id, from.cp, assumed)) ++wrong;
        }
      }
    }
  }
  EXPECT_LE(wrong, 2) << "of 1200";  // 1 in 7000 in longer runs
}

TEST(PbchFalseAlarm, NoiseGivesNoWord) {
  // Expected below 1e-5 per call (cpp/doc/pbch_decoding.md eq. 5); one in 3000 calls would be a rate 30 times that.
  std::mt19937_64 random(15);
  std::normal_distribution<float> normal;
  PbchDecoder decoder;
  std::array<PbchSoftBits, 6> soft;
  int found = 0;
  for (int i = 0; i < 3000; ++i) {
    for (auto& frame : soft) {
      for (float& bit : frame) bit = normal(random);
    }
    if (decoder.decode(soft, i % 504, i % 2 == 0 ? CyclicPrefix::kNormal : CyclicPrefix::kExtended, 1 << (i % 3)))
      ++found;
  }
  EXPECT_EQ(found, 0);
}

}  // namespace
}  // namespace soopnav::lte
