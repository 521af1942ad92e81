#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "waveform/naive_gold.hpp"

/// The broadcast channel's coding written step by step from TS 36.212 and 36.211, one bit at a time; shares no code
/// with the library.
namespace soopnav::lte::test {

/// 24 payload bits of a bandwidth index, PHICH fields and frame number (TS 36.331).
inline std::vector<int> naive_mib(int bandwidth_index, bool extended_phich, int phich_resource, int sfn) {
  std::vector<int> bits;
  const auto put = [&](int value, int width) {
    for (int i = width - 1; i >= 0; --i) bits.push_back((value >> i) & 1);
  };
  put(bandwidth_index, 3);
  put(extended_phich ? 1 : 0, 1);
  put(phich_resource, 2);
  put(sfn / 4, 8);
  put(0, 10);
  return bits;
}

/// 36.212 5.1.1 and 5.3.1.1: the remainder of the polynomial division, masked.
inline std::vector<int> naive_attach_crc(const std::vector<int>& payload, int n_ports) {
  std::vector<int> dividend = payload;
  dividend.resize(payload.size() + 16);
  const std::vector<std::size_t> generator{0, 4, 11, 16};  // D^16 + D^12 + D^5 + 1, counted from the highest power
  for (std::size_t i = 0; i < payload.size(); ++i) {
    if (dividend[i] == 0) continue;
    for (const std::size_t term : generator) dividend[i + term] ^= 1;
  }
  std::vector<int> out = payload;
  for (std::size_t i = 0; i < 16; ++i) {
    const int mask = n_ports == 1 ? 0 : (n_ports == 2 ? 1 : static_cast<int>(i % 2));
    out.push_back(dividend[payload.size() + i] ^ mask);
  }
  return out;
}

/// 36.212 5.1.3.1: a shift register that starts with the last six bits.
inline std::vector<std::vector<int>> naive_convolve(const std::vector<int>& bits) {
  const int generators[3][7] = {{1, 0, 1, 1, 0, 1, 1}, {1, 1, 1, 1, 0, 0, 1}, {1, 1, 1, 0, 1, 0, 1}};
  std::vector<int> shift(7);
  for (std::size_t i = 0; i < 6; ++i) shift[i] = bits[bits.size() - 1 - i];
  std::vector<std::vector<int>> streams(3);
  for (const int bit : bits) {
    for (std::size_t i = 6; i > 0; --i) shift[i] = shift[i - 1];
    shift[0] = bit;
    for (std::size_t s = 0; s < 3; ++s) {
      int sum = 0;
      for (std::size_t i = 0; i < 7; ++i) sum += generators[s][i] * shift[i];
      streams[s].push_back(sum % 2);
    }
  }
  return streams;
}

/// 36.212 5.1.4.2: interleaver matrix with its dummies, then the circular buffer read `length` times past them.
inline std::vector<int> naive_rate_match(const std::vector<std::vector<int>>& streams, std::size_t length) {
  const std::size_t columns[32] = {1, 17, 9, 25, 5, 21, 13, 29, 3, 19, 11, 27, 7, 23, 15, 31,
                                   0, 16, 8, 24, 4, 20, 12, 28, 2, 18, 10, 26, 6, 22, 14, 30};
  constexpr int kDummy = -1;
  std::vector<int> buffer;
  for (const auto& stream : streams) {
    const std::size_t rows = (stream.size() + 31) / 32;
    std::vector<int> matrix(rows * 32 - stream.size(), kDummy);
    matrix.insert(matrix.end(), stream.begin(), stream.end());
    for (const std::size_t column : columns) {
      for (std::size_t row = 0; row < rows; ++row) buffer.push_back(matrix[row * 32 + column]);
    }
  }
  std::vector<int> out;
  for (std::size_t k = 0; out.size() < length; ++k) {
    const int bit = buffer[k % buffer.size()];
    if (bit != kDummy) out.push_back(bit);
  }
  return out;
}

/// All of it: 1920 or 1728 scrambled bits of 40 ms.
inline std::vector<int> naive_pbch_bits(const std::vector<int>& payload, int cell_id, int n_ports, bool normal_prefix) {
  auto bits = naive_rate_match(naive_convolve(naive_attach_crc(payload, n_ports)), normal_prefix ? 1920 : 1728);
  const auto c = naive_gold(static_cast<std::uint32_t>(cell_id), bits.size());
  for (std::size_t i = 0; i < bits.size(); ++i) bits[i] ^= c[i];
  return bits;
}

/// (symbol of slot 1, subcarrier of the central 72) in mapping order, 36.211 6.6.4.
inline std::vector<std::pair<int, int>> naive_pbch_places(int cell_id, bool normal_prefix) {
  std::vector<std::pair<int, int>> places;
  for (int l = 0; l < 4; ++l) {
    for (int k = 0; k < 72; ++k) {
      bool reference = false;
      for (int port = 0; port < 4; ++port) {
        int v = -1;
        if (port == 0 && l == 0) v = 0;
        if (port == 0 && l == (normal_prefix ? 4 : 3)) v = 3;
        if (port == 1 && l == 0) v = 3;
        if (port == 1 && l == (normal_prefix ? 4 : 3)) v = 0;
        if (port == 2 && l == 1) v = 3;  // slot 1 is odd
        if (port == 3 && l == 1) v = 3 + 3;
        if (v >= 0 && k % 6 == (v + cell_id % 6) % 6) reference = true;
      }
      if (!reference) places.emplace_back(l, k);
    }
  }
  return places;
}

}  // namespace soopnav::lte::test
