#include "soopnav/array/manifold.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "array/require.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::array {

namespace {

constexpr double kSlopeStepRad = 1e-3;
constexpr double kDegree = kPi / 180.0;

bool finite(const Cf64& value) { return std::isfinite(value.real()) && std::isfinite(value.imag()); }

void require_even(const char* name, const std::vector<double>& grid) {
  require(grid.size() >= 2, name, grid.size(), "at least 2 grid values expected");
  const double step = (grid.back() - grid.front()) / static_cast<double>(grid.size() - 1);
  require(std::isfinite(step) && step > 0.0, name, step, "ascending finite grid values expected");
  for (std::size_t i = 0; i < grid.size(); ++i) {
    const double even = grid.front() + step * static_cast<double>(i);
    require(std::abs(grid[i] - even) < 1e-6 * step, name, grid[i], "this grid value is not evenly spaced");
  }
}

/// Where `x` lies on a grid: index of the value below, and the share of the one above.
struct Place {
  std::size_t low, high;
  double share;
};

}  // namespace

Manifold::Manifold(ArrayGeometry geometry) : geometry_(std::move(geometry)) { factors_.setOnes(geometry_.size()); }

Manifold::Manifold(ArrayGeometry geometry, ResponseGrid grid) : Manifold(std::move(geometry)) {
  require(!grid.frequency_hz.empty(), "frequency_hz", 0, "at least 1 grid value expected");
  for (std::size_t i = 0; i < grid.frequency_hz.size(); ++i) {
    const double f = grid.frequency_hz[i];
    require(std::isfinite(f) && f > 0.0 && (i == 0 || f > grid.frequency_hz[i - 1]), "frequency_hz", f,
            "ascending positive grid values expected");
  }
  require_even("azimuth", grid.azimuth_rad);
  require_even("elevation", grid.elevation_rad);
  require(std::abs(grid.elevation_rad.front()) < kPi / 2 + 1e-9 && std::abs(grid.elevation_rad.back()) < kPi / 2 + 1e-9,
          "elevation", grid.elevation_rad.back(), "grid values within +- 90 degrees expected");
  const double step = grid.azimuth_rad[1] - grid.azimuth_rad[0];
  const double around = grid.azimuth_rad.back() - grid.azimuth_rad.front() + step;
  require(around < kTwoPi + 1e-6 * step, "azimuth", grid.azimuth_rad.back(),
          "grid values of less than a turn expected");
  periodic_ = std::abs(around - kTwoPi) < 1e-6 * step;
  const auto elements = static_cast<std::size_t>(size());
  const std::size_t cells = grid.frequency_hz.size() * grid.elevation_rad.size() * grid.azimuth_rad.size();
  require(grid.correction.size() == cells * elements, "response", grid.correction.size(),
          "one value for each element, frequency, elevation and azimuth expected");
  const auto hole = std::find_if_not(grid.correction.begin(), grid.correction.end(), finite);
  if (hole != grid.correction.end()) {
    const auto holes = std::count_if(hole, grid.correction.end(), [](const Cf64& value) { return !finite(value); });
    auto at = static_cast<std::size_t>(hole - grid.correction.begin());
    const std::size_t element = at % elements;
    at /= elements;
    const double azimuth = grid.azimuth_rad[at % grid.azimuth_rad.size()];
    at /= grid.azimuth_rad.size();
    std::ostringstream where;
    where << "element " << element << ", azimuth " << azimuth / kDegree << " deg, elevation "
          << grid.elevation_rad[at % grid.elevation_rad.size()] / kDegree << " deg, "
          << grid.frequency_hz[at / grid.elevation_rad.size()] << " Hz";
    require(false, "response", std::to_string(holes) + " holes, the first at " + where.str(),
            "every grid point needs a finite value");
  }
  grid_ = std::move(grid);
}

