#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/estimation/covariance_check.hpp"
#include "soopnav/estimation/observed.hpp"
#include "soopnav/estimation/particle_bins.hpp"
#include "soopnav/estimation/particle_kernel.hpp"
#include "soopnav/estimation/particle_moments.hpp"
#include "soopnav/estimation/particle_options.hpp"
#include "soopnav/estimation/particle_spread.hpp"
#include "soopnav/estimation/particle_storage.hpp"
#include "soopnav/estimation/particle_terms.hpp"
#include "soopnav/estimation/particle_threads.hpp"
#include "soopnav/estimation/particle_view.hpp"
#include "soopnav/estimation/particle_weights.hpp"
#include "soopnav/estimation/resampling.hpp"
#include "soopnav/estimation/transition.hpp"

namespace soopnav {

/// A chunk of a cloud, for a user's own likelihood: `components[c]` are stored number c (see the state's `stored_at`)
/// of particles `first`, `first` + 1, ...
template <std::floating_point T, int Size>
struct ParticleChunk {
  std::size_t first;
  std::array<std::span<const T>, static_cast<std::size_t>(Size)> components;
};

/// A process model that can move the particles of a cloud.
template <class Process, class State, class T>
concept ParticleProcessFor = ProcessModelFor<Process, State> || detail::ChunkProcess<Process, State, T>;

/// Sequential importance resampling: a cloud of weighted states (doc/particle_filter.md; nielsen Annex A).
///
/// `State`: as for the Kalman filters, and the same process and measurement models serve it, called with packets of
/// particles. `Scalar`: double, or float for half the memory and about half the time where the frame is local (a float
/// has 7 digits: half a metre at ECEF magnitudes). The process noise has the resolution of a float in both.
///
/// A call to `predict` or `step` begins with resampling when the effective sample size asks for it; so what is read
/// between calls is the weighted cloud, whose means vary less than those of a resampled one.
///
/// The result is a function of the seed and the calls: the same bits for any number of threads and on any processor
/// that keeps IEEE 754 (as far as the models' own arithmetic goes: build without contraction, see
/// core/packet_math.hpp). `predict`, `update` and `step` do not allocate, and throw only what a model throws: the cloud
/// is then as it was, or as it was and resampled when the call began with that. Particles
/// that a process model takes to NaN or infinity stay where they were and lose their weight. Copies are independent and
/// go on alike.
template <FixedStateType StateType, std::floating_point ScalarType = double>
class ParticleFilter {
 public:
  using State = StateType;
  using Scalar = ScalarType;
  static constexpr int kSize = detail::kStateSize<State>;
  static constexpr int kDim = State::kDim;
  using Tangent = Eigen::Matrix<double, kDim, 1>;
  using Square = Eigen::Matrix<double, kDim, kDim>;
  using Chunk = ParticleChunk<Scalar, kSize>;

  /// Particles x0.retract(d), d normal with covariance `P0`. Throws std::invalid_argument when an option is out of
  /// range, `x0` is not finite or `P0` is no covariance.
  ParticleFilter(const State& x0, const Square& P0, const ParticleOptions& options) : ParticleFilter(options) {
    detail::check_state(x0.x, "x0");
    check_covariance(P0, "P0");
    const Square root = detail::root_of<Square>(P0);
    constexpr std::size_t kBlock = 64;
    threads_.run((options.count + detail::kParticleChunk - 1) / detail::kParticleChunk, [&](std::size_t chunk) {
      const std::size_t end = std::min((chunk + 1) * detail::kParticleChunk, options.count);
      RandomStream random = initial_draws();
      random.seek(chunk * detail::kParticleChunk * static_cast<std::size_t>(kDim));
      Eigen::Matrix<double, kDim, static_cast<int>(kBlock)> draws;
      for (std::size_t i = chunk * detail::kParticleChunk; i < end; i += kBlock) {
        const std::size_t n = std::min(kBlock, end - i);
        random.fill_normal(std::span<double>(draws.data(), n * static_cast<std::size_t>(kDim)));
        for (std::size_t j = 0; j < n; ++j) {
          put(i + j, x0.retract(root * draws.col(static_cast<Eigen::Index>(j))));
        }
      }
    });
    fill_padding();
  }

