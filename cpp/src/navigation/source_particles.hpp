#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "navigation/source_filter.hpp"
#include "soopnav/core/random.hpp"

namespace soopnav::navigation::detail {

/// Places of a source with weights (carter Algorithm 1 with the weight w p(e); doc/source_location.md section 6).
class Particles {
 public:
  Particles(std::size_t count, std::size_t dimensions);

  void clear(std::uint64_t seed) noexcept;
  [[nodiscard]] bool started() const noexcept { return started_; }
  /// Normal about `mean`, `sigma` in each coordinate.
  void start(const Vector& mean, double sigma) noexcept;
  /// Along a bearing: ranges uniform, directions normal, a share `outlier` of them all round.
  void start(const Kept& kept, double min_range_m, double max_range_m, double outlier) noexcept;
  /// One bearing; resamples where the effective share falls below `threshold`. False when no particle explains it.
  [[nodiscard]] bool weigh(const PackedBearing& bearing, double outlier, double threshold) noexcept;
  void moments(Vector& mean, Matrix& covariance) const noexcept;
  /// Weights that sum to one, for `weights`; the cloud itself stays as it is.
  void show() noexcept;

  [[nodiscard]] std::span<const double> coordinates(std::size_t axis) const noexcept {
    return {places_[axis].data(), count_};
  }
  [[nodiscard]] std::span<const double> weights() const noexcept { return {shown_.data(), count_}; }

 private:
  void resample() noexcept;

  std::size_t count_;
  std::size_t dimensions_;
  bool started_ = false;
  double total_ = 1.0;
  RandomStream random_;
  std::array<std::vector<double>, 3> places_;
  std::vector<double> weights_, shown_, moved_;
  std::vector<float> draws_;
  std::vector<std::uint32_t> ancestors_;
};

}  // namespace soopnav::navigation::detail
