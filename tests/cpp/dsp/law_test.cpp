#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <ostream>
#include <string>

#include "dsp/kernels.hpp"
#include "dsp/signals.hpp"
#include "soopnav/dsp/correlate.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/dsp/fractional_delay.hpp"
#include "soopnav/dsp/peak.hpp"
#include "soopnav/dsp/resample.hpp"

namespace soopnav::dsp {
namespace {

using testing::Cf64;
using testing::largest_difference;
using testing::noise;

// One battery for everything here that maps a capture to a capture linearly.
struct Operation {
  const char* name;
  double step;  // inputs per output
  std::function<std::vector<Cf32>(IqSpan)> run;
};

std::ostream& operator<<(std::ostream& stream, const Operation& operation) { return stream << operation.name; }

std::vector<Operation> operations() {
  const auto kernel = noise(37, 99);
  const auto filter = [kernel](FilterKind kind) {
    return [kernel, kind](IqSpan x) {
      OverlapSave object(kernel, kind, 128);
      std::vector<Cf32> y(x.size());
      object.apply(x, 0, y);
      return y;
    };
  };
  const auto resampler = [](Resampler prototype) {
    return [prototype](IqSpan x) {
      Resampler object = prototype;
      std::vector<Cf32> y(object.output_size(x.size()));
      object.apply(x, 0, y);
      return y;
    };
  };
  return {{"convolution", 1.0, filter(FilterKind::kConvolution)},
          {"correlation", 1.0, filter(FilterKind::kCorrelation)},
          {"sinc_delay", 1.0, [](IqSpan x) { return delayed(x, 3.3); }},
          {"lagrange_delay", 1.0,
           [](IqSpan x) {
             std::vector<Cf32> y(x.size());
             FractionalDelay::lagrange(3.3, 5).apply(x, 0, y);
             return y;
           }},
          {"decimation", 5.0, resampler(Resampler::rational(1, 5))},
          {"rational", 2.5, resampler(Resampler::rational(2, 5))},
          {"interpolation", 0.25, resampler(Resampler::rational(4, 1))},
          {"arbitrary", 1.25, resampler(Resampler::arbitrary(1.25))}};
}

class LinearOperations : public ::testing::TestWithParam<Operation> {};

TEST_P(LinearOperations, AreLinear) {
  const auto a = noise(700, 1), b = noise(700, 2);
  const Cf32 p(0.6F, -1.1F), q(-0.3F, 0.8F);
  std::vector<Cf32> sum(700);
  for (std::size_t i = 0; i < sum.size(); ++i) sum[i] = p * a[i] + q * b[i];
  const auto ya = GetParam().run(a), yb = GetParam().run(b), ysum = GetParam().run(sum);
  std::vector<Cf32> want(ya.size());
  double scale = 0.0;
  for (std::size_t i = 0; i < want.size(); ++i) {
    want[i] = p * ya[i] + q * yb[i];
    scale = std::max(scale, std::abs(Cf64(want[i])));
  }
  EXPECT_LT(largest_difference(ysum, want), 2e-6 * scale);
}

// A capture delayed by 20 samples gives outputs delayed by 20 / step.
TEST_P(LinearOperations, CommuteWithShifts) {
  const auto x = noise(700, 1);
  std::vector<Cf32> late(720);
  std::copy(x.begin(), x.end(), late.begin() + 20);
  const auto y = GetParam().run(x), y_late = GetParam().run(late);
  const auto shift = static_cast<std::size_t>(20.0 / GetParam().step);
  ASSERT_EQ(y_late.size(), y.size() + shift);
  double scale = 0.0;
  for (const Cf32& v : y) scale = std::max(scale, std::abs(Cf64(v)));
  EXPECT_LT(largest_difference(std::span(y_late).subspan(shift), y), 2e-6 * scale);
}

INSTANTIATE_TEST_SUITE_P(All, LinearOperations, ::testing::ValuesIn(operations()),
                         [](const auto& test) { return std::string(test.param.name); });

TEST(ConvolutionLaw, Commutes) {
  const auto a = noise(90, 1), b = noise(61, 2);
  std::vector<Cf32> ab(150), ba(150);
  OverlapSave(b, FilterKind::kConvolution).apply(a, 0, ab);
  OverlapSave(a, FilterKind::kConvolution).apply(b, 0, ba);
  EXPECT_LT(largest_difference(ab, ba), 1e-4);
}

TEST(CorrelationLaw, SwappingTheSignalsMirrorsAndConjugates) {
  const auto a = noise(90, 1), b = noise(61, 2);
  std::vector<Cf32> ab(150), ba(150);
  OverlapSave(b, FilterKind::kCorrelation).apply(a, -60, ab);  // lags -60 .. 89
  OverlapSave(a, FilterKind::kCorrelation).apply(b, -89, ba);  // lags -89 .. 60
  std::reverse(ba.begin(), ba.end());
  for (Cf32& v : ba) v = std::conj(v);
  EXPECT_LT(largest_difference(ab, ba), 1e-4);
}

TEST(DelayLaw, ForthAndBackIsTheSignal) {
  const testing::Tones signal(11, 0.8 * std::numbers::pi, 3);
  const auto x = signal.sample(500);
  const auto y = delayed(delayed(x, 7.31), -7.31);
  EXPECT_LT(testing::db(largest_difference(std::span(x).subspan(60, 380), std::span(y).subspan(60, 380))), -74.0);
}

TEST(ResampleLaw, UpThenDownIsTheSignal) {
  const testing::Tones signal(11, 0.8 * std::numbers::pi, 3);
  const auto x = signal.sample(1000);
  for (const double rate : {3.0, 1.37, 2.00001}) {
    const auto y = resample(resample(x, 1.0, rate), rate, 1.0);
    ASSERT_GE(y.size(), x.size());
    EXPECT_LT(testing::db(largest_difference(std::span(x).subspan(100, 800), std::span(y).subspan(100, 800))), -74.0);
  }
}

// A start offset and a delay by the opposite are the same thing.
TEST(ResampleLaw, AStartIsADelay) {
  const testing::Tones signal(11, 0.8 * std::numbers::pi, 3);
  const auto x = signal.sample(500);
  auto resampler = Resampler::rational(1, 1, {}, 0.37);
  std::vector<Cf32> y(500);
  resampler.apply(x, 0, y);
  const auto z = delayed(x, -0.37);
  EXPECT_LT(testing::db(largest_difference(std::span(y).subspan(60, 380), std::span(z).subspan(60, 380))), -74.0);
}

// The grid of filters gives what the exact ones give.
TEST(ResampleLaw, ArbitraryEqualsRational) {
  const auto x = noise(3000, 5);
  auto exact = Resampler::rational(5, 13);
  auto grid = Resampler::arbitrary(13.0 / 5.0);
  std::vector<Cf32> a(exact.output_size(3000)), b(a.size());
  exact.apply(x, 0, a);
  grid.apply(x, 0, b);
  EXPECT_LT(testing::db(largest_difference(a, b)), -80.0);
}

TEST(PeakLaw, ScaleAndPhaseDoNotMoveThePeakAndMirroringFlipsIt) {
  std::vector<Cf32> r(201), scaled(201);
  for (std::size_t n = 0; n < r.size(); ++n) {
    const double t = 0.6 * std::numbers::pi * (static_cast<double>(n) - 100.3);
    r[n] = Cf32(static_cast<float>(std::sin(t) / t), 0.0F);
    scaled[n] = r[n] * Cf32(-120.0F, 77.0F);
  }
  auto mirrored = r;
  std::reverse(mirrored.begin(), mirrored.end());
  const PeakRefiner refiner;
  const auto peak = refiner.refine(r, 100), other = refiner.refine(scaled, 100),
             flipped = refiner.refine(mirrored, 100);
  ASSERT_TRUE(peak && other && flipped);
  EXPECT_NEAR(peak->offset_samples, other->offset_samples, 1e-6);
  EXPECT_NEAR(peak->offset_samples, -flipped->offset_samples, 1e-6);
  for (const PeakScale scale : {PeakScale::kMagnitude, PeakScale::kPower, PeakScale::kLog}) {
    const auto a = parabolic_peak(0.5, 1.0, 0.8, scale), b = parabolic_peak(0.8, 1.0, 0.5, scale),
               c = parabolic_peak(3.5, 7.0, 5.6, scale);
    ASSERT_TRUE(a && b && c);
    EXPECT_GT(a->offset_samples, 0.0) << "positive is towards later samples";
    EXPECT_NEAR(a->offset_samples, -b->offset_samples, 1e-15);
    EXPECT_NEAR(a->offset_samples, c->offset_samples, 1e-12);
    EXPECT_NEAR(7.0 * a->magnitude, c->magnitude, 1e-12);
  }
}

}  // namespace

namespace detail_baseline {
// kernels.cpp compiled for the baseline only, in kernels_baseline.cpp.
Cf32 dot(const float* taps, const Cf32* x, std::size_t n) noexcept;
Cf32 dot_between(const float* low, const float* high, float mu, const Cf32* x, std::size_t n) noexcept;
void fir(const float* taps, std::size_t n_taps, const Cf32* x, std::size_t n_out, Cf32* out) noexcept;
void multiply(Cf32* a, const Cf32* b, std::size_t n) noexcept;
}  // namespace detail_baseline

namespace {

TEST(KernelLaw, TheVectorWidthChangesNoBit) {
  const auto x = noise(4096, 1);
  const auto low = noise(2048, 2), high = noise(2048, 3);
  const auto* a = reinterpret_cast<const float*>(low.data());
  const auto* b = reinterpret_cast<const float*>(high.data());
  for (std::size_t n = detail::kDotSamples; n <= 2048; n += 7 * detail::kDotSamples) {
    for (const std::size_t shift : {0U, 1U, 3U}) {
      EXPECT_EQ(detail::dot(a, x.data() + shift, n), detail_baseline::dot(a, x.data() + shift, n));
      EXPECT_EQ(detail::dot_between(a, b, 0.37F, x.data() + shift, n),
                detail_baseline::dot_between(a, b, 0.37F, x.data() + shift, n));
    }
  }
  for (const std::size_t n_out : {1U, 31U, 32U, 33U, 1000U}) {
    for (const std::size_t n_taps : {1U, 2U, 30U, 77U}) {
      std::vector<Cf32> wide(n_out), plain(n_out);
      detail::fir(a, n_taps, x.data() + 1, n_out, wide.data());
      detail_baseline::fir(a, n_taps, x.data() + 1, n_out, plain.data());
      EXPECT_EQ(wide, plain);
    }
  }
  auto wide = low, plain = low;
  detail::multiply(wide.data(), high.data(), 2047);
  detail_baseline::multiply(plain.data(), high.data(), 2047);
  EXPECT_EQ(wide, plain);
}

// The same sums in double precision, so that two equal mistakes do not pass.
TEST(KernelLaw, DotsAreSums) {
  const auto x = noise(64, 1);
  std::vector<float> low(128), high(128);
  Cf64 want_low{}, want_high{};
  for (std::size_t k = 0; k < 64; ++k) {
    low[2 * k] = low[2 * k + 1] = static_cast<float>(k) * 0.01F - 0.3F;
    high[2 * k] = high[2 * k + 1] = 0.5F - static_cast<float>(k) * 0.02F;
    want_low += static_cast<double>(low[2 * k]) * Cf64(x[k]);
    want_high += static_cast<double>(high[2 * k]) * Cf64(x[k]);
  }
  EXPECT_LT(std::abs(Cf64(detail::dot(low.data(), x.data(), 64)) - want_low), 1e-5);
  EXPECT_LT(std::abs(Cf64(detail::dot_between(low.data(), high.data(), 0.25F, x.data(), 64)) -
                     (0.75 * want_low + 0.25 * want_high)),
            1e-5);
}

}  // namespace
}  // namespace soopnav::dsp
