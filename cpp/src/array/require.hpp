#pragma once

#include <sstream>
#include <stdexcept>
#include <string_view>

namespace soopnav::array {

/// Throws std::invalid_argument "name: value; rule" unless `holds`.
template <class Value>
void require(bool holds, std::string_view name, const Value& value, std::string_view rule) {
  if (holds) return;
  std::ostringstream message;
  message << name << ": " << value << "; " << rule;
  throw std::invalid_argument(message.str());
}

}  // namespace soopnav::array
