#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "navigation/source_filter.hpp"
#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/chi_square.hpp"

// What a run of bearings says by itself, before any position: a mean direction, whether one far place explains them,
// and where the platform drove over the source.
namespace soopnav::navigation::detail {

// Of each of two tests, of calling bearings to a far source crossing.
inline constexpr double kParallelProbability = 0.01;
inline constexpr double kParallelDeviations = 2.326;  // the same of a normal number
inline constexpr double kFlip = 2.0 * kPi / 3.0;  // turn between two bearings that only a source on the way explains
inline constexpr double kFlipPlaces = 2.0;  // of the distance between the two places: as far as that source may be
inline constexpr double kStepAside = 0.05;  // of that distance: how far beside the singular line a search begins

// Sums from which the mean direction follows.
struct Heading {
  double c = 0.0, s = 0.0, weight = 0.0, elevation = 0.0, elevation_weight = 0.0;
  std::array<double, 3> place{};

  void add(const Kept& k) noexcept {
    const double w = 1.0 / k.b.variance_azimuth;
    c += w * k.b.cos_azimuth;
    s += w * k.b.sin_azimuth;
    weight += w;
    place[0] += w * k.b.x;
    place[1] += w * k.b.y;
    place[2] += w * k.b.z;
    const double v = 1.0 / k.b.variance_elevation;
    elevation += v * k.b.elevation;
    elevation_weight += v;
  }
};

// Whether one far place explains the bearings: their angles about the first one, regressed on 1 / range. O(1) each.
struct Sight {
  // Weighted sums of one angle e and of its slope t against 1 / range.
  struct Sums {
    double w = 0.0, t = 0.0, e = 0.0, tt = 0.0, te = 0.0, ee = 0.0;
    void add(double weight, double slope, double angle) noexcept {
      w += weight;
      t += weight * slope;
      e += weight * angle;
      tt += weight * slope * slope;
      te += weight * slope * angle;
      ee += weight * angle * angle;
    }
  };
  std::size_t count = 0;
  Kept first;
  Sums azimuth, elevation;

  void add(const Kept& k, bool space) noexcept {
    if (count++ == 0) first = k;
    const double dx = k.b.x - first.b.x;
    const double dy = k.b.y - first.b.y;
    const double c = first.b.cos_azimuth;
    const double s = first.b.sin_azimuth;
    const double turn = wrap_to_pi(k.azimuth - first.azimuth);
    if (!space) return azimuth.add(1.0 / k.b.variance_azimuth, s * dx - c * dy, turn);
    const double level = std::max(std::cos(first.b.elevation), 1e-3);
    const double rise = std::sin(first.b.elevation);
    azimuth.add(1.0 / k.b.variance_azimuth, (s * dx - c * dy) / level, turn);
    const double slope = rise * (c * dx + s * dy) - level * (k.b.z - first.b.z);
    elevation.add(1.0 / k.b.variance_elevation, slope, k.b.elevation - first.b.elevation);
  }

  // Of one direction.
  [[nodiscard]] double chi_square(bool space) const noexcept {
    const double up = space ? elevation.ee - elevation.e * elevation.e / elevation.w : 0.0;
    return azimuth.ee - azimuth.e * azimuth.e / azimuth.w + up;
  }

  // Neither do the angles scatter more than they should, nor do they turn as towards a near place.
  [[nodiscard]] bool parallel(bool space) const noexcept {
    if (count < 2) return true;
    const double chi = chi_square(space);
    double information = azimuth.tt - azimuth.t * azimuth.t / azimuth.w;
    double score = azimuth.te - azimuth.t * azimuth.e / azimuth.w;
    double dof = static_cast<double>(count) - 1.0;
    if (space) {
      information += elevation.tt - elevation.t * elevation.t / elevation.w;
      score += elevation.te - elevation.t * elevation.e / elevation.w;
      dof *= 2.0;
    }
    if (information > 0.0 && score > kParallelDeviations * std::sqrt(information)) return false;
    return chi < chi_square_upper_quantile(kParallelProbability, dof);
  }
};

// Places where the direction turned round and stayed so: the platform drove over the source.
struct Flips {
  static constexpr std::size_t kSide = 3;  // bearings on either side that agree
  static constexpr std::size_t kMost = 3;
  struct Place {
    std::array<double, 2> at{};
    std::array<double, 2> across{};  // a step from the line between the two places, on which the cost is singular
    double apart_m = 0.0;
    double before = 0.0;  // azimuth
  };
  struct Seen {
    double x = 0.0, y = 0.0, azimuth = 0.0, variance = 0.0;
  };
  std::array<Seen, 2 * kSide> last{};
  std::size_t count = 0;  // bearings
  std::array<Place, kMost> places{};
  std::size_t found = 0;

  void add(const Kept& k) noexcept {
    std::move(last.begin() + 1, last.end(), last.begin());
    last.back() = {k.b.x, k.b.y, k.azimuth, k.b.variance_azimuth};
    if (++count < last.size()) return;
    const Seen& a = last[kSide - 1];
    const Seen& b = last[kSide];
    const auto turn = [](const Seen& one, const Seen& two) { return std::abs(wrap_to_pi(two.azimuth - one.azimuth)); };
    const double round = turn(a, b);
    if (round < kFlip) return;
    const double noise = 4.0 * std::sqrt(a.variance + b.variance);
    if (round < kFlip + noise) return;
    for (std::size_t i = 0; i + 1 < kSide; ++i) {
      if (turn(last[i], a) > 0.25 * kFlip + noise || turn(b, last[kSide + 1 + i]) > 0.25 * kFlip + noise) return;
    }
    if (found > 0) {  // turned back farther on: some bearings from elsewhere, and no source here
      const Place& one = places[(found - 1) % kMost];
      const double way = std::hypot(one.at[0] - b.x, one.at[1] - b.y);
      if (std::abs(wrap_to_pi(b.azimuth - one.before)) < 0.5 * kFlip && way > kFlipPlaces * one.apart_m) {
        --found;
        return;
      }
    }
    Place& to = places[found++ % kMost];
    to.before = a.azimuth;
    to.at = {0.5 * (a.x + b.x), 0.5 * (a.y + b.y)};
    to.across = {kStepAside * (a.y - b.y), kStepAside * (b.x - a.x)};
    to.apart_m = std::hypot(a.x - b.x, a.y - b.y);
  }
  [[nodiscard]] std::size_t size() const noexcept { return std::min(found, kMost); }
};

}  // namespace soopnav::navigation::detail
