#include <cmath>
#include <numbers>
#include <sstream>
#include <stdexcept>

#include "soopnav/dsp/ambiguity.hpp"

namespace soopnav::dsp {
namespace {

constexpr double kPi = std::numbers::pi;

void require_positive(const char* name, double value) {
  if (std::isfinite(value) && value > 0.0) return;
  std::ostringstream text;
  text << name << ": a finite number above 0 required, got " << value;
  throw std::invalid_argument(text.str());
}

void require_shape(double bandwidth_hz, SpectrumShape shape, double rolloff) {
  require_positive("bandwidth_hz", bandwidth_hz);
  if (shape == SpectrumShape::kFlat || (rolloff >= 0.0 && rolloff <= 1.0)) return;
  std::ostringstream text;
  text << "rolloff: 0 to 1 required, got " << rolloff;
  throw std::invalid_argument(text.str());
}

// Power spectrum at u = f / B, peak 1.
double spectrum(double u, SpectrumShape shape, double rolloff) {
  const double x = std::abs(u);
  if (shape == SpectrumShape::kFlat || rolloff == 0.0) return x <= 0.5 ? 1.0 : 0.0;
  const double edge = 0.5 * (1.0 - rolloff);
  if (x <= edge) return 1.0;
  if (x >= 0.5 * (1.0 + rolloff)) return 0.0;
  return 0.5 * (1.0 + std::cos(kPi / rolloff * (x - edge)));
}

}  // namespace

double rms_bandwidth_rad(double bandwidth_hz, SpectrumShape shape, double rolloff) {
  require_shape(bandwidth_hz, shape, rolloff);
  const double widening =
      shape == SpectrumShape::kFlat ? 1.0 : 1.0 + 3.0 * rolloff * rolloff * (1.0 - 8.0 / (kPi * kPi));
  return kPi * bandwidth_hz * std::sqrt(widening / 3.0);
}

TdoaFdoaBound stein_bound(double bandwidth_hz, double duration_s, double snr_a, double snr_b, SpectrumShape shape,
                          double rolloff) {
  require_positive("duration_s", duration_s);
  require_positive("snr_a", snr_a);
  require_positive("snr_b", snr_b);
  const double beta = rms_bandwidth_rad(bandwidth_hz, shape, rolloff);
  const double duration_rad = kPi * duration_s / std::sqrt(3.0);
  const double snr = 2.0 / (1.0 / snr_a + 1.0 / snr_b + 1.0 / (snr_a * snr_b));
  const double amplitude = std::sqrt(bandwidth_hz * duration_s * snr);
  return {1.0 / (beta * amplitude), 1.0 / (duration_rad * amplitude)};
}

TdoaFdoaBound stochastic_bound(double bandwidth_hz, double duration_s, double snr_a, double snr_b, SpectrumShape shape,
                               double rolloff) {
  require_shape(bandwidth_hz, shape, rolloff);
  require_positive("duration_s", duration_s);
  require_positive("snr_a", snr_a);
  require_positive("snr_b", snr_b);
  // Midpoint rule over the two parts, flat and cosine, of one side: the integrand is smooth in each.
  const double flat = shape == SpectrumShape::kFlat ? 0.5 : 0.5 * (1.0 - rolloff);
  const double end = shape == SpectrumShape::kFlat ? 0.5 : 0.5 * (1.0 + rolloff);
  constexpr int kSteps = 4000;
  double zeroth = 0.0, second = 0.0;
  const auto add = [&](double from, double to) {
    const double step = (to - from) / kSteps;
    for (int i = 0; i < kSteps && step > 0.0; ++i) {
      const double u = from + (i + 0.5) * step;
      const double s = spectrum(u, shape, rolloff);
      const double information = snr_a * snr_b * s * s / (1.0 + (snr_a + snr_b) * s) * step;
      zeroth += 2.0 * information;
      second += 2.0 * u * u * information;
    }
  };
  add(0.0, flat);
  add(flat, end);
  const double cycles = bandwidth_hz * duration_s;
  const double beta = 2.0 * kPi * bandwidth_hz;
  const double duration_rad = kPi * duration_s / std::sqrt(3.0);
  return {1.0 / (beta * std::sqrt(2.0 * cycles * second)), 1.0 / (duration_rad * std::sqrt(2.0 * cycles * zeroth))};
}

}  // namespace soopnav::dsp
