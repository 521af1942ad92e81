#pragma once

#include "soopnav/core/role.hpp"
#include "soopnav/measurement/arithmetic.hpp"

namespace soopnav {

/// A part of the state measured as it is: a position that another receiver found, a surveyed mark, a velocity of zero.
///
/// Model:   z = p                                        (doc/measurement_models.md eq. 2) [m]
/// Frames:  p in `FrameTag`.
/// Roles:   `Part`: the position, unless another role or block of vector components is named (a velocity [m/s]).
/// Refused: nothing. No allocation.
template <class FrameTag = EcefFrame, int Dim = 3, PartOf<Dim> Part = Role<Dim, PositionTag>>
struct PositionFix {
  using Frame = FrameTag;
  static constexpr int kDim = Dim;
  Part part{};  ///< p

  template <class X, class Y>
  requires Provides<X, PositionFix, Part>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto p = x(part);
    for (int i = 0; i < Dim; ++i) y.value(i) = p[i];
    if constexpr (Y::kJacobian) {
      auto&& to_p = y.jacobian(part);
      for (int i = 0; i < Dim; ++i) to_p(i, i) += 1.0;
    }
    return true;
  }
};

}  // namespace soopnav