  /// Particles x0.retract(d), d uniform between `low` and `high` (units of the tangent). Throws std::invalid_argument
  /// unless these are finite and low <= high.
  ParticleFilter(const State& x0, const Tangent& low, const Tangent& high, const ParticleOptions& options)
      : ParticleFilter(options) {
    detail::check_state(x0.x, "x0");
    detail::check_state(low, "low");
    detail::check_state(high, "high");
    for (int k = 0; k < kDim; ++k) {
      if (low[k] <= high[k]) continue;
      throw std::invalid_argument("low[" + std::to_string(k) + "] is " + std::to_string(low[k]) + ", above high[" +
                                  std::to_string(k) + "] = " + std::to_string(high[k]));
    }
    RandomStream random = initial_draws();
    for (std::size_t i = 0; i < options.count; ++i) {
      Tangent d;
      for (int k = 0; k < kDim; ++k) d[k] = random.uniform(low[k], high[k]);
      put(i, x0.retract(d));
    }
    fill_padding();
  }

  /// The particles given, equally weighted; `options.count` is their number. Throws std::invalid_argument when there
  /// are none or one is not finite.
  ParticleFilter(std::span<const State> particles, ParticleOptions options)
      : ParticleFilter((options.count = particles.size(), options)) {
    for (std::size_t i = 0; i < particles.size(); ++i) {
      detail::check_state(particles[i].x, "particles");
      State x = particles[i];
      x.normalize();
      put(i, x);
    }
    fill_padding();
  }

  /// Moves the cloud by `dt_s` > 0 [s].
  template <ParticleProcessFor<State, Scalar> Process>
  ParticleReport predict(const Process& process, const InputOf<Process>& input, double dt_s) {
    return advance(process, input, dt_s);
  }
  template <ParticleProcessFor<State, Scalar> Process>
  requires(!detail::kDriven<Process>) ParticleReport predict(const Process& process, double dt_s) {
    return advance(process, detail::NoInput{}, dt_s);
  }

  /// Weights the cloud by independent `terms`: an `Observed`, a `Contaminated`, a contiguous range of either, a
  /// `Correlated` (at most 16 rows), or a constraint (`Region`).
  template <class... Terms>
  requires(sizeof...(Terms) >= 1) ParticleReport update(const Terms&... terms) {
    auto ready = std::make_tuple(detail::make_term<State, Scalar>(terms)...);
    double constant = 0.0;
    if (const ParticleStatus status = check(ready, constant); status != ParticleStatus::kAccepted)
      return refused(status);
    const auto store = this->store();
    const auto reference = static_cast<Scalar>(total_.largest);
    const auto body = [&ready, &store, reference](std::size_t chunk) {
      const std::size_t n = store.size(chunk);
      std::array<Scalar, detail::kParticleChunk> log_likelihood;
      std::fill_n(log_likelihood.begin(), n, Scalar{0});
      detail::TermChunk<State, Scalar> view{};
      view.before = view.after = store.columns(store.present, store.first(chunk));
      view.log_likelihood = log_likelihood.data();
      view.n = n;
      std::apply([&view](const auto&... term) { (term.add(view), ...); }, ready);
      take_likelihood(store, chunk, reference, log_likelihood.data());
    };
    guarded([&] { run(store.chunks(), body); });
    return finish_update(constant, false, false);
  }
  /// Weights by z = h(x) + noise of covariance `R`.
  template <class Model>
  requires requires { Model::kDim; }
  ParticleReport update(const Model& model, const Eigen::Matrix<double, Model::kDim, 1>& z,
                        const Eigen::Matrix<double, Model::kDim, Model::kDim>& R) {
    return update(Observed<Model>(model, z, R));
  }
  template <class Model>
  requires(Model::kDim == 1) ParticleReport update(const Model& model, double z, double variance) {
    return update(Observed<Model>(model, z, variance));
  }

  /// `predict` and `update` in one pass over memory. Terms may also be constraints on the step (`Walls`). When every
  /// weight vanishes the prediction stands: the particles are the predicted ones, weighted as before the observations.
  template <ParticleProcessFor<State, Scalar> Process, class... Terms>
  ParticleReport step(const Process& process, const InputOf<Process>& input, double dt_s, const Terms&... terms) {
    return advance(process, input, dt_s, terms...);
  }
  template <ParticleProcessFor<State, Scalar> Process, class... Terms>
  requires(!detail::kDriven<Process>) ParticleReport step(const Process& process, double dt_s, const Terms&... terms) {
    return advance(process, detail::NoInput{}, dt_s, terms...);
  }

