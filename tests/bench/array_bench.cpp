// Directions from samples: the whole estimate of the four-element array, and its parts.

#include <benchmark/benchmark.h>

#include <memory>
#include <vector>

#include "soopnav/array/direction_finder.hpp"
#include "soopnav/core/random.hpp"

namespace soopnav::array {
namespace {

constexpr std::size_t kSnapshots = 2500;

std::vector<Cf32> capture(const Manifold& manifold) {
  const auto elements = static_cast<std::size_t>(manifold.size());
  std::vector<Cf32> iq(elements * kSnapshots), signal(kSnapshots);
  RandomStream random(1);
  random.fill_complex_normal(iq);
  random.fill_complex_normal(signal, 4.0);
  ComplexVector a;
  static_cast<void>(manifold.steering(unit_vector({0.5, 0.9}), manifold.geometry().frequency_hz(), a));
  for (std::size_t m = 0; m < elements; ++m) {
    const Cf32 factor(a[static_cast<Eigen::Index>(m)]);
    for (std::size_t n = 0; n < kSnapshots; ++n) iq[m * kSnapshots + n] += factor * signal[n];
  }
  return iq;
}

void finder(benchmark::State& state) {
  const Manifold manifold(ArrayGeometry::planar(2, 2, 0.2));
  const auto iq = capture(manifold);
  DirectionFinder finder(std::make_shared<const SteeringTable>(manifold),
                         {DirectionMethod::kMusic, static_cast<int>(state.range(0)), 0.0, false});
  for (auto _ : state) {
    auto found = finder.estimate({iq.data(), 4, kSnapshots, kSnapshots});
    benchmark::DoNotOptimize(found);
  }
}
BENCHMARK(finder)->Name("array/music-4x2500-360x91")->Arg(1)->Arg(2)->Unit(benchmark::kMicrosecond);

void covariances(benchmark::State& state) {
  const auto channels = static_cast<std::size_t>(state.range(0));
  std::vector<Cf32> iq(channels * kSnapshots);
  RandomStream(1).fill_complex_normal(iq);
  ComplexMatrix R;
  for (auto _ : state) {
    auto report = covariance({iq.data(), channels, kSnapshots, kSnapshots}, R);
    benchmark::DoNotOptimize(report);
    benchmark::DoNotOptimize(R.data());
  }
}
BENCHMARK(covariances)->Name("array/covariance-2500")->Arg(4)->Arg(8)->Unit(benchmark::kMicrosecond);

void eigenvectors(benchmark::State& state) {
  const auto channels = static_cast<std::size_t>(state.range(0));
  std::vector<Cf32> iq(channels * kSnapshots);
  RandomStream(1).fill_complex_normal(iq);
  ComplexMatrix R;
  static_cast<void>(covariance({iq.data(), channels, kSnapshots, kSnapshots}, R));
  HermitianEigen eigen;
  for (auto _ : state) {
    const bool done = hermitian_eigen(R, eigen);
    benchmark::DoNotOptimize(done);
    benchmark::DoNotOptimize(eigen.vectors.data());
  }
}
BENCHMARK(eigenvectors)->Name("array/eigen")->Arg(4)->Arg(8)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace soopnav::array
