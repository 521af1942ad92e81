#pragma once

#include <array>
#include <complex>
#include <vector>

#include "soopnav/waveform/lte/super_resolution.hpp"
#include "waveform/lte/small_matrix.hpp"

namespace soopnav::lte {

/// Maximum-likelihood delays of k paths with the amplitudes projected out (cpp/doc/lte_super_resolution.md section 4).
///
/// Delays `theta` are in turns per 15 kHz: a path's element at frequency f is gain * exp(-j 2 pi f theta).
class PathFit {
 public:
  static constexpr int kElements = 4 * kMaxRb;
  using Delays = std::array<double, kMaxResolved>;
  using Information = SmallMatrix<double, kMaxResolved>;

  /// One solution.
  struct Solution {
    int paths = 0;
    Delays theta{};
    double residual = 0.0;                                                          ///< energy that is left
    std::array<std::array<std::complex<double>, kMaxPorts>, kMaxResolved> gains{};  ///< [path][port]
    Information information;  ///< of the delays for noise variance 2 (eq. 8), per (turn / 15 kHz)^2
  };

  PathFit();

  /// The channel that the following calls fit; it must stay.
  void set(const ChannelView& channel);

  /// Amplitudes by least squares for delays as they are. False when two of them cannot be told apart.
  [[nodiscard]] bool evaluate(int paths, const Delays& theta, Solution& out);

  /// Levenberg-Marquardt from `theta`; false when it ends nearer than `separation` (turns) between two delays, or
  /// outside of `low` ... `high`.
  [[nodiscard]] bool polish(int paths, const Delays& theta, double separation, double low, double high, Solution& out);

  /// The best pair of delays on a grid of `step` over `low` ... `high`, at least two steps apart (eq. 10).
  [[nodiscard]] std::array<double, 2> best_pair(double low, double high, double step);

  /// What `solution` leaves of each port.
  void residual(const Solution& solution, std::array<std::vector<Cf32>, kMaxPorts>& out) const;

 private:
  bool solve(Solution& s);
  void phasors(double theta, Cf32* out) const;

  ChannelView channel_;
  int count_ = 0, half_ = 0, step_ = 0;
  float scale_ = 1.0F;  // of the frequencies
  std::array<float, kElements> frequency_{};
  std::array<std::array<Cf32, kElements>, kMaxResolved> steering_{}, weighted_{};
  std::vector<Cf32> left_;
  std::vector<std::complex<double>> grid_;
};

}  // namespace soopnav::lte
