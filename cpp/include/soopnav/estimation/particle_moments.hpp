#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>

#include "soopnav/core/packet_math.hpp"
#include "soopnav/estimation/particle_kernel.hpp"
#include "soopnav/estimation/particle_local.hpp"
#include "soopnav/estimation/particle_view.hpp"

namespace soopnav::detail {

/// Chunks are summed in at most so many groups, then the groups one after the other: an order that no thread changes.
inline constexpr std::size_t kMomentGroups = 64;

/// Sums of one group: the weighted numbers for the mean, or the weighted products for the covariance.
template <class State, class T>
struct MomentBody {
  static constexpr int kSize = kStateSize<State>;
  static constexpr int kDim = State::kDim;
  // For the mean: every number, cosine and sine of a heading, the ten products of a quaternion. For the covariance: the
  // lower triangle.
  static constexpr std::size_t kMeanSums = static_cast<std::size_t>(kSize) + 12;
  static constexpr std::size_t kCovarianceSums = static_cast<std::size_t>(kDim * (kDim + 1) / 2);
  static constexpr std::size_t kSums = std::max(kMeanSums, kCovarianceSums);
  using Sums = std::array<double, kSums>;

  ParticleStore<T, kSize> store;
  double reference;   // log-weight
  const State* mean;  // null: sums for the mean
  std::span<Sums> out;

  void operator()(std::size_t group) const {
    using P = Packet<double>;
    std::array<P, kSums> sums;
    for (P& s : sums) s = P(0);
    std::array<double, kParticleChunk> weights;
    const std::size_t groups = out.size();
    for (std::size_t chunk = store.chunks() * group / groups; chunk < store.chunks() * (group + 1) / groups; ++chunk) {
      const std::size_t first = store.first(chunk);
      const std::size_t n = store.size(chunk);
      relative_weights(store.log_weights + first, reference, n, weights.data());
      for (std::size_t at = 0; at < n; at += P::kWidth) {
        const P w = P::load(&weights[at]);
        ParticleView<State, double> x;
        for (std::size_t c = 0; c < x.values.size(); ++c) {
          const T* from = store.present + c * store.stride + first + at;
          if constexpr (sizeof(T) == 8) {
            x.values[c] = P::load(from);
          } else {
            x.values[c] = P::load_float(from);
          }
        }
        if (mean == nullptr) {
          add_mean(w, x, sums);
        } else {
          std::array<P, static_cast<std::size_t>(kDim)> d;
          local_packets(*mean, x, d);
          std::size_t k = 0;
          for (std::size_t i = 0; i < d.size(); ++i) {
            const P wd = w * d[i];
            for (std::size_t j = 0; j <= i; ++j, ++k) sums[k] += wd * d[j];
          }
        }
      }
    }
    for (std::size_t k = 0; k < kSums; ++k) out[group][k] = sum(sums[k]);
  }

  static State mean_of(const Sums& sums, double total) {
    State m{};
    for (int i = 0; i < kSize; ++i) m.x[i] = sums[static_cast<std::size_t>(i)] / total;
    constexpr auto kAngle = static_cast<std::size_t>(kSize);
    if constexpr (HoldsRole<State, Role<1, HeadingTag>>) {
      m.x[State::stored_at(kHeading)] = portable_atan2(sums[kAngle + 1], sums[kAngle]);
    }
    if constexpr (HoldsRole<State, Role<3, AttitudeTag>>) {
      Eigen::Matrix4d products;
      std::size_t k = kAngle + 2;
      for (int i = 0; i < 4; ++i) {
        for (int j = 0; j <= i; ++j, ++k) products(i, j) = products(j, i) = sums[k] / total;
      }
      const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> solver(products);
      Eigen::Vector4d q = solver.eigenvectors().col(3);
      if (q[0] < 0.0) q = -q;
      m(kAttitude) = q;
    }
    m.normalize();
    return m;
  }

 private:
  static SOOPNAV_INLINE void add_mean(const Packet<double>& w, const ParticleView<State, double>& x,
                                      std::array<Packet<double>, kSums>& sums) {
    for (std::size_t c = 0; c < x.values.size(); ++c) sums[c] += w * x.values[c];
    constexpr auto kAngle = static_cast<std::size_t>(kSize);
    if constexpr (HoldsRole<State, Role<1, HeadingTag>>) {
      const auto turn = sincos(x.values[static_cast<std::size_t>(State::stored_at(kHeading))]);
      sums[kAngle] += w * turn.cos;
      sums[kAngle + 1] += w * turn.sin;
    }
    if constexpr (HoldsRole<State, Role<3, AttitudeTag>>) {
      const auto* q = x.values.data() + State::stored_at(kAttitude);
      std::size_t k = kAngle + 2;
      for (int i = 0; i < 4; ++i) {
        for (int j = 0; j <= i; ++j, ++k) sums[k] += w * q[i] * q[j];
      }
    }
  }
};

/// The weights of the particles, normalised, handed to `take(i, w)` in order.
template <class T, int Size, class Take>
void for_each_weight(const ParticleStore<T, Size>& store, const WeightSums& total, const Take& take) {
  std::array<double, kParticleChunk> w;
  for (std::size_t chunk = 0; chunk < store.chunks(); ++chunk) {
    const std::size_t first = store.first(chunk);
    relative_weights(store.log_weights + first, total.largest, store.size(chunk), w.data());
    const std::size_t n = std::min(store.size(chunk), store.count - first);
    for (std::size_t i = 0; i < n; ++i) take(first + i, w[i] / total.sum);
  }
}

/// The groups of `body` added up in order.
template <class State, class T>
[[nodiscard]] typename MomentBody<State, T>::Sums join_groups(
    std::span<const typename MomentBody<State, T>::Sums> groups) {
  typename MomentBody<State, T>::Sums total{};
  for (const auto& g : groups) {
    for (std::size_t k = 0; k < total.size(); ++k) total[k] += g[k];
  }
  return total;
}

}  // namespace soopnav::detail
