#pragma once

#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/packet.hpp"

/// Elementary functions of packets, on +, -, *, / and sqrt only: the same bits from every processor and C library
/// that keeps IEEE 754, as long as products and sums are not contracted (-ffp-contract=off; without fused instructions
/// in the target there is nothing to contract). Lanes that are NaN or infinite come out as the C library's functions
/// have them. Nothing here branches, allocates or sets errno.
///
/// Polynomials are Chebyshev interpolants of the functions' smooth parts, to below a tenth of a unit in the last place.

namespace soopnav {
namespace detail {

// Horner's rule, highest power first, coefficients rounded to the packet's precision.
template <class P, std::size_t Terms>
SOOPNAV_INLINE P polynomial(const std::array<double, Terms>& c, const P& z) noexcept {
  using T = typename P::Scalar;
  P sum(static_cast<T>(c[0]));
  for (std::size_t k = 1; k < Terms; ++k) sum = sum * z + P(static_cast<T>(c[k]));
  return sum;
}

// What differs between the two precisions. `magic` plus a whole number holds that number in its lowest bits.
template <class T>
struct PacketConstants;

template <>
struct PacketConstants<double> {
  static constexpr int kMantissa = 52;
  static constexpr std::int64_t kBias = 1023;
  static constexpr double kMagic = 0x1.8p52;
  static constexpr double kLn2High = 0x1.62e42fefa38p-1;  // 42 bits: times a whole number below 2^11 it is exact
  static constexpr double kLn2Low = 0x1.ef35793c7673p-45;
  static constexpr double kExpLowest = -746.0;
  static constexpr double kExpHighest = 710.0;
  // pi/2 in 33 + 33 + 53 bits: times a whole number below 2^20 the first two are exact.
  static constexpr double kHalfPi1 = 0x1.921fb544p+0;
  static constexpr double kHalfPi2 = 0x1.0b4611a6p-34;
  static constexpr double kHalfPi3 = 0x1.3198a2e037073p-69;
  static constexpr double kQuarterPiHigh = 0x1.921fb54442d18p-1;
  static constexpr double kQuarterPiLow = 0x1.1a62633145c07p-55;
  static constexpr double kTwoPi1 = 0x1.921fb544p+2;  // with the next: the double nearest 2 pi, exactly
  static constexpr double kTwoPi2 = 0x1.0b46p-32;
  static constexpr double kLargestAngle = 1e15;
  // (e^r - 1 - r) / r^2, |r| <= ln(2) / 2
  static constexpr std::array<double, 11> kExp = {2.0915442297780116e-09,
                                                  2.5106274733573296e-08,
                                                  2.75572718102198e-07,
                                                  2.755725283351691e-06,
                                                  2.4801587327007187e-05,
                                                  0.00019841269876864356,
                                                  0.0013888888888883327,
                                                  0.008333333333325544,
                                                  0.04166666666666667,
                                                  0.1666666666666667,
                                                  0.5};
  // (ln((1 + s) / (1 - s)) / s - 2) / s^2 in s^2 <= 0.0295
  static constexpr std::array<double, 8> kLog = {0.13088034850927555, 0.13268638369266825, 0.15386244737621665,
                                                 0.18181795547521137, 0.22222222392581045, 0.28571428570799784,
                                                 0.40000000000000885, 0.6666666666666666};
  // (sin(x) / x - 1) / x^2 and (cos(x) - 1 + x^2 / 2) / x^4 in x^2 <= (pi / 4)^2
  static constexpr std::array<double, 6> kSin = {1.5916726193889336e-10, -2.5051112272573243e-08, 2.755731600817155e-06,
                                                 -0.0001984126983657571, 0.008333333333330827,    -0.16666666666666666};
  static constexpr std::array<double, 6> kCos = {-1.1381754653662937e-11, 2.0876134024090145e-09,
                                                 -2.755731721268659e-07,  2.4801587298651292e-05,
                                                 -0.0013888888888887322,  0.041666666666666664};
  // (atan(x) / x - 1) / x^2 in x^2 <= (sqrt(2) - 1)^2
  static constexpr std::array<double, 12> kAtan = {0.01614822854677186,  -0.03444584442357738, 0.04546719509555166,
                                                   -0.0522938047378184,  0.058787824694439814, -0.06666412077725274,
                                                   0.07692295658327873,  -0.09090908728587459, 0.11111111104652255,
                                                   -0.14285714285654638, 0.19999999999999785,  -0.3333333333333333};
};

template <>
struct PacketConstants<float> {
  static constexpr int kMantissa = 23;
  static constexpr std::int32_t kBias = 127;
  static constexpr float kMagic = 0x1.8p23F;
  static constexpr float kLn2High = 0x1.62e4p-1F;  // 15 bits
  static constexpr float kLn2Low = 0x1.7f7d1cp-20F;
  static constexpr float kExpLowest = -104.0F;
  static constexpr float kExpHighest = 89.0F;
  static constexpr float kHalfPi1 = 0x1.92p+0F;
  static constexpr float kHalfPi2 = 0x1.fb4p-12F;
  static constexpr float kHalfPi3 = 0x1.4442d2p-24F;
  static constexpr float kQuarterPiHigh = 0x1.921fbp-1F;  // 21 bits
  static constexpr float kQuarterPiLow = 0x1.5110b4p-23F;
  static constexpr float kTwoPi1 = 0x1.92p+2F;
  static constexpr float kTwoPi2 = 0x1.921fb6p+2F - 0x1.92p+2F;
  static constexpr float kLargestAngle = 1e6F;
  static constexpr std::array<double, 6> kExp = {0.0001989198131397769, 0.0013934541928270264, 0.008333310024225292,
                                                 0.04166645680967788,   0.16666666682534356,   0.5000000014286223};
  static constexpr std::array<double, 4> kLog = {0.23331614471843498, 0.28550778633191964, 0.4000012221181065,
                                                 0.6666666655404201};
  static constexpr std::array<double, 4> kSin = {2.7246868722877944e-06, -0.00019840063040804117, 0.00833333183062943,
                                                 -0.16666666663741367};
  static constexpr std::array<double, 3> kCos = {2.4545419078353295e-05, -0.0013888291300556933, 0.04166666459882798};
  static constexpr std::array<double, 6> kAtan = {0.05028080567011183,  -0.08616863957438002, 0.1107031216765306,
                                                  -0.14284094100114464, 0.19999976194852576,  -0.33333333276160115};
};

// 2^n for `shifted` = n + kMagic, n within the exponents of normal numbers.
template <class P>
SOOPNAV_INLINE P power_of_two(const P& shifted) noexcept {
  using C = PacketConstants<typename P::Scalar>;
  using H = typename P::Half;
  using B = typename P::BitsHalf;
  const B one = (C::kBias << C::kMantissa) - B{};
  P out;
  out.low = reinterpret_cast<H>((reinterpret_cast<B>(shifted.low) << C::kMantissa) + one);
  out.high = reinterpret_cast<H>((reinterpret_cast<B>(shifted.high) << C::kMantissa) + one);
  return out;
}

// x = 2^e m with m in [sqrt(1/2), sqrt(2)), for one half of positive normal numbers.
template <class P>
SOOPNAV_INLINE void split_exponent(const typename P::Half& x, typename P::Half& exponent,
                                   typename P::Half& m) noexcept {
  using T = typename P::Scalar;
  using Half = typename P::Half;
  using Bits = typename P::BitsHalf;
  using C = PacketConstants<T>;
  using Lane = typename P::Bits;
  constexpr Lane kRootHalf =
      std::bit_cast<Lane>(sizeof(T) == 8 ? static_cast<T>(0x1.6a09e667f3bcdp-1) : static_cast<T>(0x1.6a09e6p-1F));
  constexpr Lane kOne = C::kBias << C::kMantissa;
  constexpr Lane kFraction = (Lane{1} << C::kMantissa) - 1;
  // The exponent becomes a number by way of the lowest bits of kMagic.
  constexpr Lane kMagicBits = std::bit_cast<Lane>(C::kMagic);
  const Bits shifted = reinterpret_cast<Bits>(x) + (kOne - kRootHalf);
  const Bits count = (shifted & ~kFraction);
  // Logical shift of a number without sign bit, which every vector unit has.
  if constexpr (sizeof(T) == 8) {
    typedef std::uint64_t Unsigned __attribute__((vector_size(32), aligned(16)));  // NOLINT(modernize-use-using)
    exponent = reinterpret_cast<Half>(reinterpret_cast<Bits>(reinterpret_cast<Unsigned>(count) >> 52) + kMagicBits);
  } else {
    typedef std::uint32_t Unsigned __attribute__((vector_size(32), aligned(16)));  // NOLINT(modernize-use-using)
    exponent = reinterpret_cast<Half>(reinterpret_cast<Bits>(reinterpret_cast<Unsigned>(count) >> 23) + kMagicBits);
  }
  exponent = exponent - (C::kMagic + static_cast<T>(C::kBias));
  m = reinterpret_cast<Half>((shifted & kFraction) + kRootHalf);
}

}  // namespace detail

/// e^a. Within 1 unit in the last place; 0 and infinity beyond the range, subnormals rounded once more.
template <class T, int W>
[[nodiscard]] SOOPNAV_INLINE Packet<T, W> exp(const Packet<T, W>& a) noexcept {
  using P = Packet<T, W>;
  using C = detail::PacketConstants<T>;
  const P x = max(min(a, P(C::kExpHighest)), P(C::kExpLowest));
  const P magic(C::kMagic);
  const P n = (x * P(static_cast<T>(1.4426950408889634)) + magic) - magic;
  const P high = x - n * P(C::kLn2High);
  const P r = high - n * P(C::kLn2Low);
  const P e = P(1) + (r + r * r * detail::polynomial(C::kExp, r));
  // In two factors, as 2^n may be too large or too small for one.
  const P half = n * P(static_cast<T>(0.5)) + magic;
  const P rest = (n - (half - magic)) + magic;
  return (e * detail::power_of_two(half)) * detail::power_of_two(rest);
}

/// Natural logarithm. Within 1 unit in the last place; -infinity at 0, NaN below.
template <class T, int W>
[[nodiscard]] SOOPNAV_INLINE Packet<T, W> log(const Packet<T, W>& a) noexcept {
  using P = Packet<T, W>;
  using C = detail::PacketConstants<T>;
  constexpr T kScaleUp = sizeof(T) == 8 ? static_cast<T>(0x1p54) : static_cast<T>(0x1p25F);
  constexpr T kScaleExponent = sizeof(T) == 8 ? T{54} : T{25};
  const auto small = a < P(std::numeric_limits<T>::min());
  const P x = select(small, a * P(kScaleUp), a);
  P e;
  P m;
  detail::split_exponent<P>(x.low, e.low, m.low);
  detail::split_exponent<P>(x.high, e.high, m.high);
  e = select(small, e - P(kScaleExponent), e);
  // ln(1 + f) = f - f^2/2 + s (f^2/2 + R(s)), s = f / (2 + f): the leading terms are exact.
  const P f = m - P(1);
  const P s = f / (P(2) + f);
  const P z = s * s;
  const P square = P(static_cast<T>(0.5)) * f * f;
  const P tail = s * (square + z * detail::polynomial(C::kLog, z)) + e * P(C::kLn2Low);
  const P value = e * P(C::kLn2High) - ((square - tail) - f);
  const P infinity(std::numeric_limits<T>::infinity());
  const P edge = select(a == P(0), -infinity, select(a == infinity, infinity, a - a + (P(0) / P(0))));
  return select((a > P(0)) & (a < infinity), value, edge);
}

/// Sine and cosine of the same angle.
template <class P>
struct SineCosine {
  P sin;
  P cos;
};

/// Sine and cosine of `a` [rad]. Doubles: within 1 unit in the last place up to 1.6e6 rad, as for an argument off by
/// one unit beyond. Floats: within 1.5e-7 up to 1000 rad, growing with the argument beyond. NaN above 1e15 (floats:
/// 1e6), where numbers are too far apart to name an angle.
template <class T, int W>
[[nodiscard]] SOOPNAV_INLINE SineCosine<Packet<T, W>> sincos(const Packet<T, W>& a) noexcept {
  using P = Packet<T, W>;
  using C = detail::PacketConstants<T>;
  using H = typename P::Half;
  using B = typename P::BitsHalf;
  const P magic(C::kMagic);
  const P shifted = a * P(static_cast<T>(0.63661977236758134)) + magic;
  const P n = shifted - magic;
  // a - n pi/2 as r + low: the first difference is exact, the rounding of the second is kept (two-sum).
  const P first = a - n * P(C::kHalfPi1);
  const P second = n * P(C::kHalfPi2);
  const P r0 = first - second;
  const P back = first - r0;
  const P error = (first - (r0 + back)) + (back - second);
  const P more = error - n * P(C::kHalfPi3);
  const P r = r0 + more;
  const P low = (r0 - r) + more;
  const P z = r * r;
  const P sine = r + (r * z * detail::polynomial(C::kSin, z) + low * (P(1) - P(static_cast<T>(0.5)) * z));
  const P half = P(static_cast<T>(0.5)) * z;
  const P one_less = P(1) - half;
  const P cosine = one_less + (((P(1) - one_less) - half) + (z * z * detail::polynomial(C::kCos, z) - r * low));
  // Quadrants 0..3: (s, c), (c, -s), (-s, -c), (-c, s), by the lowest bits of n.
  const auto turn = [](const H& from, const H& s, const H& c, H& sin_out, H& cos_out) {
    const B bits = reinterpret_cast<B>(from);
    const B odd = B{} - (bits & 1);
    constexpr int kToSign = static_cast<int>(8 * sizeof(T)) - 2;
    const B sign_bit = std::numeric_limits<typename P::Bits>::min() - B{};
    const B sign_sin = (bits << kToSign) & sign_bit;
    const B sign_cos = ((bits + 1) << kToSign) & sign_bit;
    const B swap = (reinterpret_cast<B>(s) ^ reinterpret_cast<B>(c)) & odd;
    sin_out = reinterpret_cast<H>(reinterpret_cast<B>(s) ^ swap ^ sign_sin);
    cos_out = reinterpret_cast<H>(reinterpret_cast<B>(c) ^ swap ^ sign_cos);
  };
  SineCosine<P> out;
  turn(shifted.low, sine.low, cosine.low, out.sin.low, out.cos.low);
  turn(shifted.high, sine.high, cosine.high, out.sin.high, out.cos.high);
  const auto inside = abs(a) <= P(C::kLargestAngle);
  const P nothing = P(0) / P(0);
  // sin(-0) is -0, which the reduction loses.
  out.sin = select(inside, select(a == P(0), a, out.sin), nothing);
  out.cos = select(inside, out.cos, nothing);
  return out;
}

/// See `sincos`.
template <class T, int W>
[[nodiscard]] SOOPNAV_INLINE Packet<T, W> sin(const Packet<T, W>& a) noexcept {
  return sincos(a).sin;
}

/// See `sincos`.
template <class T, int W>
[[nodiscard]] SOOPNAV_INLINE Packet<T, W> cos(const Packet<T, W>& a) noexcept {
  return sincos(a).cos;
}

/// Angle of the point (`x`, `y`) from the first axis, in [-pi, pi]; signs of zeros and infinities as std::atan2. Within
/// 2.5 units in the last place.
template <class T, int W>
[[nodiscard]] SOOPNAV_INLINE Packet<T, W> atan2(const Packet<T, W>& y, const Packet<T, W>& x) noexcept {
  using P = Packet<T, W>;
  using C = detail::PacketConstants<T>;
  // Sums of two must not overflow: scaled down together when huge.
  const P huge(std::numeric_limits<T>::max() / T{4});
  const auto large = (abs(x) > huge) | (abs(y) > huge);
  const P scale = select(large, P(static_cast<T>(0.25)), P(1));
  const P ax = abs(x) * scale;
  const P ay = abs(y) * scale;
  const P low = min(ax, ay);
  const P high = max(ax, ay);
  // atan(low / high) = pi/4 + atan((low - high) / (low + high)) where the ratio is above tan(pi/8).
  const auto second = (low > high * P(static_cast<T>(0.41421356237309503))) | ((low == high) & (high > P(0)));
  const P top = select(second, select(low == high, P(0), low - high), low);
  const P bottom = select(second, low + high, select(high == P(0), P(1), high));
  const P t = top / bottom;
  const P z = t * t;
  const P angle = t + t * z * detail::polynomial(C::kAtan, z);
  // The result is m pi/4 +- angle.
  P m = select(second, P(1), P(0));
  P sign(1);
  const auto steep = ay > ax;
  m = select(steep, P(2) - m, m);
  sign = select(steep, -sign, sign);
  const auto behind = copysign(P(1), x) < P(0);
  m = select(behind, P(4) - m, m);
  sign = select(behind, -sign, sign);
  const P value = copysign(m * P(C::kQuarterPiHigh) + (sign * angle + m * P(C::kQuarterPiLow)), y);
  return select((x == x) & (y == y), value, x + y);
}

/// `a` plus the multiple of 2 pi that brings it into [-pi, pi). Not finite in, NaN out.
///
/// Doubles up to 6e6 rad (floats: 2.5e4) have the bits of the scalar `wrap_to_pi`; beyond, the rounding of the multiple
/// adds an error of the order of the argument's last place.
template <class T, int W>
[[nodiscard]] SOOPNAV_INLINE Packet<T, W> wrap_to_pi(const Packet<T, W>& a) noexcept {
  using P = Packet<T, W>;
  using C = detail::PacketConstants<T>;
  constexpr T kHalfTurn = (C::kTwoPi1 + C::kTwoPi2) / T{2};
  const P n = round_to_even(a * P(static_cast<T>(1.0 / kTwoPi)));
  const P turns = P(C::kTwoPi1 + C::kTwoPi2);
  const P r = (a - n * P(C::kTwoPi1)) - n * P(C::kTwoPi2);
  const P up = select(r < P(-kHalfTurn), r + turns, r);
  const P wrapped = select(up >= P(kHalfTurn), up - turns, up);
  return select(a == P(0), a, wrapped);  // keeps the sign of a zero
}

/// `wrap_to_pi` in single precision, with respect to the float nearest 2 pi.
[[nodiscard]] inline float wrap_to_pi(float angle_rad) noexcept {
  using C = detail::PacketConstants<float>;
  const float wrapped = std::remainder(angle_rad, C::kTwoPi1 + C::kTwoPi2);
  return wrapped >= (C::kTwoPi1 + C::kTwoPi2) / 2.0F ? wrapped - (C::kTwoPi1 + C::kTwoPi2) : wrapped;
}

}  // namespace soopnav
