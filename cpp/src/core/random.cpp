#include "soopnav/core/random.hpp"

#include <Random123/philox.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>

#include "core/target_clones.hpp"
#include "soopnav/core/constants.hpp"

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
struct Words {
  std::array<Lane32, 4> w;
};

// Multipliers and Weyl constants of Philox 4x32 (Salmon et al., section 4); the tests hold the lanes against Random123.
constexpr std::uint32_t kMultiplier0 = 0xD2511F53U;
constexpr std::uint32_t kMultiplier1 = 0xCD9E8D57U;
constexpr std::uint32_t kWeyl0 = 0x9E3779B9U;
constexpr std::uint32_t kWeyl1 = 0xBB67AE85U;

inline void philox_batch(Source source, std::uint64_t first_index, Words& words) {
  Lane32& a = words.w[0];
  Lane32& b = words.w[1];
  Lane32& c = words.w[2];
  Lane32& d = words.w[3];
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

SOOPNAV_TARGET_CLONES
void batch_u64(Source source, std::uint64_t first_index, std::uint64_t* out) {
  Words words;
  philox_batch(source, first_index, words);
  for (std::size_t i = 0; i < kBlocks; ++i) {
    out[2 * i] = join(words.w[0][i], words.w[1][i]);
    out[2 * i + 1] = join(words.w[2][i], words.w[3][i]);
  }
}

SOOPNAV_TARGET_CLONES
void batch_u32(Source source, std::uint64_t first_index, std::uint32_t* out) {
  Words words;
  philox_batch(source, first_index, words);
  for (std::size_t i = 0; i < kBlocks; ++i) {
    for (std::size_t j = 0; j < 4; ++j) out[4 * i + j] = words.w[j][i];
  }
}

SOOPNAV_TARGET_CLONES
void batch_uniform(Source source, std::uint64_t first_index, double* out) {
  constexpr std::uint64_t kOne = 0x3FF0000000000000U;
  std::array<std::uint64_t, 2 * kBlocks> bits;
  Words words;
  philox_batch(source, first_index, words);
  for (std::size_t i = 0; i < kBlocks; ++i) {
    bits[2 * i] = join(words.w[0][i], words.w[1][i]);
    bits[2 * i + 1] = join(words.w[2][i], words.w[3][i]);
  }
  // The top 53 bits: 52 as the mantissa of a number in [1, 2), the last as 0 or 2^-53.
  for (std::size_t i = 0; i < 2 * kBlocks; ++i) {
    const std::uint64_t last = std::uint64_t{0} - ((bits[i] >> 11) & 1U);
    const double half_step = std::bit_cast<double>(last & std::bit_cast<std::uint64_t>(0x1p-53));
    out[i] = (std::bit_cast<double>(kOne | (bits[i] >> 12)) - 1.0) + half_step;
  }
}

SOOPNAV_TARGET_CLONES
void batch_normal(Source source, std::uint64_t first_index, double* out) {
  Words words;
  philox_batch(source, first_index, words);
  for (std::size_t i = 0; i < kBlocks; ++i) {
    const Pair64 pair = box_muller(join(words.w[0][i], words.w[1][i]), join(words.w[2][i], words.w[3][i]));
    out[2 * i] = pair.x;
    out[2 * i + 1] = pair.y;
  }
}

SOOPNAV_TARGET_CLONES
void batch_normal_float(Source source, std::uint64_t first_index, float* out) {
  Words words;
  philox_batch(source, first_index, words);
  for (std::size_t i = 0; i < kBlocks; ++i) {
    const Pair32 first = box_muller(words.w[0][i], words.w[1][i]);
    const Pair32 second = box_muller(words.w[2][i], words.w[3][i]);
    out[4 * i] = first.x;
    out[4 * i + 1] = first.y;
    out[4 * i + 2] = second.x;
    out[4 * i + 3] = second.y;
  }
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
  for_each_run<T, PerBlock>(source, kind, position, out.size(), batch,
                            [out](const T* draws, std::size_t at, std::size_t n) {
                              std::copy_n(draws, n, out.begin() + static_cast<std::ptrdiff_t>(at));
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