  /// Adds a user's log-likelihoods: `f(chunk, log_likelihood)` writes one for each particle of the chunk. Called chunk
  /// by chunk, by several threads at once when there are; an exception of `f` is passed on, the weights unchanged.
  template <class F>
  requires std::invocable<const F&, const Chunk&, std::span<Scalar>> ParticleReport reweight(const F& f) {
    const auto store = this->store();
    const auto reference = static_cast<Scalar>(total_.largest);
    const auto body = [&](std::size_t chunk) {
      std::array<Scalar, detail::kParticleChunk> log_likelihood;
      std::fill_n(log_likelihood.begin(), store.size(chunk), Scalar{0});
      const std::size_t first = store.first(chunk);
      const std::size_t n = std::min(store.size(chunk), store.count - first);
      Chunk view{first, {}};
      for (std::size_t c = 0; c < view.components.size(); ++c) {
        view.components[c] = {store.present + c * store.stride + first, n};
      }
      f(view, std::span<Scalar>(log_likelihood.data(), n));
      take_likelihood(store, chunk, reference, log_likelihood.data());
    };
    guarded([&] { threads_.run(store.chunks(), body); });
    return finish_update(0.0, false, false);
  }

  /// Changes particles where they are: `f(columns, first, n)` may write stored number c of particles `first` ... in
  /// `columns[c][0 ... n - 1]`, finite numbers only; n is a multiple of the packet's width and may include padding.
  /// Called chunk by chunk, by several threads at once when there are.
  template <class F>
  requires std::invocable < const F&, const std::array < Scalar*, static_cast<std::size_t>(kSize)
  > &, std::size_t, std::size_t > void transform(const F& f) {
    const auto store = this->store();
    run(store.chunks(), [&store, &f](std::size_t chunk) {
      std::array<Scalar*, Store::kSize> columns;
      for (std::size_t c = 0; c < Store::kSize; ++c) {
        columns[c] = store.present + c * store.stride + store.first(chunk);
      }
      f(columns, store.first(chunk), store.size(chunk));
    });
  }

  /// Whether the next prediction will begin by resampling.
  [[nodiscard]] bool resampling_due() const noexcept {
    const auto n = static_cast<double>(count_);
    if (total_.squares == n && total_.sum == n) return false;  // equal weights: nothing to gain
    return options_.ess_threshold >= 1.0 || ess() < options_.ess_threshold * n;
  }
  /// Resamples now, whatever the effective sample size, to as many particles as are wanted, and spreads the copies if
  /// that is asked for; weights are equal afterwards.
  void resample() {
    const auto spread = this->spread();
    gather();
    if (options_.regularisation > 0.0) {
      transform([&spread](const auto& columns, std::size_t first, std::size_t n) {
        detail::ParticleColumns<Scalar, kSize> from;
        std::copy(columns.begin(), columns.end(), from.component.begin());
        spread.apply(from, first, n, columns);
      });
    }
    ++step_number_;
  }

  /// The ancestors that the next prediction will begin by drawing, into `out` (count() numbers), one for each particle;
  /// false, and nothing written, when it will not resample. Changes nothing. For a count that stays what it is.
  [[nodiscard]] bool next_ancestors(std::span<std::uint32_t> out) {
    if (!resampling_due() || out.size() != count_ || bins_.active()) return false;
    draw_ancestors(count_);
    std::copy_n(store().ancestors(), count_, out.begin());
    restore_sums();
    return true;
  }
  /// The standard normals of the next prediction: number k of particle i is number k * stride + i of the stream.
  [[nodiscard]] RandomStream next_noise() const noexcept {
    return RandomStream(options_.seed).substream(2 * step_number_);
  }
  [[nodiscard]] std::uint64_t next_noise_stride() const noexcept { return store().noise_stride(); }

