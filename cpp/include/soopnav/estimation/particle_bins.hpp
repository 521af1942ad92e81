#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/estimation/particle_options.hpp"

namespace soopnav::detail {

/// Counts the bins that particles lie in, and from it how many particles are wanted (doc/particle_filter.md eq. 17).
class ParticleBins {
 public:
  /// Inactive, and without storage, when `options.adaptive` has no bins. Throws std::invalid_argument unless there is a
  /// bin size for each of the `numbers` of a state.
  ParticleBins(const ParticleOptions& options, std::size_t numbers);

  [[nodiscard]] bool active() const noexcept { return !sizes_.empty(); }
  void clear() noexcept;
  /// Adds a particle. False when `count` particles are wanted already: more bins change nothing. No allocation.
  bool add(std::span<const double> particle) noexcept;
  /// Particles that the bins so far call for, least ... count.
  [[nodiscard]] std::size_t wanted() const noexcept;
  [[nodiscard]] std::size_t bins() const noexcept { return bins_; }
  [[nodiscard]] std::size_t storage_bytes() const noexcept { return table_.capacity() * sizeof(std::uint64_t); }

 private:
  std::vector<double> sizes_;
  std::size_t least_ = 0;
  std::size_t most_ = 0;
  double factor_ = 0.0;               // 1 / (2 divergence)
  double normal_ = 0.0;               // quantile
  std::vector<std::uint64_t> table_;  // open addressing; 0 where free
  std::size_t bins_ = 0;
};

}  // namespace soopnav::detail
