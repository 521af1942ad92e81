#include "soopnav/core/packet.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "soopnav/core/packet_math.hpp"
#include "soopnav/core/random.hpp"

namespace soopnav {
namespace {

template <class T>
class PacketTest : public testing::Test {
 protected:
  using Pack = Packet<T>;
  static constexpr T kInfinity = std::numeric_limits<T>::infinity();
  static constexpr T kNan = std::numeric_limits<T>::quiet_NaN();

  // Values of all sizes and signs.
  static Pack random_packet(RandomStream& random, double largest) {
    Pack p;
    for (int i = 0; i < Pack::kWidth; ++i) p.set(i, static_cast<T>(random.uniform(-largest, largest)));
    return p;
  }
  static std::vector<T> edges() {
    return {T{0},
            -T{0},
            T{1},
            T{-1},
            static_cast<T>(0.5),
            static_cast<T>(2.5),
            kInfinity,
            -kInfinity,
            kNan,
            std::numeric_limits<T>::max(),
            -std::numeric_limits<T>::max(),
            std::numeric_limits<T>::denorm_min(),
            std::numeric_limits<T>::min()};
  }
  // Distance of `got` from the exact value in units of its last place; 0 for two NaN or equal infinities.
  static double ulps(T got, long double exact) {
    const T nearest = static_cast<T>(exact);
    if (std::isnan(got) || std::isnan(nearest)) return std::isnan(got) && std::isnan(nearest) ? 0.0 : 1e9;
    if (std::isinf(got) || std::isinf(nearest)) return got == nearest ? 0.0 : 1e9;
    const T unit = std::nextafter(std::abs(nearest), kInfinity) - std::abs(nearest);
    return static_cast<double>(std::abs(static_cast<long double>(got) - exact) / static_cast<long double>(unit));
  }
  template <class Mine, class Theirs>
  static double worst(Mine mine, Theirs exact, double low, double high) {
    RandomStream random(11);
    double most = 0.0;
    for (int k = 0; k < 4000; ++k) {
      Pack x;
      for (int i = 0; i < Pack::kWidth; ++i) x.set(i, static_cast<T>(random.uniform(low, high)));
      const Pack y = mine(x);
      for (int i = 0; i < Pack::kWidth; ++i) most = std::max(most, ulps(y[i], exact(static_cast<long double>(x[i]))));
    }
    return most;
  }
};

using Scalars = testing::Types<double, float>;
TYPED_TEST_SUITE(PacketTest, Scalars);

TYPED_TEST(PacketTest, LanesAreScalarArithmetic) {
  using T = TypeParam;
  using P = Packet<T>;
  RandomStream random(1);
  for (int k = 0; k < 200; ++k) {
    const P a = TestFixture::random_packet(random, 100.0);
    const P b = TestFixture::random_packet(random, 100.0);
    P c = a;
    c += b;
    c *= a;
    c -= b;
    c /= b;
    const P root = sqrt(abs(a));
    const P mixed = 2.0 * a - b / 3 + 1;
    for (int i = 0; i < P::kWidth; ++i) {
      const T x = a[i];
      const T y = b[i];
      const T sum = x + y;
      const T product = sum * x;
      const T difference = product - y;
      ASSERT_EQ(c[i], difference / y);
      ASSERT_EQ(root[i], std::sqrt(std::abs(x)));
      const T twice = T{2} * x;
      const T third = y / T{3};
      ASSERT_EQ(mixed[i], (twice - third) + T{1});
      ASSERT_EQ(min(a, b)[i], std::min(x, y));
      ASSERT_EQ(max(a, b)[i], std::max(x, y));
      ASSERT_EQ((-a)[i], -x);
      ASSERT_EQ(copysign(a, b)[i], std::copysign(x, y));
      ASSERT_EQ(floor(a)[i], std::floor(x));
      ASSERT_EQ(round_to_even(a)[i], std::nearbyint(x));
      ASSERT_EQ((a < b)[i], x < y);
      ASSERT_EQ((a >= b)[i], x >= y);
      ASSERT_EQ((a == a)[i], true);
      ASSERT_EQ((a != b)[i], x != y);
      ASSERT_EQ(select(a < b, a, b)[i], x < y ? x : y);
      ASSERT_EQ(((!(a < b)) | (b < T{0}))[i], !(x < y) || y < T{0});
    }
  }
}

TYPED_TEST(PacketTest, LoadsAndStoresAnywhere) {
  using T = TypeParam;
  using P = Packet<T>;
  std::vector<T> numbers(64);
  for (std::size_t i = 0; i < numbers.size(); ++i) numbers[i] = static_cast<T>(i);
  const P p = P::load(numbers.data() + 3);
  for (int i = 0; i < P::kWidth; ++i) EXPECT_EQ(p[i], static_cast<T>(i + 3));
  std::vector<T> out(64, T{-1});
  p.store(out.data() + 5);
  EXPECT_EQ(out[4], T{-1});
  EXPECT_EQ(out[5], T{3});
  EXPECT_EQ(out[static_cast<std::size_t>(5 + P::kWidth)], T{-1});
  const std::vector<float> floats(32, 0.1F);
  EXPECT_EQ(P::load_float(floats.data() + 1)[P::kWidth - 1], static_cast<T>(0.1F));
  std::vector<double> wide(16);
  p.store_as_double(wide.data());
  EXPECT_EQ(wide[2], 5.0);
  const int n = P::kWidth;
  EXPECT_EQ(sum(p), static_cast<T>(3 * n + n * (n - 1) / 2));
  EXPECT_EQ(largest(p), static_cast<T>(n + 2));
}

TYPED_TEST(PacketTest, MasksAnswerForAllAndAny) {
  using P = Packet<TypeParam>;
  P p(1);
  EXPECT_TRUE(all(p > 0));
  EXPECT_FALSE(any(p < 0));
  p.set(P::kWidth - 1, TypeParam{-1});
  EXPECT_FALSE(all(p > 0));
  EXPECT_TRUE(any(p < 0));
  EXPECT_EQ(select(true, 1.0, 2.0), 1.0);
}

TYPED_TEST(PacketTest, FunctionsAreWithinTheirUlps) {
  using T = TypeParam;
  const auto exp_ = [](const auto& x) { return exp(x); };
  const auto log_ = [](const auto& x) { return log(x); };
  const auto exact_exp = [](long double x) { return std::exp(x); };
  const auto exact_log = [](long double x) { return std::log(x); };
  const double widest = sizeof(T) == 8 ? 760.0 : 110.0;
  for (const double range : {0.5, 30.0, widest}) EXPECT_LE(this->worst(exp_, exact_exp, -range, range), 1.0) << range;
  EXPECT_LE(this->worst(log_, exact_log, 0.0, 3.0), 1.0);
  EXPECT_LE(this->worst(log_, exact_log, 0.99, 1.01), 1.0);
  EXPECT_LE(this->worst(log_, exact_log, 0.0, 1e30), 1.0);
  EXPECT_LE(this->worst(log_, exact_log, 0.0, 1e-37), 1.0);  // subnormal floats
}

TEST(PacketMath, SineAndCosineOfDoubles) {
  RandomStream random(3);
  using P = Packet<double>;
  for (const double range : {0.7, 10.0, 1e3, 1.6e6}) {
    for (int k = 0; k < 4000; ++k) {
      P x;
      for (int i = 0; i < P::kWidth; ++i) x.set(i, random.uniform(-range, range));
      const auto y = sincos(x);
      for (int i = 0; i < P::kWidth; ++i) {
        const auto exact_sin = std::sin(static_cast<long double>(x[i]));
        const auto exact_cos = std::cos(static_cast<long double>(x[i]));
        const double unit = std::abs(std::nextafter(y.sin[i], 2.0) - y.sin[i]);
        ASSERT_LE(std::abs(static_cast<double>(static_cast<long double>(y.sin[i]) - exact_sin)), unit) << x[i];
        const double unit_cos = std::abs(std::nextafter(y.cos[i], 2.0) - y.cos[i]);
        ASSERT_LE(std::abs(static_cast<double>(static_cast<long double>(y.cos[i]) - exact_cos)), unit_cos) << x[i];
      }
    }
  }
  // Multiples of pi/2, where everything cancels.
  for (int n = -20; n <= 20; ++n) {
    const double x = n * (kPi / 2.0);
    EXPECT_NEAR(sin(P(x))[0], std::sin(x), 1e-30 + 2e-16 * std::abs(std::sin(x)));
    EXPECT_NEAR(cos(P(x))[0], std::cos(x), 1e-30 + 2e-16 * std::abs(std::cos(x)));
  }
  EXPECT_TRUE(std::isnan(sin(P(2e15))[0]));
}

TEST(PacketMath, SineAndCosineOfFloats) {
  RandomStream random(3);
  using P = Packet<float>;
  for (int k = 0; k < 4000; ++k) {
    P x;
    for (int i = 0; i < P::kWidth; ++i) x.set(i, static_cast<float>(random.uniform(-1000.0, 1000.0)));
    const auto y = sincos(x);
    for (int i = 0; i < P::kWidth; ++i) {
      ASSERT_NEAR(static_cast<double>(y.sin[i]), std::sin(static_cast<double>(x[i])), 1.5e-7);
      ASSERT_NEAR(static_cast<double>(y.cos[i]), std::cos(static_cast<double>(x[i])), 1.5e-7);
    }
  }
}

TYPED_TEST(PacketTest, EdgesAreTheLibrarys) {
  using T = TypeParam;
  using P = Packet<T>;
  const auto same = [](T got, T want) {
    if (std::isnan(want)) return std::isnan(got);
    return std::signbit(got) == std::signbit(want) && TestFixture::ulps(got, static_cast<long double>(want)) <= 3.0;
  };
  for (const T x : this->edges()) {
    EXPECT_TRUE(same(exp(P(x))[0], std::exp(x))) << "exp " << x;
    EXPECT_TRUE(same(log(P(x))[0], std::log(x))) << "log " << x;
    EXPECT_TRUE(same(sqrt(P(x))[0], std::sqrt(x))) << "sqrt " << x;
    EXPECT_TRUE(same(floor(P(x))[0], std::floor(x))) << "floor " << x;
    EXPECT_TRUE(same(round_to_even(P(x))[0], std::nearbyint(x))) << "round " << x;
    if (!(std::abs(x) == std::numeric_limits<T>::max())) {
      EXPECT_TRUE(same(sin(P(x))[0], std::sin(x))) << "sin " << x;
      EXPECT_TRUE(same(cos(P(x))[0], std::cos(x))) << "cos " << x;
      EXPECT_TRUE(same(wrap_to_pi(P(x))[0], wrap_to_pi(x))) << "wrap " << x;
    }
    for (const T y : this->edges()) {
      EXPECT_TRUE(same(atan2(P(y), P(x))[0], std::atan2(y, x))) << "atan2 " << y << ", " << x;
    }
  }
}

TYPED_TEST(PacketTest, ArcTangentIsWithinItsUlps) {
  using T = TypeParam;
  using P = Packet<T>;
  RandomStream random(8);
  double most = 0.0;
  for (int k = 0; k < 8000; ++k) {
    const double spread = std::pow(10.0, random.uniform(-6.0, 6.0));
    P y;
    P x;
    for (int i = 0; i < P::kWidth; ++i) {
      y.set(i, static_cast<T>(random.normal()));
      x.set(i, static_cast<T>(spread * random.normal()));
    }
    const P angle = atan2(y, x);
    for (int i = 0; i < P::kWidth; ++i) {
      const auto exact = std::atan2(static_cast<long double>(y[i]), static_cast<long double>(x[i]));
      most = std::max(most, TestFixture::ulps(angle[i], exact));
    }
  }
  EXPECT_LE(most, 2.5);
}

TYPED_TEST(PacketTest, WrapsLikeTheScalar) {
  using T = TypeParam;
  using P = Packet<T>;
  RandomStream random(5);
  for (const double range : {4.0, 100.0, 2e4}) {
    for (int k = 0; k < 2000; ++k) {
      const P a = TestFixture::random_packet(random, range);
      const P w = wrap_to_pi(a);
      for (int i = 0; i < P::kWidth; ++i) {
        ASSERT_EQ(w[i], wrap_to_pi(a[i])) << a[i];
        ASSERT_GE(w[i], -static_cast<T>(kPi));
        ASSERT_LT(w[i], static_cast<T>(kPi));
      }
    }
  }
  EXPECT_EQ(wrap_to_pi(P(static_cast<T>(kPi)))[0], -static_cast<T>(kPi));
  EXPECT_EQ(wrap_to_pi(P(static_cast<T>(-kPi)))[0], -static_cast<T>(kPi));
}

}  // namespace
}  // namespace soopnav
