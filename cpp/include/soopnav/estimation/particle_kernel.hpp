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
#include "soopnav/estimation/particle_spread.hpp"
#include "soopnav/estimation/particle_terms.hpp"
#include "soopnav/estimation/particle_threads.hpp"
#include "soopnav/estimation/particle_view.hpp"
#include "soopnav/estimation/particle_weights.hpp"
#include "soopnav/estimation/resampling.hpp"

namespace soopnav::detail {

/// What a particle filter owns: components, log-weights, and their sums. `stride` numbers per component lie in memory,
/// `padded` of them are used: the count in whole packets; the particles of the padding have no weight.
template <class T, int Size>
struct ParticleStore {
  using Scalar = T;
  static constexpr std::size_t kSize = static_cast<std::size_t>(Size);
  using Columns = ParticleColumns<T, Size>;

  std::size_t count = 0;
  std::size_t stride = 0;
  std::size_t padded = 0;
  T* present = nullptr;  // components one behind the other
  T* other = nullptr;    // where the next ones are written
  T* log_weights = nullptr;
  T* spare = nullptr;          // the next log-weights; or the ancestors, while a step reads them
  std::span<WeightSums> sums;  // one for each chunk
  T* first_stage = nullptr;    // log-likelihoods of what is expected; none without a look ahead

  [[nodiscard]] std::size_t chunks() const noexcept { return (padded + kParticleChunk - 1) / kParticleChunk; }
  [[nodiscard]] std::size_t first(std::size_t chunk) const noexcept { return chunk * kParticleChunk; }
  [[nodiscard]] std::size_t size(std::size_t chunk) const noexcept {
    return std::min(kParticleChunk, padded - first(chunk));
  }
  // Particles of a chunk that are there to make packets whole.
  [[nodiscard]] std::size_t padding(std::size_t chunk) const noexcept {
    const std::size_t end = first(chunk) + size(chunk);
    return end > count ? end - count : 0;
  }
  // Normals of one kind are drawn for as many particles as there can be.
  [[nodiscard]] std::uint64_t noise_stride() const noexcept {
    return (stride + kParticleChunk - 1) / kParticleChunk * kParticleChunk;
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
  bool noisy;  ///< false: where the particles are expected, without noise
};

/// A process model that moves whole chunks: `move` answers whether all of them could be. In place of `propagate`, for
/// models that are only known at run time.
template <class Process, class State, class T>
concept ChunkProcess = requires(const Process& process, const MoveChunk<T, kStateSize<State>>& chunk) {
  { process.move(chunk) } -> std::same_as<bool>;
};

/// Moves `n` particles: normal k of particle i is `normals[k * stride + i]` (`advance` 1), or the same for all of them
/// (0). Particles without a next state stay and get a log-likelihood of -infinity; false when there are any.
template <class State, class T, class Process>
[[nodiscard]] SOOPNAV_INLINE bool propagate_particles(const Process& process, const InputOf<Process>& input,
                                                      double dt_s, const ParticleColumns<T, kStateSize<State>>& before,
                                                      const std::array<T*, kStateSize<State>>& after, std::size_t n,
                                                      const float* normals, std::size_t stride, std::size_t advance,
                                                      T* log_likelihood) {
  using P = Packet<T>;
  constexpr auto kComponents = static_cast<std::size_t>(kStateSize<State>);
  bool lost = false;
  for (std::size_t at = 0; at < n; at += P::kWidth) {
    ParticleView<State, T> x;
    before.load(at, x);
    ParticleNext<State, T> y;
    for (std::size_t c = 0; c < kComponents; ++c) y.state.values[c] = x.values[c];  // as a whole it goes by memory
    const ParticleNoise<T> w{normals + advance * at, stride};
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
    for (std::size_t c = 0; c < kComponents; ++c) y.state.values[c].store(after[c] + at);
    l.store(log_likelihood + at);
  }
  return !lost;
}

/// One step of one chunk: gather (when resampled), spread (when asked to), propagate, add the terms, weigh.
template <class State, class T, class Process, class... Terms>
struct StepBody {
  static constexpr int kSize = kStateSize<State>;
  static constexpr std::size_t kChunk = kParticleChunk;
  static constexpr auto kComponents = static_cast<std::size_t>(kSize);
  using Store = ParticleStore<T, kSize>;
  using Columns = ParticleColumns<T, kSize>;

  const Process& process;
  const InputOf<Process>& input;
  double dt_s;
  RandomStream noise;
  Store store;
  bool resampled;
  bool looked_ahead;                       // ancestors were drawn by the first stage, whose likelihoods are taken off
  const ParticleSpread<State, T>* spread;  // none without one
  T reference;                             // of the old log-weights
  std::tuple<Terms...>& terms;
  std::atomic<bool>& lost_some;  // set when a particle had no next state

