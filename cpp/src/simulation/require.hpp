#pragma once

#include <sstream>
#include <stdexcept>
#include <string_view>

namespace soopnav::simulation {

/// Throws std::invalid_argument "name: value; rule" unless `holds`.
inline void require(bool holds, std::string_view name, double value, std::string_view rule) {
  if (holds) return;
  std::ostringstream message;
  message << name << ": " << value << "; " << rule;
  throw std::invalid_argument(message.str());
}

}  // namespace soopnav::simulation
