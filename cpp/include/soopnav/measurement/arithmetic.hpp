#pragma once

#include <type_traits>

#include "soopnav/core/arithmetic.hpp"
#include "soopnav/core/role.hpp"

namespace soopnav {

/// Nearer to the source than this a direction is undefined [m].
inline constexpr double kMinRangeM = 1e-6;

/// Whether a state (or a packet of particles) has a part.
template <class X, class Part>
concept HoldsPart = requires(const X& x, const Part& part) {
  x(part);
};

/// Whether a state can answer a model: it names the model's frame and has every part the model reads. What cannot does
/// not compile, and this says why.
template <class X, class Model, class... Parts>
concept Provides = FrameCompatible<Model, X> &&(HoldsPart<X, Parts>&&...);

namespace detail {

// The frame a model has when only the size of its source is given.
template <int Space>
using FrameOfSpace = std::conditional_t<Space == 2, PlanarFrame, EcefFrame>;

// Whether two points are too near each other for a direction, by the square of their distance. Packets of particles are
// not asked: the few that are get some direction. NaN passes, to be seen in what comes out.
template <class T>
[[nodiscard]] constexpr bool too_near(const T& square_m2) noexcept {
  if constexpr (std::is_arithmetic_v<T>) {
    return square_m2 <= kMinRangeM * kMinRangeM;
  } else {
    return false;
  }
}

}  // namespace detail
}  // namespace soopnav
