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
#include "soopnav/estimation/particle_loop.hpp"

namespace soopnav::navigation {
namespace {

using P = Packet<double>;
using C = soopnav::detail::PacketConstants<double>;
using Cf = soopnav::detail::PacketConstants<float>;

// Places at a time: their sums stay in the first-level cache.
constexpr std::size_t kBlock = 256;
// Factors multiplied before a logarithm is taken: each is above 1e-19 unless a place is impossible anyway.
constexpr std::size_t kFactors = 12;
// Bearings at a time: what they have beside their geometry is worked out once.
constexpr std::size_t kPiece = 8 * kFactors;
// The platform's own place has no direction: its squared distance is kept from zero.
constexpr double kMinSquare = 1e-6;

// Element by element, so that the widest vectors serve. (atan(x) / x - 1) / x^2 in x^2 <= (sqrt(2) - 1)^2 to 1e-13,
// which is as exact as a likelihood needs: the Chebyshev interpolant of the arc tangent's smooth part.
constexpr std::array<double, 7> kAtan = {-0.04043225363148022, 0.07135325398001925, -0.09028983553586428,
                                         0.11107495140494247,  -0.1428561251158461, 0.19999998917291675,
                                         -0.33333333331440734};

constexpr std::array<float, 4> kAtanFloat = {0.0852049204F, -0.140241428F, 0.199912377F, -0.333332866F};

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

// The same in single precision, to 2e-7 rad.
SOOPNAV_INLINE float turn_of(float y, float x) noexcept {
  const float ax = std::fabs(x);
  const float ay = std::fabs(y);
  // What comes of each comparison is chosen at once: asked twice, a compiler works out both ways for every element.
  const bool steep = ay > ax;
  const float low = steep ? ax : ay;
  const float high = steep ? ay : ax;
  const float sign = steep ? -1.0F : 1.0F;
  const float corner = steep ? 1.57079633F : 0.0F;
  const bool upper = low > high * 0.41421356F;
  const float top = upper ? low - high : low;
  const float bottom = upper ? low + high : high;
  const float eighth = upper ? 0.785398163F : 0.0F;
  const float t = top / (bottom + 1e-30F);
  const float z = t * t;
  float sum = kAtanFloat[0];
  for (std::size_t k = 1; k < kAtanFloat.size(); ++k) sum = sum * z + kAtanFloat[k];
  const float quarter = corner + sign * (eighth + (t + t * z * sum));
  return x < 0.0F ? 3.14159265F - quarter : quarter;
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

// In single precision, for floors that leave nothing of what is lost below e^-80.
SOOPNAV_INLINE float decay(float x) noexcept {
  const float inside = -std::min(x, 80.0F);
  const float shifted = inside * 1.44269504F + Cf::kMagic;
  const float n = shifted - Cf::kMagic;
  const float r = (inside - n * Cf::kLn2High) - n * Cf::kLn2Low;
  float sum = static_cast<float>(Cf::kExp[0]);
  for (std::size_t k = 1; k < Cf::kExp.size(); ++k) sum = sum * r + static_cast<float>(Cf::kExp[k]);
  const float e = 1.0F + (r + r * r * sum);
  const std::int32_t exponent = (std::bit_cast<std::int32_t>(shifted) << Cf::kMantissa) + (Cf::kBias << Cf::kMantissa);
  return e * std::bit_cast<float>(exponent);
}

// What a bearing contributes beside its geometry.
struct Density {
  double half_inverse_azimuth = 0.0;  // 1 / (2 variance)
  double half_inverse_elevation = 0.0;
  double floor = 0.0;  // relative to the largest value of the normal part
  double log_top = 0.0;

  Density() = default;
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

// The same in single precision but for the differences of places: twice as fast, an angle to 3e-7 rad. Taken from
// logarithms, or as a density multiplied to products.
struct CoarseBearing {
  double x, y;
  float c, s, half_inverse, floor;

  CoarseBearing(const PackedBearing& b, const Density& d)
      : x(b.x),
        y(b.y),
        c(static_cast<float>(b.cos_azimuth)),
        s(static_cast<float>(b.sin_azimuth)),
        half_inverse(static_cast<float>(d.half_inverse_azimuth)),
        floor(static_cast<float>(d.floor)) {}
};
SOOPNAV_INLINE float coarse_exponent(double x, double y, const CoarseBearing& b) noexcept {
  const auto dx = static_cast<float>(x - b.x);
  const auto dy = static_cast<float>(y - b.y);
  const float error = turn_of(dy * b.c - dx * b.s, dx * b.c + dy * b.s);
  return error * error * b.half_inverse;
}
// Four bearings taken from logarithms at once, all lengths from a place near: single precision throughout.
struct NearBearings {
  std::array<float, 4> x, y, c, s, half_inverse;
};
SOOPNAV_TARGET_CLONES_WIDE
void subtract_near(const NearBearings& b, const float* __restrict x, const float* __restrict y, std::size_t n,
                   double* __restrict logs) noexcept {
  const NearBearings k = b;
  for (std::size_t i = 0; i < n; ++i) {
    float sum = 0.0F;
    for (std::size_t j = 0; j < 4; ++j) {
      const float dx = x[i] - k.x[j];
      const float dy = y[i] - k.y[j];
      const float error = turn_of(dy * k.c[j] - dx * k.s[j], dx * k.c[j] + dy * k.s[j]);
      sum += error * error * k.half_inverse[j];
    }
    logs[i] -= static_cast<double>(sum);
  }
}
SOOPNAV_TARGET_CLONES_WIDE
void multiply_coarse(CoarseBearing b, const double* __restrict x, const double* __restrict y, std::size_t n,
                     double* __restrict product) noexcept {
  for (std::size_t i = 0; i < n; ++i) {
    product[i] *= static_cast<double>(decay(coarse_exponent(x[i], y[i], b)) + b.floor);
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

// Packets: eight lanes whatever the vectors, so the same sums everywhere. `lanes`: eight sums, eight sums of squares.
SOOPNAV_INLINE void scale_and_sum_of(double scale, std::size_t n, double* w, double* lanes) noexcept {
  P sums = P::load(lanes);
  P squares = P::load(lanes + P::kWidth);
  for (std::size_t i = 0; i < n; i += P::kWidth) {
    const P weight = P::load(w + i) * P(scale);
    weight.store(w + i);
    sums += weight;
    squares += weight * weight;
  }
  sums.store(lanes);
  squares.store(lanes + P::kWidth);
}
// Compiled twice by hand: what target_clones copies has its packets taken apart for the baseline already.
void scale_and_sum_portable(double scale, std::size_t n, double* w, double* lanes) noexcept {
  scale_and_sum_of(scale, n, w, lanes);
}
#if SOOPNAV_WIDE_LOOPS
[[gnu::flatten, gnu::target("avx2")]] void scale_and_sum_wide(double scale, std::size_t n, double* w,
                                                              double* lanes) noexcept {
  scale_and_sum_of(scale, n, w, lanes);
}
#endif
void scale_and_sum(double scale, std::size_t n, double* w, double* lanes) noexcept {
#if SOOPNAV_WIDE_LOOPS
  if (soopnav::detail::has_wide_loops()) return scale_and_sum_wide(scale, n, w, lanes);
#endif
  scale_and_sum_portable(scale, n, w, lanes);
}

void roots(std::size_t n, double* values) noexcept {
  for (std::size_t i = 0; i < n; i += P::kWidth) sqrt(P::load(values + i)).store(values + i);
}

using Block = std::array<double, kBlock>;
using FloatBlock = std::array<float, kBlock>;

// Deviations above 1e-4 rad, against which single precision is nothing, and floors above what it holds.
bool coarse_enough(const PackedBearing& b, const Density& d, bool space) noexcept {
  return !space && b.exact_platform() && b.variance_azimuth > 1e-8 && (d.floor == 0.0 || d.floor > 1e-25);
}

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

// Adds the bearings' logarithms, without what all places have in common, for the places from `at` on.
void add_block(std::span<const PackedBearing> bearings, std::span<const Density> densities, const Places& places,
               std::size_t at, std::size_t n, bool floor, double* logs) noexcept {
  const bool space = !places.z.empty();
  Block exponent;
  Block shrink;
  Block product;
  product.fill(1.0);
  FloatBlock near_x;
  FloatBlock near_y;
  bool near_known = false;
  NearBearings near{};
  std::size_t waiting = 0;
  std::size_t factors = 0;
  for (std::size_t k = 0; k < bearings.size(); ++k) {
    const PackedBearing& b = bearings[k];
    const Density& d = densities[k];
    if (coarse_enough(b, d, space)) {
      if (!floor) {
        if (waiting == 0 && !near_known) {
          for (std::size_t i = 0; i < n; ++i) {
            near_x[i] = static_cast<float>(places.x[at + i] - places.x[at]);
            near_y[i] = static_cast<float>(places.y[at + i] - places.y[at]);
          }
          near_known = true;
        }
        near.x[waiting] = static_cast<float>(b.x - places.x[at]);
        near.y[waiting] = static_cast<float>(b.y - places.y[at]);
        near.c[waiting] = static_cast<float>(b.cos_azimuth);
        near.s[waiting] = static_cast<float>(b.sin_azimuth);
        near.half_inverse[waiting] = static_cast<float>(d.half_inverse_azimuth);
        if (++waiting == 4) {
          subtract_near(near, near_x.data(), near_y.data(), n, logs);
          waiting = 0;
        }
        continue;
      }
      multiply_coarse(CoarseBearing(b, d), &places.x[at], &places.y[at], n, product.data());
    } else {
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
    }
    if (++factors == kFactors) {
      take_logs(n, product, logs);
      factors = 0;
    }
  }
  if (waiting > 0) {  // those that are missing weigh nothing
    for (std::size_t j = waiting; j < 4; ++j) near.half_inverse[j] = 0.0F;
    subtract_near(near, near_x.data(), near_y.data(), n, logs);
  }
  if (factors > 0) take_logs(n, product, logs);
}

void refuse(const std::string& text) { throw std::invalid_argument(text); }

}  // namespace

void add_log_likelihood(std::span<const PackedBearing> bearings, const Places& places, double outlier_probability,
                        std::span<double> log_likelihood) noexcept {
  const bool space = !places.z.empty();
  std::array<Density, kPiece> densities;
  for (std::size_t from = 0; from < bearings.size(); from += kPiece) {
    const auto piece = bearings.subspan(from, std::min(kPiece, bearings.size() - from));
    double top = 0.0;
    for (std::size_t k = 0; k < piece.size(); ++k) {
      densities[k] = Density(piece[k], outlier_probability, space);
      top += densities[k].log_top;
    }
    const std::span<const Density> known(densities.data(), piece.size());
    for (std::size_t at = 0; at < log_likelihood.size(); at += kBlock) {
      const std::size_t n = std::min(kBlock, log_likelihood.size() - at);
      add_block(piece, known, places, at, n, outlier_probability > 0.0, log_likelihood.data() + at);
      for (std::size_t i = 0; i < n; ++i) log_likelihood[at + i] += top;
    }
  }
}

WeightSum weigh_places(const PackedBearing& bearing, const Places& places, double outlier_probability, double scale,
                       std::span<double> weights) noexcept {
  const Density density(bearing, outlier_probability, !places.z.empty());
  const bool coarse = density.floor > 0.0 && coarse_enough(bearing, density, !places.z.empty());
  Block exponent;
  Block shrink;
  std::array<double, 16> lanes{};
  for (std::size_t at = 0; at < weights.size(); at += kBlock) {
    const std::size_t n = std::min(kBlock, weights.size() - at);
    double* const w = weights.data() + at;
    if (coarse) {
      multiply_coarse(CoarseBearing(bearing, density), &places.x[at], &places.y[at], n, w);
    } else if (errors_of(bearing, density, places, at, n, exponent, shrink)) {
      multiply_shrunk(exponent.data(), shrink.data(), density.floor, n, w);
    } else {
      multiply_density(exponent.data(), density.floor, n, w);
    }
    scale_and_sum(scale, n, w, lanes.data());
  }
  return {sum(P::load(lanes.data())), sum(P::load(lanes.data() + 8))};
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
  const std::size_t count = (surface.size() + P::kWidth - 1) / P::kWidth * P::kWidth;
  std::vector<double> x(count), y(count), values(count);
  const auto place = [](double low, double high, std::size_t i, std::size_t n) {
    return low + (high - low) * static_cast<double>(i) / static_cast<double>(n - 1);
  };
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t at = std::min(i, surface.size() - 1);
    x[i] = place(grid.x_min_m, grid.x_max_m, at % grid.columns, grid.columns);
    y[i] = place(grid.y_min_m, grid.y_max_m, at / grid.columns, grid.rows);
  }
  add_log_likelihood(bearings, {x, y, {}}, outlier_probability, values);
  std::copy_n(values.begin(), surface.size(), surface.begin());
}

}  // namespace soopnav::navigation
