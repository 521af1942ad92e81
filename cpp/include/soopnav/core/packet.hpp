#pragma once

#include <cmath>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

/// Marks what must dissolve into the loop that uses it: packets only pay when they stay in registers.
#define SOOPNAV_INLINE __attribute__((always_inline)) inline

namespace soopnav {

/// Which lanes of a `Packet<T>` a condition holds for.
template <class T>
struct PacketMask {
  using Bits = std::conditional_t<sizeof(T) == 8, std::int64_t, std::int32_t>;
  typedef Bits Half
      __attribute__((vector_size(32), aligned(16)));  // NOLINT(modernize-use-using): the attribute needs it
  static constexpr int kWidth = static_cast<int>(64 / sizeof(T));

  Half low;   ///< lanes 0 ... kWidth / 2 - 1: all bits set or none
  Half high;  ///< the other lanes

  [[nodiscard]] SOOPNAV_INLINE bool operator[](int lane) const noexcept {
    return (lane < kWidth / 2 ? low[lane] : high[lane - kWidth / 2]) != 0;
  }
  friend SOOPNAV_INLINE PacketMask operator&(const PacketMask& a, const PacketMask& b) noexcept {
    return {a.low & b.low, a.high & b.high};
  }
  friend SOOPNAV_INLINE PacketMask operator|(const PacketMask& a, const PacketMask& b) noexcept {
    return {a.low | b.low, a.high | b.high};
  }
  friend SOOPNAV_INLINE PacketMask operator!(const PacketMask& a) noexcept { return {~a.low, ~a.high}; }
  friend SOOPNAV_INLINE bool any(const PacketMask& a) noexcept {
    const Half both = a.low | a.high;
    Bits sum = 0;
    for (int i = 0; i < kWidth / 2; ++i) sum |= both[i];
    return sum != 0;
  }
  friend SOOPNAV_INLINE bool all(const PacketMask& a) noexcept { return !any(!a); }
};

/// A row of numbers, one for each of `kWidth` particles, computed with as one number.
///
/// What a model's `x(role)[i]` is in a particle cloud. 64 bytes on every machine (8 doubles, 16 floats), so that
/// results do not depend on the processor; arithmetic is IEEE 754 lane by lane, so each lane has the bits of the scalar
/// computation. Mixes with numbers, which are converted to `T`. Comparisons give a `PacketMask` for `select`, `any` and
/// `all`. `sqrt`, `abs`, `min`, `max` and `floor` are found by argument lookup; exp, log, sin, cos, atan2 are in
/// core/packet_math.hpp. Everything is inline and allocates nothing; a default-made packet is uninitialised.
template <std::floating_point T, int Width = static_cast<int>(64 / sizeof(T))>
struct Packet {
  static_assert(Width * sizeof(T) == 64, "a packet has 64 bytes");
  static_assert(std::is_same_v<T, double> || std::is_same_v<T, float>, "packets hold double or float");
  using Scalar = T;
  using Mask = PacketMask<T>;
  using Bits = typename Mask::Bits;
  typedef T Half __attribute__((vector_size(32), aligned(16)));  // NOLINT(modernize-use-using): the attribute needs it
  using BitsHalf = typename Mask::Half;
  static constexpr int kWidth = Width;
  static constexpr int kHalf = Width / 2;

  Half low;   ///< lanes 0 ... kHalf - 1
  Half high;  ///< the other lanes

  Packet() = default;
  SOOPNAV_INLINE Packet(const Half& low_lanes, const Half& high_lanes) noexcept : low(low_lanes), high(high_lanes) {}
  /// `value` in every lane.
  template <class S>
  requires std::is_arithmetic_v<S> SOOPNAV_INLINE explicit(false) Packet(S value) noexcept {  // NOLINT
    const T v = static_cast<T>(value);
    // By way of a quarter: a vector of 32 bytes is put together lane by lane where it is not the machine's.
    if constexpr (kHalf == 4) {
      const Quarter q = {v, v};
      low = __builtin_shufflevector(q, q, 0, 1, 0, 1);
    } else {
      const Quarter q = {v, v, v, v};
      low = __builtin_shufflevector(q, q, 0, 1, 2, 3, 0, 1, 2, 3);
    }
    high = low;
  }

  /// The `kWidth` numbers from `from` on; any alignment.
  [[nodiscard]] static SOOPNAV_INLINE Packet load(const T* from) noexcept {
    const Half first = *reinterpret_cast<const LooseHalf*>(from);
    const Half second = *reinterpret_cast<const LooseHalf*>(from + kHalf);
    return {first, second};
  }
  /// Writes the lanes to `to`, `kWidth` numbers; any alignment.
  SOOPNAV_INLINE void store(T* to) const noexcept {
    *reinterpret_cast<LooseHalf*>(to) = low;
    *reinterpret_cast<LooseHalf*>(to + kHalf) = high;
  }

