#pragma once

#include <cmath>
#include <stdexcept>
#include <string>

// Rules that options of a pair are held to; std::invalid_argument names the option, its value and the rule.
namespace soopnav::navigation::pair_options {

[[noreturn]] inline void refuse(const char* name, double value, const char* rule) {
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; " + rule);
}
inline void zero_or_more(const char* name, double value) {
  if (!(value >= 0.0) || !std::isfinite(value)) refuse(name, value, "a finite number of 0 or more expected");
}
inline void positive(const char* name, double value) {
  if (!(value > 0.0) || !std::isfinite(value)) refuse(name, value, "a positive number expected");
}

}  // namespace soopnav::navigation::pair_options