  /// Predictions, steps and calls of `resample` so far: with the options, the particles, their log-weights and the
  /// log-likelihood all that a filter is, so what is to be kept of it.
  [[nodiscard]] std::uint64_t steps() const noexcept { return step_number_; }
  /// Log-weights, up to a constant: -infinity for none.
  [[nodiscard]] std::span<const Scalar> log_weights() const noexcept { return {log_weights_.data(), count_}; }
  /// Takes over what another filter of the same options was: it then goes on with the same bits. `components` are the
  /// stored numbers of all particles, component by component. Throws std::invalid_argument, having changed nothing, for
  /// wrong sizes, numbers that are not finite, log-weights that are NaN or +infinity, and weights that all vanish.
  void restore(std::span<const Scalar> components, std::span<const Scalar> log_weights, double log_likelihood,
               std::uint64_t steps) {
    detail::check_cloud(components, log_weights, static_cast<std::size_t>(kSize),
                        bins_.active() ? options_.adaptive.least : options_.count, options_.count);
    set_count(log_weights.size());
    for (std::size_t c = 0; c < static_cast<std::size_t>(kSize); ++c) {
      std::copy_n(components.begin() + static_cast<std::ptrdiff_t>(c * count_), count_,
                  present_.begin() + static_cast<std::ptrdiff_t>(c * stride_));
    }
    fill_padding();
    set_equal_weights();
    std::copy(log_weights.begin(), log_weights.end(), log_weights_.begin());
    restore_sums();
    total_ = joined();
    log_likelihood_ = log_likelihood;
    step_number_ = steps;
  }

  /// Particles there are: `options().count`, unless the count is adaptive.
  [[nodiscard]] std::size_t count() const noexcept { return count_; }
  [[nodiscard]] const ParticleOptions& options() const noexcept { return options_; }
  /// Effective sample size, 1 / sum of the squared normalised weights (eq. 4).
  [[nodiscard]] double ess() const noexcept { return total_.sum * total_.sum / total_.squares; }
  /// Sum of the reported log-likelihoods of accepted observations.
  [[nodiscard]] double log_likelihood() const noexcept { return log_likelihood_; }
  /// Bytes on the heap that grow with the count.
  [[nodiscard]] std::size_t storage_bytes() const noexcept {
    return (present_.capacity() + other_.capacity() + log_weights_.capacity() + spare_.capacity() +
            first_stage_.capacity()) *
               sizeof(Scalar) +
           bins_.storage_bytes() + sums_.capacity() * sizeof(detail::WeightSums) +
           groups_.capacity() * sizeof(typename Moments::Sums);
  }

  /// Stored number `c` of every particle.
  [[nodiscard]] std::span<const Scalar> component(int c) const noexcept {
    return {present_.data() + static_cast<std::size_t>(c) * stride_, count_};
  }
  /// Particle `i` < count().
  [[nodiscard]] State particle(std::size_t i) const noexcept {
    State x{};
    for (int c = 0; c < kSize; ++c) x.x[c] = static_cast<double>(component(c)[i]);
    return x;
  }
  /// Normalised weights of the particles, into `out` (count() numbers, else std::invalid_argument).
  void weights(std::span<double> out) const {
    if (out.size() != count_) {
      throw std::invalid_argument("out has " + std::to_string(out.size()) + " numbers; there are " +
                                  std::to_string(count_) + " particles");
    }
    detail::for_each_weight(store(), total_, [out](std::size_t i, double w) { out[i] = w; });
  }

  /// Weighted mean: plain for vectors, of the directions for headings, the nearest rotation for attitudes (the
  /// eigenvector of the mean of q qᵀ). No allocation.
  [[nodiscard]] State mean() const {
    const auto sums = moments(nullptr);
    return Moments::mean_of(sums, total_.sum);
  }
  /// Weighted covariance of mean.local(x), in the tangent at `mean`. No allocation.
  [[nodiscard]] Square covariance(const State& mean) const {
    const auto sums = moments(&mean);
    Square P;
    std::size_t k = 0;
    for (int i = 0; i < kDim; ++i) {
      for (int j = 0; j <= i; ++j, ++k) P(i, j) = P(j, i) = sums[k] / total_.sum;
    }
    return P;
  }
  [[nodiscard]] Square covariance() const { return covariance(mean()); }

