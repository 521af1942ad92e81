#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/clock/deviation.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::clock {
namespace {

constexpr double kEulerGamma = 0.57721566490153286;
constexpr std::size_t kLargestFactor = 64;

bool third_differences(DeviationKind kind) {
  return kind == DeviationKind::kHadamard || kind == DeviationKind::kOverlappingHadamard;
}

bool averaged(DeviationKind kind) { return kind == DeviationKind::kModifiedAllan || kind == DeviationKind::kTime; }

bool overlapping(DeviationKind kind) { return kind != DeviationKind::kAllan && kind != DeviationKind::kHadamard; }

// Generalised autocovariance of phase at a lag in samples, up to a factor and to even polynomials that differences do
// not see (doc/clocks.md eq. 10).
double generalised_covariance(PowerLaw noise, double lag) {
  const double t = std::abs(lag);
  switch (noise) {
    case PowerLaw::kWhitePhase:
      return t < 0.5 ? 1.0 : 0.0;
    case PowerLaw::kFlickerPhase:
      return t < 0.5 ? 0.0 : -std::log(kPi * t) - kEulerGamma;
    case PowerLaw::kWhiteFrequency:
      return -t;
    case PowerLaw::kFlickerFrequency:
      return t < 0.5 ? 0.0 : t * t * std::log(t);
    case PowerLaw::kRandomWalkFrequency:
      return t * t * t;
  }
  return 0.0;
}

// Autocovariance of second or third differences of span `factor` at lag 0, 1, ... (in samples).
std::vector<double> difference_covariance(PowerLaw noise, bool third, std::size_t factor, std::size_t lags) {
  // The differences' coefficients against themselves: (1, -4, 6, -4, 1) or (-1, 6, -15, 20, -15, 6, -1), from the
  // middle.
  constexpr std::array<double, 4> kSecond{6.0, -4.0, 1.0, 0.0};
  constexpr std::array<double, 4> kThird{20.0, -15.0, 6.0, -1.0};
  const auto& c = third ? kThird : kSecond;
  const auto m = static_cast<double>(factor);
  std::vector<double> out(lags);
  for (std::size_t k = 0; k < lags; ++k) {
    const auto lag = static_cast<double>(k);
    double sum = c[0] * generalised_covariance(noise, lag);
    for (std::size_t j = 1; j < c.size(); ++j) {
      if (c[j] == 0.0) continue;
      const double apart = static_cast<double>(j) * m;
      sum += c[j] * (generalised_covariance(noise, lag + apart) + generalised_covariance(noise, lag - apart));
    }
    out[k] = sum;
  }
  return out;
}

// The same of the sums of `factor` neighbouring differences.
std::vector<double> windowed(const std::vector<double>& R, std::size_t factor, std::size_t lags) {
  const auto m = static_cast<std::ptrdiff_t>(factor);
  std::vector<double> out(lags);
  for (std::size_t k = 0; k < lags; ++k) {
    double sum = 0.0;
    for (std::ptrdiff_t l = 1 - m; l < m; ++l) {
      const auto at = static_cast<std::size_t>(std::abs(static_cast<std::ptrdiff_t>(k) + l));
      sum += static_cast<double>(m - std::abs(l)) * R[at];
    }
    out[k] = sum;
  }
  return out;
}

}  // namespace

double equivalent_dof(DeviationKind kind, PowerLaw noise, std::size_t factor, std::size_t count) {
  if (factor < 1) throw std::invalid_argument("factor = 0: at least 1 expected");
  if (count < 1) throw std::invalid_argument("count = 0: at least 1 expected");
  const bool third = third_differences(kind);
  std::vector<double> R;
  auto terms = static_cast<double>(count);
  if (!overlapping(kind)) {
    // Terms stand a span apart; power laws look alike at every span, but for the corner of flicker phase noise.
    const std::size_t span = noise == PowerLaw::kFlickerPhase ? factor : 1;
    const auto fine = difference_covariance(noise, third, span, 8 * span + 1);
    for (std::size_t k = 0; k < fine.size(); k += span) R.push_back(fine[k]);
  } else if (noise == PowerLaw::kWhitePhase && !averaged(kind)) {
    // Correlated at whole spans only, so the span does not scale.
    const auto few = difference_covariance(noise, third, 1, 4);
    double sum = few[0] * few[0];
    for (std::size_t j = 1; j < few.size(); ++j) {
      sum += 2.0 * std::max(0.0, 1.0 - static_cast<double>(j * factor) / terms) * few[j] * few[j];
    }
    return terms * few[0] * few[0] / sum;
  } else {
    const std::size_t m = std::min(factor, kLargestFactor);
    terms = std::max(1.0, terms * static_cast<double>(m) / static_cast<double>(factor));
    const std::size_t lags = 6 * m + 1;
    R = averaged(kind) ? windowed(difference_covariance(noise, third, m, lags + m), m, lags)
                       : difference_covariance(noise, third, m, lags);
  }
  double sum = R[0] * R[0];
  for (std::size_t k = 1; k < R.size() && static_cast<double>(k) < terms; ++k) {
    sum += 2.0 * (1.0 - static_cast<double>(k) / terms) * R[k] * R[k];
  }
  return std::max(1.0, terms * R[0] * R[0] / sum);
}

std::optional<PowerLaw> identify_noise(std::span<const double> phase_s, std::size_t factor, DeviationKind kind) {
  constexpr std::size_t kFewest = 30;
  constexpr std::size_t kMost = 32768;  // more would not change the answer
  if (factor < 1 || phase_s.empty()) return std::nullopt;
  std::vector<double> z;
  z.reserve(std::min(kMost, phase_s.size() / factor + 1));
  for (std::size_t i = 0; i < phase_s.size() && z.size() < kMost; i += factor) z.push_back(phase_s[i]);
  const int most = third_differences(kind) ? 3 : 2;
  for (int differences = 0;; ++differences) {
    std::size_t n = 0;
    double mean = 0.0;
    for (const double value : z) {
      if (std::isfinite(value)) mean += value, ++n;
    }
    if (n < kFewest) return std::nullopt;
    mean /= static_cast<double>(n);
    double square = 0.0;
    double product = 0.0;
    double before = std::numeric_limits<double>::quiet_NaN();
    for (const double value : z) {
      const double off = value - mean;
      if (std::isfinite(off)) square += off * off;
      if (std::isfinite(off * before)) product += off * before;
      before = off;
    }
    if (!(square > 0.0)) return std::nullopt;
    const double r = product / square;
    const double fraction = r / (1.0 + r);
    if (fraction < 0.25 || differences >= most) {
      const double alpha = std::round(2.0 - 2.0 * (fraction + differences));
      return static_cast<PowerLaw>(static_cast<int>(std::clamp(alpha, -2.0, 2.0)));
    }
    for (std::size_t i = 0; i + 1 < z.size(); ++i) z[i] = z[i + 1] - z[i];
    z.pop_back();
  }
}

}  // namespace soopnav::clock
