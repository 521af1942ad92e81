#include "soopnav/array/geometry.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <utility>

#include "array/require.hpp"
#include "soopnav/array/types.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::array {

namespace {

constexpr double kCoincidentWavelengths = 1e-6;
constexpr double kWholeCycles = 1e-6;
constexpr double kFlat = 1e-9;  // of the aperture
constexpr std::size_t kMaxAmbiguities = 4096;

void require_count(const char* name, int count, int least) {
  require(count >= least && count <= kMaxElements, name, count, "2 to 32 elements expected");
}

void require_length(const char* name, double length) {
  require(std::isfinite(length) && length > 0.0, name, length, "a positive finite number of wavelengths expected");
}

double wavelength(double frequency_hz) {
  require(std::isfinite(frequency_hz) && frequency_hz > 0.0, "frequency_hz", frequency_hz,
          "a positive finite frequency expected");
  return kSpeedOfLightMps / frequency_hz;
}

}  // namespace

Eigen::Vector3d unit_vector(const Direction& direction) noexcept {
  const double flat = std::cos(direction.elevation_rad);
  return {flat * std::cos(direction.azimuth_rad), flat * std::sin(direction.azimuth_rad),
          std::sin(direction.elevation_rad)};
}

Direction direction_of(const Eigen::Vector3d& u) noexcept {
  const double flat = std::hypot(u[0], u[1]);
  return {flat > 1e-14 * std::abs(u[2]) ? std::atan2(u[1], u[0]) : 0.0, std::atan2(u[2], flat)};
}

ArrayGeometry::ArrayGeometry(std::vector<Eigen::Vector3d> positions_m, double frequency_hz, std::string name)
    : positions_m_(std::move(positions_m)),
      frequency_hz_(frequency_hz),
      wavelength_m_(wavelength(frequency_hz)),
      name_(std::move(name)) {
  const auto count = positions_m_.size();
  require(count >= 2 && count <= static_cast<std::size_t>(kMaxElements), "positions_m", count,
          "2 to 32 elements expected");
  smallest_spacing_m_ = std::numeric_limits<double>::infinity();
  for (std::size_t m = 0; m < count; ++m) {
    require(positions_m_[m].allFinite(), "positions_m", m, "the position of this element is not finite");
    for (std::size_t n = 0; n < m; ++n) {
      const double distance_m = (positions_m_[m] - positions_m_[n]).norm();
      if (!(distance_m > kCoincidentWavelengths * wavelength_m_)) {
        require(false, "positions_m", std::to_string(n) + " and " + std::to_string(m),
                "these elements lie on one point");
      }
      aperture_m_ = std::max(aperture_m_, distance_m);
      smallest_spacing_m_ = std::min(smallest_spacing_m_, distance_m);
    }
  }
  require(std::isfinite(aperture_m_ / wavelength_m_), "positions_m", aperture_m_, "too far apart");
  find_span();
  find_ambiguities();
}

ArrayGeometry ArrayGeometry::ula(int count, double spacing_wavelengths, double frequency_hz) {
  require_count("n", count, 2);
  require_length("spacing_wavelengths", spacing_wavelengths);
  std::vector<Eigen::Vector3d> positions;
  for (int m = 0; m < count; ++m) {
    positions.emplace_back(m * spacing_wavelengths * wavelength(frequency_hz), 0.0, 0.0);
  }
  return {std::move(positions), frequency_hz, "ULA " + std::to_string(count)};
}

ArrayGeometry ArrayGeometry::uca(int count, double radius_wavelengths, double frequency_hz) {
  require_count("n", count, 2);
  require_length("radius_wavelengths", radius_wavelengths);
  const double radius_m = radius_wavelengths * wavelength(frequency_hz);
  std::vector<Eigen::Vector3d> positions;
  for (int m = 0; m < count; ++m) {
    const double angle = 2.0 * std::numbers::pi * m / count;
    positions.emplace_back(radius_m * std::cos(angle), radius_m * std::sin(angle), 0.0);
  }
  return {std::move(positions), frequency_hz, "UCA " + std::to_string(count)};
}

ArrayGeometry ArrayGeometry::planar(int columns, int rows, double spacing_wavelengths, double frequency_hz) {
  require(columns >= 1, "nx", columns, "at least 1 expected");
  require(rows >= 1, "ny", rows, "at least 1 expected");
  require(columns <= kMaxElements && rows <= kMaxElements && columns * rows >= 2 && columns * rows <= kMaxElements,
          "nx * ny", static_cast<double>(columns) * rows, "2 to 32 elements expected");
  require_length("spacing_wavelengths", spacing_wavelengths);
  const double spacing_m = spacing_wavelengths * wavelength(frequency_hz);
  std::vector<Eigen::Vector3d> positions;
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) positions.emplace_back(column * spacing_m, row * spacing_m, 0.0);
  }
  return {std::move(positions), frequency_hz, "planar " + std::to_string(columns) + "x" + std::to_string(rows)};
}

