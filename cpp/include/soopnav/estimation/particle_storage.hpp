#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <new>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/estimation/particle_kernel.hpp"
#include "soopnav/estimation/particle_threads.hpp"
#include "soopnav/estimation/particle_weights.hpp"
#include "soopnav/estimation/resampling.hpp"

namespace soopnav::detail {

template <class T>
struct CacheAligned {
  using value_type = T;
  CacheAligned() = default;
  template <class U>
  explicit(false) CacheAligned(const CacheAligned<U>&) noexcept {}
  [[nodiscard]] T* allocate(std::size_t n) {
    return static_cast<T*>(::operator new (n * sizeof(T), std::align_val_t{64}));
  }
  /// Elements that nothing is given for stay as the memory was: all of them are written before they are read.
  template <class U>
  void construct(U* p) noexcept {
    ::new (static_cast<void*>(p)) U;
  }
  void deallocate(T* p, std::size_t) noexcept { ::operator delete (p, std::align_val_t{64}); }
  friend bool operator==(const CacheAligned&, const CacheAligned&) { return true; }
};
template <class T>
using CacheAlignedVector = std::vector<T, CacheAligned<T>>;

/// Ancestors of `outputs` particles under systematic resampling, into the store; its sums are used up.
template <class Store>
void share_systematic(const Store& store, const WeightSums& total, double offset, std::size_t outputs,
                      ParticleThreads& threads) {
  using Scalar = typename Store::Scalar;
  const double scale = static_cast<double>(outputs) / total.sum;
  const auto count = static_cast<std::int32_t>(outputs);
  // Where each chunk's share begins goes into its sums, which are not needed any more: largest becomes the base, sum
  // the first output.
  std::size_t last = 0;
  double base = 0.0;
  for (std::size_t chunk = 0; chunk < store.chunks(); ++chunk) {
    // What is too small for its weights to be told from zero in `Scalar` counts as zero.
    constexpr double kLeast = sizeof(Scalar) == 8 ? 1e-300 : 1e-36;
    WeightSums& sums = store.sums[chunk];
    const double factor = sums.sum > 0.0 ? portable_exp(sums.largest - total.largest) : 0.0;
    const double sum = factor > kLeast ? factor * sums.sum : 0.0;
    if (sum > 0.0) last = chunk;
    sums.largest = base;
    sums.sum = chunk_boundary(base, scale, offset, count);
    base += sum;
  }
  for (std::size_t chunk = last + 1; chunk < store.chunks(); ++chunk) store.sums[chunk].sum = count;
  threads.run(store.chunks(), [&](std::size_t chunk) {
    const auto begin = static_cast<std::int32_t>(store.sums[chunk].sum);
    const auto end = chunk + 1 < store.chunks() ? static_cast<std::int32_t>(store.sums[chunk + 1].sum) : count;
    if (begin >= end) return;
    std::array<double, kParticleChunk> w;
    const std::size_t first = store.first(chunk);
    relative_weights(store.log_weights + first, total.largest, store.size(chunk), w.data());
    share_chunk({w.data(), store.size(chunk), store.sums[chunk].largest, scale, offset,
                 static_cast<std::uint32_t>(first), begin, end},
                store.ancestors());
  });
}

/// Throws std::invalid_argument unless particles and log-weights could be those of a cloud of least ... most particles
/// of `numbers` numbers each.
template <std::floating_point T>
void check_cloud(std::span<const T> components, std::span<const T> log_weights, std::size_t numbers, std::size_t least,
                 std::size_t most) {
  const std::size_t count = log_weights.size();
  if (count < least || count > most) {
    const std::string range = std::to_string(least) + (least == most ? "" : " ... " + std::to_string(most));
    throw std::invalid_argument("log_weights has " + std::to_string(count) + " numbers; " + range + " expected");
  }
  if (components.size() != count * numbers) {
    throw std::invalid_argument("components has " + std::to_string(components.size()) + " numbers; " +
                                std::to_string(count * numbers) + " expected");
  }
  if (!std::all_of(components.begin(), components.end(), [](T x) { return std::isfinite(x); })) {
    throw std::invalid_argument("components: a number is not finite");
  }
  const auto sound = [](T w) { return w <= std::numeric_limits<T>::max(); };
  if (!std::all_of(log_weights.begin(), log_weights.end(), sound) ||
      !std::any_of(log_weights.begin(), log_weights.end(), [](T w) { return std::isfinite(w); })) {
    throw std::invalid_argument("log_weights: NaN, +infinity, or no weight at all");
  }
}

}  // namespace soopnav::detail
