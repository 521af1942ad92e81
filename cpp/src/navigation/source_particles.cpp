#include "navigation/source_particles.hpp"

#include <algorithm>
#include <cmath>

#include "core/target_clones.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/packet.hpp"
#include "soopnav/estimation/particle_loop.hpp"
#include "soopnav/estimation/resampling.hpp"

namespace soopnav::navigation::detail {
namespace {

using P = Packet<double>;

std::size_t padded(std::size_t n) { return (n + P::kWidth - 1) / P::kWidth * P::kWidth; }

// Sum of w (x - mx), or of w (x - mx) (y - my). Packets: eight lanes whatever the vectors, so the same sums everywhere.
struct Product {
  const double* w;
  const double* x;
  const double* y;  // null: the sum
  double mx, my;
};
SOOPNAV_INLINE double sum_of(const Product& p, std::size_t n) noexcept {
  P total(0);
  if (p.y == nullptr) {
    for (std::size_t i = 0; i < n; i += P::kWidth) total += P::load(p.w + i) * (P::load(p.x + i) - P(p.mx));
  } else {
    for (std::size_t i = 0; i < n; i += P::kWidth) {
      total += P::load(p.w + i) * (P::load(p.x + i) - P(p.mx)) * (P::load(p.y + i) - P(p.my));
    }
  }
  return sum(total);
}
double sum_portable(const Product& p, std::size_t n) noexcept { return sum_of(p, n); }
#if SOOPNAV_WIDE_LOOPS
[[gnu::flatten, gnu::target("avx2")]] double sum_wide(const Product& p, std::size_t n) noexcept { return sum_of(p, n); }
#endif
double weighted(const Product& p, std::size_t n) noexcept {
#if SOOPNAV_WIDE_LOOPS
  if (soopnav::detail::has_wide_loops()) return sum_wide(p, n);
#endif
  return sum_portable(p, n);
}

SOOPNAV_TARGET_CLONES_WIDE
void add_scaled(const float* __restrict draw, double scale, std::size_t n, double* __restrict x) noexcept {
  for (std::size_t i = 0; i < n; ++i) x[i] += scale * static_cast<double>(draw[i]);
}
SOOPNAV_TARGET_CLONES_WIDE
void shrink(double share, double offset, std::size_t n, double* __restrict x) noexcept {
  for (std::size_t i = 0; i < n; ++i) x[i] = share * x[i] + offset;
}

}  // namespace

Particles::Particles(std::size_t count, std::size_t dimensions)
    : count_(count),
      dimensions_(dimensions),
      weights_(padded(count)),
      shown_(count),
      moved_(padded(count)),
      draws_(padded(count)),
      ancestors_(count) {
  for (std::size_t axis = 0; axis < dimensions_; ++axis) places_[axis].resize(padded(count));
}

void Particles::clear(std::uint64_t seed) noexcept {
  random_ = RandomStream(seed, 0x50F7);
  started_ = false;
  total_ = 1.0;
  std::fill(weights_.begin(), weights_.end(), 0.0);
  std::fill_n(weights_.begin(), count_, 1.0 / static_cast<double>(count_));
  std::fill(shown_.begin(), shown_.end(), 1.0 / static_cast<double>(count_));
}

void Particles::start(const Vector& mean, double sigma) noexcept {
  for (std::size_t axis = 0; axis < dimensions_; ++axis) {
    random_.fill_normal(std::span(draws_.data(), count_));
    std::fill(places_[axis].begin(), places_[axis].end(), mean[axis]);
    add_scaled(draws_.data(), sigma, count_, places_[axis].data());
  }
  started_ = true;
}

void Particles::start(const Kept& kept, double min_range_m, double max_range_m, double outlier) noexcept {
  const double sigma = std::sqrt(kept.b.variance_azimuth);
  const double slope = std::sqrt(kept.b.variance_elevation);
  const auto round = static_cast<std::size_t>(outlier * static_cast<double>(count_));
  for (auto& axis : places_) std::fill(axis.begin(), axis.end(), 0.0);
  for (std::size_t i = 0; i < count_; ++i) {
    const double azimuth = i < round ? random_.uniform(-kPi, kPi) : kept.azimuth + sigma * random_.normal();
    const double level = random_.uniform(min_range_m, max_range_m);
    places_[0][i] = kept.b.x + level * std::cos(azimuth);
    places_[1][i] = kept.b.y + level * std::sin(azimuth);
    if (dimensions_ == 3) {
      const double elevation = std::clamp(kept.b.elevation + slope * random_.normal(), -0.49 * kPi, 0.49 * kPi);
      places_[2][i] = kept.b.z + level * std::tan(elevation);
    }
  }
  started_ = true;
}

bool Particles::weigh(const PackedBearing& bearing, double outlier, double threshold) noexcept {
  const Places places{places_[0], places_[1], places_[2]};
  const WeightSum sums = weigh_places(bearing, places, outlier, 1.0 / total_, weights_);
  // Padding has no weight, and sums of nothing are no number to divide by.
  if (!(sums.sum > 1e-290) || !std::isfinite(sums.sum)) return false;
  total_ = sums.sum;
  if (sums.sum * sums.sum < threshold * static_cast<double>(count_) * sums.squares) resample();
  return true;
}

void Particles::show() noexcept {
  std::copy_n(weights_.begin(), count_, shown_.begin());
  shrink(1.0 / total_, 0.0, count_, shown_.data());
}

void Particles::moments(Vector& mean, Matrix& covariance) const noexcept {
  const std::size_t n = weights_.size();
  for (std::size_t i = 0; i < dimensions_; ++i) {
    const double from = places_[i][0];
    mean[i] = from + weighted({weights_.data(), places_[i].data(), nullptr, from, 0.0}, n) / total_;
  }
  for (std::size_t i = 0; i < dimensions_; ++i) {
    for (std::size_t j = 0; j <= i; ++j) {
      covariance[i][j] =
          weighted({weights_.data(), places_[i].data(), places_[j].data(), mean[i], mean[j]}, n) / total_;
      covariance[j][i] = covariance[i][j];
    }
  }
}

void Particles::resample() noexcept {
  Vector mean{};
  Matrix covariance{};
  moments(mean, covariance);
  if (!soopnav::resample(Resampling::kSystematic, std::span<const double>(weights_.data(), count_), random_,
                         ancestors_)) {
    return;
  }
  // A kernel of the cloud's own covariance in place of copies; the cloud shrinks by as much as the kernel widens it.
  const auto d = static_cast<double>(dimensions_);
  const double bandwidth = std::pow(4.0 / ((d + 2.0) * static_cast<double>(count_)), 1.0 / (d + 4.0));
  const double keep = std::sqrt(1.0 - bandwidth * bandwidth);
  for (std::size_t axis = 0; axis < dimensions_; ++axis) {
    double* const x = places_[axis].data();
    for (std::size_t i = 0; i < count_; ++i) moved_[i] = x[ancestors_[i]];
    std::copy_n(moved_.begin(), count_, x);
    shrink(keep, (1.0 - keep) * mean[axis], count_, x);
  }
  Matrix L{};
  if (factor(dimensions_, covariance, L)) {
    for (std::size_t k = 0; k < dimensions_; ++k) {
      random_.fill_normal(std::span(draws_.data(), count_));
      for (std::size_t axis = k; axis < dimensions_; ++axis) {
        add_scaled(draws_.data(), bandwidth * L[axis][k], count_, places_[axis].data());
      }
    }
  }
  std::fill_n(weights_.begin(), count_, 1.0 / static_cast<double>(count_));
  total_ = 1.0;
}

}  // namespace soopnav::navigation::detail