  /// Marginal distribution of stored number `c`: the weight in each of `bins.size()` equal bins between `low` and
  /// `high`. Returns the weight inside; 0, all bins 0, unless low < high are finite. No allocation.
  double histogram(int c, double low, double high, std::span<double> bins) const noexcept {
    std::fill(bins.begin(), bins.end(), 0.0);
    if (bins.empty() || !(low < high) || !std::isfinite(high - low)) return 0.0;
    const double per_bin = static_cast<double>(bins.size()) / (high - low);
    double inside = 0.0;
    const std::span<const Scalar> x = component(c);
    detail::for_each_weight(store(), total_, [&](std::size_t i, double w) {
      const double at = (static_cast<double>(x[i]) - low) * per_bin;
      if (!(at >= 0.0 && at < static_cast<double>(bins.size()))) return;
      bins[static_cast<std::size_t>(at)] += w;
      inside += w;
    });
    return inside;
  }

 private:
  using Pack = Packet<Scalar>;
  using Store = detail::ParticleStore<Scalar, kSize>;
  using Moments = detail::MomentBody<State, Scalar>;
  using Spread = detail::ParticleSpread<State, Scalar>;

  explicit ParticleFilter(const ParticleOptions& options)
      : options_(checked(options)), threads_(options.threads), bins_(options, static_cast<std::size_t>(kSize)) {
    stride_ = (options.count + Pack::kWidth - 1) / Pack::kWidth * Pack::kWidth;
    const std::size_t numbers = stride_ * static_cast<std::size_t>(kSize);
    present_.resize(numbers);
    // Also holds weights as doubles while ancestors are drawn.
    other_.resize(std::max(numbers, stride_ * sizeof(double) / sizeof(Scalar)));
    present_.resize(other_.size());
    log_weights_.resize(stride_);
    spare_.resize(stride_);
    if (options.auxiliary) first_stage_.resize(stride_);
    sums_.resize((stride_ + detail::kParticleChunk - 1) / detail::kParticleChunk);
    groups_.resize(std::min(detail::kMomentGroups, sums_.size()));
    wide_ = !options.portable_kernels && detail::has_wide_loops();
    set_count(options.count);
    set_equal_weights();
  }
  [[nodiscard]] static const ParticleOptions& checked(const ParticleOptions& options) {
    detail::check_particle_options(options);
    return options;
  }

  [[nodiscard]] Store store() const noexcept {
    // The filter's own arrays, through a view that both constant and changing calls use.
    auto* self = const_cast<ParticleFilter*>(this);  // NOLINT(cppcoreguidelines-pro-type-const-cast)
    return {count_,
            stride_,
            padded_,
            self->present_.data(),
            self->other_.data(),
            self->log_weights_.data(),
            self->spare_.data(),
            std::span(self->sums_),
            self->first_stage_.data()};
  }
  void set_count(std::size_t count) noexcept {
    count_ = count;
    padded_ = (count + Pack::kWidth - 1) / Pack::kWidth * Pack::kWidth;
  }
  [[nodiscard]] detail::WeightSums joined() const {
    return detail::join(std::span<const detail::WeightSums>(sums_).first(store().chunks()));
  }
  template <class Body>
  void run(std::size_t pieces, const Body& body) const {
    threads_.run(pieces, detail::CompiledLoop<Body>{body, wide_});
  }

  void put(std::size_t i, const State& x) noexcept {
    for (int c = 0; c < kSize; ++c) {
      present_[static_cast<std::size_t>(c) * stride_ + i] = static_cast<Scalar>(x.x[c]);
    }
  }
  // The padding is computed with, so it must be sound.
  void fill_padding() noexcept {
    const State last = particle(count_ - 1);
    for (std::size_t i = count_; i < padded_; ++i) put(i, last);
  }
  [[nodiscard]] RandomStream initial_draws() const noexcept {
    return RandomStream(options_.seed).substream(std::numeric_limits<std::uint64_t>::max());
  }
  void set_equal_weights() noexcept {
    std::fill_n(log_weights_.begin(), count_, Scalar{0});
    std::fill(log_weights_.begin() + static_cast<std::ptrdiff_t>(count_),
              log_weights_.begin() + static_cast<std::ptrdiff_t>(padded_), -std::numeric_limits<Scalar>::infinity());
    const auto store = this->store();
    for (std::size_t chunk = 0; chunk < store.chunks(); ++chunk) {
      const std::size_t first = store.first(chunk);
      const auto m = static_cast<double>(std::min(detail::kParticleChunk, count_ - std::min(first, count_)));
      sums_[chunk] = {m > 0.0 ? 0.0 : -std::numeric_limits<double>::infinity(), m, m};
    }
    const auto n = static_cast<double>(count_);
    total_ = {0.0, n, n};
  }

