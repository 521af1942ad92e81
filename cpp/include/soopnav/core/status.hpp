#pragma once

#include <cstdint>
#include <string_view>

namespace soopnav {

/// What became of an observation given to a filter or solver. Anything but `kAccepted` left the state untouched.
enum class UpdateStatus : std::uint8_t {
  kAccepted,             ///< the state was updated
  kGated,                ///< the normalised innovation squared lies above the gate
  kUndefined,            ///< the model has no value or no Jacobian here (coincident points)
  kNonFinite,            ///< NaN or infinity in the observation, its covariance or the prediction
  kNotPositiveDefinite,  ///< the covariance of the observation or of the innovation is not positive definite
  kStaleHandle,          ///< a handle names states that its layout does not hold (any more)
  kWrongTimeScale,       ///< the epoch is invalid or in another time scale than the state's
  kTimeNotAdvancing,     ///< the time step is not a positive finite number, or the epoch is not after the state's
  kTooLate,              ///< the observation is older than what the filter keeps for late ones
  kTooManyRows,          ///< more rows at once than the filter was made for
};

/// A lower-case phrase for reports: "accepted", "gated", ...; "unknown" for a value that is no enumerator.
[[nodiscard]] constexpr std::string_view to_string(UpdateStatus status) noexcept {
  switch (status) {
    case UpdateStatus::kAccepted:
      return "accepted";
    case UpdateStatus::kGated:
      return "gated";
    case UpdateStatus::kUndefined:
      return "undefined";
    case UpdateStatus::kNonFinite:
      return "not finite";
    case UpdateStatus::kNotPositiveDefinite:
      return "not positive definite";
    case UpdateStatus::kStaleHandle:
      return "stale handle";
    case UpdateStatus::kWrongTimeScale:
      return "wrong time scale";
    case UpdateStatus::kTimeNotAdvancing:
      return "time not advancing";
    case UpdateStatus::kTooLate:
      return "too late";
    case UpdateStatus::kTooManyRows:
      return "too many rows";
  }
  return "unknown";
}

}  // namespace soopnav