  /// As `load` of numbers in single precision.
  [[nodiscard]] static SOOPNAV_INLINE Packet load_float(const float* from) noexcept {
    if constexpr (sizeof(T) == 4) {
      return load(from);
    } else {
      const Narrow first = *reinterpret_cast<const LooseNarrow*>(from);
      const Narrow second = *reinterpret_cast<const LooseNarrow*>(from + kHalf);
      return {__builtin_convertvector(first, Half), __builtin_convertvector(second, Half)};
    }
  }
  /// As `store` of the lanes' representations.
  template <std::unsigned_integral U>
  requires(sizeof(U) == sizeof(T)) SOOPNAV_INLINE void store_bits(U* to) const noexcept {
    *reinterpret_cast<LooseHalf*>(to) = low;
    *reinterpret_cast<LooseHalf*>(to + kHalf) = high;
  }
  /// As `store` to doubles.
  SOOPNAV_INLINE void store_as_double(double* to) const noexcept {
    if constexpr (sizeof(T) == 8) {
      store(to);
    } else {
      for (int i = 0; i < kWidth; ++i) to[i] = static_cast<double>((*this)[i]);
    }
  }

  [[nodiscard]] SOOPNAV_INLINE T operator[](int lane) const noexcept {
    return lane < kHalf ? low[lane] : high[lane - kHalf];
  }
  SOOPNAV_INLINE void set(int lane, T value) noexcept {
    if (lane < kHalf) {
      low[lane] = value;
    } else {
      high[lane - kHalf] = value;
    }
  }
  /// Itself: a packet is computed already (see `eval` in measurement/arithmetic.hpp).
  [[nodiscard]] SOOPNAV_INLINE Packet eval() const noexcept { return *this; }

  friend SOOPNAV_INLINE Packet operator+(const Packet& a, const Packet& b) noexcept {
    return {a.low + b.low, a.high + b.high};
  }
  friend SOOPNAV_INLINE Packet operator-(const Packet& a, const Packet& b) noexcept {
    return {a.low - b.low, a.high - b.high};
  }
  friend SOOPNAV_INLINE Packet operator*(const Packet& a, const Packet& b) noexcept {
    return {a.low * b.low, a.high * b.high};
  }
  friend SOOPNAV_INLINE Packet operator/(const Packet& a, const Packet& b) noexcept {
    return {a.low / b.low, a.high / b.high};
  }
  friend SOOPNAV_INLINE Packet operator-(const Packet& a) noexcept { return {-a.low, -a.high}; }
  friend SOOPNAV_INLINE Packet operator+(const Packet& a) noexcept { return a; }
  SOOPNAV_INLINE Packet& operator+=(const Packet& b) noexcept { return *this = *this + b; }
  SOOPNAV_INLINE Packet& operator-=(const Packet& b) noexcept { return *this = *this - b; }
  SOOPNAV_INLINE Packet& operator*=(const Packet& b) noexcept { return *this = *this * b; }
  SOOPNAV_INLINE Packet& operator/=(const Packet& b) noexcept { return *this = *this / b; }

  friend SOOPNAV_INLINE Mask operator<(const Packet& a, const Packet& b) noexcept {
    return {reinterpret_cast<BitsHalf>(a.low < b.low), reinterpret_cast<BitsHalf>(a.high < b.high)};
  }
  friend SOOPNAV_INLINE Mask operator<=(const Packet& a, const Packet& b) noexcept {
    return {reinterpret_cast<BitsHalf>(a.low <= b.low), reinterpret_cast<BitsHalf>(a.high <= b.high)};
  }
  friend SOOPNAV_INLINE Mask operator>(const Packet& a, const Packet& b) noexcept { return b < a; }
  friend SOOPNAV_INLINE Mask operator>=(const Packet& a, const Packet& b) noexcept { return b <= a; }
  friend SOOPNAV_INLINE Mask operator==(const Packet& a, const Packet& b) noexcept {
    return {reinterpret_cast<BitsHalf>(a.low == b.low), reinterpret_cast<BitsHalf>(a.high == b.high)};
  }
  friend SOOPNAV_INLINE Mask operator!=(const Packet& a, const Packet& b) noexcept { return !(a == b); }

  /// `a` where `mask` holds, else `b`.
  friend SOOPNAV_INLINE Packet select(const Mask& mask, const Packet& a, const Packet& b) noexcept {
    return {reinterpret_cast<Half>((mask.low & reinterpret_cast<BitsHalf>(a.low)) |
                                   (~mask.low & reinterpret_cast<BitsHalf>(b.low))),
            reinterpret_cast<Half>((mask.high & reinterpret_cast<BitsHalf>(a.high)) |
                                   (~mask.high & reinterpret_cast<BitsHalf>(b.high)))};
  }

  friend SOOPNAV_INLINE Packet abs(const Packet& a) noexcept {
    const BitsHalf keep = std::numeric_limits<Bits>::max() - BitsHalf{};
    return {reinterpret_cast<Half>(reinterpret_cast<BitsHalf>(a.low) & keep),
            reinterpret_cast<Half>(reinterpret_cast<BitsHalf>(a.high) & keep)};
  }
  /// The smaller, `a` where either is NaN (std::min).
  friend SOOPNAV_INLINE Packet min(const Packet& a, const Packet& b) noexcept { return select(b < a, b, a); }
  /// The larger, `a` where either is NaN (std::max).
  friend SOOPNAV_INLINE Packet max(const Packet& a, const Packet& b) noexcept { return select(a < b, b, a); }

