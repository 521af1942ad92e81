#pragma once

#include <Eigen/Core>
#include <array>
#include <atomic>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <tuple>

#include "soopnav/core/joint_process.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/particle_loop.hpp"
#include "soopnav/estimation/particle_terms.hpp"
#include "soopnav/estimation/particle_threads.hpp"
#include "soopnav/estimation/particle_view.hpp"
#include "soopnav/estimation/particle_weights.hpp"
#include "soopnav/estimation/resampling.hpp"

namespace soopnav::detail {

/// What a particle filter owns: components, log-weights, and their sums. `stride` numbers per component: the count
/// padded to whole packets; the particles of the padding have no weight.
template <class T, int Size>
struct ParticleStore {
  static constexpr std::size_t kSize = static_cast<std::size_t>(Size);
  using Columns = ParticleColumns<T, Size>;

  std::size_t count = 0;
  std::size_t stride = 0;
  T* present = nullptr;  // components one behind the other
  T* other = nullptr;    // where the next ones are written
  T* log_weights = nullptr;
  T* spare = nullptr;          // the next log-weights; or the ancestors, while a step reads them
  std::span<WeightSums> sums;  // one for each chunk

  [[nodiscard]] std::size_t chunks() const noexcept { return (stride + kParticleChunk - 1) / kParticleChunk; }
  [[nodiscard]] std::size_t first(std::size_t chunk) const noexcept { return chunk * kParticleChunk; }
  [[nodiscard]] std::size_t size(std::size_t chunk) const noexcept {
    return std::min(kParticleChunk, stride - first(chunk));
  }
  [[nodiscard]] std::uint32_t* ancestors() const noexcept { return reinterpret_cast<std::uint32_t*>(spare); }
  [[nodiscard]] Columns columns(const T* base, std::size_t at) const noexcept {
    Columns c;
    for (std::size_t i = 0; i < kSize; ++i) c.component[i] = base + i * stride + at;
    return c;
  }
};

// New log-weights of a chunk from old ones (null: all equal) and log-likelihoods: NaN and +infinity count as
// impossible, the padding has no weight. Then their sums.
template <class T>
SOOPNAV_INLINE WeightSums finish_weights(const T* old, T reference, const T* log_likelihood, std::size_t n,
                                         std::size_t padding, T* out) {
  using P = Packet<T>;
  const P nothing(-std::numeric_limits<T>::infinity());
  const P most(std::numeric_limits<T>::max());
  for (std::size_t at = 0; at < n; at += P::kWidth) {
    P l = P::load(log_likelihood + at);
    if (old != nullptr) l += P::load(old + at) - P(reference);
    select(l <= most, l, nothing).store(out + at);
  }
  for (std::size_t i = 0; i < padding; ++i) out[n - 1 - i] = -std::numeric_limits<T>::infinity();
  return weigh_chunk(out, n);
}

/// A chunk of particles to be moved: what a process model that works on whole chunks is handed.
template <class T, int Size>
struct MoveChunk {
  std::array<const T*, static_cast<std::size_t>(Size)> before;  ///< component by component
  std::array<T*, static_cast<std::size_t>(Size)> after;         ///< to be written, all of it
  T* log_likelihood;   ///< to be written: 0, or -infinity for particles that stay where they were
  std::size_t n;       ///< particles, a multiple of the packet's width
  std::size_t first;   ///< number of the first
  RandomStream noise;  ///< standard normal k of particle i is number k * stride + i of it
  std::uint64_t stride;
};

/// A process model that moves whole chunks: `move` answers whether all of them could be. In place of `propagate`, for
/// models that are only known at run time.
template <class Process, class State, class T>
concept ChunkProcess = requires(const Process& process, const MoveChunk<T, kStateSize<State>>& chunk) {
  { process.move(chunk) } -> std::same_as<bool>;
};

/// One step of one chunk: gather (when resampled), propagate, add the terms, weigh.
template <class State, class T, class Process, class... Terms>
struct StepBody {
  static constexpr int kSize = kStateSize<State>;
  using Store = ParticleStore<T, kSize>;

  const Process& process;
  const InputOf<Process>& input;
  double dt_s;
  RandomStream noise;
  Store store;
  bool resampled;
  T reference;  // of the old log-weights
  std::tuple<Terms...>& terms;
  std::atomic<bool>& lost_some;  // set when a particle had no next state

