#pragma once

#include <complex>
#include <span>

namespace soopnav {

/// One complex baseband sample. Samples are single precision everywhere; estimates are double.
using Cf32 = std::complex<float>;

/// A read-only run of samples, oldest first. It never owns them.
using IqSpan = std::span<const Cf32>;

}  // namespace soopnav
