#include "soopnav/core/random.hpp"

#include <Random123/philox.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>

#include "core/target_clones.hpp"
#include "soopnav/core/constants.hpp"

// The rounds of Philox are written out for wider vectors: compilers do not see that only half of a 64-bit product is
// new. Whole numbers, so that the choice cannot show.
#if !defined(SOOPNAV_NO_TARGET_CLONES) && defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#include <immintrin.h>
#define SOOPNAV_WIDE_PHILOX 1
#else
#define SOOPNAV_WIDE_PHILOX 0
#endif

namespace soopnav {
namespace {

// Counter of block k of a kind: words 0 and 1 hold k (62 bits) and the kind (2 bits), words 2 and 3 the stream.
// The key is the seed. Kinds have counters of their own so that no two kinds of draw ever share random bits.
enum class Kind : std::uint64_t { kBits64 = 0, kNormal = 1, kNormalFloat = 2, kBits32 = 3 };

constexpr std::uint32_t low_word(std::uint64_t x) { return static_cast<std::uint32_t>(x); }
constexpr std::uint32_t high_word(std::uint64_t x) { return static_cast<std::uint32_t>(x >> 32); }
constexpr std::uint64_t join(std::uint32_t low, std::uint32_t high) { return low | (std::uint64_t{high} << 32); }

constexpr std::uint64_t block_index(Kind kind, std::uint64_t block) {
  return (block & ((std::uint64_t{1} << 62) - 1)) | (static_cast<std::uint64_t>(kind) << 62);
}

struct Source {
  std::uint64_t key;
  std::uint64_t stream;
};

// ---- Kernels. A batch is kBlocks consecutive Philox blocks in structure-of-arrays form, so that every step below is
// one loop over independent lanes that any vector width computes alike.

constexpr std::size_t kBlocks = 32;
using Lane32 = std::array<std::uint32_t, kBlocks>;

// Multipliers and Weyl constants of Philox 4x32 (Salmon et al., section 4); the tests hold the lanes against Random123.
constexpr std::uint32_t kMultiplier0 = 0xD2511F53U;
constexpr std::uint32_t kMultiplier1 = 0xCD9E8D57U;
constexpr std::uint32_t kWeyl0 = 0x9E3779B9U;
constexpr std::uint32_t kWeyl1 = 0xBB67AE85U;

// The 64-bit draws of kBlocks blocks in the order of their positions: words 0 and 1 of a block, then words 2 and 3.
using Draws = std::array<std::uint64_t, 2 * kBlocks>;

void philox_portable(Source source, std::uint64_t first_index, Draws& out) {
  Lane32 a;
  Lane32 b;
  Lane32 c;
  Lane32 d;
  for (std::size_t i = 0; i < kBlocks; ++i) {
    const std::uint64_t index = first_index + i;
    a[i] = low_word(index);
    b[i] = high_word(index);
    c[i] = low_word(source.stream);
    d[i] = high_word(source.stream);
  }
  std::uint32_t key0 = low_word(source.key);
  std::uint32_t key1 = high_word(source.key);
  for (int round = 0; round < 10; ++round) {
    for (std::size_t i = 0; i < kBlocks; ++i) {
      const std::uint64_t p = std::uint64_t{kMultiplier0} * a[i];
      const std::uint64_t q = std::uint64_t{kMultiplier1} * c[i];
      a[i] = high_word(q) ^ b[i] ^ key0;
      c[i] = high_word(p) ^ d[i] ^ key1;
      b[i] = low_word(q);
      d[i] = low_word(p);
    }
    key0 += kWeyl0;
    key1 += kWeyl1;
  }
  for (std::size_t i = 0; i < kBlocks; ++i) {
    out[2 * i] = join(a[i], b[i]);
    out[2 * i + 1] = join(c[i], d[i]);
  }
}

#if SOOPNAV_WIDE_PHILOX
// One block in each 64-bit lane, a word in its lower half. The multiplication reads lower halves only, so what the
// upper ones gather does not matter until the end. Several vectors at a time, as each round waits for its products.

[[gnu::target("avx2")]] void philox_avx2(Source source, std::uint64_t first_index, Draws& out) {
  constexpr std::size_t kVectors = 4;
  const __m256i multiplier0 = _mm256_set1_epi64x(kMultiplier0);
  const __m256i multiplier1 = _mm256_set1_epi64x(kMultiplier1);
  for (std::size_t first = 0; first < kBlocks; first += 4 * kVectors) {
    __m256i a[kVectors];
    __m256i b[kVectors];
    __m256i c[kVectors];
    __m256i d[kVectors];
    for (std::size_t v = 0; v < kVectors; ++v) {
      const std::uint64_t index = first_index + first + 4 * v;
      a[v] = _mm256_add_epi64(_mm256_set1_epi64x(static_cast<std::int64_t>(index)), _mm256_setr_epi64x(0, 1, 2, 3));
      b[v] = _mm256_srli_epi64(a[v], 32);
      c[v] = _mm256_set1_epi64x(low_word(source.stream));
      d[v] = _mm256_set1_epi64x(high_word(source.stream));
    }
    std::uint32_t key0 = low_word(source.key);
    std::uint32_t key1 = high_word(source.key);
    for (int round = 0; round < 10; ++round) {
      const __m256i k0 = _mm256_set1_epi64x(key0);
      const __m256i k1 = _mm256_set1_epi64x(key1);
      for (std::size_t v = 0; v < kVectors; ++v) {
        const __m256i p = _mm256_mul_epu32(a[v], multiplier0);
        const __m256i q = _mm256_mul_epu32(c[v], multiplier1);
        a[v] = _mm256_xor_si256(_mm256_xor_si256(_mm256_srli_epi64(q, 32), b[v]), k0);
        c[v] = _mm256_xor_si256(_mm256_xor_si256(_mm256_srli_epi64(p, 32), d[v]), k1);
        b[v] = q;
        d[v] = p;
      }
      key0 += kWeyl0;
      key1 += kWeyl1;
    }
    for (std::size_t v = 0; v < kVectors; ++v) {
      const __m256i x = _mm256_blend_epi32(a[v], _mm256_slli_epi64(b[v], 32), 0xAA);
      const __m256i y = _mm256_blend_epi32(c[v], _mm256_slli_epi64(d[v], 32), 0xAA);
      const __m256i even = _mm256_unpacklo_epi64(x, y);
      const __m256i odd = _mm256_unpackhi_epi64(x, y);
      auto* to = reinterpret_cast<__m256i*>(out.data() + 2 * (first + 4 * v));
      _mm256_storeu_si256(to, _mm256_permute2x128_si256(even, odd, 0x20));
      _mm256_storeu_si256(to + 1, _mm256_permute2x128_si256(even, odd, 0x31));
    }
  }
}

[[gnu::target("avx512f")]] void philox_avx512(Source source, std::uint64_t first_index, Draws& out) {
  constexpr std::size_t kVectors = 4;
  static_assert(kBlocks == 8 * kVectors);
  constexpr __mmask8 kAll = 0xFF;  // GCC 12 warns of the unmasked forms' own operands
  const __m512i multiplier0 = _mm512_set1_epi64(kMultiplier0);
  const __m512i multiplier1 = _mm512_set1_epi64(kMultiplier1);
  __m512i a[kVectors];
  __m512i b[kVectors];
  __m512i c[kVectors];
  __m512i d[kVectors];
  for (std::size_t v = 0; v < kVectors; ++v) {
    a[v] = _mm512_add_epi64(_mm512_set1_epi64(static_cast<std::int64_t>(first_index + 8 * v)),
                            _mm512_setr_epi64(0, 1, 2, 3, 4, 5, 6, 7));
    b[v] = _mm512_maskz_srli_epi64(kAll, a[v], 32);
    c[v] = _mm512_set1_epi64(low_word(source.stream));
    d[v] = _mm512_set1_epi64(high_word(source.stream));
  }
  std::uint32_t key0 = low_word(source.key);
  std::uint32_t key1 = high_word(source.key);
  for (int round = 0; round < 10; ++round) {
    const __m512i k0 = _mm512_set1_epi64(key0);
    const __m512i k1 = _mm512_set1_epi64(key1);
    for (std::size_t v = 0; v < kVectors; ++v) {
      constexpr int kXorOfThree = 0x96;
      const __m512i p = _mm512_maskz_mul_epu32(kAll, a[v], multiplier0);
      const __m512i q = _mm512_maskz_mul_epu32(kAll, c[v], multiplier1);
      a[v] = _mm512_ternarylogic_epi64(_mm512_maskz_srli_epi64(kAll, q, 32), b[v], k0, kXorOfThree);
      c[v] = _mm512_ternarylogic_epi64(_mm512_maskz_srli_epi64(kAll, p, 32), d[v], k1, kXorOfThree);
      b[v] = q;
      d[v] = p;
    }
    key0 += kWeyl0;
    key1 += kWeyl1;
  }
  const __m512i first_four = _mm512_setr_epi64(0, 8, 1, 9, 2, 10, 3, 11);
  const __m512i last_four = _mm512_setr_epi64(4, 12, 5, 13, 6, 14, 7, 15);
  for (std::size_t v = 0; v < kVectors; ++v) {
    const __m512i x = _mm512_mask_blend_epi32(0xAAAA, a[v], _mm512_maskz_slli_epi64(kAll, b[v], 32));
    const __m512i y = _mm512_mask_blend_epi32(0xAAAA, c[v], _mm512_maskz_slli_epi64(kAll, d[v], 32));
    std::uint64_t* to = out.data() + 16 * v;
    _mm512_storeu_si512(to, _mm512_permutex2var_epi64(x, first_four, y));
    _mm512_storeu_si512(to + 8, _mm512_permutex2var_epi64(x, last_four, y));
  }
}
#endif

void philox_batch(Source source, std::uint64_t first_index, Draws& out) {
#if SOOPNAV_WIDE_PHILOX
  if (__builtin_cpu_supports("avx512f")) {
    philox_avx512(source, first_index, out);
    return;
  }
  if (__builtin_cpu_supports("avx2")) {
    philox_avx2(source, first_index, out);
    return;
  }
#endif
  philox_portable(source, first_index, out);
}

// Coefficients of the series, highest power first for Horner.
//   ln((1+s)/(1-s)) = 2 s (1 + z/3 + z^2/5 + ...), z = s^2 <= 0.0295 for arguments in [sqrt(1/2), sqrt(2)]
//   sin(x) = x (1 - z/3! + z^2/5! - ...),  cos(x) = 1 - z/2! + z^2/4! - ..., z = x^2 <= (pi/4)^2
template <class Real, std::size_t Terms>
constexpr std::array<Real, Terms> logarithm_series() {
  std::array<Real, Terms> c{};
  for (std::size_t k = 0; k < Terms; ++k) c[Terms - 1 - k] = static_cast<Real>(2.0 / static_cast<double>(2 * k + 1));
  return c;
}
template <class Real, std::size_t Terms>
constexpr std::array<Real, Terms> trigonometric_series(std::size_t first_power) {
  std::array<Real, Terms> c{};
  double factorial = 1.0;
  for (std::size_t k = 0; k < Terms; ++k) {
    c[Terms - 1 - k] = static_cast<Real>((k % 2 == 0 ? 1.0 : -1.0) / factorial);
    const auto n = static_cast<double>(2 * k + first_power);
    factorial *= (n + 1.0) * (n + 2.0);
  }
  return c;
}
template <class Real, std::size_t Terms>
inline Real horner(const std::array<Real, Terms>& c, Real z) {
  Real sum = c[0];
  for (std::size_t k = 1; k < Terms; ++k) sum = sum * z + c[k];
  return sum;
}

// Terms so that the truncation lies below half a unit in the last place.
constexpr auto kLog64 = logarithm_series<double, 11>();
constexpr auto kSin64 = trigonometric_series<double, 9>(1);
constexpr auto kCos64 = trigonometric_series<double, 10>(0);
constexpr auto kLog32 = logarithm_series<float, 5>();
constexpr auto kSin32 = trigonometric_series<float, 6>(1);
constexpr auto kCos32 = trigonometric_series<float, 6>(0);

// Box-Muller: r = sqrt(-2 ln u), angle = (quadrant + f) pi/2 with f uniform in [-1/2, 1/2); x = r cos, y = r sin.

struct Pair64 {
  double x;
  double y;
};

inline Pair64 box_muller(std::uint64_t radius_bits, std::uint64_t angle_bits) {
  constexpr std::uint64_t kOne = 0x3FF0000000000000U;
  constexpr std::uint64_t kMantissa = 0x000FFFFFFFFFFFFFU;
  constexpr std::uint64_t kRootHalf = 0x3FE6A09E667F3BCDU;  // bits of sqrt(1/2)
  constexpr double kHalfUlp = 0x1p-53;
  // 52 bits made a double in [1, 2); less 1 - 2^-53 that is u = (k + 1/2) 2^-52, exactly.
  const double u = std::bit_cast<double>(kOne | (radius_bits >> 12)) - (1.0 - kHalfUlp);
  // u = 2^e m with m in [sqrt(1/2), sqrt(2)). The exponent becomes a double by way of the mantissa of 2^52.
  const std::uint64_t shifted = std::bit_cast<std::uint64_t>(u) + (kOne - kRootHalf);
  const double exponent = std::bit_cast<double>(0x4330000000000000U | (shifted >> 52)) - (0x1p52 + 1023.0);
  const double m = std::bit_cast<double>((shifted & kMantissa) + kRootHalf);
  const double s = (m - 1.0) / (m + 1.0);
  const double logarithm = exponent * std::numbers::ln2 + s * horner(kLog64, s * s);
  const double r = std::sqrt(-2.0 * logarithm);

  const double f = std::bit_cast<double>(kOne | ((angle_bits << 2) >> 12)) - (1.5 - kHalfUlp);
  const double angle = f * (kPi / 2.0);
  const double z = angle * angle;
  const double sine = angle * horner(kSin64, z);
  const double cosine = horner(kCos64, z);
  // Quadrants 0..3: (c, s), (-s, c), (-c, -s), (s, -c). Selected with masks, which vectorise where branches do not.
  const std::uint64_t odd = std::uint64_t{0} - ((angle_bits >> 62) & 1U);
  const std::uint64_t c = std::bit_cast<std::uint64_t>(cosine);
  const std::uint64_t q = std::bit_cast<std::uint64_t>(sine);
  const std::uint64_t swap = (c ^ q) & odd;
  const std::uint64_t sign_y = angle_bits & 0x8000000000000000U;
  const std::uint64_t sign_x = (angle_bits ^ (angle_bits << 1)) & 0x8000000000000000U;
  return {r * std::bit_cast<double>(c ^ swap ^ sign_x), r * std::bit_cast<double>(q ^ swap ^ sign_y)};
}

struct Pair32 {
  float x;
  float y;
};

inline Pair32 box_muller(std::uint32_t radius_bits, std::uint32_t angle_bits) {
  constexpr std::uint32_t kOne = 0x3F800000U;
  constexpr std::uint32_t kRootHalf = 0x3F3504F3U;
  // 31 bits, so that the conversion is the signed one that every vector unit has; u = (k + 1/2) 2^-31, at most 1.
  const float u = (static_cast<float>(static_cast<std::int32_t>(radius_bits >> 1)) + 0.5F) * 0x1p-31F;
  const std::uint32_t shifted = std::bit_cast<std::uint32_t>(u) + (kOne - kRootHalf);
  const float exponent = static_cast<float>(static_cast<std::int32_t>(shifted >> 23) - 127);
  const float m = std::bit_cast<float>((shifted & 0x007FFFFFU) + kRootHalf);
  const float s = (m - 1.0F) / (m + 1.0F);
  const float logarithm = exponent * std::numbers::ln2_v<float> + s * horner(kLog32, s * s);
  const float r = std::sqrt(-2.0F * logarithm);

  const float angle =
      static_cast<float>(static_cast<std::int32_t>(angle_bits << 2)) * static_cast<float>(kPi / 4.0 / 2147483648.0);
  const float z = angle * angle;
  const float sine = angle * horner(kSin32, z);
  const float cosine = horner(kCos32, z);
  const std::uint32_t odd = 0U - ((angle_bits >> 30) & 1U);
  const std::uint32_t c = std::bit_cast<std::uint32_t>(cosine);
  const std::uint32_t q = std::bit_cast<std::uint32_t>(sine);
  const std::uint32_t swap = (c ^ q) & odd;
  const std::uint32_t sign_y = angle_bits & 0x80000000U;
  const std::uint32_t sign_x = (angle_bits ^ (angle_bits << 1)) & 0x80000000U;
  return {r * std::bit_cast<float>(c ^ swap ^ sign_x), r * std::bit_cast<float>(q ^ swap ^ sign_y)};
}

// Draws of one batch, in the order of their positions.

void batch_u64(Source source, std::uint64_t first_index, std::uint64_t* out) {
  Draws draws;
  philox_batch(source, first_index, draws);
  std::copy(draws.begin(), draws.end(), out);
}

void batch_u32(Source source, std::uint64_t first_index, std::uint32_t* out) {
  Draws draws;
  philox_batch(source, first_index, draws);
  for (std::size_t i = 0; i < draws.size(); ++i) {
    out[2 * i] = low_word(draws[i]);
    out[2 * i + 1] = high_word(draws[i]);
  }
}

SOOPNAV_TARGET_CLONES
void uniforms(const Draws& bits, double* out) {
  constexpr std::uint64_t kOne = 0x3FF0000000000000U;
  // The top 53 bits: 52 as the mantissa of a number in [1, 2), the last as 0 or 2^-53.
  for (std::size_t i = 0; i < bits.size(); ++i) {
    const std::uint64_t last = std::uint64_t{0} - ((bits[i] >> 11) & 1U);
    const double half_step = std::bit_cast<double>(last & std::bit_cast<std::uint64_t>(0x1p-53));
    out[i] = (std::bit_cast<double>(kOne | (bits[i] >> 12)) - 1.0) + half_step;
  }
}

void batch_uniform(Source source, std::uint64_t first_index, double* out) {
  Draws bits;
  philox_batch(source, first_index, bits);
  uniforms(bits, out);
}

SOOPNAV_TARGET_CLONES_WIDE
void normals(const Draws& bits, double* out) {
  for (std::size_t i = 0; i < bits.size(); i += 2) {
    const Pair64 pair = box_muller(bits[i], bits[i + 1]);
    out[i] = pair.x;
    out[i + 1] = pair.y;
  }
}

void batch_normal(Source source, std::uint64_t first_index, double* out) {
  Draws bits;
  philox_batch(source, first_index, bits);
  normals(bits, out);
}

SOOPNAV_TARGET_CLONES_WIDE
void normals(const Draws& bits, float* out) {
  for (std::size_t i = 0; i < bits.size(); ++i) {
    const Pair32 pair = box_muller(low_word(bits[i]), high_word(bits[i]));
    out[2 * i] = pair.x;
    out[2 * i + 1] = pair.y;
  }
}

void batch_normal_float(Source source, std::uint64_t first_index, float* out) {
  Draws bits;
  philox_batch(source, first_index, bits);
  normals(bits, out);
}

std::array<std::uint32_t, 4> one_block(Source source, Kind kind, std::uint64_t block) {
  const std::uint64_t index = block_index(kind, block);
  return philox_4x32_10({low_word(index), high_word(index), low_word(source.stream), high_word(source.stream)},
                        {low_word(source.key), high_word(source.key)});
}

// Runs through `count` draws from `position` on, batch by batch, and hands `use(draws, n)` the runs in order.
template <class T, std::size_t PerBlock, class Batch, class Use>
void for_each_run(Source source, Kind kind, std::uint64_t position, std::size_t count, Batch batch, Use use) {
  std::array<T, PerBlock * kBlocks> draws;
  std::size_t done = 0;
  while (done < count) {
    const std::uint64_t at = position + done;
    batch(source, block_index(kind, at / PerBlock), draws.data());
    const auto offset = static_cast<std::size_t>(at % PerBlock);
    const std::size_t n = std::min(draws.size() - offset, count - done);
    use(draws.data() + offset, done, n);
    done += n;
  }
}

template <class T, std::size_t PerBlock, class Batch>
void fill(Source source, Kind kind, std::uint64_t& position, std::span<T> out, Batch batch) {
  // Whole batches go straight to where they belong.
  constexpr std::size_t kDraws = PerBlock * kBlocks;
  std::size_t whole = 0;
  if (position % PerBlock == 0) {
    for (; whole + kDraws <= out.size(); whole += kDraws) {
      batch(source, block_index(kind, (position + whole) / PerBlock), out.data() + whole);
    }
  }
  for_each_run<T, PerBlock>(source, kind, position + whole, out.size() - whole, batch,
                            [rest = out.subspan(whole)](const T* draws, std::size_t at, std::size_t n) {
                              std::copy_n(draws, n, rest.begin() + static_cast<std::ptrdiff_t>(at));
                            });
  position += out.size();
}

}  // namespace

std::array<std::uint32_t, 4> philox_4x32_10(const std::array<std::uint32_t, 4>& counter,
                                            const std::array<std::uint32_t, 2>& key) noexcept {
  const philox4x32_ctr_t c{{counter[0], counter[1], counter[2], counter[3]}};
  const philox4x32_key_t k{{key[0], key[1]}};
  const philox4x32_ctr_t r = philox4x32_R(10, c, k);
  return {r.v[0], r.v[1], r.v[2], r.v[3]};
}

RandomStream RandomStream::substream(std::uint64_t index) const noexcept {
  // 128 bits hashed from (seed, stream, index) name the child. The key is complemented so that these blocks are not
  // among the draws of this stream.
  const std::uint64_t key = ~key_;
  const auto words = philox_4x32_10({low_word(index), high_word(index), low_word(stream_), high_word(stream_)},
                                    {low_word(key), high_word(key)});
  return RandomStream(join(words[0], words[1]), join(words[2], words[3]));
}

std::uint64_t RandomStream::next_u64() noexcept {
  const auto w = one_block({key_, stream_}, Kind::kBits64, position_ / 2);
  return position_++ % 2 == 0 ? join(w[0], w[1]) : join(w[2], w[3]);
}

std::uint32_t RandomStream::next_u32() noexcept {
  const auto w = one_block({key_, stream_}, Kind::kBits32, position_ / 4);
  return w[position_++ % 4];
}

double RandomStream::uniform() noexcept { return static_cast<double>(next_u64() >> 11) * 0x1p-53; }

double RandomStream::normal() noexcept {
  const auto w = one_block({key_, stream_}, Kind::kNormal, position_ / 2);
  const Pair64 pair = box_muller(join(w[0], w[1]), join(w[2], w[3]));
  return position_++ % 2 == 0 ? pair.x : pair.y;
}

float RandomStream::normal_float() noexcept {
  const auto w = one_block({key_, stream_}, Kind::kNormalFloat, position_ / 4);
  const std::size_t first = position_ % 4 < 2 ? 0 : 2;
  const Pair32 pair = box_muller(w[first], w[first + 1]);
  return position_++ % 2 == 0 ? pair.x : pair.y;
}

void RandomStream::fill_u64(std::span<std::uint64_t> out) noexcept {
  fill<std::uint64_t, 2>({key_, stream_}, Kind::kBits64, position_, out, batch_u64);
}

void RandomStream::fill_u32(std::span<std::uint32_t> out) noexcept {
  fill<std::uint32_t, 4>({key_, stream_}, Kind::kBits32, position_, out, batch_u32);
}

void RandomStream::fill_uniform(std::span<double> out) noexcept {
  fill<double, 2>({key_, stream_}, Kind::kBits64, position_, out, batch_uniform);
}

void RandomStream::fill_normal(std::span<double> out) noexcept {
  fill<double, 2>({key_, stream_}, Kind::kNormal, position_, out, batch_normal);
}

void RandomStream::fill_normal(std::span<float> out) noexcept {
  fill<float, 4>({key_, stream_}, Kind::kNormalFloat, position_, out, batch_normal_float);
}

// The standard gives std::complex<float> the layout of float[2], so a run of samples is a run of twice as many floats.

void RandomStream::fill_complex_normal(std::span<Cf32> out, double variance) noexcept {
  const std::span<float> parts(reinterpret_cast<float*>(out.data()), 2 * out.size());
  const auto sigma = static_cast<float>(std::sqrt(variance / 2.0));
  for_each_run<float, 4>({key_, stream_}, Kind::kNormalFloat, position_, parts.size(), batch_normal_float,
                         [parts, sigma](const float* draws, std::size_t at, std::size_t n) {
                           for (std::size_t i = 0; i < n; ++i) parts[at + i] = sigma * draws[i];
                         });
  position_ += parts.size();
}

void RandomStream::add_complex_normal(std::span<Cf32> samples, double variance) noexcept {
  const std::span<float> parts(reinterpret_cast<float*>(samples.data()), 2 * samples.size());
  const auto sigma = static_cast<float>(std::sqrt(variance / 2.0));
  for_each_run<float, 4>({key_, stream_}, Kind::kNormalFloat, position_, parts.size(), batch_normal_float,
                         [parts, sigma](const float* draws, std::size_t at, std::size_t n) {
                           for (std::size_t i = 0; i < n; ++i) parts[at + i] += sigma * draws[i];
                         });
  position_ += parts.size();
}

}  // namespace soopnav
