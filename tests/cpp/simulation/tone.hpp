#pragma once

#include <cmath>
#include <complex>
#include <cstddef>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/iq.hpp"

namespace soopnav::test {

/// exp(j 2 pi f t) at time t [samples], f in cycles per sample; the phase reduced in long double.
inline std::complex<double> tone_at(double frequency_cycles, double time_samples) {
  const long double turns = static_cast<long double>(frequency_cycles) * static_cast<long double>(time_samples);
  return std::polar(1.0, kTwoPi * static_cast<double>(turns - std::round(turns)));
}

inline std::vector<Cf32> tone(double frequency_cycles, std::size_t n) {
  std::vector<Cf32> samples(n);
  for (std::size_t i = 0; i < n; ++i) samples[i] = Cf32(tone_at(frequency_cycles, static_cast<double>(i)));
  return samples;
}

}  // namespace soopnav::test