  void operator()(std::size_t chunk) const {
    const std::size_t first = store.first(chunk);
    const std::size_t n = store.size(chunk);

    TermChunk<State, T> view;
    view.before = store.columns(store.present, first);
    view.after = store.columns(store.other, first);
    view.n = n;
    const std::uint32_t* ancestors = store.ancestors() + first;
    std::array<T, kChunk * kComponents> gathered;
    if (resampled) {
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
    Columns from = view.before;  // constraints see the copies where they were before they were spread
    std::array<T, kChunk * kComponents> copies;
    if (spread != nullptr) {
      std::array<T*, kComponents> to;
      for (std::size_t c = 0; c < kComponents; ++c) to[c] = copies.data() + c * kChunk;
      spread->apply(view.before, first, n, to);
      for (std::size_t c = 0; c < kComponents; ++c) from.component[c] = to[c];
    }
    const bool lost = !move(from, first, n, log_likelihood.data());
    if (lost) lost_some.store(true, std::memory_order_relaxed);
    if constexpr (sizeof...(Terms) > 0) {
      std::apply([&view](const auto&... term) { (term.add(view), ...); }, terms);
      if (looked_ahead) {
        for (std::size_t i = 0; i < n; ++i) log_likelihood[i] -= store.first_stage[ancestors[i]];
      }
      T* out = (resampled ? store.log_weights : store.spare) + first;
      store.sums[chunk] = finish_weights(resampled ? nullptr : store.log_weights + first, reference,
                                         log_likelihood.data(), n, store.padding(chunk), out);
    } else if (resampled || lost) {
      T* out = store.log_weights + first;
      store.sums[chunk] =
          finish_weights(resampled ? nullptr : out, T{0}, log_likelihood.data(), n, store.padding(chunk), out);
    }
  }

 private:
  // False when a particle had no next state.
  [[nodiscard]] SOOPNAV_INLINE bool move(const Columns& before, std::size_t first, std::size_t n,
                                         T* log_likelihood) const {
    std::array<T*, kComponents> after;
    for (std::size_t c = 0; c < kComponents; ++c) after[c] = store.other + c * store.stride + first;
    if constexpr (ChunkProcess<Process, State, T>) {
      return process.move(
          MoveChunk<T, kSize>{before.component, after, log_likelihood, n, first, noise, store.noise_stride(), true});
    } else {
      constexpr auto kNoise = static_cast<std::size_t>(Process::kNoise);
      std::array<float, kChunk*(kNoise > 0 ? kNoise : 1)> normals;
      for (std::size_t k = 0; k < kNoise; ++k) {
        RandomStream draws = noise;
        draws.seek(k * store.noise_stride() + first);
        draws.fill_normal(std::span(normals).subspan(k * kChunk, n));
      }
      return propagate_particles<State, T>(process, input, dt_s, before, after, n, normals.data(), kChunk, 1,
                                           log_likelihood);
    }
  }
};

/// The first stage of a step that looks ahead: the log-likelihood of where each particle is expected (eq. 12).
template <class State, class T, class Process, class... Terms>
struct LookAheadBody {
  static constexpr int kSize = kStateSize<State>;
  static constexpr auto kComponents = static_cast<std::size_t>(kSize);

  const Process& process;
  const InputOf<Process>& input;
  double dt_s;
  RandomStream noise;
  ParticleStore<T, kSize> store;
  T reference;
  const std::tuple<Terms...>& terms;

  void operator()(std::size_t chunk) const {
    using P = Packet<T>;
    const std::size_t first = store.first(chunk);
    const std::size_t n = store.size(chunk);
    std::array<T, kParticleChunk * kComponents> expected;
    std::array<T*, kComponents> after;
    TermChunk<State, T> view;
    view.before = store.columns(store.present, first);
    for (std::size_t c = 0; c < kComponents; ++c) {
      view.after.component[c] = after[c] = expected.data() + c * kParticleChunk;
    }
    view.log_likelihood = store.first_stage + first;
    view.n = n;
    if constexpr (ChunkProcess<Process, State, T>) {
      static_cast<void>(process.move(MoveChunk<T, kSize>{view.before.component, after, view.log_likelihood, n, first,
                                                         noise, store.noise_stride(), false}));
    } else {
      static constexpr std::array<float, P::kWidth> kZeros{};
      static_cast<void>(propagate_particles<State, T>(process, input, dt_s, view.before, after, n, kZeros.data(), 0, 0,
                                                      view.log_likelihood));
    }
    std::apply([&view](const auto&... term) { (term.add(view), ...); }, terms);
    // What cannot be becomes as unlikely as can be: a difference of infinities would be no number.
    const P least(sizeof(T) == 8 ? static_cast<T>(-1e300) : static_cast<T>(-1e30));
    const P most(std::numeric_limits<T>::max());
    for (std::size_t at = 0; at < n; at += P::kWidth) {
      const P l = P::load(view.log_likelihood + at);
      select((l <= most) & (l >= least), l, least).store(view.log_likelihood + at);
    }
    store.sums[chunk] = finish_weights(store.log_weights + first, reference, view.log_likelihood, n,
                                       store.padding(chunk), store.spare + first);
  }
};

/// Gives every particle a share of the first stage's likelihood: `l <- ln(e^l + e^floor)`, then the weights (eq. 13).
template <class T, int Size>
struct DefendBody {
  ParticleStore<T, Size> store;
  T reference;
  T floor;

  void operator()(std::size_t chunk) const {
    using P = Packet<T>;
    const std::size_t first = store.first(chunk);
    const std::size_t n = store.size(chunk);
    T* l = store.first_stage + first;
    const P b(floor);
    for (std::size_t at = 0; at < n; at += P::kWidth) {
      const P a = P::load(l + at);
      (max(a, b) + log(P(1) + exp(-abs(a - b)))).store(l + at);
    }
    store.sums[chunk] =
        finish_weights(store.log_weights + first, reference, l, n, store.padding(chunk), store.spare + first);
  }
};

}  // namespace soopnav::detail
