#include "waveform/lte/viterbi.hpp"

#include <algorithm>
#include <bit>

#include "waveform/lte/pbch_code.hpp"

namespace soopnav::lte::detail {
namespace {

constexpr std::size_t kStates = 64;
constexpr std::size_t kHalf = kStates / 2;

// State: the six newest bits, the newest highest. States 2 j and 2 j + 1 both lead to j (input 0) and j + 32 (input 1).
// All three generators tap both ends of the register, so the other three branches of a butterfly carry the first one's
// output or its complement: signs of the branch from 2 j with input 0 are enough.
using Signs = std::array<std::array<float, kHalf>, 3>;

constexpr Signs make_signs() noexcept {
  Signs signs{};
  for (std::size_t s = 0; s < 3; ++s) {
    for (unsigned j = 0; j < kHalf; ++j) signs[s][j] = std::popcount((2U * j) & kGenerators[s]) % 2 == 0 ? 1.0F : -1.0F;
  }
  return signs;
}

constexpr Signs kSigns = make_signs();

}  // namespace

void TailBitingViterbi::pass(std::span<const float, 120> soft) noexcept {
  for (std::size_t time = 0; time < kProtectedBits; ++time) {
    const float a = soft[3 * time], b = soft[3 * time + 1], c = soft[3 * time + 2];
    alignas(64) std::array<float, kStates> next;
    auto& lead = lead_[time];
    for (std::size_t j = 0; j < kHalf; ++j) {
      const float branch = kSigns[0][j] * a + kSigns[1][j] * b + kSigns[2][j] * c;
      const float even = metric_[2 * j], odd = metric_[2 * j + 1];
      const float even_0 = even + branch, odd_0 = odd - branch;
      const float even_1 = even - branch, odd_1 = odd + branch;
      next[j] = even_0 > odd_0 ? even_0 : odd_0;
      next[j + kHalf] = even_1 > odd_1 ? even_1 : odd_1;
      lead[j] = even_0 - odd_0;
      lead[j + kHalf] = even_1 - odd_1;
    }
    metric_ = next;
  }
}

float TailBitingViterbi::start(std::span<const float, 120> soft) noexcept {
  metric_.fill(0.0F);
  pass(soft);
  return *std::max_element(metric_.begin(), metric_.end());
}

ViterbiResult TailBitingViterbi::finish(std::span<const float, 120> soft) noexcept {
  constexpr int kPasses = 4;
  ViterbiResult result;
  for (int i = 0; i < kPasses && !result.tail_biting; ++i) {
    if (i > 0) pass(soft);
    const auto best = static_cast<std::size_t>(std::max_element(metric_.begin(), metric_.end()) - metric_.begin());
    std::size_t state = best;
    result.bits = 0;
    for (std::size_t time = kProtectedBits; time-- > 0;) {
      result.bits |= static_cast<std::uint64_t>(state / kHalf) << time;
      state = 2 * (state % kHalf) + (lead_[time][state] >= 0.0F ? 0U : 1U);
    }
    result.tail_biting = state == best;
  }
  return result;
}

}  // namespace soopnav::lte::detail
