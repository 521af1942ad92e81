#include "soopnav/dsp/fft.hpp"

#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>

namespace soopnav::dsp {

int fast_fft_size(int minimum) {
  if (minimum < 1) {
    throw std::invalid_argument("minimum: at least 1 required, got " + std::to_string(minimum));
  }
  // Every 2^a 3^b 5^c from `minimum` up to the next power of two, which is one of them.
  std::int64_t best = std::numeric_limits<std::int64_t>::max();
  for (std::int64_t five = 1; five < best; five *= 5) {
    for (std::int64_t three = five; three < best; three *= 3) {
      std::int64_t size = three;
      while (size < minimum) size *= 2;
      if (size < best) best = size;
      if (three >= minimum) break;
    }
    if (five >= minimum) break;
  }
  if (best > std::numeric_limits<int>::max()) {
    throw std::invalid_argument("minimum: no fast size fits in an int, got " + std::to_string(minimum));
  }
  return static_cast<int>(best);
}

}  // namespace soopnav::dsp
