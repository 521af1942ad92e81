#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "soopnav/core/random.hpp"

namespace soopnav {

/// How offspring are drawn from weights (doc/particle_filter.md, eq. 7 to 11). For all but `kNearest` particle i has
/// N w_i offspring on average; they differ in how far one draw strays from that.
enum class Resampling : std::uint8_t {
  kMultinomial,  ///< N independent draws: offspring of variance N w (1 - w)
  kResidual,     ///< floor(N w) each, the rest multinomial
  kStratified,   ///< one draw in each of N equal strata
  kSystematic,   ///< one draw for all: floor(N w) or one more; the least variance and the fastest
  /// The nearest entry of the cumulative sum to each systematic position, as the listings of nielsen's Annex A have it.
  /// WRONG: particle i gets N (w_i + w_i+1) / 2 offspring. Kept to reproduce those figures and to show the difference.
  kNearest,
};

/// "multinomial", "residual", "stratified", "systematic", "nearest"; "unknown" for a value that is no enumerator.
[[nodiscard]] std::string_view to_string(Resampling scheme) noexcept;

/// Draws `ancestors.size()` indices into `weights`, in ascending order.
///
/// `weights` are >= 0 and need not be normalised. A weight of zero has no offspring, however the sums round. `random`
/// is moved by as many draws as the scheme needs: N + 1 or N uniforms (multinomial, stratified), one (systematic,
/// nearest), up to N + 1 (residual). O(N) in time, no allocation. Returns false, having touched nothing, when a weight
/// is negative or NaN, or their sum is zero or infinite, or there are more than 2^31 - 1 of them; true and nothing
/// drawn for no ancestors.
[[nodiscard]] bool resample(Resampling scheme, std::span<const double> weights, RandomStream& random,
                            std::span<std::uint32_t> ancestors) noexcept;

namespace detail {

/// Particles per chunk: the unit of work of a thread, and of every sum. Results depend on it, so it is fixed.
inline constexpr std::size_t kParticleChunk = 512;

/// The offspring of one chunk under systematic resampling.
///
/// Particle i of the chunk gets the outputs j with S <= (j + offset) / scale < S + weights[i], S being `base` plus the
/// weights before it. The outputs [begin, end) all belong to this chunk; what rounding leaves over goes to its last
/// particle that has a weight.
struct ChunkShare {
  const double* weights;
  std::size_t n;        ///< of them, at most kParticleChunk
  double base;          ///< sum of the weights of the chunks before
  double scale;         ///< outputs per unit of weight
  double offset;        ///< the one uniform draw
  std::uint32_t first;  ///< index of the chunk's first particle
  std::int32_t begin;   ///< `chunk_boundary` at `base` ...
  std::int32_t end;     ///< ... and behind the chunk
};
/// Writes ancestors[begin ... end). No allocation.
void share_chunk(const ChunkShare& share, std::uint32_t* ancestors) noexcept;

/// Number of outputs whose position lies below the cumulative weight `sum`, in 0 ... count.
[[nodiscard]] std::int32_t chunk_boundary(double sum, double scale, double offset, std::int32_t count) noexcept;

}  // namespace detail
}  // namespace soopnav
