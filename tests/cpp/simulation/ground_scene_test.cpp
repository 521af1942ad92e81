#include "soopnav/simulation/ground_scene.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>
#include <vector>

#include "support/allocation_count.hpp"

namespace soopnav::simulation {
namespace {

const vision::Camera kCamera{160, 120, 131.0, 131.0, 79.5, 59.5};
const GroundTextureOptions kSmall{128, 0.004, 4, 1.0, 0.22};

TEST(GroundScene, FramesAndCloudsAfterTheFirstDoNotAllocate) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  GroundScene scene(1, kSmall);
  const std::vector<CameraView> views{{{0.0, 0.0, 0.0}, 1.0, {0.1, 0.0}}, {{0.01, 0.0, 0.0}, 1.0, {0.1, 0.0}}};
  ShotOptions shot;
  shot.noise = 2.0;
  shot.defocus_px = 1.0;
  const std::vector<GroundObject> objects{{{0.1, 0.0, 0.3}, 0.2, 0.2, 0.1, 1.0, 0.3}};
  const GroundWall wall{0.4, 0.0, 0.0};
  CloudOptions cloud;
  cloud.points = 2000;
  std::vector<std::uint8_t> image(160 * 120);
  std::vector<float> xyz(3 * cloud.points);
  const auto both = [&] {
    scene.render(kCamera, views, shot, objects, &wall, image);
    scene.depth_cloud(kCamera, views.front(), cloud, objects, &wall, xyz);
  };
  both();
  const auto first = image;
  EXPECT_EQ(test::allocations_of(both), 0);
  EXPECT_EQ(image, first) << "the same frame has the same bits, whatever was drawn in between";
}

TEST(GroundScene, RefusesBuffersOfAnotherSize) {
  GroundScene scene(1, kSmall);
  const CameraView view;
  std::vector<std::uint8_t> image(100);
  EXPECT_THROW(scene.render(kCamera, {&view, 1}, {}, {}, nullptr, image), std::invalid_argument);
  image.resize(160 * 120);
  EXPECT_THROW(scene.render(kCamera, {}, {}, {}, nullptr, image), std::invalid_argument);
  std::vector<float> xyz(7);
  EXPECT_THROW(scene.depth_cloud(kCamera, view, {}, {}, nullptr, xyz), std::invalid_argument);
}

}  // namespace
}  // namespace soopnav::simulation
