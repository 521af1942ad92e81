#include "soopnav/estimation/particle_bins.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <stdexcept>
#include <string>

#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/particle_spread.hpp"
#include "soopnav/estimation/particle_weights.hpp"

namespace soopnav::detail {

ParticleBins::ParticleBins(const ParticleOptions& options, std::size_t numbers)
    : sizes_(options.adaptive.bin_sizes), least_(options.adaptive.least), most_(options.count) {
  if (sizes_.empty()) return;
  if (sizes_.size() != numbers) {
    throw std::invalid_argument("adaptive.bin_sizes has " + std::to_string(sizes_.size()) + " numbers; the state has " +
                                std::to_string(numbers));
  }
  factor_ = 0.5 / options.adaptive.divergence;
  normal_ = normal_two_sided_gate(2.0 * (1.0 - options.adaptive.probability));
  table_.resize(std::bit_ceil(2 * most_));
}

void ParticleBins::clear() noexcept {
  std::fill(table_.begin(), table_.end(), std::uint64_t{0});
  bins_ = 0;
}

bool ParticleBins::add(std::span<const double> particle) noexcept {
  // The bin's name: its whole coordinates, mixed (finaliser of splitmix64). Two bins of one name are as rare as 2^-64
  // per pair.
  std::uint64_t name = 0x9E3779B97F4A7C15U;
  for (std::size_t i = 0; i < sizes_.size(); ++i) {
    if (sizes_[i] == 0.0) continue;
    name ^= std::bit_cast<std::uint64_t>(std::floor(particle[i] / sizes_[i]) + 0.0);
    name = (name ^ (name >> 30U)) * 0xBF58476D1CE4E5B9U;
    name = (name ^ (name >> 27U)) * 0x94D049BB133111EBU;
    name ^= name >> 31U;
  }
  if (name == 0) name = 1;
  const std::size_t mask = table_.size() - 1;
  for (std::size_t at = name & mask;; at = (at + 1) & mask) {
    if (table_[at] == name) return true;
    if (table_[at] == 0) {
      table_[at] = name;
      ++bins_;
      return wanted() < most_;
    }
  }
}

std::size_t ParticleBins::wanted() const noexcept {
  if (bins_ < 2) return least_;
  // The chi-square quantile of bins - 1 degrees of freedom, by Wilson and Hilferty.
  const auto dof = static_cast<double>(bins_ - 1);
  const double spread = 2.0 / (9.0 * dof);
  const double root = 1.0 - spread + std::sqrt(spread) * normal_;
  const double wanted = std::ceil(factor_ * dof * root * root * root);
  if (!(wanted < static_cast<double>(most_))) return most_;
  return std::max(least_, static_cast<std::size_t>(wanted));
}

double kernel_width(double regularisation, int dim, std::size_t count) noexcept {
  const auto n = static_cast<double>(dim);
  const double best = portable_exp(portable_log(4.0 / ((n + 2.0) * static_cast<double>(count))) / (n + 4.0));
  return std::min(1.0, regularisation * best);
}

}  // namespace soopnav::detail
