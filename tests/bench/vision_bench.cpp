#include <benchmark/benchmark.h>

#include <cstdint>
#include <vector>

#include "soopnav/simulation/ground_scene.hpp"
#include "soopnav/vision/ground_plane.hpp"
#include "soopnav/vision/rigid_motion.hpp"

namespace {

using namespace soopnav;
using simulation::CameraView;
using simulation::GroundScene;

const CameraView kView{{0.3, -0.2, 0.4}, 1.0, {0.08, -0.1}};

vision::Camera camera() { return {640, 480, 525.0, 525.0, 319.5, 239.5}; }

/// A plane from 30 000 points of which `range(0)` per cent are outliers.
void plane_30000(benchmark::State& state) {
  GroundScene scene(1, {64, 0.001, 4, 1.0, 0.2});
  simulation::CloudOptions options;
  options.outlier_share = static_cast<double>(state.range(0)) / 100.0;
  std::vector<float> xyz(3 * options.points);
  scene.depth_cloud(camera(), kView, options, {}, nullptr, xyz);
  vision::PlaneFitter fitter;
  for (auto _ : state) benchmark::DoNotOptimize(fitter.fit(xyz));
}
BENCHMARK(plane_30000)->Arg(0)->Arg(30)->Arg(60)->Unit(benchmark::kMicrosecond);

void rigid_motion_300(benchmark::State& state) {
  const vision::Camera lens = camera();
  const vision::GroundPlane plane = simulation::true_plane(kView);
  const vision::GroundProjection ground(plane);
  RandomStream random(2);
  std::vector<Eigen::Vector2d> before, now;
  while (now.size() < 300) {
    const Eigen::Vector2d at(random.uniform(-0.5, 0.5), random.uniform(-0.4, 0.4));
    Eigen::Vector2d a, b;
    if (!lens.project(ground.to_camera(at + Eigen::Vector2d(0.02, 0.01)), a) ||
        !lens.project(ground.to_camera(at), b)) {
      continue;
    }
    before.push_back(a);
    now.push_back(b + 0.1 * Eigen::Vector2d(random.normal(), random.normal()));
  }
  vision::RigidMotionEstimator estimator;
  for (auto _ : state) benchmark::DoNotOptimize(estimator.estimate(lens, before, now, plane, plane));
}
BENCHMARK(rigid_motion_300)->Unit(benchmark::kMicrosecond);

void render_640x480(benchmark::State& state) {
  GroundScene scene(1);
  const vision::Camera lens = camera();
  std::vector<std::uint8_t> image(640 * 480);
  simulation::ShotOptions shot;
  shot.noise = 2.0;
  CameraView view = kView;
  view.height_m = static_cast<double>(state.range(0)) / 10.0;
  for (auto _ : state) scene.render(lens, {&view, 1}, shot, {}, nullptr, image);
}
BENCHMARK(render_640x480)->Arg(10)->Arg(14)->Unit(benchmark::kMicrosecond);

void depth_cloud_30000(benchmark::State& state) {
  GroundScene scene(1, {64, 0.001, 4, 1.0, 0.2});
  const simulation::CloudOptions options;
  std::vector<float> xyz(3 * options.points);
  for (auto _ : state) scene.depth_cloud(camera(), kView, options, {}, nullptr, xyz);
}
BENCHMARK(depth_cloud_30000)->Unit(benchmark::kMicrosecond);

}  // namespace
