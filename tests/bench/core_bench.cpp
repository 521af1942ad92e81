// Random numbers of core against the standard library's, in one run. Items are numbers drawn.

#include <benchmark/benchmark.h>

#include <random>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/core/random.hpp"

namespace {

constexpr std::size_t kDraws = std::size_t{1} << 16;

void count_draws(benchmark::State& state, std::size_t per_iteration) {
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(per_iteration));
}

template <class Real>
void normal_std(benchmark::State& state) {
  std::mt19937_64 generator(1);
  std::normal_distribution<Real> normal;
  std::vector<Real> out(kDraws);
  for (auto _ : state) {
    for (Real& x : out) x = normal(generator);
    benchmark::DoNotOptimize(out.data());
    benchmark::ClobberMemory();
  }
  count_draws(state, kDraws);
}

template <class Real>
void normal_fill(benchmark::State& state) {
  soopnav::RandomStream random(1);
  std::vector<Real> out(kDraws);
  for (auto _ : state) {
    random.fill_normal(std::span<Real>(out));
    benchmark::DoNotOptimize(out.data());
    benchmark::ClobberMemory();
  }
  count_draws(state, kDraws);
}

void normal_one_by_one(benchmark::State& state) {
  soopnav::RandomStream random(1);
  std::vector<double> out(kDraws);
  for (auto _ : state) {
    for (double& x : out) x = random.normal();
    benchmark::DoNotOptimize(out.data());
    benchmark::ClobberMemory();
  }
  count_draws(state, kDraws);
}

void complex_noise_added(benchmark::State& state) {
  soopnav::RandomStream random(1);
  std::vector<soopnav::Cf32> samples(kDraws / 2);
  for (auto _ : state) {
    random.add_complex_normal(samples, 1e-3);
    benchmark::DoNotOptimize(samples.data());
    benchmark::ClobberMemory();
  }
  count_draws(state, kDraws);
}

void uniform_std(benchmark::State& state) {
  std::mt19937_64 generator(1);
  std::uniform_real_distribution<double> uniform;
  std::vector<double> out(kDraws);
  for (auto _ : state) {
    for (double& x : out) x = uniform(generator);
    benchmark::DoNotOptimize(out.data());
    benchmark::ClobberMemory();
  }
  count_draws(state, kDraws);
}

void uniform_fill(benchmark::State& state) {
  soopnav::RandomStream random(1);
  std::vector<double> out(kDraws);
  for (auto _ : state) {
    random.fill_uniform(out);
    benchmark::DoNotOptimize(out.data());
    benchmark::ClobberMemory();
  }
  count_draws(state, kDraws);
}

BENCHMARK(normal_std<double>)->Name("normal_double/mt19937_64_normal_distribution");
BENCHMARK(normal_fill<double>)->Name("normal_double/random_stream_fill");
BENCHMARK(normal_one_by_one)->Name("normal_double/random_stream_one_by_one");
BENCHMARK(normal_std<float>)->Name("normal_float/mt19937_64_normal_distribution");
BENCHMARK(normal_fill<float>)->Name("normal_float/random_stream_fill");
BENCHMARK(complex_noise_added)->Name("normal_float/random_stream_add_complex_normal");
BENCHMARK(uniform_std)->Name("uniform_double/mt19937_64_uniform_real_distribution");
BENCHMARK(uniform_fill)->Name("uniform_double/random_stream_fill");

}  // namespace
