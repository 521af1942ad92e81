#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "particle_cloud.hpp"
#include "soopnav/estimation/particle_filter.hpp"

namespace soopnav::python {

/// The cloud of one state and precision; a state without headings is a `CustomState` of its size, whatever its roles.
template <class State, class T>
class CloudOf final : public ParticleCloud {
 public:
  CloudOf(CloudSettings settings, ParticlePrior prior)
      : ParticleCloud(std::move(settings)), prior_(std::move(prior)), filter_(draw(this->settings().options)) {}

 private:
  using Filter = ParticleFilter<State, T>;
  static constexpr int kSize = Filter::kSize;

  [[nodiscard]] Filter draw(const ParticleOptions& options) const {
    if (prior_.samples.size() != 0) {
      std::vector<State> particles(static_cast<std::size_t>(prior_.samples.rows()));
      for (std::size_t i = 0; i < particles.size(); ++i) {
        particles[i].x = prior_.samples.row(static_cast<Eigen::Index>(i)).transpose();
      }
      return Filter(std::span<const State>(particles), options);
    }
    State x0{};
    if (prior_.x0.size() == 0) return Filter(x0, prior_.low, prior_.high, options);
    x0.x = prior_.x0;
    return Filter(x0, prior_.P0, options);
  }

  void plan_move(const AnyProcess& process, const double* input, double dt_s) override {
    const auto diffusion = process.diffusion<State>().sigma;
    move_.prepare(process, diffusion, settings().roles, settings().state, input, dt_s, wide());
  }
  void plan_move(std::span<const double> next) override {
    move_.prepare(next.data(), settings().options.count, static_cast<std::size_t>(kSize), settings().roles, wide());
  }
  UpdateStatus plan_weights(std::span<const Observations> observations, const Constraints* constraints) override {
    weigh_.clear();
    for (const Observations& o : observations) {
      if (const UpdateStatus status = weigh_.add(o); status != UpdateStatus::kAccepted) return status;
    }
    weigh_.prepare(settings().roles, constraints, wide());
    return UpdateStatus::kAccepted;
  }
  ParticleReport do_step(double dt_s) override {
    return weigh_.empty() ? filter_.predict(move_, dt_s) : filter_.step(move_, dt_s, WeighTerm<T>{&weigh_});
  }
  ParticleReport do_update() override { return filter_.update(WeighTerm<T>{&weigh_}); }
  ParticleReport do_reweight(std::span<const double> log_likelihood) override {
    return filter_.reweight([log_likelihood](const typename Filter::Chunk& chunk, std::span<T> out) {
      std::transform(log_likelihood.data() + chunk.first, log_likelihood.data() + chunk.first + out.size(), out.begin(),
                     [](double l) { return static_cast<T>(l); });
    });
  }
  void do_resample() override { filter_.resample(); }
  bool resampling_due() const override { return filter_.resampling_due(); }
  bool next_ancestors(std::span<std::uint32_t> out) override { return filter_.next_ancestors(out); }
  RandomStream next_noise_stream(std::uint64_t& stride) const override {
    stride = filter_.next_noise_stride();
    return filter_.next_noise();
  }
  void do_restart(std::uint64_t number) override {
    ParticleOptions options = settings().options;
    options.seed = RandomStream(options.seed).substream(number).next_u64();
    options.threads = 1;
    const Filter fresh = draw(options);
    std::vector<T> components;
    for (int c = 0; c < kSize; ++c)
      components.insert(components.end(), fresh.component(c).begin(), fresh.component(c).end());
    filter_.restore(components, fresh.log_weights(), filter_.log_likelihood(), filter_.steps());
  }
  void get_mean(double* out) const override {
    const State mean = filter_.mean();
    std::copy(mean.x.begin(), mean.x.end(), out);
  }
  void get_covariance(double* out) const override {
    const auto P = filter_.covariance();
    std::copy_n(P.data(), P.size(), out);
  }
  double get_ess() const override { return filter_.ess(); }
  double get_log_likelihood() const override { return filter_.log_likelihood(); }
  std::size_t get_storage_bytes() const override { return filter_.storage_bytes(); }
  void get_component(int c, double* out) const override {
    const std::span<const T> from = filter_.component(c);
    std::copy(from.begin(), from.end(), out);
  }
  void get_weights(std::span<double> out) const override { filter_.weights(out); }
  double get_histogram(int c, double low, double high, std::span<double> bins) const override {
    return filter_.histogram(c, low, high, bins);
  }
  void get_snapshot(CloudSnapshot& snapshot) const override {
    const std::size_t count = filter_.count();
    snapshot.components.resize(count * static_cast<std::size_t>(kSize));
    for (int c = 0; c < kSize; ++c) get_component(c, snapshot.components.data() + static_cast<std::size_t>(c) * count);
    snapshot.log_weights.assign(filter_.log_weights().begin(), filter_.log_weights().end());
    snapshot.log_likelihood = filter_.log_likelihood();
    snapshot.steps = filter_.steps();
  }
  void set_snapshot(const CloudSnapshot& snapshot) override {
    const auto cast = [](const std::vector<double>& values) {
      std::vector<T> out(values.size());
      std::transform(values.begin(), values.end(), out.begin(), [](double x) { return static_cast<T>(x); });
      return out;
    };
    filter_.restore(cast(snapshot.components), cast(snapshot.log_weights), snapshot.log_likelihood, snapshot.steps);
  }

  ParticlePrior prior_;
  Filter filter_;
  MoveStep<T> move_;
  WeighStep<T> weigh_;
};

/// `CloudOf<CustomState<N>, T>` for the N of the settings among those listed; null for another.
template <class T, int... N>
[[nodiscard]] std::unique_ptr<ParticleCloud> make_plain_cloud(CloudSettings& settings, ParticlePrior& prior) {
  std::unique_ptr<ParticleCloud> cloud;
  const auto attempt = [&]<int kSize>(std::integral_constant<int, kSize>) {
    if (settings.names.size() != static_cast<std::size_t>(kSize)) return;
    cloud = std::make_unique<CloudOf<CustomState<kSize>, T>>(std::move(settings), std::move(prior));
  };
  (attempt(std::integral_constant<int, N>{}), ...);
  return cloud;
}

}  // namespace soopnav::python
