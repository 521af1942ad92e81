#include "soopnav/dsp/fractional_delay.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <ostream>
#include <stdexcept>

#include "dsp/signals.hpp"

namespace soopnav::dsp {

static void PrintTo(const SincDesign& design, std::ostream* stream) {
  *stream << design.passband << "_" << design.attenuation_db << "dB";
}

namespace {

using testing::Cf64;
using testing::db;
using testing::largest_difference;
using testing::noise;
using testing::Tones;

constexpr double kPi = std::numbers::pi;

// |H(w) - exp(-j w d)|: the error of a delay of `delay` on a tone of that angular frequency.
double tone_error(const FractionalDelay& filter, double w) {
  Cf64 response{};
  for (std::size_t k = 0; k < filter.taps().size(); ++k) {
    const auto lag = static_cast<double>(filter.first_tap() + static_cast<std::int64_t>(k));
    response += filter.taps()[k] * std::polar(1.0, -w * lag);
  }
  return std::abs(response - std::polar(1.0, -w * filter.delay_samples()));
}

class SincDesigns : public ::testing::TestWithParam<SincDesign> {};

TEST_P(SincDesigns, MeetTheirErrorAtEveryDelayAndFrequency) {
  const SincDesign design = GetParam();
  auto filter = FractionalDelay::windowed_sinc(0.0, design);
  double worst = 0.0;
  for (int i = 0; i <= 40; ++i) {
    ASSERT_TRUE(filter.set_delay(-3.0 + 0.0501 * i));
    for (int k = 0; k <= 100; ++k) worst = std::max(worst, tone_error(filter, kPi * design.passband * k / 100.0));
  }
  EXPECT_LE(db(worst), -design.attenuation_db);
  EXPECT_GE(db(worst), -design.attenuation_db - 25.0) << "far more taps than the design needs";
}

INSTANTIATE_TEST_SUITE_P(Designs, SincDesigns,
                         ::testing::Values(SincDesign{}, SincDesign{0.5, 40.0}, SincDesign{0.5, 80.0},
                                           SincDesign{0.5, 100.0}, SincDesign{0.8, 20.0}, SincDesign{0.8, 60.0},
                                           SincDesign{0.8, 110.0}, SincDesign{0.95, 80.0}, SincDesign{0.3, 60.0},
                                           SincDesign{0.99, 90.0}));

TEST(FractionalDelay, DelaysABandLimitedSignal) {
  const Tones signal(23, 0.8 * kPi, 4);
  const auto x = signal.sample(600);
  for (const double delay : {0.5, -0.5, 17.37, -40.9, 0.999999}) {
    const auto filter = FractionalDelay::windowed_sinc(delay);
    std::vector<Cf32> y(400);
    filter.apply(x, 100, y);
    double worst = 0.0;
    for (std::size_t i = 0; i < y.size(); ++i) {
      worst = std::max(worst, std::abs(Cf64(y[i]) - signal(100.0 + static_cast<double>(i) - delay)));
    }
    EXPECT_LT(db(worst), -80.0) << delay;
  }
}

TEST(FractionalDelay, AWholeDelayCopies) {
  const auto x = noise(50, 3);
  for (const std::int64_t delay : {std::int64_t{0}, std::int64_t{3}, std::int64_t{-4}}) {
    for (int order = 0; order <= 9; ++order) {
      const auto filter = order == 0 ? FractionalDelay::windowed_sinc(static_cast<double>(delay))
                                     : FractionalDelay::lagrange(static_cast<double>(delay), order);
      std::vector<Cf32> y(80);
      filter.apply(x, -10, y);
      for (std::size_t i = 0; i < y.size(); ++i) {
        const std::int64_t from = static_cast<std::int64_t>(i) - 10 - delay;
        const Cf32 want = from >= 0 && from < 50 ? x[static_cast<std::size_t>(from)] : Cf32{};
        EXPECT_EQ(y[i], want) << i << " delay " << delay << " order " << order;
      }
    }
  }
}

TEST(FractionalDelay, IsZeroOutsideTheCapture) {
  const std::vector<Cf32> x(10, Cf32(1.0F, -1.0F));
  const auto filter = FractionalDelay::windowed_sinc(0.5);
  const auto reach = static_cast<std::int64_t>(filter.taps().size());
  std::vector<Cf32> y(20, Cf32(5.0F, 5.0F));
  filter.apply(x, -reach - 20, y);
  for (const Cf32& v : y) EXPECT_EQ(v, Cf32{});
  filter.apply(x, 10 + reach, y);
  for (const Cf32& v : y) EXPECT_EQ(v, Cf32{});
  y.assign(20, Cf32(5.0F, 5.0F));
  filter.apply({}, 0, y);
  for (const Cf32& v : y) EXPECT_EQ(v, Cf32{});
}

// The same outputs whether a range is made at once or in parts: edges and middle are different code.
TEST(FractionalDelay, PartsEqualTheWhole) {
  const auto x = noise(200, 8);
  for (const auto& filter : {FractionalDelay::windowed_sinc(1.3), FractionalDelay::lagrange(-2.4, 5)}) {
    std::vector<Cf32> whole(300), parts(300);
    filter.apply(x, -50, whole);
    for (std::size_t at = 0; at < 300; at += 7) {
      filter.apply(x, static_cast<std::int64_t>(at) - 50,
                   std::span(parts).subspan(at, std::min<std::size_t>(7, 300 - at)));
    }
    EXPECT_EQ(whole, parts);
  }
}

class LagrangeOrders : public ::testing::TestWithParam<int> {};

TEST_P(LagrangeOrders, AreExactForPolynomials) {
  const int order = GetParam();
  std::vector<double> taps(static_cast<std::size_t>(order) + 1);
  for (const double delay : {0.5 * order, 0.5 * order + 0.31, 0.5 * order - 0.47}) {
    lagrange_delay_taps(delay, taps);
    for (int degree = 0; degree <= order; ++degree) {
      double sum = 0.0, scale = 0.0;
      for (std::size_t k = 0; k < taps.size(); ++k) {
        const double term = taps[k] * std::pow(-static_cast<double>(k), degree);
        sum += term;
        scale += std::abs(term);
      }
      EXPECT_NEAR(sum, std::pow(-delay, degree), 1e-13 * (1.0 + scale)) << "degree " << degree;
    }
  }
}

TEST_P(LagrangeOrders, ErrByTheBoundOfTheRemainder) {
  const int order = GetParam();
  for (const double delay : {0.5, 0.25, -0.1, 7.4, 12.0 + 0.49}) {
    const auto filter = FractionalDelay::lagrange(delay, order);
    double product = 1.0;
    for (int k = 0; k <= order; ++k) product *= std::abs(delay - static_cast<double>(filter.first_tap() + k)) / (k + 1);
    EXPECT_LE(std::abs(delay - static_cast<double>(filter.first_tap()) - 0.5 * order), 0.5);
    for (const double w : {0.05, 0.3, 0.8, 1.5, 2.5}) {
      const double bound = product * std::pow(w, order + 1);
      const double error = tone_error(filter, w);
      EXPECT_LE(error, bound + 1e-14) << "order " << order << " delay " << delay << " w " << w;
      if (w < 0.2 && bound > 1e-12) {
        EXPECT_GE(error, 0.9 * bound) << "order " << order;
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Orders, LagrangeOrders, ::testing::Range(1, 10));

// The figures of the header's comment.
TEST(Lagrange, ErrsAsItsCommentSays) {
  const auto error_db = [](int order, double fraction_of_half_rate) {
    return db(tone_error(FractionalDelay::lagrange(0.5, order), kPi * fraction_of_half_rate));
  };
  EXPECT_NEAR(error_db(3, 0.1), -72.9, 0.1);
  EXPECT_NEAR(error_db(3, 0.5), -18.7, 0.1);
  EXPECT_NEAR(error_db(9, 0.25), -95.0, 0.1);
  EXPECT_NEAR(error_db(9, 0.5), -39.9, 0.1);
}

TEST(FractionalDelay, AppliesWhatItsTapsSay) {
  const auto x = noise(300, 2);
  for (const auto& filter : {FractionalDelay::windowed_sinc(-1.7), FractionalDelay::lagrange(4.2, 4)}) {
    std::vector<Cf32> y(300);
    filter.apply(x, 0, y);
    for (std::int64_t n = 0; n < 300; ++n) {
      Cf64 sum{};
      for (std::size_t k = 0; k < filter.taps().size(); ++k) {
        const std::int64_t at = n - filter.first_tap() - static_cast<std::int64_t>(k);
        if (at >= 0 && at < 300) sum += filter.taps()[k] * Cf64(x[static_cast<std::size_t>(at)]);
      }
      EXPECT_LT(std::abs(Cf64(y[static_cast<std::size_t>(n)]) - sum), 2e-6) << n;
    }
  }
}

TEST(FractionalDelay, SincTapsAreThoseOfTheFunction) {
  const SincDesign design{0.7, 70.0};
  std::vector<double> taps(static_cast<std::size_t>(sinc_tap_count(design)));
  sinc_delay_taps(0.3, design, taps);
  const auto filter = FractionalDelay::windowed_sinc(5.3, design);
  EXPECT_EQ(filter.first_tap(), 5 - static_cast<std::int64_t>(taps.size() / 2) + 1);
  for (std::size_t k = 0; k < taps.size(); ++k) EXPECT_NEAR(filter.taps()[k], taps[k], 1e-14);
}

TEST(FractionalDelay, SetDelayRefusesWhatIsNoDelay) {
  auto filter = FractionalDelay::windowed_sinc(1.5);
  for (const double bad : {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), 1e16}) {
    EXPECT_FALSE(filter.set_delay(bad));
    EXPECT_EQ(filter.delay_samples(), 1.5);
    EXPECT_THROW((void)FractionalDelay::windowed_sinc(bad), std::invalid_argument);
    EXPECT_THROW((void)FractionalDelay::lagrange(bad, 3), std::invalid_argument);
  }
  EXPECT_TRUE(filter.set_delay(-2.25));
  EXPECT_EQ(filter.delay_samples(), -2.25);
}

TEST(FractionalDelay, Refuses) {
  for (const SincDesign bad : {SincDesign{0.0, 80.0}, SincDesign{0.995, 80.0}, SincDesign{-0.1, 80.0},
                               SincDesign{std::nan(""), 80.0}, SincDesign{0.8, 19.0}, SincDesign{0.8, 111.0}}) {
    EXPECT_THROW((void)sinc_tap_count(bad), std::invalid_argument);
    EXPECT_THROW((void)FractionalDelay::windowed_sinc(0.5, bad), std::invalid_argument);
  }
  EXPECT_THROW((void)FractionalDelay::lagrange(0.5, 0), std::invalid_argument);
  EXPECT_THROW((void)FractionalDelay::lagrange(0.5, 10), std::invalid_argument);
  std::vector<double> taps(5);
  EXPECT_THROW(sinc_delay_taps(0.5, {}, taps), std::invalid_argument);
  taps.resize(static_cast<std::size_t>(sinc_tap_count({})));
  EXPECT_THROW(sinc_delay_taps(1.0, {}, taps), std::invalid_argument);
  EXPECT_THROW(sinc_delay_taps(-0.1, {}, taps), std::invalid_argument);
  EXPECT_THROW(lagrange_delay_taps(0.5, std::span(taps).first(1)), std::invalid_argument);
  EXPECT_THROW(lagrange_delay_taps(0.5, std::span(taps).first(11)), std::invalid_argument);
  EXPECT_THROW(lagrange_delay_taps(std::nan(""), std::span(taps).first(4)), std::invalid_argument);
}

TEST(Delayed, KeepsTheLength) {
  const Tones signal(5, 0.5 * kPi, 1);
  const auto x = signal.sample(200);
  const auto y = delayed(x, 2.5);
  ASSERT_EQ(y.size(), x.size());
  EXPECT_LT(std::abs(Cf64(y[100]) - signal(97.5)), 1e-4);
  EXPECT_TRUE(delayed({}, 2.5).empty());
}

}  // namespace
}  // namespace soopnav::dsp
