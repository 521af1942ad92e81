#include "soopnav/core/epoch.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <limits>

#include "support/nan.hpp"

namespace soopnav {
namespace {

using ::soopnav::test::kNan;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::int64_t kMaxSeconds = std::numeric_limits<std::int64_t>::max();
constexpr std::int64_t kMinSeconds = std::numeric_limits<std::int64_t>::min();

TEST(Epoch, FractionIsBroughtIntoRange) {
  const Epoch late(TimeScale::kGps, 10, 2.75);
  EXPECT_EQ(late.seconds(), 12);
  EXPECT_EQ(late.fraction_s(), 0.75);
  const Epoch early(TimeScale::kGps, 10, -0.25);
  EXPECT_EQ(early.seconds(), 9);
  EXPECT_EQ(early.fraction_s(), 0.75);
  const Epoch just_before(TimeScale::kGps, 10, -1e-20);  // rounds up to the second
  EXPECT_EQ(just_before.seconds(), 10);
  EXPECT_EQ(just_before.fraction_s(), 0.0);
}

TEST(Epoch, DifferenceIsSharpWhereADoubleIsNot) {
  const std::int64_t today = 1'795'219'200;
  const Epoch a(TimeScale::kUtc, today, 0.1);
  const Epoch b(TimeScale::kUtc, today + 1, 0.1 + 1e-12);
  ASSERT_TRUE(b - a);
  EXPECT_NEAR(*(b - a), 1.0 + 1e-12, 2e-16);
  EXPECT_EQ(*(a - b), -*(b - a));
  EXPECT_NE(b.seconds_since_origin() - a.seconds_since_origin(), *(b - a));  // what the class is for
}

TEST(Epoch, AddingAndSubtractingComeBack) {
  const Epoch start(TimeScale::kTai, 1'700'000'000, 0.625);
  for (const double dt : {1e-13, 1e-9, 0.4, 0.375, 1.0, 1234.5678901234, -0.7, -3600.000000001, 5e9}) {
    const Epoch moved = start + dt;
    ASSERT_TRUE(moved - start) << dt;
    EXPECT_NEAR(*(moved - start), dt, 2e-16 + 2e-16 * std::abs(dt)) << dt;
    EXPECT_NEAR(*((moved - dt) - start), 0.0, 3e-16) << dt;
  }
  Epoch stepped = start;
  for (int i = 0; i < 1000; ++i) stepped += 0.001;
  EXPECT_NEAR(*(stepped - start), 1.0, 1000 * 1.2e-16);
  stepped -= 1.0;
  EXPECT_NEAR(*(stepped - start), 0.0, 1000 * 1.2e-16);
}

TEST(Epoch, OrderWithinAScale) {
  const Epoch a(TimeScale::kGps, 5, 0.25);
  EXPECT_LT(a, Epoch(TimeScale::kGps, 5, 0.5));
  EXPECT_LT(a, Epoch(TimeScale::kGps, 6, 0.0));
  EXPECT_GT(a, Epoch(TimeScale::kGps, -6, 0.9));
  EXPECT_EQ(a, Epoch(TimeScale::kGps, 4, 1.25));
  EXPECT_LE(a, a);
}

TEST(Epoch, ScalesDoNotMix) {
  const Epoch gps(TimeScale::kGps, 5, 0.0);
  const Epoch utc(TimeScale::kUtc, 5, 0.0);
  EXPECT_FALSE(gps - utc);
  EXPECT_FALSE(gps == utc);
  EXPECT_FALSE(gps < utc);
  EXPECT_FALSE(gps > utc);
  EXPECT_EQ(gps <=> utc, std::partial_ordering::unordered);
}

TEST(Epoch, WhatIsNoTimeIsInvalidAndStaysSo) {
  const Epoch good(TimeScale::kGps, 5, 0.0);
  const Epoch bad[] = {Epoch(TimeScale::kGps, 0, kNan),
                       Epoch(TimeScale::kGps, 0, kInfinity),
                       Epoch(TimeScale::kGps, kMaxSeconds, 1.0),
                       Epoch(TimeScale::kGps, kMinSeconds, -1.0),
                       Epoch::from_seconds(TimeScale::kGps, 1e19),
                       good + kNan,
                       good + kInfinity,
                       good - 1e300,
                       Epoch::invalid(TimeScale::kGps)};
  for (const Epoch& epoch : bad) {
    EXPECT_FALSE(epoch.is_valid());
    EXPECT_EQ(epoch.scale(), TimeScale::kGps);
    EXPECT_FALSE((epoch + 1.0).is_valid());
    EXPECT_FALSE(epoch - good);
    EXPECT_FALSE(epoch == epoch);
    EXPECT_TRUE(std::isnan(epoch.seconds_since_origin()));
  }
  EXPECT_TRUE(good.is_valid());
}

TEST(Epoch, DifferencesAcrossAllOfTimeDoNotOverflow) {
  const Epoch last(TimeScale::kTai, kMaxSeconds, 0.5);
  const Epoch first(TimeScale::kTai, kMinSeconds, 0.5);
  EXPECT_DOUBLE_EQ(*(last - first), 18446744073709551615.0);
  EXPECT_DOUBLE_EQ(*(first - last), -18446744073709551615.0);
  EXPECT_GT(last, first);
}

TEST(Epoch, SamplesOfACapture) {
  EXPECT_EQ(Epoch::of_sample(0, 19.2e6), Epoch());
  const Epoch half = Epoch::of_sample(9'600'000, 19.2e6);
  EXPECT_EQ(half.scale(), TimeScale::kCapture);
  EXPECT_EQ(half.seconds(), 0);
  EXPECT_EQ(half.fraction_s(), 0.5);
  // The 10^15-th sample and the next: index / rate as a double would step by 7 ns there.
  const std::int64_t far = 1'000'000'000'000'000;
  EXPECT_NEAR(*(Epoch::of_sample(far + 1, 19.2e6) - Epoch::of_sample(far, 19.2e6)), 1.0 / 19.2e6, 4e-16);
  EXPECT_EQ(Epoch::of_sample(19'200'000 * std::int64_t{100'000'000} + 1, 19.2e6).seconds(), 100'000'000);
  const Epoch before = Epoch::of_sample(-1, 4.0);
  EXPECT_EQ(before.seconds(), -1);
  EXPECT_EQ(before.fraction_s(), 0.75);
  for (const double rate : {0.0, -1.0, kNan, kInfinity}) EXPECT_FALSE(Epoch::of_sample(1, rate).is_valid()) << rate;
}

TEST(Epoch, ScalesHaveNames) {
  EXPECT_EQ(to_string(TimeScale::kCapture), "capture");
  EXPECT_EQ(to_string(TimeScale::kGps), "GPS");
  EXPECT_EQ(to_string(TimeScale::kUtc), "UTC");
  EXPECT_EQ(to_string(TimeScale::kTai), "TAI");
  EXPECT_EQ(to_string(static_cast<TimeScale>(77)), "unknown");
}

}  // namespace
}  // namespace soopnav
