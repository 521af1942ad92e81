#include <algorithm>
#include <cmath>
#include <utility>

#include "array/kernels.hpp"
#include "array/require.hpp"
#include "soopnav/array/direction_finder.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::array {

namespace {

constexpr double kMaxDirections = 16e6;
constexpr double kStepSlack = 1e-9;
constexpr double kOnPlane = 1e-9;
constexpr double kAlike = 1e-9;  // of the power

void require_step(const char* name, double step) {
  require(step > 0.0 && step <= kPi / 4 + kStepSlack, name, step, "a step of 0 to pi/4 (45 degrees) expected");
}

/// Even values from `low` to `high`, both ends, in steps of at most `step`.
std::vector<double> spread(double low, double high, double step) {
  const double intervals = std::max(1.0, std::ceil((high - low) / step - kStepSlack));
  std::vector<double> out;
  for (double i = 0.0; i <= intervals; i += 1.0) out.push_back(low + (high - low) * i / intervals);
  return out;
}

double at_frequency(const Manifold& manifold, double frequency_hz) {
  require(std::isfinite(frequency_hz) && frequency_hz >= 0.0, "frequency_hz", frequency_hz,
          "a finite frequency >= 0 expected");
  return frequency_hz > 0.0 ? frequency_hz : manifold.geometry().frequency_hz();
}

}  // namespace

SteeringTable::SteeringTable(Manifold manifold, const GridOptions& options)
    : manifold_(std::move(manifold)), options_(options), frequency_hz_(at_frequency(manifold_, options.frequency_hz)) {
  require_step("azimuth_step", options.azimuth_step_rad);
  require_step("elevation_step", options.elevation_step_rad);
  require(options.elevation_min_rad >= -kPi / 2 - kStepSlack && options.elevation_min_rad <= 89.0 / 90.0 * kPi / 2,
          "elevation_min", options.elevation_min_rad, "-pi/2 to 89 degrees expected");
  require(std::isfinite(options.azimuth_start_rad), "azimuth_start", options.azimuth_start_rad,
          "a finite angle expected");
  require(kTwoPi / options.azimuth_step_rad * kPi / options.elevation_step_rad < kMaxDirections, "azimuth_step",
          options.azimuth_step_rad, "fewer than 16 million directions expected");
  const ArrayGeometry& geometry = manifold_.geometry();
  if (geometry.rank() == 1) {
    periodic_ = false;
    const Eigen::Vector3d& line = geometry.axis();
    if (std::abs(line[2]) < 1e-9) {
      active_ = 1;
      elevations_ = {0.0};
      const double along = std::atan2(line[1], line[0]);
      azimuths_ = spread(along, along + kPi, options.azimuth_step_rad);
    } else {
      require(std::abs(line[2]) > 1.0 - 1e-9, "geometry", geometry.name(),
              "a line of elements must be horizontal or vertical in array axes");
      active_ = 2;
      azimuths_ = {0.0};
      elevations_ = spread(-kPi / 2, kPi / 2, options.elevation_step_rad);
    }
  } else {
    const double columns = std::ceil(kTwoPi / options.azimuth_step_rad - kStepSlack);
    for (double i = 0.0; i < columns; i += 1.0) azimuths_.push_back(options.azimuth_start_rad + kTwoPi * i / columns);
    elevations_ = spread(std::max(-kPi / 2, options.elevation_min_rad), kPi / 2, options.elevation_step_rad);
  }
  const auto elements = static_cast<std::size_t>(manifold_.size());
  groups_ = (size() + kernels::kLanes - 1) / kernels::kLanes;
  values_.assign(groups_ * 2 * elements * kernels::kLanes, 0.0F);
  bool any = false;
  ComplexVector a;
  for (std::size_t i = 0; i < size(); ++i) {
    if (!manifold_.steering(unit_vector(direction(i)), frequency_hz_, a)) continue;
    const double norm = a.norm();
    if (!(norm > 0.0)) continue;
    any = true;
    float* const group = values_.data() + i / kernels::kLanes * 2 * elements * kernels::kLanes + i % kernels::kLanes;
    for (std::size_t m = 0; m < elements; ++m) {
      const Cf64 value = a[static_cast<Eigen::Index>(m)] / norm;
      group[2 * m * kernels::kLanes] = static_cast<float>(value.real());
      group[(2 * m + 1) * kernels::kLanes] = static_cast<float>(value.imag());
    }
  }
  require(any, "manifold", geometry.name(), "its responses reach none of the grid's directions");
  mirror_ = geometry.rank() == 1 || (geometry.rank() == 2 && sides_alike());
}

// Whether every direction of the grid behind the plane answers as its image in front does, up to a common factor.
bool SteeringTable::sides_alike() const noexcept {
  if (!manifold_.grid()) return true;
  const Eigen::Vector3d& normal = manifold_.geometry().axis();
  ComplexVector behind, front;
  for (std::size_t i = 0; i < size(); ++i) {
    const Eigen::Vector3d u = unit_vector(direction(i));
    if (!(normal.dot(u) < -kOnPlane) || !manifold_.steering(u, frequency_hz_, behind)) continue;
    if (!manifold_.steering(u - 2.0 * normal.dot(u) * normal, frequency_hz_, front)) return false;
    const double common = std::norm(behind.dot(front)), whole = behind.squaredNorm() * front.squaredNorm();
    if (!(common >= (1.0 - kAlike) * whole)) return false;
  }
  return true;
}

}  // namespace soopnav::array
