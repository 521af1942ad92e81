// Times of arrival on captures of known delay, and what the estimators refuse.
#include "soopnav/waveform/lte/time_of_arrival.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "support/nan.hpp"
#include "waveform/lte_scene.hpp"

namespace soopnav::lte {
namespace {

using test::noise;
using test::random_cell;
using test::truth;
using test::wrapped_s;
using ::testing::HasSubstr;

using ::soopnav::test::kNan;

std::vector<Cf32> capture(const CellParameters& cell, double rate_hz, double duration_s, double snr_db,
                          std::uint64_t seed) {
  return synthesize({&cell, 1}, rate_hz, static_cast<std::size_t>(std::llround(duration_s * rate_hz)),
                    noise_variance_for_snr(snr_db), seed);
}

// What a search hands over: right but for errors of its size.
Detection roughly(const CellParameters& cell) {
  Detection d = truth(cell);
  d.frame_start_s += 0.08e-6;
  d.cfo_hz -= 3.0;
  d.clock_error_ppm += 0.2;
  d.clock_error_sigma_ppm = 0.2;
  return d;
}

// The first path of frame i comes at delay + i * 10 ms / (1 + clock error). Bounds of six deviations.
void expect_truth(const TimeOfArrival& toa, const CellParameters& cell, std::size_t frames) {
  ASSERT_EQ(toa.toa_s.size(), frames);
  ASSERT_EQ(toa.sigma_s.size(), frames);
  ASSERT_EQ(toa.frame_index.size(), frames);
  EXPECT_GE(toa.toa_s.front(), 0.0);
  EXPECT_LT(toa.toa_s.front(), kFrameS);
  const double late_s = kFrameS / (1.0 + 1e-6 * cell.clock_error_ppm) - kFrameS;  // of each frame after the one before
  for (std::size_t i = 0; i < frames; ++i) {
    EXPECT_GT(toa.sigma_s[i], 0.0);
    EXPECT_LT(std::abs(wrapped_s(toa.toa_s[i] - cell.delay_s - toa.frame_index[i] * late_s)), 6.0 * toa.sigma_s[i])
        << "frame " << toa.frame_index[i];
    EXPECT_LT(std::abs(toa.toa_s[i] - toa.toa_s[0]), 5e-6);  // no jump of a frame
    if (i > 0) {
      EXPECT_EQ(toa.frame_index[i], toa.frame_index[i - 1] + 1);
    }
  }
}

struct Kind {
  double rate_hz;
  int n_rb;
  int n_ports;
  CyclicPrefix cp;
  Duplex duplex;
  int tdd_configuration = 0;
};

class ToaKinds : public ::testing::TestWithParam<Kind> {};

TEST_P(ToaKinds, EveryFramesDelay) {
  const Kind kind = GetParam();
  RandomStream random(static_cast<std::uint64_t>(kind.n_rb), static_cast<std::uint64_t>(kind.rate_hz));
  CellParameters cell = random_cell(random, kind.n_rb, kind.n_ports);
  cell.cp = kind.cp;
  cell.duplex = kind.duplex;
  cell.tdd_configuration = kind.tdd_configuration;
  cell.delay_s = random.uniform(0.1e-3, 0.3e-3);  // three whole frames in 30.4 ms, and less than a subframe of others
  cell.cfo_hz = random.uniform(-8e3, 8e3);
  cell.clock_error_ppm = random.uniform(-10.0, 10.0);
  const auto iq = capture(cell, kind.rate_hz, 30.4e-3, 15.0, 2);
  ToaEstimator estimator(kind.rate_hz);
  TimeOfArrival toa;
  ASSERT_EQ(estimator.estimate(iq, roughly(cell), toa), ToaStatus::kOk);
  expect_truth(toa, cell, 3);
  EXPECT_NEAR(toa.cfo_hz, cell.cfo_hz, 1.0);
  EXPECT_NEAR(toa.clock_error_ppm, cell.clock_error_ppm, 0.5);
  EXPECT_NEAR(toa.snr_db, 15.0, 0.6);
  EXPECT_NEAR(10.0 * std::log10(toa.noise_variance), -15.0, 0.6);
  ASSERT_EQ(toa.paths.size(), 1U);
  EXPECT_EQ(toa.paths[0].delay_s, 0.0);
  EXPECT_EQ(toa.paths[0].power_db, 0.0);
}

constexpr CyclicPrefix kNormal = CyclicPrefix::kNormal, kExtended = CyclicPrefix::kExtended;

INSTANTIATE_TEST_SUITE_P(
    All, ToaKinds,
    ::testing::Values(Kind{1.92e6, 6, 1, kNormal, Duplex::kFdd}, Kind{1.92e6, 6, 4, kExtended, Duplex::kFdd},
                      Kind{3.84e6, 15, 2, kNormal, Duplex::kTdd, 0}, Kind{7.68e6, 25, 4, kNormal, Duplex::kTdd, 1},
                      Kind{7.68e6, 25, 2, kExtended, Duplex::kTdd, 2}, Kind{15.36e6, 50, 2, kNormal, Duplex::kFdd},
                      Kind{11.52e6, 50, 1, kNormal, Duplex::kTdd, 3}, Kind{15.36e6, 75, 2, kExtended, Duplex::kFdd},
                      Kind{19.2e6, 100, 2, kNormal, Duplex::kFdd}, Kind{30.72e6, 100, 4, kNormal, Duplex::kTdd, 5},
                      Kind{23.04e6, 100, 1, kNormal, Duplex::kTdd, 6},
                      // Resampled, and bands cut by the rate.
                      Kind{2.4e6, 6, 2, kNormal, Duplex::kFdd}, Kind{20e6, 100, 2, kNormal, Duplex::kFdd},
                      Kind{2.048e6, 6, 2, kNormal, Duplex::kTdd, 4}, Kind{1.92e6, 50, 2, kNormal, Duplex::kFdd}));

TEST(Toa, TheIncompleteFrameBeforeTheFirstCountsToo) {
  // Two thirds of a frame come before the first whole one.
  RandomStream random(3);
  CellParameters cell = random_cell(random, 25);
  cell.delay_s = 6.7e-3;
  ToaEstimator estimator(7.68e6);
  TimeOfArrival toa;
  ASSERT_EQ(estimator.estimate(capture(cell, 7.68e6, 26.8e-3, 15.0, 4), roughly(cell), toa), ToaStatus::kOk);
  expect_truth(toa, cell, 3);
  EXPECT_EQ(toa.frame_index.front(), -1);
}

TEST(Toa, NextToTheWrapTheFramesStayTogether) {
  RandomStream random(5);
  ToaEstimator estimator(7.68e6);
  for (const double delay_s : {0.0, 0.3e-9, 15e-9, 0.4e-6, kFrameS - 0.4e-6, kFrameS - 15e-9, kFrameS - 0.3e-9}) {
    for (const double ppm : {-20.0, 0.0, 20.0}) {
      SCOPED_TRACE(delay_s);
      CellParameters cell = random_cell(random, 25);
      cell.delay_s = delay_s;
      cell.clock_error_ppm = ppm;
      const auto iq = capture(cell, 7.68e6, 32e-3, 10.0, random.next_u64());
      TimeOfArrival toa;
      ASSERT_EQ(estimator.estimate(iq, truth(cell), toa), ToaStatus::kOk);
      ASSERT_GE(toa.toa_s.size(), 3U);
      expect_truth(toa, cell, toa.toa_s.size());
    }
  }
}

TEST(Toa, ClockErrorAndCarrierOffsetApart) {
  // Frames of a fast clock come early; the carrier does not tell.
  RandomStream random(6);
  ToaEstimator estimator(7.68e6);
  for (const double ppm : {-20.0, 0.0, 20.0}) {
    for (const double cfo_hz : {-2.5e3, 0.0, 40e3}) {
      CellParameters cell = random_cell(random, 25);
      cell.delay_s = 2e-3;
      cell.cfo_hz = cfo_hz;
      cell.clock_error_ppm = ppm;
      TimeOfArrival toa;
      ASSERT_EQ(estimator.estimate(capture(cell, 7.68e6, 62.5e-3, 15.0, 7), roughly(cell), toa), ToaStatus::kOk);
      expect_truth(toa, cell, 6);
      EXPECT_NEAR(toa.clock_error_ppm, ppm, 0.05);  // a frame's delay is known to 0.3 ns, six of them to 0.008 ppm
      EXPECT_NEAR(toa.cfo_hz, cfo_hz, 0.2);
      EXPECT_LT((toa.toa_s.back() - toa.toa_s.front()) * ppm, 0.0 + (ppm == 0.0 ? 1e-30 : 0.0));
    }
  }
}

TEST(Toa, FirstPathWeakerThanTheSecond) {
  // Slope timing is off by 37 m and the strongest path by 36 m on these paths.
  constexpr double kRateHz = 30.72e6;
  RandomStream random(8);
  ToaEstimator estimator(kRateHz);
  for (int trial = 0; trial < 3; ++trial) {
    CellParameters cell = random_cell(random, 100);
    cell.delay_s = random.uniform(0.0, 5e-3);
    cell.taps = {{0.0, 0.6}, {3.7 / kRateHz, std::polar(1.0, 1.1)}, {9.2 / kRateHz, std::polar(0.5, -2.0)}};
    TimeOfArrival toa;
    ASSERT_EQ(estimator.estimate(capture(cell, kRateHz, 25e-3, 20.0, random.next_u64()), truth(cell), toa),
              ToaStatus::kOk);
    expect_truth(toa, cell, toa.toa_s.size());
    for (const double t : toa.toa_s) EXPECT_LT(std::abs(wrapped_s(t - cell.delay_s)) * kSpeedOfLightMps, 0.1);
    ASSERT_EQ(toa.paths.size(), 3U);
    EXPECT_EQ(toa.paths[0].delay_s, 0.0);
    EXPECT_NEAR(toa.paths[1].delay_s * kRateHz, 3.7, 0.02);
    EXPECT_NEAR(toa.paths[2].delay_s * kRateHz, 9.2, 0.02);
    EXPECT_NEAR(toa.paths[0].power_db, 20.0 * std::log10(0.6), 0.1);
    EXPECT_NEAR(toa.paths[1].power_db, 0.0, 0.1);
    EXPECT_NEAR(toa.paths[2].power_db, 20.0 * std::log10(0.5), 0.1);
    // The impulse response has its largest value at the second path.
    ASSERT_FALSE(toa.impulse_response.empty());
    const auto top = std::max_element(toa.impulse_response.begin(), toa.impulse_response.end());
    const double at_s = toa.impulse_response_start_s +
                        toa.impulse_response_step_s * static_cast<double>(top - toa.impulse_response.begin());
    EXPECT_NEAR(at_s * kRateHz, 3.7, 0.5);
    EXPECT_NEAR(*top, 1.0, 0.15);
  }
}

TEST(Toa, DelayOfTheCaptureIsAddedWhole) {
  // Law: cut k samples off and every time is k samples earlier, modulo a frame.
  RandomStream random(9);
  CellParameters cell = random_cell(random, 25);
  cell.delay_s = 3.1e-3;
  const auto iq = capture(cell, 7.68e6, 45e-3, 20.0, 10);
  ToaEstimator estimator(7.68e6);
  TimeOfArrival whole, cut;
  ASSERT_EQ(estimator.estimate(iq, truth(cell), whole), ToaStatus::kOk);
  for (const std::size_t k : {1U, 999U, 40001U}) {
    Detection d = truth(cell);
    const double by_s = static_cast<double>(k) / 7.68e6;
    d.frame_start_s = std::fmod(d.frame_start_s - by_s + kFrameS, kFrameS);
    ASSERT_EQ(estimator.estimate(std::span(iq).subspan(k), d, cut), ToaStatus::kOk);
    for (std::size_t i = 0; i < cut.toa_s.size(); ++i) {
      EXPECT_LT(std::abs(wrapped_s(cut.toa_s[i] + by_s - whole.toa_s[0])), 8.0 * cut.sigma_s[i]) << k;
    }
  }
}

// What the estimator refuses.

std::string refusal_of_rate(double rate_hz) {
  try {
    const ToaEstimator estimator(rate_hz);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "accepted";
}

TEST(ToaBadInput, RatesOutOfRangeAreNamed) {
  for (const double rate_hz : {0.0, -1.92e6, 1.39e6, 100.1e6, kNan, std::numeric_limits<double>::infinity()}) {
    EXPECT_THAT(refusal_of_rate(rate_hz), HasSubstr("sample_rate_hz")) << rate_hz;
    EXPECT_THAT(refusal_of_rate(rate_hz), HasSubstr("1.4e6 ... 100e6")) << rate_hz;
  }
  EXPECT_THAT(refusal_of_rate(1.39e6), HasSubstr("1390000"));
  EXPECT_EQ(refusal_of_rate(1.4e6), "accepted");
  EXPECT_EQ(refusal_of_rate(100e6), "accepted");
}

TEST(ToaBadInput, CellsThatCannotBe) {
  CellParameters cell;
  cell.cell_id = 5;
  const auto iq = capture(cell, 1.92e6, 20e-3, 20.0, 1);
  std::array<Detection, 5> bad;
  bad.fill(truth(cell));
  bad[0].cell_id = 504;
  bad[1].n_ports = 3;
  bad[2].n_rb = 7;
  bad[3].cfo_hz = kNan;
  bad[4].clock_error_ppm = kNan;
  ToaEstimator estimator(1.92e6);
  TimeOfArrival toa;
  for (const Detection& d : bad) {
    EXPECT_EQ(estimator.estimate(iq, d, toa), ToaStatus::kBadCell);
    EXPECT_TRUE(toa.toa_s.empty());
    EXPECT_THROW(SubframeToaEstimator(1.92e6, d), std::invalid_argument);
  }
}

TEST(ToaBadInput, TooShort) {
  RandomStream random(11);
  CellParameters cell = random_cell(random);
  cell.delay_s = 5e-3;
  for (const double rate_hz : {1.92e6, 2.4e6}) {
    ToaEstimator estimator(rate_hz);
    TimeOfArrival toa;
    EXPECT_EQ(estimator.estimate({}, truth(cell), toa), ToaStatus::kTooShort);
    EXPECT_EQ(estimator.estimate(noise(1, 1.0, 1), truth(cell), toa), ToaStatus::kTooShort);
    EXPECT_EQ(estimator.estimate(noise(150, 1.0, 1), truth(cell), toa), ToaStatus::kTooShort);
    EXPECT_TRUE(toa.toa_s.empty());
  }
}

TEST(ToaBadInput, NonFinite) {
  RandomStream random(12);
  const CellParameters cell = random_cell(random);
  const auto good = capture(cell, kBaseRateHz, 25e-3, 15.0, 13);
  ToaEstimator estimator(kBaseRateHz);
  TimeOfArrival toa;
  for (const std::size_t at : {std::size_t{0}, good.size() / 2, good.size() - 1}) {
    for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
      auto iq = good;
      iq[at] = {0.0F, bad};
      EXPECT_EQ(estimator.estimate(iq, truth(cell), toa), ToaStatus::kNonFinite);
      EXPECT_TRUE(toa.toa_s.empty());
    }
  }
  EXPECT_EQ(estimator.estimate(good, truth(cell), toa), ToaStatus::kOk);
}

TEST(ToaBadInput, LostWhereTheCellIsNot) {
  RandomStream random(14);
  CellParameters cell = random_cell(random);
  cell.cell_id = 100;
  cell.delay_s = 1e-3;
  const auto iq = capture(cell, kBaseRateHz, 45e-3, 15.0, 15);
  ToaEstimator estimator(kBaseRateHz);
  TimeOfArrival toa;
  Detection other = truth(cell);
  other.cell_id = 203;
  EXPECT_EQ(estimator.estimate(iq, other, toa), ToaStatus::kLost);
  Detection elsewhere = truth(cell);
  elsewhere.frame_start_s += 4e-3;
  EXPECT_EQ(estimator.estimate(iq, elsewhere, toa), ToaStatus::kLost);
  EXPECT_EQ(estimator.estimate(noise(iq.size(), 1.0, 16), truth(cell), toa), ToaStatus::kLost);
  EXPECT_EQ(estimator.estimate(std::vector<Cf32>(iq.size()), truth(cell), toa), ToaStatus::kLost);
  EXPECT_EQ(estimator.estimate(std::vector<Cf32>(iq.size(), Cf32(1.0F, 1.0F)), truth(cell), toa), ToaStatus::kLost);
  EXPECT_TRUE(toa.toa_s.empty());
}

TEST(ToaBadInput, LostAtTheWrongRate) {
  RandomStream random(17);
  CellParameters cell = random_cell(random, 100);
  cell.delay_s = 1e-3;
  const auto iq = capture(cell, 19.2e6, 45e-3, 20.0, 18);
  for (const double declared_hz : {15.36e6, 20e6, 30.72e6}) {
    ToaEstimator estimator(declared_hz);
    TimeOfArrival toa;
    EXPECT_EQ(estimator.estimate(iq, truth(cell), toa), ToaStatus::kLost) << declared_hz;
  }
}

// One subframe at a time.

TEST(SubframeToa, EverySubframe) {
  constexpr double kRateHz = 15.36e6;
  RandomStream random(19);
  for (const CyclicPrefix cp : {kNormal, kExtended}) {
    CellParameters cell = random_cell(random, 50, 2);
    cell.cp = cp;
    cell.delay_s = 50.37e-6;
    const auto iq = capture(cell, kRateHz, 10.2e-3, 15.0, 20);
    SubframeToaEstimator estimator(kRateHz, truth(cell));
    for (int subframe = 0; subframe < 10; ++subframe) {
      const double start_s = 50e-6 + subframe * 1e-3;
      const auto toa = estimator.estimate(iq, subframe, start_s, 0.0);
      ASSERT_TRUE(toa) << subframe;
      EXPECT_LT(std::abs(toa->toa_s - cell.delay_s - subframe * 1e-3), 6.0 * toa->sigma_s) << subframe;
      EXPECT_NEAR(toa->snr_db, 15.0, 1.0);
      EXPECT_NEAR(10.0 * std::log10(toa->noise_variance), -15.0, 1.0);
      // Nothing of this cell is known to the estimator at another place of the frame.
      const auto wrong = estimator.estimate(iq, (subframe + 1) % 10, start_s, 0.0);
      if (wrong) {
        EXPECT_LT(wrong->snr_db, 0.0);
      }
    }
  }
}

TEST(SubframeToa, ResidualCarrierOffset) {
  constexpr double kRateHz = 7.68e6;
  RandomStream random(21);
  for (const double cfo_hz : {-900.0, -200.0, 0.0, 35.0, 900.0}) {
    for (const double given_hz : {0.0, 5e3}) {
      for (const CyclicPrefix cp : {kNormal, kExtended}) {
        CellParameters cell = random_cell(random, 25, 2);
        cell.cp = cp;
        cell.delay_s = 20.2e-6;
        cell.cfo_hz = given_hz + cfo_hz;
        SubframeToaEstimator estimator(kRateHz, truth(cell));
        const auto toa = estimator.estimate(capture(cell, kRateHz, 1.1e-3, 30.0, 22), 0, 20e-6, given_hz);
        ASSERT_TRUE(toa);
        EXPECT_NEAR(toa->residual_cfo_hz, cfo_hz, 4.0);
        EXPECT_LT(std::abs(toa->toa_s - cell.delay_s), 6.0 * toa->sigma_s + 1e-10);
      }
    }
  }
}

TEST(SubframeToa, WithoutNoiseItIsExact) {
  // Limits: single precision of samples and phasors; 3e-11 s is a centimetre.
  constexpr double kRateHz = 30.72e6;
  RandomStream random(23);
  for (int trial = 0; trial < 10; ++trial) {
    CellParameters cell = random_cell(random, 100, 1 << (trial % 3));
    cell.delay_s = 20e-6 + random.uniform(-1e-6, 1e-6);
    const auto iq = synthesize({&cell, 1}, kRateHz, 33792);
    SubframeToaEstimator estimator(kRateHz, truth(cell));
    const auto toa = estimator.estimate(iq, 0, 20e-6, 0.0);
    ASSERT_TRUE(toa);
    EXPECT_NEAR(toa->toa_s, cell.delay_s, 3e-12);
    EXPECT_GT(toa->snr_db, 60.0);
  }
}

TEST(SubframeToaBadInput, GivesNothing) {
  constexpr double kRateHz = 1.92e6;
  RandomStream random(24);
  CellParameters cell = random_cell(random);
  cell.delay_s = 20e-6;
  auto iq = capture(cell, kRateHz, 1.1e-3, 20.0, 25);
  SubframeToaEstimator estimator(kRateHz, truth(cell));
  ASSERT_TRUE(estimator.estimate(iq, 0, 20e-6, 0.0));
  EXPECT_FALSE(estimator.estimate({}, 0, 20e-6, 0.0));
  EXPECT_FALSE(estimator.estimate(std::span(iq).first(1), 0, 20e-6, 0.0));
  EXPECT_FALSE(estimator.estimate(std::span(iq).first(700), 0, 20e-6, 0.0));  // ends in the first slot
  EXPECT_FALSE(estimator.estimate(std::vector<Cf32>(iq.size()), 0, 20e-6, 0.0));
  EXPECT_FALSE(estimator.estimate(iq, -1, 20e-6, 0.0));
  EXPECT_FALSE(estimator.estimate(iq, 10, 20e-6, 0.0));
  EXPECT_FALSE(estimator.estimate(iq, 0, kNan, 0.0));
  EXPECT_FALSE(estimator.estimate(iq, 0, 20e-6, kNan));
  EXPECT_FALSE(estimator.estimate(iq, 0, -1e-3, 0.0));
  EXPECT_FALSE(estimator.estimate(iq, 0, 2e-3, 0.0));
  EXPECT_FALSE(estimator.estimate(iq, 0, 1e300, 0.0));
  iq[60] = {std::numeric_limits<float>::quiet_NaN(), 0.0F};
  EXPECT_FALSE(estimator.estimate(iq, 0, 20e-6, 0.0));
}

TEST(SubframeToaBadInput, SubframesWithoutReferenceSignals) {
  constexpr double kRateHz = 7.68e6;
  RandomStream random(26);
  CellParameters cell = random_cell(random, 25);
  cell.duplex = Duplex::kTdd;
  cell.tdd_configuration = 0;
  cell.delay_s = 20.1e-6;
  const auto iq = capture(cell, kRateHz, 10.1e-3, 20.0, 27);
  SubframeToaEstimator estimator(kRateHz, truth(cell));
  for (int subframe = 0; subframe < 10; ++subframe) {
    const auto toa = estimator.estimate(iq, subframe, 20e-6 + subframe * 1e-3, 0.0);
    EXPECT_EQ(toa.has_value(), subframe == 0 || subframe == 5) << subframe;
    if (toa) {
      EXPECT_LT(std::abs(toa->toa_s - cell.delay_s - subframe * 1e-3), 6.0 * toa->sigma_s);
    }
  }
}

TEST(SubframeToaBadInput, RatesAreNamed) {
  const auto refusal = [](double rate_hz) -> std::string {
    try {
      const SubframeToaEstimator estimator(rate_hz, {});
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "accepted";
  };
  for (const double rate_hz : {0.0, -1.92e6, 1e6, 2.4e6, 20e6, 1.93e6, 101e6, kNan}) {
    EXPECT_THAT(refusal(rate_hz), HasSubstr("sample_rate_hz")) << rate_hz;
  }
  EXPECT_THAT(refusal(2.4e6), HasSubstr("a multiple of 1.92e6"));
  for (const double rate_hz : {1.92e6, 3.84e6, 5.76e6, 19.2e6, 30.72e6}) EXPECT_EQ(refusal(rate_hz), "accepted");
}

}  // namespace
}  // namespace soopnav::lte
