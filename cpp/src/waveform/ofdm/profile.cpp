#include "waveform/ofdm/profile.hpp"

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <vector>

#include "soopnav/core/constants.hpp"

namespace soopnav::ofdm {
namespace {

constexpr double kWhole = 1e-9;
constexpr double kSlopeStep = 1e-4;

double sinc(double t) noexcept { return std::abs(t) < kWhole ? 1.0 : std::sin(kPi * t) / (kPi * t); }

double slope_of_weight_on_difference(double r, double dr) noexcept {
  const double a = 1.0 - r * r;
  return 2.0 * r * dr / (a * a);
}

}  // namespace

double prefix_correlation(const Numerology& numerology, double i_minus_delta) noexcept {
  const double period = numerology.symbol_samples();
  const double lag = numerology.subcarriers;
  const double s = std::sin(kPi * (i_minus_delta - std::round(i_minus_delta)));
  double sum = 0.0;
  for (int p = 0; p < numerology.prefix; ++p) {
    const double u = i_minus_delta - p;
    if (std::abs(s) < kWhole) {
      sum += std::abs(std::remainder(std::round(u), period)) < 0.5 ? 1.0 : 0.0;
      continue;
    }
    // Sums over all symbols in closed form: of sinc(u - k M)^2, and of sinc(u - N - k M) sinc(u + N - k M).
    const double d = period * std::sin(kPi * u / period);
    sum += s * s / (d * d);
    sum += s * s / (kTwoPi * lag * period) *
           (1.0 / std::tan(kPi * (u - lag) / period) - 1.0 / std::tan(kPi * (u + lag) / period));
  }
  return sum;
}

double prefix_correlation_slope(const Numerology& numerology, double i_minus_delta) noexcept {
  return (prefix_correlation(numerology, i_minus_delta - kSlopeStep) -
          prefix_correlation(numerology, i_minus_delta + kSlopeStep)) /
         (2.0 * kSlopeStep);
}

double pair_information(const Numerology& numerology, double fraction, double rho) noexcept {
  double information = 0.0;
  for (int i = 0; i < numerology.symbol_samples(); ++i) {
    const double r = rho * prefix_correlation(numerology, i - fraction);
    const double dr = rho * prefix_correlation_slope(numerology, i - fraction);
    const double a = 1.0 - r * r;
    information += 2.0 * dr * dr * (1.0 + r * r) / (a * a);
  }
  return information;
}

void score_inflation(const Numerology& numerology, double fraction, const double* rho, std::size_t count,
                     double* inflation) {
  const int period = numerology.symbol_samples();
  const int lag = numerology.subcarriers;
  const int prefix = numerology.prefix;
  constexpr int kSymbols = 7;
  const int first = -period;  // of the samples that pairs of this symbol and of its neighbours are made of
  const int samples = 3 * period + lag;
  Eigen::MatrixXd copy(samples, kSymbols * prefix), original(samples, kSymbols * prefix);
  for (int n = 0; n < samples; ++n) {
    for (int k = 0; k < kSymbols; ++k) {
      for (int p = 0; p < prefix; ++p) {
        const double u = first + n - fraction - ((k - kSymbols / 2) * period + p);
        copy(n, k * prefix + p) = sinc(u);
        original(n, k * prefix + p) = sinc(u - lag);
      }
    }
  }
  // E[y(i) y*(j)] beside the identity (eq. 13), for i of this symbol's pairs.
  const auto rows = static_cast<Eigen::Index>(period + lag);
  const Eigen::MatrixXd y =
      copy.middleRows(period, rows) * original.transpose() + original.middleRows(period, rows) * copy.transpose();
  const auto covariance = [&](int i, int j, double noise) { return y(i, j - first) + (i == j ? 1.0 + noise : 0.0); };
  std::vector<double> on_difference(static_cast<std::size_t>(period)), on_sum(static_cast<std::size_t>(period));
  std::vector<double> b(static_cast<std::size_t>(period)), slope(static_cast<std::size_t>(period));
  for (int i = 0; i < period; ++i) {
    b[static_cast<std::size_t>(i)] = prefix_correlation(numerology, i - fraction);
    slope[static_cast<std::size_t>(i)] = prefix_correlation_slope(numerology, i - fraction);
  }
  for (std::size_t c = 0; c < count; ++c) {
    const double noise = 1.0 / rho[c] - 1.0;
    double information = 0.0;
    for (int i = 0; i < period; ++i) {
      const double r = rho[c] * b[static_cast<std::size_t>(i)];
      const double dr = rho[c] * slope[static_cast<std::size_t>(i)];
      const double a = 1.0 - r * r;
      information += 2.0 * dr * dr * (1.0 + r * r) / (a * a);
      const double on_product = -2.0 * dr / ((1.0 + r) * (1.0 + r));
      on_difference[static_cast<std::size_t>(i)] = slope_of_weight_on_difference(r, dr) - 0.25 * on_product;
      on_sum[static_cast<std::size_t>(i)] = 0.25 * on_product;
    }
    double variance = 0.0;
    for (int i = 0; i < period; ++i) {
      for (int j = -period; j < 2 * period; ++j) {
        const auto at = static_cast<std::size_t>((j + period) % period);
        const double ii = covariance(i, j, noise), in = covariance(i, j + lag, noise);
        const double ni = covariance(i + lag, j, noise), nn = covariance(i + lag, j + lag, noise);
        const double dd = ii - in - ni + nn, ss = ii + in + ni + nn, ds = ii + in - ni - nn, sd = ii - in + ni - nn;
        const auto here = static_cast<std::size_t>(i);
        variance += on_difference[here] * on_difference[at] * dd * dd + on_sum[here] * on_sum[at] * ss * ss +
                    on_difference[here] * on_sum[at] * ds * ds + on_sum[here] * on_difference[at] * sd * sd;
      }
    }
    const double power = 1.0 + noise;
    inflation[c] = variance / (power * power) / information;
  }
}

}  // namespace soopnav::ofdm
