#include "soopnav/estimation/chi_square.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace soopnav {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr double kEpsilon = std::numeric_limits<double>::epsilon();

struct GammaTails {
  double lower = kNan;  // P(a, x)
  double upper = kNan;  // Q(a, x)
};

// log(1 + u) - u without cancellation for small u.
double log1p_minus(double u) {
  if (std::abs(u) > 0.3) return std::log1p(u) - u;
  double power = -u * u;  // (-1)^(k+1) u^k, k = 2
  double sum = 0.0;
  for (int k = 2; k < 200; ++k) {
    const double term = power / k;
    sum += term;
    if (std::abs(term) <= kEpsilon * std::abs(sum)) break;
    power *= -u;
  }
  return sum;
}

// The part of log Gamma(a) beyond (a - 1/2) log a - a + log(2 pi) / 2, a >= 20 (NIST Digital Library 5.11.1).
double stirling_correction(double a) {
  const double a2 = a * a;
  return (1.0 / 12.0 - (1.0 / 360.0 - (1.0 / 1260.0 - (1.0 / 1680.0 - 1.0 / (1188.0 * a2)) / a2) / a2) / a2) / a;
}

// log Gamma(a), a > 0, by the recurrence to where Stirling's series holds; std::lgamma writes a global sign.
double log_gamma(double a) {
  double product = 1.0;
  while (a < 20.0) product *= a++;
  return (a - 0.5) * std::log(a) - a + 0.5 * std::log(2.0 * std::numbers::pi) + stirling_correction(a) -
         std::log(product);
}

// log of x^a exp(-x) / Gamma(a + 1). For large a the three terms nearly cancel, so Stirling's series is used, whose
// leading terms cancel by hand.
double log_gamma_factor(double a, double x) {
  if (a < 20.0) return a * std::log(x) - x - log_gamma(a + 1.0);
  const double u = (x - a) / a;
  return a * log1p_minus(u) - 0.5 * std::log(2.0 * std::numbers::pi * a) - stirling_correction(a);
}

GammaTails gamma_tails(double a, double x) {
  if (!(a > 0.0) || !(x >= 0.0) || std::isinf(a)) return {};
  if (x == 0.0) return {0.0, 1.0};
  if (std::isinf(x)) return {1.0, 0.0};
  const double factor = std::exp(log_gamma_factor(a, x));
  const int limit = 200 + static_cast<int>(std::min(20.0 * std::sqrt(a) + a, 1e7));
  if (x < a + 1.0) {
    // P = factor * sum_k x^k / ((a + 1) ... (a + k))
    double term = 1.0;
    double sum = 1.0;
    for (int k = 1; k < limit && term > kEpsilon * 0.25 * sum; ++k) {
      term *= x / (a + k);
      sum += term;
    }
    const double p = std::min(factor * sum, 1.0);
    return {p, 1.0 - p};
  }
  // Q = factor * a * 1 / (x + 1 - a - 1 (1 - a) / (x + 3 - a - ...)), evaluated from the front (modified Lentz).
  constexpr double kTiny = 1e-300;
  double b = x + 1.0 - a;
  double c = 1.0 / kTiny;
  double d = 1.0 / b;
  double fraction = d;
  for (int k = 1; k < limit; ++k) {
    const double numerator = -k * (k - a);
    b += 2.0;
    d = numerator * d + b;
    if (std::abs(d) < kTiny) d = kTiny;
    c = b + numerator / c;
    if (std::abs(c) < kTiny) c = kTiny;
    d = 1.0 / d;
    const double step = c * d;
    fraction *= step;
    if (std::abs(step - 1.0) < kEpsilon) break;
  }
  const double q = std::min(factor * a * fraction, 1.0);
  return {1.0 - q, q};
}

// Quantile of the standard normal distribution to four digits (Hastings, Abramowitz and Stegun 26.2.23): a start only.
double rough_normal_upper(double q) {
  const double tail = std::min(q, 1.0 - q);
  const double t = std::sqrt(-2.0 * std::log(std::max(tail, 1e-300)));
  const double z =
      t - (2.515517 + t * (0.802853 + t * 0.010328)) / (1.0 + t * (1.432788 + t * (0.189269 + t * 0.001308)));
  return q < 0.5 ? z : -z;
}

// x with P(dof/2, x/2) = lower, Q = upper; lower + upper = 1, the smaller one exact.
double quantile(double lower, double upper, double dof) {
  if (!(dof > 0.0) || std::isinf(dof) || !(lower >= 0.0) || !(upper >= 0.0)) return kNan;
  if (lower == 0.0) return 0.0;
  if (upper == 0.0) return kInf;
  const double a = 0.5 * dof;
  const bool small_lower = lower < upper;
  // Wilson and Hilferty's cube, or the first term of the series where the cube turns negative.
  const double h = 2.0 / (9.0 * dof);
  const double cube = 1.0 - h + rough_normal_upper(small_lower ? 1.0 - lower : upper) * std::sqrt(h);
  double x = 0.5 * dof * cube * cube * cube;
  if (!(cube > 0.0) || (small_lower && x < 0.3 * a)) x = std::exp((std::log(lower) + log_gamma(a + 1.0)) / a);
  if (x < 1e-200) return 2.0 * x;  // the series is its first term, and its powers underflow
  double low = 0.0;
  double high = kInf;
  // Newton's method on the logarithm of the smaller tail, which is concave in log x (lower) or in x (upper), kept in a
  // bracket that each step tightens.
  for (int i = 0; i < 200; ++i) {
    const GammaTails tails = gamma_tails(a, x);
    const bool below = small_lower ? tails.lower < lower : tails.upper > upper;
    (below ? low : high) = x;
    const double density = std::exp(log_gamma_factor(a, x)) * a / x;
    double next = 0.0;
    if (small_lower) {
      next = x * std::exp(tails.lower / (density * x) * std::log(lower / tails.lower));
    } else {
      next = x + tails.upper / density * std::log(tails.upper / upper);
    }
    // Convergence is quadratic: a step this short lands within rounding.
    if (std::abs(next - x) <= 1e-9 * x) return 2.0 * next;
    if (!(next > low) || !(next < high)) next = std::isinf(high) ? 2.0 * x + 1.0 : 0.5 * (low + high);
    x = next;
  }
  return 2.0 * x;
}

}  // namespace

double regularized_gamma_p(double a, double x) noexcept { return gamma_tails(a, x).lower; }

double regularized_gamma_q(double a, double x) noexcept { return gamma_tails(a, x).upper; }

double chi_square_cdf(double x, double dof) noexcept { return gamma_tails(0.5 * dof, 0.5 * x).lower; }

double chi_square_quantile(double probability, double dof) noexcept {
  return quantile(probability, 1.0 - probability, dof);
}

double chi_square_upper_quantile(double probability, double dof) noexcept {
  return quantile(1.0 - probability, probability, dof);
}

double normal_two_sided_gate(double probability) noexcept {
  if (!(probability > 0.0)) return kNan;
  return std::sqrt(chi_square_upper_quantile(probability, 1.0));
}

}  // namespace soopnav
