// Statistics of the random pieces. Fixed seeds; bounds are five standard deviations (6e-7) unless they say otherwise.

#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <vector>

#include "simulation/tone.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/simulation/channel.hpp"

namespace soopnav::simulation {
namespace {

// The variance of n samples' mean |noise|^2 is variance^2 / n.
TEST(AwgnConsistency, SnrIsWhatWasAsked) {
  constexpr std::size_t kSamples = 200'000;
  for (const double snr_db : {-14.0, 0.0, 25.0}) {
    std::vector<Cf32> samples = test::tone(0.123, kSamples);
    for (Cf32& x : samples) x *= 3.0F;
    const std::vector<Cf32> clean = samples;
    const double variance = noise_variance_for_snr(mean_power(clean), snr_db);
    RandomStream random(21);
    add_awgn(samples, variance, random);
    EXPECT_EQ(random.position(), 2 * kSamples);
    for (std::size_t n = 0; n < kSamples; ++n) samples[n] -= clean[n];
    const double relative = 5.0 / std::sqrt(1.0 * kSamples);
    EXPECT_NEAR(mean_power(clean) / mean_power(samples) / power_ratio(snr_db), 1.0, 1.1 * relative) << snr_db;
  }
}

// Noise per resource element behind the unitary, the unscaled and the 1/N transform; 64 symbols of 128 points.
TEST(AwgnConsistency, ElementSnrHoldsForEveryTransform) {
  constexpr int kPoints = 128;
  constexpr int kSymbols = 500;
  const dsp::Fft fft(kPoints, dsp::FftDirection::kForward);
  const double gains[] = {1.0, kPoints, 1.0 / kPoints};
  for (const double gain : gains) {
    RandomStream random(22);
    const double variance = noise_variance_for_element_snr(6.0, 2.0, gain);
    double power = 0.0;
    for (int symbol = 0; symbol < kSymbols; ++symbol) {
      std::vector<Cf32> samples(kPoints);
      add_awgn(samples, variance, random);
      fft.execute(samples.data(), samples.data());
      power += mean_power(samples) * gain / kPoints / kSymbols;  // sqrt(g / N) times the unscaled transform
    }
    EXPECT_NEAR(2.0 / power / power_ratio(6.0), 1.0, 5.5 / std::sqrt(1.0 * kPoints * kSymbols)) << gain;
  }
}

// Noise is white: no correlation at lags 1 to 5.
TEST(AwgnConsistency, NoiseIsWhite) {
  constexpr std::size_t kSamples = 200'000;
  std::vector<Cf32> noise(kSamples);
  RandomStream random(23);
  add_awgn(noise, 1.0, random);
  for (std::size_t lag = 1; lag <= 5; ++lag) {
    std::complex<double> sum = 0.0;
    for (std::size_t n = lag; n < kSamples; ++n) {
      sum += std::complex<double>(noise[n]) * std::conj(std::complex<double>(noise[n - lag]));
    }
    EXPECT_LT(std::abs(sum), 5.3 * std::sqrt(1.0 * kSamples)) << lag;  // |.| is Rayleigh: 6e-13
  }
}

// The converter's rounding is uniform noise: (full_scale / 127)^2 / 6 per complex sample. The variance of one squared
// error, uniform in +-q/2, is q^4 / 180; two parts per sample.
TEST(ConverterConsistency, RoundingNoise) {
  constexpr std::size_t kSamples = 100'000;
  std::vector<Cf32> samples(kSamples);
  RandomStream random(24);
  random.fill_complex_normal(samples, 0.05);
  std::vector<std::int8_t> pairs(2 * kSamples);
  ASSERT_EQ(quantize_ci8(samples, 1.0, pairs), 0U);
  const auto back = dequantize_ci8(pairs, 1.0);
  for (std::size_t n = 0; n < kSamples; ++n) samples[n] -= back[n];
  const double step = 1.0 / 127.0;
  EXPECT_NEAR(mean_power(samples), step * step / 6.0, 5.0 * step * step * std::sqrt(2.0 / 180.0 / kSamples));
}

// Clipping happens as often as a normal passes full scale: here at two standard deviations of a part.
TEST(ConverterConsistency, ClippingRate) {
  constexpr std::size_t kSamples = 100'000;
  std::vector<Cf32> samples(kSamples);
  RandomStream random(25);
  random.fill_complex_normal(samples, 2.0);
  std::vector<std::int8_t> pairs(2 * kSamples);
  const auto clipped = static_cast<double>(quantize_ci8(samples, 2.0, pairs));
  // Parts that round to 128 or more are clipped, so the border lies half a step beyond full scale.
  const double probability = std::erfc(2.0 * (127.5 / 127.0) / std::sqrt(2.0));
  const double parts = 2.0 * kSamples;
  EXPECT_NEAR(clipped, parts * probability, 5.0 * std::sqrt(parts * probability));
}

}  // namespace
}  // namespace soopnav::simulation
