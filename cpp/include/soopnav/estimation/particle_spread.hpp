#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>

#include "soopnav/core/packet_math.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/particle_local.hpp"
#include "soopnav/estimation/particle_view.hpp"
#include "soopnav/estimation/resampling.hpp"

namespace soopnav::detail {

/// Width h of a Gaussian kernel over `dim` components that is best for a normal density (eq. 15), at most 1.
[[nodiscard]] double kernel_width(double regularisation, int dim, std::size_t count) noexcept;

/// A square root of a covariance that may be singular, by LDLᵀ.
template <class Square>
[[nodiscard]] Square root_of(const Square& P) {
  const Eigen::LDLT<Square> ldlt(P);
  Square root = ldlt.matrixL();
  root = ldlt.transpositionsP().transpose() * root;
  return root * ldlt.vectorD().cwiseMax(0.0).cwiseSqrt().asDiagonal();
}

/// The kernel that copies are spread with: x <- m.retract(a m.local(x) + root w), w standard normal (eq. 16).
template <class State, class T>
struct ParticleSpread {
  static constexpr int kSize = kStateSize<State>;
  static constexpr int kDim = State::kDim;
  static constexpr auto kComponents = static_cast<std::size_t>(kSize);

  State mean;                              // m, of the cloud
  Eigen::Matrix<double, kDim, kDim> root;  // times its transpose: h² times the covariance of the cloud
  double shrink = 1.0;                     // a = sqrt(1 - h²): mean and covariance stay what they are
  RandomStream noise{0};                   // normal k of particle i is number k * stride + i
  std::uint64_t stride = 0;

  /// `n` particles, the first of them number `first`, into `to`; that may be where they are.
  void apply(const ParticleColumns<T, kSize>& from, std::size_t first, std::size_t n,
             const std::array<T*, kComponents>& to) const {
    using P = Packet<T>;
    constexpr auto kD = static_cast<std::size_t>(kDim);
    std::array<float, kParticleChunk * kD> normals;
    for (std::size_t k = 0; k < kD; ++k) {
      RandomStream draws = noise;
      draws.seek(k * stride + first);
      draws.fill_normal(std::span(normals).subspan(k * kParticleChunk, n));
    }
    const P towards_mean(static_cast<T>(shrink - 1.0));
    for (std::size_t at = 0; at < n; at += P::kWidth) {
      ParticleView<State, T> x;
      from.load(at, x);
      std::array<P, kD> d;
      local_packets(mean, x, d);
      for (std::size_t i = 0; i < kD; ++i) {
        d[i] = towards_mean * d[i];
        for (std::size_t k = 0; k < kD; ++k) {
          const auto factor = static_cast<T>(root(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k)));
          if (factor != T{0}) d[i] += P(factor) * P::load_float(&normals[k * kParticleChunk + at]);
        }
      }
      retract_packets<State>(d, x);
      normalize(x);
      for (std::size_t c = 0; c < kComponents; ++c) x.values[c].store(to[c] + at);
    }
  }
};

}  // namespace soopnav::detail