  template <class... Ready>
  [[nodiscard]] static ParticleStatus check(std::tuple<Ready...>& terms, double& constant) {
    UpdateStatus status = UpdateStatus::kAccepted;
    std::apply(
        [&](auto&... term) { ((status = status == UpdateStatus::kAccepted ? term.check(constant) : status), ...); },
        terms);
    return detail::particle_status(status);
  }
  [[nodiscard]] ParticleReport refused(ParticleStatus status) const noexcept {
    return {status, std::numeric_limits<double>::quiet_NaN(), ess(), false};
  }
  static SOOPNAV_INLINE void take_likelihood(const Store& store, std::size_t chunk, Scalar reference,
                                             const Scalar* log_likelihood) {
    const std::size_t first = store.first(chunk);
    store.sums[chunk] = detail::finish_weights(store.log_weights + first, reference, log_likelihood, store.size(chunk),
                                               store.padding(chunk), store.spare + first);
  }

  // The new log-weights are in `spare_` (in `log_weights_` when the call `gathered` its particles): takes them over,
  // unless all vanish. `looked_ahead`: the first stage's share of the log-likelihood.
  ParticleReport finish_update(double constant, bool gathered, bool resampled, const double* looked_ahead = nullptr) {
    const detail::WeightSums sums = joined();
    if (!(sums.sum > 0.0)) {
      if (looked_ahead != nullptr) {
        undo_first_stage();
      } else if (gathered) {
        set_equal_weights();
      } else {
        restore_sums();
      }
      return {ParticleStatus::kDegenerate, -std::numeric_limits<double>::infinity(), ess(), resampled};
    }
    const double before = gathered ? static_cast<double>(count_) : total_.sum;
    double gain = sums.largest + detail::portable_log(sums.sum) - detail::portable_log(before) + constant;
    if (looked_ahead != nullptr) gain += *looked_ahead;
    if (!gathered) log_weights_.swap(spare_);
    total_ = sums;
    log_likelihood_ += gain;
    return {ParticleStatus::kAccepted, gain, ess(), resampled};
  }
  // Weights that the particles have without the observation: drawn by the first stage, they are worth its inverse.
  void undo_first_stage() {
    const auto store = this->store();
    threads_.run(store.chunks(), [&store](std::size_t chunk) {
      const std::size_t first = store.first(chunk);
      const std::size_t n = store.size(chunk);
      std::array<Scalar, detail::kParticleChunk> l;
      for (std::size_t i = 0; i < n; ++i) l[i] = -store.first_stage[store.ancestors()[first + i]];
      store.sums[chunk] = detail::finish_weights<Scalar>(nullptr, Scalar{0}, l.data(), n, store.padding(chunk),
                                                         store.log_weights + first);
    });
    total_ = joined();
  }
  void restore_sums() {
    const auto store = this->store();
    threads_.run(store.chunks(), [&store](std::size_t chunk) {
      store.sums[chunk] = detail::weigh_chunk(store.log_weights + store.first(chunk), store.size(chunk));
    });
  }

