// Linked where OpenCV is private to soopnav: a tracker, or the sentence that there is none.
#include <cstdio>
#include <exception>
#include <string_view>

#include "soopnav/vision/feature_tracker.hpp"

int main() {
  using namespace soopnav::vision;
  try {
    const bool empty = FeatureTracker(64, 48).tracks().empty();
    std::printf("tracking by OpenCV %s\n", std::string(opencv_version()).c_str());
    return tracking_available() && empty ? 0 : 1;
  } catch (const std::exception& error) {
    std::printf("%s\n", error.what());
    return !tracking_available() && std::string_view(error.what()).find("OpenCV") != std::string_view::npos ? 0 : 1;
  }
}
