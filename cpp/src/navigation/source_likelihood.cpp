#include "soopnav/navigation/source_likelihood.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/target_clones.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/packet_math.hpp"

namespace soopnav::navigation {
namespace {

using P = Packet<double>;
using C = soopnav::detail::PacketConstants<double>;

// Places at a time: their sums stay in the first-level cache.
constexpr std::size_t kBlock = 256;
// Factors multiplied before a logarithm is taken: each is above 1e-19 unless a place is impossible anyway.
constexpr std::size_t kFactors = 12;
// The platform's own place has no direction: its squared distance is kept from zero.
constexpr double kMinSquare = 1e-6;

// Element by element, so that the widest vectors serve. (atan(x) / x - 1) / x^2 in x^2 <= (sqrt(2) - 1)^2 to 1e-13,
// which is as exact as a likelihood needs: the Chebyshev interpolant of the arc tangent's smooth part.
constexpr std::array<double, 7> kAtan = {-0.04043225363148022, 0.07135325398001925, -0.09028983553586428,
                                         0.11107495140494247,  -0.1428561251158461, 0.19999998917291675,
                                         -0.33333333331440734};

// |atan2(y, x)| in [0, pi].
SOOPNAV_INLINE double turn_of(double y, double x) noexcept {
  const double ax = std::fabs(x);
  const double ay = std::fabs(y);
  const double low = ax < ay ? ax : ay;
  const double high = ax < ay ? ay : ax;
  // atan(low / high) = pi/4 + atan((low - high) / (low + high)) where the ratio is above tan(pi/8).
  const bool upper = low > high * 0.41421356237309503;
  const double t = (upper ? low - high : low) / ((upper ? low + high : high) + 1e-300);
  const double z = t * t;
  double sum = kAtan[0];
  for (std::size_t k = 1; k < kAtan.size(); ++k) sum = sum * z + kAtan[k];
  const double eighth = (t + t * z * sum) + (upper ? 0.25 * kPi : 0.0);
  const double quarter = ay > ax ? 0.5 * kPi - eighth : eighth;
  return x < 0.0 ? kPi - quarter : quarter;
}

// e^-x for x >= 0. Below 1e-304 it stays there: numbers that are not normal would cost a hundred times as much.
SOOPNAV_INLINE double decay(double x) noexcept {
  const double inside = x < 700.0 ? -x : -700.0;
  const double shifted = inside * 1.4426950408889634 + C::kMagic;
  const double n = shifted - C::kMagic;
  const double r = (inside - n * C::kLn2High) - n * C::kLn2Low;
  double sum = C::kExp[0];
  for (std::size_t k = 1; k < C::kExp.size(); ++k) sum = sum * r + C::kExp[k];
  const double e = 1.0 + (r + r * r * sum);
  const std::int64_t exponent = (std::bit_cast<std::int64_t>(shifted) << C::kMantissa) + (C::kBias << C::kMantissa);
  return e * std::bit_cast<double>(exponent);
}

// What a bearing contributes beside its geometry.
struct Density {
  double half_inverse_azimuth = 0.0;  // 1 / (2 variance)
  double half_inverse_elevation = 0.0;
  double floor = 0.0;  // relative to the largest value of the normal part
  double log_top = 0.0;

