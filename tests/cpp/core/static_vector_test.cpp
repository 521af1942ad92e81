#include "soopnav/core/static_vector.hpp"

#include <gtest/gtest.h>

#include <numeric>
#include <span>
#include <type_traits>

namespace soopnav {
namespace {

using Four = StaticVector<int, 4>;
static_assert(std::is_trivially_copyable_v<Four>);

Four of(std::initializer_list<int> values) {
  Four v;
  for (const int value : values) EXPECT_TRUE(v.push_back(value));
  return v;
}

TEST(StaticVector, StartsEmpty) {
  const Four v;
  EXPECT_TRUE(v.empty());
  EXPECT_EQ(v.size(), 0U);
  EXPECT_EQ(v.begin(), v.end());
  EXPECT_EQ(Four::capacity(), 4U);
}

TEST(StaticVector, RefusesWhatDoesNotFit) {
  Four v = of({1, 2, 3, 4});
  EXPECT_TRUE(v.full());
  EXPECT_FALSE(v.push_back(5));
  EXPECT_FALSE(v.resize(5));
  EXPECT_EQ(v, of({1, 2, 3, 4}));
}

TEST(StaticVector, ResizeFillsOnlyTheNew) {
  Four v = of({1});
  EXPECT_TRUE(v.resize(3, 7));
  EXPECT_EQ(v, of({1, 7, 7}));
  EXPECT_TRUE(v.resize(1));
  EXPECT_TRUE(v.resize(2));
  EXPECT_EQ(v, of({1, 0}));  // not the 7 that was there
}

TEST(StaticVector, EraseKeepsTheOrder) {
  Four v = of({1, 2, 3, 4});
  v.erase_at(1);
  EXPECT_EQ(v, of({1, 3, 4}));
  v.erase_at(2);
  EXPECT_EQ(v, of({1, 3}));
  v.erase_at(0);
  EXPECT_EQ(v, of({3}));
  v.pop_back();
  EXPECT_TRUE(v.empty());
}

TEST(StaticVector, IsARangeAndASpan) {
  Four v = of({1, 2, 3});
  EXPECT_EQ(std::accumulate(v.begin(), v.end(), 0), 6);
  const std::span<int> span(v);
  EXPECT_EQ(span.size(), 3U);
  span[1] = 20;
  EXPECT_EQ(v[1], 20);
  EXPECT_EQ(v.front(), 1);
  EXPECT_EQ(v.back(), 3);
}

TEST(StaticVector, EqualityLooksAtSizeAndElements) {
  EXPECT_NE(of({1, 2}), of({1, 2, 3}));
  EXPECT_NE(of({1, 2}), of({1, 3}));
  Four shortened = of({1, 2, 3});
  shortened.pop_back();
  EXPECT_EQ(shortened, of({1, 2}));
}

}  // namespace
}  // namespace soopnav
