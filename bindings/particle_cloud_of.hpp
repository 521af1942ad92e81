#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "particle_cloud.hpp"
#include "soopnav/clock/two_state.hpp"
#include "soopnav/estimation/particle_filter.hpp"

namespace soopnav::python {

using ExactClock = ComposedState<PlanarFrame, Role<1, ClockBiasTag>, Role<1, ClockDriftTag>>;

/// The cloud of one state and precision; a state without headings is a `CustomState` of its size, whatever its roles.
template <class State, class T>
class CloudOf final : public ParticleCloud {
 public:
  CloudOf(CloudSettings settings, ParticlePrior prior)
      : ParticleCloud(std::move(settings)), prior_(std::move(prior)), filter_(draw(this->settings().options)) {
    move_.keep_clock_exact(!this->settings().clock.empty());
  }

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
    const std::vector<int>& clock = settings().clock;
    if (clock.empty()) return;
    const auto n = static_cast<Eigen::Index>(clock.size());
    Eigen::MatrixXd F = Eigen::MatrixXd::Identity(n, n);
    Eigen::MatrixXd Q = Eigen::MatrixXd::Zero(n, n);
    if (n == 2) {
      const clock::ClockNoise noise = process.clock().value_or(clock::ClockNoise{});
      Transition<ExactClock, 2> y{ExactClock{}};
      static_cast<void>(clock::TwoState<>{noise}.propagate(ExactClock{}, dt_s, ZeroNoise{}, y));
      F = y.F.template topLeftCorner<2, 2>();
      Q = y.G.template topRows<2>() * y.G.template topRows<2>().transpose();
    }
    for (Eigen::Index i = 0; i < n; ++i) {
      const double sigma = diffusion[static_cast<std::size_t>(clock[static_cast<std::size_t>(i)])];
      Q(i, i) += sigma * sigma * dt_s;
    }
    set_clock_step(F, Q);
  }
  void plan_move(std::span<const double> next) override {
    move_.prepare(next.data(), filter_.count(), static_cast<std::size_t>(kSize), settings().roles, wide());
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
  std::size_t get_count() const override { return filter_.count(); }
  bool get_clock_factors(Eigen::Index rows, Eigen::MatrixXd& H) const override {
    constexpr std::size_t kWidth = Packet<T>::kWidth;
    constexpr double kStep = 1024.0;  // what the rows are linear in can take any
    const std::vector<int>& clock = settings().clock;
    H.setZero(rows, static_cast<Eigen::Index>(clock.size()));
    std::array<std::array<T, kWidth>, static_cast<std::size_t>(kSize)> numbers;
    std::array<const T*, static_cast<std::size_t>(kSize)> columns;
    std::vector<T> residuals(kMaxGroupRows * soopnav::detail::kParticleChunk);
    for (std::size_t i = 0; i < filter_.count(); ++i) {
      for (std::size_t c = 0; c < numbers.size(); ++c) {
        numbers[c].fill(filter_.component(static_cast<int>(c))[i]);
        columns[c] = numbers[c].data();
      }
      for (std::size_t k = 0; k < clock.size(); ++k) {
        auto& column = numbers[static_cast<std::size_t>(clock[k])];
        column.fill(T{0});
        column[k + 1] = static_cast<T>(kStep);
      }
      weigh_.residuals(columns.data(), residuals.data(), kWidth);
      for (Eigen::Index row = 0; row < rows; ++row) {
        const T* r = residuals.data() + static_cast<std::size_t>(row) * soopnav::detail::kParticleChunk;
        for (std::size_t k = 0; k < clock.size(); ++k) {
          H(row, static_cast<Eigen::Index>(k)) = static_cast<double>(r[0] - r[k + 1]) / kStep;
        }
      }
      if (H.allFinite()) return true;
    }
    return false;
  }
  void do_correct_clock(const Eigen::MatrixXd& K) override {
    const std::vector<int>& clock = settings().clock;
    filter_.transform([this, &K, &clock](const auto& to, std::size_t /*first*/, std::size_t n) {
      std::array<const T*, static_cast<std::size_t>(kSize)> columns;
      std::copy(to.begin(), to.end(), columns.begin());
      std::array<T, kMaxGroupRows * soopnav::detail::kParticleChunk> residuals;
      weigh_.residuals(columns.data(), residuals.data(), n);
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t k = 0; k < clock.size(); ++k) {
          T change{0};
          for (Eigen::Index row = 0; row < K.cols(); ++row) {
            change += static_cast<T>(K(static_cast<Eigen::Index>(k), row)) *
                      residuals[static_cast<std::size_t>(row) * soopnav::detail::kParticleChunk + i];
          }
          if (std::isfinite(change)) to[static_cast<std::size_t>(clock[k])][i] += change;
        }
      }
    });
  }
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
