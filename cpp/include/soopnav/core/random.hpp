#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>

#include "soopnav/core/iq.hpp"

namespace soopnav {

/// The Philox 4x32-10 bijection of `counter` under `key` (Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as
/// easy as 1, 2, 3", SC11; Random123). `RandomStream` is made of it; open for tests and for counters of one's own.
[[nodiscard]] std::array<std::uint32_t, 4> philox_4x32_10(const std::array<std::uint32_t, 4>& counter,
                                                          const std::array<std::uint32_t, 2>& key) noexcept;

/// A counter-based stream of random numbers, named by a seed and a stream number.
///
/// There is nothing hidden: a draw is a fixed function of (seed, stream, kind of draw, position), and drawing one
/// number moves the position by one, whatever its kind. So draw k does not depend on who drew before it: threads copy
/// the stream, `seek` to their share, and together give the bits of a single thread. Kinds never share random bits. A
/// copy is an independent cursor over the same numbers; independent numbers come from `substream`.
///
/// Normals are Box-Muller with this library's own polynomials on +, -, *, / and sqrt only: the same bits from any
/// compiler, vector width and C library that keep IEEE 754 (and no contraction, as this project is built).
/// Nothing here allocates or throws. Positions count to 2^63; the sequence of one (seed, stream, kind) does not repeat.
/// Meets std::uniform_random_bit_generator, so it serves std::shuffle and the distributions of <random>.
class RandomStream {
 public:
  using result_type = std::uint64_t;

  explicit constexpr RandomStream(std::uint64_t seed = 0, std::uint64_t stream = 0) noexcept
      : key_(seed), stream_(stream) {}

  /// The stream named `index` below this one, at position 0: independent of this one, of its other substreams and of
  /// theirs. The same whatever this stream's position is. One per run, per source, per sensor.
  [[nodiscard]] RandomStream substream(std::uint64_t index) const noexcept;

  [[nodiscard]] constexpr std::uint64_t position() const noexcept { return position_; }  ///< of the next draw
  constexpr void seek(std::uint64_t position) noexcept { position_ = position; }         ///< next draw: `position`
  constexpr void skip(std::uint64_t draws) noexcept { position_ += draws; }

  [[nodiscard]] std::uint64_t next_u64() noexcept;  ///< 64 random bits
  [[nodiscard]] std::uint32_t next_u32() noexcept;  ///< 32 random bits
  [[nodiscard]] double uniform() noexcept;          ///< uniform on the multiples of 2^-53 in [0, 1)
  [[nodiscard]] double uniform(double low, double high) noexcept { return low + (high - low) * uniform(); }
  [[nodiscard]] double normal() noexcept;  ///< standard normal, |x| <= 8.58
  [[nodiscard]] double normal(double mean, double sigma) noexcept { return mean + sigma * normal(); }
  /// Standard normal in single precision, |x| <= 6.67. Not the rounded `normal()` of the same position.
  [[nodiscard]] float normal_float() noexcept;

  void fill_u64(std::span<std::uint64_t> out) noexcept;  ///< as repeated `next_u64()`
  void fill_u32(std::span<std::uint32_t> out) noexcept;  ///< as repeated `next_u32()`
  void fill_uniform(std::span<double> out) noexcept;     ///< as repeated `uniform()`
  void fill_normal(std::span<double> out) noexcept;      ///< as repeated `normal()`, and much faster
  void fill_normal(std::span<float> out) noexcept;       ///< as repeated `normal_float()`, and much faster

  /// Circular complex normals with E|x|^2 = `variance` >= 0: `normal_float()` times sqrt(variance / 2), real part
  /// first. Each sample takes two positions.
  void fill_complex_normal(std::span<Cf32> out, double variance = 1.0) noexcept;

  /// Adds what `fill_complex_normal` would have written.
  void add_complex_normal(std::span<Cf32> samples, double variance) noexcept;

  [[nodiscard]] static constexpr result_type min() noexcept { return 0; }
  [[nodiscard]] static constexpr result_type max() noexcept { return std::numeric_limits<result_type>::max(); }
  [[nodiscard]] result_type operator()() noexcept { return next_u64(); }

  /// Same numbers at the same position.
  friend constexpr bool operator==(const RandomStream&, const RandomStream&) = default;

 private:
  std::uint64_t key_;
  std::uint64_t stream_;
  std::uint64_t position_ = 0;
};

}  // namespace soopnav
