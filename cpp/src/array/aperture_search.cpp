#include "array/aperture_search.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "soopnav/array/subspace.hpp"
#include "soopnav/core/angle.hpp"

namespace soopnav::array {

namespace {

constexpr double kPhaseStepRad = 0.9;  // of the farthest snapshot, from angle to angle
constexpr double kLineStep = 0.6;      // of 1 / duration
constexpr std::size_t kMaxStarts = 6;
constexpr std::size_t kMaxLines = 4096;

}  // namespace

void ApertureSearch::prepare(const ApertureModel& m, bool frequency_offsets, double max_frequency_hz) {
  double reach = 0.0;
  for (std::size_t i = 0; i < m.nodes; ++i) {
    for (std::size_t k = 0; k < m.n; ++k) reach = std::max(reach, m.wave_number[i] * std::hypot(m.x0[k], m.y0[k]));
  }
  const double wanted = std::clamp(kPi * reach / kPhaseStepRad, 9.0, 90.0);
  angles_ = 2 * static_cast<std::size_t>(std::ceil(wanted));
  const double duration = m.t.back() - m.t.front();
  // Twice what even snapshots tell apart is enough for uneven ones, and bounds the cost.
  const double apart_hz = 0.5 * static_cast<double>(m.n - 1) / duration;
  const double reach_hz = max_frequency_hz > 0.0 ? std::min(max_frequency_hz, 2.0 * apart_hz) : apart_hz;
  const auto side = frequency_offsets ? static_cast<std::size_t>(std::ceil(std::min(
                                            reach_hz * duration / kLineStep, static_cast<double>(kMaxLines / 2))))
                                      : 0;
  lines_ = 2 * side + 1;
  line_offset_.resize(lines_);
  for (std::size_t f = 0; f < lines_; ++f) {
    line_offset_[f] = kTwoPi * kLineStep / duration * (static_cast<double>(f) - static_cast<double>(side));
  }
  line_re_.resize(m.n * lines_);
  line_im_.resize(m.n * lines_);
  for (std::size_t k = 0; k < m.n; ++k) {
    for (std::size_t f = 0; f < lines_; ++f) {
      line_re_[k * lines_ + f] = static_cast<float>(std::cos(line_offset_[f] * m.t[k]));
      line_im_[k * lines_ + f] = static_cast<float>(-std::sin(line_offset_[f] * m.t[k]));
    }
  }
  steering_.resize(m.nodes * angles_ * m.n);
  for (std::size_t i = 0; i < m.nodes; ++i) {
    for (std::size_t a = 0; a < angles_; ++a) {
      const double angle = kTwoPi * static_cast<double>(a) / static_cast<double>(angles_);
      const double kx = m.wave_number[i] * std::cos(angle), ky = m.wave_number[i] * std::sin(angle);
      for (std::size_t k = 0; k < m.n; ++k) {
        const double phase = -(kx * m.x0[k] + ky * m.y0[k]);
        steering_[(i * angles_ + a) * m.n + k] = {static_cast<float>(std::cos(phase)),
                                                  static_cast<float>(std::sin(phase))};
      }
    }
  }
  product_.resize(m.n);
  series_.resize(m.n);
  sum_re_.resize(lines_);
  sum_im_.resize(lines_);
  power_.resize(m.nodes * angles_ * angles_);
  line_.resize(power_.size());
  starts_.resize(kMaxStarts * m.nodes);
  score_.resize(angles_);
}

// Of series_ over all offsets.
float ApertureSearch::spectrum_peak(std::size_t n, std::size_t& line) noexcept {
  std::fill(sum_re_.begin(), sum_re_.end(), 0.0F);
  std::fill(sum_im_.begin(), sum_im_.end(), 0.0F);
  const std::size_t lines = lines_;
  float* const re = sum_re_.data();
  float* const im = sum_im_.data();
  for (std::size_t k = 0; k < n; ++k) {
    const float a = series_[k].real(), b = series_[k].imag();
    const float* const c = &line_re_[k * lines];
    const float* const s = &line_im_[k * lines];
    for (std::size_t f = 0; f < lines; ++f) {
      re[f] += a * c[f] - b * s[f];
      im[f] += a * s[f] + b * c[f];
    }
  }
  float best = -1.0F;
  for (std::size_t f = 0; f < lines; ++f) {
    const float power = re[f] * re[f] + im[f] * im[f];
    if (power > best) {
      best = power;
      line = f;
    }
  }
  return best;
}

std::complex<double> ApertureSearch::line_sum(std::size_t n, std::size_t line) const noexcept {
  std::complex<double> sum = 0.0;
  for (std::size_t k = 0; k < n; ++k) {
    sum += std::complex<double>(series_[k] *
                                std::complex<float>(line_re_[k * lines_ + line], line_im_[k * lines_ + line]));
  }
  return sum;
}

std::size_t ApertureSearch::pairs(const ApertureModel& m, std::size_t reference) {
  const std::size_t n = m.n, count = angles_, half = angles_ / 2;
  const std::complex<float>* const own = &steering_[reference * count * n];
  const auto fill_product = [&](std::size_t i) {
    for (std::size_t k = 0; k < n; ++k) {
      const std::complex<double>& r = m.y[k * m.nodes + reference];
      const double size = std::abs(r);
      product_[k] = size > 0.0 ? std::complex<float>(m.y[k * m.nodes + i] * std::conj(r) / size / std::sqrt(m.power[i]))
                               : std::complex<float>{};
    }
  };
  const auto fill_series = [&](std::size_t i, std::size_t a, std::size_t b) {
    const std::complex<float>* const s = &steering_[(i * count + b) * n];
    const std::complex<float>* const r = own + a * n;
    for (std::size_t k = 0; k < n; ++k) {
      const float cr = s[k].real() * r[k].real() + s[k].imag() * r[k].imag();
      const float ci = s[k].imag() * r[k].real() - s[k].real() * r[k].imag();
      const float pr = product_[k].real(), pi = product_[k].imag();
      series_[k] = {pr * cr - pi * ci, pr * ci + pi * cr};
    }
  };
  std::fill(score_.begin(), score_.end(), 0.0F);
  for (std::size_t i = 0; i < m.nodes; ++i) {
    if (i == reference || !m.used[i]) continue;
    fill_product(i);
    const bool alike = m.wave_number[i] == m.wave_number[reference];
    float* const power = &power_[i * count * count];
    std::size_t* const line = &line_[i * count * count];
    for (std::size_t a = 0; a < count; ++a) {
      for (std::size_t b = 0; b < count; ++b) {
        // u_b - u_a is that of the pair turned by half a turn and swapped.
        const std::size_t twin = ((b + half) % count) * count + (a + half) % count, at = a * count + b;
        if (alike && twin < at) {
          power[at] = power[twin];
          line[at] = line[twin];
          continue;
        }
        fill_series(i, a, b);
        power[at] = spectrum_peak(n, line[at]);
      }
      score_[a] += *std::max_element(power + a * count, power + (a + 1) * count);
    }
  }
  std::array<std::size_t, kMaxStarts> chosen{};
  std::size_t found = 0;
  for (std::size_t a = 0; a < count; ++a) {
    if (score_[a] < score_[(a + 1) % count] || score_[a] <= score_[(a + count - 1) % count]) continue;
    if (found == kMaxStarts && score_[a] <= score_[chosen[found - 1]]) continue;
    std::size_t place = found < kMaxStarts ? found++ : kMaxStarts - 1;
    for (; place > 0 && score_[chosen[place - 1]] < score_[a]; --place) chosen[place] = chosen[place - 1];
    chosen[place] = a;
  }
  if (found == 0) {
    chosen[0] = static_cast<std::size_t>(std::max_element(score_.begin(), score_.end()) - score_.begin());
    found = 1;
  }
  const double step = kTwoPi / static_cast<double>(count);
  for (std::size_t s = 0; s < found; ++s) {
    Peak* const row = &starts_[s * m.nodes];
    row[reference] = {0.0F, step * static_cast<double>(chosen[s]), 0.0, 0.0};
  }
  for (std::size_t i = 0; i < m.nodes; ++i) {
    if (i == reference || !m.used[i]) continue;
    fill_product(i);
    for (std::size_t s = 0; s < found; ++s) {
      const float* const power = &power_[(i * count + chosen[s]) * count];
      const auto b = static_cast<std::size_t>(std::max_element(power, power + count) - power);
      const std::size_t line = line_[(i * count + chosen[s]) * count + b];
      fill_series(i, chosen[s], b);
      starts_[s * m.nodes + i] = {power[b], step * static_cast<double>(b), line_offset_[line],
                                  std::arg(line_sum(n, line))};
    }
  }
  return found;
}

ApertureSearch::Peak ApertureSearch::scan(const ApertureModel& m, std::size_t node, std::span<const double> psi) {
  Peak best;
  for (std::size_t k = 0; k < m.n; ++k) {
    product_[k] = std::complex<float>(m.y[k * m.nodes + node] / std::sqrt(m.power[node]) * std::polar(1.0, -psi[k]));
  }
  for (std::size_t a = 0; a < angles_; ++a) {
    const std::complex<float>* const s = &steering_[(node * angles_ + a) * m.n];
    for (std::size_t k = 0; k < m.n; ++k) {
      series_[k] = {product_[k].real() * s[k].real() - product_[k].imag() * s[k].imag(),
                    product_[k].real() * s[k].imag() + product_[k].imag() * s[k].real()};
    }
    std::size_t line = 0;
    const float power = spectrum_peak(m.n, line);
    if (power > best.power) {
      best = {power, kTwoPi * static_cast<double>(a) / static_cast<double>(angles_), line_offset_[line],
              std::arg(line_sum(m.n, line))};
    }
  }
  return best;
}

std::size_t ApertureSearch::singles(const ApertureModel& m) {
  for (std::size_t i = 0; i < m.nodes; ++i) {
    if (m.used[i]) starts_[i] = scan(m, i, m.psi);
  }
  return 1;
}

void ApertureSearch::start(std::size_t s, ApertureModel& m) const {
  for (std::size_t i = 0; i < m.nodes; ++i) {
    if (!m.used[i]) continue;
    const Peak& peak = starts_[s * m.nodes + i];
    m.theta[i] = peak.bearing;
    m.offset[i] = peak.offset;
    m.phi[i] = peak.phase;
  }
}

double ApertureSearch::largest(const ApertureModel& m, std::size_t node, std::span<const double> psi) {
  return static_cast<double>(scan(m, node, psi).power) * m.power[node];
}

}  // namespace soopnav::array