  Density(const PackedBearing& b, double outlier, bool space) {
    half_inverse_azimuth = 0.5 / b.variance_azimuth;
    half_inverse_elevation = space ? 0.5 / b.variance_elevation : 0.0;
    const double volume =
        space ? kTwoPi * std::sqrt(b.variance_azimuth * b.variance_elevation) : std::sqrt(kTwoPi * b.variance_azimuth);
    const double top = (1.0 - outlier) / volume;
    floor = outlier / (space ? kTwoPi * kPi : kTwoPi) / top;
    log_top = std::log(top);
  }
};

// Half the squared azimuth error in its standard deviations. The turn from the measured azimuth needs no wrapping.
SOOPNAV_TARGET_CLONES_WIDE
void plane_exponents(const PackedBearing& b, double half_inverse, const double* __restrict x,
                     const double* __restrict y, std::size_t n, double* __restrict exponent) noexcept {
  const double bx = b.x, by = b.y, c = b.cos_azimuth, s = b.sin_azimuth;
  for (std::size_t i = 0; i < n; ++i) {
    const double dx = x[i] - bx;
    const double dy = y[i] - by;
    const double error = turn_of(dy * c - dx * s, dx * c + dy * s);
    exponent[i] = error * error * half_inverse;
  }
}

// What the platform's covariance leaves across the line: exponents scaled, and the ratio of variances into `share`.
SOOPNAV_TARGET_CLONES_WIDE
void spread_azimuth(const PackedBearing& b, const double* __restrict x, const double* __restrict y, std::size_t n,
                    double* __restrict exponent, double* __restrict share) noexcept {
  const double bx = b.x, by = b.y, xx = b.xx, xy = b.xy, yy = b.yy, variance = b.variance_azimuth;
  for (std::size_t i = 0; i < n; ++i) {
    const double dx = x[i] - bx;
    const double dy = y[i] - by;
    const double level = dx * dx + dy * dy + kMinSquare;
    const double across = (dy * dy * xx - 2.0 * dx * dy * xy + dx * dx * yy) / (level * level);
    const double ratio = variance / (variance + across);
    exponent[i] *= ratio;
    share[i] = ratio;
  }
}

// Adds the elevation's part; `range` is the horizontal distance.
SOOPNAV_TARGET_CLONES_WIDE
void add_elevation(const PackedBearing& b, double half_inverse, const double* __restrict x, const double* __restrict y,
                   const double* __restrict z, const double* __restrict range, std::size_t n,
                   double* __restrict exponent, double* __restrict share) noexcept {
  const double bx = b.x, by = b.y, bz = b.z, variance = b.variance_elevation, measured = b.elevation;
  const double xx = b.xx, yy = b.yy, zz = b.zz, xy = 2.0 * b.xy, xz = 2.0 * b.xz, yz = 2.0 * b.yz;
  for (std::size_t i = 0; i < n; ++i) {
    const double dz = z[i] - bz;
    const double up = turn_of(dz, range[i]);
    const double miss = (dz < 0.0 ? -up : up) - measured;
    const double level = range[i] * range[i];
    const double square = level + dz * dz;
    // Gradient of the elevation with respect to the platform: (dx dz, dy dz, -level) / (square * range).
    const double gx = (x[i] - bx) * dz;
    const double gy = (y[i] - by) * dz;
    const double gz = -level;
    const double form = gx * gx * xx + gy * gy * yy + gz * gz * zz + gx * gy * xy + gx * gz * xz + gy * gz * yz;
    const double ratio = variance / (variance + form / (level * square * square));
    exponent[i] += miss * miss * ratio * half_inverse;
    share[i] *= ratio;
  }
}

SOOPNAV_TARGET_CLONES_WIDE
void subtract(const double* __restrict exponent, std::size_t n, double* __restrict logs) noexcept {
  for (std::size_t i = 0; i < n; ++i) logs[i] -= exponent[i];
}
SOOPNAV_TARGET_CLONES_WIDE
void multiply(const double* __restrict factor, std::size_t n, double* __restrict product) noexcept {
  for (std::size_t i = 0; i < n; ++i) product[i] *= factor[i];
}
SOOPNAV_TARGET_CLONES_WIDE
void multiply_density(const double* __restrict exponent, double floor, std::size_t n,
                      double* __restrict product) noexcept {
  for (std::size_t i = 0; i < n; ++i) product[i] *= decay(exponent[i]) + floor;
}
SOOPNAV_TARGET_CLONES_WIDE
void multiply_shrunk(const double* __restrict exponent, const double* __restrict shrink, double floor, std::size_t n,
                     double* __restrict product) noexcept {
  for (std::size_t i = 0; i < n; ++i) product[i] *= decay(exponent[i]) * shrink[i] + floor;
}

void roots(std::size_t n, double* values) noexcept {
  for (std::size_t i = 0; i < n; i += P::kWidth) sqrt(P::load(values + i)).store(values + i);
}

using Block = std::array<double, kBlock>;

// Exponents of the places from `at` on; `shrink` is the root of the ratio of variances unless the bearing is simple.
bool errors_of(const PackedBearing& b, const Density& d, const Places& places, std::size_t at, std::size_t n,
               Block& exponent, Block& shrink) noexcept {
  const double* const x = places.x.data() + at;
  const double* const y = places.y.data() + at;
  plane_exponents(b, d.half_inverse_azimuth, x, y, n, exponent.data());
  const bool space = !places.z.empty();
  if (!space && b.exact_platform()) return false;
  spread_azimuth(b, x, y, n, exponent.data(), shrink.data());
  if (space) {
    Block range;
    for (std::size_t i = 0; i < n; i += P::kWidth) {
      const P dx = P::load(x + i) - P(b.x);
      const P dy = P::load(y + i) - P(b.y);
      sqrt(dx * dx + dy * dy + P(kMinSquare)).store(&range[i]);
    }
    add_elevation(b, d.half_inverse_elevation, x, y, places.z.data() + at, range.data(), n, exponent.data(),
                  shrink.data());
  }
  roots(n, shrink.data());
  return true;
}

void take_logs(std::size_t n, Block& product, double* logs) noexcept {
  for (std::size_t i = 0; i < n; i += P::kWidth) {
    (P::load(logs + i) + log(P::load(&product[i]))).store(logs + i);
    P(1).store(&product[i]);
  }
}

void refuse(const std::string& text) { throw std::invalid_argument(text); }

}  // namespace

void add_log_likelihood(std::span<const PackedBearing> bearings, const Places& places, double outlier_probability,
                        std::span<double> log_likelihood) noexcept {
  const bool space = !places.z.empty();
  const bool floor = outlier_probability > 0.0;
  Block exponent;
  Block shrink;
  Block product;
  product.fill(1.0);
  for (std::size_t at = 0; at < log_likelihood.size(); at += kBlock) {
    const std::size_t n = std::min(kBlock, log_likelihood.size() - at);
    double* const logs = log_likelihood.data() + at;
    double top = 0.0;
    std::size_t factors = 0;
    for (const PackedBearing& b : bearings) {
      const Density d(b, outlier_probability, space);
      top += d.log_top;
      const bool shrunk = errors_of(b, d, places, at, n, exponent, shrink);
      if (!floor) {
        subtract(exponent.data(), n, logs);
        if (!shrunk) continue;
        multiply(shrink.data(), n, product.data());
      } else if (shrunk) {
        multiply_shrunk(exponent.data(), shrink.data(), d.floor, n, product.data());
      } else {
        multiply_density(exponent.data(), d.floor, n, product.data());
      }
      if (++factors == kFactors) {
        take_logs(n, product, logs);
        factors = 0;
      }
    }
    if (factors > 0) take_logs(n, product, logs);
    for (std::size_t i = 0; i < n; ++i) logs[i] += top;
  }
}

WeightSum weigh_places(const PackedBearing& bearing, const Places& places, double outlier_probability, double scale,
                       std::span<double> weights) noexcept {
  const Density density(bearing, outlier_probability, !places.z.empty());
  Block exponent;
  Block shrink;
  P sums(0);
  P squares(0);
  for (std::size_t at = 0; at < weights.size(); at += kBlock) {
    const std::size_t n = std::min(kBlock, weights.size() - at);
    double* const w = weights.data() + at;
    if (errors_of(bearing, density, places, at, n, exponent, shrink)) {
      multiply_shrunk(exponent.data(), shrink.data(), density.floor, n, w);
    } else {
      multiply_density(exponent.data(), density.floor, n, w);
    }
    for (std::size_t i = 0; i < n; i += P::kWidth) {
      const P weight = P::load(w + i) * P(scale);
      weight.store(w + i);
      sums += weight;
      squares += weight * weight;
    }
  }
  return {sum(sums), sum(squares)};
}

void likelihood_surface(std::span<const PackedBearing> bearings, const SurfaceGrid& grid, double outlier_probability,
                        std::span<double> surface) {
  if (!(outlier_probability >= 0.0 && outlier_probability < 1.0)) {
    refuse("outlier_probability = " + std::to_string(outlier_probability) + ": [0, 1) expected");
  }
  if (!(grid.x_max_m > grid.x_min_m && grid.y_max_m > grid.y_min_m) || !std::isfinite(grid.x_max_m - grid.x_min_m) ||
      !std::isfinite(grid.y_max_m - grid.y_min_m)) {
    refuse("grid: finite limits expected, each maximum above its minimum");
  }
  if (grid.columns < 2 || grid.rows < 2 || surface.size() != grid.rows * grid.columns) {
    refuse("grid: at least two columns and rows expected, and a surface of rows * columns numbers");
  }
  const std::size_t width = (grid.columns + P::kWidth - 1) / P::kWidth * P::kWidth;
  std::vector<double> x(width), y(width), row(width);
  const auto place = [](double low, double high, std::size_t i, std::size_t n) {
    return low + (high - low) * static_cast<double>(std::min(i, n - 1)) / static_cast<double>(n - 1);
  };
  for (std::size_t i = 0; i < width; ++i) x[i] = place(grid.x_min_m, grid.x_max_m, i, grid.columns);
  for (std::size_t j = 0; j < grid.rows; ++j) {
    std::fill(y.begin(), y.end(), place(grid.y_min_m, grid.y_max_m, j, grid.rows));
    std::fill(row.begin(), row.end(), 0.0);
    add_log_likelihood(bearings, {x, y, {}}, outlier_probability, row);
    std::copy_n(row.begin(), grid.columns, surface.begin() + static_cast<std::ptrdiff_t>(j * grid.columns));
  }
}

}  // namespace soopnav::navigation
