#pragma once

#include <cstddef>

#include "soopnav/array/types.hpp"
#include "soopnav/core/iq.hpp"

namespace soopnav::array {

/// Samples of an array: sample n of channel m is samples[m stride + n]. It never owns them.
struct ChannelSpan {
  const Cf32* samples = nullptr;
  std::size_t channels = 0;
  std::size_t snapshots = 0;
  std::size_t stride = 0;

  /// Snapshots first .. first + count - 1.
  [[nodiscard]] ChannelSpan part(std::size_t first, std::size_t count) const noexcept {
    return {samples + first, channels, count, stride};
  }
};

/// What became of a covariance; `channel` is the first at fault, -1 without one.
struct CovarianceReport {
  ArrayStatus status = ArrayStatus::kOk;
  int channel = -1;
};

/// Sample covariance R = (1/N) sum_n x(n) x(n)^H, carter (4.12): M x M, Hermitian.
///
/// Products in single precision, summed in single precision over 256 snapshots and in double over those; the same bits
/// on every target. kTooFewSnapshots (N < M, R is given: it is singular), kNonFinite and kDeadChannel name the channel
/// (R is given for a dead one, and zero for one that is not finite); kWrongSize for no channel or more than 32. Does
/// not allocate. 4 channels of 2500 snapshots: 3 us.
[[nodiscard]] CovarianceReport covariance(const ChannelSpan& iq, ComplexMatrix& out) noexcept;

/// Forward-backward average (R + J conj(R) J) / 2: doubles the snapshots and decorrelates two coherent sources. For
/// arrays that look the same from behind when their elements are counted backwards (ULA, planar). Does not allocate.
[[nodiscard]] ComplexMatrix forward_backward(const ComplexMatrix& R) noexcept;

/// Spatial smoothing: the mean over the covariances of the M - size + 1 subarrays of `size` consecutive elements of a
/// ULA, forward-backward averaged where wanted: decorrelates coherent sources, M - size + 1 of them (twice that with
/// averaging). Does not allocate.
/// @throws std::invalid_argument unless 1 <= size <= M.
[[nodiscard]] ComplexMatrix spatial_smoothing(const ComplexMatrix& R, int subarray_size, bool average = false);

}  // namespace soopnav::array
