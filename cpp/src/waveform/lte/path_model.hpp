#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "waveform/lte/link_tracker.hpp"

namespace soopnav::lte {

inline constexpr int kMaxPaths = 8;

/// Discrete paths of a channel: y_p(j) = sum_l a_pl exp(-j 2 pi f_j tau_l / N) + noise, delays common to the ports.
///
/// Paths are added one at a time, the strongest of what is left, as long as it stands out of the noise and of the
/// strongest path; after each, all delays are refined together by Gauss-Newton with the amplitudes projected out.
/// See cpp/doc/lte_time_of_arrival.md section 5.
class PathModel {
 public:
  struct Limits {
    double false_path = 1e-6;     ///< probability of a path in noise alone
    double weakest_db = -25.0;    ///< below the strongest path: where model errors begin
    double earliest_db = -20.0;   ///< a first path weaker than this is not taken as such
    double window_samples = 0.0;  ///< delays looked at: -window ... +window
  };

  PathModel();

  /// Fits `ports` channels of `count` elements. `noise` is the variance of one element. False when nothing stands out.
  [[nodiscard]] bool fit(const Cf32* const* y, int ports, const int* frequencies, int count, int fft_size, double noise,
                         const Limits& limits, CoarseDelay& coarse);

  [[nodiscard]] int paths() const noexcept { return paths_; }
  [[nodiscard]] double delay(int path) const noexcept {
    return delays_[static_cast<std::size_t>(path)];
  }                                                     ///< samples, ascending
  [[nodiscard]] double power(int path) const noexcept;  ///< mean over ports of |a|^2
  [[nodiscard]] int first() const noexcept { return first_; }
  /// Standard deviation of the first path's delay, the other paths unknown too.
  [[nodiscard]] double first_sigma() const noexcept { return first_sigma_; }
  /// The fitted channel of `port`.
  [[nodiscard]] const Cf32* channel(int port) const noexcept { return model_[static_cast<std::size_t>(port)].data(); }

 private:
  void solve_amplitudes(const Cf32* const* y);
  bool refine(const Cf32* const* y);
  void make_model();

  int ports_ = 0, count_ = 0, fft_size_ = 0, paths_ = 0, first_ = 0;
  const int* frequencies_ = nullptr;
  double first_sigma_ = 0.0;
  std::array<double, kMaxPaths> delays_{};
  Eigen::MatrixXcd steering_;  // count x paths
  std::array<Eigen::VectorXcd, kMaxPorts> amplitudes_;
  Eigen::MatrixXd information_;  // of the delays, noise variance 1
  std::array<std::vector<Cf32>, kMaxPorts> model_, residual_;
};

}  // namespace soopnav::lte
