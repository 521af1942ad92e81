#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

/// Kernels of the particle filter compiled for the baseline instruction set only.
namespace particle_baseline {

template <class T>
std::array<double, 3> weigh(const T* log_weights, std::size_t n);
template <class T>
void relative(const T* log_weights, double reference, std::size_t n, double* weights);
bool systematic(std::span<const double> weights, std::uint64_t seed, std::span<std::uint32_t> ancestors);
void normals(std::uint64_t seed, std::span<float> out);
void normals(std::uint64_t seed, std::span<double> out);

}  // namespace particle_baseline
