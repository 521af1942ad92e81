#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "soopnav/core/iq.hpp"

namespace soopnav::tracking {

inline constexpr std::size_t kRun = 512;  ///< samples of a run, at most

/// Sums of a run: samples times the conjugate of carrier and code, early, prompt and late; and |sample|².
struct Sums {
  std::complex<double> early{}, prompt{}, late{};
  double power = 0.0;

  Sums& operator+=(const Sums& other) noexcept {
    early += other.early;
    prompt += other.prompt;
    late += other.late;
    power += other.power;
    return *this;
  }
};

/// Chips laid out for runs: a period and as much again as a run can need.
class CodeTable {
 public:
  CodeTable(const std::vector<Cf32>& chips, double most_chips_per_sample);
  [[nodiscard]] bool is_real() const noexcept { return real_; }
  [[nodiscard]] double length() const noexcept { return length_; }
  [[nodiscard]] const Cf32* chips() const noexcept { return chips_.data(); }
  [[nodiscard]] const float* real() const noexcept { return real_chips_.data(); }

 private:
  std::vector<Cf32> chips_;
  std::vector<float> real_chips_;
  double length_;
  bool real_;
};

/// Sums of `n` <= kRun samples. `phase` [cycles] of the carrier at the first, `step` cycles a sample; `chip` of the
/// prompt code at the first (any number), `rate` chips a sample, `half` chips from early to prompt. The additions'
/// order is fixed, the same with any vector width. `bad` grows by samples that are not finite or beyond 1e15, which
/// count as zeros. No allocation.
[[nodiscard]] Sums correlate(const Cf32* x, std::size_t n, const CodeTable& code, double phase, double step,
                             double chip, double rate, double half, std::uint32_t& bad) noexcept;

}  // namespace soopnav::tracking
