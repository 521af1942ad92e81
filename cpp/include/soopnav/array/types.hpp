#pragma once

#include <Eigen/Core>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <string_view>

namespace soopnav::array {

using Cf64 = std::complex<double>;

/// Most elements of an array: what fits on the stack, so that no estimate needs the heap.
inline constexpr int kMaxElements = 32;

/// M x M and smaller, held in place.
using ComplexMatrix = Eigen::Matrix<Cf64, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kMaxElements, kMaxElements>;
using ComplexVector = Eigen::Matrix<Cf64, Eigen::Dynamic, 1, Eigen::ColMajor, kMaxElements, 1>;
using RealVector = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, kMaxElements, 1>;

/// What became of a block of samples or of a covariance. With anything but kOk and kUnresolved there are no bearings.
enum class ArrayStatus : std::uint8_t {
  kOk,
  kNonFinite,        ///< NaN or infinity, or samples too large to be squared in single precision
  kDeadChannel,      ///< a channel 100 dB below the strongest, or nothing at all
  kTooFewSnapshots,  ///< fewer snapshots than elements
  kSingular,         ///< the covariance has not the rank that the method needs
  kNoSource,         ///< the source count is 0
  kUnresolved,       ///< fewer peaks than sources: those that are there are reported
  kWrongSize,        ///< another number of channels than the array's elements
};

/// A lower-case phrase for reports.
[[nodiscard]] constexpr std::string_view to_string(ArrayStatus status) noexcept {
  switch (status) {
    case ArrayStatus::kOk:
      return "ok";
    case ArrayStatus::kNonFinite:
      return "not finite";
    case ArrayStatus::kDeadChannel:
      return "dead channel";
    case ArrayStatus::kTooFewSnapshots:
      return "fewer snapshots than elements";
    case ArrayStatus::kSingular:
      return "singular covariance";
    case ArrayStatus::kNoSource:
      return "no source";
    case ArrayStatus::kUnresolved:
      return "fewer peaks than sources";
    case ArrayStatus::kWrongSize:
      return "wrong number of channels";
  }
  return "unknown";
}

}  // namespace soopnav::array
