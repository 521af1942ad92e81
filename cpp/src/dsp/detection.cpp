#include "soopnav/dsp/detection.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "soopnav/core/constants.hpp"

namespace soopnav::dsp {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr int kMaxSums = 1'000'000;
constexpr double kMaxArgument = 1e5;

// ln n! - (n + 1/2) ln n + n - ln(2 pi) / 2, for n > 15.
double stirling_error(double n) noexcept {
  const double q = 1.0 / (n * n);
  return (1.0 / 12.0 - (1.0 / 360.0 - (1.0 / 1260.0 - (1.0 / 1680.0 - q / 1188.0) * q) * q) * q) / n;
}

// n ln(n / x) + x - n, without the cancellation of n near x.
double deviance(double n, double x) noexcept {
  const double difference = n - x;
  if (std::abs(difference) < 0.1 * (n + x)) {
    const double v = difference / (n + x);
    double sum = difference * v;
    double power = 2.0 * n * v;
    for (int j = 1; j < 1000; ++j) {
      power *= v * v;
      const double next = sum + power / (2 * j + 1);
      if (next == sum) break;
      sum = next;
    }
    return sum;
  }
  return n * std::log(n / x) + x - n;
}

// Probability of n under a Poisson law of mean x > 0, by its saddle point: right to 1e-13 (Loader 2000).
double poisson(double n, double x) noexcept {
  if (n <= 15.0) {
    double log_factorial = 0.0;
    for (double k = 2.0; k <= n; k += 1.0) log_factorial += std::log(k);
    return std::exp(n * std::log(x) - x - log_factorial);
  }
  return std::exp(-stirling_error(n) - deviance(n, x)) / std::sqrt(kTwoPi * n);
}

// P(G > x) for G of the gamma law of whole shape n: the sum of Poisson probabilities below n, largest first.
double upper_tail(double n, double x) noexcept {
  if (x <= 0.0) return 1.0;
  // The largest term is at the last one, or at x.
  const double peak = std::min(n - 1.0, std::floor(x));
  double sum = 0.0;
  double term = poisson(peak, x);
  const double first = term;
  for (double k = peak; k >= 0.0 && term > 1e-18 * sum; k -= 1.0) {
    sum += term;
    term *= k / x;
  }
  term = first;
  for (double k = peak + 1.0; k < n; k += 1.0) {
    term *= x / k;
    sum += term;
    if (term < 1e-18 * sum) break;
  }
  return std::min(sum, 1.0);
}

// P(G <= x): the Poisson probabilities from n on, largest first.
double lower_tail(double n, double x) noexcept {
  if (x <= 0.0) return 0.0;
  const double peak = std::max(n, std::floor(x));
  const double first = poisson(peak, x);
  double sum = 0.0;
  double term = first;
  for (double k = peak + 1.0; term > 1e-18 * sum; k += 1.0) {
    sum += term;
    term *= x / k;
  }
  term = first;
  for (double k = peak; k > n; k -= 1.0) {
    term *= k / x;
    sum += term;
    if (term < 1e-18 * sum) break;
  }
  return std::min(sum, 1.0);
}

// Where the summands w_k pois(M + k; x) are largest: k (k + M) = x y (doc/gps_acquisition.md eq. 9).
double peak_of(double m, double x, double y) noexcept { return 2.0 * x * y / (m + std::sqrt(m * m + 4.0 * x * y)); }

// sum_k pois(k; y) P(G_{M+k} > x): upwards, where each tail is the one before it plus a positive term.
double mixed_upper(double m, double x, double y) noexcept {
  const double peak = peak_of(m, x, y);
  const double low = std::max(0.0, std::floor(peak - 7.0 * std::sqrt(peak) - 5.0));
  double weight = poisson(low, y);
  double tail = upper_tail(m + low, x);
  double step = poisson(m + low, x);
  double sum = 0.0;
  for (double k = low;; k += 1.0) {
    const double term = weight * tail;
    sum += term;
    if (k > peak && term <= 1e-17 * sum) break;
    weight *= y / (k + 1.0);
    tail += step;
    step *= x / (m + k + 1.0);
  }
  return std::min(sum, 1.0);
}

// sum_k pois(k; y) P(G_{M+k} <= x): downwards, for the same reason.
double mixed_lower(double m, double x, double y) noexcept {
  const double peak = peak_of(m, x, y);
  double high = std::ceil(peak + 8.0 * std::sqrt(peak) + 40.0);
  double weight = poisson(high, y);
  double tail = lower_tail(m + high, x);
  while ((weight < 1e-290 || tail < 1e-290) && high > peak + 1.0) {  // what is lost here is lost for all below it
    high = std::floor(peak + 0.9 * (high - peak));
    weight = poisson(high, y);
    tail = lower_tail(m + high, x);
  }
  double step = poisson(m + high - 1.0, x);
  double sum = 0.0;
  for (double k = high; k >= 0.0; k -= 1.0) {
    const double term = weight * tail;
    sum += term;
    if (k < peak && term <= 1e-17 * sum) break;
    weight *= k / y;
    tail += step;
    step *= (m + k - 1.0) / x;
  }
  return std::min(sum, 1.0);
}

bool valid(int m, double a, double b) noexcept {
  return m >= 1 && m <= kMaxSums && a >= 0.0 && a <= kMaxArgument && b >= 0.0 && (b <= kMaxArgument || std::isinf(b));
}

// The probability above (or not above) b.
double side(int m, double a, double b, bool above) noexcept {
  if (!valid(m, a, b)) return kNan;
  if (b == 0.0) return above ? 1.0 : 0.0;
  if (std::isinf(b)) return above ? 0.0 : 1.0;
  const double x = 0.5 * b * b;
  const double y = 0.5 * a * a;
  const double n = m;
  const bool small_above = x > n + y;
  double small = 0.0;
  if (y < 1e-300) {
    small = small_above ? upper_tail(n, x) : lower_tail(n, x);
  } else {
    small = small_above ? mixed_upper(n, x, y) : mixed_lower(n, x, y);
  }
  return small_above == above ? small : 1.0 - small;
}

}  // namespace

