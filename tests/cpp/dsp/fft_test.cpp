#include "soopnav/dsp/fft.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>
#include <string>
#include <thread>

#include "dsp/signals.hpp"

namespace soopnav::dsp {
namespace {

using testing::Cf64;
using testing::noise;

// The definition, in double precision.
std::vector<Cf64> direct_dft(std::span<const Cf32> x, double sign) {
  const std::size_t n = x.size();
  std::vector<Cf64> root(n), out(n);
  for (std::size_t k = 0; k < n; ++k) {
    root[k] = std::polar(1.0, sign * 2.0 * std::numbers::pi * static_cast<double>(k) / static_cast<double>(n));
  }
  for (std::size_t k = 0; k < n; ++k) {
    for (std::size_t i = 0; i < n; ++i) out[k] += Cf64(x[i]) * root[k * i % n];
  }
  return out;
}

double relative_error(std::span<const Cf32> got, const std::vector<Cf64>& want) {
  double error = 0.0, scale = 0.0;
  for (std::size_t i = 0; i < want.size(); ++i) {
    error += std::norm(Cf64(got[i]) - want[i]);
    scale += std::norm(want[i]);
  }
  return std::sqrt(error / scale);
}

class FftSizes : public ::testing::TestWithParam<int> {};

TEST_P(FftSizes, EqualsTheDefinitionForEveryAlignmentAndInPlace) {
  const int size = GetParam();
  const auto length = static_cast<std::size_t>(size);
  for (const FftDirection direction : {FftDirection::kForward, FftDirection::kInverse}) {
    const Fft fft(size, direction);
    EXPECT_EQ(fft.size(), size);
    EXPECT_EQ(fft.direction(), direction);
    const double sign = direction == FftDirection::kForward ? -1.0 : 1.0;
    for (const std::size_t in_shift : {0U, 1U}) {
      const std::vector<Cf32> input = noise(length + 1, 7);
      const auto want = direct_dft(std::span(input).subspan(in_shift, length), sign);
      for (const std::size_t out_shift : {0U, 1U}) {
        std::vector<Cf32> in = input, out(length + 1);
        fft.execute(in.data() + in_shift, out.data() + out_shift);
        EXPECT_LT(relative_error(std::span(out).subspan(out_shift), want), 3e-7);
        EXPECT_EQ(in, input) << "the input was changed";
      }
      std::vector<Cf32> both = input;
      fft.execute(both.data() + in_shift, both.data() + in_shift);
      EXPECT_LT(relative_error(std::span(both).subspan(in_shift), want), 3e-7);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Sizes, FftSizes,
                         ::testing::Values(1, 2, 3, 4, 5, 7, 8, 12, 31, 37, 64, 75, 128, 137, 360, 1200, 1536));

TEST(Fft, ForwardThenInverseMultipliesByTheSize) {
  const int size = 1920;
  const auto x = noise(static_cast<std::size_t>(size), 3);
  std::vector<Cf32> y(x.size());
  Fft(size, FftDirection::kForward).execute(x.data(), y.data());
  Fft(size, FftDirection::kInverse).execute(y.data(), y.data());
  for (Cf32& v : y) v /= static_cast<float>(size);
  EXPECT_LT(testing::largest_difference(x, y), 1e-6);
}

TEST(Fft, PositiveFrequencyFallsIntoItsBin) {
  const int size = 64;
  std::vector<Cf32> x(64), y(64);
  for (std::size_t n = 0; n < 64; ++n) x[n] = Cf32(std::polar(1.0, 2.0 * std::numbers::pi * 5.0 * double(n) / 64.0));
  Fft(size, FftDirection::kForward).execute(x.data(), y.data());
  for (std::size_t k = 0; k < 64; ++k) EXPECT_NEAR(std::abs(y[k]), k == 5 ? 64.0F : 0.0F, 1e-4F) << k;
}

TEST(Fft, OnePlanServesManyThreads) {
  const int size = 2310;  // a factor of 11 takes KissFFT's path with shared scratch
  const auto length = static_cast<std::size_t>(size);
  const Fft fft(size, FftDirection::kForward);
  std::vector<std::vector<Cf32>> inputs, wanted;
  for (unsigned t = 0; t < 6; ++t) {
    inputs.push_back(noise(length, t));
    wanted.emplace_back(length);
    fft.execute(inputs.back().data(), wanted.back().data());
  }
  std::vector<int> wrong(6, 0);
  std::vector<std::thread> threads;
  for (std::size_t t = 0; t < 6; ++t) {
    threads.emplace_back([&, t] {
      std::vector<Cf32> out(length);
      for (int repeat = 0; repeat < 40; ++repeat) {
        if (repeat % 2 == 0) {
          fft.execute(inputs[t].data(), out.data());
        } else {
          out = inputs[t];
          fft.execute(out.data(), out.data());
        }
        if (testing::largest_difference(out, wanted[t]) > 1e-3) ++wrong[t];
        const Fft planned_meanwhile(64 + repeat, FftDirection::kInverse);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_THAT(wrong, ::testing::Each(0));
}

TEST(Fft, Moves) {
  Fft a(8, FftDirection::kForward);
  Fft b = std::move(a);
  EXPECT_EQ(b.size(), 8);
  b = Fft(16, FftDirection::kInverse);
  EXPECT_EQ(b.size(), 16);
}

TEST(Fft, RefusesSizesBelowOne) {
  for (const int size : {0, -5}) {
    try {
      const Fft fft(size, FftDirection::kForward);
      FAIL() << "accepted " << size;
    } catch (const std::invalid_argument& error) {
      EXPECT_THAT(error.what(), ::testing::AllOf(::testing::HasSubstr("size"), ::testing::HasSubstr("at least 1"),
                                                 ::testing::HasSubstr(std::to_string(size))));
    }
  }
}

TEST(Fft, NamesItsLibrary) { EXPECT_STREQ(fft_library(), SOOPNAV_TEST_FFT); }

TEST(FastFftSize, IsTheSmallestWithoutLargePrimes) {
  const auto is_fast = [](int n) {
    for (const int prime : {2, 3, 5}) {
      while (n % prime == 0) n /= prime;
    }
    return n == 1;
  };
  for (int minimum = 1; minimum <= 4000; ++minimum) {
    int want = minimum;
    while (!is_fast(want)) ++want;
    ASSERT_EQ(fast_fft_size(minimum), want) << minimum;
  }
  EXPECT_EQ(fast_fft_size(153601), 155520);
  EXPECT_EQ(fast_fft_size(1 << 30), 1 << 30);
}

TEST(FastFftSize, Refuses) {
  EXPECT_THROW((void)fast_fft_size(0), std::invalid_argument);
  EXPECT_THROW((void)fast_fft_size(-1), std::invalid_argument);
  EXPECT_THROW((void)fast_fft_size(2147483647), std::invalid_argument);
}

}  // namespace
}  // namespace soopnav::dsp
