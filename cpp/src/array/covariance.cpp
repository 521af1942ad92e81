#include "soopnav/array/covariance.hpp"

#include <algorithm>
#include <cmath>

#include "array/kernels.hpp"
#include "array/require.hpp"

namespace soopnav::array {

namespace {

constexpr double kDead = 1e-10;   // of the strongest channel's power
constexpr double kFaint = 1e-26;  // mean power below which squares of a channel not yet dead leave single precision

/// The kernel's sums in double precision.
void faint_sums(const ChannelSpan& iq, double* power, double* re, double* im) noexcept {
  std::size_t pair = 0;
  for (std::size_t i = 0; i < iq.channels; ++i) {
    const Cf32* const x = iq.samples + i * iq.stride;
    power[i] = 0.0;
    for (std::size_t n = 0; n < iq.snapshots; ++n) power[i] += std::norm(Cf64(x[n]));
    for (std::size_t j = 0; j < i; ++j, ++pair) {
      const Cf32* const y = iq.samples + j * iq.stride;
      Cf64 sum = 0.0;
      for (std::size_t n = 0; n < iq.snapshots; ++n) sum += Cf64(x[n]) * std::conj(Cf64(y[n]));
      re[pair] = sum.real();
      im[pair] = sum.imag();
    }
  }
}

}  // namespace

CovarianceReport covariance(const ChannelSpan& iq, ComplexMatrix& out) noexcept {
  if (iq.channels < 1 || iq.channels > static_cast<std::size_t>(kMaxElements)) return {ArrayStatus::kWrongSize, -1};
  const auto channels = static_cast<Eigen::Index>(iq.channels);
  out.setZero(channels, channels);
  if (iq.snapshots == 0) return {ArrayStatus::kTooFewSnapshots, -1};
  double power[kMaxElements] = {};
  double re[kMaxElements * (kMaxElements - 1) / 2] = {}, im[kMaxElements * (kMaxElements - 1) / 2] = {};
  kernels::covariance_sums(iq.samples, iq.channels, iq.stride, iq.snapshots, power, re, im);
  for (std::size_t m = 0; m < iq.channels; ++m) {
    if (!std::isfinite(power[m])) return {ArrayStatus::kNonFinite, static_cast<int>(m)};
  }
  const double scale = 1.0 / static_cast<double>(iq.snapshots);
  if (scale * *std::max_element(power, power + iq.channels) < kFaint) faint_sums(iq, power, re, im);
  std::size_t pair = 0;
  for (Eigen::Index i = 0; i < channels; ++i) {
    out(i, i) = scale * power[i];
    for (Eigen::Index j = 0; j < i; ++j, ++pair) {
      out(i, j) = Cf64(scale * re[pair], scale * im[pair]);
      out(j, i) = std::conj(out(i, j));
    }
  }
  const double strongest = *std::max_element(power, power + iq.channels);
  for (std::size_t m = 0; m < iq.channels; ++m) {
    if (!(power[m] > kDead * strongest)) return {ArrayStatus::kDeadChannel, static_cast<int>(m)};
  }
  if (iq.snapshots < iq.channels) return {ArrayStatus::kTooFewSnapshots, -1};
  return {};
}

ComplexMatrix forward_backward(const ComplexMatrix& R) noexcept {
  ComplexMatrix out = R;
  const Eigen::Index last = R.rows() - 1;
  for (Eigen::Index i = 0; i <= last; ++i) {
    for (Eigen::Index j = 0; j <= last; ++j) out(i, j) = 0.5 * (R(i, j) + std::conj(R(last - i, last - j)));
  }
  return out;
}

ComplexMatrix spatial_smoothing(const ComplexMatrix& R, int subarray_size, bool average) {
  require(subarray_size >= 1 && subarray_size <= R.rows(), "subarray_size", subarray_size,
          "1 to the number of elements expected");
  const Eigen::Index count = R.rows() - subarray_size + 1;
  ComplexMatrix out = ComplexMatrix::Zero(subarray_size, subarray_size);
  for (Eigen::Index k = 0; k < count; ++k) out += R.block(k, k, subarray_size, subarray_size);
  out /= static_cast<double>(count);
  return average ? forward_backward(out) : out;
}

}  // namespace soopnav::array
