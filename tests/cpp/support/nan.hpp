#pragma once

#include <limits>

namespace soopnav::test {

inline constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

}  // namespace soopnav::test
