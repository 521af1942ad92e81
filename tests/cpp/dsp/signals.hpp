#pragma once

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstddef>
#include <numbers>
#include <random>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"

namespace soopnav::dsp::testing {

using Cf64 = std::complex<double>;

/// Uniform in the square of half-width one, the same on every platform.
inline std::vector<Cf32> noise(std::size_t size, unsigned seed) {
  std::mt19937 engine(seed);
  const auto uniform = [&] { return static_cast<float>(static_cast<double>(engine()) / 2147483648.0 - 1.0); };
  std::vector<Cf32> out(size);
  for (Cf32& x : out) {
    const float re = uniform();
    x = {re, uniform()};
  }
  return out;
}

/// A sum of tones: band-limited, known at every time. The magnitudes of the tones add up to one.
class Tones {
 public:
  /// `count` tones with angular frequencies spread over [-highest_rad, highest_rad], both ends included.
  Tones(int count, double highest_rad, unsigned seed) {
    std::mt19937 engine(seed);
    for (int k = 0; k < count; ++k) {
      const double place = count > 1 ? 2.0 * k / (count - 1) - 1.0 : 1.0;
      frequencies_.push_back(highest_rad * place);
      amplitudes_.push_back(std::polar(1.0 / count, static_cast<double>(engine()) * 1e-9));
    }
  }
  Cf64 operator()(double t) const {
    Cf64 sum{};
    for (std::size_t k = 0; k < frequencies_.size(); ++k) {
      sum += amplitudes_[k] * std::polar(1.0, std::remainder(frequencies_[k] * t, 2.0 * std::numbers::pi));
    }
    return sum;
  }
  std::vector<Cf32> sample(std::size_t size) const {
    std::vector<Cf32> out(size);
    for (std::size_t n = 0; n < size; ++n) out[n] = Cf32((*this)(static_cast<double>(n)));
    return out;
  }

 private:
  std::vector<double> frequencies_;
  std::vector<Cf64> amplitudes_;
};

inline double largest_difference(std::span<const Cf32> a, std::span<const Cf32> b) {
  double largest = a.size() == b.size() ? 0.0 : HUGE_VAL;
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) {
    const double difference = std::abs(Cf64(a[i]) - Cf64(b[i]));
    if (!(difference <= largest)) largest = difference;
  }
  return largest;
}

inline double db(double ratio) { return 20.0 * std::log10(ratio); }

}  // namespace soopnav::dsp::testing
