#include "soopnav/simulation/channel.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>
#include <string>

#include "support/nan.hpp"

namespace soopnav::simulation {
namespace {

using testing::StartsWith;

using ::soopnav::test::kNan;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

template <class Call>
std::string refusal(Call&& call) {
  try {
    call();
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

TEST(ChannelPower, Decibels) {
  EXPECT_DOUBLE_EQ(power_ratio(10.0), 10.0);
  EXPECT_DOUBLE_EQ(power_ratio(-30.0), 1e-3);
  EXPECT_DOUBLE_EQ(decibels(100.0), 20.0);
  EXPECT_EQ(decibels(0.0), -kInfinity);
  EXPECT_DOUBLE_EQ(decibels(power_ratio(-7.25)), -7.25);
}

TEST(ChannelPower, MeanPower) {
  EXPECT_EQ(mean_power({}), 0.0);
  const std::vector<Cf32> samples{{3.0F, 4.0F}, {0.0F, 1.0F}};
  EXPECT_EQ(mean_power(samples), 13.0);
}

TEST(ChannelPower, NoiseVariances) {
  EXPECT_DOUBLE_EQ(noise_variance_for_snr(2.0, 10.0), 0.2);
  EXPECT_DOUBLE_EQ(noise_variance_for_snr(2.0, -10.0), 20.0);
  EXPECT_EQ(noise_variance_for_snr(0.0, 3.0), 0.0);
  EXPECT_DOUBLE_EQ(noise_variance_for_element_snr(20.0), 0.01);
  EXPECT_DOUBLE_EQ(noise_variance_for_element_snr(20.0, 4.0), 0.04);
  EXPECT_DOUBLE_EQ(noise_variance_for_element_snr(0.0, 128.0, 128.0), 1.0);
}

TEST(ChannelRefusals, NameTheParameterItsValueAndTheRule) {
  std::vector<Cf32> samples(4);
  RandomStream random(1);
  EXPECT_EQ(refusal([&] { add_awgn(samples, -1.0, random); }), "variance: -1; it must be finite and not negative");
  EXPECT_EQ(random.position(), 0U);  // refused before anything was drawn
  EXPECT_THAT(refusal([&] { add_awgn(samples, kNan, random); }), StartsWith("variance: nan"));
  EXPECT_THAT(refusal([&] { static_cast<void>(noise_variance_for_snr(-1.0, 0.0)); }), StartsWith("signal_power: -1"));
  EXPECT_THAT(refusal([&] { static_cast<void>(noise_variance_for_snr(1.0, kNan)); }), StartsWith("snr_db: nan"));
  EXPECT_THAT(refusal([&] { static_cast<void>(noise_variance_for_element_snr(0.0, -1.0)); }),
              StartsWith("element_power: -1"));
  EXPECT_THAT(refusal([&] { static_cast<void>(noise_variance_for_element_snr(0.0, 1.0, 0.0)); }),
              StartsWith("transform_gain: 0"));
  EXPECT_THAT(refusal([&] { apply_cfo(samples, kNan, 1e6); }), StartsWith("cfo_hz: nan"));
  EXPECT_THAT(refusal([&] { apply_cfo(samples, 1.0, 0.0); }), StartsWith("sample_rate_hz: 0"));
  EXPECT_THAT(refusal([&] { apply_cfo(samples, 1.0, 1e6, kInfinity); }), StartsWith("phase_rad: inf"));
  EXPECT_THAT(refusal([&] { static_cast<void>(apply_clock_error(samples, 1001.0)); }),
              StartsWith("clock_error_ppm: 1001; it must lie between -1000 and 1000"));
  EXPECT_THAT(refusal([&] { static_cast<void>(apply_clock_error(samples, kNan)); }), StartsWith("clock_error_ppm"));
  const std::vector<Tap> late{{kInfinity, 1.0}};
  const std::vector<Tap> loud{{0.0, {kNan, 0.0}}};
  EXPECT_THAT(refusal([&] { static_cast<void>(apply_taps(samples, 1e6, late)); }), StartsWith("delay_s: inf"));
  EXPECT_THAT(refusal([&] { static_cast<void>(apply_taps(samples, 1e6, loud)); }), StartsWith("gain: nan"));
  EXPECT_THAT(refusal([&] { static_cast<void>(apply_taps(samples, -1e6, {})); }), StartsWith("sample_rate_hz: -1e+06"));
  EXPECT_THAT(refusal([&] { scale_to_rms(samples, 0.0); }), StartsWith("rms: 0"));
  std::vector<std::int8_t> pairs(8);
  EXPECT_THAT(refusal([&] { quantize_ci8(samples, 0.0, pairs); }), StartsWith("full_scale: 0"));
  EXPECT_THAT(refusal([&] { quantize_ci8(samples, 1.0, std::span(pairs).first(7)); }), StartsWith("out.size(): 7"));
  EXPECT_THAT(refusal([&] { static_cast<void>(dequantize_ci8(std::span(pairs).first(7), 1.0)); }),
              StartsWith("pairs.size(): 7; it must be even"));
}

TEST(ChannelEdges, NothingInNothingOut) {
  std::vector<Cf32> none;
  RandomStream random(1);
  add_awgn(none, 1.0, random);
  apply_cfo(none, 1.0, 2.0);
  EXPECT_EQ(scale_to_rms(none, 1.0), 1.0);
  EXPECT_TRUE(apply_clock_error(none, 1.0).empty());
  EXPECT_TRUE(apply_taps(none, 1.0, std::vector<Tap>{{}}).empty());
  EXPECT_EQ(quantize_ci8(none, 1.0, {}), 0U);
}

TEST(ChannelConverter, RoundsClipsAndCounts) {
  const std::vector<Cf32> samples{
      {0.0F, 127.0F},    {-127.0F, 254.0F},
      {-127.6F, 127.4F}, {63.5F, 0.5F},
      {1.5F, -1.5F},     {std::numeric_limits<float>::quiet_NaN(), -std::numeric_limits<float>::infinity()}};
  std::vector<std::int8_t> pairs(2 * samples.size());
  EXPECT_EQ(quantize_ci8(samples, 127.0, pairs), 4U);  // 254, -127.6, NaN and infinity
  EXPECT_THAT(pairs, testing::ElementsAre(0, 127, -127, 127, -127, 127, 64, 0, 2, -2, 0, -127));
  const auto back = dequantize_ci8(pairs, 1.0);
  EXPECT_EQ(back[1], Cf32(-1.0F, 1.0F));
  EXPECT_FLOAT_EQ(back[3].real(), 64.0F / 127.0F);
}

TEST(ChannelConverter, ScalesToRms) {
  std::vector<Cf32> samples{{3.0F, 4.0F}, {0.0F, 5.0F}};
  EXPECT_DOUBLE_EQ(scale_to_rms(samples, 0.25), 0.05);
  EXPECT_NEAR(mean_power(samples), 0.0625, 1e-8);
  std::vector<Cf32> silence(3);
  EXPECT_EQ(scale_to_rms(silence, 1.0), 1.0);
  EXPECT_EQ(mean_power(silence), 0.0);
}

}  // namespace
}  // namespace soopnav::simulation
