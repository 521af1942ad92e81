#include "soopnav/waveform/lte/pbch.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

#include "waveform/naive_pbch.hpp"
#include "waveform/pbch_signal.hpp"

namespace soopnav::lte {
namespace {

using ::testing::HasSubstr;

std::vector<int> to_ints(const auto& bits) { return std::vector<int>(bits.begin(), bits.end()); }

TEST(Mib, EqualsAPublishedPayload) {
  // Frame 100 of a 6-block cell with normal PHICH and N_g = 1, as another implementation packs it.
  const MibBits expected{0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0};
  EXPECT_EQ(pack_mib({6, 100, false, 2, 0}), expected);
}

TEST(Mib, EveryFieldComesBack) {
  for (const int n_rb : kBandwidthsRb) {
    for (int sfn = 0; sfn < 1024; ++sfn) {
      const MasterInformationBlock in{n_rb, sfn, sfn % 3 == 0, sfn % 4, static_cast<std::uint16_t>((37 * sfn) % 1024)};
      const auto out = unpack_mib(pack_mib(in));
      ASSERT_TRUE(out.has_value());
      EXPECT_EQ(out->n_rb, n_rb);
      EXPECT_EQ(out->sfn, sfn - sfn % 4);
      EXPECT_EQ(out->extended_phich, in.extended_phich);
      EXPECT_EQ(out->phich_resource, in.phich_resource);
      EXPECT_EQ(out->spare, in.spare);
    }
  }
}

TEST(Mib, ReservedBandwidthsAreRefused) {
  MibBits bits = pack_mib({100, 0, false, 0, 0});  // 101
  EXPECT_TRUE(unpack_mib(bits).has_value());
  bits[1] = 1;  // 111
  EXPECT_FALSE(unpack_mib(bits).has_value());
  bits[2] = 0;  // 110
  EXPECT_FALSE(unpack_mib(bits).has_value());
}

TEST(PbchElements, EqualTheDefinitionForAllCells) {
  for (int cell = 0; cell < 504; ++cell) {
    for (const CyclicPrefix cp : {CyclicPrefix::kNormal, CyclicPrefix::kExtended}) {
      const auto expected = test::naive_pbch_places(cell, cp == CyclicPrefix::kNormal);
      std::array<PbchElement, 240> elements;
      const int n = pbch_elements(cell, cp, elements);
      ASSERT_EQ(n, pbch_bits_per_frame(cp) / 2);
      ASSERT_EQ(expected.size(), static_cast<std::size_t>(n));
      for (std::size_t i = 0; i < expected.size(); ++i) {
        ASSERT_EQ(elements[i].symbol, expected[i].first) << cell << ' ' << i;
        ASSERT_EQ(elements[i].subcarrier, expected[i].second) << cell << ' ' << i;
      }
    }
  }
}

TEST(EncodePbch, EqualsTheStandardStepByStep) {
  std::vector<std::uint8_t> normal(1920), extended(1728);
  for (int cell = 0; cell < 504; cell += 7) {
    const int bandwidth = cell % 6, sfn = (cell * 41) % 1024;
    const MasterInformationBlock mib{kBandwidthsRb[static_cast<std::size_t>(bandwidth)], sfn, cell % 2 == 1, cell % 4,
                                     0};
    const auto payload = test::naive_mib(bandwidth, cell % 2 == 1, cell % 4, sfn);
    for (const int ports : {1, 2, 4}) {
      encode_pbch(mib, cell, ports, CyclicPrefix::kNormal, normal);
      ASSERT_EQ(to_ints(normal), test::naive_pbch_bits(payload, cell, ports, true)) << cell << ' ' << ports;
      encode_pbch(mib, cell, ports, CyclicPrefix::kExtended, extended);
      ASSERT_EQ(to_ints(extended), test::naive_pbch_bits(payload, cell, ports, false)) << cell << ' ' << ports;
    }
  }
}

TEST(EncodePbch, NamesWhatItRefuses) {
  std::vector<std::uint8_t> bits(1920);
  const auto message = [&](const MasterInformationBlock& mib, int cell, int ports, CyclicPrefix cp) -> std::string {
    try {
      encode_pbch(mib, cell, ports, cp, bits);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "accepted";
  };
  const MasterInformationBlock good{};
  EXPECT_EQ(message(good, 503, 4, CyclicPrefix::kNormal), "accepted");
  EXPECT_THAT(message({7, 0, false, 0, 0}, 0, 1, CyclicPrefix::kNormal), HasSubstr("mib.n_rb: 7"));
  EXPECT_THAT(message({6, 1024, false, 0, 0}, 0, 1, CyclicPrefix::kNormal), HasSubstr("mib.sfn: 1024"));
  EXPECT_THAT(message({6, 0, false, 4, 0}, 0, 1, CyclicPrefix::kNormal), HasSubstr("mib.phich_resource: 4"));
  EXPECT_THAT(message({6, 0, false, 0, 1024}, 0, 1, CyclicPrefix::kNormal), HasSubstr("mib.spare: 1024"));
  EXPECT_THAT(message(good, 504, 1, CyclicPrefix::kNormal), HasSubstr("cell_id: 504"));
  EXPECT_THAT(message(good, -1, 1, CyclicPrefix::kNormal), HasSubstr("cell_id: -1"));
  EXPECT_THAT(message(good, 0, 3, CyclicPrefix::kNormal), HasSubstr("n_ports: 3"));
  EXPECT_THAT(message(good, 0, 1, CyclicPrefix::kExtended), HasSubstr("out: 1920"));
}

// Antenna ports and prefixes share one battery.
struct Case {
  int n_ports;
  CyclicPrefix cp;
};

class Pbch : public ::testing::TestWithParam<Case> {
 protected:
  [[nodiscard]] test::PbchSender sender(int cell_id, double noise_variance) {
    std::uniform_real_distribution<double> phase(0.0, 6.28);
    test::PbchSender out{cell_id, GetParam().n_ports, GetParam().cp, {}, noise_variance, 1.0};
    for (auto& h : out.channel) h = std::polar(1.0, phase(random));
    return out;
  }

  std::mt19937_64 random{5};
};

INSTANTIATE_TEST_SUITE_P(PortsAndPrefixes, Pbch,
                         ::testing::Values(Case{1, CyclicPrefix::kNormal}, Case{2, CyclicPrefix::kNormal},
                                           Case{4, CyclicPrefix::kNormal}, Case{1, CyclicPrefix::kExtended},
                                           Case{2, CyclicPrefix::kExtended}, Case{4, CyclicPrefix::kExtended}));

TEST_P(Pbch, SoftBitsAreLogLikelihoodRatios) {
  // Of a true log-likelihood ratio L about a sent sign s, Gaussian: E[s L] = Var[L] / 2 = 2 |h|^2 / N0, whatever the
  // gains.
  constexpr double kNoise = 0.8;
  auto from = sender(77, kNoise);
  from.channel = {std::polar(0.6, 1.0), std::polar(1.3, -2.0), std::polar(0.9, 0.3), std::polar(0.4, 2.2)};
  double gain = 0.0;  // mean over elements of |h|^2 of the pair
  if (GetParam().n_ports == 1) gain = std::norm(from.channel[0]);
  if (GetParam().n_ports == 2) gain = (std::norm(from.channel[0]) + std::norm(from.channel[1])) / 2.0;
  if (GetParam().n_ports == 4) {
    for (const auto& h : from.channel) gain += std::norm(h) / 4.0;
  }
  const auto per_frame = static_cast<std::size_t>(pbch_bits_per_frame(from.cp));
  std::vector<std::uint8_t> bits(4 * per_frame);
  double sum = 0.0;
  constexpr int kFrames = 100;
  for (int frame = 0; frame < kFrames; ++frame) {
    const MasterInformationBlock mib{25, 4 * frame, false, 1, 0};
    encode_pbch(mib, from.cell_id, from.n_ports, from.cp, bits);
    const auto soft = from.soft_bits(mib, 1, random).front();
    for (std::size_t i = 0; i < per_frame; ++i) {
      sum += (bits[i] != 0 ? -1.0 : 1.0) * static_cast<double>(soft[i]);
    }
  }
  const double n = static_cast<double>(kFrames) * static_cast<double>(per_frame);
  const double expected = 2.0 * gain / kNoise;
  EXPECT_NEAR(sum / n, expected, 5.0 * std::sqrt(2.0 * expected * 2.0 / n));  // five sigma; pairs of 4 ports differ
}

TEST_P(Pbch, AStrongFrameIsEnoughAtEveryPhaseOfThePeriod) {
  PbchDecoder decoder;
  for (int cell = 0; cell < 504; cell += 9) {
    for (int phase = 0; phase < 4; ++phase) {
      const auto from = sender(cell, 0.05);
      const MasterInformationBlock mib{50, (cell * 8 + phase) % 1024, true, 3, 0};
      const auto soft = from.soft_bits(mib, 1, random);
      const auto result = decoder.decode(soft, cell, from.cp, from.n_ports);
      ASSERT_TRUE(result.has_value()) << cell << ' ' << phase;
      EXPECT_EQ(result->mib.sfn, mib.sfn);
      EXPECT_EQ(result->mib.n_rb, 50);
      EXPECT_TRUE(result->mib.extended_phich);
      EXPECT_EQ(result->mib.phich_resource, 3);
      EXPECT_EQ(result->n_ports, from.n_ports);
      EXPECT_GT(result->margin, 15.0);
    }
  }
}

TEST_P(Pbch, CombinesAcrossTheBorderForEveryCarryOfTheCounter) {
  // -14.5 dB per element: four frames of one period are too few here, six are enough (PbchSensitivity has the rates).
  PbchDecoder decoder;
  int right = 0, tried = 0;
  for (int counter = 0; counter < 256; counter += counter % 16 == 3 ? 4 : 1) {
    if (counter % 4 == 1) continue;  // keep the run short; every carry depth stays in
    const auto from = sender((counter * 31) % 504, std::pow(10.0, 1.45));
    const MasterInformationBlock mib{100, 4 * counter + 1 + counter % 3, false, 0, 0};
    const auto result = decoder.decode(from.soft_bits(mib, 6, random), from.cell_id, from.cp, from.n_ports);
    ++tried;
    if (!result) continue;
    EXPECT_EQ(result->mib.sfn, mib.sfn) << counter;
    EXPECT_EQ(result->mib.n_rb, 100) << counter;
    ++right;
  }
  EXPECT_GE(right, tried - tried / 12) << "of " << tried;
}

TEST_P(Pbch, TheFrameNumberWraps) {
  PbchDecoder decoder;
  for (const int sfn : {1020, 1021, 1022, 1023, 0, 508, 511, 512}) {
    const auto from = sender(200, 8.0);
    const auto result = decoder.decode(from.soft_bits({6, sfn, false, 2, 0}, 8, random), 200, from.cp, from.n_ports);
    ASSERT_TRUE(result.has_value()) << sfn;
    EXPECT_EQ(result->mib.sfn, sfn);
  }
}

TEST_P(Pbch, AnotherNumberOfPortsDoesNotPass) {
  // The same noise-free word under the other masks: the CRC must refuse it.
  PbchDecoder decoder;
  const auto from = sender(31, 0.01);
  const auto soft = from.soft_bits({15, 77, false, 2, 0}, 4, random);
  for (const int ports : {1, 2, 4}) {
    EXPECT_EQ(decoder.decode(soft, 31, from.cp, ports).has_value(), ports == from.n_ports);
  }
}

TEST_P(Pbch, AnotherCellDoesNotPass) {
  PbchDecoder decoder;
  const auto from = sender(31, 0.01);
  const auto soft = from.soft_bits({15, 77, false, 2, 0}, 4, random);
  for (const int cell : {0, 30, 32, 34, 503}) {
    EXPECT_FALSE(decoder.decode(soft, cell, from.cp, from.n_ports).has_value()) << cell;
  }
}

TEST_P(Pbch, MarginGrowsWithTheFrames) {
  PbchDecoder decoder;
  const auto from = sender(12, 0.01);
  const auto soft = from.soft_bits({15, 80, false, 2, 0}, 4, random);
  const auto one = decoder.decode(std::span(soft).first(1), 12, from.cp, from.n_ports);
  const auto four = decoder.decode(soft, 12, from.cp, from.n_ports);
  ASSERT_TRUE(one && four);
  // Nearly without noise the margin is the square root of the number of bits.
  EXPECT_NEAR(one->margin, std::sqrt(pbch_bits_per_frame(from.cp)), 0.3);
  EXPECT_NEAR(four->margin, 2.0 * one->margin, 0.3);
}

TEST(PbchDecoder, FramesWithoutANumberAreLeftOut) {
  std::mt19937_64 random(1);
  PbchDecoder decoder;
  const test::PbchSender from{99, 2, CyclicPrefix::kNormal, {1.0, {0.0, 1.0}, 1.0, 1.0}, 0.5, 1.0};
  auto soft = from.soft_bits({75, 600, false, 2, 0}, 6, random);
  soft[0][17] = std::numeric_limits<float>::quiet_NaN();
  soft[2][400] = std::numeric_limits<float>::infinity();
  const auto result = decoder.decode(soft, 99, CyclicPrefix::kNormal, 2);
  ASSERT_TRUE(result.has_value());
  EXPECT_EQ(result->mib.sfn, 600);
  for (auto& frame : soft) frame[5] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_FALSE(decoder.decode(soft, 99, CyclicPrefix::kNormal, 2).has_value());
}

TEST(PbchDecoder, NothingInNothingOut) {
  PbchDecoder decoder;
  EXPECT_FALSE(decoder.decode({}, 0, CyclicPrefix::kNormal, 1).has_value());
  const std::vector<PbchSoftBits> zeros(8);
  EXPECT_FALSE(decoder.decode(zeros, 0, CyclicPrefix::kNormal, 1).has_value());
  std::mt19937_64 random(1);
  const test::PbchSender from{0, 1, CyclicPrefix::kNormal, {1.0, 1.0, 1.0, 1.0}, 0.1, 1.0};
  const auto good = from.soft_bits({}, 1, random);
  EXPECT_TRUE(decoder.decode(good, 0, CyclicPrefix::kNormal, 1).has_value());
  for (const int cell : {-1, 504}) EXPECT_FALSE(decoder.decode(good, cell, CyclicPrefix::kNormal, 1).has_value());
  for (const int ports : {-1, 0, 3, 5}) EXPECT_FALSE(decoder.decode(good, 0, CyclicPrefix::kNormal, ports).has_value());
}

TEST(PbchDecoder, ToleratesSoftBitsOfAWrongScale) {
  std::mt19937_64 random(3);
  PbchDecoder decoder;
  for (const double noise_variance : {0.01, 1.0, 10.0}) {
    const test::PbchSender from{5, 1, CyclicPrefix::kNormal, {1.0, 1.0, 1.0, 1.0}, noise_variance, 1.0};
    const auto soft = from.soft_bits({50, 20, false, 2, 0}, 6, random);
    for (const float scale : {0.25F, 1.4F}) {
      auto scaled = soft;
      for (auto& frame : scaled) {
        for (float& bit : frame) bit *= scale;
      }
      const auto right = decoder.decode(soft, 5, CyclicPrefix::kNormal, 1);
      const auto wrong = decoder.decode(scaled, 5, CyclicPrefix::kNormal, 1);
      ASSERT_TRUE(right && wrong) << noise_variance << ' ' << scale;
      EXPECT_EQ(wrong->mib.sfn, 20);
      EXPECT_NEAR(wrong->margin, right->margin, 1e-3);
    }
  }
}

TEST(PbchDecoder, FindsASignalThatStartsLate) {
  std::mt19937_64 random(8);
  const test::PbchSender from{150, 2, CyclicPrefix::kNormal, {1.0, 1.0, 1.0, 1.0}, 1.0, 1.0};
  auto silent = from;
  silent.signal = 0.0;
  auto soft = silent.soft_bits({25, 100, false, 2, 0}, 60, random);
  const auto tail = from.soft_bits({25, 160, false, 2, 0}, 20, random);
  soft.insert(soft.end(), tail.begin(), tail.end());
  PbchDecoder decoder;
  const auto result = decoder.decode(soft, 150, CyclicPrefix::kNormal, 2);
  ASSERT_TRUE(result.has_value());
  EXPECT_EQ(result->mib.sfn, 100);  // of the first frame, although it held none
}

}  // namespace
}  // namespace soopnav::lte
