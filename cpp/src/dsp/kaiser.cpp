#include "dsp/kaiser.hpp"

#include <cmath>
#include <numbers>

namespace soopnav::dsp::detail {
namespace {

// Modified Bessel function of order zero by its power series; every term is positive, so nothing cancels.
double bessel_i0(double x) noexcept {
  const double quarter = 0.25 * x * x;
  double term = 1.0;
  double sum = 1.0;
  for (int k = 1; term > 1e-17 * sum; ++k) {
    term *= quarter / (static_cast<double>(k) * k);
    sum += term;
  }
  return sum;
}

}  // namespace

double sin_pi(double t) noexcept {
  const double nearest = std::nearbyint(t);
  const double sine = std::sin(std::numbers::pi * (t - nearest));
  return std::fmod(nearest, 2.0) == 0.0 ? sine : -sine;
}

double sinc(double t) noexcept {
  if (std::abs(t) < 1e-9) return 1.0;
  return sin_pi(t) / (std::numbers::pi * t);
}

double kaiser_beta(double attenuation_db) noexcept {
  if (attenuation_db > 50.0) return 0.1102 * (attenuation_db - 8.7);
  if (attenuation_db <= 21.0) return 0.0;
  const double excess = attenuation_db - 21.0;
  return 0.5842 * std::pow(excess, 0.4) + 0.07886 * excess;
}

double kaiser_span(double attenuation_db, double width_rad) noexcept {
  return (attenuation_db - 7.95) / (2.285 * width_rad) + 1.0;
}

KaiserSinc::KaiserSinc(double cutoff, double span, double attenuation_db) noexcept
    : cutoff_(cutoff), half_span_(0.5 * span), beta_(kaiser_beta(attenuation_db)), scale_(cutoff / bessel_i0(beta_)) {}

double KaiserSinc::operator()(double t) const noexcept {
  const double u = t / half_span_;
  const double inside = 1.0 - u * u;
  if (inside < 0.0) return 0.0;
  return scale_ * sinc(cutoff_ * t) * bessel_i0(beta_ * std::sqrt(inside));
}

}  // namespace soopnav::dsp::detail
