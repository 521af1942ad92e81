#pragma once

#include <complex>
#include <cstddef>
#include <span>
#include <vector>

#include "array/aperture_model.hpp"

namespace soopnav::array {

/// Axis that a path is longest along, and whether it is a line as phases see it.
struct PathAxis {
  double angle_rad;
  bool straight;
};
[[nodiscard]] PathAxis path_axis(const ApertureModel& m) noexcept;

/// Sets what the model cannot tell: the first link's phase, and its offset where the receiver's phase is free.
void fix_gauge(ApertureModel& m, bool frequency_offsets, std::size_t reference, bool modes) noexcept;

/// Bearings, path, offsets and phases from phases alone (eq. 7 to 10), with the gauge fixed. False: no ellipse.
[[nodiscard]] bool start_blind(ApertureModel& m, bool frequency_offsets);

/// Where the likelihood's maxima may be: grids of bearings and frequency offsets.
class ApertureSearch {
 public:
  /// Tables for the model's path and times. Allocates where it is larger than before.
  void prepare(const ApertureModel& m, bool frequency_offsets, double max_frequency_hz);

  /// Starts of all links in use against one: the receiver's phase cancels in their products. Best first.
  std::size_t pairs(const ApertureModel& m, std::size_t reference);
  /// One start, of each link by itself: the receiver's phase is the model's psi.
  std::size_t singles(const ApertureModel& m);
  /// Puts start s into the model.
  void start(std::size_t s, ApertureModel& m) const;

  /// Largest |sum_k y_k conj(model)|^2 of one node over bearings and offsets, with this phase of the receiver.
  [[nodiscard]] double largest(const ApertureModel& m, std::size_t node, std::span<const double> psi);

 private:
  struct Peak {
    float power = 0.0F;
    double bearing = 0.0, offset = 0.0, phase = 0.0;
  };
  [[nodiscard]] float spectrum_peak(std::size_t n, std::size_t& line) noexcept;
  [[nodiscard]] std::complex<double> line_sum(std::size_t n, std::size_t line) const noexcept;
  Peak scan(const ApertureModel& m, std::size_t node, std::span<const double> psi);

  std::size_t angles_ = 0, lines_ = 0;
  std::vector<double> line_offset_;
  std::vector<float> line_re_, line_im_;       // n x lines
  std::vector<std::complex<float>> steering_;  // nodes x angles x n, exp(-j k u . p)
  std::vector<std::complex<float>> product_, series_;
  std::vector<float> sum_re_, sum_im_;
  std::vector<float> power_;  // nodes x angles x angles
  std::vector<std::size_t> line_;
  std::vector<Peak> starts_;  // starts x nodes
  std::vector<float> score_;
};

}  // namespace soopnav::array