Manifold Manifold::with_errors(std::span<const double> gain_db, std::span<const double> phase_rad) const {
  const auto elements = static_cast<std::size_t>(size());
  require(gain_db.size() == elements, "gain_db", gain_db.size(), "one value per element expected");
  require(phase_rad.size() == elements, "phase_rad", phase_rad.size(), "one value per element expected");
  Manifold out = *this;
  for (std::size_t m = 0; m < elements; ++m) {
    require(std::isfinite(gain_db[m]) && std::abs(gain_db[m]) <= 300.0, "gain_db", gain_db[m],
            "-300 to 300 dB expected");
    require(std::isfinite(phase_rad[m]), "phase_rad", phase_rad[m], "a finite phase expected");
    out.factors_[static_cast<Eigen::Index>(m)] *= std::polar(std::pow(10.0, gain_db[m] / 20.0), phase_rad[m]);
  }
  out.errors_ = true;
  return out;
}

Manifold Manifold::with_coupling(const ComplexMatrix& coupling) const {
  require(coupling.rows() == size() && coupling.cols() == size(), "coupling", coupling.rows(),
          "a square matrix with one row per element expected");
  for (Eigen::Index i = 0; i < coupling.size(); ++i) {
    require(finite(coupling.data()[i]), "coupling", i, "this value is not finite");
  }
  Manifold out = *this;
  if (coupling_) {
    const ComplexMatrix before = *coupling_;
    out.coupling_ = coupling.lazyProduct(before);
  } else {
    out.coupling_ = coupling;
  }
  return out;
}

// Trilinear in frequency, elevation and azimuth.
bool Manifold::response(const Eigen::Vector3d& u, double frequency_hz, ComplexVector& out) const noexcept {
  const auto& [frequencies, azimuths, elevations, correction] = *grid_;
  const Direction direction = direction_of(u);
  const double az_step = azimuths[1] - azimuths[0];
  const double el_step = elevations[1] - elevations[0];
  double x = (direction.azimuth_rad - azimuths.front()) / az_step;
  const auto columns = static_cast<double>(azimuths.size());
  if (periodic_) {
    x -= columns * std::floor(x / columns);
  } else {
    const double turn = kTwoPi / az_step;
    x -= turn * std::floor((x + 1e-6) / turn);
    const bool pole = std::abs(u[2]) > 1.0 - 1e-12;
    if (pole) x = std::clamp(x, 0.0, columns - 1.0);
    if (!(x < columns - 1.0 + 1e-6)) return false;
    x = std::clamp(x, 0.0, columns - 1.0);
  }
  double y = (direction.elevation_rad - elevations.front()) / el_step;
  const auto rows = static_cast<double>(elevations.size());
  if (!(y > -1e-6 && y < rows - 1.0 + 1e-6)) return false;
  y = std::clamp(y, 0.0, rows - 1.0);

  const auto place = [](double at, std::size_t count, bool around) {
    const auto low = std::min(static_cast<std::size_t>(at), around ? count - 1 : count - 2);
    return Place{low, (low + 1) % count, at - static_cast<double>(low)};
  };
  const Place az = place(x, azimuths.size(), periodic_);
  const Place el = place(y, elevations.size(), false);
  Place f{0, 0, 0.0};
  if (frequencies.size() > 1) {
    const double clamped = std::clamp(frequency_hz, frequencies.front(), frequencies.back());
    const auto above = std::upper_bound(frequencies.begin() + 1, frequencies.end() - 1, clamped);
    f.high = static_cast<std::size_t>(above - frequencies.begin());
    f.low = f.high - 1;
    f.share = (clamped - frequencies[f.low]) / (frequencies[f.high] - frequencies[f.low]);
  }
  const auto elements = static_cast<std::size_t>(size());
  out.setZero(size());
  for (int corner = 0; corner < 8; ++corner) {
    const bool up_f = (corner & 4) != 0, up_el = (corner & 2) != 0, up_az = (corner & 1) != 0;
    const double weight =
        (up_f ? f.share : 1.0 - f.share) * (up_el ? el.share : 1.0 - el.share) * (up_az ? az.share : 1.0 - az.share);
    if (weight == 0.0) continue;
    const std::size_t cell =
        ((up_f ? f.high : f.low) * elevations.size() + (up_el ? el.high : el.low)) * azimuths.size() +
        (up_az ? az.high : az.low);
    for (std::size_t m = 0; m < elements; ++m) {
      out[static_cast<Eigen::Index>(m)] += weight * correction[cell * elements + m];
    }
  }
  return true;
}

