#include "soopnav/vision/feature_tracker.hpp"

#include <opencv2/core.hpp>
#include <stdexcept>
#include <vector>

namespace soopnav::vision {

bool tracking_available() noexcept { return true; }

std::string_view opencv_version() noexcept { return CV_VERSION; }

}  // namespace soopnav::vision
