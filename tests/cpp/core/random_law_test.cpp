// What holds between draws: fills equal single draws, shares equal the whole, substreams and kinds do not meet.

#include <gtest/gtest.h>

#include <cstdint>
#include <set>
#include <thread>
#include <vector>

#include "soopnav/core/random.hpp"

namespace soopnav {
namespace {

// Sizes around a block (2 or 4 draws) and a batch of the kernels (64 or 128), from every offset within a block.
constexpr std::size_t kSizes[] = {0, 1, 2, 3, 5, 63, 64, 65, 127, 128, 129, 300};
constexpr std::uint64_t kStarts[] = {0, 1, 2, 3, 62, 1'000'000'007, (std::uint64_t{1} << 33) - 5};

template <class T, class Fill, class One>
void expect_fill_equals_single(Fill fill, One one) {
  for (const std::uint64_t start : kStarts) {
    for (const std::size_t size : kSizes) {
      RandomStream a(123, 45);
      RandomStream b(123, 45);
      a.seek(start);
      b.seek(start);
      std::vector<T> filled(size);
      fill(a, filled);
      for (std::size_t i = 0; i < size; ++i) ASSERT_EQ(filled[i], one(b)) << "start " << start << ", draw " << i;
      ASSERT_EQ(a.position(), b.position());
    }
  }
}

TEST(RandomStreamLaw, FillsEqualSingleDraws) {
  expect_fill_equals_single<std::uint64_t>([](RandomStream& r, std::vector<std::uint64_t>& v) { r.fill_u64(v); },
                                           [](RandomStream& r) { return r.next_u64(); });
  expect_fill_equals_single<std::uint32_t>([](RandomStream& r, std::vector<std::uint32_t>& v) { r.fill_u32(v); },
                                           [](RandomStream& r) { return r.next_u32(); });
  expect_fill_equals_single<double>([](RandomStream& r, std::vector<double>& v) { r.fill_uniform(v); },
                                    [](RandomStream& r) { return r.uniform(); });
  expect_fill_equals_single<double>([](RandomStream& r, std::vector<double>& v) { r.fill_normal(std::span(v)); },
                                    [](RandomStream& r) { return r.normal(); });
  expect_fill_equals_single<float>([](RandomStream& r, std::vector<float>& v) { r.fill_normal(std::span(v)); },
                                   [](RandomStream& r) { return r.normal_float(); });
}

TEST(RandomStreamLaw, ComplexFillIsTwoScaledNormals) {
  RandomStream a(7);
  RandomStream b(7);
  std::vector<Cf32> filled(333);
  a.fill_complex_normal(filled, 8.0);
  for (const Cf32 x : filled) {
    const float re = 2.0F * b.normal_float();
    const float im = 2.0F * b.normal_float();
    ASSERT_EQ(x, Cf32(re, im));
  }
  EXPECT_EQ(a.position(), b.position());
  std::vector<Cf32> added(333, Cf32(1.0F, 1.0F));
  RandomStream c(7);
  c.add_complex_normal(added, 8.0);
  for (std::size_t i = 0; i < added.size(); ++i) ASSERT_EQ(added[i], Cf32(1.0F, 1.0F) + filled[i]);
}

TEST(RandomStreamLaw, SharesOfThreadsEqualTheWhole) {
  constexpr std::size_t kDraws = 10'001;
  std::vector<float> whole(kDraws);
  RandomStream alone(99, 3);
  alone.fill_normal(std::span(whole));
  for (const std::size_t n_threads : {2U, 3U, 7U}) {
    std::vector<float> shared(kDraws);
    std::vector<std::thread> threads;
    for (std::size_t t = 0; t < n_threads; ++t) {
      threads.emplace_back([&shared, t, n_threads] {
        const std::size_t begin = kDraws * t / n_threads;
        const std::size_t end = kDraws * (t + 1) / n_threads;
        RandomStream mine(99, 3);
        mine.seek(begin);
        mine.fill_normal(std::span(shared).subspan(begin, end - begin));
      });
    }
    for (std::thread& thread : threads) thread.join();
    EXPECT_EQ(shared, whole) << n_threads << " threads";
  }
}

TEST(RandomStreamLaw, SubstreamsAreTheirOwn) {
  const RandomStream parent(11, 22);
  std::set<std::uint64_t> words;
  std::size_t drawn = 0;
  const auto draw = [&](RandomStream stream) {
    for (int i = 0; i < 8; ++i, ++drawn) words.insert(stream.next_u64());
  };
  draw(parent);
  for (std::uint64_t i = 0; i < 500; ++i) {
    draw(parent.substream(i));
    draw(parent.substream(i).substream(i));
    draw(parent.substream(i).substream(i + 1));
    draw(RandomStream(11, 23).substream(i));
    draw(RandomStream(12, 22).substream(i));
  }
  EXPECT_EQ(words.size(), drawn);  // any two equal by chance: 1e-11
}

TEST(RandomStreamLaw, SubstreamsDoNotDependOnThePosition) {
  RandomStream parent(11, 22);
  const RandomStream before = parent.substream(5);
  parent.skip(1000);
  EXPECT_EQ(parent.substream(5), before);
  EXPECT_EQ(before.position(), 0U);
}

// A uniform and a normal at one position share no random bits: the sign and the size of the normal do not follow it.
TEST(RandomStreamLaw, KindsAtOnePositionAreIndependent) {
  constexpr int kDraws = 100'000;
  double with_uniform = 0.0;
  double with_float = 0.0;
  double squares = 0.0;
  for (int i = 0; i < kDraws; ++i) {
    RandomStream a(3);
    a.seek(static_cast<std::uint64_t>(i));
    RandomStream b = a;
    RandomStream c = a;
    const double u = a.uniform() - 0.5;
    const double x = b.normal();
    with_uniform += u * x;
    squares += u * (x * x - 1.0);
    with_float += static_cast<double>(c.normal_float()) * x;
  }
  // Five standard deviations: 6e-7 each.
  const double root = std::sqrt(static_cast<double>(kDraws));
  EXPECT_LT(std::abs(with_uniform), 5.0 * root * std::sqrt(1.0 / 12.0));
  EXPECT_LT(std::abs(squares), 5.0 * root * std::sqrt(2.0 / 12.0));
  EXPECT_LT(std::abs(with_float), 5.0 * root);
}

}  // namespace
}  // namespace soopnav