bool Manifold::steering(const Eigen::Vector3d& u, double frequency_hz, ComplexVector& out) const noexcept {
  ComplexVector plain;
  if (grid_) {
    if (!response(u, frequency_hz, plain)) return false;
  } else {
    plain.setOnes(size());
  }
  const double k = kTwoPi * frequency_hz / kSpeedOfLightMps;
  for (int m = 0; m < size(); ++m) {
    const double phase = k * geometry_.positions_m()[static_cast<std::size_t>(m)].dot(u);
    plain[m] *= factors_[m] * Cf64(std::cos(phase), std::sin(phase));
  }
  if (coupling_) {
    out = coupling_->lazyProduct(plain);
  } else {
    out = plain;
  }
  return true;
}

bool Manifold::steering(const Eigen::Vector3d& u, const Eigen::Vector3d& t0, const Eigen::Vector3d& t1,
                        double frequency_hz, SteeringJet& out) const noexcept {
  ComplexVector here, slope[2];
  const Eigen::Vector3d* const tangents[2] = {&t0, &t1};
  if (grid_) {
    if (!response(u, frequency_hz, here)) return false;
    for (int i = 0; i < 2; ++i) {
      ComplexVector after, before;
      double span = 2.0 * kSlopeStepRad;
      if (!response((u + kSlopeStepRad * *tangents[i]).normalized(), frequency_hz, after)) {
        after = here;
        span -= kSlopeStepRad;
      }
      if (!response((u - kSlopeStepRad * *tangents[i]).normalized(), frequency_hz, before)) {
        before = here;
        span -= kSlopeStepRad;
      }
      slope[i] = (after - before) / std::max(span, kSlopeStepRad);
    }
  } else {
    here.setOnes(size());
  }
  const double k = kTwoPi * frequency_hz / kSpeedOfLightMps;
  out.value.resize(size());
  for (auto& vector : out.first) vector.resize(size());
  for (auto& vector : out.second) vector.resize(size());
  for (int m = 0; m < size(); ++m) {
    const Eigen::Vector3d& r = geometry_.positions_m()[static_cast<std::size_t>(m)];
    const double phase = k * r.dot(u), k0 = k * r.dot(t0), k1 = k * r.dot(t1);
    const Cf64 wave = factors_[m] * Cf64(std::cos(phase), std::sin(phase));
    const Cf64 a = wave * here[m];
    const auto j = [](double x, const Cf64& z) { return Cf64(-x * z.imag(), x * z.real()); };
    out.value[m] = a;
    out.first[0][m] = j(k0, a);
    out.first[1][m] = j(k1, a);
    out.second[0][m] = -k0 * k0 * a - j(phase, a);  // a great circle turns towards -u
    out.second[1][m] = -k0 * k1 * a;
    out.second[2][m] = -k1 * k1 * a - j(phase, a);
    if (grid_) {
      const Cf64 s0 = wave * slope[0][m], s1 = wave * slope[1][m];
      out.first[0][m] += s0;
      out.first[1][m] += s1;
      out.second[0][m] += j(2.0 * k0, s0);
      out.second[1][m] += j(k0, s1) + j(k1, s0);
      out.second[2][m] += j(2.0 * k1, s1);
    }
  }
  if (coupling_) {
    const auto couple = [this](ComplexVector& vector) {
      const ComplexVector before = vector;
      vector = coupling_->lazyProduct(before);
    };
    couple(out.value);
    for (auto& vector : out.first) couple(vector);
    for (auto& vector : out.second) couple(vector);
  }
  return true;
}

}  // namespace soopnav::array
