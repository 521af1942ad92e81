// A build without OpenCV: nothing can be tracked, and everything says so.
#include <stdexcept>

#include "soopnav/vision/feature_tracker.hpp"

namespace soopnav::vision {

class FeatureTracker::Impl {};

bool tracking_available() noexcept { return false; }

std::string_view opencv_version() noexcept { return {}; }

FeatureTracker::FeatureTracker(int, int, const FeatureTrackerOptions&) {
  throw std::runtime_error(
      "tracking needs OpenCV, which this build of soopnav was made without: install libopencv-core-dev, "
      "libopencv-imgproc-dev and libopencv-video-dev, and build again with SOOPNAV_WITH_OPENCV=ON");
}
FeatureTracker::FeatureTracker(FeatureTracker&&) noexcept = default;
FeatureTracker& FeatureTracker::operator=(FeatureTracker&&) noexcept = default;
FeatureTracker::~FeatureTracker() = default;

TrackedFrame FeatureTracker::track(const ImageView&, std::span<const Eigen::Vector2d>) noexcept { return {}; }

std::span<const FeatureTrack> FeatureTracker::tracks() const noexcept { return {}; }

void FeatureTracker::prune(std::span<const std::uint8_t>) noexcept {}

void FeatureTracker::reset() noexcept {}

const FeatureTrackerOptions& FeatureTracker::options() const noexcept {
  static const FeatureTrackerOptions kNone;
  return kNone;
}

}  // namespace soopnav::vision
