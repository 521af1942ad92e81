#include "soopnav/dsp/peak.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>

#include "dsp/signals.hpp"

namespace soopnav::dsp {
namespace {

constexpr double kPi = std::numbers::pi;

double sinc(double t) { return t == 0.0 ? 1.0 : std::sin(kPi * t) / (kPi * t); }

// The correlation peak of a signal that fills the fraction `band` of the rate, at sample 1000 + offset.
std::vector<Cf32> sinc_peak(double band, double offset) {
  std::vector<Cf32> r(2001);
  for (std::size_t n = 0; n < r.size(); ++n) {
    r[n] = Cf32(std::polar(3.0, 0.7) * sinc(band * (static_cast<double>(n) - 1000.0 - offset)));
  }
  return r;
}

TEST(ParabolicPeak, IsExactOnItsOwnScale) {
  for (const double offset : {-0.49, -0.2, 0.0, 0.31, 0.5}) {
    const auto parabola = [&](double t) { return 4.0 - 1.3 * (t - offset) * (t - offset); };
    const auto gauss = [&](double t) { return 4.0 * std::exp(-0.8 * (t - offset) * (t - offset)); };
    const auto magnitude = parabolic_peak(parabola(-1), parabola(0), parabola(1));
    const auto power =
        parabolic_peak(std::sqrt(parabola(-1)), std::sqrt(parabola(0)), std::sqrt(parabola(1)), PeakScale::kPower);
    const auto log = parabolic_peak(gauss(-1), gauss(0), gauss(1), PeakScale::kLog);
    ASSERT_TRUE(magnitude && power && log);
    EXPECT_NEAR(magnitude->offset_samples, offset, 1e-12);
    EXPECT_NEAR(power->offset_samples, offset, 1e-12);
    EXPECT_NEAR(log->offset_samples, offset, 1e-12);
    EXPECT_NEAR(magnitude->magnitude, 4.0, 1e-12);
    EXPECT_NEAR(power->magnitude, 2.0, 1e-12);
    EXPECT_NEAR(log->magnitude, 4.0, 1e-12);
  }
}

// The table of the header's comment.
TEST(ParabolicPeak, HasTheBiasItsCommentStates) {
  struct Row {
    double band;
    PeakScale scale;
    double bias;
    double sign;  // of the error at a positive offset
  };
  for (const Row& row : {Row{0.25, PeakScale::kMagnitude, 0.0060, -1.0}, Row{0.25, PeakScale::kPower, 0.0162, -1.0},
                         Row{0.25, PeakScale::kLog, 0.0042, 1.0}, Row{0.5, PeakScale::kMagnitude, 0.0251, -1.0},
                         Row{0.5, PeakScale::kPower, 0.0692, -1.0}, Row{0.5, PeakScale::kLog, 0.0208, 1.0},
                         Row{0.9, PeakScale::kMagnitude, 0.1696, -1.0}, Row{0.9, PeakScale::kPower, 0.2398, -1.0}}) {
    double worst = 0.0;
    for (int i = 0; i <= 500; ++i) {
      const double offset = 0.001 * i;
      const auto peak = parabolic_peak(std::abs(sinc(row.band * (-1.0 - offset))), sinc(row.band * offset),
                                       std::abs(sinc(row.band * (1.0 - offset))), row.scale);
      ASSERT_TRUE(peak);
      const double error = peak->offset_samples - offset;
      EXPECT_GE(error * row.sign, -1e-9);
      worst = std::max(worst, std::abs(error));
      if (i == 0 || i == 500) {
        EXPECT_NEAR(error, 0.0, 1e-9);
      }
    }
    EXPECT_NEAR(worst, row.bias, 0.0001) << "band " << row.band;
  }
}

TEST(ParabolicPeak, IsEmptyWithoutAPeak) {
  const double nan = std::nan(""), infinity = HUGE_VAL;
  for (const PeakScale scale : {PeakScale::kMagnitude, PeakScale::kPower, PeakScale::kLog}) {
    EXPECT_FALSE(parabolic_peak(1.0, 0.9, 0.5, scale));
    EXPECT_FALSE(parabolic_peak(0.5, 0.9, 1.0, scale));
    EXPECT_FALSE(parabolic_peak(1.0, 1.0, 1.0, scale));
    EXPECT_FALSE(parabolic_peak(0.0, 0.0, 0.0, scale));
    EXPECT_FALSE(parabolic_peak(-0.1, 1.0, 0.5, scale));
    EXPECT_FALSE(parabolic_peak(nan, 1.0, 0.5, scale));
    EXPECT_FALSE(parabolic_peak(0.5, nan, 0.5, scale));
    EXPECT_FALSE(parabolic_peak(0.5, 1.0, nan, scale));
    EXPECT_FALSE(parabolic_peak(0.5, infinity, 0.5, scale));
  }
  EXPECT_FALSE(parabolic_peak(0.0, 1.0, 0.5, PeakScale::kLog));
  EXPECT_TRUE(parabolic_peak(0.0, 1.0, 0.5, PeakScale::kPower));
  const auto tie = parabolic_peak(0.2, 1.0, 1.0);
  ASSERT_TRUE(tie);
  EXPECT_DOUBLE_EQ(tie->offset_samples, 0.5);
  EXPECT_TRUE(parabolic_peak(1e200, 2e200, 1e200, PeakScale::kPower)) << "the square overflowed";
}

TEST(ParabolicPeak, ReadsACorrelation) {
  const std::vector<Cf32> r = {{0.0F, 3.0F}, {0.0F, 0.0F}, {0.0F, 0.0F}, {2.0F, 0.0F}};
  const auto edge = parabolic_peak(r, 0, PeakScale::kMagnitude);
  ASSERT_TRUE(edge);
  EXPECT_NEAR(edge->offset_samples, 0.0, 1e-12);
  const auto wrapped = parabolic_peak(r, 0, PeakScale::kMagnitude, PeakBoundary::kCircular);
  ASSERT_TRUE(wrapped);
  EXPECT_NEAR(wrapped->offset_samples, -0.25, 1e-12);
  EXPECT_FALSE(parabolic_peak(r, 4));
  EXPECT_FALSE(parabolic_peak({}, 0));
}

class RefinedPeaks : public ::testing::TestWithParam<double> {};

TEST_P(RefinedPeaks, HaveNoBias) {
  const double band = GetParam();
  const PeakRefiner refiner;
  for (int i = -10; i <= 10; ++i) {
    const double offset = 0.05 * i;
    const auto peak = refiner.refine(sinc_peak(band, offset), 1000);
    ASSERT_TRUE(peak) << offset;
    EXPECT_NEAR(peak->offset_samples, offset, 1e-4) << "band " << band;
    EXPECT_NEAR(peak->magnitude, 3.0, 1e-4);
  }
}
INSTANTIATE_TEST_SUITE_P(Bands, RefinedPeaks, ::testing::Values(0.2, 0.484375, 0.6, 0.8));

TEST(PeakRefiner, FinerDesignsErrLess) {
  const auto bias = [](double attenuation_db) {
    const PeakRefiner refiner({0.8, attenuation_db});
    double worst = 0.0;
    for (int i = 0; i <= 10; ++i) {
      const auto peak = refiner.refine(sinc_peak(0.3, 0.05 * i), 1000);
      worst = std::max(worst, peak ? std::abs(peak->offset_samples - 0.05 * i) : 1.0);
    }
    return worst;
  };
  EXPECT_GT(bias(40.0), 3.0 * bias(60.0));
  EXPECT_GT(bias(60.0), 3.0 * bias(80.0));
  EXPECT_LT(bias(100.0), 1e-5);
}

TEST(PeakRefiner, WrapsACircularCorrelation) {
  // A flat spectrum of 31 of 64 bins, delayed by 0.3 samples before the start.
  std::vector<Cf32> r(64);
  for (std::size_t n = 0; n < 64; ++n) {
    testing::Cf64 sum{};
    for (int k = -15; k <= 15; ++k)
      sum += std::polar(1.0 / 31.0, 2.0 * kPi * k * (static_cast<double>(n) + 0.3) / 64.0);
    r[n] = Cf32(sum);
  }
  const PeakRefiner refiner;
  const auto peak = refiner.refine(r, 0, PeakBoundary::kCircular);
  ASSERT_TRUE(peak);
  EXPECT_NEAR(peak->offset_samples, -0.3, 1e-4);
  EXPECT_NEAR(peak->magnitude, 1.0, 1e-4);
}

TEST(PeakRefiner, IsEmptyWithoutAPeak) {
  const PeakRefiner refiner;
  const std::vector<Cf32> zeros(100), ones(100, Cf32(1.0F, 0.0F));
  EXPECT_FALSE(refiner.refine(zeros, 50));
  EXPECT_FALSE(refiner.refine(ones, 50));
  EXPECT_FALSE(refiner.refine({}, 0));
  EXPECT_FALSE(refiner.refine(ones, 100));
  auto bad = sinc_peak(0.5, 0.2);
  EXPECT_TRUE(refiner.refine(bad, 1000));
  bad[1003] = {std::numeric_limits<float>::quiet_NaN(), 0.0F};
  EXPECT_FALSE(refiner.refine(bad, 1000)) << "a NaN inside its reach";
  EXPECT_GT(refiner.reach(), 3U);
  EXPECT_THROW(PeakRefiner(SincDesign{1.5, 80.0}), std::invalid_argument);
}

TEST(LargestSample, SkipsWhatIsNoNumber) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_FALSE(largest_sample({}));
  EXPECT_FALSE(largest_sample(std::vector<Cf32>{{nan, 0.0F}}));
  EXPECT_EQ(largest_sample(std::vector<Cf32>{{0.0F, 0.0F}}), 0U);
  EXPECT_EQ(largest_sample(std::vector<Cf32>{{1.0F, 0.0F}, {nan, 9.0F}, {0.0F, -2.0F}, {2.0F, 0.0F}}), 2U);
}

}  // namespace
}  // namespace soopnav::dsp
