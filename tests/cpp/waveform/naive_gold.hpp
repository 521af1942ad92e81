#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace soopnav::lte::test {

/// c(n), n = 0 ... length - 1, of TS 36.211 section 7.2 written as the standard writes it: one element at a time from
/// three arrays. The tests compare the library with this and share no code with it.
inline std::vector<int> naive_gold(std::uint32_t c_init, std::size_t length) {
  constexpr std::size_t kSkip = 1600;
  std::vector<int> x1(kSkip + length + 31), x2(kSkip + length + 31), c(length);
  x1[0] = 1;
  for (std::size_t i = 0; i < 31; ++i) x2[i] = static_cast<int>((c_init >> i) & 1U);
  for (std::size_t n = 0; n < kSkip + length; ++n) {
    x1[n + 31] = (x1[n + 3] + x1[n]) % 2;
    x2[n + 31] = (x2[n + 3] + x2[n + 2] + x2[n + 1] + x2[n]) % 2;
  }
  for (std::size_t n = 0; n < length; ++n) c[n] = (x1[n + kSkip] + x2[n + kSkip]) % 2;
  return c;
}

}  // namespace soopnav::lte::test
