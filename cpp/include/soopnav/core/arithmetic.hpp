#pragma once

#include <type_traits>

namespace soopnav {

/// The value of an expression: numbers as they are, expressions (of Eigen, of packets of particles) computed.
///
/// Models name their intermediate results with `const auto`; without this an Eigen expression would be computed again
/// at each use, or outlive what it points to.
template <class T>
[[nodiscard]] auto eval(const T& value) {
  if constexpr (std::is_arithmetic_v<T>) {
    return value;
  } else {
    return value.eval();
  }
}

}  // namespace soopnav
