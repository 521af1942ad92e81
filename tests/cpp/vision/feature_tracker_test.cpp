#include "soopnav/vision/feature_tracker.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/vision/camera.hpp"
#include "soopnav/vision/ego_motion.hpp"

namespace soopnav::vision {
namespace {

using Vector2 = Eigen::Vector2d;

constexpr int kWidth = 320, kHeight = 240;

// Smooth noise: random heights on a lattice of five pixels, joined by a cubic spline, so that it is known at every
// place.
double height(int i, int k) {
  std::uint32_t h = static_cast<std::uint32_t>(i) * 0x9E3779B1U ^ static_cast<std::uint32_t>(k) * 0x85EBCA77U;
  h = (h ^ (h >> 15)) * 0x2C1B3C6DU;
  h = (h ^ (h >> 12)) * 0x297A2D39U;
  return static_cast<double>(h ^ (h >> 15)) / 4294967296.0 - 0.5;
}

std::array<double, 4> spline(double t) {
  const double s = 1.0 - t;
  return {s * s * s / 6.0, (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0, (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0,
          t * t * t / 6.0};
}

double pattern(double x, double y) {
  const double gx = x / 5.0, gy = y / 5.0;
  const int i = static_cast<int>(std::floor(gx)), k = static_cast<int>(std::floor(gy));
  const auto across = spline(gx - i), down = spline(gy - k);
  double sum = 0.0;
  for (int b = 0; b < 4; ++b) {
    for (int a = 0; a < 4; ++a) {
      sum += across[static_cast<std::size_t>(a)] * down[static_cast<std::size_t>(b)] * height(i + a, k + b);
    }
  }
  return 128.0 + 330.0 * sum;
}

struct Picture {
  std::vector<std::uint8_t> pixels = std::vector<std::uint8_t>(static_cast<std::size_t>(kWidth * kHeight));
  [[nodiscard]] ImageView view() const { return {pixels.data(), kWidth, kHeight, kWidth}; }
};

// What stood at (u, v) stands at (u, v) + shift, turned about the origin.
Picture picture(const Vector2& shift, double turn_rad = 0.0) {
  Picture out;
  const double c = std::cos(turn_rad), s = std::sin(turn_rad);
  for (int v = 0; v < kHeight; ++v) {
    for (int u = 0; u < kWidth; ++u) {
      const double x = u - shift.x(), y = v - shift.y();
      out.pixels[static_cast<std::size_t>(v * kWidth + u)] =
          static_cast<std::uint8_t>(std::clamp(std::lround(pattern(c * x + s * y, -s * x + c * y)), 0L, 255L));
    }
  }
  return out;
}

Picture flat(std::uint8_t level) {
  Picture out;
  std::fill(out.pixels.begin(), out.pixels.end(), level);
  return out;
}

FeatureTrackerOptions hundred() {
  FeatureTrackerOptions options;
  options.tracks = 100;
  options.cell_px = 32;
  return options;
}

class Tracking : public testing::Test {
 protected:
  void SetUp() override {
    if (!tracking_available()) GTEST_SKIP() << "built without OpenCV";
  }
};

double mean_error(const FeatureTracker& tracker, const Vector2& flow, double& worst) {
  Vector2 mean = Vector2::Zero();
  int count = 0;
  worst = 0.0;
  for (const FeatureTrack& track : tracker.tracks()) {
    if (track.age == 0) continue;
    const Vector2 error = track.pixel - track.pixel_previous - flow;
    mean += error;
    worst = std::max(worst, error.norm());
    ++count;
  }
  return (mean / count).norm();
}

TEST_F(Tracking, FollowsAShiftToHundredthsOfAPixel) {
  for (const Vector2& flow : {Vector2(3.3, -2.25), Vector2(0.5, 0.5), Vector2(-42.0, 17.75), Vector2(0.0, 0.0)}) {
    FeatureTracker tracker(kWidth, kHeight, hundred());
    const TrackedFrame first = tracker.track(picture({0.0, 0.0}).view());
    EXPECT_EQ(first.status, FrameStatus::kFirst);
    EXPECT_EQ(first.born, 100);
    Picture moved = picture(flow);
    moved.pixels[0] ^= 1U;  // not the very same picture
    const TrackedFrame second = tracker.track(moved.view());
    EXPECT_EQ(second.status, FrameStatus::kTracked);
    EXPECT_GT(second.followed, 60);
    EXPECT_EQ(second.start, FlowStart::kPhaseCorrelation);
    EXPECT_NEAR(second.median_flow_px, flow.norm(), 0.02);
    double worst = 0.0;
    EXPECT_LT(mean_error(tracker, flow, worst), 0.01) << flow.transpose();
    EXPECT_LT(worst, 0.4);  // near the edges the mean of the surroundings is another one
  }
}

TEST_F(Tracking, KeepsItsTracksAndTheirNames) {
  FeatureTracker tracker(kWidth, kHeight, hundred());
  std::set<std::uint64_t> names;
  std::uint64_t largest = 0;
  for (int k = 0; k <= 12; ++k) {
    static_cast<void>(tracker.track(picture({4.0 * k, 1.5 * k}, 0.004 * k).view()));
    ASSERT_GE(tracker.tracks().size(), 70U);
    std::set<std::uint64_t> now;
    for (const FeatureTrack& track : tracker.tracks()) {
      EXPECT_TRUE(now.insert(track.id).second);
      EXPECT_LE(track.age, k);
      EXPECT_TRUE(track.age > 0 || track.id >= largest);  // a new one has a new name
      names.insert(track.id);
    }
    largest = std::max(largest, *now.rbegin());
    for (std::size_t i = 1; i < tracker.tracks().size(); ++i) {
      EXPECT_GE(tracker.tracks()[i - 1].age, tracker.tracks()[i].age);
    }
  }
  EXPECT_GT(names.size(), 105U);
  EXPECT_GT(tracker.tracks().front().age, 8);
}

TEST_F(Tracking, StartsWhereItIsTold) {
  const Vector2 flow(-61.5, 38.25);
  FeatureTracker tracker(kWidth, kHeight, hundred());
  static_cast<void>(tracker.track(picture({0.0, 0.0}).view()));
  std::vector<Vector2> predicted;
  for (const FeatureTrack& track : tracker.tracks()) predicted.push_back(track.pixel + flow + Vector2(1.5, -2.0));
  predicted[3].x() = std::numeric_limits<double>::quiet_NaN();
  const TrackedFrame report = tracker.track(picture(flow).view(), predicted);
  EXPECT_EQ(report.start, FlowStart::kPrediction);
  EXPECT_GT(report.followed, 50);
  double worst = 0.0;
  EXPECT_LT(mean_error(tracker, flow, worst), 0.01);
  // A prediction that is far off costs a second start, no tracks.
  predicted.clear();
  for (const FeatureTrack& track : tracker.tracks()) predicted.push_back(track.pixel + Vector2(50.0, 50.0));
  const TrackedFrame second = tracker.track(picture({-70.0, 40.0}).view(), predicted);
  EXPECT_EQ(second.start, FlowStart::kPhaseCorrelation);
  EXPECT_GT(second.followed, 70);
}

TEST_F(Tracking, TheSameBitsEachTime) {
  std::vector<double> runs[2];
  for (auto& run : runs) {
    FeatureTracker tracker(kWidth, kHeight, hundred());
    for (int k = 0; k < 4; ++k) static_cast<void>(tracker.track(picture({9.3 * k, -2.2 * k}).view()));
    for (const FeatureTrack& track : tracker.tracks()) run.insert(run.end(), {track.pixel.x(), track.pixel.y()});
  }
  EXPECT_EQ(runs[0], runs[1]);
}

TEST_F(Tracking, SaysWhatIsWrongWithAFrame) {
  FeatureTracker tracker(kWidth, kHeight, hundred());
  EXPECT_EQ(tracker.track(flat(0).view()).status, FrameStatus::kDark);
  EXPECT_EQ(tracker.track(flat(255).view()).status, FrameStatus::kSaturated);
  EXPECT_EQ(tracker.track(flat(90).view()).status, FrameStatus::kFlat);
  EXPECT_EQ(tracker.track(picture({0.0, 0.0}).view()).status, FrameStatus::kFirst);
  EXPECT_EQ(tracker.track(picture({0.0, 0.0}).view()).status, FrameStatus::kRepeated);
  EXPECT_EQ(tracker.tracks().size(), 100U);
  const Picture good = picture({2.0, 0.0});
  EXPECT_EQ(tracker.track({good.pixels.data(), kWidth, kHeight - 1, kWidth}).status, FrameStatus::kBadImage);
  EXPECT_EQ(tracker.track({good.pixels.data(), kWidth, kHeight, kWidth - 1}).status, FrameStatus::kBadImage);
  EXPECT_EQ(tracker.track({nullptr, kWidth, kHeight, kWidth}).status, FrameStatus::kBadImage);
  // Useless frames are stepped over.
  EXPECT_EQ(tracker.track(flat(0).view()).status, FrameStatus::kDark);
  EXPECT_EQ(tracker.track(flat(255).view()).status, FrameStatus::kSaturated);
  const TrackedFrame after = tracker.track(picture({5.0, 3.0}).view());
  EXPECT_EQ(after.status, FrameStatus::kTracked);
  EXPECT_EQ(after.skipped, 2);
  double worst = 0.0;
  EXPECT_LT(mean_error(tracker, {5.0, 3.0}, worst), 0.01);
  // Too many of them, and all starts anew.
  for (int k = 0; k <= tracker.options().patience; ++k) {
    EXPECT_EQ(tracker.track(flat(static_cast<std::uint8_t>(80 + k)).view()).status, FrameStatus::kFlat);
  }
  EXPECT_TRUE(tracker.tracks().empty());
  EXPECT_EQ(tracker.track(picture({5.0, 3.0}).view()).status, FrameStatus::kFirst);
}

TEST_F(Tracking, AnotherSceneIsAFirstFrameAgain) {
  FeatureTracker tracker(kWidth, kHeight, hundred());
  static_cast<void>(tracker.track(picture({0.0, 0.0}).view()));
  const TrackedFrame report = tracker.track(picture({4000.0, 9000.0}, 1.3).view());
  EXPECT_TRUE(report.status == FrameStatus::kLost || report.followed < 30) << report.followed;
  static_cast<void>(tracker.track(picture({4002.0, 9000.0}, 1.3).view()));
  EXPECT_GT(tracker.tracks().size(), 90U);
}

TEST_F(Tracking, GivesUpWhatItIsToldTo) {
  FeatureTracker tracker(kWidth, kHeight, hundred());
  static_cast<void>(tracker.track(picture({0.0, 0.0}).view()));
  std::vector<std::uint8_t> keep(tracker.tracks().size(), 1);
  keep[0] = keep[7] = 0;
  const std::uint64_t second = tracker.tracks()[1].id;
  tracker.prune(std::span(keep).first(5));  // not as many as tracks
  EXPECT_EQ(tracker.tracks().size(), 100U);
  tracker.prune(keep);
  EXPECT_EQ(tracker.tracks().size(), 98U);
  EXPECT_EQ(tracker.tracks()[0].id, second);
  tracker.reset();
  EXPECT_TRUE(tracker.tracks().empty());
}

TEST_F(Tracking, CornersKeepTheirDistanceAndSpread) {
  FeatureTracker tracker(kWidth, kHeight, hundred());
  static_cast<void>(tracker.track(picture({0.0, 0.0}).view()));
  const auto tracks = tracker.tracks();
  int quadrant[4] = {};
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    const Vector2& p = tracks[i].pixel;
    EXPECT_TRUE(p.x() >= 12.0 && p.y() >= 12.0 && p.x() < kWidth - 12.0 && p.y() < kHeight - 12.0);
    ++quadrant[(p.x() < kWidth / 2 ? 0 : 1) + (p.y() < kHeight / 2 ? 0 : 2)];
    for (std::size_t k = 0; k < i; ++k) EXPECT_GE((p - tracks[k].pixel).norm(), 8.0);
  }
  for (const int count : quadrant) EXPECT_GE(count, 15);
}

// The preset no-opencv runs it.
TEST(FeatureTracker, WithoutOpenCvItSaysWhatToInstall) {
  if (tracking_available()) GTEST_SKIP() << "built with OpenCV";
  EXPECT_EQ(opencv_version(), "");
  const auto refused = [](auto make) -> std::string {
    try {
      make();
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "";
  };
  const auto sentence = testing::AllOf(testing::StartsWith("tracking needs OpenCV"),
                                       testing::HasSubstr("install libopencv-core-dev, libopencv-imgproc-dev and "
                                                          "libopencv-video-dev"),
                                       testing::EndsWith("build again with SOOPNAV_WITH_OPENCV=ON"));
  EXPECT_THAT(refused([] { const FeatureTracker tracker(kWidth, kHeight); }), sentence);
  EXPECT_THAT(refused([] { const EgoMotion ego(Camera(kWidth, kHeight, 300.0, 300.0, 160.0, 120.0)); }), sentence);
}

TEST(FeatureTracker, SaysWhichOptionIsWrong) {
  if (!tracking_available()) GTEST_SKIP() << "built without OpenCV";
  const auto sentence = [](auto change, int width = kWidth) -> std::string {
    FeatureTrackerOptions options;
    change(options);
    try {
      const FeatureTracker tracker(width, kHeight, options);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_EQ(sentence([](auto&) {}), "");
  EXPECT_EQ(sentence([](auto&) {}, 31), "width: 31; 32 to 16384 pixels are possible");
  EXPECT_EQ(sentence([](auto& o) { o.tracks = 0; }), "tracks: 0; 1 to 20000 are possible");
  EXPECT_EQ(sentence([](auto& o) { o.window_px = 20; }), "window_px: 20; an odd number from 5 to 63 is needed");
  EXPECT_THAT(sentence([](auto& o) { o.quality = 0.0; }), testing::StartsWith("quality: "));
  EXPECT_THAT(sentence([](auto& o) { o.border_px = 150; }), testing::StartsWith("border_px: 150"));
  EXPECT_THAT(sentence([](auto& o) { o.epsilon_px = std::nan(""); }), testing::StartsWith("epsilon_px: "));
  EXPECT_THAT(sentence([](auto& o) { o.patience = -1; }), testing::StartsWith("patience: -1"));
}

}  // namespace
}  // namespace soopnav::vision