double marcum_q(int m, double a, double b) noexcept { return side(m, a, b, true); }

double marcum_q_complement(int m, double a, double b) noexcept { return side(m, a, b, false); }

double false_alarm_probability(int sums, double threshold) noexcept {
  if (!(sums >= 1 && sums <= kMaxSums && threshold >= 0.0)) return kNan;
  return std::isinf(threshold) ? 0.0 : upper_tail(sums, threshold);
}

double detection_threshold(int sums, double probability) noexcept {
  if (!(sums >= 1 && sums <= kMaxSums && probability > 0.0 && probability <= 1.0)) return kNan;
  if (sums == 1) return -std::log(probability);
  // Newton's method on the logarithm of the tail, which is concave: from the right of the root no step overshoots, and
  // the bracket holds every other one.
  double low = 0.0;
  double high = sums;
  while (upper_tail(sums, high) > probability) high *= 2.0;
  double t = high;
  for (int i = 0; i < 200; ++i) {
    const double tail = upper_tail(sums, t);
    (tail > probability ? low : high) = t;
    const double slope = poisson(sums - 1.0, t) / tail;
    double next = t + std::log(tail / probability) / slope;
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (std::abs(next - t) <= 1e-15 * t) return next;
    t = next;
  }
  return t;
}

double detection_probability(int sums, double snr, double threshold) noexcept {
  if (!(snr >= 0.0 && threshold >= 0.0)) return kNan;
  return marcum_q(sums, std::sqrt(2.0 * snr), std::sqrt(2.0 * threshold));
}

double cell_false_alarm(double total, double cells) noexcept {
  if (!(total > 0.0 && total < 1.0 && cells >= 1.0)) return kNan;
  return -std::expm1(std::log1p(-total) / cells);
}

}  // namespace soopnav::dsp
