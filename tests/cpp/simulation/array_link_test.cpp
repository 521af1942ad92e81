#include "soopnav/simulation/array_link.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/simulation/channel.hpp"
#include "soopnav/simulation/eigenvalue_map.hpp"
#include "soopnav/simulation/front_end.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::simulation {
namespace {

using Complex = std::complex<double>;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

Complex mean_product(IqSpan x, IqSpan y) {
  Complex sum;
  for (std::size_t n = 0; n < x.size(); ++n) sum += Complex(x[n]) * std::conj(Complex(y[n]));
  return sum / static_cast<double>(x.size());
}

// carter 5.1 by hand: 10 dBm, L1 over 1 km 96.42 dB; k T0 20 MHz and 6 dB are -94.97 dBm.
TEST(LinkBudget, OutputPowerOfTheChain) {
  LinkBudget budget;
  EXPECT_NEAR(budget.received_power_dbm(1000.0), 10.0 - 96.397, 2e-3);
  EXPECT_NEAR(budget.noise_floor_dbm(), -173.975 + 73.010 + 6.0, 2e-3);
  budget.splitter_loss_db = 6.0;
  budget.delay_system_loss_db = 4.0;
  budget.excess_loss_db = 16.6;
  EXPECT_NEAR(budget.snr_db(1000.0), -18.03, 0.01);
  budget.excess_loss_db = kNan;
  EXPECT_THROW(budget.check(), std::invalid_argument);
}

TEST(LinkBudget, FarFieldIsTheLargestOfThreeLimits) {
  const double wavelength = kSpeedOfLightMps / 1e9;
  EXPECT_DOUBLE_EQ(far_field_limit_m(0.0, 1e9), 1.6 * wavelength);
  EXPECT_DOUBLE_EQ(far_field_limit_m(wavelength, 1e9), 5.0 * wavelength);
  EXPECT_DOUBLE_EQ(far_field_limit_m(10.0 * wavelength, 1e9), 200.0 * wavelength);
  EXPECT_THROW(static_cast<void>(far_field_limit_m(-1.0, 1e9)), std::invalid_argument);
}

TEST(ArrayRenderer, PhasesOfTheElementsAndPowers) {
  const std::array<Complex, 2> steering{1.0, std::polar(2.0, 0.7)};
  ArrayRenderer renderer(2, 20000, 20e6, Waveform::kNoise, 0.3);
  std::vector<Cf32> out(40000);
  const std::array waves{ArrivingWave{steering, 3.0}};
  renderer.render(waves, 0.0, RandomStream(1), out);
  const auto x = IqSpan(out).first(20000), y = IqSpan(out).last(20000);
  EXPECT_NEAR(std::arg(mean_product(y, x)), 0.7, 1e-5);
  EXPECT_NEAR(mean_power(y) / mean_power(x), 4.0, 1e-4);
  // 6000 independent amplitudes: 1 / sqrt(6000) of the power, five times as much allowed
  EXPECT_NEAR(mean_power(x) / 9.0, 1.0, 0.065);
  // Nothing outside the band: differences of neighbours of a narrow wave are small, |1 - e^jw|^2 averages to 0.30.
  std::vector<Cf32> difference(19999);
  for (std::size_t n = 0; n < difference.size(); ++n) difference[n] = out[n + 1] - out[n];
  const double expected = 2.0 - 2.0 * std::sin(0.3 * kPi) / (0.3 * kPi);
  EXPECT_NEAR(mean_power(difference) / mean_power(x), expected, 0.05 * expected);
}

TEST(ArrayRenderer, WavesAreIndependentOfEachOther) {
  const std::array<Complex, 1> one{1.0};
  ArrayRenderer renderer(1, 500, 1e6);
  std::vector<Cf32> first(500), second(500), both(500), noise(500);
  const std::array waves{ArrivingWave{one, 1.0}, ArrivingWave{one, 0.5}};
  const std::array silent{ArrivingWave{one, 0.0}, ArrivingWave{one, 0.5}};
  renderer.render(std::span(waves).first(1), 0.0, RandomStream(3), first);
  renderer.render(silent, 0.0, RandomStream(3), second);
  renderer.render({}, 2.0, RandomStream(3), noise);
  renderer.render(waves, 2.0, RandomStream(3), both);
  for (std::size_t n = 0; n < 500; ++n) EXPECT_NEAR(std::abs(both[n] - first[n] - second[n] - noise[n]), 0.0F, 2e-6F);
  EXPECT_NEAR(std::abs(mean_product(first, second)), 0.0, 0.5 * 5.0 / std::sqrt(500.0));
  EXPECT_NEAR(mean_power(noise), 2.0, 2.0 * 5.0 / std::sqrt(500.0));
}

TEST(ArrayRenderer, DelaysTurnAToneAndShiftNoise) {
  const std::array<Complex, 2> steering{1.0, 1.0};
  const std::array<double, 2> delay{0.0, 3e-6};  // three samples
  std::vector<Cf32> out(2000);
  for (const double ratio : {1.0, 0.4}) {
    ArrayRenderer noise(2, 1000, 1e6, Waveform::kNoise, ratio);
    noise.render(std::array{ArrivingWave{steering, 1.0, delay}}, 0.0, RandomStream(5), out);
    for (std::size_t n = 0; n < 1000; ++n) EXPECT_NEAR(std::abs(out[1000 + (n + 3) % 1000] - out[n]), 0.0F, 1e-5F);
    EXPECT_NEAR(mean_power(std::span(out).first(1000)), 1.0, 5.0 / std::sqrt(1000.0 * ratio));
  }
  ArrayRenderer tone(2, 1000, 1e6, Waveform::kTone, 1.0, 50e3);
  tone.render(std::array{ArrivingWave{steering, 1.0, delay}}, 0.0, RandomStream(5), out);
  for (std::size_t n = 0; n + 3 < 1000; ++n) EXPECT_NEAR(std::abs(out[1003 + n] - out[n]), 0.0F, 1e-6F);
}

TEST(ArrayRenderer, Refusals) {
  EXPECT_THROW(ArrayRenderer(0, 10, 1e6), std::invalid_argument);
  EXPECT_THROW(ArrayRenderer(1, 0, 1e6), std::invalid_argument);
  EXPECT_THROW(ArrayRenderer(1, 10, 0.0), std::invalid_argument);
  EXPECT_THROW(ArrayRenderer(1, 10, 1e6, Waveform::kNoise, 0.0), std::invalid_argument);
  EXPECT_THROW(ArrayRenderer(1, 10, 1e6, Waveform::kTone, 1.0, kNan), std::invalid_argument);
  ArrayRenderer renderer(2, 10, 1e6);
  std::vector<Cf32> out(20);
  const std::array<Complex, 1> short_steering{1.0};
  EXPECT_THROW(renderer.render(std::array{ArrivingWave{short_steering}}, 1.0, RandomStream(1), out),
               std::invalid_argument);
  EXPECT_THROW(renderer.render({}, kNan, RandomStream(1), out), std::invalid_argument);
  EXPECT_THROW(renderer.render({}, 1.0, RandomStream(1), std::span(out).first(19)), std::invalid_argument);
}

// Moments of the complex Wishart law: E S = R and E |S_ij - R_ij|^2 = R_ii R_jj / N.
TEST(CovarianceSampler, FirstTwoMomentsOfTheLaw) {
  const std::array<Complex, 3> a{1.0, std::polar(1.0, 1.0), std::polar(1.0, -2.0)};
  for (const std::size_t snapshots : {2UL, 3UL, 20UL}) {
    CovarianceSampler sampler(3, snapshots);
    constexpr int kDraws = 20000;
    std::array<Complex, 9> sum{};
    std::array<double, 9> square{};
    std::array<Complex, 9> truth{};
    for (std::size_t i = 0; i < 9; ++i) truth[i] = (i % 4 == 0 ? 1.0 : 0.0) + 4.0 * a[i / 3] * std::conj(a[i % 3]);
    std::array<Complex, 9> drawn{};
    const RandomStream random(7);
    for (int k = 0; k < kDraws; ++k) {
      ASSERT_TRUE(
          sampler.draw(std::array{ArrivingWave{a, 2.0}}, random.substream(static_cast<std::uint64_t>(k)), drawn));
      for (std::size_t i = 0; i < 9; ++i) {
        sum[i] += drawn[i];
        square[i] += std::norm(drawn[i] - truth[i]);
      }
    }
    const double variance = 25.0 / static_cast<double>(snapshots);
    for (std::size_t i = 0; i < 9; ++i) {
      EXPECT_LT(std::abs(sum[i] / double{kDraws} - truth[i]), 5.0 * std::sqrt(variance / kDraws)) << snapshots;
      EXPECT_NEAR(square[i] / kDraws / variance, 1.0, 0.15) << snapshots;  // fourth moments grow for few snapshots
    }
  }
}

TEST(CovarianceSampler, RefusesWhatIsNoCovariance) {
  CovarianceSampler sampler(2, 10);
  std::array<Complex, 4> out{7.0};
  EXPECT_FALSE(sampler.draw(std::array<Complex, 4>{1.0, 2.0, 2.0, 1.0}, RandomStream(1), out));
  EXPECT_FALSE(sampler.draw(std::array<Complex, 4>{1.0, kNan, kNan, 1.0}, RandomStream(1), out));
  EXPECT_EQ(out[0], 7.0);
  EXPECT_THROW(CovarianceSampler(2, 0), std::invalid_argument);
  EXPECT_THROW(CovarianceSampler(0, 1), std::invalid_argument);
}

TEST(GammaVariate, MeanAndVarianceAreTheShape) {
  for (const double shape : {1.0, 7.0, 2500.0}) {
    RandomStream random(11);
    double sum = 0.0, square = 0.0;
    constexpr int kDraws = 40000;
    for (int k = 0; k < kDraws; ++k) {
      const double x = gamma_variate(shape, random) - shape;
      sum += x;
      square += x * x;
    }
    EXPECT_NEAR(sum / kDraws, 0.0, 5.0 * std::sqrt(shape / kDraws));
    EXPECT_NEAR(square / kDraws / shape, 1.0, 0.08);
  }
}

// 1 + M SNR for a strong signal (carter 4.11), a uniform azimuth without one.
TEST(EigenvalueMap, EndsOfTheCurve) {
  array::GridOptions grid;
  grid.azimuth_step_rad = grid.elevation_step_rad = 0.07;
  const auto table =
      std::make_shared<const array::SteeringTable>(array::Manifold(array::ArrayGeometry::planar(2, 2, 0.2)), grid);
  EigenvalueMapOptions options;
  options.snapshots = 1000;
  options.trials = 200;
  const std::array snr_db{-30.0, 10.0};
  const auto map = eigenvalue_map(table, snr_db, options, RandomStream(3));
  EXPECT_NEAR(map.ratio[1], 41.0, 1.0);
  EXPECT_NEAR(map.azimuth_rms_rad[0], kPi / std::sqrt(3.0), 0.4);
  EXPECT_LT(map.azimuth_rms_rad[1], 0.02);
  EXPECT_LT(map.angle_rms_rad[1], map.angle_rms_rad[0]);
  const auto second = eigenvalue_map(table, std::span(snr_db).first(1), options, RandomStream(3));
  EXPECT_EQ(second.ratio[0], map.ratio[0]);  // an SNR does not depend on the others
  EXPECT_THROW(static_cast<void>(eigenvalue_map(table, {}, options, RandomStream(3))), std::invalid_argument);
  options.trials = 9;
  EXPECT_THROW(static_cast<void>(eigenvalue_map(table, snr_db, options, RandomStream(3))), std::invalid_argument);
}

// ---- Front end

TEST(FrontEnd, ImageOfTwoDecibelsAndTenDegrees) {
  FrontEndOptions options;
  options.full_scale_dbm = 0.0;  // root milliwatts come out as they are, noise far below
  ChannelErrors errors;
  errors.iq_gain_db = 2.0;
  errors.iq_phase_rad = 10.0 * kPi / 180.0;
  errors.dc = {0.01, -0.02};
  const FrontEnd front_end({errors}, options);
  std::vector<Cf32> x(1000);
  for (std::size_t n = 0; n < x.size(); ++n)
    x[n] = std::polar(0.5F, static_cast<float>(kTwoPi * 0.05 * static_cast<double>(n)));
  const std::vector<Cf32> sent = x;
  EXPECT_EQ(front_end.apply(x, RandomStream(1)), 0U);
  std::vector<Cf32> image(sent.size());
  for (std::size_t n = 0; n < image.size(); ++n) image[n] = std::conj(sent[n]);
  const Complex g = std::pow(10.0, 0.1) * std::polar(1.0, errors.iq_phase_rad);
  EXPECT_LT(std::abs(mean_product(x, sent) / 0.25 - 0.5 * (1.0 + g)), 1e-4);
  EXPECT_LT(std::abs(mean_product(x, image) / 0.25 - 0.5 * (1.0 - std::conj(g))), 1e-4);
  EXPECT_NEAR(20.0 * std::log10(std::abs(1.0 - g) / std::abs(1.0 + g)), -16.82, 0.01);
  const std::vector<Cf32> ones(1000, Cf32(1.0F, 0.0F));
  EXPECT_LT(std::abs(mean_product(x, ones) - Complex(0.01, -0.02)), 1e-4);
}

TEST(FrontEnd, AttenuatorStepsAndItsRestInNoise) {
  FrontEndOptions options;
  options.attenuation_db = 20.6;
  const FrontEnd front_end({ChannelErrors{}}, options);
  EXPECT_DOUBLE_EQ(front_end.stepped_attenuation_db(), 20.0);
  const double unit = std::pow(10.0, (front_end.noise_floor_dbm() + 40.0) / 20.0);  // 40 dB over the noise: full scale
  std::vector<Cf32> silence(100000), tone(100000, Cf32(static_cast<float>(unit), 0.0F));
  front_end.apply(silence, RandomStream(2));
  EXPECT_NEAR(decibels(mean_power(silence)), -40.0 + 0.6, 0.07);
  front_end.apply(tone, RandomStream(2));
  EXPECT_NEAR(decibels(mean_power(tone)), -20.0, 0.07);
  options.attenuator_step_db = 0.1;
  EXPECT_NEAR(FrontEnd({ChannelErrors{}}, options).stepped_attenuation_db(), 20.6, 1e-12);
}

TEST(FrontEnd, PhaseShifterStepsAndSign) {
  FrontEndOptions options;
  options.full_scale_dbm = 0.0;
  options.phase_step_rad = 0.1;
  ChannelErrors late;
  late.phase_delay_rad = 0.77;
  const FrontEnd front_end({ChannelErrors{}, late}, options);
  EXPECT_NEAR(front_end.phase_delay_rad(1), 0.8, 1e-12);
  std::vector<Cf32> x(20, Cf32(1.0F, 0.0F));
  front_end.apply(x, RandomStream(1));
  EXPECT_NEAR(std::arg(x[15] / x[5]), -0.8, 1e-3);
}

TEST(FrontEnd, ConverterRoundsAndClips) {
  FrontEndOptions options;
  options.full_scale_dbm = 60.0;  // noise of -155 dB under full scale
  options.adc_bits = 3;
  const FrontEnd front_end({ChannelErrors{}}, options);
  const auto at = [](double re, double im) { return 1000.0F * Cf32(static_cast<float>(re), static_cast<float>(im)); };
  std::vector<Cf32> x{at(0.3, -0.3), at(5.0, -5.0), at(0.75, -1.0), at(std::numeric_limits<double>::quiet_NaN(), 0.1)};
  EXPECT_EQ(front_end.apply(x, RandomStream(1)), 4U);  // two of 5, and both parts of the NaN
  EXPECT_EQ(x, (std::vector<Cf32>{{0.25F, -0.25F}, {0.75F, -1.0F}, {0.75F, -1.0F}, {0.0F, 0.0F}}));
}

TEST(FrontEnd, Refusals) {
  EXPECT_THROW(FrontEnd({}, {}), std::invalid_argument);
  FrontEndOptions options;
  options.adc_bits = 1;
  EXPECT_THROW(FrontEnd({ChannelErrors{}}, options), std::invalid_argument);
  options = {};
  options.attenuation_db = -1.0;
  EXPECT_THROW(FrontEnd({ChannelErrors{}}, options), std::invalid_argument);
  ChannelErrors errors;
  errors.gain = {kNan, 0.0};
  EXPECT_THROW(FrontEnd({errors}, {}), std::invalid_argument);
  const FrontEnd two({ChannelErrors{}, ChannelErrors{}}, {});
  std::vector<Cf32> odd(3);
  EXPECT_THROW(two.apply(odd, RandomStream(1)), std::invalid_argument);
}

TEST(DownConvert, ToneComesOutAtTheDifferenceFrequency) {
  std::vector<float> radio(8000);
  for (std::size_t n = 0; n < radio.size(); ++n) {
    radio[n] = static_cast<float>(0.7 * std::cos(kTwoPi * 0.26 * static_cast<double>(n) + 0.4));
  }
  const auto x = down_convert(radio, 1.0, 0.25, 8, 0.1);
  ASSERT_EQ(x.size(), 1000U);
  for (std::size_t n = 100; n < 900; ++n) {
    const Complex expected = std::polar(0.7, kTwoPi * 0.08 * static_cast<double>(n) + 0.3);
    EXPECT_LT(std::abs(Complex(x[n]) - expected), 5e-4) << n;
  }
  EXPECT_THROW(static_cast<void>(down_convert(radio, 1.0, 0.5, 8)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(down_convert(radio, 1.0, 0.25, 1)), std::invalid_argument);
}

TEST(ArrayLinkNoAlloc, BlocksAndDraws) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  const std::array<Complex, 2> steering{1.0, std::polar(1.0, 0.7)};
  const std::array<double, 2> delay{0.0, 1e-9};
  const std::array waves{ArrivingWave{steering, 1.0}, ArrivingWave{steering, 1.0, delay}};
  ArrayRenderer renderer(2, 2500, 20e6, Waveform::kNoise, 0.5);
  CovarianceSampler sampler(2, 100);
  FrontEndOptions options;
  options.adc_bits = 8;
  const FrontEnd front_end({ChannelErrors{}, ChannelErrors{}}, options);
  std::vector<Cf32> out(5000);
  std::array<Complex, 4> drawn{};
  renderer.render(waves, 1.0, RandomStream(1), out);
  bool good = false;
  EXPECT_EQ(test::allocations_of([&] {
              renderer.render(waves, 1.0, RandomStream(1), out);
              front_end.apply(out, RandomStream(2));
              good = sampler.draw(waves, RandomStream(3), drawn);
            }),
            0);
  EXPECT_TRUE(good);
}

}  // namespace
}  // namespace soopnav::simulation
