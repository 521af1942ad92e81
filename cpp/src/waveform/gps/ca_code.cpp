#include "soopnav/waveform/gps/ca_code.hpp"

#include <stdexcept>
#include <string>
#include <utility>

namespace soopnav::gps {
namespace {

// IS-GPS-200N table 3-Ia: the stages of G2 that make each satellite's code.
constexpr std::array<std::pair<int, int>, kMaxPrn> kTaps{
    {{2, 6}, {3, 7},  {4, 8},  {5, 9}, {1, 9}, {2, 10}, {1, 8},  {2, 9},  {3, 10}, {2, 3}, {3, 4}, {5, 6}, {6, 7},
     {7, 8}, {8, 9},  {9, 10}, {1, 4}, {2, 5}, {3, 6},  {4, 7},  {5, 8},  {6, 9},  {1, 3}, {4, 6}, {5, 7}, {6, 8},
     {7, 9}, {8, 10}, {1, 6},  {2, 7}, {3, 8}, {4, 9},  {5, 10}, {4, 10}, {1, 7},  {2, 8}, {4, 10}}};

// Stage i of a shift register is bit i - 1.
constexpr unsigned stage(unsigned word, int i) { return (word >> (i - 1)) & 1U; }

}  // namespace

CaCode ca_code(int prn) {
  if (prn < 1 || prn > kMaxPrn) {
    throw std::invalid_argument("prn = " + std::to_string(prn) + " must be in [1, " + std::to_string(kMaxPrn) + "]");
  }
  const auto [first, second] = kTaps[static_cast<std::size_t>(prn - 1)];
  CaCode code{};
  unsigned g1 = 0x3FF;
  unsigned g2 = 0x3FF;
  for (auto& chip : code) {
    const unsigned bit = stage(g1, 10) ^ stage(g2, first) ^ stage(g2, second);
    chip = bit != 0 ? -1 : 1;
    const unsigned next1 = stage(g1, 3) ^ stage(g1, 10);
    const unsigned next2 = stage(g2, 2) ^ stage(g2, 3) ^ stage(g2, 6) ^ stage(g2, 8) ^ stage(g2, 9) ^ stage(g2, 10);
    g1 = ((g1 << 1U) | next1) & 0x3FFU;
    g2 = ((g2 << 1U) | next2) & 0x3FFU;
  }
  return code;
}

}  // namespace soopnav::gps