  template <class Process, class... Terms>
  ParticleReport advance(const Process& process, const InputOf<Process>& input, double dt_s, const Terms&... terms) {
    if (!(dt_s > 0.0) || std::isinf(dt_s)) return refused(ParticleStatus::kTimeNotAdvancing);
    auto ready = std::make_tuple(detail::make_term<State, Scalar>(terms)...);
    double constant = 0.0;
    if (const ParticleStatus status = check(ready, constant); status != ParticleStatus::kAccepted)
      return refused(status);
    double first_stage = 0.0;
    const bool looked_ahead = sizeof...(Terms) > 0 && look_ahead(process, input, dt_s, ready, first_stage);
    const bool resampled = looked_ahead || resampling_due();
    const bool spreads = resampled && options_.regularisation > 0.0;
    const Spread spread = spreads ? this->spread() : Spread{};
    // A new number of particles needs a pass of its own: the old ones lie elsewhere.
    const bool gathers = resampled && !bins_.active();
    if (gathers) {
      draw_ancestors(count_);
    } else if (resampled) {
      gather();
    }
    std::atomic<bool> lost{false};
    const auto store = this->store();
    const RandomStream noise = RandomStream(options_.seed).substream(2 * step_number_);
    const auto body = std::apply(
        [&](auto&... term) {
          return detail::StepBody<State, Scalar, Process, std::remove_reference_t<decltype(term)>...>{
              process,
              input,
              dt_s,
              noise,
              store,
              gathers,
              looked_ahead,
              spreads ? &spread : nullptr,
              static_cast<Scalar>(total_.largest),
              ready,
              lost};
        },
        ready);
    try {
      run(store.chunks(), body);
    } catch (...) {
      if (gathers) {
        keep_resampled(looked_ahead);
      } else {
        restore_sums();
      }
      throw;
    }
    ++step_number_;
    present_.swap(other_);
    if constexpr (sizeof...(Terms) > 0) {
      return finish_update(constant, gathers, resampled, looked_ahead ? &first_stage : nullptr);
    } else {
      if (gathers || lost.load()) {
        total_ = joined();
        if (!(total_.sum > 0.0)) {
          set_equal_weights();
          return {ParticleStatus::kDegenerate, 0.0, ess(), resampled};
        }
      }
      return {ParticleStatus::kAccepted, 0.0, ess(), resampled};
    }
  }

  // The first stage of an auxiliary step (eq. 12 to 14): leaves its weights as the cloud's, to be resampled by. False,
  // and nothing changed, without one, or when nothing is expected to be possible.
  template <class Process, class Ready>
  bool look_ahead(const Process& process, const InputOf<Process>& input, double dt_s, const Ready& ready,
                  double& log_likelihood) {
    if (!options_.auxiliary) return false;
    constexpr double kShare = 0.05;  // of the mean likelihood, that every particle gets
    const auto store = this->store();
    const RandomStream noise = RandomStream(options_.seed).substream(2 * step_number_);
    const auto reference = static_cast<Scalar>(total_.largest);
    const double before = detail::portable_log(total_.sum);
    const auto first = std::apply(
        [&](const auto&... term) {
          return detail::LookAheadBody<State, Scalar, Process, std::remove_cvref_t<decltype(term)>...>{
              process, input, dt_s, noise, store, reference, ready};
        },
        ready);
    guarded([&] { run(store.chunks(), first); });
    const detail::WeightSums sums = joined();
    // So little that it is the sum of impossible ones.
    constexpr double kLeast = sizeof(Scalar) == 8 ? -1e299 : -1e29;
    if (!(sums.sum > 0.0) || !(sums.largest > kLeast)) {
      restore_sums();
      return false;
    }
    const double mean = sums.largest + detail::portable_log(sums.sum) - before;
    const detail::DefendBody<Scalar, kSize> second{store, reference,
                                                   static_cast<Scalar>(mean + detail::portable_log(kShare))};
    run(store.chunks(), second);
    log_weights_.swap(spare_);
    total_ = joined();
    log_likelihood = total_.largest + detail::portable_log(total_.sum) - before;
    return true;
  }

  [[nodiscard]] Spread spread() const {
    if (!(options_.regularisation > 0.0)) return Spread{};
    const double h = detail::kernel_width(options_.regularisation, kDim, count_);
    const State m = mean();
    return {m, h * detail::root_of<Square>(covariance(m)), std::sqrt(1.0 - h * h),
            RandomStream(options_.seed).substream((std::uint64_t{1} << 63U) + step_number_), store().noise_stride()};
  }

