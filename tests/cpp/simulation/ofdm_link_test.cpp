// The simulated OFDM link: laws of its movements, what is refused, and that measuring allocates nothing per epoch.

#include "soopnav/simulation/ofdm_link.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/simulation/channel.hpp"
#include "support/allocation_count.hpp"
#include "support/nan.hpp"

namespace soopnav::simulation {
namespace {

using testing::StartsWith;

using ::soopnav::test::kNan;
const ofdm::Numerology kNumerology{};
const double kFineM = kNumerology.sample_m() / 15.0;

OfdmLinkOptions options(int oversampling, Movement movement) {
  OfdmLinkOptions out;
  out.oversampling = oversampling;
  out.movement = movement;
  return out;
}

std::vector<Cf32> epoch(OfdmLink& link, double delay_m, std::optional<double> snr_db = std::nullopt,
                        const std::optional<Reflection>& reflection = std::nullopt) {
  std::vector<Cf32> out(link.epoch_samples());
  link.epoch(delay_m, RandomStream(5), out, snr_db, reflection);
  return out;
}

double difference_db(const std::vector<Cf32>& a, const std::vector<Cf32>& b) {
  double error = 0.0, power = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    error += static_cast<double>(std::norm(a[i] - b[i]));
    power += static_cast<double>(std::norm(a[i]));
  }
  return decibels(error / power + 1e-30);
}

template <class Call>
std::string refusal(Call&& call) {
  try {
    call();
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

TEST(OfdmLinkLaw, DelayZeroIsTheStringItselfAndAWholeSampleGoesRound) {
  for (const auto movement : {Movement::kInterpolateAndShift, Movement::kFractionalDelay}) {
    OfdmLink link(kNumerology, 20, options(1, movement));
    const auto still = epoch(link, 0.0);
    EXPECT_NEAR(mean_power(still), 1.0, 0.05);
    for (std::size_t i = 0; i < 16; ++i) EXPECT_LT(std::abs(still[i] - still[64 + i]), 1e-5F);  // a prefix
    const auto later = epoch(link, 1.0001 * kNumerology.sample_m());
    std::vector<Cf32> expected(still.begin() + 1, still.end() - 1);
    const std::vector<Cf32> moved(later.begin() + 2, later.end());
    EXPECT_LT(difference_db(expected, moved), movement == Movement::kInterpolateAndShift ? -120.0 : -60.0);
  }
}

TEST(OfdmLinkLaw, TheCriticalReceiverTakesEachFifteenthSample) {
  for (const auto movement : {Movement::kInterpolateAndShift, Movement::kFractionalDelay}) {
    OfdmLink slow(kNumerology, 20, options(1, movement)), fast(kNumerology, 20, options(15, movement));
    for (const double delay_m : {0.0, 7.3, 441.7, -3.2, 5000.0}) {
      const Reflection reflection{123.4, {0.3, -0.9}};
      const auto few = epoch(slow, delay_m, std::nullopt, reflection);
      const auto many = epoch(fast, delay_m, std::nullopt, reflection);
      ASSERT_EQ(many.size(), 15 * few.size());
      std::vector<Cf32> fifteenth(few.size());
      for (std::size_t i = 0; i < few.size(); ++i) fifteenth[i] = many[15 * i];
      EXPECT_LT(difference_db(few, fifteenth), -100.0) << delay_m;
    }
  }
}

TEST(OfdmLinkLaw, ShiftsByWholeFineSamplesRoundedDown) {
  OfdmLink link(kNumerology, 4, options(15, Movement::kInterpolateAndShift));
  const auto still = epoch(link, 0.0);
  for (const long long shift : {1LL, 7LL, 1199LL, -4LL, 7000LL}) {
    const auto moved = epoch(link, (static_cast<double>(shift) + 0.999) * kFineM);
    const auto n = static_cast<long long>(still.size());
    for (long long i = 0; i < n; i += 13) {
      const auto from = static_cast<std::size_t>((((i - shift) % n) + n) % n);
      ASSERT_EQ(moved[static_cast<std::size_t>(i)], still[from]) << shift << " " << i;
    }
  }
}

TEST(OfdmLinkLaw, InterpolationAgreesWithTheExactOneWhereTheSignalHasNoEdge) {
  // Eight taps against the whole string: the outermost subcarriers are what an 8-tap filter cannot keep.
  OfdmLink shifted(kNumerology, 41, options(1, Movement::kInterpolateAndShift));
  OfdmLink exact(kNumerology, 41, options(1, Movement::kFractionalDelay));  // 42 symbols: the same circle
  const auto a = epoch(exact, 7.0 * kFineM), b = epoch(shifted, 7.5 * kFineM);
  EXPECT_LT(difference_db(a, b), -10.0);
  EXPECT_GT(difference_db(a, b), -30.0);
}

TEST(OfdmLinkLaw, AReflectionIsASecondPathAndNoiseHasItsPower) {
  for (const auto movement : {Movement::kInterpolateAndShift, Movement::kFractionalDelay}) {
    OfdmLink link(kNumerology, 20, options(1, movement));
    const auto direct = epoch(link, 30.0), second = epoch(link, 230.0);
    const auto both = epoch(link, 30.0, std::nullopt, Reflection{200.0, {0.6, 0.8}});
    std::vector<Cf32> sum(direct.size());
    for (std::size_t i = 0; i < sum.size(); ++i) sum[i] = direct[i] + Cf32(0.6F, 0.8F) * second[i];
    EXPECT_LT(difference_db(both, sum), -100.0);
    const auto noisy = epoch(link, 30.0, -3.0);
    EXPECT_NEAR(difference_db(direct, noisy), 3.0, 0.6);  // 1680 samples: 4 sigma are 0.43 dB
  }
  auto with_cfo = options(15, Movement::kInterpolateAndShift);
  with_cfo.cfo_hz = 20e3;
  with_cfo.band_limited_noise = true;
  OfdmLink link(kNumerology, 60, with_cfo);
  const auto noisy = epoch(link, 0.0, 10.0);
  ofdm::BoundaryEstimator estimator(kNumerology, 60, 15);
  const auto boundary = estimator.estimate(noisy);
  EXPECT_NEAR(boundary.cfo_hz, 20e3, 2e3);  // sigma 260 Hz
  EXPECT_NEAR(boundary.metric, 1.0 / 1.1, 0.03);
}

TEST(OfdmLinkMeasure, SameBitsForAnyNumberOfThreadsAndAsEpochByEpoch) {
  const std::vector<double> delays{0.0, 100.0, 333.3, 1000.0, 1300.0, 20.0, 7.0};
  std::vector<Reflection> reflections(delays.size());
  reflections[2] = {300.0, {0.0, 1.2}};
  OfdmLink::Measure how;
  how.snr_db = 10.0;
  how.folded = true;
  how.method = ofdm::BoundaryMethod::kInterpolated;
  OfdmLink link(kNumerology, 50, options(1, Movement::kFractionalDelay));
  const auto one = link.measure(delays, reflections, RandomStream(9), how);
  how.threads = 3;
  const auto three = link.measure(delays, reflections, RandomStream(9), how);
  EXPECT_EQ(one.range_m, three.range_m);
  EXPECT_EQ(one.sigma_m, three.sigma_m);
  EXPECT_EQ(one.metric, three.metric);
  EXPECT_EQ(one.folded, three.folded);
  ofdm::BoundaryEstimator estimator(kNumerology, 50, 1, {how.method, std::nullopt});
  std::vector<Cf32> iq(link.epoch_samples());
  for (std::size_t e = 0; e < delays.size(); ++e) {
    std::optional<Reflection> reflection;
    if (e == 2) reflection = reflections[e];
    link.epoch(delays[e], RandomStream(9).substream(e), iq, how.snr_db, reflection);
    EXPECT_EQ(estimator.estimate(iq).boundary_m, one.range_m[e]);
    EXPECT_EQ(one.status[e], ofdm::BoundaryStatus::kOk);
  }
  EXPECT_TRUE(link.measure({}, {}, RandomStream(9), how).range_m.empty());
}

TEST(OfdmLinkRefusals, NameTheParameterItsValueAndTheRule) {
  EXPECT_THAT(refusal([] { OfdmLink(kNumerology, 0); }), StartsWith("symbols: 0; it must be 1 to 65536"));
  EXPECT_THAT(refusal([] { OfdmLink(kNumerology, 20, options(3, Movement::kFractionalDelay)); }),
              StartsWith("oversampling: 3; it must be 1 or 15"));
  EXPECT_THAT(refusal([] { OfdmLink({4096, 300, 1e6}, 60000); }), StartsWith("symbols: 60000; an epoch"));
  EXPECT_THAT(refusal([] { OfdmLink({0, 0, 1e6}, 2); }), StartsWith("subcarriers: 0"));
  OfdmLink link(kNumerology, 2);
  EXPECT_THAT(refusal([&] { epoch(link, kNan); }), StartsWith("delay_m: nan"));
  EXPECT_THAT(refusal([&] { epoch(link, 0.0, kNan); }), StartsWith("snr_db: nan"));
  EXPECT_THAT(refusal([&] { epoch(link, 0.0, 0.0, Reflection{kNan, 1.0}); }), StartsWith("reflection extra_m: nan"));
  EXPECT_THAT(refusal([&] { epoch(link, 0.0, 0.0, Reflection{1.0, kNan}); }), StartsWith("reflection gain: nan"));
  std::vector<Cf32> few(3);
  EXPECT_THAT(refusal([&] { link.epoch(0.0, RandomStream(1), few); }), StartsWith("out.size(): 3"));
  OfdmLink::Measure how;
  how.threads = 0;
  const std::vector<double> delays{1.0};
  EXPECT_THAT(refusal([&] { static_cast<void>(link.measure(delays, {}, RandomStream(1), how)); }),
              StartsWith("threads: 0"));
  const std::vector<Reflection> two(2);
  EXPECT_THAT(refusal([&] { static_cast<void>(link.measure(delays, two, RandomStream(1), {})); }),
              StartsWith("reflections.size(): 2"));
}

TEST(OfdmLinkNoAlloc, Epochs) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  for (const auto movement : {Movement::kInterpolateAndShift, Movement::kFractionalDelay}) {
    for (const int oversampling : {1, 15}) {
      OfdmLink link(kNumerology, 20, options(oversampling, movement));
      std::vector<Cf32> out(link.epoch_samples());
      link.epoch(1.0, RandomStream(1), out);  // the first transform may set its library up
      EXPECT_EQ(test::allocations_of([&] { link.epoch(10.0, RandomStream(2), out, 3.0, Reflection{200.0, 0.5}); }), 0);
    }
  }
}

}  // namespace
}  // namespace soopnav::simulation
