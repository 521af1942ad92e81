#include "waveform/iridium/gamma_tail.hpp"

#include <cmath>

namespace soopnav::iridium {
namespace {

// ln Q(a, x) for x > a: modified Lentz evaluation of the continued fraction.
double log_upper_tail(double a, double x) noexcept {
  constexpr double kTiny = 1e-300;
  double b = x + 1.0 - a, c = 1.0 / kTiny, d = 1.0 / b, h = d;
  for (int i = 1; i < 10'000; ++i) {
    const double an = -i * (i - a);
    b += 2.0;
    d = an * d + b;
    if (std::abs(d) < kTiny) d = kTiny;
    c = b + an / c;
    if (std::abs(c) < kTiny) c = kTiny;
    d = 1.0 / d;
    const double change = d * c;
    h *= change;
    if (std::abs(change - 1.0) < 1e-14) break;
  }
  return -x + a * std::log(x) - std::lgamma(a) + std::log(h);
}

}  // namespace

double gamma_tail_quantile(double shape, double probability) noexcept {
  const double target = std::log(probability);
  double low = shape + 1.0, high = 2.0 * shape + 10.0;
  while (log_upper_tail(shape, high) > target) high *= 2.0;
  for (int i = 0; i < 100 && high - low > 1e-10 * high; ++i) {
    const double middle = 0.5 * (low + high);
    (log_upper_tail(shape, middle) > target ? low : high) = middle;
  }
  return 0.5 * (low + high) / shape;
}

}  // namespace soopnav::iridium
