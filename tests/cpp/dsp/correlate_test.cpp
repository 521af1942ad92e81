#include "soopnav/dsp/correlate.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <ostream>
#include <stdexcept>
#include <tuple>

#include "dsp/signals.hpp"

namespace soopnav::dsp {

static void PrintTo(FilterKind kind, std::ostream* stream) {
  *stream << (kind == FilterKind::kConvolution ? "convolution" : "correlation");
}

namespace {

using testing::Cf64;
using testing::largest_difference;
using testing::noise;

// The definitions of FilterKind, in double precision.
std::vector<Cf32> direct(std::span<const Cf32> x, std::span<const Cf32> h, FilterKind kind, std::int64_t first,
                         std::size_t count) {
  std::vector<Cf32> y(count);
  for (std::size_t i = 0; i < count; ++i) {
    const std::int64_t n = first + static_cast<std::int64_t>(i);
    Cf64 sum{};
    for (std::size_t k = 0; k < h.size(); ++k) {
      const auto lag = static_cast<std::int64_t>(k);
      const std::int64_t at = kind == FilterKind::kConvolution ? n - lag : n + lag;
      if (at < 0 || at >= static_cast<std::int64_t>(x.size())) continue;
      const Cf64 tap(h[k]);
      sum += (kind == FilterKind::kConvolution ? tap : std::conj(tap)) * Cf64(x[static_cast<std::size_t>(at)]);
    }
    y[i] = Cf32(sum);
  }
  return y;
}

double tolerance(std::span<const Cf32> h) {
  double sum = 0.0;
  for (const Cf32& tap : h) sum += std::abs(Cf64(tap));
  return 1e-5 * std::sqrt(2.0) * sum;
}

struct Case {
  std::size_t n_in, n_kernel;
  int fft_size;
};

std::ostream& operator<<(std::ostream& stream, const Case& c) {
  return stream << c.n_in << "x" << c.n_kernel << "_fft" << c.fft_size;
}

class OverlapSaveCases : public ::testing::TestWithParam<std::tuple<Case, FilterKind>> {};

TEST_P(OverlapSaveCases, EqualsTheDirectSum) {
  const auto [c, kind] = GetParam();
  const auto x = noise(c.n_in, 1);
  const auto h = noise(c.n_kernel, 2);
  OverlapSave filter(h, kind, c.fft_size);
  EXPECT_EQ(filter.kernel_size(), c.n_kernel);
  EXPECT_EQ(filter.block_size(), static_cast<std::size_t>(filter.fft_size()) - c.n_kernel + 1);
  const auto all = static_cast<std::int64_t>(c.n_in + c.n_kernel);
  // The whole, parts of it, and ranges that lie beside the capture.
  for (const auto& [first, count] : std::vector<std::pair<std::int64_t, std::size_t>>{
           {0, c.n_in}, {-all - 3, c.n_in + 3 * c.n_kernel + 9}, {5, 17}, {all + 40, 8}, {-3 * all, 5}, {0, 0}}) {
    std::vector<Cf32> y(count, Cf32(9.0F, 9.0F));
    filter.apply(x, first, y);
    EXPECT_LT(largest_difference(y, direct(x, h, kind, first, count)), tolerance(h)) << first << " " << count;
  }
}

TEST_P(OverlapSaveCases, StreamGivesTheSameForAnyCut) {
  const auto [c, kind] = GetParam();
  const auto x = noise(c.n_in, 1);
  const auto h = noise(c.n_kernel, 2);
  OverlapSave filter(h, kind, c.fft_size);
  const std::size_t total = c.n_in == 0 ? 0 : (kind == FilterKind::kConvolution ? c.n_in + c.n_kernel - 1 : c.n_in);
  const auto want = direct(x, h, kind, 0, total);
  for (const std::size_t cut : {std::size_t{1}, std::size_t{7}, std::size_t{100}, std::size_t{100000}}) {
    std::vector<Cf32> y;
    for (std::size_t at = 0; at < x.size(); at += cut) {
      const auto block = std::span(x).subspan(at, std::min(cut, x.size() - at));
      std::vector<Cf32> out(filter.push_size(block.size()));
      EXPECT_EQ(filter.push(block, out), out.size());
      y.insert(y.end(), out.begin(), out.end());
    }
    std::vector<Cf32> out(filter.flush_size());
    EXPECT_EQ(filter.flush(out), out.size());
    y.insert(y.end(), out.begin(), out.end());
    EXPECT_LT(largest_difference(y, want), tolerance(h)) << "cut " << cut;
    EXPECT_EQ(filter.flush_size(), 0U);
  }
}

INSTANTIATE_TEST_SUITE_P(Sizes, OverlapSaveCases,
                         ::testing::Combine(::testing::Values(Case{0, 3, 0}, Case{1, 1, 0}, Case{1, 40, 0},
                                                              Case{50, 1, 1}, Case{300, 16, 16}, Case{300, 16, 17},
                                                              Case{1000, 63, 128}, Case{700, 137, 0},
                                                              Case{90, 256, 300}, Case{3000, 200, 0}),
                                            ::testing::Values(FilterKind::kConvolution, FilterKind::kCorrelation)));

TEST(OverlapSave, CorrelationPeaksWhereTheTemplateStarts) {
  const auto h = noise(100, 5);
  std::vector<Cf32> x(1000);
  std::copy(h.begin(), h.end(), x.begin() + 321);
  OverlapSave correlator(h, FilterKind::kCorrelation);
  std::vector<Cf32> y(x.size());
  correlator.apply(x, 0, y);
  double energy = 0.0;
  for (const Cf32& tap : h) energy += std::norm(Cf64(tap));
  const auto peak = std::max_element(y.begin(), y.end(), [](Cf32 a, Cf32 b) { return std::norm(a) < std::norm(b); });
  EXPECT_EQ(peak - y.begin(), 321);
  EXPECT_NEAR(peak->real(), energy, 1e-4 * energy);
  EXPECT_NEAR(peak->imag(), 0.0, 1e-4 * energy);
}

TEST(OverlapSave, PushLeavesTheStreamAloneWhenTheOutputIsTooShort) {
  const auto x = noise(500, 1);
  OverlapSave filter(noise(20, 2), FilterKind::kConvolution, 64);
  std::vector<Cf32> all(519);
  filter.apply(x, 0, all);
  std::vector<Cf32> out(600);
  std::size_t count = filter.push(std::span(x).first(200), out);
  EXPECT_THROW(filter.push(std::span(x).subspan(200), std::span(out).first(10)), std::invalid_argument);
  count += filter.push(std::span(x).subspan(200), std::span(out).subspan(count));
  EXPECT_THROW(filter.flush(std::span<Cf32>{}), std::invalid_argument);
  count += filter.flush(std::span(out).subspan(count));
  ASSERT_EQ(count, all.size());
  EXPECT_LT(largest_difference(std::span(out).first(count), all), 1e-4);
}

TEST(OverlapSave, ApplyLeavesTheStreamAlone) {
  const auto x = noise(300, 1);
  OverlapSave filter(noise(20, 2), FilterKind::kConvolution, 64);
  std::vector<Cf32> plain(319), mixed(319), other(50);
  std::size_t n = filter.push(x, plain);
  n += filter.flush(std::span(plain).subspan(n));
  ASSERT_EQ(n, plain.size());
  n = filter.push(std::span(x).first(100), mixed);
  filter.apply(noise(80, 9), 3, other);
  n += filter.push(std::span(x).subspan(100), std::span(mixed).subspan(n));
  n += filter.flush(std::span(mixed).subspan(n));
  EXPECT_EQ(plain, mixed);
}

TEST(OverlapSave, ResetForgets) {
  const auto x = noise(150, 1);
  OverlapSave filter(noise(20, 2), FilterKind::kCorrelation, 64);
  std::vector<Cf32> fresh(150), out(150), rest(400);
  std::size_t n = filter.push(x, fresh);
  filter.flush(std::span(fresh).subspan(n));
  filter.push(noise(70, 4), rest);
  filter.reset();
  n = filter.push(x, out);
  filter.flush(std::span(out).subspan(n));
  EXPECT_EQ(fresh, out);
}

TEST(OverlapSave, NanReachesOnlyItsBlock) {
  auto x = noise(1000, 1);
  x[500] = {std::numeric_limits<float>::quiet_NaN(), 0.0F};
  OverlapSave filter(noise(20, 2), FilterKind::kConvolution, 64);
  std::vector<Cf32> y(1000);
  filter.apply(x, 0, y);
  EXPECT_TRUE(std::isnan(y[500].real()));
  for (const std::size_t i : {0U, 300U, 436U, 600U, 999U}) EXPECT_TRUE(std::isfinite(y[i].real())) << i;
}

TEST(OverlapSave, Refuses) {
  const auto h = noise(16, 1);
  auto bad = h;
  bad[3] = {0.0F, std::numeric_limits<float>::infinity()};
  EXPECT_THROW(OverlapSave({}, FilterKind::kConvolution), std::invalid_argument);
  EXPECT_THROW(OverlapSave(bad, FilterKind::kConvolution), std::invalid_argument);
  EXPECT_THROW(OverlapSave(h, FilterKind::kConvolution, 15), std::invalid_argument);
  EXPECT_THROW(OverlapSave(h, FilterKind::kConvolution, -1), std::invalid_argument);
  EXPECT_NO_THROW(OverlapSave(h, FilterKind::kConvolution, 16));
}

}  // namespace
}  // namespace soopnav::dsp
