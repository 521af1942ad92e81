// Steps of a bootstrap particle filter against the loop one writes first: an array of structures, std::mt19937_64 and
// std::normal_distribution. Five states (planar position and velocity, clock), four pseudoranges, systematic resampling
// in every step. Also the parts: resampling schemes, moments, and normal variates.

#include <benchmark/benchmark.h>

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstdint>
#include <random>
#include <stdexcept>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/estimation/particle_filter.hpp"
#include "soopnav/estimation/resampling.hpp"
#include "soopnav/measurement/pseudorange.hpp"

namespace {

using namespace soopnav;
using State = ComposedState<PlanarFrame, Role<2, PositionTag>, Role<2, VelocityTag>, Role<1, ClockBiasTag>>;
using Model = Pseudorange<PlanarFrame, Known<1>, Known<2>>;

constexpr double kStepS = 0.1;
constexpr double kAccelerationMps2 = 0.3;
constexpr double kClockM = 0.5;

struct Motion {
  static constexpr int kNoise = 3;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    for (int i = 0; i < 2; ++i) {
      const auto a = w[i] * kAccelerationMps2;
      y.next(kPlanarPosition)[i] = x(kPlanarPosition)[i] + x(kPlanarVelocity)[i] * dt_s + a * (0.5 * dt_s * dt_s);
      y.next(kPlanarVelocity)[i] = x(kPlanarVelocity)[i] + a * dt_s;
    }
    y.next(kClockBias)[0] = x(kClockBias)[0] + w[2] * (kClockM * std::sqrt(dt_s));
    return true;
  }
};

const std::array<Eigen::Vector2d, 4> kSources = {Eigen::Vector2d{0, 0}, Eigen::Vector2d{50, 0}, Eigen::Vector2d{0, 50},
                                                 Eigen::Vector2d{50, 50}};
constexpr int kEpochs = 64;  // then back again, so that the receiver stays among the sources

std::vector<std::array<double, 4>> make_pseudoranges() {
  RandomStream random(5);
  std::vector<std::array<double, 4>> z(kEpochs);
  for (int k = 0; k < kEpochs; ++k) {
    const Eigen::Vector2d p(20.0 + std::sin(0.02 * k), 22.0 + std::cos(0.02 * k));
    for (std::size_t i = 0; i < 4; ++i)
      z[static_cast<std::size_t>(k)][i] = (p - kSources[i]).norm() + 2.0 + random.normal();
  }
  return z;
}

State start() {
  State x;
  x.x << 20, 23, 0, 0, 2;
  return x;
}

// The first afternoon's filter.
class PlainFilter {
 public:
  explicit PlainFilter(std::size_t count) : particles_(count), next_(count), weights_(count) {
    for (Particle& p : particles_) {
      p = {20.0 + normal_(engine_), 23.0 + normal_(engine_), normal_(engine_), normal_(engine_),
           2.0 + normal_(engine_)};
    }
  }
  double step(const std::array<double, 4>& z) {
    double largest = -1e300;
    for (std::size_t k = 0; k < particles_.size(); ++k) {
      Particle& p = particles_[k];
      const double ax = kAccelerationMps2 * normal_(engine_);
      const double ay = kAccelerationMps2 * normal_(engine_);
      p.x += p.vx * kStepS + 0.5 * ax * kStepS * kStepS;
      p.y += p.vy * kStepS + 0.5 * ay * kStepS * kStepS;
      p.vx += ax * kStepS;
      p.vy += ay * kStepS;
      p.b += kClockM * std::sqrt(kStepS) * normal_(engine_);
      double l = 0.0;
      for (std::size_t i = 0; i < 4; ++i) {
        const double r = z[i] - std::hypot(p.x - kSources[i][0], p.y - kSources[i][1]) - p.b;
        l -= 0.5 * r * r;
      }
      weights_[k] = l;
      largest = std::max(largest, l);
    }
    double sum = 0.0;
    double squares = 0.0;
    for (double& w : weights_) {
      w = std::exp(w - largest);
      sum += w;
      squares += w * w;
    }
    const double u = std::uniform_real_distribution<double>()(engine_);
    double cumulative = weights_[0];
    std::size_t i = 0;
    for (std::size_t j = 0; j < next_.size(); ++j) {
      const double position = (static_cast<double>(j) + u) * sum / static_cast<double>(next_.size());
      while (cumulative < position && i + 1 < particles_.size()) cumulative += weights_[++i];
      next_[j] = particles_[i];
    }
    particles_.swap(next_);
    return sum * sum / squares;
  }

 private:
  struct Particle {
    double x, y, vx, vy, b;
  };
  std::mt19937_64 engine_{1};
  std::normal_distribution<double> normal_;
  std::vector<Particle> particles_;
  std::vector<Particle> next_;
  std::vector<double> weights_;
};

void BM_PlainStep(benchmark::State& state) {
  const auto z = make_pseudoranges();
  PlainFilter f(static_cast<std::size_t>(state.range(0)));
  std::size_t k = 0;
  for (auto _ : state) benchmark::DoNotOptimize(f.step(z[k++ % kEpochs]));
  state.SetItemsProcessed(state.iterations() * state.range(0));
}
BENCHMARK(BM_PlainStep)->Arg(100000)->Unit(benchmark::kMillisecond);

template <class T>
void BM_Step(benchmark::State& state) {
  const auto z = make_pseudoranges();
  ParticleFilter<State, T> f(start(), Eigen::Matrix<double, 5, 5>::Identity(),
                             {.count = static_cast<std::size_t>(state.range(0)),
                              .seed = 1,
                              .threads = static_cast<int>(state.range(1)),
                              .ess_threshold = 1.0});
  std::array<Observed<Model>, 4> observed;
  std::size_t k = 0;
  for (auto _ : state) {
    for (std::size_t i = 0; i < 4; ++i) observed[i] = Observed<Model>(Model{kSources[i]}, z[k % kEpochs][i], 1.0);
    ++k;
    const auto report = f.step(Motion{}, kStepS, observed);
    if (!report.accepted()) throw std::runtime_error("the filter refused a step");
  }
  state.SetItemsProcessed(state.iterations() * state.range(0));
}
BENCHMARK_TEMPLATE(BM_Step, double)
    ->ArgNames({"n", "threads"})
    ->Args({100000, 1})
    ->Args({100000, 2})
    ->Args({1000000, 1})
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();
BENCHMARK_TEMPLATE(BM_Step, float)
    ->ArgNames({"n", "threads"})
    ->Args({100000, 1})
    ->Args({100000, 2})
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

void BM_Moments(benchmark::State& state) {
  const ParticleFilter<State> f(start(), Eigen::Matrix<double, 5, 5>::Identity(), {.count = 100000});
  for (auto _ : state) benchmark::DoNotOptimize(f.covariance());
}
BENCHMARK(BM_Moments)->Unit(benchmark::kMillisecond);

void BM_Resample(benchmark::State& state) {
  RandomStream random(1);
  std::vector<double> weights(100000);
  for (double& w : weights) w = std::exp(random.normal());
  std::vector<std::uint32_t> ancestors(weights.size());
  const auto scheme = static_cast<Resampling>(state.range(0));
  state.SetLabel(std::string(to_string(scheme)));
  for (auto _ : state) {
    if (!resample(scheme, weights, random, ancestors)) throw std::runtime_error("the weights were refused");
    benchmark::DoNotOptimize(ancestors.data());
  }
}
BENCHMARK(BM_Resample)->DenseRange(0, 3)->Unit(benchmark::kMillisecond);

}  // namespace
