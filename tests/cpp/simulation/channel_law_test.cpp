// Exactness and signs of the channel's pieces, against tones whose value is known at any time.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <vector>

#include "simulation/tone.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/simulation/channel.hpp"

namespace soopnav::simulation {
namespace {

using test::tone;
using test::tone_at;

constexpr double kRateHz = 1.92e6;

std::size_t strongest_bin(const std::vector<Cf32>& samples) {
  std::vector<Cf32> spectrum(samples.size());
  dsp::Fft(static_cast<int>(samples.size()), dsp::FftDirection::kForward).execute(samples.data(), spectrum.data());
  const auto peak =
      std::max_element(spectrum.begin(), spectrum.end(), [](Cf32 a, Cf32 b) { return std::norm(a) < std::norm(b); });
  return static_cast<std::size_t>(peak - spectrum.begin());
}

TEST(CfoLaw, PositiveMovesTheSpectrumUp) {
  std::vector<Cf32> samples(1024, Cf32(1.0F, 0.0F));
  apply_cfo(samples, 5.0 * kRateHz / 1024.0, kRateHz);
  EXPECT_EQ(strongest_bin(samples), 5U);
  apply_cfo(samples, -8.0 * kRateHz / 1024.0, kRateHz);
  EXPECT_EQ(strongest_bin(samples), 1021U);
}

TEST(CfoLaw, PhaseIsExactFarFromTheStart) {
  for (const std::int64_t first : {std::int64_t{0}, std::int64_t{-1'000'000'007}, std::int64_t{1} << 40}) {
    std::vector<Cf32> samples(1000, Cf32(1.0F, 0.0F));
    const double cfo_hz = 14'283.7;
    apply_cfo(samples, cfo_hz, kRateHz, 0.7, first);
    for (std::size_t n = 0; n < samples.size(); ++n) {
      const std::complex<double> expected =
          tone_at(cfo_hz / kRateHz, static_cast<double>(first + static_cast<std::int64_t>(n))) * std::polar(1.0, 0.7);
      ASSERT_LT(std::abs(std::complex<double>(samples[n]) - expected), 1.2e-7) << first << " + " << n;
    }
  }
}

TEST(CfoLaw, PartsMakeTheWhole) {
  const std::vector<Cf32> signal = tone(0.01, 1000);
  std::vector<Cf32> whole = signal;
  std::vector<Cf32> parts = signal;
  apply_cfo(whole, 12'345.6, kRateHz, -1.0);
  apply_cfo(std::span(parts).first(317), 12'345.6, kRateHz, -1.0);
  apply_cfo(std::span(parts).subspan(317), 12'345.6, kRateHz, -1.0, 317);
  for (std::size_t n = 0; n < whole.size(); ++n) ASSERT_LT(std::abs(whole[n] - parts[n]), 1.2e-7F);
}

TEST(CfoLaw, BackAndForthIsNothing) {
  const std::vector<Cf32> signal = tone(-0.2, 500);
  std::vector<Cf32> samples = signal;
  apply_cfo(samples, 7e5, kRateHz, 2.0);
  apply_cfo(samples, -7e5, kRateHz, -2.0);
  for (std::size_t n = 0; n < signal.size(); ++n) ASSERT_LT(std::abs(samples[n] - signal[n]), 2.4e-7F);
}

// A fast transmitter's tone is heard higher, and its frames are short in samples.
TEST(ClockErrorLaw, TonesRiseByTheError) {
  constexpr std::size_t kSamples = 200'000;
  for (const double ppm : {7.86, -20.0, 500.0}) {
    for (const double frequency : {0.01, 0.2, -0.35}) {
      const auto heard = apply_clock_error(tone(frequency, kSamples), ppm);
      double worst = 0.0;
      for (std::size_t m = 200; m + 400 < heard.size(); ++m) {
        const auto expected = tone_at(frequency, static_cast<double>(m) * (1.0 + 1e-6 * ppm));
        worst = std::max(worst, std::abs(std::complex<double>(heard[m]) - expected));
      }
      EXPECT_LT(worst, 1.5e-4) << ppm << " ppm, " << frequency;  // 80 dB is 1e-4
    }
  }
}

TEST(ClockErrorLaw, FastTransmittersFramesAreShort) {
  constexpr std::size_t kSamples = 400'000;
  const std::vector<Cf32> signal(kSamples, Cf32(1.0F, 0.0F));
  EXPECT_EQ(apply_clock_error(signal, 100.0).size(), 399'961U);   // ceil(400 000 / 1.0001)
  EXPECT_EQ(apply_clock_error(signal, -100.0).size(), 400'041U);  // ceil(400 000 / 0.9999)
  // A pulse sent at sample 300 000 is heard 30 samples early.
  std::vector<Cf32> pulse(kSamples);
  pulse[300'000] = 1.0F;
  const auto heard = apply_clock_error(pulse, 100.0);
  const auto peak =
      std::max_element(heard.begin(), heard.end(), [](Cf32 a, Cf32 b) { return std::norm(a) < std::norm(b); });
  EXPECT_EQ(peak - heard.begin(), 299'970);
}

TEST(ClockErrorLaw, StartMovesTheFirstOutput) {
  const double frequency = 0.05;
  const auto heard = apply_clock_error(tone(frequency, 1000), 10.0, {}, 100.25);
  EXPECT_EQ(heard.size(), 900U);
  for (std::size_t m = 0; m < 800; ++m) {
    const auto expected = tone_at(frequency, 100.25 + static_cast<double>(m) * (1.0 + 1e-5));
    ASSERT_LT(std::abs(std::complex<double>(heard[m]) - expected), 1.5e-4) << m;
  }
}

TEST(TapsLaw, WholeSamplesAreCopies) {
  RandomStream random(1);
  std::vector<Cf32> signal(500);
  random.fill_complex_normal(signal);
  const std::vector<Tap> taps{{7.0 / kRateHz, {0.5, 0.0}}};
  const auto out = apply_taps(signal, kRateHz, taps);
  ASSERT_EQ(out.size(), signal.size());
  for (std::size_t n = 0; n < 7; ++n) EXPECT_EQ(out[n], Cf32());
  for (std::size_t n = 7; n < out.size(); ++n) ASSERT_EQ(out[n], 0.5F * signal[n - 7]);
  const std::vector<Tap> earlier{{-7.0 / kRateHz, {0.0, 1.0}}};
  const auto turned = apply_taps(signal, kRateHz, earlier);
  for (std::size_t n = 0; n + 7 < out.size(); ++n) {
    ASSERT_EQ(turned[n], Cf32(-signal[n + 7].imag(), signal[n + 7].real()));
  }
  EXPECT_EQ(turned.back(), Cf32());
}

TEST(TapsLaw, NoTapsAreSilence) { EXPECT_EQ(mean_power(apply_taps(tone(0.1, 100), kRateHz, {})), 0.0); }

// The answer to a tone is the tone times sum g exp(-j 2 pi f delay).
TEST(TapsLaw, FractionalDelaysTurnTones) {
  const std::vector<Tap> taps{{0.0, {1.0, 0.0}}, {1.37e-6, {-0.3, 0.4}}, {5.2083e-6, {0.0, 0.25}}};
  for (const double frequency : {-0.39, -0.1, 0.003, 0.25, 0.39}) {
    const auto out = apply_taps(tone(frequency, 2000), kRateHz, taps);
    std::complex<double> response = 0.0;
    for (const Tap& tap : taps) response += tap.gain * std::conj(tone_at(frequency, tap.delay_s * kRateHz));
    double worst = 0.0;
    for (std::size_t n = 100; n < 1900; ++n) {
      worst = std::max(
          worst, std::abs(std::complex<double>(out[n]) - response * tone_at(frequency, 1.0 * static_cast<double>(n))));
    }
    EXPECT_LT(worst, 1.75 * 1e-4) << frequency;  // 80 dB below the sum of the taps' magnitudes
  }
}

TEST(TapsLaw, PathsAddUp) {
  RandomStream random(2);
  std::vector<Cf32> signal(600);
  random.fill_complex_normal(signal);
  const std::vector<Tap> both{{0.3e-6, {0.7, -0.1}}, {2.9e-6, {0.2, 0.6}}};
  const auto sum = apply_taps(signal, kRateHz, both);
  const auto first = apply_taps(signal, kRateHz, std::span(both).first(1));
  const auto second = apply_taps(signal, kRateHz, std::span(both).last(1));
  for (std::size_t n = 0; n < sum.size(); ++n) ASSERT_LT(std::abs(sum[n] - first[n] - second[n]), 1e-6F);
}

TEST(ConverterLaw, RoundTripIsWithinHalfAStep) {
  RandomStream random(3);
  std::vector<Cf32> signal(10'000);
  random.fill_complex_normal(signal, 0.1);
  constexpr double kFullScale = 2.0;
  std::vector<std::int8_t> pairs(2 * signal.size());
  ASSERT_EQ(quantize_ci8(signal, kFullScale, pairs), 0U);
  const auto back = dequantize_ci8(pairs, kFullScale);
  const double half_step = 0.5 * kFullScale / 127.0 * (1.0 + 1e-5);
  for (std::size_t n = 0; n < signal.size(); ++n) {
    ASSERT_LE(std::abs(static_cast<double>(back[n].real() - signal[n].real())), half_step);
    ASSERT_LE(std::abs(static_cast<double>(back[n].imag() - signal[n].imag())), half_step);
  }
  std::vector<std::int8_t> again(pairs.size());
  EXPECT_EQ(quantize_ci8(back, kFullScale, again), 0U);
  EXPECT_EQ(again, pairs);
}

}  // namespace
}  // namespace soopnav::simulation
