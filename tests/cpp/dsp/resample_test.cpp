#include "soopnav/dsp/resample.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <ostream>
#include <stdexcept>

#include "dsp/signals.hpp"

namespace soopnav::dsp {
namespace {

using testing::Cf64;
using testing::db;
using testing::noise;
using testing::Tones;

constexpr double kPi = std::numbers::pi;

struct Rates {
  double in_hz, out_hz;
  bool rational;
  ResampleDesign design{};
  double start = 0.0;
};

std::ostream& operator<<(std::ostream& stream, const Rates& rates) {
  return stream << rates.in_hz << "_to_" << rates.out_hz << "_" << rates.design.attenuation_db << "dB_from_"
                << rates.start;
}

class ResampleRates : public ::testing::TestWithParam<Rates> {
 protected:
  Resampler resampler_ = Resampler::between(GetParam().in_hz, GetParam().out_hz, GetParam().design, GetParam().start);
  // Samples beyond a start inside the capture.
  std::size_t capture(std::size_t size) const {
    return size + static_cast<std::size_t>(std::max(0.0, GetParam().start));
  }
  double lower_ = std::min(1.0, GetParam().out_hz / GetParam().in_hz);  // the lower rate, in input rates
};

class DecimatingRates : public ResampleRates {};

TEST_P(ResampleRates, OutputsAreTheSignalAtTheirTimes) {
  const Rates& rates = GetParam();
  EXPECT_EQ(resampler_.is_rational(), rates.rational);
  EXPECT_EQ(resampler_.start_samples(), rates.start);
  EXPECT_NEAR(resampler_.step_samples(), rates.in_hz / rates.out_hz, 1e-15 * resampler_.step_samples());
  const Tones signal(9, rates.design.passband * lower_ * kPi, 4);
  const std::size_t n_in = capture(6 * resampler_.tap_count());
  const auto x = signal.sample(n_in);
  std::vector<Cf32> y(resampler_.output_size(n_in));
  resampler_.apply(x, 0, y);
  double worst = 0.0;
  const double reach = static_cast<double>(resampler_.tap_count());
  for (std::size_t m = 0; m < y.size(); ++m) {
    const double t = rates.start + static_cast<double>(m) * rates.in_hz / rates.out_hz;
    if (t < reach || t > static_cast<double>(n_in) - reach) continue;
    worst = std::max(worst, std::abs(Cf64(y[m]) - signal(t)));
  }
  EXPECT_GT(worst, 0.0) << "nothing compared";
  EXPECT_LE(db(worst), -rates.design.attenuation_db);
}

TEST_P(DecimatingRates, NothingOfTheStopbandIsLeft) {
  const Rates& rates = GetParam();
  const double edge = rates.design.stopband * lower_;
  ASSERT_LT(edge, 1.0);
  const std::size_t n_in = 4 * resampler_.tap_count();
  double worst = 0.0;
  for (const double frequency : {edge, -edge, 0.5 * (edge + 1.0), 1.0}) {
    std::vector<Cf32> x(n_in);
    for (std::size_t n = 0; n < n_in; ++n) {
      x[n] = Cf32(std::polar(1.0, std::remainder(kPi * frequency * static_cast<double>(n), 2.0 * kPi)));
    }
    const auto first =
        static_cast<std::int64_t>(1.5 * static_cast<double>(resampler_.tap_count()) / resampler_.step_samples());
    std::vector<Cf32> y(static_cast<std::size_t>(first) / 2 + 1);
    resampler_.apply(x, first, y);
    for (const Cf32& v : y) worst = std::max(worst, std::abs(Cf64(v)));
  }
  EXPECT_LE(db(worst), -rates.design.attenuation_db);
}

TEST_P(ResampleRates, StreamGivesTheSameBitsForAnyCut) {
  const std::size_t n_in = capture(3 * resampler_.tap_count() + 3000);
  const auto x = noise(n_in, 1);
  std::vector<Cf32> whole(resampler_.output_size(n_in));
  resampler_.apply(x, 0, whole);
  for (const std::size_t cut : {std::size_t{13}, std::size_t{1000}, n_in}) {
    std::vector<Cf32> y, out;
    for (std::size_t at = 0; at < n_in; at += cut) {
      const auto block = std::span(x).subspan(at, std::min(cut, n_in - at));
      out.resize(resampler_.push_size(block.size()));
      ASSERT_EQ(resampler_.push(block, out), out.size());
      y.insert(y.end(), out.begin(), out.end());
    }
    out.resize(resampler_.flush_size());
    ASSERT_EQ(resampler_.flush(out), out.size());
    y.insert(y.end(), out.begin(), out.end());
    ASSERT_EQ(y, whole) << "cut " << cut;
    EXPECT_EQ(resampler_.flush_size(), 0U);
  }
}

TEST_P(ResampleRates, AnyRangeGivesTheSameBits) {
  const std::size_t n_in = capture(3 * resampler_.tap_count());
  const auto x = noise(n_in, 2);
  const auto n_out = resampler_.output_size(n_in);
  std::vector<Cf32> whole(n_out + 40), part(17);
  resampler_.apply(x, -20, whole);
  for (const std::int64_t first : {std::int64_t{-20}, std::int64_t{-3}, std::int64_t{0}, std::int64_t{11},
                                   static_cast<std::int64_t>(n_out) - 5, static_cast<std::int64_t>(n_out) + 3}) {
    resampler_.apply(x, first, part);
    for (std::size_t i = 0; i < part.size(); ++i) {
      EXPECT_EQ(part[i], whole[static_cast<std::size_t>(first + 20) + i]) << first << " " << i;
    }
  }
}

TEST_P(ResampleRates, OutputSizeCountsTheTimesInsideTheCapture) {
  const Rates& rates = GetParam();
  const double step = rates.in_hz / rates.out_hz;
  for (const std::size_t n_in : {std::size_t{0}, std::size_t{1}, std::size_t{2}, std::size_t{99}, std::size_t{12345}}) {
    const std::size_t count = resampler_.output_size(n_in);
    const auto time = [&](std::size_t m) { return rates.start + static_cast<double>(m) * step; };
    if (count > 0) {
      EXPECT_LT(time(count - 1), static_cast<double>(n_in));
    }
    EXPECT_GE(time(count) + 1e-9, static_cast<double>(n_in));
  }
}

INSTANTIATE_TEST_SUITE_P(
    Rates, ResampleRates,
    ::testing::Values(Rates{30.72e6, 1.92e6, true}, Rates{19.2e6, 1.92e6, true}, Rates{23.04e6, 1.92e6, true},
                      Rates{1.4e6, 1.92e6, true}, Rates{2.4e6, 1.92e6, true}, Rates{1.92e6, 1.92e6, true},
                      Rates{1.92e6, 7.68e6, true}, Rates{1.92e6, 1.92e6 * (1.0 + 7.86e-6), false},
                      Rates{100e6, 1.92e6, true}, Rates{61.44e6, 1.9200123e6, false}, Rates{1.4e6, 1.9200123e6, false},
                      Rates{2.048e6, 1.92e6, true, {0.6, 0.9, 60.0}}, Rates{5.0e6, 1.92e6, true, {0.9, 1.1, 100.0}},
                      Rates{3.0e6, 1.9e6, true, {}, 0.4321}, Rates{3.0e6, 1.9e6, true, {}, -1234.5678},
                      Rates{3.0e6, 1.9e6, true, {}, 7654.321}, Rates{3.0e6, 1.90001e6, false, {}, 0.4321},
                      Rates{3.0e6, 1.90001e6, false, {}, -777.7}, Rates{3.0e6, 1.90001e6, false, {}, 5555.5}));

INSTANTIATE_TEST_SUITE_P(Rates, DecimatingRates,
                         ::testing::Values(Rates{30.72e6, 1.92e6, true}, Rates{19.2e6, 1.92e6, true},
                                           Rates{23.04e6, 1.92e6, true}, Rates{2.4e6, 1.92e6, true},
                                           Rates{100e6, 1.92e6, true}, Rates{61.44e6, 1.9200123e6, false},
                                           Rates{2.048e6, 1.92e6, true, {0.6, 0.9, 60.0}},
                                           Rates{5.0e6, 1.92e6, true, {0.9, 1.1, 100.0}}));

TEST(Resampler, TheFirstOutputLiesOnTheFirstInput) {
  std::vector<Cf32> x(400);
  x[0] = {1.0F, 0.0F};
  for (auto resampler : {Resampler::rational(1, 4), Resampler::rational(3, 2), Resampler::arbitrary(3.99)}) {
    std::vector<Cf32> y(9);
    resampler.apply(x, -4, y);
    for (std::size_t i = 0; i < 4; ++i) EXPECT_LT(std::abs(y[i]), std::abs(y[4])) << "the impulse is not at time 0";
    for (std::size_t i = 1; i <= 4; ++i) {
      EXPECT_NEAR(std::abs(y[4 + i]), std::abs(y[4 - i]), 1e-5) << "the response is not even about time 0";
    }
  }
}

TEST(Resampler, ReducesTheFactor) {
  const auto resampler = Resampler::rational(48, 36);
  EXPECT_EQ(resampler.phase_count(), 4U);
  EXPECT_EQ(resampler.step_samples(), 0.75);
  EXPECT_TRUE(Resampler::rational(1 << 20, 1 << 21).is_rational());
}

TEST(Resampler, ShortAndEmptyCaptures) {
  auto resampler = Resampler::rational(1, 10);
  EXPECT_EQ(resampler.output_size(0), 0U);
  EXPECT_EQ(resampler.output_size(1), 1U);
  std::vector<Cf32> y(3, Cf32(4.0F, 4.0F));
  resampler.apply({}, 0, y);
  EXPECT_THAT(y, ::testing::Each(Cf32{}));
  EXPECT_EQ(resampler.push_size(0), 0U);
  EXPECT_EQ(resampler.push({}, {}), 0U);
  EXPECT_EQ(resampler.flush({}), 0U);
  const std::vector<Cf32> one = {Cf32(1.0F, 2.0F)};
  EXPECT_EQ(resample(one, 10.0, 1.0).size(), 1U);
  EXPECT_TRUE(resample({}, 10.0, 1.0).empty());
}

TEST(Resampler, RefusedBuffersLeaveTheStreamAlone) {
  auto resampler = Resampler::rational(2, 3);
  const auto x = noise(2000, 1);
  std::vector<Cf32> whole(resampler.output_size(2000)), y(whole.size());
  resampler.apply(x, 0, whole);
  std::size_t count = resampler.push(std::span(x).first(700), y);
  EXPECT_THROW(resampler.push(std::span(x).subspan(700), std::span(y).first(3)), std::invalid_argument);
  count += resampler.push(std::span(x).subspan(700), std::span(y).subspan(count));
  EXPECT_THROW(resampler.flush({}), std::invalid_argument);
  count += resampler.flush(std::span(y).subspan(count));
  EXPECT_EQ(count, y.size());
  EXPECT_EQ(y, whole);
}

// A clock error of 7.86 ppm over two million samples: time must not drift away from m * step.
TEST(Resampler, TimeDoesNotDrift) {
  const double step = 1.0 + 7.86e-6;
  auto resampler = Resampler::arbitrary(step);
  const double w = 0.5 * kPi;
  const std::size_t n_in = 200;
  const std::int64_t first = 2'000'000;
  const auto begin = static_cast<std::int64_t>(static_cast<double>(first) * step) - 100;
  // The same outputs from a capture that starts late: its start carries the fraction.
  auto shifted =
      Resampler::arbitrary(step, {}, std::fma(static_cast<double>(first), step, -static_cast<double>(begin)));
  std::vector<Cf32> x(n_in), y(20);
  for (std::size_t n = 0; n < n_in; ++n) x[n] = Cf32(std::polar(1.0, w * static_cast<double>(n)));
  shifted.apply(x, 0, y);
  std::vector<Cf32> z(20), late(static_cast<std::size_t>(begin) + n_in);
  std::copy(x.begin(), x.end(), late.begin() + begin);
  resampler.apply(late, first, z);
  EXPECT_LT(testing::largest_difference(y, z), 2e-7);
}

TEST(Resampler, NanReachesOnlyItsWindows) {
  auto x = noise(2000, 1);
  x[1000] = {std::numeric_limits<float>::quiet_NaN(), 0.0F};
  auto resampler = Resampler::rational(1, 2);
  std::vector<Cf32> y(1000);
  resampler.apply(x, 0, y);
  const std::size_t reach = resampler.tap_count() / 2 / 2 + 1;
  EXPECT_TRUE(std::isnan(y[500].real()));
  EXPECT_TRUE(std::isfinite(y[500 - reach].real()));
  EXPECT_TRUE(std::isfinite(y[500 + reach].real()));
}

TEST(Resampler, Refuses) {
  EXPECT_THROW((void)Resampler::rational(0, 1), std::invalid_argument);
  EXPECT_THROW((void)Resampler::rational(1, 0), std::invalid_argument);
  EXPECT_THROW((void)Resampler::rational(-2, 3), std::invalid_argument);
  EXPECT_THROW((void)Resampler::rational(1025, 1026), std::invalid_argument);
  EXPECT_THROW((void)Resampler::rational(1, 1025), std::invalid_argument);
  for (const double bad : {0.0, -1.0, 1e-4, 1025.0, std::nan(""), HUGE_VAL}) {
    EXPECT_THROW((void)Resampler::arbitrary(bad), std::invalid_argument) << bad;
  }
  for (const double bad : {0.0, -1.0, std::nan(""), HUGE_VAL}) {
    EXPECT_THROW((void)Resampler::between(bad, 1.0), std::invalid_argument) << bad;
    EXPECT_THROW((void)Resampler::between(1.0, bad), std::invalid_argument) << bad;
  }
  for (const ResampleDesign bad :
       {ResampleDesign{0.0, 1.2, 80.0}, ResampleDesign{1.0, 1.2, 80.0}, ResampleDesign{0.8, 0.8, 80.0},
        ResampleDesign{0.8, 1.21, 80.0}, ResampleDesign{0.8, 1.2, 10.0}, ResampleDesign{0.8, 1.2, 120.0},
        ResampleDesign{std::nan(""), 1.2, 80.0}, ResampleDesign{0.8, 1.2, std::nan("")},
        ResampleDesign{0.8, 0.800001, 80.0}}) {
    EXPECT_THROW((void)Resampler::rational(1, 2, bad), std::invalid_argument);
  }
  EXPECT_THROW((void)Resampler::rational(1, 2, {}, std::nan("")), std::invalid_argument);
  EXPECT_THROW((void)Resampler::arbitrary(2.0, {}, 1e16), std::invalid_argument);
}

TEST(Resampler, SaysWhatItRefuses) {
  try {
    (void)Resampler::between(1.92e6, -5.0);
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_THAT(error.what(), ::testing::AllOf(::testing::HasSubstr("out_rate_hz"), ::testing::HasSubstr("-5"),
                                               ::testing::HasSubstr("positive")));
  }
}

}  // namespace
}  // namespace soopnav::dsp
