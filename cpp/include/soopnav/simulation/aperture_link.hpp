#pragma once

#include <complex>
#include <span>

#include "soopnav/core/random.hpp"

/// Phasors of radio nodes along the path of one antenna: what a synthetic array is made from.
namespace soopnav::simulation {

/// One node's link, seen along the path.
struct ApertureLink {
  double bearing_rad = 0.0;  ///< of the direct wave
  double wavelength_m = 0.15;
  double snr = 10.0;          ///< mean power over E|noise|^2 = 1, both parts of the signal together
  double k_factor = 1e300;    ///< direct over diffuse power: large is line of sight, 0 Rayleigh
  double frequency_hz = 0.0;  ///< offset of the node's oscillator
  int waves = 24;             ///< that the diffuse part is the sum of
};

/// y_ki = A (sqrt(K/(K+1)) e^{j(psi_k + phi_i + 2 pi f_i t_k + k u_i . p_k)} + sqrt(1/(K+1)) d_i(p_k) e^{j psi_k +
/// ...})
/// + noise of variance 1 (doc/synthetic_aperture.md eq. 1, 13). The diffuse part d has mean power 1: plane waves of
/// independent complex normal amplitudes from directions uniform over the turn (Clarke), so it is Rayleigh at every
/// place and decorrelates over 0.4 wavelengths. phi_i is uniform. Substream 0 of `random` is the noise, i + 1 node i.
/// Writes n x L, a row per snapshot. Does not allocate.
/// @param path_m n x 2, the true one. @param phase_rad n, the receiver's psi; empty: 0.
/// @throws std::invalid_argument for sizes that do not fit, numbers that are not finite, a wavelength that is not
///         positive, an SNR or K factor that is negative, waves outside 1 .. 1024.
void render_aperture(std::span<const ApertureLink> links, std::span<const double> path_m,
                     std::span<const double> time_s, std::span<const double> phase_rad, const RandomStream& random,
                     std::span<std::complex<double>> phasors);

/// A path as dead reckoning reports it: each step off by an independent normal error per axis, the first point right.
/// n x 2 in and out, which may be the same. @throws std::invalid_argument for sizes that differ, a sigma < 0 or NaN.
void drift_path(std::span<const double> path_m, double sigma_m_per_sqrt_step, RandomStream random,
                std::span<double> out);

}  // namespace soopnav::simulation
