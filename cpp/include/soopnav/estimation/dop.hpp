#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>

#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav {

/// Dilution of precision: standard deviation of an estimate per standard deviation of equally good, independent
/// measurements, from geometry alone. No unit. NaN where it does not apply: all of it for a geometry of less than full
/// rank, `vdop` of a planar state, `hdop` and `vdop` in a frame whose third axis is not the vertical (ECEF, a plane).
struct Dop {
  double gdop = std::numeric_limits<double>::quiet_NaN();  ///< position and clock bias (everything the state estimates)
  double pdop = std::numeric_limits<double>::quiet_NaN();  ///< position
  double hdop = std::numeric_limits<double>::quiet_NaN();  ///< horizontal position
  double vdop = std::numeric_limits<double>::quiet_NaN();  ///< vertical position
  double tdop = std::numeric_limits<double>::quiet_NaN();  ///< c * clock bias
};

/// Dilution of precision from the cofactor matrix (HᵀH)⁻¹ of a state's tangent components. No allocation.
template <FixedStateType State>
[[nodiscard]] Dop dilution_of_precision(const Eigen::Matrix<double, State::kDim, State::kDim>& cofactor) noexcept {
  Dop dop;
  dop.gdop = std::sqrt(cofactor.trace());
  if constexpr (HoldsRole<State, Role<3, PositionTag>>) {
    constexpr int kAt = State::at(kPosition);
    constexpr bool kPlanar = kAt + 3 > State::kDim;
    constexpr bool kLevel =
        std::same_as<typename State::Frame, EnuFrame> || std::same_as<typename State::Frame, NedFrame>;
    const double horizontal = cofactor(kAt, kAt) + cofactor(kAt + 1, kAt + 1);
    if constexpr (kLevel || kPlanar) dop.hdop = std::sqrt(horizontal);
    if constexpr (kPlanar) {
      dop.pdop = dop.hdop;
    } else {
      dop.pdop = std::sqrt(horizontal + cofactor(kAt + 2, kAt + 2));
      if constexpr (kLevel) dop.vdop = std::sqrt(cofactor(kAt + 2, kAt + 2));
    }
  }
  if constexpr (HoldsRole<State, Role<1, ClockBiasTag>>) {
    constexpr int kAt = State::at(kClockBias);
    dop.tdop = std::sqrt(cofactor(kAt, kAt));
  }
  return dop;
}

}  // namespace soopnav