// Gram-Schmidt with the longest remainder first: the rank is the number of remainders that are not rounding.
void ArrayGeometry::find_span() {
  std::vector<Eigen::Vector3d> rest;
  for (const auto& position : positions_m_) rest.emplace_back(position - positions_m_.front());
  for (rank_ = 0; rank_ < 3; ++rank_) {
    const auto longest = std::max_element(
        rest.begin(), rest.end(), [](const auto& a, const auto& b) { return a.squaredNorm() < b.squaredNorm(); });
    if (!(longest->norm() > kFlat * aperture_m_)) break;
    const Eigen::Vector3d along = longest->normalized();
    span_.col(rank_) = along;
    for (auto& vector : rest) vector -= along * along.dot(vector);
  }
  if (rank_ == 1) axis_ = span_.col(0);
  if (rank_ == 2) axis_ = span_.col(0).cross(span_.col(1)).normalized();
  if (rank_ == 3) return;
  for (Eigen::Index i = 0; i < 3; ++i) {
    if (std::abs(axis_[i]) < 1e-12) axis_[i] = 0.0;
  }
  // The reported side is the one with axis 3, or axis 1, or axis 2.
  const double sign = rank_ == 1        ? (axis_[0] != 0.0   ? axis_[0]
                                           : axis_[1] != 0.0 ? axis_[1]
                                                             : axis_[2])
                      : axis_[2] != 0.0 ? axis_[2]
                      : axis_[0] != 0.0 ? axis_[0]
                                        : axis_[1];
  if (sign < 0.0) axis_ = -axis_;
}

// Whole cycles on `rank` independent baselines give every candidate difference; the other baselines confirm it.
void ArrayGeometry::find_ambiguities() {
  std::vector<Eigen::Vector3d> baselines;
  for (std::size_t m = 0; m < positions_m_.size(); ++m) {
    for (std::size_t n = 0; n < m; ++n) baselines.emplace_back((positions_m_[m] - positions_m_[n]) / wavelength_m_);
  }
  std::stable_sort(baselines.begin(), baselines.end(),
                   [](const auto& a, const auto& b) { return a.squaredNorm() < b.squaredNorm(); });
  Eigen::Matrix3d rows = Eigen::Matrix3d::Zero();  // in span coordinates
  Eigen::Matrix3d orthogonal = Eigen::Matrix3d::Zero();
  int found = 0;
  int most[3] = {0, 0, 0};
  for (const auto& baseline : baselines) {
    if (found == rank_) break;
    Eigen::Vector3d rest = baseline;
    for (int i = 0; i < found; ++i) rest -= orthogonal.col(i) * orthogonal.col(i).dot(baseline);
    if (!(rest.norm() > 1e-6 * baseline.norm())) continue;
    orthogonal.col(found) = rest.normalized();
    rows.row(found) = (span_.transpose() * baseline).transpose();
    most[found] = static_cast<int>(std::min(60.0, std::floor(2.0 * baseline.norm() + kWholeCycles)));
    ++found;
  }
  for (int i = found; i < 3; ++i) rows(i, i) = 1.0;
  const Eigen::Matrix3d inverse = rows.inverse();
  for (int i = -most[0]; i <= most[0]; ++i) {
    for (int j = -most[1]; j <= most[1]; ++j) {
      for (int k = -most[2]; k <= most[2]; ++k) {
        if (i == 0 && j == 0 && k == 0) continue;
        const Eigen::Vector3d difference = span_ * (inverse * Eigen::Vector3d(i, j, k));
        if (difference.norm() > 2.0 + 1e-9) continue;
        const bool whole = std::all_of(baselines.begin(), baselines.end(), [&](const auto& baseline) {
          const double cycles = baseline.dot(difference);
          return std::abs(cycles - std::round(cycles)) < kWholeCycles;
        });
        if (whole && ambiguities_.size() < kMaxAmbiguities) ambiguities_.push_back(difference);
      }
    }
  }
}

bool ArrayGeometry::ambiguous() const noexcept {
  return std::any_of(ambiguities_.begin(), ambiguities_.end(), [](const auto& d) { return d.norm() < 2.0 - 1e-9; });
}

Eigen::Vector3d ArrayGeometry::reported_side(const Eigen::Vector3d& u) const noexcept {
  if (rank_ == 3) return u;
  const double along = axis_.dot(u);
  if (rank_ == 2) return along < 0.0 ? Eigen::Vector3d(u - 2.0 * along * axis_) : u;
  const double c = std::clamp(along, -1.0, 1.0);
  Eigen::Vector3d across = Eigen::Vector3d::UnitZ().cross(axis_);
  across = across.norm() > 1e-9 ? Eigen::Vector3d(across.normalized()) : Eigen::Vector3d(Eigen::Vector3d::UnitX());
  return c * axis_ + std::sqrt(1.0 - c * c) * across;
}

std::vector<Direction> ArrayGeometry::ambiguous_directions(const Direction& direction) const {
  const Eigen::Vector3d u = reported_side(unit_vector(direction));
  require(u.allFinite(), "direction", direction.azimuth_rad, "azimuth and elevation must be finite");
  std::vector<Direction> out;
  for (const auto& difference : ambiguities_) {
    const Eigen::Vector3d inside = span_ * (span_.transpose() * u) - difference;  // what the elements see of u'
    const double squared = inside.squaredNorm();
    if (squared > 1.0 + 1e-9) continue;
    if (rank_ == 3) {
      if (std::abs(squared - 1.0) < 1e-6) out.push_back(direction_of(inside));
      continue;
    }
    const double rest = std::sqrt(std::max(0.0, 1.0 - squared));
    if (rank_ == 1) {
      out.push_back(direction_of(reported_side(inside + rest * span_.col(0).unitOrthogonal())));
    } else {
      out.push_back(direction_of(inside + rest * axis_));
    }
  }
  return out;
}

}  // namespace soopnav::array