  void operator()(std::size_t chunk) const {
    constexpr auto kComponents = static_cast<std::size_t>(kSize);
    constexpr std::size_t kChunk = kParticleChunk;
    const std::size_t first = store.first(chunk);
    const std::size_t n = store.size(chunk);

    TermChunk<State, T> view;
    view.before = store.columns(store.present, first);
    view.after = store.columns(store.other, first);
    view.n = n;
    std::array<T, kChunk * kComponents> gathered;
    if (resampled) {
      const std::uint32_t* ancestors = store.ancestors() + first;
      // All components of a particle together: its number is read once.
      std::array<const T*, kComponents> from;
      for (std::size_t c = 0; c < kComponents; ++c) {
        from[c] = store.present + c * store.stride;
        view.before.component[c] = gathered.data() + c * kChunk;
      }
      for (std::size_t i = 0; i < n; ++i) {
        const std::size_t ancestor = ancestors[i];
        for (std::size_t c = 0; c < kComponents; ++c) gathered[c * kChunk + i] = from[c][ancestor];
      }
    }

    std::array<T, kChunk> log_likelihood;
    view.log_likelihood = log_likelihood.data();
    bool lost = false;
    if constexpr (ChunkProcess<Process, State, T>) {
      MoveChunk<T, kSize> move{view.before.component,  {}, log_likelihood.data(), n, first, noise,
                               store.chunks() * kChunk};
      for (std::size_t c = 0; c < kComponents; ++c) move.after[c] = store.other + c * store.stride + first;
      lost = !process.move(move);
    } else {
      lost = !propagate_chunk(view, first, log_likelihood.data());
    }
    if (lost) lost_some.store(true, std::memory_order_relaxed);
    if constexpr (sizeof...(Terms) > 0) {
      std::apply([&view](const auto&... term) { (term.add(view), ...); }, terms);
      T* out = (resampled ? store.log_weights : store.spare) + first;
      store.sums[chunk] = finish_weights(resampled ? nullptr : store.log_weights + first, reference,
                                         log_likelihood.data(), n, padding(chunk), out);
    } else if (resampled || lost) {
      T* out = store.log_weights + first;
      store.sums[chunk] =
          finish_weights(resampled ? nullptr : out, T{0}, log_likelihood.data(), n, padding(chunk), out);
    }
  }

 private:
  // False when a particle had no next state.
  [[nodiscard]] SOOPNAV_INLINE bool propagate_chunk(const TermChunk<State, T>& view, std::size_t first,
                                                    T* log_likelihood) const {
    using P = Packet<T>;
    constexpr auto kComponents = static_cast<std::size_t>(kSize);
    constexpr auto kNoise = static_cast<std::size_t>(Process::kNoise);
    constexpr std::size_t kChunk = kParticleChunk;
    const std::size_t n = view.n;
    std::array<float, kChunk*(kNoise > 0 ? kNoise : 1)> normals;
    for (std::size_t k = 0; k < kNoise; ++k) {
      RandomStream draws = noise;
      draws.seek(k * store.chunks() * kChunk + first);
      draws.fill_normal(std::span(normals).subspan(k * kChunk, n));
    }
    T* after = store.other + first;
    bool lost = false;
    for (std::size_t at = 0; at < n; at += P::kWidth) {
      ParticleView<State, T> x;
      view.before.load(at, x);
      ParticleNext<State, T> y;
      for (std::size_t c = 0; c < kComponents; ++c) y.state.values[c] = x.values[c];  // as a whole it goes by memory
      const ParticleNoise<T> w{normals.data() + at, kChunk};
      const bool defined = detail::propagate(process, x, input, dt_s, w, y);
      normalize(y.state);
      const auto sound = finite(y.state);
      P l(T{0});
      if (!defined || any(!sound)) {
        const auto keep = defined ? sound : !(l == l);
        for (std::size_t c = 0; c < kComponents; ++c) y.state.values[c] = select(keep, y.state.values[c], x.values[c]);
        l = select(keep, l, P(-std::numeric_limits<T>::infinity()));
        lost = true;
      }
      for (std::size_t c = 0; c < kComponents; ++c) y.state.values[c].store(after + c * store.stride + at);
      l.store(log_likelihood + at);
    }
    return !lost;
  }
  [[nodiscard]] std::size_t padding(std::size_t chunk) const noexcept {
    const std::size_t end = store.first(chunk) + store.size(chunk);
    return end > store.count ? end - store.count : 0;
  }
};

}  // namespace soopnav::detail
