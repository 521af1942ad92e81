#include "soopnav/simulation/aperture_link.hpp"

#include <cmath>

#include "simulation/require.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::simulation {

void render_aperture(std::span<const ApertureLink> links, std::span<const double> path_m,
                     std::span<const double> time_s, std::span<const double> phase_rad, const RandomStream& random,
                     std::span<std::complex<double>> phasors) {
  const std::size_t n = time_s.size(), nodes = links.size();
  require(path_m.size() == 2 * n, "path_m", static_cast<double>(path_m.size()), "two numbers per time expected");
  require(phase_rad.empty() || phase_rad.size() == n, "phase_rad", static_cast<double>(phase_rad.size()),
          "one per time, or none, expected");
  require(phasors.size() == n * nodes, "phasors", static_cast<double>(phasors.size()),
          "one per time and link expected");
  for (const double v : path_m) require(std::isfinite(v), "path_m", v, "it must be finite");
  for (const double v : time_s) require(std::isfinite(v), "time_s", v, "it must be finite");
  for (const double v : phase_rad) require(std::isfinite(v), "phase_rad", v, "it must be finite");
  for (const ApertureLink& link : links) {
    require(std::isfinite(link.bearing_rad), "bearing_rad", link.bearing_rad, "it must be finite");
    require(std::isfinite(link.wavelength_m) && link.wavelength_m > 0.0, "wavelength_m", link.wavelength_m,
            "it must be finite and positive");
    require(std::isfinite(link.snr) && link.snr >= 0.0, "snr", link.snr, "it must be finite and >= 0");
    require(std::isfinite(link.k_factor) && link.k_factor >= 0.0, "k_factor", link.k_factor,
            "it must be finite and >= 0");
    require(std::isfinite(link.frequency_hz), "frequency_hz", link.frequency_hz, "it must be finite");
    require(link.waves >= 1 && link.waves <= 1024, "waves", link.waves, "1 to 1024");
  }
  RandomStream noise = random.substream(0);
  const double part = std::sqrt(0.5);
  for (std::complex<double>& v : phasors) {
    const double re = noise.normal(0.0, part);
    v = {re, noise.normal(0.0, part)};
  }
  for (std::size_t i = 0; i < nodes; ++i) {
    const ApertureLink& link = links[i];
    RandomStream own = random.substream(i + 1);
    const double phi = own.uniform(0.0, kTwoPi), wave_number = kTwoPi / link.wavelength_m;
    const double direct = std::sqrt(link.snr * (link.k_factor / (link.k_factor + 1.0)));
    const double diffuse = std::sqrt(link.snr / (link.k_factor + 1.0));
    const auto add = [&](std::complex<double> amplitude, double bearing) {
      const double x = wave_number * std::cos(bearing), y = wave_number * std::sin(bearing);
      for (std::size_t k = 0; k < n; ++k) {
        const double phase = phi + kTwoPi * link.frequency_hz * time_s[k] + x * path_m[2 * k] + y * path_m[2 * k + 1] +
                             (phase_rad.empty() ? 0.0 : phase_rad[k]);
        phasors[k * nodes + i] += amplitude * std::polar(1.0, phase);
      }
    };
    if (direct > 0.0) add(direct, link.bearing_rad);
    if (!(diffuse > 1e-12 * direct) || diffuse == 0.0) continue;
    const double scale = diffuse * std::sqrt(0.5 / link.waves);
    for (int w = 0; w < link.waves; ++w) {
      const double bearing = own.uniform(0.0, kTwoPi), re = own.normal(0.0, scale);
      add({re, own.normal(0.0, scale)}, bearing);
    }
  }
}

void drift_path(std::span<const double> path_m, double sigma_m_per_sqrt_step, RandomStream random,
                std::span<double> out) {
  require(path_m.size() % 2 == 0, "path_m", static_cast<double>(path_m.size()), "two numbers per point expected");
  require(out.size() == path_m.size(), "out", static_cast<double>(out.size()), "as many numbers as path_m expected");
  require(std::isfinite(sigma_m_per_sqrt_step) && sigma_m_per_sqrt_step >= 0.0, "sigma_m_per_sqrt_step",
          sigma_m_per_sqrt_step, "it must be finite and >= 0");
  double x = 0.0, y = 0.0;
  for (std::size_t k = 0; 2 * k < path_m.size(); ++k) {
    if (k > 0) {
      x += random.normal(0.0, sigma_m_per_sqrt_step);
      y += random.normal(0.0, sigma_m_per_sqrt_step);
    }
    out[2 * k] = path_m[2 * k] + x;
    out[2 * k + 1] = path_m[2 * k + 1] + y;
  }
}

}  // namespace soopnav::simulation
