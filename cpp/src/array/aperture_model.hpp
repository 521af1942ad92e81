#pragma once

#include <complex>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "soopnav/array/synthetic_aperture.hpp"

namespace soopnav::array {

/// Likelihood of an aperture's phasors, its scoring steps and its bound: doc/synthetic_aperture.md eq. 1 to 6.
///
/// Per node: bearing, offset, phase; then the modes' amplitudes: the parameters that stay. Per snapshot: the receiver's
/// phase and the path's error, eliminated forwards as a chain. Sizes change in `resize` only.
struct ApertureModel {
  enum : std::size_t { kBearing, kOffset, kPhase, kPerNode };

  std::size_t n = 0, nodes = 0, modes = 0;
  ReceiverPhase receiver = ReceiverPhase::kFree;
  bool path_free = false;   // blind: the path is unknown
  bool path_error = false;  // random walk
  bool path_given = true;

  // Data.
  std::vector<std::complex<double>> y;                      // n x nodes
  std::vector<double> x0, y0, t, mode_x, mode_y;            // path, centred time, modes x n
  std::vector<double> wave_number, noise, power;            // per node: 2 pi / lambda, E|noise|^2, mean |y|^2
  std::vector<double> phase_information, path_information;  // of the step to k, k >= 1
  std::vector<std::uint8_t> used, fixed;                    // nodes, parameters

  // State.
  std::vector<double> theta, offset, phi, amplitude, z, psi, dx, dy;

  void resize(std::size_t snapshots, std::size_t n_nodes, std::size_t n_modes);
  [[nodiscard]] std::size_t parameters() const noexcept { return kPerNode * nodes + modes; }

  /// Receiver phases in closed form where they are free, then amplitudes.
  void settle() noexcept;
  /// Minus the log likelihood, priors included.
  [[nodiscard]] double cost() const noexcept;
  /// Residual power over its degrees of freedom, into `noise` of all nodes.
  void estimate_noise() noexcept;
  /// Scoring steps until bearings stand still. False: they do not.
  bool solve(int max_steps, double settled_rad, bool own_noise, int& steps) noexcept;
  /// Reduced information at the state and its inverse. False where it is singular.
  bool invert() noexcept;
  [[nodiscard]] double covariance(std::size_t a, std::size_t b) const noexcept {
    return inverse_[a * parameters() + b];
  }

  /// Model phase of one node at one snapshot without the receiver's.
  [[nodiscard]] double phase_of(std::size_t node, std::size_t k) const noexcept {
    return node_phase(k, node, cosine_[node], sine_[node]);
  }
  void aim() noexcept;  // sines and cosines of theta
  [[nodiscard]] double prior_cost() const noexcept;
  [[nodiscard]] int unknowns() const noexcept;

 private:
  [[nodiscard]] double px(std::size_t k) const noexcept;
  [[nodiscard]] double py(std::size_t k) const noexcept;
  [[nodiscard]] double node_phase(std::size_t k, std::size_t i, double c, double s) const noexcept;
  void assemble(double damping) noexcept;
  bool factor(double floor) noexcept;
  void back_substitute() noexcept;
  void move(double scale) noexcept;
  void keep() noexcept;
  void restore() noexcept;

  std::vector<double> cosine_, sine_, px_, py_;
  std::vector<double> information_, diagonal_, gradient_, step_, inverse_;
  std::vector<double> chain_inverse_, chain_cross_, chain_right_, chain_step_;
  std::vector<double> kept_;
  std::vector<std::size_t> active_;
};

}  // namespace soopnav::array
