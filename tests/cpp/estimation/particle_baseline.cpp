// The library's own kernels once more, without the wider vectors and under another name, for particle_law_test.cpp.
#ifndef SOOPNAV_NO_TARGET_CLONES
#define SOOPNAV_NO_TARGET_CLONES
#endif
#define soopnav soopnav_baseline
#include "core/random.cpp"
#include "estimation/particle_weights.cpp"
#include "estimation/resampling.cpp"
#undef soopnav

#include "estimation/particle_baseline.hpp"

namespace particle_baseline {

template <class T>
std::array<double, 3> weigh(const T* log_weights, std::size_t n) {
  const auto sums = soopnav_baseline::detail::weigh_chunk(log_weights, n);
  return {sums.largest, sums.sum, sums.squares};
}
template <class T>
void relative(const T* log_weights, double reference, std::size_t n, double* weights) {
  soopnav_baseline::detail::relative_weights(log_weights, reference, n, weights);
}
template std::array<double, 3> weigh(const double*, std::size_t);
template std::array<double, 3> weigh(const float*, std::size_t);
template void relative(const double*, double, std::size_t, double*);
template void relative(const float*, double, std::size_t, double*);

bool systematic(std::span<const double> weights, std::uint64_t seed, std::span<std::uint32_t> ancestors) {
  soopnav_baseline::RandomStream random(seed);
  return soopnav_baseline::resample(soopnav_baseline::Resampling::kSystematic, weights, random, ancestors);
}
void normals(std::uint64_t seed, std::span<float> out) { soopnav_baseline::RandomStream(seed).fill_normal(out); }
void normals(std::uint64_t seed, std::span<double> out) { soopnav_baseline::RandomStream(seed).fill_normal(out); }

}  // namespace particle_baseline