  /// Correctly rounded; NaN below zero.
  friend SOOPNAV_INLINE Packet sqrt(const Packet& a) noexcept {
    Packet root;
    root_half(a.low, root.low);
    root_half(a.high, root.high);
    return root;
  }

  /// `a` with the sign of `b`.
  friend SOOPNAV_INLINE Packet copysign(const Packet& a, const Packet& b) noexcept {
    const BitsHalf sign = std::numeric_limits<Bits>::min() - BitsHalf{};
    return {reinterpret_cast<Half>((reinterpret_cast<BitsHalf>(a.low) & ~sign) |
                                   (reinterpret_cast<BitsHalf>(b.low) & sign)),
            reinterpret_cast<Half>((reinterpret_cast<BitsHalf>(a.high) & ~sign) |
                                   (reinterpret_cast<BitsHalf>(b.high) & sign))};
  }

  /// Nearest whole number, halves to even; what is too large to have a fraction, infinity and NaN as they are.
  friend SOOPNAV_INLINE Packet round_to_even(const Packet& a) noexcept {
    // Adding 2^52 (2^23) leaves no room for a fraction.
    constexpr T kShift = sizeof(T) == 8 ? static_cast<T>(0x1p52) : static_cast<T>(0x1p23);
    const Packet size = abs(a);
    return select(size < Packet(kShift), copysign((size + kShift) - kShift, a), a);
  }
  /// Largest whole number not above.
  friend SOOPNAV_INLINE Packet floor(const Packet& a) noexcept {
    const Packet near = round_to_even(a);
    return select(near > a, near - Packet(1), near);
  }

  /// Sum of the lanes: lane i and lane i + kHalf first, then halves again, in this order on every machine.
  [[nodiscard]] friend SOOPNAV_INLINE T sum(const Packet& a) noexcept {
    T s[static_cast<std::size_t>(kHalf)];
    const Half first = a.low + a.high;
    std::memcpy(s, &first, sizeof(Half));
    for (int n = kHalf / 2; n >= 1; n /= 2) {
      for (int i = 0; i < n; ++i) s[i] += s[i + n];
    }
    return s[0];
  }
  /// Largest lane; a lane that is NaN counts for nothing.
  [[nodiscard]] friend SOOPNAV_INLINE T largest(const Packet& a) noexcept {
    T best = -std::numeric_limits<T>::infinity();
    for (int i = 0; i < kWidth; ++i) best = a[i] > best ? a[i] : best;
    return best;
  }

 private:
  // A half wherever it lies, among numbers.
  typedef T LooseHalf __attribute__((vector_size(32), aligned(sizeof(T)), may_alias));  // NOLINT(modernize-use-using)

  // Half as many floats as a packet of floats has.
  typedef T Quarter __attribute__((vector_size(16)));                                 // NOLINT(modernize-use-using)
  typedef float Narrow __attribute__((vector_size(16)));                              // NOLINT(modernize-use-using)
  typedef float LooseNarrow __attribute__((vector_size(16), aligned(4), may_alias));  // NOLINT(modernize-use-using)

  // The vector units' own instruction: std::sqrt on each lane would set errno, which keeps compilers from vectorising.
  static SOOPNAV_INLINE void root_half(const Half& a, Half& root) noexcept {
#if defined(__SSE2__)
    if constexpr (sizeof(T) == 8) {
      const __m128d first = _mm_sqrt_pd(__builtin_shufflevector(a, a, 0, 1));
      const __m128d second = _mm_sqrt_pd(__builtin_shufflevector(a, a, 2, 3));
      root = __builtin_shufflevector(first, second, 0, 1, 2, 3);
    } else {
      const __m128 first = _mm_sqrt_ps(__builtin_shufflevector(a, a, 0, 1, 2, 3));
      const __m128 second = _mm_sqrt_ps(__builtin_shufflevector(a, a, 4, 5, 6, 7));
      root = __builtin_shufflevector(first, second, 0, 1, 2, 3, 4, 5, 6, 7);
    }
#else
    for (int i = 0; i < kHalf; ++i) root[i] = std::sqrt(a[i]);
#endif
  }
};

/// `a` where `condition` holds, else `b`: for models that are written once for numbers and packets.
template <std::floating_point T>
[[nodiscard]] constexpr T select(bool condition, T a, T b) noexcept {
  return condition ? a : b;
}

template <class T>
inline constexpr bool kIsPacket = false;
template <class T, int Width>
inline constexpr bool kIsPacket<Packet<T, Width>> = true;

/// A number or a packet of numbers: what a model computes with.
template <class T>
concept Numeric = std::floating_point<T> || kIsPacket<T>;

}  // namespace soopnav
