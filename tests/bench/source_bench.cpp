#include <benchmark/benchmark.h>

#include <cmath>
#include <string>
#include <vector>

#include "soopnav/navigation/source_likelihood.hpp"
#include "soopnav/navigation/source_locator.hpp"

namespace {

using namespace soopnav::navigation;

std::vector<SourceBearing> drive(std::size_t n) {
  std::vector<SourceBearing> out(n);
  for (std::size_t i = 0; i < n; ++i) {
    const double s = static_cast<double>(i) / static_cast<double>(n - 1);
    out[i].t_s = static_cast<double>(i);
    out[i].position_m = {-1000.0 + 2000.0 * s, -150.0 - 200.0 * std::sin(3.0 * s), 0.0};
    out[i].azimuth_rad = std::atan2(-out[i].position_m[1], -out[i].position_m[0]) + 0.01 * std::sin(37.0 * s * s * 1e3);
    out[i].sigma_azimuth_rad = 0.02;
  }
  return out;
}

void likelihood_surface_200(benchmark::State& state) {
  const auto bearings = drive(500);
  std::vector<PackedBearing> packed(bearings.size());
  for (std::size_t i = 0; i < packed.size(); ++i) {
    packed[i].x = bearings[i].position_m[0];
    packed[i].y = bearings[i].position_m[1];
    packed[i].cos_azimuth = std::cos(bearings[i].azimuth_rad);
    packed[i].sin_azimuth = std::sin(bearings[i].azimuth_rad);
    packed[i].variance_azimuth = 4e-4;
  }
  std::vector<double> surface(40000);
  const double outlier = static_cast<double>(state.range(0)) / 100.0;
  for (auto _ : state) {
    likelihood_surface(packed, {-1000.0, 1000.0, -1000.0, 1000.0, 200, 200}, outlier, surface);
    benchmark::DoNotOptimize(surface.data());
  }
}
BENCHMARK(likelihood_surface_200)->Arg(0)->Arg(2)->Unit(benchmark::kMillisecond);

void locate(benchmark::State& state) {
  const auto bearings = drive(500);
  SourceOptions options;
  options.method = static_cast<SourceMethod>(state.range(0));
  options.start_m = Eigen::Vector3d(300.0, 200.0, 0.0);
  options.start_sigma_m = 500.0;
  SourceLocator locator(options);
  for (auto _ : state) {
    locator.reset(options.start_m, 1);
    for (const SourceBearing& b : bearings) locator.observe(b);
    const SourceFix fix = locator.fix();
    benchmark::DoNotOptimize(fix.position_m.data());
  }
  state.SetLabel(std::string(to_string(options.method)));
}
BENCHMARK(locate)->DenseRange(0, 8)->Unit(benchmark::kMillisecond);

}  // namespace
