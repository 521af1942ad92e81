// Values from NumPy 2.4 and SciPy 1.17; the expression that made them stands at each table.
#include <gtest/gtest.h>

#include <array>

#include "dsp/signals.hpp"
#include "soopnav/dsp/correlate.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/dsp/fractional_delay.hpp"
#include "soopnav/dsp/peak.hpp"
#include "soopnav/dsp/resample.hpp"

namespace soopnav::dsp {
namespace {

using testing::Cf64;

struct Value {
  std::size_t index;
  Cf64 value;
};

// n = numpy.arange(size); x = numpy.cos(.3 * n) + 1j * numpy.sin(.02 * n * n)
std::vector<Cf32> chirp(std::size_t size) {
  std::vector<Cf32> x(size);
  for (std::size_t i = 0; i < size; ++i) {
    const auto n = static_cast<double>(i);
    x[i] = Cf32(Cf64(std::cos(0.3 * n), std::sin(0.02 * n * n)));
  }
  return x;
}

// h = numpy.exp(1j * .4 * numpy.arange(5)) * (1 + numpy.arange(5))
std::vector<Cf32> kernel() {
  std::vector<Cf32> h(5);
  for (std::size_t k = 0; k < 5; ++k)
    h[k] = Cf32(std::polar(1.0 + static_cast<double>(k), 0.4 * static_cast<double>(k)));
  return h;
}

void expect_values(std::span<const Cf32> got, std::initializer_list<Value> wanted, double tolerance) {
  for (const Value& want : wanted) {
    ASSERT_LT(want.index, got.size());
    EXPECT_LT(std::abs(Cf64(got[want.index]) - want.value), tolerance)
        << want.index << ": " << got[want.index] << " instead of " << want.value;
  }
}

TEST(NumPy, Fft) {
  const auto x = chirp(15);
  std::vector<Cf32> y(15);
  Fft(15, FftDirection::kForward).execute(x.data(), y.data());  // numpy.fft.fft(x)
  expect_values(
      y,
      {{0, {-2.628561, 5.409819}}, {1, {3.572146, -10.371804}}, {7, {0.735738, 0.388936}}, {14, {4.551135, 1.412423}}},
      5e-6);
  Fft(15, FftDirection::kInverse).execute(x.data(), y.data());  // 15 * numpy.fft.ifft(x)
  expect_values(
      y,
      {{0, {-2.628561, 5.409819}}, {1, {4.551135, 1.412423}}, {7, {0.624466, 0.519136}}, {14, {3.572146, -10.371804}}},
      5e-6);
}

TEST(NumPy, Convolve) {
  std::vector<Cf32> y(16);
  OverlapSave(kernel(), FilterKind::kConvolution).apply(chirp(12), 0, y);  // numpy.convolve(x, h)
  expect_values(
      y, {{0, {1.0, 0.0}}, {3, {5.482899, 6.794949}}, {11, {-16.275888, -2.298405}}, {15, {-3.157328, -5.031737}}},
      1e-5);
}

TEST(NumPy, Correlate) {
  std::vector<Cf32> y(8);
  OverlapSave(kernel(), FilterKind::kCorrelation).apply(chirp(12), 0, y);  // numpy.correlate(x, h, 'valid')
  expect_values(y, {{0, {7.760144, -6.231269}}, {3, {9.067117, 5.530789}}, {7, {4.543511, 17.050465}}}, 1e-5);
}

// g(t) = b sinc(b t) i0(beta sqrt(1 - (2 t / K)^2)) / i0(beta), b = min(1, up / down), beta = .1102 * (88 - 8.7), on
// t = numpy.arange(-K // 2 * up, K // 2 * up + 1) / up; scipy.signal.resample_poly(x, up, down, window=g / up).
TEST(SciPy, ResamplePoly) {
  auto up = Resampler::rational(3, 2);
  ASSERT_EQ(up.tap_count(), 32U);  // K
  std::vector<Cf32> y(up.output_size(80));
  ASSERT_EQ(y.size(), 120U);
  up.apply(chirp(80), 0, y);
  expect_values(y,
                {{0, {1.0, 0.0}},
                 {1, {1.0809725, 0.0093745}},
                 {2, {0.8547381, 0.0353135}},
                 {7, {0.1867799, 0.4219445}},
                 {16, {-0.9971119, 0.7617617}},
                 {119, {0.1228240, -0.9212823}}},
                1e-6);
  auto down = Resampler::rational(2, 5);
  ASSERT_EQ(down.tap_count(), 80U);
  y.resize(down.output_size(80));
  ASSERT_EQ(y.size(), 32U);
  down.apply(chirp(80), 0, y);
  expect_values(y,
                {{0, {0.6999954, 0.0029123}},
                 {1, {0.8095798, 0.1176006}},
                 {2, {0.0295043, 0.4904158}},
                 {7, {0.5178304, -0.2402308}},
                 {16, {0.8438462, -0.1663281}},
                 {31, {-0.2651543, -0.0299698}}},
                1e-6);
}

// sum(x * numpy.sinc(t) * i0(beta * sqrt(1 - (t / 15)^2)) / i0(beta)), t = m - 2.3 - n, beta = .1102 * (88 - 8.7)
TEST(NumPy, SincDelay) {
  ASSERT_EQ(sinc_tap_count({}), 30);
  const auto y = delayed(chirp(80), 2.3);
  expect_values(y,
                {{0, {0.0633474, -0.0001073}},
                 {5, {0.7216966, 0.1453692}},
                 {40, {0.3092616, -0.1508606}},
                 {79, {-0.5121045, -0.5025640}}},
                1e-6);
}

// The classical half-sample weights (Abramowitz & Stegun, table 25.1 at p = 1/2).
TEST(AbramowitzStegun, LagrangeHalfSampleWeights) {
  std::array<double, 4> four{};
  lagrange_delay_taps(1.5, four);
  const std::array<double, 4> want_four = {-1.0 / 16, 9.0 / 16, 9.0 / 16, -1.0 / 16};
  for (std::size_t k = 0; k < 4; ++k) EXPECT_NEAR(four[k], want_four[k], 1e-15);
  std::array<double, 6> six{};
  lagrange_delay_taps(2.5, six);
  const std::array<double, 6> want_six = {3.0 / 256, -25.0 / 256, 150.0 / 256, 150.0 / 256, -25.0 / 256, 3.0 / 256};
  for (std::size_t k = 0; k < 6; ++k) EXPECT_NEAR(six[k], want_six[k], 1e-15);
}

// k = numpy.arange(-6, 7); R = (1 + .05 * k) * exp(.05j * k**2) * exp(-2j * pi * k * 10.37 / 32)
// scipy.optimize.minimize_scalar(lambda t: -abs(sum(R * exp(2j * pi * k * t / 32))), bounds=(9.5, 11.5),
//                                method='bounded', options=dict(xatol=1e-12))
TEST(SciPy, BandLimitedMaximum) {
  constexpr double kPi = std::numbers::pi;
  std::vector<Cf32> r(32);
  for (std::size_t n = 0; n < 32; ++n) {
    Cf64 sum{};
    for (int k = -6; k <= 6; ++k) {
      sum += std::polar(1.0 + 0.05 * k, 0.05 * k * k + 2.0 * kPi * k * (static_cast<double>(n) - 10.37) / 32.0);
    }
    r[n] = Cf32(sum);
  }
  const auto index = largest_sample(r);
  ASSERT_TRUE(index);
  const auto peak = PeakRefiner().refine(r, *index, PeakBoundary::kCircular);
  ASSERT_TRUE(peak);
  EXPECT_NEAR(static_cast<double>(*index) + peak->offset_samples, 10.193032, 1e-4);
  EXPECT_NEAR(peak->magnitude, 10.731639, 1e-3);
}

}  // namespace
}  // namespace soopnav::dsp