  // Resamples into as many particles as are wanted.
  void gather() {
    std::size_t wanted = count_;
    if (bins_.active()) {
      draw_ancestors(options_.count);
      wanted = count_by_bins();
      restore_sums();
    }
    draw_ancestors(wanted);
    take_ancestors(wanted);
    set_equal_weights();
  }
  // Copies the particles that the ancestors drawn name; their weights are those from before.
  void take_ancestors(std::size_t count) {
    const auto from = this->store();
    set_count(count);
    const auto to = this->store();
    threads_.run(to.chunks(), [&from, &to](std::size_t chunk) {
      const std::size_t first = to.first(chunk);
      for (std::size_t c = 0; c < to.kSize; ++c) {
        const Scalar* source = from.present + c * from.stride;
        Scalar* target = to.other + c * to.stride + first;
        for (std::size_t i = 0; i < to.size(chunk); ++i) target[i] = source[to.ancestors()[first + i]];
      }
    });
    present_.swap(other_);
  }
  // After a step that gathered and then failed: the weights are partly overwritten, the ancestors are still there.
  void keep_resampled(bool looked_ahead) {
    take_ancestors(count_);
    if (looked_ahead) {
      undo_first_stage();
    } else {
      set_equal_weights();
    }
  }
  // Does what a model may throw in; an exception passes on when the weights are as they were.
  template <class Work>
  void guarded(const Work& work) {
    try {
      work();
    } catch (...) {
      restore_sums();
      throw;
    }
  }
  // Particles that the bins of those drawn call for.
  [[nodiscard]] std::size_t count_by_bins() {
    const auto store = this->store();
    bins_.clear();
    std::array<double, static_cast<std::size_t>(kSize)> x;
    for (std::size_t i = 0; i < options_.count; ++i) {
      const std::size_t ancestor = store.ancestors()[i];
      if (i > 0 && ancestor == store.ancestors()[i - 1]) continue;  // in ascending order
      for (std::size_t c = 0; c < x.size(); ++c) x[c] = static_cast<double>(store.present[c * store.stride + ancestor]);
      if (!bins_.add(x)) break;
    }
    return bins_.wanted();
  }

  // Fills `spare_` with the ancestors of `outputs` particles.
  void draw_ancestors(std::size_t outputs) {
    const auto store = this->store();
    RandomStream random = RandomStream(options_.seed).substream(2 * step_number_ + 1);
    if (options_.resampling == Resampling::kSystematic) {
      detail::share_systematic(store, total_, random.uniform(), outputs, threads_);
    } else {
      // Weights as doubles, in the memory where the next states will be.
      auto* w = reinterpret_cast<double*>(store.other);
      threads_.run(store.chunks(), [&store, w, this](std::size_t chunk) {
        const std::size_t first = store.first(chunk);
        detail::relative_weights(store.log_weights + first, total_.largest, store.size(chunk), w + first);
      });
      static_cast<void>(soopnav::resample(options_.resampling, std::span<const double>(w, count_), random,
                                          std::span(store.ancestors(), outputs)));
    }
    const std::size_t end = (outputs + Pack::kWidth - 1) / Pack::kWidth * Pack::kWidth;
    std::fill(store.ancestors() + outputs, store.ancestors() + end, store.ancestors()[outputs - 1]);
  }

  [[nodiscard]] typename Moments::Sums moments(const State* mean) const {
    const auto store = this->store();
    const auto groups = std::span(groups_).first(std::min(groups_.size(), store.chunks()));
    const Moments body{store, total_.largest, mean, groups};
    run(groups.size(), body);
    return detail::join_groups<State, Scalar>(std::span<const typename Moments::Sums>(groups));
  }

  ParticleOptions options_;
  mutable detail::ParticleThreads threads_;
  detail::ParticleBins bins_;
  std::size_t count_ = 0;   // of the particles there are ...
  std::size_t padded_ = 0;  // ... in whole packets
  std::size_t stride_ = 0;  // of the components in memory: for the most there can be
  detail::CacheAlignedVector<Scalar> present_;
  detail::CacheAlignedVector<Scalar> other_;
  detail::CacheAlignedVector<Scalar> log_weights_;
  detail::CacheAlignedVector<Scalar> spare_;
  detail::CacheAlignedVector<Scalar> first_stage_;  // for a look ahead
  std::vector<detail::WeightSums> sums_;
  mutable std::vector<typename Moments::Sums> groups_;
  detail::WeightSums total_{0.0, 0.0, 0.0};
  double log_likelihood_ = 0.0;
  std::uint64_t step_number_ = 0;
  bool wide_ = false;
};

}  // namespace soopnav
