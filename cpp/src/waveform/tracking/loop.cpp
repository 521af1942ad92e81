#include "soopnav/waveform/tracking/loop.hpp"

#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "soopnav/core/constants.hpp"

namespace soopnav::tracking {
namespace {

using Vector3 = std::array<double, 3>;
using Matrix3 = std::array<Vector3, 3>;

void require_loop(bool holds, const char* name, double value, const char* rule) {
  if (!holds) throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " " + rule);
}

Matrix3 times(const Matrix3& a, const Matrix3& b) noexcept {
  Matrix3 out{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      for (std::size_t k = 0; k < 3; ++k) out[i][j] += a[i][k] * b[k][j];
    }
  }
  return out;
}

// P of P = A P A' + W, by doubling.
Matrix3 lyapunov(Matrix3 a, Matrix3 w) noexcept {
  for (int step = 0; step < 60; ++step) {
    Matrix3 transposed{};
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) transposed[i][j] = a[j][i];
    }
    const Matrix3 more = times(times(a, w), transposed);
    double change = 0.0, size = 0.0;
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) w[i][j] += more[i][j];
      change += std::abs(more[i][i]);
      size += std::abs(w[i][i]);
    }
    if (change <= 1e-15 * size) break;
    a = times(a, a);
  }
  return w;
}

// Errors of phase, rate, rate of rate with time in intervals: A = F - K h (eq. 9).
Matrix3 closed(int order, const Vector3& gain) noexcept {
  Matrix3 a{};
  const Vector3 mean{1.0, 0.5, 1.0 / 6.0};
  const Matrix3 f{{{1.0, 1.0, 0.5}, {0.0, 1.0, 1.0}, {0.0, 0.0, 1.0}}};
  const auto states = static_cast<std::size_t>(order);
  for (std::size_t i = 0; i < states; ++i) {
    for (std::size_t j = 0; j < states; ++j) a[i][j] = f[i][j] - gain[i] * mean[j];
  }
  return a;
}

// Variance of the phase per variance of a mean.
Matrix3 noise_gain(int order, const Vector3& gain) noexcept {
  Matrix3 w{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) w[i][j] = gain[i] * gain[j];
  }
  return lyapunov(closed(order, gain), w);
}

// Gains for poles exp(x s), x = natural frequency times T (eq. 10).
Vector3 place(int order, double x) noexcept {
  if (order == 1) return {-std::expm1(-x), 0.0, 0.0};
  // A pair at x (-cosine +- j sine): v² + c v + d with v = z - 1.
  const double damping = order == 2 ? std::sqrt(0.5) : 0.5;
  const double radius = std::exp(-damping * x);
  const double real = radius * std::cos(std::sqrt(1.0 - damping * damping) * x);
  const double c = 2.0 - 2.0 * real, d = 1.0 - 2.0 * real + radius * radius;
  if (order == 2) return {c - 0.5 * d, d, 0.0};
  const double r = -std::expm1(-x);  // (v + r)
  const double c0 = r * d, c1 = d + r * c, c2 = c + r;
  const double second = c1 - c0;
  return {c2 - 0.5 * second - c0 / 6.0, second, c0};
}

}  // namespace

Loop design_loop(int order, double bandwidth_hz, double interval_s) {
  require_loop(order >= 1 && order <= 3, "order", order, "must be 1, 2 or 3");
  require_loop(bandwidth_hz > 0.0 && std::isfinite(bandwidth_hz), "bandwidth_hz", bandwidth_hz,
               "must be positive and finite");
  require_loop(interval_s > 0.0 && std::isfinite(interval_s), "interval_s", interval_s, "must be positive and finite");
  constexpr std::array<double, 3> kMost{0.4, 0.9, 1.6};
  const double product = bandwidth_hz * interval_s;
  require_loop(product <= kMost[static_cast<std::size_t>(order - 1)] && product >= 1e-9, "bandwidth_hz * interval_s",
               product, "must be at least 1e-9 and at most 0.4, 0.9, 1.6 for orders 1, 2, 3");
  Loop loop{order, interval_s, bandwidth_hz, {}};
  double low = 1e-10, high = 40.0;
  for (int i = 0; i < 100; ++i) {
    const double middle = std::sqrt(low * high);
    (0.5 * noise_gain(order, place(order, middle))[0][0] < product ? low : high) = middle;
  }
  loop.gain = place(order, std::sqrt(low * high));
  return loop;
}

PhaseNoise PhaseNoise::from_allan(double h0, double h_minus_2, double carrier_hz) {
  require_loop(h0 >= 0.0 && std::isfinite(h0), "h0", h0, "must be finite and not negative");
  require_loop(h_minus_2 >= 0.0 && std::isfinite(h_minus_2), "h_minus_2", h_minus_2, "must be finite and not negative");
  require_loop(carrier_hz > 0.0 && std::isfinite(carrier_hz), "carrier_hz", carrier_hz, "must be positive and finite");
  const double square = carrier_hz * carrier_hz;
  return {0.5 * square * h0, 2.0 * kPi * kPi * square * h_minus_2};
}

LoopVariance noise_variance(const Loop& loop, double mean_variance) noexcept {
  const Matrix3 p = noise_gain(loop.order, loop.gain);
  return {p[0][0] * mean_variance, p[1][1] * mean_variance / (loop.interval_s * loop.interval_s)};
}

LoopVariance oscillator_variance(const Loop& loop, const PhaseNoise& noise) noexcept {
  const double t = loop.interval_s;
  const double q = noise.white_frequency_cycles2ps * t;
  const double g = noise.frequency_walk_cycles2ps3 * t * t * t;
  if (loop.order == 1 && g > 0.0) {
    return {std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
  }
  // Of phase, rate and mean over an interval, in cycles with time in intervals (eq. 13).
  const Matrix3 v{{{q + g / 3.0, 0.5 * g, 0.5 * q + g / 8.0},
                   {0.5 * g, g, g / 6.0},
                   {0.5 * q + g / 8.0, g / 6.0, q / 3.0 + g / 20.0}}};
  const Matrix3 map{{{1.0, 0.0, -loop.gain[0]}, {0.0, 1.0, -loop.gain[1]}, {0.0, 0.0, -loop.gain[2]}}};
  Matrix3 transposed{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) transposed[i][j] = map[j][i];
  }
  Matrix3 w = times(times(map, v), transposed);
  const auto states = static_cast<std::size_t>(loop.order);
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      if (i >= states || j >= states) w[i][j] = 0.0;
    }
  }
  const Matrix3 p = lyapunov(closed(loop.order, loop.gain), w);
  return {p[0][0], p[1][1] / (t * t)};
}

double phase_variance(double cn0_hz, double interval_s) noexcept {
  return 1.0 / (2.0 * interval_s * cn0_hz * kTwoPi * kTwoPi);
}

double costas_phase_variance(double cn0_hz, double interval_s, double integration_s) noexcept {
  return phase_variance(cn0_hz, interval_s) * (1.0 + 0.5 / (integration_s * cn0_hz));
}

double window_variance(const PhaseNoise& noise, double window_s) noexcept {
  return noise.white_frequency_cycles2ps * window_s / 12.0 +
         noise.frequency_walk_cycles2ps3 * window_s * window_s * window_s / 320.0;
}

double code_variance(double cn0_hz, double interval_s, double integration_s, double spacing_chips) noexcept {
  return spacing_chips / (4.0 * interval_s * cn0_hz) * (1.0 + 1.0 / (integration_s * cn0_hz));
}

}  // namespace soopnav::tracking
